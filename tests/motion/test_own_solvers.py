"""The equations of motion in a user's own diffeqsolve, beside `simulate`."""

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
import rigs

import jaxbody as jb
from jaxbody.model.joints.frame_tables import gaps_at
from jaxbody.model.joints.kinematics import Coordinates

MOTION = {"base": jb.Harmonic(frequency=0.8, translation=[0.01, 0, 0], rotation=[0, 0, 0.02])}
TIMES = jnp.linspace(0.0, 2.0, 21)
PLATE = rigs.plate(damping=1.0)


def solved(f, state, args, solver=None, rtol=1e-10, **options):
    options = {"saveat": diffrax.SaveAt(ts=TIMES)} | options
    steps = diffrax.PIDController(rtol=rtol, atol=rtol / 100)
    return diffrax.diffeqsolve(
        f if isinstance(f, diffrax.ODETerm) else diffrax.ODETerm(f),
        solver or diffrax.Tsit5(),
        TIMES[0],
        TIMES[-1],
        0.01,
        state,
        args=args,
        stepsize_controller=steps,
        max_steps=100_000,
        **options,
    )


def assert_same(states, trajectory, limit):
    for name in ("q", "v", "z"):
        found, expected = getattr(states, name), getattr(trajectory.state, name)
        np.testing.assert_allclose(
            found,
            expected,
            rtol=0,
            atol=limit * max(1.0, float(jnp.abs(expected).max(initial=0.0))),
        )


@pytest.mark.parametrize(
    "solver", [diffrax.Tsit5(), pytest.param(diffrax.Kvaerno5(), marks=pytest.mark.long)]
)
def test_a_plate_moves_as_by_simulate(solver):
    """Errors of a motion are some hundred times the tolerance of a step."""
    start = jb.equilibrium(PLATE).state
    f = jb.equations_of_motion(PLATE, motion=MOTION)
    states = jb.jit(lambda model: solved(f, start, model, solver).ys)(PLATE)
    done = jb.simulate(PLATE, TIMES, motion=MOTION, initial=start, rtol=1e-11)
    assert_same(states, done, 1e-8)
    again = f.trajectory(TIMES, states, PLATE)
    assert again.ok and set(again.forces) == set(done.forces)
    for name, force in done.forces.items():
        np.testing.assert_allclose(again.forces[name], force, rtol=0, atol=1e-7)
    np.testing.assert_allclose(np.linalg.norm(again.state.q[:, 3:], axis=1), 1.0, rtol=1e-14)


def test_an_event_ends_a_motion_at_a_threshold():
    f = jb.equations_of_motion(PLATE, motion=MOTION)
    event = diffrax.Event(lambda t, y, args, **_: y.q[0] - 0.005, optimistix.Newton(1e-10, 1e-10))
    start = jb.equilibrium(PLATE).state
    done = jb.jit(
        lambda model: solved(f, start, model, event=event, saveat=diffrax.SaveAt(t1=True))
    )(PLATE)
    assert done.result == diffrax.RESULTS.event_occurred
    ends = np.array([0.0, float(done.ts[0])])
    at_end = jb.simulate(PLATE, ends, motion=MOTION, initial=start, rtol=1e-11).state.q[-1]
    np.testing.assert_allclose(at_end[0], 0.005, rtol=0, atol=1e-10)


@pytest.mark.long
def test_derivatives_by_the_adjoint_of_the_user():
    """BacksolveAdjoint takes the numbers to differentiate by, as models hold empty tuples, which
    diffrax 0.7 does not take there."""
    start, motion = jb.equilibrium(PLATE).state, MOTION
    f = jb.equations_of_motion(PLATE, motion=motion)
    term = diffrax.ODETerm(lambda t, y, numbers: f(t, y, jb.replace(PLATE, numbers)))

    def end(k, adjoint):
        return jnp.sum(solved(term, start, {"s0.stiffness": k}, adjoint=adjoint).ys.q[-1, :3])

    def by_simulate(k):
        model = jb.replace(PLATE, {"s0.stiffness": k})
        return jnp.sum(
            jb.simulate(model, TIMES, motion=motion, initial=start, rtol=1e-11).state.q[-1, :3]
        )

    k = PLATE["s0"].stiffness
    expected = jb.jit(jax.grad(by_simulate))(k)
    for adjoint in (diffrax.RecursiveCheckpointAdjoint(), diffrax.BacksolveAdjoint()):
        np.testing.assert_allclose(
            jb.jit(jax.grad(lambda k, a=adjoint: end(k, a)))(k), expected, rtol=1e-6
        )


@pytest.mark.long
@pytest.mark.parametrize("kind", ["joints with memory", "closures"])
def test_memory_and_closures_move_as_by_simulate(kind):
    """Closures drift by the errors of the solver: simulate projects its steps onto them."""
    if kind == "closures":
        model, limit = rigs.slider_crank({}), 1e-6
        initial = jb.State(
            model.reference.q,
            jnp.array([3.0]) @ np.asarray(jb.linearize(model, model.reference).dependent.N).T,
        )
    else:
        law = jb.laws.Linear(400.0) + jb.laws.Maxwell(stiffness=300.0, relaxation_time=0.3)
        model = jb.Model(
            bodies={"arm": jb.Body(2.0, [0.1, 0.1, 0.1], com=[0.4, 0, 0])},
            supports={"base": jb.Support()},
            gravity=[0, 0, -9.81],
            joints={"arm": jb.Hinge("base", axis=[0, 1, 0])},
            elements={
                "strut": jb.SpringDamper(
                    ("arm", [0.5, 0, 0]), ("base", [0.5, 0, 0.6]), spring=law, free_length=0.5
                )
            },
        )
        initial, limit = model.reference, 1e-8
    motion = {
        name: jb.Harmonic(frequency=0.8, translation=[0, 0, 0.02]) for name in model.layout.supports
    }
    f = jb.equations_of_motion(model, motion=motion)
    states = jb.jit(lambda model: solved(f, initial, model).ys)(model)
    done = jb.simulate(model, TIMES, motion=motion, initial=initial, rtol=1e-11)
    assert_same(states, done, limit)
    if model.closures:
        assert float(jnp.abs(gaps_at(Coordinates(model), states.q[-1])).max()) < limit


def test_what_is_wrong_is_named():
    with pytest.raises(jb.JaxbodyError, match=r"'ground'.*UNKNOWN_NAME"):
        jb.equations_of_motion(PLATE, motion={"ground": MOTION["base"]})
