"""The size of a model: the length and the scales of the coordinates with which round-off is compared."""

from __future__ import annotations

from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, is_concrete
from jaxbody.geometry.vectors import to_rank
from jaxbody.models.models import Model

FEW_SAMPLES, FEW_COORDINATES, SHORT = 1000, 6, 30.0  # up to which, and up to how many seconds, motions are not long


def size_of(model: Model) -> Float[Array, ""]:
    """A length of the model: the largest distance of a point of attachment or a center of mass from the origin of its body; if that is
    zero, the largest distance from the world's origin; if that is zero too, 1 m."""
    xp: Any = np if is_concrete(model) else jnp  # outside of compiled programs no operation of JAX is run
    on_bodies, anywhere = [np.zeros((1, 3), model.gravity.dtype), model.bodies.rows.com], [model.bodies.rows.position]
    for table in (*model.elements, *model.closures):
        for end, points in enumerate(table.rows.points):
            on_body = np.array([link[end] in model.layout.bodies for link in table.links])
            on_bodies.append(xp.where(on_body[:, None], points, 0.0))
            anywhere.append(points)
    near, far = (xp.max(xp.sum(xp.concatenate(points) ** 2, -1)) for points in (on_bodies, anywhere))
    return xp.asarray(xp.sqrt(xp.where(near > 0, near, xp.where(far > 0, far, 1.0))))  # with a derivative where points lie at origins


def is_costly(model: Model) -> bool:
    """Whether each step of a motion or a search takes several times as long, with closures or memory."""
    return bool(model.closures or model.layout.nz)


def take_long(model: Model, *times: Float[Array, "*nt"]) -> bool:
    """Whether motions at these times [s] take so long that their programs are to be optimized."""
    if times and (is_costly(model) or not is_concrete(times)):
        return True
    numbers = max(model.layout.nv, FEW_COORDINATES) * sum(t.size for t in times)
    return numbers > FEW_SAMPLES * FEW_COORDINATES or any(np.ptp(np.asarray(t)) > SHORT for t in times)


def scale_of(model: Model, size: Float[Array, ""]) -> Float[Array, "nv"]:
    """Delta per scaled increment: 1 for translations, 1/size for rotations, so that all increments are in meters."""
    xp: Any = np if is_concrete(size) else jnp
    return xp.where(model.layout.turns, 1 / size, 1.0)


def scaled(A: Any, scale: Any) -> Any:
    """A matrix, or several, of scaled increments: A_ij scale_i scale_j."""
    return A * to_rank(scale[None] * scale[:, None], A.ndim)
