"""The state of a model, and the instant that elements, loads and instruments read."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxbody.geometry.frames import Frame
from jaxbody.geometry.vectors import cross, rotate


class State(eqx.Module):
    """Where everything is and how it moves: q the coordinates and v the speeds of the joints, in the order of the bodies; z the states
    that elements carry themselves. For a free body q = (position of O, unit quaternion w, x, y, z), v = (velocity of O, angular
    velocity), world axes. Leading axes are times or samples.

    >>> state = State(q=jnp.array([0.3]), v=jnp.array([0.0]))
    >>> state.z.shape
    (0,)
    """

    q: Float[Array, "*n nq"]
    v: Float[Array, "*n nv"]
    z: Float[Array, "*n nz"]

    def __init__(self, q, v, z=None):
        self.q, self.v = q, v
        self.z = jnp.zeros((*jnp.shape(q)[:-1], 0), jnp.result_type(q)) if z is None else z


class Instant(Frame):
    """The table of frames at one time with the state that it comes from; where instruments ask for them, the accelerations a of origins and
    alpha of the frames, and the force F and moment M about its origin, world axes, that a frame passes on: what bodies and elements exert on world and
    supports, and what a body, with all that it carries, exerts on its joint."""

    state: State
    a: Float[Array, "n 3"] | None = None
    alpha: Float[Array, "n 3"] | None = None
    F: Float[Array, "n 3"] | None = None
    M: Float[Array, "n 3"] | None = None

    def acceleration(self, row: int, a_B: Float[Array, "3"]) -> Float[Array, "3"]:
        """World acceleration a + alpha x r + w x (w x r), r = R a, of a point fixed in a frame."""
        assert self.a is not None and self.alpha is not None
        r, w = rotate(self.R[row], a_B), self.w[row]
        return self.a[row] + cross(self.alpha[row], r) + cross(w, cross(w, r))
