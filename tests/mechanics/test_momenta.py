"""Hamilton's equations against derivatives of H; a Gauss step is symplectic and conserves momenta,
and energy in chaotic motion."""

from functools import partial

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
from jax.flatten_util import ravel_pytree
from test_collocations import STEPS, has_no_trend

import jaxbody as jb
from jaxbody.geometry import rotations
from jaxbody.mechanics.closed_loops import dynamics_of
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.motion.canonical_equations import Canonical


def chain():
    """A heavy top on a ball and an arm on its hinge, nothing symmetric, held by a spring."""
    return jb.Model(
        bodies={
            "top": jb.Body(mass=1.2, inertia=[0.05, 0.06, 0.04], com=[0.1, 0.02, 0.3]),
            "arm": jb.Body(
                mass=0.6,
                inertia=[0.02, 0.03, 0.025],
                com=[0.15, 0.05, 0.1],
                position=[0.1, 0.0, 0.5],
            ),
        },
        joints={"top": jb.Ball("world"), "arm": jb.Hinge("top", axis=[1, 0.3, 0])},
        elements={
            "s": jb.Spring(
                ("arm", [0.2, 0, 0.1]), ("world", [0.3, 0.2, 1.5]), stiffness=60.0, free_length=0.3
            )
        },
        gravity=[0, 0, -9.81],
    )


MODELS = {"plate": rigs.plate, "chain": chain}
SPEEDS = {"plate": [0.5, -0.2, 0.3, 1.0, 2.0, -0.7], "chain": [1.5, -0.6, 0.8, 2.0]}


def model_and_state(name):
    model = MODELS[name]()
    return model, jb.State(model.reference.q, jnp.array(SPEEDS[name]))


def form_of(model, motions=None, loads=()):
    return Canonical(
        dynamics_of(
            model, motions or tuple(jb.inputs.AtRest() for _ in model.layout.supports), loads
        )
    )


def quaternion_at(name):
    return slice(3, 7) if name == "plate" else slice(0, 4)


@pytest.mark.parametrize("name", MODELS)
def test_hamiltons_equations(name):
    """Of H = 1/2 P M(q)^-1 P + V(q), for quaternions of any length: P = p for a number, im(p q*)/2
    for a quaternion; dH/dp and -dH/dq."""
    model, state = model_and_state(name)
    quaternion = quaternion_at(name)

    def H(q, p):
        w, x = q[quaternion][0], q[quaternion][1:]
        turning = (
            w * p[quaternion][1:] - p[quaternion][0] * x - jnp.cross(p[quaternion][1:], x)
        ) / 2
        P = jnp.concatenate([p[: quaternion.start], turning, p[quaternion.stop :]])
        q = q.at[quaternion].divide(jnp.sqrt(q[quaternion] @ q[quaternion]))
        M = jax.hessian(lambda v: jb.kinetic_energy(model, jb.State(q, v)))(state.v)
        return P @ jnp.linalg.solve(M, P) / 2 + jb.potential_energy(model, jb.State(q, state.v))

    rng = np.random.default_rng(1)
    q = state.q + jnp.asarray(0.3 * rng.standard_normal(len(state.q)))
    p = jnp.asarray(rng.standard_normal(len(q)))
    of_q, of_p = jax.jit(jax.grad(H, (0, 1)))(q, p)
    result = eqx.filter_jit(form_of(model).rate)(jnp.array(0.0), jnp.concatenate([q, p]))
    assert rigs.max_difference(result, jnp.concatenate([of_p, -of_q])) < 1e-12 * np.abs(of_q).max()


@pytest.mark.long
def test_momenta_move_as_velocities_do():
    """With dampers, a load and a support in motion: the rate of the state by its momenta is that of
    the equations of motion."""
    model, t = rigs.rig(), jnp.array(0.3)
    load = jb.Force(("box", [0.1, 0.2, 0.0]), force=[1.0, 2.0, -1.0], axes="body")
    dynamics = dynamics_of(model, (jb.Harmonic(**rigs.SHAKING),), (load,))
    state = jb.State(model.reference.q, jnp.array([0.5, 0.2, -0.3, 1.0, 2.0, -0.7, 0.4]))
    form = Canonical(dynamics)

    @eqx.filter_jit
    def both(form, state):
        y = form.pack(state, t)
        again = form.unpack(y, t)
        _, moved = jax.jvp(form.unpack, (y, t), (form.rate(t, y), jnp.ones_like(t)))
        rate = form.dynamics.coordinates.rate(state.q, state.v)
        return again, moved, jb.State(rate, form.dynamics.acceleration(t, state.q, state.v))

    again, result, expected = both(form, state)
    assert rigs.max_difference(again.q, state.q) < 1e-15
    assert rigs.max_difference(again.v, state.v) < 1e-14
    assert rigs.max_difference(result.q, expected.q) < 1e-14
    assert rigs.max_difference(result.v, expected.v) < 1e-12 * np.abs(expected.v).max()


def stepped(model, start, h, stages=3, steps=1, samples=None, **options):
    options = dict(
        solver=jb.Gauss(stages=stages),
        stepsize_controller=STEPS,
        dt0=h,
        adjoint=diffrax.ForwardMode(),
        **options,
    )
    return jb.simulate(model, np.linspace(0, steps * h, samples or 2), initial=start, **options)


def chart(name, around):
    """(Delta, p) <-> state near a pose: p = dL/dDelta' in the rotation vector of the chart, by
    derivatives of its velocities."""
    model, _ = model_and_state(name)
    coordinates, quaternion = Coordinates(model), quaternion_at(name)

    def state(delta, rate):
        q, q_dot = jax.jvp(partial(coordinates.retract, around), (delta,), (rate,))
        w = (
            2
            * rotations.multiply(q_dot[quaternion], q[quaternion] * jnp.array([1, -1, -1, -1]))[1:]
        )
        return jb.State(
            q, jnp.concatenate([q_dot[: quaternion.start], w, q_dot[quaternion.stop :]])
        )

    def momenta(delta, rate):
        return jax.grad(lambda rate: jb.kinetic_energy(model, state(delta, rate)))(rate)

    def from_canonical(x):
        delta, p = jnp.split(x, 2)
        return state(delta, jnp.linalg.solve(jax.jacfwd(partial(momenta, delta))(delta), p))

    def to_canonical(result):
        turn = rotations.log_quaternion(
            rotations.multiply(
                result.q[quaternion], around[quaternion] * jnp.array([1, -1, -1, -1])
            )
        )
        delta = jnp.concatenate(
            [(result.q - around)[: quaternion.start], turn, (result.q - around)[quaternion.stop :]]
        )
        per_rate = jax.jacfwd(lambda rate: state(delta, rate).v)(delta)
        return jnp.concatenate([delta, momenta(delta, jnp.linalg.solve(per_rate, result.v))])

    return jax.jit(from_canonical), jax.jit(to_canonical)


def jacobian(function, x):
    """Of a function of arrays or states."""
    flat, back = ravel_pytree(x)
    return np.asarray(jax.jit(jax.jacfwd(lambda x: ravel_pytree(function(back(x)))[0]))(flat))


@pytest.mark.long
@pytest.mark.parametrize("name", MODELS)
def test_a_step_is_symplectic(name):
    """S' J S = J for the Jacobian S of a long step in rotation vectors and their momenta."""
    model, start = model_and_state(name)
    h, n = 0.05, model.layout.nv
    around = stepped(model, start, h).state.q[-1]
    J = np.block([[np.zeros((n, n)), np.eye(n)], [-np.eye(n), np.zeros((n, n))]])

    def step(state):
        end = stepped(model, state, h).state
        return jb.State(end.q[-1], end.v[-1])

    S, x = np.eye(2 * n), chart(name, start.q)[1](start)
    # one by one, which compile fast
    for part in (chart(name, start.q)[0], step, chart(name, around)[1]):
        S, x = jacobian(part, x) @ S, part(x)
    assert rigs.max_difference(S, np.eye(2 * n)) > 0.1
    assert rigs.max_difference(S.T @ J @ S, J) < 1e-10


def pair():
    """Two bodies that turn and are tied to each other only, by two springs; their momentum and
    moment of momentum about the origin of the world."""
    return jb.Model(
        bodies={
            "a": jb.Body(mass=2.0, inertia=[0.1, 0.16, 0.2], com=[0.05, -0.02, 0.03]),
            "b": jb.Body(
                mass=0.8,
                inertia=[0.02, 0.05, 0.06],
                com=[0.1, 0.02, -0.03],
                position=[0.8, 0.2, -0.1],
            ),
        },
        elements={
            "s": jb.Spring(
                ("a", [0.2, 0.1, 0]), ("b", [-0.2, 0, 0.1]), stiffness=40.0, free_length=0.3
            ),
            "t": jb.Spring(
                ("a", [0.2, -0.1, 0.1]), ("b", [-0.1, 0.1, -0.1]), stiffness=60.0, free_length=0.4
            ),
        },
    )


def momenta_of(model, state):
    """sum m v_C and sum C x m v_C + R J R' w, by NumPy."""
    total = np.zeros(6)
    for body, q, v in zip(
        ("a", "b"),
        np.asarray(state.q).reshape(-1, 7),
        np.asarray(state.v).reshape(-1, 6),
        strict=True,
    ):
        R = rigs.turned(q[3:])
        c = R @ np.asarray(model[body].com)
        P = float(model[body].mass) * (v[:3] + np.cross(v[3:], c))
        total += np.concatenate(
            [P, np.cross(q[:3] + c, P) + R @ np.asarray(model[body].inertia) @ R.T @ v[3:]]
        )
    return total


@pytest.mark.long
def test_momentum_and_angular_momentum_are_conserved():
    model = pair()
    start = jb.State(
        model.reference.q,
        jnp.array([0.5, -0.2, 0.3, 1.0, 2.0, -0.7, -0.4, 0.3, 0.1, -2.0, 1.5, 3.0]),
    )
    with pytest.warns(jb.JaxbodyWarning, match="UNATTACHED"):
        result = stepped(model, start, 0.05, stages=2, steps=200)
    end = jb.State(result.state.q[-1], result.state.v[-1])
    assert rigs.max_difference(end.q, start.q) > 1.0
    # of a method, not of rounding
    assert abs(result.energies["total"][-1] / result.energies["total"][0] - 1) > 1e-7
    assert rigs.max_difference(momenta_of(model, end), momenta_of(model, start)) < 1e-12


@pytest.mark.long
def test_the_momenta_of_a_heavy_top_are_conserved():
    """About the vertical and about its own axis of symmetry, over ten thousand steps."""
    top = jb.Model(
        bodies={"top": jb.Body(mass=1.0, inertia=[0.05, 0.05, 0.02], com=[0, 0, 0.3])},
        joints={"top": jb.Ball("world")},
        gravity=[0, 0, -9.81],
    )
    start = jb.State(jnp.array([np.cos(0.3), np.sin(0.3), 0, 0]), jnp.array([0.5, -3.0, 20.0]))
    result = stepped(top, start, 0.02, steps=10_000, samples=201, max_steps=10_100)
    R = rigs.turned(result.state.q)
    J = np.diag([0.05 + 0.09, 0.05 + 0.09, 0.02])
    H = np.einsum("tij,jk,tlk,tl->ti", R, J, R, result.state.v)
    assert np.ptp(R[:, 2, 2]) > 0.1
    assert np.ptp(H[:, 2]) < 1e-11
    assert np.ptp(np.einsum("ti,ti->t", H, R[:, :, 2])) < 1e-11
    error = result.energies["total"] / result.energies["total"][0] - 1
    assert np.abs(error).max() < 1e-6


@pytest.mark.long
@pytest.mark.parametrize("stages", [1, 2, 3])
def test_order_with_dampers_loads_and_a_moving_base(stages):
    """A rig with dampers and a mount on a base that moves, turning fast: order two for each stage,
    by Dopri8."""
    model, motion = rigs.rig(mount=rigs.MOUNT), {"base": jb.Harmonic(**rigs.SHAKING)}
    start = jb.State(model.reference.q, jnp.array([0.5, 0.2, -0.3, 1.0, 2.0, -0.7, 0.4]))
    times = np.linspace(0, 0.5, 3)
    exact = jb.simulate(model, times, motion=motion, initial=start, rtol=1e-12)
    options = dict(
        solver=jb.Gauss(stages=stages), stepsize_controller=STEPS, adjoint=diffrax.ForwardMode()
    )
    result = [
        jb.simulate(model, times, motion=motion, initial=start, dt0=h, **options)
        for h in (0.0125, 0.00625)
    ]
    errors = [
        rigs.max_difference(
            np.concatenate([f.state.q, f.state.v], 1),
            np.concatenate([exact.state.q, exact.state.v], 1),
        )
        for f in result
    ]
    print("order of", stages, "stages:", np.log2(errors[0] / errors[1]), "errors", errors)
    assert abs(np.log2(errors[0] / errors[1]) - 2 * stages) < 0.3


@pytest.mark.long
@pytest.mark.parametrize("mode", ["forward", "reverse"])
def test_derivatives_of_a_top(mode):
    """The derivatives of its position after 0.4 s with respect to stiffness and mass, against
    differences of the same steps."""
    top = jb.Model(
        bodies={"top": jb.Body(mass=1.2, inertia=[0.05, 0.06, 0.04], com=[0.1, 0.02, 0.3])},
        joints={"top": jb.Ball("world")},
        elements={
            "s": jb.Spring(
                ("top", [0.2, 0, 0.5]), ("world", [0.3, 0.2, 1.5]), stiffness=60.0, free_length=0.3
            )
        },
        gravity=[0, 0, -9.81],
    )
    start = jb.State(top.reference.q, jnp.array([1.5, -0.6, 0.8]))
    adjoint = diffrax.ForwardMode() if mode == "forward" else diffrax.DirectAdjoint()
    options = dict(solver=jb.Gauss(stages=2), stepsize_controller=STEPS, dt0=0.02, max_steps=32)

    def end(x, adjoint=adjoint):
        changed = jb.replace(top, {"s.stiffness": x[0], "top.mass": x[1]})
        result = jb.simulate(
            changed, np.array([0, 0.2, 0.4]), initial=start, adjoint=adjoint, **options
        )
        return jnp.sum(jnp.sin(3 * result.state.q[-1]))

    x, forward = jnp.array([60.0, 1.2]), diffrax.ForwardMode()
    result = (jax.jacfwd if mode == "forward" else jax.jacrev)(end)(x)
    steps = 1e-4 * np.diag(x)
    differences = [(end(x + d, forward) - end(x - d, forward)) / (2 * d.sum()) for d in steps]
    # of differences: squares of 1e-4
    assert rigs.max_difference(result / np.array(differences), np.ones(2)) < 1e-6


def tumbling(model, start, period, steps, periods):
    """The motion, and the change of its energy relative to the largest kinetic energy."""
    h, steps = period / steps, periods * steps
    result = stepped(model, start, h, steps=steps, samples=1001, max_steps=steps + 100)
    assert result.ok
    energy = np.asarray(result.energies["total"])
    error = (energy - energy[0]) / np.max(result.energies["kinetic"])
    first, last = error[:100], error[-100:]
    print(
        "energy: most",
        np.abs(error).max(),
        "first tenth",
        first.mean(),
        first.std(),
        "last tenth",
        last.mean(),
        last.std(),
    )
    return result, error


@pytest.mark.long
def test_energy_of_a_tumbling_plate_has_no_trend_over_a_hundred_thousand_periods():
    """It turns over and over, springs at a third to twice their length, 40 steps in the fastest
    period; with velocities in place of momenta the same stages wander by 3e-8, and their trend
    is 4e-8."""
    model = rigs.plate()
    eq = jb.equilibrium(model)
    period = 1 / float(jb.modes(jb.linearize(model, eq)).frequency[-1])
    start = jb.State(
        jb.joints.retract(model, eq.state.q, jnp.array([0.05, -0.04, 0.05, 1.0, -0.8, 1.2])),
        jnp.zeros(6),
    )
    result, error = tumbling(model, start, period, 40, 100_000)
    assert result.poses["plate"].R[:, 2, 2].min() < -0.5
    assert np.abs(error).max() < 1e-8
    assert abs(error[-100:].mean() - error[:100].mean()) < error.std()
    assert has_no_trend(error)


@pytest.mark.long
def test_energy_of_a_chain_has_no_trend():
    """The top swings on its ball and the arm by two radians and more on its hinge, 5000
    times 0.5 s."""
    model, start = model_and_state("chain")
    result, error = tumbling(model, start, 0.5, 30, 5000)
    assert np.ptp(result.state.q[:, 4]) > 2
    assert np.abs(error).max() < 1e-7
    assert abs(error[-100:].mean() - error[:100].mean()) < error.std()
    assert has_no_trend(error)
