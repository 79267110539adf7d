"""The definition of a model: its energies T and V, its dissipation R, L = T - V, and what follows
by jax.hessian, jax.grad and jax.jvp.

All are functions of small motions about a state: the coordinates become q (+) Delta, the supports
move by Xi from their reference poses, and the velocities of all frames are the derivatives of their
poses along Delta' and Xi'. Delta = 0 with Delta' = v is the state itself.

    M | -M~ | M_bb    Hessian of T in (Delta', y', Xi')
    C | -C~ | C_bb    Hessian of R in (Delta', y', Xi')
    K | -K~ | K_bb    Hessian of V + lambda c in (Delta, y, Xi)
    motion            d/dt dL/dDelta' - dL/dDelta + dR/dDelta' = Q + H - J' lambda,   c'' = 0,
                      z' = f(frames, z)

y are the coordinates of elements with memory; | separates the blocks 11, 12 and 22. Q and H are the
generalized forces of loads and force elements and of hysteresis, which have no potential, from
their virtual power. M, C and K lose the derivatives of Q, and have a row z' - f for each state of a
force element; C and K contain the tangents of hysteresis. c are the conditions of closures, J =
dc/dDelta, lambda their multipliers, z the states of elements. Faster, structured forms of the same
equations are in `mechanics`; tests compare them with this file.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, shaped
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems
from jaxbody.geometry.frames import Frame, Instant
from jaxbody.geometry.vectors import axial, dot, rotate, rotate_back
from jaxbody.model.element_states import apart, holding, with_commands
from jaxbody.model.inputs.loads import Load
from jaxbody.model.joints.frame_tables import (
    Acting,
    completed,
    each_element,
    exerted,
    force_rates,
    gaps_displaced,
    inertial_tables,
    of_table,
    power,
    rank,
    reads_accelerations,
    state_rates,
)
from jaxbody.model.joints.kinematics import Coordinates, displacements, frames_displaced, imposed
from jaxbody.model.laws.law_states import InState, memories
from jaxbody.model.models import Model, refuse_batch
from jaxbody.model.preconditions import check_state
from jaxbody.model.states import State
from jaxbody.numerics.small_systems import saddle_point

# T, V and R as functions of the frames; the laws with memory of the model contain their states z


def kinetic(model: Model, frames: Frame) -> Float[Array, ""]:
    """Return T [J], the sum of 1/2 m v_C^2 + 1/2 w' J_C w over the bodies and of the kinetic
    energies of elements with inertia. Source: (10), (11) of the paper."""
    bodies, moving = model.bodies.rows, frames[model.layout.first_body :]
    v_C = moving.velocity(bodies.com)
    w_B = rotate_back(moving.R, moving.w)
    T = 0.5 * jnp.sum(bodies.mass * dot(v_C, v_C) + dot(w_B, rotate(bodies.inertia, w_B)))
    inertial = (
        of_table(model, frames, table, lambda s, *F: s.kinetic_energy(*s.rates(*F)))
        for table in inertial_tables(model)
    )
    inner = (
        jax.vmap(lambda law: law.kinetic())(law)
        for law in memories(model.elements, InState)
        if law.law.inertial
    )
    return sum(map(jnp.sum, (*inertial, *inner)), T)


def gravity_energy(model: Model, frames: Frame) -> Float[Array, ""]:
    """Return the potential energy of the weights [J], the sum of -m g . C over the bodies, with C
    the center of mass."""
    bodies = model.bodies.rows
    return -jnp.sum(
        bodies.mass * dot(frames[model.layout.first_body :].point(bodies.com), model.gravity[None])
    )


def potential(model: Model, frames: Frame) -> Float[Array, ""]:
    """Return V [J], the sum of V(e) over the elements minus the sum of m g . C over the bodies.
    Source: (22), (60) of the paper."""
    return gravity_energy(model, frames) + sum(
        jnp.sum(e) for e in each_element(model, frames, lambda s, *F: s.potential(*F))
    )


def rayleigh(model: Model, frames: Frame) -> Float[Array, ""]:
    """Return the dissipation function R [W], the sum of R(e, e') over the elements."""
    return sum(
        (
            jnp.sum(e)
            for e in each_element(model, frames, lambda s, *F: s.dissipation(*s.rates(*F)))
        ),
        jnp.zeros((), frames.p.dtype),
    )


# T, V, R, L, c, Q and H as functions of small motions about a state


def frames_at(
    model: Model, state: State, delta: Array, delta_dot: Array, xi: Array, xi_dot: Array
) -> Frame:
    """Return the frames at q (+) Delta on supports displaced by Xi, with the velocities due to
    Delta' and Xi': v = p', [w] = R' R^T."""
    pose, rate = jax.jvp(
        lambda delta, xi: frames_displaced(model, state, delta, xi).pose(),
        (delta, xi),
        (delta_dot, xi_dot),
    )
    return Frame(pose.p, pose.R, rate.p, jax.vmap(axial)(rate.R @ jnp.swapaxes(pose.R, -1, -2)))


def T(model: Model, state: State, *small: Array) -> Float[Array, ""]:
    """Return the kinetic energy T [J] for `small` = (Delta, Delta', Xi, Xi')."""
    return kinetic(holding(model, state.z), frames_at(model, state, *small))


def V(model: Model, state: State, *small: Array) -> Float[Array, ""]:
    """Return the potential energy V [J] for `small` = (Delta, Delta', Xi, Xi'), of which the rates
    have no effect."""
    return potential(holding(model, state.z), frames_at(model, state, *small))


def R(model: Model, state: State, z_dot: Array, *small: Array) -> Float[Array, ""]:
    """Return the dissipation function R [W] for the rates z' of the element states and `small` =
    (Delta, Delta', Xi, Xi')."""
    return rayleigh(apart(model, state.z, z_dot), frames_at(model, state, *small))


def L(model: Model, state: State, *small: Array) -> Float[Array, ""]:
    """Return L = T - V [J] for `small` = (Delta, Delta', Xi, Xi'). Source: (12) of the paper."""
    return T(model, state, *small) - V(model, state, *small)


def c(model: Model, state: State, delta: Array, xi: Array) -> Float[Array, "nc"]:
    """Return the conditions c of all closures at q (+) Delta on supports displaced by Xi [m]."""
    coordinates = Coordinates(model)
    return gaps_displaced(coordinates, coordinates.retract(state.q, delta), xi)


def Q(
    model: Model, state: State, loads: tuple[Load, ...], t: Any, *small: Array
) -> Float[Array, "nv"]:
    """Return the generalized forces of loads and force elements from their virtual power P(v*) =
    Q . v*, v* a virtual Delta': P = sum of F . v* + M . w*."""
    now = instant(model, state, t, small, None)
    return _of_wrenches(model, state, exerted(holding(model, state.z), now, loads), *small)[0]


def _of_wrenches(
    model: Model, state: State, acting: Acting, *small: Array
) -> tuple[Float[Array, "nv"], Float[Array, "ns 6"]]:
    """Return the generalized forces on Delta, and those on Xi, of wrenches on frames."""

    return _by_virtual_power(lambda moved: power(model, acting, moved), model, state, *small)


def H(model: Model, state: State, z_dot: Array, *small: Array) -> Float[Array, "nv"]:
    """Return the generalized forces of elements with hysteresis that follow from neither V nor R,
    from their virtual power P = -sum of (F - dV/de - dR/de') . e*."""
    now, pairs = (
        frames_at(model, state, *small),
        zip(holding(model, state.z).elements, apart(model, state.z, z_dot).elements, strict=True),
    )
    tables = [
        replace(a, rows=(a.rows, b.rows))
        for a, b in pairs
        if any(not law.law.has_rows for law in memories(a, InState))
    ]

    def power(moved):
        return -sum(
            (
                jnp.sum(
                    of_table(model, now, table, _without_potential)
                    * of_table(model, moved, table, lambda s, *F: s[0].rates(*F)[1])
                )
                for table in tables
            ),
            jnp.zeros((), state.q.dtype),
        )

    return _by_virtual_power(power, model, state, *small)[0]


def _by_virtual_power(
    power: Callable[[Frame], Array], model: Model, state: State, delta, _, xi, xi_dot
) -> tuple[Float[Array, "nv"], Float[Array, "ns 6"]]:
    """Return dP/d(v*, Xi'*) of a virtual power P, a function of the frames that move at the virtual
    velocities."""
    return jax.grad(lambda v, xi_dot: power(frames_at(model, state, delta, v, xi, xi_dot)), (0, 1))(
        jnp.zeros_like(state.v), jnp.zeros_like(xi_dot)
    )


def _without_potential(element: Any, *frames: Frame) -> Array:
    """Return F - dV/de - dR/de', the part of the force of an element that follows from neither V
    nor R. `element`: the pair (element with variable states, the same element with given rates of
    its states)."""
    moving, known = element
    e, e_dot = moving.rates(*frames)
    return (
        moving.force(*frames)
        - jax.grad(moving.energy)(e)
        - jax.grad(known.dissipation, 1)(e, e_dot)
    )


def _z_dot(model: Model, state: State, *small: Array) -> Array:
    """Return the rates z' of the element states at rest."""
    if not model.layout.nz:
        return state.z
    now = instant(model, state, jnp.zeros((), state.q.dtype), small, None)
    return state_rates(holding(model, state.z), now)


def instant(model: Model, state: State, t: Any, small: Any, along: Any) -> Instant:
    """Return the frames for `small` = (Delta, Delta', Xi, Xi') at the time t; if force elements
    read accelerations, with those for the rates `along` of `small`, by default at rest."""
    frames = frames_at(model, state, *small)
    if not reads_accelerations(model):
        return frames.at_time(t, state)
    along = jax.tree.map(jnp.zeros_like, small) if along is None else along
    _, changes = jax.jvp(lambda *small: frames_at(model, state, *small), tuple(small), tuple(along))
    return replace(frames.at_time(t, state), a=changes.v, alpha=changes.w)


def force_matrices(
    model: Model, state: State, loads: tuple[Load, ...]
) -> tuple[Array, Array, Array]:
    """Return the parts of M, C and K of (Delta, y, Xi) due to loads and force elements: minus the
    derivatives of Q, and the rows z' - f of their states."""
    layout, zero = model.layout, jnp.zeros((), state.q.dtype)
    nv, ny, places = layout.nv, len(layout.inner_places), layout.inner_places
    own, heavy = np.arange(ny - len(layout.first_order), ny), len(layout.inertial)
    z, base = jnp.asarray(state.z), (len(layout.supports), 6)

    def parts(x):
        return x[:nv], x[nv : nv + ny], x[nv + ny :].reshape(base)

    def balance(x, x_dot, x_ddot):
        (delta, y, xi), (rate, y_dot, xi_dot) = parts(x), parts(x_dot)
        moved = z.at[places].add(y).at[layout.inner_rates].add(y_dot[:heavy])
        held = apart(model, moved, jnp.zeros_like(z).at[places].set(y_dot))
        small = delta, state.v + rate, xi, xi_dot
        along = state.v + rate, parts(x_ddot)[0], xi_dot, parts(x_ddot)[2]
        now = instant(model, state, zero, small, along)
        Q, on_supports = _of_wrenches(model, state, exerted(held, now, loads), *small)
        f = jnp.zeros_like(y).at[own].set(y_dot[own] - force_rates(held, now))
        return jnp.concatenate([-Q, f, -on_supports.ravel()])

    still = jnp.zeros(nv + ny + layout.nxi, z.dtype)
    K, C, *M = jax.jacfwd(balance, (0, 1, 2) if reads_accelerations(model) else (0, 1))(
        still, still, still
    )
    return M[0] if M else jnp.zeros_like(K), C, K


def command_forces(
    model: Model, state: State, loads: tuple[Load, ...], drives: tuple[str, ...]
) -> Float[Array, "n nu"]:
    """Return the generalized forces on (Delta, y, Xi) per unit of the command of each drive; in the
    row z' - f of a state, df/du."""
    layout, base = model.layout, jnp.zeros((len(model.layout.supports), 6), state.q.dtype)
    small = jnp.zeros_like(state.v), state.v, base, base
    now = instant(model, state, jnp.zeros((), state.q.dtype), small, None)
    inner = jnp.zeros(len(layout.inner_places) - len(layout.first_order), state.q.dtype)

    def forces(u):
        held = with_commands(apart(model, state.z), dict(zip(drives, u, strict=True)))
        Q, on_supports = _of_wrenches(model, state, exerted(held, now, loads), *small)
        return jnp.concatenate([Q, inner, force_rates(held, now), on_supports.ravel()])

    return jax.jacfwd(forces)(jnp.zeros(len(drives), state.q.dtype))


# Equilibrium, matrices and motion, which follow by differentiation


def unbalanced(model: Model, state: State, loads: tuple[Load, ...]) -> Float[Array, "nv"]:
    """Return the unbalanced generalized forces dV/dDelta - Q - H at rest [N, N m], which are zero
    at an equilibrium without closures."""
    still, base = jnp.zeros_like(state.v), jnp.zeros((len(model.layout.supports), 6), state.q.dtype)
    here = still, still, base, base
    forces = Q(model, state, loads, jnp.zeros((), still.dtype), *here) + H(
        model, state, _z_dot(model, state, *here), *here
    )
    return jax.grad(lambda delta: V(model, state, delta, still, base, base))(still) - forces


def matrices(
    model: Model, state: State, loads: tuple[Load, ...], multipliers: Array
) -> tuple[Array, Array, Array]:
    """Return M, C and K of (Delta, y, Xi) about a state, under loads and with the multipliers of
    closures."""
    layout, base = model.layout, jnp.zeros((len(model.layout.supports), 6), state.q.dtype)
    nv, ny, heavy = layout.nv, len(layout.inner_places), len(layout.inertial)
    still, z = jnp.zeros_like(state.v), jnp.asarray(state.z)

    def parts(x):
        return x[:nv], x[nv : nv + ny], x[nv + ny :].reshape(base.shape)

    def with_rates(y_dot):
        return State(state.q, state.v, z.at[layout.inner_rates].set(y_dot[:heavy])), jnp.zeros_like(
            z
        ).at[layout.inner_places].set(y_dot)

    def of_T(x_dot):
        delta_dot, y_dot, xi_dot = parts(x_dot)
        return T(model, with_rates(y_dot)[0], still, delta_dot, base, xi_dot)

    def of_R(x_dot):
        delta_dot, y_dot, xi_dot = parts(x_dot)
        return R(model, *with_rates(y_dot), still, delta_dot, base, xi_dot)

    def of_V(x):
        delta, y, xi = parts(x)
        moved = State(state.q, state.v, z.at[layout.inner_places].add(y))
        frames = frames_at(model, moved, delta, still, xi, base)
        return potential(apart(model, moved.z), frames) + multipliers @ c(model, state, delta, xi)

    x_dot = jnp.concatenate(
        [state.v, z[layout.inner_rates], jnp.zeros(ny - heavy + base.size, z.dtype)]
    )
    M, C, K = (
        jax.hessian(of_T)(x_dot),
        jax.hessian(of_R)(x_dot),
        jax.hessian(of_V)(jnp.zeros_like(x_dot)),
    )
    without = force_matrices(model, state, loads)
    return tuple(H + part for H, part in zip((M, C, K), without, strict=True))


def rates(model: Model, state: State, motions, loads: tuple[Load, ...], t: Array):
    """Return v' and z' by Lagrange's equations on moving supports, and the equations [M J'; J 0] of
    v' and lambda, None without closures."""
    zero, rest = jnp.zeros_like(state.v), jnp.zeros((2, len(model.layout.supports), 6), t.dtype)
    (xi, xi_dot), (_, xi_ddot) = (
        jax.jvp(lambda t: imposed(motions, t), (t,), (jnp.ones_like(t),))
        if motions
        else (rest, rest)
    )
    here, along = (zero, state.v, xi, xi_dot), (state.v, zero, xi_dot, xi_ddot)
    z_dot = _z_dot(model, state, *here)
    of_L, of_R = (
        (lambda *small: L(model, state, *small)),
        (lambda *small: R(model, state, z_dot, *small)),
    )
    momentum = jax.grad(of_L, 1)
    M = jax.jacfwd(momentum, 1)(*here)
    _, drift = jax.jvp(momentum, here, along)
    held, now = holding(model, state.z), instant(model, state, t, here, along)
    f = (
        jax.grad(of_L, 0)(*here)
        - jax.grad(of_R, 1)(*here)
        + _of_wrenches(model, state, exerted(held, now, loads), *here)[0]
        + H(model, state, z_dot, *here)
        - drift
    )

    def rates_at(v_dot):
        """Return z', at the accelerations of the motion where a force element reads them."""
        if not reads_accelerations(model):
            return z_dot
        return state_rates(held, instant(model, state, t, here, (state.v, v_dot, xi_dot, xi_ddot)))

    if not model.closures:
        v_dot = jnp.linalg.solve(M, f)
        return v_dot, rates_at(v_dot), None

    def c_dot(delta, delta_dot, xi, xi_dot):
        return jax.jvp(
            lambda delta, xi: c(model, state, delta, xi), (delta, xi), (delta_dot, xi_dot)
        )[1]

    J, (_, bend) = jax.jacfwd(c_dot, 1)(*here), jax.jvp(c_dot, here, along)
    equations = saddle_point(M, J, rank(model))
    v_dot = equations.solve(f, -bend)[0]
    return v_dot, rates_at(v_dot), equations


# The public functions, which check their arguments and are compiled


def kinetic_energy(
    model: Model, state: State, delta=None, delta_dot=None, xi=None, xi_dot=None
) -> Float[Array, ""]:
    """Return the kinetic energy T [J] at q (+) Delta with the rates Delta', on supports displaced
    by Xi with the rate Xi'; see `lagrangian`. Source: (10), (11) of the paper.

    Args:
        delta: increments Delta of the coordinates [m, rad], by default 0
        delta_dot: Delta' [m/s, rad/s], by default the speeds v of the state
        xi: displacements Xi of the supports [m, rad], by default 0
        xi_dot: their rates [m/s, rad/s], by default 0

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])}, gravity=[0, 0, -10.0]
    ... )
    >>> state = jb.State(model.reference.q, jnp.array([0, 0, 3.0, 0, 0, 0]))
    >>> float(jb.kinetic_energy(model, state))
    9.0
    """
    return _value(T, model, state, delta, delta_dot, xi, xi_dot)


def potential_energy(
    model: Model, state: State, delta=None, delta_dot=None, xi=None, xi_dot=None
) -> Float[Array, ""]:
    """Return the potential energy V [J] at q (+) Delta, on supports displaced by Xi; see
    `lagrangian`. The rates have no effect. Source: (22), (60) of the paper.

    Args:
        delta: increments Delta of the coordinates [m, rad], by default 0
        delta_dot: Delta' [m/s, rad/s], by default the speeds v of the state
        xi: displacements Xi of the supports [m, rad], by default 0
        xi_dot: their rates [m/s, rad/s], by default 0

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1], position=[0, 0, 1.5])},
    ...     gravity=[0, 0, -10.0],
    ... )
    >>> float(jb.potential_energy(model, model.reference))
    30.0
    """
    return _value(V, model, state, delta, delta_dot, xi, xi_dot)


def dissipation(
    model: Model, state: State, delta=None, delta_dot=None, xi=None, xi_dot=None
) -> Float[Array, ""]:
    """Return the dissipation function R [W], 1/2 c e'^2 for a linear damper; 2 R is the power that
    linear dampers dissipate. See `lagrangian`.

    Args:
        delta: increments Delta of the coordinates [m, rad], by default 0
        delta_dot: Delta' [m/s, rad/s], by default the speeds v of the state
        xi: displacements Xi of the supports [m, rad], by default 0
        xi_dot: their rates [m/s, rad/s], by default 0

    Derivatives treat the rates of the element states as constants, so that -dR/dDelta' is the
    generalized force of the dampers.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])}, gravity=[0, 0, -10.0]
    ... )
    >>> state = jb.State(model.reference.q, jnp.array([0, 0, 3.0, 0, 0, 0]))
    >>> float(jb.dissipation(model, state))
    0.0
    """
    return _value(_R, model, state, delta, delta_dot, xi, xi_dot)


def lagrangian(
    model: Model, state: State, delta=None, delta_dot=None, xi=None, xi_dot=None
) -> Float[Array, ""]:
    """Return L = T - V of small motions about a state [J], to be differentiated. Source: (12) of
    the paper.

    Args:
        delta: increments Delta of the coordinates, by default 0: for a free body the displacement
            of its O [m] and a rotation vector [rad]
        delta_dot: Delta', by default the speeds v of the state
        xi: displacements Xi of the supports from their reference poses, by default 0: {support: six
            numbers}, or a row for each support
        xi_dot: their rates, by default 0

    Errors: BAD_SHAPE, NON_FINITE, UNKNOWN_NAME for a support.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     elements={
    ...         "s": jb.Spring(
    ...             ("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=50.0, free_length=1.0
    ...         )
    ...     },
    ... )
    >>> stiffness = jax.hessian(lambda delta: -jb.lagrangian(model, model.reference, delta))(
    ...     jnp.zeros(1)
    ... )
    >>> mass = jax.hessian(lambda rate: jb.lagrangian(model, model.reference, None, rate))(
    ...     jnp.zeros(1)
    ... )
    >>> stiffness.round(9).tolist(), mass.round(9).tolist()
    ([[50.0]], [[2.0]])
    """
    return _value(L, model, state, delta, delta_dot, xi, xi_dot)


def _R(model: Model, state: State, *small: Array) -> Float[Array, ""]:
    """Return R after the small changes (Delta, Delta', Xi, Xi'), with z' computed for them and
    treated as a constant in derivatives."""
    return R(model, state, _z_dot(model, state, *jax.lax.stop_gradient(small)), *small)


def _value(
    function: Callable[..., Array], model: Model, state: State, delta, delta_dot, xi, xi_dot
) -> Float[Array, ""]:
    refuse_batch(model, "model")
    check_state(model, state, "state")
    with Problems() as problems:
        delta, delta_dot = (
            None if x is None else shaped(x, (model.layout.nv,), name, problems)
            for x, name in ((delta, "delta"), (delta_dot, "delta_dot"))
        )
        xi, xi_dot = (
            None if x is None else displacements(model, x, name, problems)
            for name, x in (("xi", xi), ("xi_dot", xi_dot))
        )
    return _program(function, model, state, (delta, delta_dot, xi, xi_dot))


@program
def _program(
    function: Callable[..., Array], model: Model, state: State, small: tuple[Array | None, ...]
) -> Float[Array, ""]:
    still, base = jnp.zeros_like(state.v), jnp.zeros((len(model.layout.supports), 6), state.q.dtype)
    delta, delta_dot, xi, xi_dot = (
        zero if x is None else x
        for x, zero in zip(small, (still, state.v, base, base), strict=True)
    )
    state = completed(model, state, frames_at(model, state, delta, still, xi, base))
    return function(model, state, delta, delta_dot, xi, xi_dot)
