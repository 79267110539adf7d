"""The size of a model, scales of its coordinates for comparisons with round-off, and mounts whose
ends are drawn apart."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, as_numpy, is_concrete
from jaxbody.core.compilation.compile_options import OPTIMIZED, QUICK, Options
from jaxbody.geometry.points_and_orientations import IDENTITY, matrix
from jaxbody.geometry.vectors import to_rank
from jaxbody.model.elements.bushings import FramePair
from jaxbody.model.elements.torsions import Torsion
from jaxbody.model.models import Model

# limits up to which a motion is not long: numbers of samples and of coordinates, duration [s]
FEW_SAMPLES, FEW_COORDINATES, SHORT = 1000, 6, 30.0
# distance, relative to the size, and angle [degrees] above which the frames of a mount differ
APART, TURNED = 0.05, 5.0


def size_of(model: Model, otherwise: Any = 1.0) -> Float[Array, ""]:
    """Return a length [m] that represents the size of a model: the largest distance of a point of
    attachment or a center of mass from the origin of its body; if that is zero, the largest
    distance from the world's origin; if that is zero too, `otherwise`."""
    # NumPy outside of compiled programs, so that nothing is compiled
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
    )  # differentiable where all points lie at origins


def drawn_apart(model: Model) -> list[str]:
    """Return a description of each mount whose two frames are drawn apart or turned against each
    other, so that it pulls or twists as drawn, and of each torsion whose axes at its two ends
    differ."""
    bodies, supports = model.bodies.rows, model.supports.rows
    orientations = np.concatenate([[IDENTITY], supports.orientation, bodies.orientation])
    positions = np.concatenate([np.zeros((1, 3)), supports.position, bodies.position])
    rotations = map(matrix, orientations)
    poses = dict(zip(model.layout.frames, zip(positions, rotations, strict=True), strict=True))
    most, descriptions = APART * float(size_of(model)), []
    for table in model.elements:
        if not isinstance(table.rows, FramePair | Torsion):
            continue
        known = jax.tree.map(as_numpy, table)
        for name, ends in zip(table.names, table.links, strict=True):
            element, (p_A, R_A), (p_B, R_B) = known.row(name), *(poses[end] for end in ends)
            turn = R_A @ matrix(element.orientation) - R_B @ matrix(element.orientation_b)
            if isinstance(element, FramePair):
                what, sine = "is drawn", np.linalg.norm(turn) / 8**0.5
                apart = np.linalg.norm(p_B + R_B @ element.b - p_A - R_A @ element.a)
            else:
                what, sine = "has axes that are drawn", np.linalg.norm(turn @ element.axis) / 2
                apart = 0.0
            angle = 2 * np.rad2deg(np.arcsin(min(sine, 1.0)))
            faults = [f"{apart:.3g} m apart"] if apart > most else []
            if angle > TURNED:
                faults.append(f"turned by {angle:.3g} degrees between its ends")
            if faults:
                kind = type(element).__name__.lower()
                descriptions.append(f"{kind} '{name}' {what} {' and '.join(faults)}")
    return descriptions


def options_of_motion(model: Model, *times: Float[Array, "*nt"]) -> Options:
    """Return the compiler options for a simulation at these times [s]: OPTIMIZED for long ones;
    with closures or memory each step takes several times as long."""
    if times and (model.closures or model.layout.nz or not is_concrete(times)):
        return OPTIMIZED
    numbers = max(model.layout.nv, FEW_COORDINATES) * sum(t.size for t in times)
    many = numbers > FEW_SAMPLES * FEW_COORDINATES
    return OPTIMIZED if many or any(np.ptp(np.asarray(t)) > SHORT for t in times) else QUICK


def scale_of(model: Model, size: Float[Array, ""]) -> Float[Array, "nv"]:
    """Return Delta per scaled increment: 1 for translations, 1/size for rotations, so that all
    increments are in meters."""
    xp: Any = np if is_concrete(size) else jnp
    return xp.where(model.layout.turns, 1 / size, 1.0)


def scaled(A: Any, scale: Any) -> Any:
    """Return a matrix, or several, for scaled increments: A_ij scale_i scale_j."""
    return A * to_rank(scale[None] * scale[:, None], A.ndim)
