"""The state of a model, and the motion of all frames at one instant."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry.fields import field
from jaxbody.geometry.frames import Frame
from jaxbody.geometry.vectors import cross, rotate


class State(eqx.Module):
    """Coordinates q and speeds v of the joints, in the order of the bodies, and internal states z of elements. For a free body
    q = (position of O, unit quaternion w, x, y, z), v = (velocity of O, angular velocity), in world axes. Leading axes are times or
    samples.

    >>> state = State(q=jnp.array([0.3]), v=jnp.array([0.0]))
    >>> state.z.shape
    (0,)
    """

    q: Float[Array, "*n nq"] = field("", "configuration")
    v: Float[Array, "*n nv"] = field("", "speeds")
    z: Float[Array, "*n nz"] = field()

    def __init__(self, q, v, z=None):
        self.q, self.v = q, v
        self.z = jnp.zeros((*jnp.shape(q)[:-1], 0), jnp.result_type(q)) if z is None else z

    def named(self) -> State:
        """The parts that have names in paths: q and v."""
        return eqx.tree_at(lambda state: state.z, self, None)


class Instant(Frame):
    """The frames at one time and their state; if instruments need them, also the accelerations a of the origins, the angular
    accelerations alpha, and the force F and moment M about the origin, in world axes: for world and supports those that bodies and elements
    exert on them, for a body those that it and all bodies that it carries exert on its joint."""

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
