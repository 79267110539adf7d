"""How large a model is: the length and the scale of each coordinate against which round-off is measured."""

from __future__ import annotations

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbody.models.models import Model


def size_of(model: Model) -> Float[Array, ""]:
    """A length of the model: the farthest that an element is attached, or a centre of mass lies, from a body's origin; else the longest
    distance from the world's origin; else 1 m."""
    on_bodies, anywhere = [jnp.zeros((1, 3), model.gravity.dtype), model.bodies.rows.com], [model.bodies.rows.position]
    for table in model.elements:
        for end, points in enumerate(table.rows.points):
            on_body = np.array([link[end] in model.layout.bodies for link in table.links])
            on_bodies.append(jnp.where(on_body[:, None], points, 0.0))
            anywhere.append(points)
    near, far = (jnp.max(jnp.linalg.norm(jnp.concatenate(points), axis=-1)) for points in (on_bodies, anywhere))
    return jnp.where(near > 0, near, jnp.where(far > 0, far, 1.0))


def scale_of(model: Model, size: Float[Array, ""]) -> Float[Array, "nv"]:
    """Delta per nondimensional increment: 1 for translations, 1/size for rotations (both in meters then)."""
    return jnp.where(model.layout.turns, 1 / size, 1.0)
