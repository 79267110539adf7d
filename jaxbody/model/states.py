"""The state of a model."""

import equinox as eqx
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float, numbers
from jaxbody.geometry.fields import field


class State(eqx.Module):
    """The state of a model: coordinates q and speeds v of the joints, in the order of the bodies,
    and states z of elements with memory, in the order of `model.layout.states`. For a free body q =
    (position of O, unit quaternion w, x, y, z), v = (velocity of O, angular velocity), in world
    axes. Leading axes are times or samples. Lists are accepted. Error: NOT_A_NUMBER.

    If z is omitted although elements have memory, they are at rest in this configuration: branches
    are relaxed, hysteresis is 0.

    >>> state = jb.State(q=[0.3], v=[0.0])
    >>> state.q.shape, state.z.shape
    ((1,), (0,))
    """

    q: Float[Array, "*n nq"] = field("", "configuration")
    v: Float[Array, "*n nv"] = field("", "speeds")
    z: Float[Array, "*n nz"] = field()

    def __init__(self, q, v, z=None):
        self.q, self.v = numbers(q, "State.q"), numbers(v, "State.v")
        self.z = (
            jnp.zeros((*self.q.shape[:-1], 0), jnp.result_type(self.q))
            if z is None
            else numbers(z, "State.z")
        )
