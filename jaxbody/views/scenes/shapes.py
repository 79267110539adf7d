"""Shapes of bodies and supports in pictures, given by the user or derived from points, center of
mass and inertia. They do not affect the model."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core.arrays import checked, concrete, vector
from jaxbody.core.errors import JaxbodyError, Problem, Problems, import_extra
from jaxbody.core.source_files import check_file
from jaxbody.geometry.points_and_orientations import IDENTITY, as_quaternion, direction, matrix
from jaxbody.views.scenes.meshes import Mesh, across, box, cylinder, hull, joined, sphere

THICK = 0.014  # half the thickness of a plate or rod, relative to the size of the model
BLOCK = 0.07  # half the edge of the block for a body with a single point
# size of the drawn box, relative to the box of equal mass and inertia; it is smaller, so that
# attached elements stay visible
INNER = 0.55
TENT = 1.5  # least volume of a hull that is a tent, over those of its box and of its points
MOST_POINTS = 4  # a quarter of this, times the spread of the points, limits half an edge


@dataclass(frozen=True)
class Shape:
    """The shape of a body or a support in a view, in the axes of its body, made by `Shape.box`,
    `cylinder`, `sphere`, `hull` or `file`.

    `color` is a color of matplotlib; None takes the default color of the body. `opacity` is between
    0 and 1.

    >>> shape = jb.views.Shape.box([1.2, 0.4, 0.1], center=[0, 0, 0.05], color="tab:blue")
    >>> shape.mesh.vertices.max(0).tolist()
    [0.6, 0.2, 0.1]
    """

    mesh: Mesh
    color: str | None = None
    opacity: float = 1.0

    @classmethod
    def box(
        cls,
        size,
        *,
        center=(0, 0, 0),
        orientation=IDENTITY,
        color: str | None = None,
        opacity: float = 1.0,
    ) -> Shape:
        """Make a box.

        Args:
            size: its edge lengths along x, y, z [m].
            center: its center, in body axes [m].
            orientation: its orientation in the body.
            color, opacity: see `Shape`.

        Errors: NOT_POSITIVE, BAD_SHAPE, NON_FINITE, BAD_QUATERNION, WRONG_KIND."""
        with Problems() as problems:
            size = _positive(size, (3,), "Shape.box size", problems)
            at, q = (
                vector(center, "Shape.box center", problems),
                as_quaternion(orientation, "Shape.box orientation", problems),
            )
            color, opacity = _look(color, opacity, problems)
        return cls(box(size).placed(_known(at), matrix(_known(q))), color, opacity)

    @classmethod
    def cylinder(
        cls,
        radius,
        length,
        *,
        axis=(0, 0, 1),
        center=(0, 0, 0),
        color: str | None = None,
        opacity: float = 1.0,
    ) -> Shape:
        """Make a cylinder.

        Args:
            radius, length: its radius and length [m].
            axis: its direction, in body axes.
            center: its center, in body axes [m].
            color, opacity: see `Shape`.

        Errors: NOT_POSITIVE, ZERO_AXIS, BAD_SHAPE, NON_FINITE, WRONG_KIND."""
        with Problems() as problems:
            r, l = (
                _positive(x, (), f"Shape.cylinder {name}", problems)
                for x, name in ((radius, "radius"), (length, "length"))
            )
            n, at = (
                direction(axis, "Shape.cylinder axis", problems),
                vector(center, "Shape.cylinder center", problems),
            )
            color, opacity = _look(color, opacity, problems)
        return cls(
            cylinder(float(r), -l / 2, l / 2).placed(_known(at), axes_along(_known(n))),
            color,
            opacity,
        )

    @classmethod
    def sphere(
        cls, radius, *, center=(0, 0, 0), color: str | None = None, opacity: float = 1.0
    ) -> Shape:
        """Make a sphere.

        Args:
            radius: its radius [m].
            center: its center, in body axes [m].
            color, opacity: see `Shape`.

        Errors: NOT_POSITIVE, BAD_SHAPE, NON_FINITE, WRONG_KIND."""
        with Problems() as problems:
            r, at = (
                _positive(radius, (), "Shape.sphere radius", problems),
                vector(center, "Shape.sphere center", problems),
            )
            color, opacity = _look(color, opacity, problems)
        return cls(sphere(float(r), 24).placed(_known(at)), color, opacity)

    @classmethod
    def hull(cls, points, *, color: str | None = None, opacity: float = 1.0) -> Shape:
        """Make the convex hull of points (n, 3) that span a volume [m]. Errors: BAD_SHAPE,
        NON_FINITE, WRONG_KIND."""
        with Problems() as problems:
            rows: Any = checked(
                points,
                ((max(np.shape(points)[:1] or (0,), default=0), 3),),
                "Shape.hull points",
                problems,
            )
            color, opacity = _look(color, opacity, problems)
            if rows is not None:
                rows = _known(rows)
                spread = (
                    np.linalg.svd(rows - rows.mean(0), compute_uv=False)
                    if len(rows) > 3
                    else np.zeros(3)
                )
                if not spread[2] > 1e-9 * spread[0]:
                    problems.add(
                        "BAD_SHAPE",
                        "Shape.hull points",
                        "span no volume",
                        value=rows.shape,
                        hint="Give four points or more that are not in one plane, "
                        "or use Shape.box.",
                    )
        return cls(hull(np.asarray(rows)), color, opacity)

    @classmethod
    def file(
        cls,
        path,
        *,
        scale: float = 1.0,
        center=(0, 0, 0),
        orientation=IDENTITY,
        color: str | None = None,
        opacity: float = 1.0,
    ) -> Shape:
        """Read a mesh from a file: STL, OBJ, PLY, GLB and others that trimesh reads (`pip install
        'jaxbody[view]'`).

        Args:
            path: path of the file.
            scale: meters per unit of the file, 1e-3 for millimeters.
            center: position of the file's origin, in body axes [m].
            orientation: orientation of the axes of the file in the body.
            color, opacity: see `Shape`.

        Errors: NO_FILE, UNREADABLE, MISSING_EXTRA, NOT_POSITIVE, BAD_SHAPE, NON_FINITE,
        BAD_QUATERNION, WRONG_KIND."""
        with Problems() as problems:
            factor = _positive(scale, (), "Shape.file scale", problems)
            at, q = (
                vector(center, "Shape.file center", problems),
                as_quaternion(orientation, "Shape.file orientation", problems),
            )
            color, opacity = _look(color, opacity, problems)
        path = Path(path)
        check_file(path)
        trimesh = import_extra("trimesh", "Shape.file")
        try:
            loaded = trimesh.load(path, force="mesh", process=True)
            mesh = Mesh(np.asarray(loaded.vertices, float), np.asarray(loaded.faces))
        except Exception as error:  # any reader of trimesh may fail
            raise JaxbodyError(
                Problem("UNREADABLE", path.name, f"holds no mesh that can be read: {error}", path)
            ) from None
        if not len(mesh.faces):
            raise JaxbodyError(
                Problem(
                    "UNREADABLE",
                    path.name,
                    "holds no triangles",
                    path,
                    hint="Export it as a mesh, such as STL.",
                )
            )
        return cls(mesh.placed(_known(at), matrix(_known(q)), float(factor)), color, opacity)


def axes_along(n: np.ndarray) -> np.ndarray:
    """Return a rotation matrix whose third column is a unit vector."""
    x = across(n)
    return np.stack([x, np.cross(n, x), n], -1)


def solid_of_body(
    points: np.ndarray, com: np.ndarray, mass: float, inertia: np.ndarray, size: float
) -> Mesh:
    """Return the default shape of a body: the hull of its points, of its center of mass and of the
    inner part of the box of equal mass and inertia, all thickened, so that the points lie inside;
    or, where that would be a tent over its points, the box with an arm to each point.

    Args:
        points: attachments and joints, in body axes (n, 3) [m].
        com, mass, inertia: center of mass [m], mass [kg] and inertia [kg m2] of the body.
        size: size of the model [m], for the thickness and for the block of a body with a single
            point.
    """
    every = np.concatenate([points, com[None]])
    spread = np.linalg.norm(every - com, axis=1).max()
    moments, axes = np.linalg.eigh(inertia)
    half = 0.5 * np.sqrt(np.maximum(6 / mass * (moments.sum() - 2 * moments), 0.0))
    if spread < BLOCK * size:
        half = np.clip(half, 0.75 * BLOCK * size, 1.5 * BLOCK * size)
    else:
        half = np.clip(
            INNER * half, THICK * size, np.maximum(0.25 * MOST_POINTS * spread, THICK * size)
        )
    block, thick = box(2 * half).placed(com, axes * np.linalg.det(axes)), THICK * size
    offsets = box([2 * thick] * 3).vertices[:, None]
    whole = hull(np.concatenate([block.vertices, *(every + offsets)]))
    if len(points) < 3 or whole.volume() < TENT * (
        block.volume() + hull(np.concatenate([*(points + offsets)])).volume()
    ):
        return whole
    parts = [block]
    for arm in points - com:
        length = np.linalg.norm(arm)
        if length > thick:
            n, sides = arm / length, [2 * thick, 2 * thick, length + thick]
            parts.append(box(sides).placed(com + 0.5 * (length + thick) * n, axes_along(n)))
    return joined(parts)


def _known(x: Any) -> np.ndarray:
    return np.asarray(concrete(x), float)


def _positive(value: Any, shape: tuple[int, ...], where: str, problems: Problems) -> Any:
    """Return the numbers if all are above zero; otherwise add a problem and return ones."""
    numbers = checked(value, (shape,), where, problems)
    known = None if numbers is None else concrete(numbers)
    if known is not None and not (known > 0).all():
        problems.add(
            "NOT_POSITIVE",
            where,
            f"is {known.tolist()}",
            value=known,
            limit="> 0",
            hint="Give lengths in meters.",
        )
        known = None
    return np.ones(shape) if known is None else np.asarray(known, float)


def _look(color: str | None, opacity: float, problems: Problems) -> tuple[str | None, float]:
    """Check color and opacity and return them. Errors: WRONG_KIND, NOT_A_FRACTION."""
    from matplotlib.colors import is_color_like, to_hex

    if color is not None and not is_color_like(color):
        problems.add(
            "WRONG_KIND",
            "Shape.color",
            f"is {color!r:.60}",
            value=color,
            limit="a color",
            hint='Give a color of matplotlib, such as "tab:blue" or "#1f6fb4".',
        )
        color = None
    if not 0 <= opacity <= 1:
        problems.add(
            "NOT_A_FRACTION",
            "Shape.opacity",
            f"is {opacity!r:.60}",
            value=opacity,
            limit="0 to 1",
            hint="1 is opaque.",
        )
    return None if color is None else to_hex(color), float(opacity)
