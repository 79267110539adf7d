"""A model in coordinates and momenta: Hamilton's equations, in which collocation at Gauss points is symplectic.

    q' = B(q) v,   B' p = dT/dv (q, v, t),   p' = dT/dq - d(p . B v)/dq + lift(Q),   B' lift(Q) = Q,   Q the generalized forces

p is conjugate to q; of a quaternion it has four numbers. T and V do not depend on the length of q, so these are Hamilton's equations of H
= p . B v - T + V on the whole space of (q, p), without singularities. |q| is constant and q . p stays zero; a shift of p along q does not
change the motion of the bodies. These invariants are quadratic, as is the angular momentum p x q: Gauss collocation conserves them.
Compare Betsch, Siebert, Int. J. Numer. Meth. Engng 79 (2009) 444; Hairer, Lubich, Wanner, Geometric Numerical Integration, VI.4.
"""

from __future__ import annotations

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry import rotations
from jaxbody.geometry.frames import Frame
from jaxbody.geometry.vectors import cross, rotate, rotate_back
from jaxbody.mechanics.energies import kinetic, wrenches
from jaxbody.mechanics.equations_of_motion import Dynamics, frames_of_free_bodies, normalized
from jaxbody.models.models import Model
from jaxbody.models.states import State
from jaxbody.numerics.small_systems import solve_spd


class Canonical(eqx.Module):
    """A model under imposed motions and loads as y' = f(t, y), y = (q, p); loads and dampers enter by their virtual work."""

    dynamics: Dynamics

    @property
    def model(self) -> Model:
        return self.dynamics.model

    def pack(self, state: State, t: Float[Array, ""]) -> Float[Array, "ny"]:
        supports = self._supports(t)
        momenta = jax.grad(lambda v: kinetic(self.model, self.dynamics.coordinates.frames(state.q, v, supports)))(state.v)
        B, B_transposed = self._tangent(state.q)
        return jnp.concatenate([state.q, _lift(B, B_transposed, momenta)])

    def unpack(self, y: Float[Array, "ny"], t: Float[Array, ""]) -> State:
        q, p = jnp.split(y, 2)
        return State(normalized(self.model, q), self._speeds(q, self._tangent(q)[1](p), self._supports(t))[0])

    def rate(self, t: Float[Array, ""], y: Float[Array, "ny"]) -> Float[Array, "ny"]:
        """dy/dt."""
        q, p = jnp.split(y, 2)
        B, B_transposed = self._tangent(q)
        supports, momenta = self._supports(t), B_transposed(p)
        v, frames, forces = self._speeds(q, momenta, supports)
        F, M = (x[self.model.layout.first_body :] for x in wrenches(self.model, frames, self.dynamics.loads, t))
        gradient = jax.grad(lambda q: jnp.sum(p * self.dynamics.coordinates.rate(q, v)))(q)
        return jnp.concatenate([B(v), _lift(B, B_transposed, forces(F, M)) - gradient])

    def _supports(self, t) -> Frame:
        return self.dynamics.coordinates.supports_moving(self.dynamics.motions, t)

    def _tangent(self, q: Float[Array, "nq"]) -> tuple[Callable, Callable]:
        """The maps v -> B v and p -> B' p."""
        B = lambda v: self.dynamics.coordinates.rate(q, v)  # noqa: E731
        zero = jnp.zeros(self.model.layout.nv, q.dtype)
        return B, lambda p: jax.linear_transpose(B, zero)(p)[0]

    def _speeds(self, q, momenta, supports: Frame) -> tuple[Array, Frame, Callable]:
        """The speeds v whose momenta are B' p, the frames, and Q + B' dT/dq as a function of forces and moments about O on the bodies."""
        if self.model.layout.floating:
            return self._floating(q, momenta, supports)
        coordinates, dynamics = self.dynamics.coordinates, self.dynamics
        frames, axes = coordinates.frames_and_axes(q, jnp.zeros_like(momenta), supports)
        lin, ang = dynamics.jacobian(frames, *axes)
        mass, base_momenta = dynamics.inertia(frames, lin, ang)
        v = solve_spd(mass, momenta - base_momenta)

        def T(q):
            frames = coordinates.frames(q, v, supports)
            return kinetic(self.model, frames), frames

        gradient, frames = jax.grad(T, has_aux=True)(q)
        return v, frames, lambda F, M: self._tangent(q)[1](gradient) + jnp.sum(lin * F[:, None] + ang * M[:, None], (0, 2))

    def _floating(self, q, momenta, supports: Frame):
        """v = R mass_B^-1 R' momenta; B' dT/dq = -(0, v x P + w x H)."""
        q, momenta = q.reshape(-1, 7), momenta.reshape(-1, 2, 3)
        R = rotations.matrix(q[:, 3:])
        assert self.dynamics.inverse_mass is not None
        in_body = rotate_back(R[:, None], momenta).reshape(-1, 1, 6)
        v, w = jnp.moveaxis(rotate(R[:, None], jnp.sum(self.dynamics.inverse_mass * in_body, -1).reshape(-1, 2, 3)), 1, 0)
        gyroscopic = cross(v, momenta[:, 0]) + cross(w, momenta[:, 1])
        frames = frames_of_free_bodies(supports, Frame(q[:, :3], R, v, w))
        return jnp.concatenate([v, w], -1).ravel(), frames, lambda F, M: jnp.concatenate([F, M - gyroscopic], -1).ravel()


def _lift(B: Callable, B_transposed: Callable, Q: Float[Array, "nv"]) -> Float[Array, "nq"]:
    """B (B' B)^-1 Q; B' B is diagonal, 1/4 q . q for a quaternion."""
    return B(Q / B_transposed(B(jnp.ones_like(Q))))
