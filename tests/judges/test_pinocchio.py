"""Pinocchio on the same models: accelerations, reactions and mass matrices of trees on moving
supports, and rests of closed loops."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

pin = pytest.importorskip("pinocchio", reason="needs Pinocchio: pip install 'jaxbody[judges]'")

import closed_loops  # noqa: E402
import elementary_joints as joints  # noqa: E402
import in_pinocchio  # noqa: E402
import judged_models  # noqa: E402

import jaxbody as jb  # noqa: E402
from jaxbody.mechanics.closed_loops import dynamics_of  # noqa: E402

SAMPLES = 4
QUICK = ("tree_with_bushings", "robot_arm")  # the others are long tests: seconds of compiling each
EXACT = 1e-10  # rounding of a dozen bodies' sums and of a solve with a condition of 1e4


def shaking(model, rng):
    """Each support moved in all six directions, phases apart."""
    return {
        name: jb.Harmonic(
            frequency=rng.uniform(0.2, 1.0, 6),
            translation=0.2 * rng.normal(size=3),
            rotation=0.3 * rng.normal(size=3),
            translation_phase=rng.uniform(0, 6, 3),
            rotation_phase=rng.uniform(0, 6, 3),
        )
        for name in model.layout.supports
    }


def random_states(model, rng):
    """Displaced from the reference by up to half a turn."""
    q = [
        jb.joints.retract(model, model.reference.q, 0.4 * rng.normal(size=model.layout.nv))
        for _ in range(SAMPLES)
    ]
    return jb.State(jnp.stack(q), jnp.array(rng.normal(size=(SAMPLES, model.layout.nv))))


@jb.jit  # compiling is the cost
def by_jaxbody(model, motions, times, states):
    dynamics = dynamics_of(model, motions)

    def one(t, state):
        v_dot = dynamics.acceleration(t, state.q, state.v)
        return (v_dot, *dynamics.reactions(t, state.q, state.v))

    return jax.vmap(one)(times, states)


def close(result, expected, tolerance=EXACT):
    assert np.shape(result) == np.shape(expected)
    np.testing.assert_allclose(
        result, expected, rtol=0, atol=tolerance * np.abs(expected).max(initial=1e-300)
    )


@pytest.mark.parametrize("name", judged_models.marked(judged_models.TREES, QUICK))
def test_accelerations_and_reactions_of_trees_on_moving_supports(name, rng):
    model = judged_models.MODELS[name]()
    motions, states, times = (
        shaking(model, rng),
        random_states(model, rng),
        rng.uniform(0, 3, SAMPLES),
    )
    found = by_jaxbody(model, tuple(motions.values()), jnp.array(times), states)
    judge = in_pinocchio.Judge(model)
    for i, t in enumerate(times):
        judge.put(
            jb.State(states.q[i], states.v[i]),
            {name: joints.imposed(motion, t) for name, motion in motions.items()},
        )
        for result, expected in zip(found, judge.accelerations(), strict=True):
            close(np.asarray(result[i]), expected)


@pytest.mark.parametrize("name", judged_models.marked(judged_models.CLOSED, QUICK))
def test_rests_reactions_and_frequencies_of_closed_loops(name):
    """The state of rest closes the loops there and is balanced by forces of the closures, which are
    those that jaxbody reports."""
    model = judged_models.MODELS[name]()
    eq = jb.equilibrium(model)
    assert eq.ok and eq.redundant == ()
    judge = in_pinocchio.Judge(model).put(eq.state)
    c, _ = closed_loops.rows_of(judge)
    np.testing.assert_allclose(c, 0, atol=1e-10)
    forces, left = closed_loops.multipliers(judge)
    size = np.abs(judge.equations()[1]).max()
    np.testing.assert_allclose(left, 0, atol=1e-9 * size)
    for closure, expected in by_closure(model, forces).items():
        assert magnitudes(eq.closure_reactions[closure]) == pytest.approx(
            expected, rel=1e-8, abs=1e-8 * size
        )
    h = judge.equations()[1]
    needed = (judge.turn.T @ (h + closed_loops.rows_of(judge)[1].T @ forces))[judge.support_rows]
    close(np.concatenate([np.ravel(x) for x in eq.reactions.values()]), -needed, 1e-9)
    found = jb.modes(jb.linearize(model, eq)).frequency
    np.testing.assert_allclose(found, closed_loops.frequencies(judge), rtol=1e-8)


def by_closure(model, forces):
    """{closure: the sizes of its force and moment}; how the components across an axis are directed
    is a choice of each program."""
    found, i = {}, 0
    for name in model.closure_names:
        turns = np.array([row.startswith("turn") for row in model[name].rows])
        mine = forces[i : i + len(turns)]
        found[name], i = [np.linalg.norm(mine[~turns]), np.linalg.norm(mine[turns])], i + len(turns)
    return found


def magnitudes(reaction):
    turns = [float(x) for row, x in reaction.items() if row.startswith("turn")]
    return [
        np.linalg.norm([float(x) for row, x in reaction.items() if not row.startswith("turn")]),
        np.linalg.norm(turns),
    ]


DAMPED = (
    "plate_on_five_springs",
    "chain_of_balls",
    "tree_with_bushings",
    "rolling_car",
    "plate_with_inerters",
    "free_on_a_carriage",
)


@pytest.mark.parametrize("name", judged_models.marked(DAMPED, ()))
def test_poles_of_damped_trees(name):
    model = judged_models.MODELS[name]()
    eq = jb.equilibrium(model)
    assert eq.ok
    judge = in_pinocchio.Judge(model).put(eq.state)
    np.testing.assert_allclose(judge.equations()[1][judge.rows], 0, atol=1e-9)
    found = np.sort_complex(np.ravel(jb.complex_modes(jb.linearize(model, eq)).poles))
    np.testing.assert_allclose(
        found, np.sort_complex(closed_loops.poles(judge)), rtol=0, atol=1e-8 * np.abs(found).max()
    )
