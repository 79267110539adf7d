"""Outputs of responses are sensors: vectors, chains, and a sensor of one's own as instrument,
output and term of a design."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs

import jaxbody as jb

F = np.array([0.3, 1.1, 2.0, 7.0])
INPUTS = {"x": jb.BaseMotion("base", "x"), "pull": jb.PointForce("arm", [0.1, 0, 0.2], "y")}
POINT = [0.1, 0.2, -0.1]


@pytest.fixture(scope="module")
def lin():
    model = rigs.rig(mount=rigs.MOUNT)
    return jb.linearize(model, jb.equilibrium(model))


@pytest.mark.long
def test_each_component_of_a_vector_is_an_output(lin):
    """ "seat.x" is what the sensor along x reads; of a pose positions and rotations, of a reaction
    forces and moments."""
    vectors = {
        "acc": jb.Acceleration("box", POINT),
        "pose": jb.sensors.BodyPose("box"),
        "base": jb.sensors.Reaction("base"),
    }
    H = jb.frequency_response(lin, F, INPUTS, vectors)
    parts = ("x", "y", "z", "rx", "ry", "rz")
    assert H.outputs == (
        *(f"acc.{d}" for d in "xyz"),
        *(f"pose.{d}" for d in parts),
        *(f"base.{d}" for d in parts),
    )
    assert H.output_units == ("m/s2",) * 3 + ("m",) * 3 + ("rad",) * 3 + ("N",) * 3 + ("N m",) * 3
    single = {f"acc.{d}": jb.Acceleration("box", POINT, axis=d) for d in "xyz"}
    single |= {f"pose.{d}": rigs.motion("box", direction=d) for d in parts}
    single |= {f"base.{d}": jb.sensors.Reaction("base", component=k) for k, d in enumerate(parts)}
    expected = jb.frequency_response(lin, F, INPUTS, single)
    np.testing.assert_allclose(
        H.values, expected.values, rtol=1e-12, atol=1e-12 * np.abs(expected.values).max()
    )


@pytest.mark.long
def test_a_rate_is_s_times_its_motion(lin):
    """Velocity and acceleration are s and s^2 times the position, relative to the arm too; likewise
    of rotations; s = 2 pi i f."""
    families = [
        (jb.Position, jb.Velocity, jb.Acceleration),
        (jb.sensors.Rotation, jb.sensors.AngularVelocity, jb.sensors.AngularAcceleration),
    ]
    outputs = {
        kind.__name__: kind("box", axis=[1, 2, -1], relative_to="arm")
        for family in families
        for kind in family
    }
    H = jb.frequency_response(lin, F, INPUTS, outputs)
    for family in families:
        motion, *rates = (np.asarray(H.values[H.outputs.index(kind.__name__)]) for kind in family)
        for k, rate in enumerate(rates):
            np.testing.assert_allclose(
                rate,
                (2j * np.pi * F) ** (k + 1) * motion,
                rtol=1e-12,
                atol=1e-12 * np.abs(rate).max(),
            )


def test_an_input_by_its_rate_is_integrated(lin):
    """The response to a velocity or an acceleration of a support is that to its displacement over s
    or s^2, as a turn too."""
    kinds = ("displacement", "velocity", "acceleration")
    inputs = {
        f"{d} {kind}": jb.BaseMotion("base", d, kind=kind) for d in ("x", "ry") for kind in kinds
    }
    H = np.asarray(jb.frequency_response(lin, F, inputs, {"box": jb.Position("box", POINT)}).values)
    for first in (0, 3):
        for k in (1, 2):
            expected = H[:, first] / (2j * np.pi * F) ** k
            np.testing.assert_allclose(
                H[:, first + k], expected, rtol=1e-12, atol=1e-12 * np.abs(expected).max()
            )


def test_a_chain_multiplies_the_response_of_its_sensor(lin):
    """gain exp(-s delay)/(1 + s lag); the bias is a constant, of which a response knows nothing."""
    chained = jb.Acceleration("box", POINT, axis="z", gain=-1.3, bias=0.2, delay=0.013, lag=0.07)
    outputs = {
        "plain": jb.Acceleration("box", POINT, axis="z"),
        "read": chained,
        "three": jb.Velocity("arm", gain=[1.0, 2.0, 3.0]),
    }
    H = jb.frequency_response(lin, F, INPUTS, outputs)
    s = 2j * np.pi * F
    np.testing.assert_allclose(
        H.values[1], -1.3 * np.exp(-0.013 * s) / (1 + 0.07 * s) * H.values[0], rtol=1e-13
    )
    arm = jb.frequency_response(lin, F, INPUTS, {"arm": jb.Velocity("arm")}).values
    np.testing.assert_allclose(
        H.values[2:], np.array([1.0, 2.0, 3.0])[:, None, None] * arm, rtol=1e-13
    )


def test_a_lag_is_a_state_of_the_state_space(lin):
    """C (s - A)^-1 B + D is the frequency response, and the poles gain -1/lag."""
    outputs = {
        "read": jb.Acceleration("box", POINT, axis="z", gain=2.0, lag=0.07),
        "turn": jb.sensors.Rotation("arm", axis="x"),
    }
    inputs = {"x": jb.BaseMotion("base", "x", kind="acceleration"), "pull": INPUTS["pull"]}
    space = lin.state_space(inputs, outputs)
    assert space.states[-1] == "lagged read"
    A, B, C, D = (np.asarray(x) for x in (space.A, space.B, space.C, space.D))
    H = np.asarray(jb.frequency_response(lin, F, inputs, outputs).values)
    found = np.stack(
        [C @ np.linalg.solve(2j * np.pi * f * np.eye(len(A)) - A, B) + D for f in F], -1
    )
    np.testing.assert_allclose(found, H, rtol=0, atol=1e-10 * np.abs(H).max(2, keepdims=True).max())
    assert np.abs(np.linalg.eigvals(A) + 1 / 0.07).min() < 1e-9


def test_a_force_reaches_a_reaction_at_once_in_the_state_space(lin):
    """D of a joint's reaction to a force on its body is what the response at very high frequencies
    tends to, whatever the masses do."""
    outputs = {
        "hinge": jb.sensors.Reaction("arm", component=0),
        "base": jb.sensors.Reaction("base", component=1),
    }
    inputs = {
        "pull": jb.PointForce("arm", [0.1, 0, 0.2], "x"),
        "push": jb.PointForce("box", [0.1, 0, 0.2], "y"),
    }
    space = lin.state_space(inputs, outputs)
    A, B, C, D = (np.asarray(x) for x in (space.A, space.B, space.C, space.D))
    H = np.asarray(jb.frequency_response(lin, F, inputs, outputs).values)
    found = np.stack(
        [C @ np.linalg.solve(2j * np.pi * f * np.eye(len(A)) - A, B) + D for f in F], -1
    )
    np.testing.assert_allclose(found, H, rtol=0, atol=1e-10 * np.abs(H).max())
    assert np.abs(D[0, 0]) > 0.01


class Slant(jb.sensors.Sensor):
    """The distance of a body from a corner of the room, a sensor of one's own."""

    on: str = eqx.field(static=True)
    corner: jax.Array
    shape, unit = (), "m"

    def __init__(self, on, corner, **chain):
        self.corner = jnp.asarray(corner)
        super().__init__(on, **chain)

    def reading(self, model, frames):
        return jnp.linalg.norm(frames.p[model.layout.frame(self.on)] - self.corner)


@pytest.mark.long
def test_a_sensor_of_ones_own_is_an_instrument_an_output_and_a_term_of_a_design():
    """A quarter car's body at height 0.9 m above a corner 1.2 m aside is 1.5 m away: the response
    is that of the height times 0.9/1.5. The fit finds the stiffness behind the record; tuning finds
    the damper of the least rms of the distance, against a scan."""
    car = jb.presets.quarter_car(damping=1500.0)
    height = float(car["body"].position[2] + jb.equilibrium(car).state.q[0])
    slant = Slant("body", [1.2, 0.0, height - 0.9])
    lin = jb.linearize(car, jb.equilibrium(car))
    road = {"road": jb.BaseMotion("road", "z")}
    outputs = {"slant": slant, "height": jb.Position("body", axis="z")}
    H = jb.frequency_response(lin, F, road, outputs)
    np.testing.assert_allclose(H["slant", "road"], 0.6 * H["height", "road"], rtol=1e-12)

    times = np.linspace(0, 1, 51)
    motion = {"road": jb.Harmonic(frequency=1.3, translation=[0, 0, 0.02])}
    measured = jb.measure(jb.simulate(car, times, motion=motion, initial="rest"), {"slant": slant})
    run = jb.Experiment(
        times,
        motion=motion,
        initial="rest",
        sensors={"slant": slant},
        measured=measured,
        noise={"slant": 1e-4},
    )
    fit = jb.fit(
        jb.replace(car, {"suspension.stiffness": 15e3}), {"run": run}, free=["suspension.stiffness"]
    )
    np.testing.assert_allclose(
        fit.model["suspension"].stiffness, car["suspension"].stiffness, rtol=1e-6
    )

    band, spectra = (
        jb.vibration.Band(0.3, 20.0, points=200),
        {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)},
    )

    def rms(model):
        return {
            "rms": jb.random_response(
                jb.linearize(model, model.reference), band, road, {"slant": slant}, spectra
            )["slant"]
        }

    path = "suspension.damping"
    tuned = jb.tune(car, rms, free=[path], minimize="rms", bounds={path: (500.0, 6000.0)})
    scan = np.linspace(500.0, 6000.0, 12)
    values = [float(rms(jb.replace(car, {path: c}))["rms"]) for c in scan]
    assert float(tuned.after["rms"]) <= min(values) * (1 + 1e-9)
    assert abs(float(tuned.values[path]) - scan[int(np.argmin(values))]) <= 500.0
