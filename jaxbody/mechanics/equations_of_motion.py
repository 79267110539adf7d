"""Structured equations of motion: those of Newton and Euler for each body, projected onto the motions that the joints allow.

    about O, in world axes:  m (a_O + alpha x c + w x (w x c)) = F,   J alpha + w x J w + m c x a_O = M        (16)-(19) of the paper
    speeds:               sum J_b' (inertia J_b v' + bias - wrench) = 0, J_b the velocity of body b per unit of each speed

Tests compare them with the Lagrange equations of L = T - V with R. Where every body is free on the world the mass matrix is constant in
body axes and is inverted once.
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry import rotations
from jaxbody.geometry.frames import Frame, stack
from jaxbody.geometry.vectors import cross, inverse_of_three, product, rotate, rotate_back, skew
from jaxbody.inputs.loads import Load
from jaxbody.mechanics.energies import each_element, wrenches
from jaxbody.mechanics.kinematics import Coordinates, Motions
from jaxbody.models.layouts import Layout
from jaxbody.models.models import Model
from jaxbody.models.sizes import size_of
from jaxbody.models.states import Instant, State
from jaxbody.numerics.small_systems import solve_spd


class Dynamics(eqx.Module):
    """A model under imposed motions and loads as a first-order system y' = f(t, y), with its constants computed once.

    y is (q, v) of the state; if all bodies are free on the world, v is replaced by the velocities in body axes."""

    coordinates: Coordinates
    motions: Motions
    loads: tuple[Load, ...]
    inverse_mass: Float[Array, "nb 6 6"] | None

    def __init__(self, model: Model, motions: Motions, loads: tuple[Load, ...] = ()):
        self.coordinates = Coordinates(model)
        self.motions, self.loads = motions, loads
        self.inverse_mass = inverse_mass(model) if model.layout.floating else None

    @property
    def model(self) -> Model:
        return self.coordinates.model

    def pack(self, state: State, t: Any = None) -> Float[Array, "ny"]:
        """y of a state; only momenta (`canonical_equations`) depend on t."""
        if not self.model.layout.floating:
            return jnp.concatenate([state.q, state.v])
        q, v = state.q.reshape(-1, 7), state.v.reshape(-1, 2, 3)
        v_B = rotate_back(rotations.matrix(q[:, None, 3:]), v)
        return jnp.concatenate([q[:, :3].ravel(), q[:, 3:].ravel(), v_B[:, 0].ravel(), v_B[:, 1].ravel()])

    def unpack(self, y: Float[Array, "ny"], t: Any = None) -> State:
        layout = self.model.layout
        if not layout.floating:
            return State(normalized(self.model, y[: layout.nq]), y[layout.nq :])
        p, quaternion, v_B, w_B = _split(y, len(layout.bodies))
        quaternion = rotations.normalize(quaternion)
        R = rotations.matrix(quaternion)
        return State(jnp.concatenate([p, quaternion], -1).ravel(), jnp.concatenate([rotate(R, v_B), rotate(R, w_B)], -1).ravel())

    def drive(self, t: Float[Array, ""]) -> Any:
        """The inputs that depend on time alone: t, and for free bodies the frames of the supports."""
        return (t, self.coordinates.supports_moving(self.motions, t)) if self.model.layout.floating else t

    def driven(self, u: Any, y: Float[Array, "ny"]) -> Float[Array, "ny"]:
        """dy/dt with u = drive(t)."""
        if self.model.layout.floating:
            t, supports = u
            return self._rate_floating(t, supports, y)
        nq = self.model.layout.nq
        q, v = y[:nq], y[nq:]
        return jnp.concatenate([self.coordinates.rate(q, v), self.acceleration(u, q, v)])

    def rate(self, t: Float[Array, ""], y: Float[Array, "ny"]) -> Float[Array, "ny"]:
        """dy/dt."""
        return self.driven(self.drive(t), y)

    def _rate_floating(self, t, supports: Frame, y):
        model = self.model
        bodies = model.bodies.rows
        p, quaternion, v_B, w_B = _split(y, len(model.layout.bodies))
        R = rotations.matrix(quaternion)
        v, w = rotate(R, v_B), rotate(R, w_B)
        frames = frames_of_free_bodies(supports, Frame(p, R, v, w))
        F, M = (x[model.layout.first_body :] for x in wrenches(model, frames, self.loads, t))
        m, c = bodies.mass[:, None], bodies.com
        P = m * (v_B + cross(w_B, c))  # momentum and angular momentum about O, in body axes
        H = rotate(bodies.inertia, w_B) + cross(c, P)
        F_B = rotate_back(R, F) - cross(w_B, P)
        M_B = rotate_back(R, M) - cross(w_B, H) - cross(v_B, P)
        assert self.inverse_mass is not None
        rate = jnp.sum(self.inverse_mass * jnp.concatenate([F_B, M_B], -1)[:, None, :], -1)
        return jnp.concatenate(
            [v.ravel(), rotations.quaternion_rate_body(quaternion, w_B).ravel(), rate[:, :3].ravel(), rate[:, 3:].ravel()]
        )

    def acceleration(self, t: Float[Array, ""], q: Float[Array, "nq"], v: Float[Array, "nv"]) -> Float[Array, "nv"]:
        """dv/dt, in the speeds of the state."""
        return self._solve(t, q, v)[0]

    def _solve(self, t, q, v):
        """v', the frames, the accelerations at v' = 0, and the velocities per unit of each speed."""
        frames, (linear, angular), a, alpha = self._bias(t, q, v)
        F, M = self._net(t, frames, a, alpha)
        lin, ang = self.jacobian(frames, linear, angular)
        forces = jnp.sum(lin * F[:, None] + ang * M[:, None], (0, 2))
        return solve_spd(self.inertia(frames, lin, ang)[0], forces), frames, a, alpha, lin, ang

    def inertia(self, frames: Frame, lin, ang) -> tuple[Float[Array, "nv nv"], Float[Array, "nv"]]:
        """The mass matrix, and the generalized momenta of the frames' velocities."""
        bodies, moving = self.model.bodies.rows, frames[self.model.layout.first_body :]
        m, R = bodies.mass[:, None, None], moving.R
        J_C = product(product(R, bodies.inertia), jnp.swapaxes(R, -1, -2))
        lin_C = lin + cross(ang, rotate(R, bodies.com)[:, None])
        turning = jnp.sum(J_C[:, None] * ang[:, :, None, :], -1)
        mass = jnp.sum(m[..., None] * lin_C[:, :, None] * lin_C[:, None] + ang[:, :, None] * turning[:, None], (0, 3))
        momenta = jnp.sum(m * lin_C * moving.velocity(bodies.com)[:, None] + turning * moving.w[:, None], (0, 2))
        return mass, momenta

    def _bias(self, t, q, v):
        """Frames, axes, and the accelerations of origin and orientation of each body at v' = 0: the derivative of the velocities
        along the motion."""

        def moving(t, q):
            frames, axes = self.coordinates.frames_and_axes(q, v, self.coordinates.supports_moving(self.motions, t))
            return (frames.v, frames.w), (frames, axes)

        (_, (a, alpha), (frames, axes)) = jax.jvp(moving, (t, q), (jnp.ones_like(t), self.coordinates.rate(q, v)), has_aux=True)
        return frames, axes, a, alpha

    def _net(self, t, frames: Frame, a, alpha):
        """Applied minus inertial force and moment on each body about its origin, for given accelerations of the frames."""
        first = self.model.layout.first_body
        bodies, moving = self.model.bodies.rows, frames[first:]
        a, alpha = a[first:], alpha[first:]
        F, M = (x[first:] for x in wrenches(self.model, frames, self.loads, t))
        c, m = rotate(moving.R, bodies.com), bodies.mass[:, None]
        force = m * (a + cross(alpha, c) + cross(moving.w, cross(moving.w, c)))

        def J(x):
            return rotate(moving.R, rotate(bodies.inertia, rotate_back(moving.R, x)))

        return F - force, M - (J(alpha) + cross(moving.w, J(moving.w)) + cross(c, force))

    def jacobian(self, frames: Frame, linear, angular):
        """(nb, nv, 3) velocities of each body's origin and its angular velocities per unit of each speed."""
        layout = self.model.layout
        owners = np.repeat(np.arange(len(layout.bodies)), [kind.nv for kind in layout.kinds])
        p = frames.p[layout.first_body :]
        mask = jnp.asarray(layout.carries, p.dtype)[..., None]
        return mask * (linear[None] + cross(angular[None], p[:, None] - p[owners][None])), mask * angular[None]

    def instant(self, t: Float[Array, ""], state: State, *, reactions: bool) -> Instant:
        """Frames with accelerations and, with `reactions`, the forces and moments that joints, supports and world carry."""
        frames, a, alpha = self._accelerated_floating(t, state) if self.model.layout.floating else self._accelerated(t, state)
        transmitted = self.transmitted_wrenches(t, frames, a, alpha) if reactions else (None, None)
        return Instant(frames.p, frames.R, frames.v, frames.w, state, a, alpha, *transmitted)

    def transmitted_wrenches(self, t, frames: Frame, a, alpha, extra: tuple[Array, Array] | None = None):
        """F and M of an Instant for given accelerations: applied loads minus the rates of momentum, summed over the bodies that a frame
        carries by joints. `extra`: force and moment on each body about its origin, in addition to the loads."""
        first = self.model.layout.first_body
        F, M = self._net(t, frames, a, alpha)
        if extra is not None:
            F, M = F + extra[0], M + extra[1]
        outboard = jnp.asarray(outboard_mask(self.model.layout), F.dtype)[..., None]
        moment = M[None] + cross(frames.p[first:][None] - frames.p[:, None], F[None])
        direct = (jnp.concatenate([x[:first], jnp.zeros_like(F)]) for x in wrenches(self.model, frames))  # elements on world and supports
        return tuple(x + jnp.sum(outboard * of_bodies, 1) for x, of_bodies in zip(direct, (F[None], moment), strict=True))

    def _accelerated(self, t, state: State):
        v_dot, frames, a, alpha, lin, ang = self._solve(t, state.q, state.v)
        first = self.model.layout.first_body
        a = a.at[first:].add(jnp.sum(lin * v_dot[None, :, None], 1))
        return frames, a, alpha.at[first:].add(jnp.sum(ang * v_dot[None, :, None], 1))

    def _accelerated_floating(self, t, state: State):
        """a = R (v_B' + w_B x v_B), alpha = R w_B'."""

        def moving(t):
            supports = self.coordinates.supports_moving(self.motions, t)
            return (supports.v, supports.w), supports

        (_, (a, alpha), supports) = jax.jvp(moving, (t,), (jnp.ones_like(t),), has_aux=True)
        y = self.pack(state)
        n = len(self.model.layout.bodies)
        p, quaternion, v_B, w_B = _split(y, n)
        _, _, v_rate, w_rate = _split(self._rate_floating(t, supports, y), n)
        R, zero = rotations.matrix(quaternion), jnp.zeros((1, 3), y.dtype)
        frames = frames_of_free_bodies(supports, Frame(p, R, rotate(R, v_B), rotate(R, w_B)))
        a = jnp.concatenate([zero, a, rotate(R, v_rate + cross(w_B, v_B))])
        return frames, a, jnp.concatenate([zero, alpha, rotate(R, w_rate)])

    def scales(self, span: Float[Array, ""]) -> Float[Array, "ny"]:
        """The scale of each component of y: the size of the model, 1 for angles; for velocities these times a fast frequency."""
        model, layout = self.model, self.model.layout
        size = size_of(model)
        rate = jnp.sqrt(self._stiffness_sum() / jnp.sum(model.bodies.rows.mass) + jnp.linalg.norm(model.gravity) / size) + 1 / span
        if not layout.floating:
            return jnp.concatenate([jnp.where(layout.angular, 1.0, size), rate * jnp.where(layout.turns, 1.0, size)])
        n = len(layout.bodies)
        return jnp.concatenate([jnp.full(3 * n, size), jnp.ones(4 * n, size.dtype), jnp.full(3 * n, rate * size), jnp.full(3 * n, rate)])

    def _stiffness_sum(self) -> Float[Array, ""]:
        """The sum over the elements of the largest second derivative of V(e) in the reference pose."""

        def stiffest(element, *frames):
            e = element.deformation(*(f.pose() for f in frames))
            return jnp.max(jnp.abs(jax.hessian(element.energy)(e)))

        reference = frames_of_free_bodies(self.coordinates.supports.at_rest(), self.coordinates.bodies.at_rest())
        largest = each_element(self.model, reference, stiffest)
        return sum((jnp.sum(k) for k in largest), jnp.zeros((), self.model.gravity.dtype))

    def reactions(self, t: Float[Array, ""], q: Float[Array, "nq"], v: Float[Array, "nv"]):
        """Force and moment about its origin that the bodies and elements exert on each support, in world axes."""
        now, first = self.instant(t, State(q, v), reactions=True), self.model.layout.first_body
        assert now.F is not None and now.M is not None
        return now.F[1:first], now.M[1:first]


def frames_of_free_bodies(supports: Frame, bodies: Frame) -> Frame:
    """The table of frames of supports and free bodies."""
    zero = jnp.zeros((1, 3), bodies.p.dtype)
    return stack([Frame(zero, np.eye(3, dtype=zero.dtype)[None], zero, zero), supports, bodies])


def inverse_mass(model: Model) -> Float[Array, "nb 6 6"]:
    """The inverse of [[m I, -m [c]], [m [c], J_C - m [c][c]]], the mass of each body about O (42), from the inverse of J_C, as v_C = v_O -
    [c] w."""
    bodies = model.bodies.rows
    C = skew(bodies.com)
    G = inverse_of_three((bodies.inertia + jnp.swapaxes(bodies.inertia, -1, -2)) / 2)
    CG, GC = product(C, G), product(G, C)
    top = jnp.concatenate([np.eye(3, dtype=C.dtype)[None] / bodies.mass[:, None, None] - product(CG, C), CG], -1)
    return jnp.concatenate([top, jnp.concatenate([-GC, G], -1)], -2)


def outboard_mask(layout: Layout) -> np.ndarray:
    """(n, nb): 1 where a frame carries a body by joints, or is the body's own frame."""
    parent = dict(zip(layout.bodies, layout.parents, strict=True))
    mask = np.zeros((len(layout.frames), len(layout.bodies)))
    for i, name in enumerate(layout.bodies):
        mask[layout.frame(name), i] = 1
        while name in parent:
            name = parent[name]
            mask[layout.frame(name), i] = 1
    return mask


def _split(y: Array, n: int):
    return y[: 3 * n].reshape(n, 3), y[3 * n : 7 * n].reshape(n, 4), y[7 * n : 10 * n].reshape(n, 3), y[10 * n :].reshape(n, 3)


def normalized(model: Model, q: Float[Array, "nq"]) -> Float[Array, "nq"]:
    """q with its quaternions normalized."""
    parts = []
    for name, kind in zip(model.layout.bodies, model.layout.kinds, strict=True):
        part = q[model.layout.q_slices[name]]
        if kind.nq - kind.nv == 1:  # its last four are a quaternion
            part = jnp.concatenate([part[:-4], rotations.normalize(part[-4:])])
        parts.append(part)
    return jnp.concatenate(parts)


def acceleration(model: Model, state: State, t: Any = 0.0, motions: Motions = (), loads: tuple[Load, ...] = ()) -> Float[Array, "nv"]:
    """dv/dt from the equations of motion, in the speeds of the state."""
    return Dynamics(model, motions, loads).acceleration(jnp.asarray(t, state.q.dtype), state.q, state.v)
