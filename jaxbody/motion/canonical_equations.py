"""A model in coordinates and momenta: Hamilton's equations, in which collocation at Gauss points
is symplectic.

    q' = B(q) v,   B' p = dT/dv (q, v, t),   p' = dT/dq - d(p . B v)/dq + lift(Q),   B' lift(Q) = Q,
    Q the generalized forces

p is conjugate to q; of a quaternion it has four numbers. T and V do not depend on the length of q,
so these are Hamilton's equations of H = p . B v - T + V on the whole space of (q, p), without
singularities. |q| is constant and q . p stays zero; a shift of p along q does not change the motion
of the bodies. These invariants are quadratic, as is the angular momentum p x q: Gauss collocation
conserves them. Compare Betsch, Siebert, Int. J. Numer. Meth. Engng 79 (2009) 444; Hairer, Lubich,
Wanner, Geometric Numerical Integration, VI.4.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry.frames import Frame
from jaxbody.lagrange import kinetic
from jaxbody.mechanics.dynamics import Dynamics
from jaxbody.model.joints.frame_tables import exerted, wrenches
from jaxbody.model.models import Model
from jaxbody.model.states import State


class Canonical(eqx.Module):
    """A model under imposed motions and loads as y' = f(t, y), y = (q, p); loads and dampers enter
    by their virtual work."""

    dynamics: Dynamics

    @property
    def model(self) -> Model:
        return self.dynamics.model

    def pack(self, state: State, t: Float[Array, ""]) -> Float[Array, "ny"]:
        supports = self._supports(t)
        momenta = jax.grad(
            lambda v: kinetic(self.model, self.dynamics.coordinates.frames(state.q, v, supports))
        )(state.v)
        return jnp.concatenate([state.q, self._lift(state.q, momenta)])

    def unpack(self, y: Float[Array, "ny"], t: Float[Array, ""]) -> State:
        q, p = jnp.split(y, 2)
        momenta = self.dynamics.coordinates.rate_transposed(q, p)
        return State(
            self.model.layout.normalized(q), self.dynamics.speeds(q, momenta, self._supports(t))[0]
        )

    def rate(self, t: Float[Array, ""], y: Float[Array, "ny"]) -> Float[Array, "ny"]:
        """Return dy/dt."""
        q, p = jnp.split(y, 2)
        coordinates = self.dynamics.coordinates
        v, frames, slope, generalized = self.dynamics.speeds(
            q, coordinates.rate_transposed(q, p), self._supports(t)
        )
        now = frames.at_time(t, State(q, v))
        acting = exerted(self.model, now, self.dynamics.loads)
        F, M = (x[self.model.layout.first_body :] for x in wrenches(self.model, now, acting))
        gradient = jax.grad(lambda q: jnp.sum(p * coordinates.rate(q, v)))(q)
        return jnp.concatenate(
            [coordinates.rate(q, v), self._lift(q, generalized(F, M) + slope) - gradient]
        )

    def _supports(self, t) -> Frame:
        return self.dynamics.coordinates.supports_moving(self.dynamics.motions, t)

    def _lift(self, q: Float[Array, "nq"], Q: Float[Array, "nv"]) -> Float[Array, "nq"]:
        """Return generalized forces or momenta conjugate to q' from those conjugate to v, Q:
        B (B' B)^-1 Q, with q' = B v; B' B is diagonal, 1/4 q . q for a quaternion."""
        rate = self.dynamics.coordinates.rate
        return rate(q, Q / self.dynamics.coordinates.rate_transposed(q, rate(q, jnp.ones_like(Q))))
