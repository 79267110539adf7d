"""Force elements in model files, drawings, reports, energies of modes, fits, tuning and sweeps."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.app.commands import main
from jaxbody.views.scenes.poses import still
from jaxbody.views.scenes.scenes import animation_of

M, K, C, Q = 4.0, 900.0, 6.0, 120.0  # of a shaft with a seal


class Leveler(jb.ForceElement):
    """A force that grows with the time integral of a reading."""

    gain: jax.Array = jb.field("N/(m s)", "positive")
    states, state_units = ("integral",), ("m s",)

    def forces(self, now):
        return now.opposed(-self.gain * now.z[0] * jnp.array([0, 0, 1.0]))

    def rates(self, now):
        return (now.readings["travel"] + 0 * now.readings["gauge"])[None]


def shaft(q=Q, **more):
    springs = {"stiffness": np.diag([K, K, K, 1, 1, 1]), "damping": np.diag([C, C, C, 0, 0, 0])}
    return jb.Model(
        bodies={"rotor": jb.Body(mass=M, inertia=[1, 1, 1])},
        joints={"rotor": jb.Translation("world")},
        elements={
            "shaft": jb.Bushing(("rotor", [0, 0, 0]), ("world", [0, 0, 0]), **springs),
            "seal": jb.forces.WhirlForce(
                ("rotor", [0, 0, 0.5]), ("world", [0, 0, 0.5]), axis="z", cross_stiffness=q
            ),
            **more,
        },
    )


MAGNET = jb.forces.MagneticBearing(
    "rotor", ("world", [0.01, 0, 0]), axis="x", current_stiffness=40.0,
    displacement_stiffness=300.0, inductance=0.02, resistance=3.0, proportional=50.0,
    derivative=4.0,
)  # fmt: skip
AIR = jb.forces.SectionAirloads(
    ("rotor", [0.1, 0, 0]), chord="x", flow=[-1, 0, 0], lift="z", pressure=60.0, area=0.3, speed=9.0
)
READY = {"magnet": MAGNET, "air": AIR}


def roots(q):
    """Of m s2 + c s + k - i q = 0, for x + i y."""
    return np.roots([M, C, K - 1j * q])


def test_files_hold_force_elements(tmp_path):
    own = {
        "level": Leveler(
            ("world", "rotor"),
            gain=jnp.array(50.0),
            reads={
                "travel": jb.Position("rotor", axis="z", gain=2.0),
                "gauge": jb.sensors.StringPotentiometer(("rotor", [0, 0, 1]), ("world", [0, 0, 3])),
            },
        ),
        "pull": jb.Force(("rotor", [0, 1, 0]), force=[1, 2, 3], axes="body"),
        "hum": jb.Force("rotor", moment=jb.signals.Sine(amplitude=[1, 2, 3], frequency=3.0)),
        "motor": jb.inputs.Unbalance("rotor", axis="z", unbalance=1e-3, frequency=5.0),
    }
    model = shaft(**READY, **own)
    for suffix in ("toml", "json"):
        jb.write_model(model, path := tmp_path / f"model.{suffix}", allow=[__name__])
        again = jb.read_model(path, allow=[__name__])
        assert eqx.tree_equal(model, again) and again.force_names == model.force_names
    with pytest.raises(jb.JaxbodyError, match=r"elements\.level: is a Leveler.*NOT_ALLOWED"):
        jb.write_model(model, tmp_path / "model.toml")


AIRFOIL = """
jaxbody = 1
[bodies.wing]
mass = "10 kg"
inertia = "1, 1, 1 kg m2"
[joints]
wing = {type = "Translation", parent = "world"}
[elements.spring]
type = "Bushing"
a = "wing"
b = "world"
stiffness = "800, 900, 950 N/m"
[elements.air]
type = "SectionAirloads"
on = ["wing", "100, 0, 0 mm"]
chord = "x"
flow = [-1, 0, 0]
lift = "z"
pressure = "3 kPa"
area = "50 cm2"
slope = "0.1 1/deg"
speed = "72 km/h"
[elements.seal]
type = "WhirlForce"
a = "wing"
b = "world"
axis = "z"
damping = "80 N s/m"
cross_stiffness = "0.4 N/mm"
"""


def test_numbers_in_files_have_units(tmp_path):
    (path := tmp_path / "wing.toml").write_text(AIRFOIL)
    air, seal = (jb.read_model(path)[name] for name in ("air", "seal"))
    found = [*air.point, air.pressure, air.area, air.slope, air.speed, seal.cross_stiffness]
    expected = [0.1, 0, 0, 3000, 5e-3, 18 / np.pi, 20, 400]
    np.testing.assert_allclose(found, expected, rtol=1e-15)
    path.write_text(AIRFOIL.replace("3 kPa", "3 kN"))
    with pytest.raises(jb.JaxbodyError, match=r"elements\.air\.pressure: is '3 kN'"):
        jb.read_model(path)


@pytest.mark.nan
def test_a_report_of_a_system_that_is_not_symmetric_shows_complex_modes(tmp_path, capsys):
    (path := tmp_path / "wing.toml").write_text(AIRFOIL)
    main(["report", str(path), "--part", "model", "--part", "modes"])
    page = path.with_suffix(".html").read_text()
    assert "Complex modes" in page and "3 elements (spring, air, seal)" in page
    assert all(text in page for text in ("pressure [Pa]", "cross stiffness [N/mm]"))
    main(["check", str(path)])
    assert "1 body, 3 elements" in capsys.readouterr().out


def test_drawings_show_force_elements():
    class Pull(jb.ForceElement):  # without points: between origins
        def forces(self, now):
            return now.opposed(jnp.array([0, 0, 1.0]))

    model = shaft(**READY, still=Pull(("world", "rotor")))
    animation = animation_of(still(model, model.reference))
    parts = [part.path for part in animation.parts if part.path[1] in model.force_names]
    kinds = [(name, what[:-2]) for _, name, what in parts]
    assert {name: kinds.count((name, "end")) for name in model.force_names} == {
        "seal": 2, "magnet": 2, "air": 1, "still": 2,
    }  # fmt: skip
    assert kinds.count(("magnet", "line")) == 1 and ("air", "line") not in kinds
    names = {label.text: label.p for label in animation.labels}
    np.testing.assert_allclose(names["magnet"].ravel(), [0.005, 0, 0], atol=1e-15)


def test_energies_say_what_has_no_potential():
    """Of a magnet on a spring k: k against k_i P/R - k_x, in which the current follows."""
    k, n = 5e3, {"current_stiffness": 40.0, "displacement_stiffness": 2e3, "proportional": 400.0}
    magnet = jb.forces.MagneticBearing(
        "rotor", "world", axis="z", inductance=0.02, resistance=3.0, derivative=4.0, **n
    )
    model = jb.Model(
        bodies={"rotor": jb.Body(mass=M, inertia=[1, 1, 1])},
        joints={"rotor": jb.Guide("world", axis="z")},
        elements={
            "spring": jb.Spring("rotor", ("world", [0, 0, -1]), stiffness=k, free_length=1.0),
            "magnet": magnet,
        },
    )
    shares = jb.vibration.mode_energies(jb.linearize(model, model.reference))
    forced = 40.0 * 400.0 / 3.0 - 2e3
    expected = 100 * np.array([k, forced]) / (k + forced)
    found = [shares.strain["spring"][0], shares.other_strain["no potential"][0]]
    np.testing.assert_allclose(found, expected, rtol=1e-12)
    others = [abs(shares.other_strain[name][0]) for name in ("tension", "gravity", "loads")]
    assert max(others) < 1e-9  # percent
    assert "no potential: magnet, whose damping is left out" in str(shares)


def test_a_fit_finds_a_cross_coupled_stiffness():
    """From the closed form of a free motion z = x + i y, z(0) = 0.01, z'(0) = 0."""
    times, (s1, s2) = np.linspace(0.0, 1.0, 201), roots(Q)
    z = 0.01 * (s2 * np.exp(s1 * times) - s1 * np.exp(s2 * times)) / (s2 - s1)
    run = jb.Experiment(
        times,
        sensors={"x": jb.Position("rotor")},
        measured={"x": np.stack([z.real, z.imag, 0 * times], 1)},
        initial=jb.State([0.01, 0, 0], [0, 0, 0]),
    )
    fit = jb.fit(shaft(70.0), {"run": run}, free=["seal.cross_stiffness"], rtol=1e-9)
    # accuracy of the integration, relative to the growth of its error over the record
    np.testing.assert_allclose(fit.estimates["seal.cross_stiffness"], Q, rtol=1e-5)


def decay(model):
    return jnp.min(jb.complex_modes(jb.linearize(model, model.reference)).decay_rate)


def test_batches_and_sweeps_of_designs():
    paths, values = "seal.cross_stiffness", np.array([0.0, 60.0, 90.0, 150.0])
    expected = [min(-roots(q).real) for q in values]
    found = jb.jit(jax.vmap(lambda q: decay(jb.replace(shaft(), {paths: q}))))(values)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)  # zero at 90
    swept = jb.sweep(shaft(), lambda model: {"decay": decay(model)}, {paths: values})
    np.testing.assert_allclose(swept["decay"], expected, rtol=1e-9, atol=1e-12)


def test_a_seal_is_tuned_to_its_limit():
    """The largest cross-coupled stiffness for a decay rate d: with s = -d + i w, m s2 + c s + k -
    i q = 0 gives m w2 = k - c d + m d2 and q = (c - 2 m d) w."""
    d = 0.1
    design = jb.tune(
        shaft(40.0),
        lambda model: {"decay": decay(model), "q": -model["seal"].cross_stiffness},
        free=["seal.cross_stiffness"],
        minimize="q",
        limits={"decay": (d, None)},
    )
    expected = (C - 2 * M * d) * np.sqrt((K - C * d + M * d**2) / M)
    # tolerance of the limit, 1e-8 of the decay rate before, over its slope
    np.testing.assert_allclose(design.values["seal.cross_stiffness"], expected, rtol=1e-7)
