"""Both precisions: a change in either direction within a process, and float32 alone."""

import os
import subprocess
import sys

import numpy as np
import pytest

import jaxbody as jb

SWITCHED = """
import sys
import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import jaxbody as jb

WEIGHTS = np.array([300.0, 100.0])  # a constant of NumPy in a law of the user's


class Split(jb.laws.Law):
    stiffness: jax.Array
    def force(self, x):
        return self.stiffness * (WEIGHTS / 400.0 * x).sum()


def results():
    model = jb.Model(bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])}, joints={"mass": jb.Guide("base", axis=[1, 0, 0])},
                     supports={"base": jb.Support()}, gravity=[-9.81, 0, 0],
                     elements={"s": jb.SpringDamper(("mass", [0, 0, 0]), ("base", [-1, 0, 0]), spring=Split(np.array(400.0)),
                                                    free_length=1.0)})
    eq = jb.equilibrium(model)
    lin = jb.linearize(model, eq)
    frequency = jb.modes(lin, allow_float32=True).frequency[0]
    times = np.array([0.0, np.pi / 20])
    q = [jb.simulate(model, times, rtol=1e-4, solver=solver).state.q[-1, 0] for solver in (None, diffrax.Tsit5())]
    H = jb.frequency_response(lin, [1.0], {"base": jb.BaseMotion("base", "x")}, {"mass": jb.Position("mass", axis="x")}).values
    found = np.array([eq.state.q[0], frequency, *q, H.real.ravel()[0]])
    assert H.dtype == (np.complex128 if jax.config.jax_enable_x64 else np.complex64)
    sag = 9.81 / 400  # half a period from rest at 0 leads to twice the sag
    exact = np.array([-sag, 20 / (2 * np.pi), -2 * sag, -2 * sag, 1 / (1 - (2 * np.pi / 20) ** 2)])
    return np.abs(found / exact - 1).max()


def of_a_table():
    # a free body, what instruments with a lag read, and its mass, which is found again
    model = jb.Model(bodies={"table": jb.Body(mass=2.0, inertia=[0.1, 0.2, 0.3])}, supports={"base": jb.Support()},
                     elements={"mount": jb.Bushing(("table", [0.1, 0, 0]), ("base", [0.1, 0, 0]),
                                                    stiffness=np.diag([900.0, 800, 700, 20, 30, 40]))})
    times, noise = np.linspace(0.0, 0.3, 31), 1e-3
    motion = {"base": jb.Harmonic(frequency=3.0, rotation=[0, 0.1, 0], translation=[0.01, 0, 0.02])}
    sensors = {"turn": jb.sensors.Orientation("table"), "speed": jb.sensors.Gyro("table", lag=0.02)}
    read = jb.measure(jb.simulate(model, times, motion=motion), sensors)
    run = jb.Experiment(times, motion=motion, sensors=sensors, measured=read, noise=noise)
    found = jb.fit(jb.replace(model, {"table.mass": 2.2}), {"run": run}, free="table.mass", allow_float32=True)
    return np.array([*np.abs(read["speed"]).max(0), found.estimates["table.mass"]])


@jax.jit
def of_the_user(x):
    return jnp.sin(x)


tables = []
for x64 in (word == "64" for word in sys.argv[1:]):
    jax.config.update("jax_enable_x64", x64)
    of_the_user(1.0)
    print(results() < (1e-4 if x64 else 1e-3))
    tables.append(of_a_table())
print(np.abs(tables[0] - tables[1]).max() < 1e-3, of_the_user._cache_size())
"""  # noqa: E501


@pytest.mark.long
@pytest.mark.everywhere
@pytest.mark.parametrize("order", [("32", "64"), ("64", "32")])
def test_precision_may_be_switched_either_way_within_a_process(order):
    environment = {**os.environ, "JAX_ENABLE_X64": "0", "PYTHONWARNINGS": "ignore"}
    run = subprocess.run(
        [sys.executable, "-c", SWITCHED, *order],
        capture_output=True,
        text=True,
        env=environment,
        timeout=600,
    )
    # and both programs of the user's are kept
    assert run.stdout.split() == ["True"] * 3 + ["2"], run.stderr


@pytest.mark.parametrize(
    "call",
    [lambda m, s: jb.simulate(m, [0.0, 1.0], initial=s), lambda m, s: jb.equilibrium(m, start=s)],
)
def test_a_state_of_the_other_precision_is_refused_with_what_to_do(call):
    model = jb.presets.quarter_car(damping=1500.0)
    single = jb.State(np.zeros(2, np.float32), np.zeros(2, np.float32))
    with pytest.raises(jb.JaxbodyError) as raised, jb.compile_times() as times:
        call(model, single)
    assert [problem.code for problem in raised.value.problems] == ["X64_CHANGED"] * 2
    assert "q: is float32, the model float64" in str(
        raised.value
    ) and "numpy.asarray(state.q, 'float64')" in str(raised.value)
    assert "integrate" not in times.programs and "equilibrium_of" not in times.programs


ALONE = """
import warnings
import numpy as np
import jaxbody as jb

slider = jb.Model(bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])}, joints={"mass": jb.Guide("base", axis=[1, 0, 0])},
                  supports={"base": jb.Support()}, gravity=[-9.81, 0, 0],
                  elements={"s": jb.Spring(("mass", [0, 0, 0]), ("base", [-1, 0, 0]), stiffness=400.0, free_length=1.0)})
car = jb.presets.quarter_car(damping=1500.0)
with warnings.catch_warnings(record=True) as warned:
    warnings.simplefilter("always")
    for model, along in ((slider, "x"), (car, "z")):
        body, base = model.layout.bodies[0], model.layout.supports[0]
        eq = jb.equilibrium(model)
        loaded = jb.equilibrium(model, loads={"f": jb.Force(body, force=[10.0 * (along == "x"), 0, 10.0 * (along == "z")])})
        lin = jb.linearize(model, eq)
        moved = jb.simulate(model, np.linspace(0, 1, 11), initial=jb.State(eq.state.q + 0.01, eq.state.v))
        u, y = {"u": jb.BaseMotion(base, along)}, {"y": jb.Position(body, axis=along)}
        H = [jb.frequency_response(lin, [1.0, 5.0], u, y, method=method) for method in ("direct", "modal")]
        few = int(moved.statistics["num_accepted_steps"]) < 200
        print(*(int(result.status) for result in (eq, loaded, moved, *H)), few, jb.preload(model).ok)
        print(*np.ravel([eq.state.q, loaded.state.q, moved.state.q[-1]]), *np.abs(H[0].values).ravel(), *np.abs(H[1].values).ravel())
    cut = jb.simulate(slider, [0.0, 100.0], initial=jb.State(slider.reference.q, np.array([1.0])), max_steps=100)
print(sorted({w.message.code for w in warned}))
print(cut.report())
"""  # noqa: E501


@pytest.mark.long
def test_float32_by_itself_ends_well_as_float64_does_and_advises_it_where_it_does_not():
    runs = []
    for x64 in ("0", "1"):
        environment = {**os.environ, "JAX_ENABLE_X64": x64}
        run = subprocess.run(
            [sys.executable, "-c", ALONE],
            capture_output=True,
            text=True,
            env=environment,
            timeout=600,
        )
        assert run.returncode == 0, run.stderr
        runs.append(run.stdout.splitlines())
    single, double = runs
    for line in (0, 2):
        # equilibria, motion, responses
        assert single[line].split()[:5] == ["0"] * 5 == double[line].split()[:5]
        assert single[line].split()[5:] == ["True", "True"]
    for line in (1, 3):
        numbers = [np.array(lines[line].split(), float) for lines in runs]
        # of 1 in responses; motions of 0.01 m, by an rtol of 1.5e-4
        assert np.abs(numbers[0] - numbers[1]).max() < 1e-4
    assert single[4] == "['FLOAT32', 'MAX_STEPS']" and double[4] == "['MAX_STEPS']"
    assert "jax_enable_x64" in single[5] and "max_steps" not in single[5]
    assert "jax_enable_x64" not in double[5] and "larger max_steps" in double[5]
