"""Structured equations of motion: those of Newton and Euler for each body, projected onto the
motions that the joints allow.

    about O, in world axes:  m (a_O + alpha x c + w x (w x c)) = F,
                             J alpha + w x J w + m c x a_O = M        (16)-(19) of the paper
    speeds:               sum J_b' (inertia J_b v' + bias - wrench) = 0,
                          J_b the velocity of body b per unit of each speed

The inertia of elements adds J_e' T_e'' J_e to the mass matrix, and its force at v' = 0 to
the wrenches.

Tests compare them with the Lagrange equations of L = T - V with R. Where every body is free on the
world the mass matrix is constant in body axes and is inverted once, unless elements have inertia:
`closed_loops.dynamics_of` chooses the form for a model.
"""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable
from dataclasses import replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry import rotations
from jaxbody.geometry.frames import Frame, Instant
from jaxbody.geometry.vectors import cross, inverse_of_three, product, rotate, rotate_back, skew
from jaxbody.lagrange import kinetic
from jaxbody.model.element_states import apart, holding, rest_states
from jaxbody.model.elements.elements import Element
from jaxbody.model.inputs.loads import Load
from jaxbody.model.joints.frame_tables import (
    each_element,
    end_rows,
    exerted,
    exerted_by_loads,
    inertial_tables,
    of_table,
    reads_accelerations,
    state_rates,
    state_scales,
    summed_on_frames,
    wrenches,
)
from jaxbody.model.joints.joints import Free
from jaxbody.model.joints.kinematics import Coordinates, Motions, jacobian, with_world
from jaxbody.model.layouts import WORLD, Layout
from jaxbody.model.models import Model, size_of
from jaxbody.model.states import State
from jaxbody.model.storage import KindTable
from jaxbody.numerics.small_systems import solve_spd

SAMPLES = 128  # most samples of motions and loads from which a model's reach is estimated


class Dynamics(eqx.Module):
    """A model under imposed motions and loads as a first-order system y' = f(t, y), with its
    constants computed once."""

    coordinates: Coordinates
    motions: Motions
    loads: tuple[Load, ...]

    def __init__(self, model: Model, motions: Motions, loads: tuple[Load, ...] = ()):
        self.coordinates, self.motions, self.loads = Coordinates(model), motions, loads

    @property
    def model(self) -> Model:
        return self.coordinates.model

    @abstractmethod
    def pack(self, state: State, t: Any = None) -> Float[Array, "ny"]:
        """Return y of a state; y depends on the time t only if it holds momenta
        (`canonical_equations`)."""

    @abstractmethod
    def unpack(self, y: Float[Array, "ny"], t: Any = None) -> State:
        """Return the state of y."""

    def drive(self, t: Float[Array, ""]) -> Any:
        """Return the inputs u of the system that depend on time alone."""
        return t

    def holding(self, z: Float[Array, "nz"]) -> Dynamics:
        """Return the equations of motion with the element states z."""
        return (
            eqx.tree_at(lambda dynamics: dynamics.coordinates.model, self, holding(self.model, z))
            if self.model.layout.nz
            else self
        )

    @abstractmethod
    def driven(self, u: Any, y: Float[Array, "ny"]) -> Float[Array, "ny"]:
        """Return dy/dt with the inputs u = drive(t)."""

    def rate(self, t: Float[Array, ""], y: Float[Array, "ny"]) -> Float[Array, "ny"]:
        """Return dy/dt."""
        return self.driven(self.drive(t), y)

    def scales(self, times: Float[Array, "nt"], start: State) -> Float[Array, "ny"]:
        """Return the scale of each component of y: for positions the size of the model or, without
        extent, the distance it moves [m], for angles 1, for velocities these times a fast
        frequency."""
        model, layout, span = self.model, self.model.layout, times[-1] - times[0]
        square = self._stiffness_sum() / jnp.sum(model.bodies.rows.mass)
        size = size_of(model, self._reach(times, start, jnp.sqrt(square) + 1 / span))
        rate = jnp.sqrt(square + jnp.linalg.norm(model.gravity) / size) + 1 / span
        y = self._packed(
            jnp.where(layout.angular, 1.0, size), rate * jnp.where(layout.turns, 1.0, size)
        )
        if not layout.nz:
            return y
        z = jnp.asarray(state_scales(model, self._reference_frames(), size))
        return jnp.concatenate(
            [
                y,
                z.at[layout.inner_rates].set(rate * z[layout.inertial])
                if len(layout.inertial)
                else z,
            ]
        )

    def _reach(self, times: Float[Array, "nt"], start: State, rate: Array) -> Array:
        """Estimate how far the bodies move [m]: |q0| + |v0|/rate + (g + |F|/m)/rate^2 + the range
        of the supports; 1 if that is 0."""
        layout, coordinates = self.model.layout, self.coordinates

        frames = coordinates.frames(
            start.q, start.v, coordinates.supports_moving(self.motions, times[0])
        )

        def acting(t):
            exerted = exerted_by_loads(self.model, frames.at_time(t, start), self.loads)
            forces = [jnp.linalg.norm(force) for _, (force, _) in exerted]
            return jnp.stack([jnp.zeros(3), *(motion(t)[:3] for motion in self.motions)]), sum(
                forces, jnp.zeros(())
            )

        places, forces = jax.vmap(acting)(times[:: len(times) // SAMPLES + 1])
        moved, speed = (
            jnp.where(layout.angular, 0.0, start.q - coordinates.reference.q),
            jnp.where(layout.turns, 0.0, start.v),
        )
        pull = jnp.linalg.norm(self.model.gravity) + jnp.max(forces) / jnp.sum(
            self.model.bodies.rows.mass
        )
        reach = (
            jnp.max(jnp.abs(moved), initial=0.0)
            + jnp.max(jnp.abs(speed), initial=0.0) / rate
            + pull / rate**2
            + jnp.max(jnp.ptp(places, 0))
        )
        return jnp.where(reach > 0, reach, 1.0)

    @abstractmethod
    def _packed(self, q: Float[Array, "nq"], v: Float[Array, "nv"]) -> Float[Array, "*n"]:
        """Return a number for each component of q and v in the order of y."""

    def _reference_frames(self) -> Frame:
        return with_world(self.coordinates.supports.at_rest(), self.coordinates.bodies.at_rest())

    def _stiffness_sum(self) -> Float[Array, ""]:
        """Return the sum over the elements of the largest second derivative of V(e) in the
        reference pose."""

        def stiffest(element, *frames):
            tangent = element.tangent(element.deformation(*(f.pose() for f in frames)))
            return jnp.max(jnp.abs(tangent))

        reference = self._reference_frames()
        model = apart(self.model, rest_states(self.model, reference.pose()))
        largest = map(jnp.sum, each_element(model, reference, stiffest))
        return sum(largest, jnp.zeros((), self.model.gravity.dtype))

    def begun(self, t: Float[Array, ""], state: State) -> tuple[State, Any]:
        """Return the state from which a motion starts, and the distance of the given state from the
        closures."""
        return state, None

    def projected(self, t: Float[Array, ""], y: Float[Array, "ny"]) -> Float[Array, "ny"]:
        """Return y, moved to the nearest state that fulfills the closures."""
        return y

    def ended(self, code: Array, t: Float[Array, ""], state: State, closing: Any) -> Array:
        """Return the status of a motion that ended at time t in this state with the status
        `code`."""
        return code

    @abstractmethod
    def acceleration(
        self, t: Float[Array, ""], q: Float[Array, "nq"], v: Float[Array, "nv"]
    ) -> Float[Array, "nv"]:
        """Return dv/dt for the speeds v of the state."""

    @abstractmethod
    def speeds(
        self, q: Float[Array, "nq"], momenta: Float[Array, "nv"], supports: Frame
    ) -> tuple[Array, Frame, Array, Callable]:
        """Return the speeds v with the generalized momenta dT/dv = `momenta`, the frames, B' dT/dq
        (q' = B v), and a function that converts forces and moments about O on the bodies to
        generalized forces."""

    @abstractmethod
    def accelerated(self, t: Float[Array, ""], state: State) -> Instant:
        """Return the frames with the accelerations of their origins and their angular
        accelerations."""

    def _net(self, now: Instant):
        """Return the applied minus the inertial force and moment on each body about its origin, for
        the accelerations of the frames."""
        first = self.model.layout.first_body
        bodies, moving = self.model.bodies.rows, now[first:]
        a, alpha, F, M = (
            jnp.asarray(x)[first:]
            for x in (now.a, now.alpha, *_acting(self.model, now, self.loads))
        )
        c, m = rotate(moving.R, bodies.com), bodies.mass[:, None]
        force = m * (a + cross(alpha, c) + cross(moving.w, cross(moving.w, c)))

        def J(x):
            return rotate(moving.R, rotate(bodies.inertia, rotate_back(moving.R, x)))

        return F - force, M - (J(alpha) + cross(moving.w, J(moving.w)) + cross(c, force))

    def instant(self, t: Float[Array, ""], state: State, *, reactions: bool) -> Instant:
        """Return the frames with accelerations and, with `reactions`, with the forces and moments
        that joints, supports and world carry."""
        now = self.accelerated(t, state)
        return self.with_reactions(now) if reactions else now

    def with_reactions(self, now: Instant, extra: tuple[Array, Array] | None = None) -> Instant:
        """Return `now` with F and M of each frame: applied loads minus the rates of momentum,
        summed over the bodies that the frame carries by joints. `extra`: force [N] and moment [N m]
        on each body about its origin, in addition to the loads."""
        first = self.model.layout.first_body
        F, M = self._net(now)
        if extra is not None:
            F, M = F + extra[0], M + extra[1]
        outboard = jnp.asarray(self.model.layout.carries[:, first:], F.dtype)[..., None]
        moment = M[None] + cross(now.p[first:][None] - now.p[:, None], F[None])
        # elements attached to world and supports
        direct = (jnp.concatenate([x[:first], jnp.zeros_like(F)]) for x in _acting(self.model, now))
        F, M = (
            x + jnp.sum(outboard * of_bodies, 1)
            for x, of_bodies in zip(direct, (F[None], moment), strict=True)
        )
        return replace(now, F=F, M=M)

    def reactions(self, t: Float[Array, ""], q: Float[Array, "nq"], v: Float[Array, "nv"]):
        """Return force [N] and moment about its origin [N m] that the bodies and elements exert on
        each support, in world axes."""
        # for elements with memory, the model must already contain their states z (see `holding`)
        now, first = self.instant(t, State(q, v), reactions=True), self.model.layout.first_body
        assert now.F is not None and now.M is not None
        return now.F[1:first], now.M[1:first]


class JointedBodies(Dynamics):
    """Bodies on joints of any kind, with y = (q, v, z) of the state."""

    def pack(self, state: State, t: Any = None) -> Float[Array, "ny"]:
        return self.model.layout.pack(state)

    def unpack(self, y: Float[Array, "ny"], t: Any = None) -> State:
        return self.model.layout.unpack(y)

    def driven(self, u: Any, y: Float[Array, "ny"]) -> Float[Array, "ny"]:
        q, v, z = self.model.layout.split(y)
        here: Any = self.holding(z)
        v_dot, now, J = here._solve(u, q, v)
        return self.model.layout.pack(
            State(self.coordinates.rate(q, v), v_dot, here.state_rates(v_dot, now, J))
        )

    def _packed(self, q: Float[Array, "nq"], v: Float[Array, "nv"]) -> Float[Array, "*n"]:
        return self.model.layout.pack(State(q, v))

    def acceleration(
        self, t: Float[Array, ""], q: Float[Array, "nq"], v: Float[Array, "nv"]
    ) -> Float[Array, "nv"]:
        return self._solve(t, q, v)[0]

    def _solve(self, t, q, v):
        """Return v', the frames with the accelerations that they have for v' = 0, and the
        velocities of the bodies per unit of each speed."""
        now, axes = self._bias(t, q, v)
        J = jacobian(self.model.layout, now, *axes)
        return solve_spd(self.inertia(now, *J)[0], generalized(*J, *self._net(now))), now, J

    def inertia(
        self, frames: Frame, lin: Float[Array, "nb nv 3"], ang: Float[Array, "nb nv 3"]
    ) -> tuple[Float[Array, "nv nv"], Float[Array, "nv"]]:
        """Return the mass matrix, and the generalized momenta of the frames' velocities."""
        bodies, moving = self.model.bodies.rows, frames[self.model.layout.first_body :]
        m, R = bodies.mass[:, None, None], moving.R
        J_C = product(product(R, bodies.inertia), jnp.swapaxes(R, -1, -2))
        lin_C = lin + cross(ang, rotate(R, bodies.com)[:, None])
        turning = jnp.sum(J_C[:, None] * ang[:, :, None, :], -1)
        mass = jnp.sum(
            m[..., None] * lin_C[:, :, None] * lin_C[:, None] + ang[:, :, None] * turning[:, None],
            (0, 3),
        )
        momenta = jnp.sum(
            m * lin_C * moving.velocity(bodies.com)[:, None] + turning * moving.w[:, None], (0, 2)
        )
        if not inertial_tables(self.model):
            return mass, momenta
        twists = jnp.concatenate([lin, ang], -1)
        of_others = jnp.zeros((self.model.layout.first_body, *twists.shape[1:]), twists.dtype)
        parts = element_inertia(self.model, frames, jnp.concatenate([of_others, twists]))
        return mass + parts[0], momenta + parts[1]

    def _bias(self, t, q, v):
        """Return the frames at time t, with the accelerations that they have for v' = 0, and the
        axes of the coordinates."""

        def moving(t, q):
            frames, axes = self.coordinates.frames_and_axes(
                q, v, self.coordinates.supports_moving(self.motions, t)
            )
            return (frames.v, frames.w), (frames, axes)

        (_, (a, alpha), (frames, axes)) = jax.jvp(
            moving, (t, q), (jnp.ones_like(t), self.coordinates.rate(q, v)), has_aux=True
        )
        return replace(frames.at_time(t, State(q, v)), a=a, alpha=alpha), axes

    def speeds(
        self, q: Float[Array, "nq"], momenta: Float[Array, "nv"], supports: Frame
    ) -> tuple[Array, Frame, Array, Callable]:
        coordinates = self.coordinates
        frames, axes = coordinates.frames_and_axes(q, jnp.zeros_like(momenta), supports)
        J = jacobian(self.model.layout, frames, *axes)
        mass, base_momenta = self.inertia(frames, *J)
        v = solve_spd(mass, momenta - base_momenta)

        def T(q):
            frames = coordinates.frames(q, v, supports)
            return kinetic(self.model, frames), frames

        gradient, frames = jax.grad(T, has_aux=True)(q)
        return v, frames, coordinates.rate_transposed(q, gradient), partial(generalized, *J)

    def accelerated(self, t: Float[Array, ""], state: State) -> Instant:
        return self._moving(*self._solve(t, state.q, state.v))

    def _moving(self, v_dot: Float[Array, "nv"], now: Instant, J: tuple[Array, Array]) -> Instant:
        """Return the frames with the accelerations that they have for v', from those for v' = 0."""
        first = self.model.layout.first_body
        a, alpha = (
            jnp.asarray(x).at[first:].add(jnp.sum(per_speed * v_dot[None, :, None], 1))
            for x, per_speed in zip((now.a, now.alpha), J, strict=True)
        )
        return replace(now, a=a, alpha=alpha)

    def state_rates(
        self, v_dot: Float[Array, "nv"], now: Instant, J: tuple[Array, Array]
    ) -> Float[Array, "nz"]:
        """Return z' of the model, which holds its states."""
        if not self.model.layout.nz:
            return jnp.zeros(0, v_dot.dtype)
        moving = self._moving(v_dot, now, J) if reads_accelerations(self.model) else now
        return state_rates(self.model, moving)


class FreeBodies(Dynamics):
    """Bodies that are all free on the world: the equations of Newton and Euler in body axes, where
    the mass matrix is constant.

    y = (positions, quaternions, velocities of O, angular velocities, z), the velocities in
    body axes."""

    inverse_mass: Float[Array, "nb 6 6"]

    def __init__(self, model: Model, motions: Motions, loads: tuple[Load, ...] = ()):
        super().__init__(model, motions, loads)
        self.inverse_mass = inverse_mass(model)

    def _packed(self, q, v):
        q, v = q.reshape(-1, 7), v.reshape(-1, 6)
        return jnp.concatenate(
            [q[:, :3].ravel(), q[:, 3:].ravel(), v[:, :3].ravel(), v[:, 3:].ravel()]
        )

    def _split(self, y):
        """Return positions, quaternions, v and w in body axes, and z, of y."""
        n = len(self.model.layout.bodies)
        return (
            y[: 3 * n].reshape(n, 3),
            y[3 * n : 7 * n].reshape(n, 4),
            y[7 * n : 10 * n].reshape(n, 3),
            y[10 * n : 13 * n].reshape(n, 3),
            y[13 * n :],
        )

    def pack(self, state: State, t: Any = None):
        R = rotations.matrix(state.q.reshape(-1, 1, 7)[..., 3:])
        y = self._packed(state.q, rotate_back(R, state.v.reshape(-1, 2, 3)))
        return jnp.concatenate([y, state.z])

    def unpack(self, y, t: Any = None):
        p, quaternion, v_B, w_B, z = self._split(y)
        quaternion = rotations.normalize(quaternion)
        R = rotations.matrix(quaternion)
        return _state(p, quaternion, rotate(R, v_B), rotate(R, w_B), z)

    def drive(self, t: Float[Array, ""]):
        """Return t and the frames of the supports."""
        return t, self.coordinates.supports_moving(self.motions, t)

    def driven(self, u, y):
        t, supports = u
        p, quaternion, v_B, w_B, z = self._split(y)
        model = holding(self.model, z)
        bodies = model.bodies.rows
        R = rotations.matrix(quaternion)
        v, w = rotate(R, v_B), rotate(R, w_B)
        now = with_world(supports, Frame(p, R, v, w)).at_time(t, _state(p, quaternion, v, w, z))
        acting = exerted(model, now, self.loads)
        F, M = (x[model.layout.first_body :] for x in wrenches(model, now, acting))
        m, c = bodies.mass[:, None], bodies.com
        P = m * (v_B + cross(w_B, c))  # momentum and angular momentum about O, in body axes
        H = rotate(bodies.inertia, w_B) + cross(c, P)
        F_B = rotate_back(R, F) - cross(w_B, P)
        M_B = rotate_back(R, M) - cross(w_B, H) - cross(v_B, P)
        rate = jnp.sum(self.inverse_mass * jnp.concatenate([F_B, M_B], -1)[:, None, :], -1)
        of_elements = [state_rates(model, now)] if len(z) else []
        return jnp.concatenate(
            [
                v.ravel(),
                rotations.quaternion_rate_body(quaternion, w_B).ravel(),
                rate[:, :3].ravel(),
                rate[:, 3:].ravel(),
                *of_elements,
            ]
        )

    def acceleration(self, t, q, v):
        now = self.accelerated(t, State(q, v))
        return jnp.concatenate([jnp.asarray(now.a), jnp.asarray(now.alpha)], -1)[
            self.model.layout.first_body :
        ].ravel()

    def accelerated(self, t, state: State):
        """Return the frames with a = R (v_B' + w_B x v_B), alpha = R w_B'."""

        def moving(t):
            supports = self.coordinates.supports_moving(self.motions, t)
            return (supports.v, supports.w), supports

        (_, (a, alpha), supports) = jax.jvp(moving, (t,), (jnp.ones_like(t),), has_aux=True)
        y = self.pack(state)
        p, quaternion, v_B, w_B, _ = self._split(y)
        _, _, v_rate, w_rate, _ = self._split(self.driven((t, supports), y))
        R, zero = rotations.matrix(quaternion), jnp.zeros((1, 3), y.dtype)
        now = with_world(supports, Frame(p, R, rotate(R, v_B), rotate(R, w_B))).at_time(t, state)
        a = jnp.concatenate([zero, a, rotate(R, v_rate + cross(w_B, v_B))])
        return replace(now, a=a, alpha=jnp.concatenate([zero, alpha, rotate(R, w_rate)]))

    def speeds(self, q, momenta, supports: Frame):
        """Return v = R mass_B^-1 R' momenta, the frames, B' dT/dq = -(0, v x P + w x H), and the
        conversion of forces and moments."""
        q, momenta = q.reshape(-1, 7), momenta.reshape(-1, 2, 3)
        R = rotations.matrix(q[:, 3:])
        in_body = rotate_back(R[:, None], momenta).reshape(-1, 1, 6)
        v, w = jnp.moveaxis(
            rotate(R[:, None], jnp.sum(self.inverse_mass * in_body, -1).reshape(-1, 2, 3)), 1, 0
        )
        gyroscopic = cross(v, momenta[:, 0]) + cross(w, momenta[:, 1])

        def of_bodies(F, M):
            return jnp.concatenate([F, M], -1).ravel()

        return (
            of_bodies(v, w),
            with_world(supports, Frame(q[:, :3], R, v, w)),
            of_bodies(jnp.zeros_like(v), -gyroscopic),
            of_bodies,
        )


def _state(
    p: Float[Array, "nb 3"],
    quaternion: Float[Array, "nb 4"],
    v: Float[Array, "nb 3"],
    w: Float[Array, "nb 3"],
    z: Float[Array, "nz"],
) -> State:
    """Return the state of free bodies."""
    return State(
        jnp.concatenate([p, quaternion], -1).ravel(), jnp.concatenate([v, w], -1).ravel(), z
    )


def generalized(lin, ang, F: Float[Array, "nb 3"], M: Float[Array, "nb 3"]) -> Float[Array, "nv"]:
    """Return the generalized forces J' (F, M) of forces and moments about O on the bodies."""
    return jnp.sum(lin * F[:, None] + ang * M[:, None], (0, 2))


def _acting(model: Model, now: Instant, loads: tuple[Load, ...] = ()) -> tuple[Array, Array]:
    """Return force and moment on each frame about its origin, including those of the inertia of
    elements."""
    F, M = wrenches(model, now, exerted(model, now, loads))
    if not inertial_tables(model):
        return F, M
    more = inertial_wrenches(model, now)
    return F + more[0], M + more[1]


def all_free(layout: Layout) -> bool:
    """Return whether every body is free on the world, so that the speeds are the velocities of the
    bodies and their Jacobian is 1."""
    return all(block.kind is Free for block in layout.joints) and set(layout.parents) == {WORLD}


def inverse_mass(model: Model) -> Float[Array, "nb 6 6"]:
    """Return the inverse of [[m I, -m [c]], [m [c], J_C - m [c][c]]], the mass of each body about O
    (42), from the inverse of J_C, as v_C = v_O - [c] w."""
    bodies = model.bodies.rows
    C = skew(bodies.com)
    G = inverse_of_three((bodies.inertia + jnp.swapaxes(bodies.inertia, -1, -2)) / 2)
    CG, GC = product(C, G), product(G, C)
    top = jnp.concatenate(
        [np.eye(3, dtype=C.dtype)[None] / bodies.mass[:, None, None] - product(CG, C), CG], -1
    )
    return jnp.concatenate([top, jnp.concatenate([-GC, G], -1)], -2)


# Elements with a kinetic energy T(e, e_dot), such as inerters: with J = de/d(Delta, Xi) they add
# J' T'' J to M | -M~ | M_bb, and the force d/dt dT/de_dot - dT/de acts like a tension


def accelerated(model: Model, now: Instant, table: KindTable, function) -> Any:
    """Return function(element, its frames (A, B, ...), their derivatives in time) for each element
    of one table, at the accelerations in `now`."""
    ends = (
        tuple(frames[rows] for rows in end_rows(model, table)) for frames in (now, now.changes())
    )
    return jax.vmap(function)(table.rows, *ends)


def inertial_wrenches(
    model: Model, now: Instant
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Return force and moment about its origin that the inertia of elements exerts on each frame,
    in world axes."""
    tables = inertial_tables(model)
    by_table = [
        accelerated(model, now, table, lambda s, *F: s.inertial_wrenches(*F)) for table in tables
    ]
    return summed_on_frames(model, tables, by_table)


def element_inertia(
    model: Model, frames: Frame, twists: Float[Array, "nf n 6"]
) -> tuple[Float[Array, "n n"], Float[Array, "n"]]:
    """Return the contribution of the elements to the mass matrix of the coordinates whose unit
    speeds move the frames by `twists`, and to the generalized momenta of the frames' velocities."""
    mass, momenta = 0.0, 0.0
    for table in inertial_tables(model):
        slopes, second, first = of_table(model, frames, table, _of_element)
        J = on_coordinates(model, table, slopes, twists)
        mass, momenta = (
            mass + jnp.sum(jnp.swapaxes(J, 1, 2) @ second @ J, 0),
            momenta + jnp.sum(J * first[:, :, None], (0, 1)),
        )
    return mass, momenta  # pyright: ignore[reportReturnType]  of at least one table


def on_coordinates(
    model: Model, table: KindTable, slopes: list[Float[Array, "ne k 6"]], twists: Any
) -> Float[Array, "ne k n"]:
    """Return de/d(Delta, Xi) of the elements of a table from their slopes in the motions of their
    frames and the twists of the frames."""
    rows: Any = end_rows(model, table)
    return sum(
        slope @ jnp.swapaxes(twists[row], 1, 2) for slope, row in zip(slopes, rows, strict=True)
    )  # pyright: ignore[reportReturnType]


def _of_element(element: Element, *frames: Frame):
    """Return de_dot/d(velocity, angular velocity) of each frame, and T'' and T' in e_dot."""
    e, e_dot = element.rates(*frames)
    k = e.size

    def rates(velocities):
        return element.rates(
            *(Frame(f.p, f.R, x[:3], x[3:]) for f, x in zip(frames, velocities, strict=True))
        )[1].reshape(k)

    slopes = jax.jacfwd(rates)([jnp.zeros(6, e.dtype)] * len(frames))
    second = jax.jacfwd(lambda rate: element.momentum(e, rate))(e_dot)
    return slopes, second.reshape(k, k), element.momentum(e, e_dot).reshape(k)
