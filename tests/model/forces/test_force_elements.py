"""Force elements: springs, dampers and Maxwell branches in disguise; linearizations against
differences of the equations of motion; derivatives; bad input."""

import dataclasses

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.mechanics.closed_loops import dynamics_of
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.numerics.eigenproblems import highest_rates

BLOCKS = [letter + block for letter in "MCK" for block in ("", "_tilde", "_bb")]


class HiddenSpring(jb.ForceElement):
    """A spring and a damper along AB."""

    a: jax.Array
    b: jax.Array
    stiffness: jax.Array = jb.field("N/m")
    damping: jax.Array = jb.field("N s/m")
    free_length: jax.Array = jb.field("m")

    def forces(self, now):
        A, B = now.frames
        d, rate = B.point(self.b) - A.point(self.a), B.velocity(self.b) - A.velocity(self.a)
        length = jnp.linalg.norm(d)
        u = d / length
        tension = self.stiffness * (length - self.free_length) + self.damping * u @ rate
        return now.opposed(-tension * u, self.a, self.b)


class HiddenMaxwell(HiddenSpring):
    """A spring beside a spring in series with a damper, of which y is the elongation."""

    branch: jax.Array = jb.field("N/m")
    states, state_units = ("dashpot",), ("m",)

    def elongation(self, now):
        A, B = now.frames
        d = B.point(self.b) - A.point(self.a)
        return jnp.linalg.norm(d) - self.free_length, d / jnp.linalg.norm(d)

    def forces(self, now):
        e, u = self.elongation(now)
        tension = self.stiffness * e + self.branch * (e - now.z[0])
        return now.opposed(-tension * u, self.a, self.b)

    def rates(self, now):
        return self.branch / self.damping * (self.elongation(now)[0] - now.z)


A_END, B_END = [0.1, 0.2, -0.3], [0.2, 0.1, 0.4]
POINTS = jnp.array(A_END), jnp.array(B_END)
NUMBERS = {"stiffness": 900.0, "damping": 40.0, "free_length": 0.6}
PAIRS = {
    "spring": (
        jb.Spring(("arm", A_END), ("base", B_END), **NUMBERS),
        HiddenSpring(("arm", "base"), *POINTS, *map(jnp.array, NUMBERS.values())),
    ),
    "maxwell": (
        jb.SpringDamper(
            ("arm", A_END),
            ("base", B_END),
            spring=jb.laws.Linear(900.0)
            + jb.laws.Maxwell(stiffness=700.0, relaxation_time=40.0 / 700.0),
            free_length=0.6,
        ),
        HiddenMaxwell(
            ("arm", "base"), *POINTS, *map(jnp.array, NUMBERS.values()), jnp.array(700.0)
        ),
    ),
}


def rig(element):
    """A plate on a bushing and an arm on a hinge of a support, joined by a spring."""
    return jb.Model(
        bodies={
            "plate": jb.Body(mass=3.0, inertia=[0.3, 0.5, 0.6], position=[0.1, 0, 0.8]),
            "arm": jb.Body(mass=2.0, inertia=[0.2, 0.3, 0.1], com=[0.05, 0.1, -0.25]),
        },
        supports={"base": jb.Support(position=[0, 0, 0.2])},
        joints={"arm": jb.Hinge("base", axis=[0.2, 1, 0.1])},
        elements={
            "mount": jb.Bushing(
                ("plate", [0, 0, 0]), ("base", [0.1, 0, 0.6]),
                damping=np.diag([20, 30, 40, 1, 1, 1]),
                stiffness=np.diag([2e3, 3e3, 4e3, 90, 80, 70]),
            ),
            "link": jb.Spring(
                ("plate", [0.2, 0, 0]), ("arm", [0.3, 0, 0]), stiffness=500.0, free_length=0.4,
                damping=9.0,
            ),
            "hinge": jb.Torsion("arm", "base", axis=[0.2, 1, 0.1], spring=400.0),
            "pair": element,
        },
        gravity=[0, 0, -9.81],
    )  # fmt: skip


@pytest.fixture(params=[pytest.param("spring", marks=pytest.mark.long), "maxwell"])
def both(request):
    return [rig(element) for element in PAIRS[request.param]]


INPUTS = {
    "base": jb.BaseMotion("base", "z"),
    "tilt": jb.BaseMotion("base", "rx"),
    "pull": jb.PointForce("plate", [0.1, 0, 0], "x"),
}
OUTPUTS = {
    "place": jb.Position("plate", [0, 0.1, 0]),
    "acc": jb.Acceleration("arm", [0.2, 0, 0]),
    "link": jb.sensors.LoadCell("link"),
    "base": jb.sensors.Reaction("base"),
}


def close(one, other, limit=1e-12):
    scale = float(jnp.abs(one).max(initial=0.0))
    np.testing.assert_allclose(other, one, rtol=0, atol=limit * max(scale, 1e-300))


def linear(model):
    return jb.linearize(model, jb.equilibrium(model))


def test_a_disguised_element_has_the_equilibrium_of_the_element(both):
    plain, hidden = (jb.equilibrium(model) for model in both)
    close(plain.state.q, hidden.state.q)
    close(plain.state.z, hidden.state.z)
    assert hidden.stable and hidden.status == 0
    for one, other in zip(plain.reactions["base"], hidden.reactions["base"], strict=True):
        close(one, other)


@pytest.mark.parametrize(
    "method", ["structured", pytest.param("definition", marks=pytest.mark.long)]
)
def test_a_disguised_element_has_the_matrices_of_the_element(both, method):
    plain, hidden = (jb.linearize(model, jb.equilibrium(model), method=method) for model in both)
    rows = np.ones(len(plain.K))
    rows[plain.nv :] = 40.0  # N s/m: the row of a dashpot, as an equation of rates
    for name in BLOCKS:
        one, other = getattr(plain, name), getattr(hidden, name)
        close(one, other if name.endswith("bb") else rows[:, None] * other)
    if not plain.massless:  # rows of Xi; those of a branch are forces on the dashpot
        for one, other in zip(plain.whole, hidden.whole, strict=True):
            close(one, other)


def test_a_disguised_element_responds_as_the_element(both):
    plain, hidden = map(linear, both)
    f = np.linspace(0.0, 12.0, 40)
    H = jb.frequency_response(plain, f, INPUTS, OUTPUTS).values
    close(H, jb.frequency_response(hidden, f, INPUTS, OUTPUTS).values)
    close(H, jb.frequency_response(hidden, f, INPUTS, OUTPUTS, method="modal").values, 1e-10)
    shaking = {"pull": jb.vibration.PowerLaw(3.0, unit="N2/Hz")}
    pull, sensors = {"pull": INPUTS["pull"]}, {"place": OUTPUTS["place"]}
    rms = [
        jb.random_response(lin, jb.vibration.Band(0.1, 20.0), pull, sensors, shaking).rms
        for lin in (plain, hidden)
    ]
    close(*rms)
    poles = [
        np.sort_complex(np.asarray(jb.complex_modes(lin).poles).ravel()) for lin in (plain, hidden)
    ]
    close(*poles, limit=1e-11)
    relaxed = [np.asarray(jb.complex_modes(lin).relaxations) for lin in (plain, hidden)]
    close(*relaxed, limit=1e-11)


def test_a_disguised_element_has_the_state_space_of_the_element(both):
    kinds = {"base": jb.BaseMotion("base", "z", kind="acceleration"), "pull": INPUTS["pull"]}
    plain, hidden = (linear(model).state_space(kinds, OUTPUTS) for model in both)
    s = 2j * np.pi * 3.0

    def at(space):
        A, B, C, D = (np.asarray(x) for x in (space.A, space.B, space.C, space.D))
        return C @ np.linalg.solve(s * np.eye(len(A)) - A, B) + D

    close(at(plain), at(hidden))


@pytest.mark.parametrize(
    "equations", ["structured", pytest.param("lagrange", marks=pytest.mark.long)]
)
def test_a_disguised_element_moves_as_the_element(both, equations):
    times = jnp.linspace(0.0, 0.5, 26)
    motion = {"base": jb.Harmonic(frequency=3.0, translation=[0, 0, 0.02], rotation=[0.1, 0, 0])}
    steps = {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 1e-3}
    state = both[0].reference
    plain, hidden = (
        jb.simulate(model, times, motion=motion, equations=equations, initial=state, **steps)
        for model in both
    )
    close(plain.state.q, hidden.state.q)
    close(plain.state.z, hidden.state.z, 1e-11)
    close(plain.energies["kinetic"], hidden.energies["kinetic"], 1e-11)
    for one, other in zip(plain.reactions["base"], hidden.reactions["base"], strict=True):
        close(one, other, 1e-11)


def test_the_work_of_force_elements_is_part_of_the_balance(both):
    """E' = work of supports and of force elements - losses, by differences of the energy."""
    motion = {"base": jb.Harmonic(frequency=3.0, translation=[0, 0, 0.02])}
    times = jnp.linspace(0.0, 0.4, 401)
    run = jb.simulate(both[1], times, motion=motion, rtol=1e-11)
    powers, total = run.powers, run.energies["total"]
    net = powers["supports"] + powers["force elements"] + powers["loads"] - powers["damping"]
    slope = (8 * (total[3:-1] - total[1:-3]) - (total[4:] - total[:-4])) / (
        12 * (times[1] - times[0])
    )
    np.testing.assert_allclose(slope, net[2:-2], rtol=0, atol=1e-6 * float(jnp.abs(net).max()))


@pytest.mark.long
def test_derivatives_are_those_of_the_element(both):
    def seen(model, scale):
        model = jb.replace(model, {"plate.mass": 3.0 * scale, "link.stiffness": 500.0 * scale})
        eq = jb.equilibrium(model)
        H = jb.frequency_response(jb.linearize(model, eq), [1.0, 2.5], INPUTS, OUTPUTS).values
        return jnp.concatenate([eq.state.q, eq.state.z, H.real.ravel(), H.imag.ravel()])

    one, other = (jax.jacfwd(lambda s, model=model: seen(model, s))(1.0) for model in both)
    close(one, other, 1e-9)
    hidden, w = both[1], jnp.cos(jnp.arange(len(other)))
    back = jax.grad(lambda s: w @ seen(hidden, s))(1.0)
    np.testing.assert_allclose(back, w @ other, rtol=1e-9)


# Linearizations of random force elements


class RandomForce(jb.ForceElement):
    """A smooth function of all that it may see, with two states."""

    weights: jax.Array
    more: jax.Array
    states = ("one", "two")

    def features(self, now):
        size = {"force": 1e-2, "shaking": 1e-3}  # so that each is about one
        parts = [x.ravel() for F in now.frames for x in (F.p, F.R, F.v, F.w)]
        parts += [size.get(name, 1.0) * jnp.ravel(x) for name, x in sorted(now.readings.items())]
        return jnp.concatenate([*parts, now.z])

    def forces(self, now):
        x = self.features(now)
        F = 3 * jnp.tanh(self.weights[: 6 * len(now.frames), : len(x)] @ x / 4)
        return tuple(
            (F[6 * i : 6 * i + 3], F[6 * i + 3 : 6 * i + 6]) for i in range(len(now.frames))
        )

    def rates(self, now):
        x = self.features(now)
        return -5 * now.z + jnp.tanh(self.more[:, : len(x)] @ x)


def random_rig(seed):
    rng = np.random.default_rng(seed)
    reads = {
        "place": jb.Position("plate", [0.1, 0.2, 0], relative_to="base"),
        "speed": jb.Velocity("arm", [0.2, 0, 0], axis="z", gain=1.5),
        "stroke": jb.Elongation("link", bias=0.3),
        "force": jb.sensors.LoadCell("damper"),
        "floor": jb.Acceleration("base", axis="x"),
        "shaking": jb.Acceleration("plate", [0.1, 0, 0]),
    }
    force = RandomForce(
        ("plate", "arm", "base"), jnp.array(rng.normal(size=(18, 80))),
        jnp.array(0.3 * rng.normal(size=(2, 80))), reads=reads,
    )  # fmt: skip
    model = rig(PAIRS["maxwell"][0])
    elements = {
        "damper": jb.SpringDamper(
            ("plate", [0.1, 0.1, 0]), ("base", [0.3, 0, 0]), spring=300.0, damper=12.0,
            free_length=0.5,
        ),
        "force": force,
    }  # fmt: skip
    parts = model.parts()
    return jb.Model(**{**parts, "elements": parts["elements"] | elements})


@jax.jit
def slopes_by_differences(model, state):
    """d(v', z')/d(Delta, Delta', y, Xi, Xi', Xi'') by differences of fourth order."""
    layout, chart = model.layout, Coordinates(model)
    nv, nz = layout.nv, layout.nz

    def rate(x):
        delta, v, z, base = jnp.split(x, np.cumsum([nv, nv, nz]))
        xi, first, second = base.reshape(3, 1, 6)
        motions = (lambda t: xi[0] + first[0] * t + second[0] * t**2 / 2,)
        dynamics = dynamics_of(model, motions)
        y = dynamics.pack(jb.State(chart.retract(state.q, delta), v, state.z + z))
        return dynamics.rate(jnp.zeros(()), y)[layout.nq :]

    h, n = 2e-4, 2 * nv + nz + 18
    steps = h * jnp.eye(n)
    multiples, weights = jnp.array([1, -1, 2, -2.0]), jnp.array([8, -8, -1, 1]) / (12 * h)
    return jax.vmap(lambda e: weights @ jax.vmap(lambda k: rate(k * e))(multiples))(steps).T


@jax.jit
def slopes_by_matrices(lin):
    """The same from M, C and K."""
    n = lin.nv
    right = jnp.concatenate(
        [-lin.K[:, :n], -lin.C[:, :n], -lin.K[:, n:], lin.K_tilde, lin.C_tilde, lin.M_tilde], 1
    )
    return jnp.linalg.solve(highest_rates(lin.M, lin.C, n), right)


@pytest.mark.filterwarnings("ignore::jaxbody.core.errors.JaxbodyWarning")  # some flutter
@pytest.mark.parametrize(
    "method, seeds",
    [
        ("structured", 6),
        *(pytest.param(x, 100, marks=pytest.mark.long) for x in ("structured", "definition")),
    ],
)
def test_linearizations_are_the_slopes_of_the_equations_of_motion(method, seeds):
    """At equilibria on a moving support. The differences have an error of 1e-9."""
    linearized = jb.jit(lambda model, eq: jb.linearize(model, eq, method=method))
    for seed in range(seeds):
        model = random_rig(seed)
        eq = jb.equilibrium(model)
        expected = slopes_by_differences(model, eq.state)
        got, scale = slopes_by_matrices(linearized(model, eq)), np.abs(expected).max(1)
        assert (np.abs(got - expected).max(1) <= 1e-8 * scale).all(), seed


@pytest.mark.long
def test_derivatives_of_random_force_elements():
    model = random_rig(3)

    def seen(scale):
        changed = jb.replace(model, {"force.weights": scale * model["force"].weights})
        eq = jb.equilibrium(changed)
        lin = jb.linearize(changed, eq)
        H = jb.frequency_response(lin, [2.0], INPUTS, {"place": OUTPUTS["place"]}).values
        return jnp.sum(eq.state.q**2) + jnp.sum(eq.state.z) + jnp.sum(jnp.abs(H) ** 2) * 1e4

    forward, reverse, h = jax.jvp(seen, (1.0,), (1.0,))[1], jax.grad(seen)(1.0), 1e-4
    assert np.isfinite(forward)
    np.testing.assert_allclose(reverse, forward, rtol=1e-9)
    sampled = [float(seen(1.0 + k * h)) for k in (-2, -1, 1, 2)]
    central = (8 * (sampled[2] - sampled[1]) - (sampled[3] - sampled[0])) / (12 * h)
    np.testing.assert_allclose(central, forward, rtol=1e-6)


def test_a_reading_has_its_gain_and_bias():
    """A force of a reading y = 1.5 x + 0.3 alone, on a mass on a spring: 200 x = F(x) at rest."""

    class Pull(jb.ForceElement):
        def forces(self, now):
            return ((now.readings["y"] * jnp.array([0, 0, 10.0]), jnp.zeros(3)),)

    model = jb.Model(
        bodies={"mass": jb.Body(mass=2.0)},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "spring": jb.Spring("mass", ("world", [0, 0, -1]), stiffness=200.0, free_length=1.0),
            "pull": Pull("mass", reads={"y": jb.Position("mass", axis="z", gain=1.5, bias=0.3)}),
        },
    )
    np.testing.assert_allclose(jb.equilibrium(model).state.q[0], 3.0 / (200.0 - 15.0), rtol=1e-12)


def test_condensed_systems_keep_the_slow_poles():
    """A filter z' = (x - z)/T and a force -p z: for T much shorter than the period the poles are
    those of m s2 + (c - p T) s + k + p, whose error is of second order in T."""

    class Filtered(jb.ForceElement):
        gain: jax.Array
        time: jax.Array
        states = ("filtered",)

        def forces(self, now):
            return ((-self.gain * now.z[0] * jnp.array([0, 0, 1.0]), jnp.zeros(3)),)

        def rates(self, now):
            return (now.readings["x"] - now.z) / self.time

    m, k, c, p, T = 2.0, 200.0, 4.0, 60.0, 1e-3
    model = jb.Model(
        bodies={"mass": jb.Body(mass=m)},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "spring": jb.Spring(
                "mass", ("world", [0, 0, -1]), stiffness=k, free_length=1.0, damping=c
            ),
            "filter": Filtered(
                "mass", jnp.array(p), jnp.array(T), reads={"x": jb.Position("mass", axis="z")}
            ),
        },
    )
    lin = jb.linearize(model, model.reference)
    slow = lin.condensed
    np.testing.assert_allclose(slow.K, [[k + p]], rtol=1e-12)
    np.testing.assert_allclose(slow.C, [[c - p * T]], rtol=1e-12)
    exact = np.roots([m * T, m + c * T, c + k * T, k + p])
    got = np.ravel(jb.complex_modes(slow).poles)
    np.testing.assert_allclose(max(got, key=np.imag), max(exact, key=np.imag), rtol=2e-4)


def test_rates_that_read_an_acceleration_have_their_poles():
    """A skyhook damper by a leaky integral u of the acceleration, u' = x'' - u/T, F = -c u:
    T m s3 + (m + c T) s2 + k T s + k = 0."""

    class Skyhook(jb.ForceElement):
        states = ("velocity",)

        def forces(self, now):
            return ((-1000.0 * now.z[0] * jnp.array([0, 0, 1.0]), jnp.zeros(3)),)

        def rates(self, now):
            return now.readings["a"] - now.z / 5.0

    model = jb.Model(
        bodies={"table": jb.Body(mass=50.0)},
        joints={"table": jb.Guide("world", axis="z")},
        elements={
            "spring": jb.Spring("table", ("world", [0, 0, -1]), stiffness=2e4, free_length=1.0),
            "skyhook": Skyhook("table", reads={"a": jb.Acceleration("table", axis="z")}),
        },
    )
    modes = jb.complex_modes(jb.linearize(model, model.reference))
    found = np.concatenate([np.ravel(modes.poles), np.ravel(modes.relaxations)])
    exact = np.roots([5.0 * 50.0, 50.0 + 1000.0 * 5.0, 2e4 * 5.0, 2e4])
    np.testing.assert_allclose(np.sort_complex(found), np.sort_complex(exact), rtol=1e-10)


# States at rest


def test_a_state_without_influence_keeps_its_start():
    class Recorder(jb.ForceElement):
        states = ("distance",)

        def forces(self, now):
            return now.opposed(jnp.zeros(3))

        def rates(self, now):
            return now.readings["travel"][None]

    force = Recorder(("world", "plate"), reads={"travel": jb.Position("plate", axis="z")})
    parts = rig(PAIRS["spring"][0]).parts()
    model = jb.Model(**{**parts, "elements": parts["elements"] | {"record": force}})
    start = jb.State(model.reference.q, model.reference.v, jnp.array([0.7]))
    eq = jb.equilibrium(model, start=start)
    assert eq.status == 0 or eq.status == jb.Status.SINGULAR_K
    assert float(eq.state.z[0]) == 0.7
    close(jb.equilibrium(rig(PAIRS["spring"][0])).state.q, eq.state.q)


# Bad input


def refused(code, **changed):
    """The error of a model with this force element."""
    force = dataclasses.replace(PAIRS["spring"][1], **changed)
    with pytest.raises(jb.JaxbodyError) as error:
        rig(force)
    assert error.value.code == code, str(error.value)
    return str(error.value)


def test_a_frame_that_is_not_there():
    assert "'arn'" in refused("UNKNOWN_BODY", between=("arn", "base"))


def test_readings_that_are_wrong():
    stroke = jb.Elongation("link")
    assert "stroke" in refused("DUPLICATE_NAME", reads={"stroke": stroke, "again": stroke})
    assert "lonk" in refused("UNKNOWN_NAME", reads={"stroke": jb.Elongation("lonk")})
    refused("WRONG_KIND", reads={"stroke": 3.0})
    refused("BAD_CHAIN", reads={"stroke": jb.Elongation("link", delay=0.1)})
    refused("BAD_CHAIN", reads={"base": jb.sensors.Reaction("base")})


def test_a_force_that_reads_its_own_acceleration():
    class Loop(HiddenSpring):
        def forces(self, now):
            return now.opposed(now.readings["acc"])

    with pytest.raises(jb.JaxbodyError) as error:
        rig(Loop(**vars(PAIRS["spring"][1]) | {"reads": {"acc": jb.Acceleration("plate")}}))
    assert error.value.code == "ALGEBRAIC_LOOP" and "reads['acc']" in str(error.value)


@pytest.mark.parametrize(
    "returned", [jnp.zeros(3), ((jnp.zeros(3), jnp.zeros(3)),), ((jnp.zeros(3), jnp.zeros(2)),) * 2]
)
def test_forces_of_wrong_shape(returned):
    class Wrong(HiddenSpring):
        def forces(self, now):
            return returned

    with pytest.raises(jb.JaxbodyError) as error:
        rig(Wrong(**vars(PAIRS["spring"][1])))
    assert error.value.code == "BAD_SHAPE" and "forces" in str(error.value)


@pytest.mark.nan
def test_a_force_that_is_not_finite():
    class Bad(jb.ForceElement):
        def forces(self, now):
            return now.opposed(jnp.log(-jnp.ones(3)))

    model = jb.Model(
        bodies={"mass": jb.Body(mass=2.0)},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "spring": jb.Spring("mass", ("world", [0, 0, -1]), stiffness=200.0, free_length=1.0),
            "pair": Bad(("world", "mass")),
        },
    )
    with pytest.warns(jb.JaxbodyWarning, match="NONFINITE_FORCE") as warned:
        jb.equilibrium(model)
    assert "'pair'" in str(warned[0].message)
    with pytest.warns(jb.JaxbodyWarning, match="'pair'"):
        jb.simulate(model, [0.0, 0.1])


@pytest.mark.nan
def test_modes_refuse_what_is_not_symmetric():
    lin = linear(random_rig(1))
    with pytest.warns(jb.JaxbodyWarning, match="complex_modes"):
        assert np.isnan(jb.modes(lin).frequency).all()
    with pytest.raises(jb.JaxbodyError, match="WRONG_KIND"):
        jb.modes(PAIRS["spring"][1])


def test_what_cannot_take_force_elements_says_so():
    model = rig(PAIRS["spring"][1])
    for call in (
        lambda: jb.simulate(
            model,
            [0.0, 0.1],
            solver=jb.Gauss(2),
            dt0=0.01,
            stepsize_controller=diffrax.ConstantStepSize(),
        ),
        lambda: jb.files.write_mjcf(model, "x.xml"),
        lambda: jb.find_equilibria(model),
        lambda: jb.preload(model, free=["link.free_length"]),
        lambda: jb.load_cases(model, {"g": jb.LoadCase()}),
        lambda: jb.excitation(model, model.reference, {"base": np.zeros(6)}),
    ):
        with pytest.raises(jb.JaxbodyError) as error:
            call()
        assert error.value.code == "NO_POTENTIAL" and "pair" in str(error.value)


# Closed loops


def linkage(element):
    """A four-bar linkage held by a spring between its crank and the world."""
    parts = jb.presets.four_bar().parts()
    return jb.Model(**{**parts, "elements": parts["elements"] | {"pair": element}})


@pytest.mark.nan
@pytest.mark.long
def test_a_disguised_spring_holds_a_closed_loop_as_the_spring():
    """Equilibrium with its derivatives, matrices and poles, on closures."""
    crank, ends = jb.presets.four_bar().layout.bodies[0], ([0.03, 0.01, 0], [0.05, 0.1, 0])
    soft = {"stiffness": 30.0, "damping": 1.0, "free_length": 0.06}
    plain, hidden = (
        linkage(element)
        for element in (
            jb.Spring((crank, ends[0]), ("world", ends[1]), **soft),
            HiddenSpring((crank, "world"), *map(jnp.array, ends), *map(jnp.array, soft.values())),
        )
    )
    one, other = map(jb.equilibrium, (plain, hidden))
    close(one.state.q, other.state.q, 1e-11)
    lin, same = jb.linearize(plain, one), jb.linearize(hidden, other)
    for name in BLOCKS:
        close(getattr(lin, name), getattr(same, name), 1e-9)
    close(jb.complex_modes(lin).poles, jb.complex_modes(same).poles, 1e-9)

    def place(model, scale):
        return jb.equilibrium(jb.replace(model, {"pair.free_length": 0.06 * scale})).state.q

    slopes = [jax.jacfwd(lambda s, model=model: place(model, s))(1.0) for model in (plain, hidden)]
    close(*slopes, 1e-9)
