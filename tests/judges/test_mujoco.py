"""MuJoCo on the same models: accelerations and rates of inner states on moving supports, and
motions over a second, base moving."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

mujoco = pytest.importorskip("mujoco", reason="needs MuJoCo: pip install 'jaxbody[test]'")

import elementary_joints as joints  # noqa: E402
import in_mujoco  # noqa: E402
import judged_models  # noqa: E402

import jaxbody as jb  # noqa: E402
from jaxbody.mechanics.closed_loops import dynamics_of  # noqa: E402

SAMPLES = 4
EXACT = 1e-10  # rounding
QUICK = ("crane", "plate_on_rubber")  # the others are long tests: a second or two of compiling each
# its mass matrix has no room for an inerter between two trees, which plate_with_inerters would need
ITS_OWN_FORCES = (
    "two_bodies_on_springs",
    "chain_of_balls",
    "sliders",
    "crane",
    "robot_arm",
    "flap_with_weight",
    "hinges_with_torsion_springs",
    "arm_with_inerters",
    "free_on_a_carriage",
    *judged_models.WITH_MEMORY,
)


def random_states(model, rng):
    """Displaced from the reference by up to half a turn."""
    n, reference = model.layout.nv, model.reference
    q = [jb.joints.retract(model, reference.q, 0.4 * rng.normal(size=n)) for _ in range(SAMPLES)]
    return [jb.State(x, rng.normal(size=n), 0.3 * rng.normal(size=model.layout.nz)) for x in q]


@jb.jit  # compiling is the cost
def rates(model, motions, times, states):
    """v' and z'."""
    dynamics = dynamics_of(model, motions)

    def one(t, state):
        y = dynamics.pack(state)
        rate = jax.jvp(dynamics.unpack, (y,), (dynamics.rate(t, y),))[1]
        return rate.v, rate.z

    return jax.vmap(one)(times, states)


@pytest.mark.parametrize("name", judged_models.marked(ITS_OWN_FORCES, QUICK))
def test_accelerations_and_rates_of_states(name, rng):
    model = judged_models.MODELS[name]()
    motions = {
        name: jb.Harmonic(
            frequency=rng.uniform(0.2, 1.0, 6),
            translation=0.2 * rng.normal(size=3),
            rotation=0.3 * rng.normal(size=3),
            translation_phase=rng.uniform(0, 6, 3),
            rotation_phase=rng.uniform(0, 6, 3),
        )
        for name in model.layout.supports
    }
    states, times = random_states(model, rng), rng.uniform(0, 3, SAMPLES)
    v_dot, z_dot = rates(
        model,
        tuple(motions.values()),
        jnp.array(times),
        jax.tree.map(lambda *x: jnp.stack(x), *states),
    )
    with in_mujoco.Judge(model) as judge:
        for i, (t, state) in enumerate(zip(times, states, strict=True)):
            judge.put(state, {name: joints.imposed(motion, t) for name, motion in motions.items()})
            expected = judge.accelerations()
            np.testing.assert_allclose(
                v_dot[i], expected, rtol=0, atol=EXACT * np.abs(expected).max()
            )
            if judge.laws:
                expected = in_order_of_z(model, judge, judge.state_rates())
                np.testing.assert_allclose(
                    z_dot[i], expected, rtol=0, atol=EXACT * np.abs(expected).max()
                )


def in_order_of_z(model, judge, rows):
    """States in the order of z, from that of the judge's laws."""
    z = np.zeros((*np.shape(rows)[:-1], model.layout.nz))
    for name in dict.fromkeys(name for name, *_ in judge.laws):
        z[..., model.layout.z_slices[name]] = rows[
            ..., [i for i, (its, *_) in enumerate(judge.laws) if its == name]
        ]
    return z


TIMES = np.linspace(0, 1.0, 6)
MOTION = jb.Harmonic(frequency=1.2, translation=[0.05, -0.04, 0.03], rotation=[0, 0, 0.1])
MOVING = (
    "tumbling_body",
    "heavy_top",
    "oblique_pendulums",
    "chain_of_balls",
    "sliders",
    "crane",
    "flap_with_weight",
    "rolling_car",
    "hinges_with_torsion_springs",
    "two_bodies_on_springs",
    "arm_with_inerters",
    "free_on_a_carriage",
    "quarter_car",
    "half_car",
    *judged_models.WITH_MEMORY,
)


@pytest.mark.long
@pytest.mark.filterwarnings("ignore:nothing connects")
@pytest.mark.parametrize("name", judged_models.marked(MOVING, QUICK))
def test_motions_over_a_second(name, rng):
    """Runge-Kutta steps of 0.2 ms there; from a random speed, all supports moving at once."""
    model = judged_models.MODELS[name]()
    motion = dict.fromkeys(model.layout.supports, MOTION)
    initial = jb.State(model.reference.q, rng.normal(size=model.layout.nv), model.reference.z)
    found = jb.simulate(model, TIMES, motion=motion, initial=initial, rtol=1e-10)
    with in_mujoco.Judge(model, swinging=motion) as judge:
        judge.put(initial)
        expected, states = judge.path(TIMES)
    for body, (p, R) in expected.items():
        np.testing.assert_allclose(found.poses[body].p, p, atol=1e-6)
        np.testing.assert_allclose(found.poses[body].R, R, atol=1e-6)
    # of hysteresis with kinks where the speed changes its sign
    states = in_order_of_z(model, judge, states)
    np.testing.assert_allclose(
        found.state.z, states, rtol=0, atol=1e-6 * np.abs(states).max(initial=1.0)
    )
