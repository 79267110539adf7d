"""The size of a model, the scales of the coordinates with which round-off is compared, and ends of
elements that are drawn apart."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, as_numpy, is_concrete
from jaxbody.geometry.points_and_orientations import IDENTITY, matrix
from jaxbody.geometry.vectors import to_rank
from jaxbody.model.elements.bushings import FramePair
from jaxbody.model.elements.torsions import Torsion
from jaxbody.model.models import Model

# up to which, and up to how many seconds, motions are not long
FEW_SAMPLES, FEW_COORDINATES, SHORT = 1000, 6, 30.0
# relative to the size, and degrees: the two frames of a mount are drawn apart
APART, TURNED = 0.05, 5.0


def size_of(model: Model, otherwise: Any = 1.0) -> Float[Array, ""]:
    """A length of the model: the largest distance of a point of attachment or a center of mass from
    the origin of its body; if that is zero, the largest distance from the world's origin; if that
    is zero too, the model has no extent, and `otherwise` [m] is taken."""
    # outside of compiled programs no operation of JAX is run
    xp: Any = np if is_concrete(model) else jnp
    on_bodies, anywhere = (
        [np.zeros((1, 3), model.gravity.dtype), model.bodies.rows.com],
        [model.bodies.rows.position],
    )
    for table in (*model.elements, *model.closures):
        for end, points in enumerate(table.rows.points):
            on_body = np.array([link[end] in model.layout.bodies for link in table.links])
            on_bodies.append(xp.where(on_body[:, None], points, 0.0))
            anywhere.append(points)
    near, far = (
        xp.max(xp.sum(xp.concatenate(points) ** 2, -1)) for points in (on_bodies, anywhere)
    )
    return xp.asarray(
        xp.sqrt(xp.where(near > 0, near, xp.where(far > 0, far, otherwise**2)))
    )  # with a derivative where points lie at origins


def drawn_apart(model: Model) -> list[str]:
    """In words, the mounts whose two frames are drawn apart or turned against each other, so that
    they pull or twist as drawn, and the torsions whose axis at one end is not that at the other."""
    said, most, bodies, supports = (
        [],
        APART * float(size_of(model)),
        model.bodies.rows,
        model.supports.rows,
    )
    count = len(model.layout.supports)  # the table of none has a row
    orientations = np.concatenate([[IDENTITY], supports.orientation[:count], bodies.orientation])
    places = np.concatenate([np.zeros((1, 3)), supports.position[:count], bodies.position])
    poses = dict(
        zip(model.layout.frames, zip(places, map(matrix, orientations), strict=True), strict=True)
    )
    tables: list[Any] = [
        jax.tree.map(as_numpy, table)
        for table in model.elements
        if isinstance(table.rows, FramePair | Torsion)
    ]
    for name, link, element in (
        each for x in tables for each in zip(x.names, x.links, map(x.row, x.names), strict=True)
    ):
        A, B = (poses[end] for end in link)
        turn, apart = A[1] @ matrix(element.orientation) - B[1] @ matrix(element.orientation_b), 0.0
        if isinstance(element, FramePair):
            sine, apart = (
                np.linalg.norm(turn) / 8**0.5,
                float(np.linalg.norm(B[0] + B[1] @ element.b - A[0] - A[1] @ element.a)),
            )
        else:
            sine = np.linalg.norm(turn @ element.axis) / 2
        angle, what = (
            float(2 * np.rad2deg(np.arcsin(min(sine, 1.0)))),
            "is drawn" if isinstance(element, FramePair) else "has axes that are drawn",
        )
        found = [f"{apart:.3g} m apart"] * (apart > most) + [
            f"turned by {angle:.3g} degrees between its ends"
        ] * (angle > TURNED)
        said += [f"{type(element).__name__.lower()} '{name}' {what} {' and '.join(found)}"] * bool(
            found
        )
    return said


def take_long(model: Model, *times: Float[Array, "*nt"]) -> bool:
    """Whether motions at these times [s] take so long that their programs are to be optimized;
    with closures or memory each step takes several times as long."""
    if times and (model.closures or model.layout.nz or not is_concrete(times)):
        return True
    numbers = max(model.layout.nv, FEW_COORDINATES) * sum(t.size for t in times)
    return numbers > FEW_SAMPLES * FEW_COORDINATES or any(
        np.ptp(np.asarray(t)) > SHORT for t in times
    )


def scale_of(model: Model, size: Float[Array, ""]) -> Float[Array, "nv"]:
    """Delta per scaled increment: 1 for translations, 1/size for rotations, so that all increments
    are in meters."""
    xp: Any = np if is_concrete(size) else jnp
    return xp.where(model.layout.turns, 1 / size, 1.0)


def scaled(A: Any, scale: Any) -> Any:
    """A matrix, or several, of scaled increments: A_ij scale_i scale_j."""
    return A * to_rank(scale[None] * scale[:, None], A.ndim)
