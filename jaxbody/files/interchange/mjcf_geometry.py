"""Geometry of MJCF: orientations, poses, and the mass and inertia of shapes (geoms)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from jaxbody.core.arrays import of_unit_length
from jaxbody.files.interchange.mjcf_documents import Attributes
from jaxbody.geometry.points_and_orientations import IDENTITY, as_quaternion, matrix, product
from jaxbody.model.bodies import Body

DEFAULTS = {
    "quat": IDENTITY,
    "axisangle": (0, 0, 1, 0),
    "xyaxes": (1, 0, 0, 0, 1, 0),
    "zaxis": (0, 0, 1),
}
ORIENTATIONS = (*DEFAULTS, "euler")

DENSITY = 1000.0  # kg/m3, of water
SIZES = {"sphere": 1, "capsule": 2, "cylinder": 2, "ellipsoid": 3, "box": 3}


@dataclass(frozen=True)
class Place:
    """Position and orientation (unit quaternion) of a frame in another."""

    p: np.ndarray
    q: np.ndarray

    @property
    def R(self) -> np.ndarray:
        return matrix(self.q)

    def __matmul__(self, other: Place) -> Place:
        return Place(self.point(other.p), product(self.q, other.q))

    def inverse(self) -> Place:
        return Place(-self.R.T @ self.p, self.q * [1, -1, -1, -1])

    def point(self, x: np.ndarray) -> np.ndarray:
        return self.p + self.R @ x


ORIGIN = Place(np.zeros(3), np.array(IDENTITY))


def about(n: np.ndarray, angle: float) -> np.ndarray:
    """Return the quaternion of a rotation by `angle` [rad] about a direction `n` of any length."""
    return np.array([np.cos(angle / 2), *(np.sin(angle / 2) * n / np.linalg.norm(n))])


def from_z_to(direction: np.ndarray) -> np.ndarray:
    """Return the quaternion of the smallest rotation from the z axis to a direction of any
    length."""
    z = direction / np.linalg.norm(direction)
    n = np.array([-z[1], z[0], 0.0])  # e_z x z
    return about(n if n.any() else np.array([1.0, 0, 0]), np.arctan2(np.linalg.norm(n), z[2]))


def place_of(a: Attributes, degrees: bool, sequence: str) -> Place:
    """Return the place of an element, from `pos` and one of `quat`, `axisangle`, `xyaxes`, `zaxis`,
    `euler`, or from `fromto`: its midpoint, with the z axis along it.

    Errors: DUPLICATE_NAME for two orientations, ZERO_AXIS, those of numbers."""
    if "fromto" in a:
        ends = a.row("fromto", np.zeros(6), (6,)).reshape(2, 3)
        along = ends[0] - ends[1]
        if not along.any():
            a.problems.add(
                "ZERO_AXIS",
                f"{a.where} fromto",
                "has length zero",
                value=ends,
                limit="> 0",
                hint="Give two different points.",
            )
            return ORIGIN
        return Place(ends.mean(0), from_z_to(along))
    given = [name for name in ORIENTATIONS if name in a]
    if len(given) > 1:
        a.problems.add(
            "DUPLICATE_NAME",
            a.where,
            f"has {' and '.join(given)}",
            value=given,
            limit="one orientation",
        )
    return Place(
        a.vector("pos"), _orientation(a, given[0], degrees, sequence) if given else ORIGIN.q
    )


def _orientation(a: Attributes, name: str, degrees: bool, sequence: str) -> np.ndarray:
    unit = np.pi / 180 if degrees else 1.0
    if name == "euler":
        return _turned(a.vector("euler") * unit, sequence)
    row = a.row(name, DEFAULTS[name], (len(DEFAULTS[name]),))
    if not (row if name == "quat" else row[:3]).any() or (name == "xyaxes" and not row[3:].any()):
        a.problems.add(
            "ZERO_AXIS",
            f"{a.where} {name}",
            "has length zero",
            value=row,
            limit="> 0",
            hint="Give a direction.",
        )
        return ORIGIN.q
    match name:
        case "quat":
            return of_unit_length(row)
        case "axisangle":
            return about(row[:3], row[3] * unit)
        case "zaxis":
            return from_z_to(row)
    x = row[:3] / np.linalg.norm(row[:3])
    z = np.cross(x, row[3:])
    if not z.any():
        a.problems.add(
            "ZERO_AXIS",
            f"{a.where} xyaxes",
            "has parallel axes",
            value=row,
            limit="two different axes",
        )
        return ORIGIN.q
    z = z / np.linalg.norm(z)
    return as_quaternion(np.stack([x, np.cross(z, x), z], -1), f"{a.where} xyaxes", a.problems)


def _turned(angles: np.ndarray, sequence: str) -> np.ndarray:
    """Return the quaternion of successive rotations [rad] about axes that rotate with the frame
    (lower-case letters) or are fixed (capitals)."""
    q = ORIGIN.q
    for letter, angle in zip(sequence, angles, strict=True):
        turn = about(np.eye(3)["xyz".index(letter.lower())], angle)
        q = product(q, turn) if letter.islower() else product(turn, q)
    return q


def solid(a: Attributes, place: Place) -> Body | None:
    """Return the body of a geom, from its mass or density; None if it has no mass.

    Errors: MISSING_ENTRY for a mesh, whose volume is not computed, WRONG_KIND,
    BAD_SHAPE, NEGATIVE."""
    kind = "mesh" if "mesh" in a else a.text("type", "sphere")
    stated = a.number("mass") if "mass" in a else None
    if (
        kind in ("plane", "hfield")
        or stated == 0
        or (stated is None and a.number("density", DENSITY) == 0)
    ):
        return None
    if kind not in SIZES or a.flag("shellinertia"):
        a.problems.add(
            "MISSING_ENTRY",
            a.where,
            ("is a shell" if kind in SIZES else f"has the type {kind}")
            + ", whose inertia is not computed",
            value=kind,
            limit=", ".join(SIZES),
            hint='Give its body an element "inertial", or this geom the mass 0.',
        )
        return None
    half = _half_sizes(a, kind)
    if half is None:
        return None
    volume, squares = SHAPES[kind](*half)
    mass = a.number("density", DENSITY) * volume if stated is None else stated
    if mass < 0:
        a.problems.add("NEGATIVE", a.where, f"has the mass {mass:g} kg", value=mass, limit=">= 0")
        return None
    return Body(mass, mass * np.array(squares), position=place.p, orientation=place.q)


def _half_sizes(a: Attributes, kind: str) -> np.ndarray | None:
    """Return the radius and half lengths [m] of a shape; with `fromto`, the half length is that of
    the line. If the sizes are wrong, add a problem and return None."""
    size = a.row("size")
    if "fromto" in a and kind != "sphere":
        half = np.linalg.norm(np.diff(a.row("fromto", np.zeros(6), (6,)).reshape(2, 3), axis=0)) / 2
        size = np.array(
            [*size[:1], *size[:1], half] if kind in ("box", "ellipsoid") else [*size[:1], half]
        )
    size = size[: SIZES[kind]]
    if len(size) < SIZES[kind] or not (size > 0).all():
        a.problems.add(
            "BAD_SHAPE",
            f"{a.where} size",
            f"is '{a.text('size')}'",
            value=a.text("size"),
            limit=f"{SIZES[kind]} above 0",
        )
        return None
    return size


def _capsule(r, h):
    """Return volume and squared radii of gyration of a cylinder of radius r and length 2 h with a
    half sphere at each end; the share of the two half spheres in the mass is 4 r / (4 r + 6 h)."""
    ends, length = 4 * r / (4 * r + 6 * h), 2 * h
    across = (1 - ends) * (3 * r**2 + length**2) / 12 + ends * (
        2 / 5 * r**2 + length * (3 * r + 2 * length) / 8
    )
    return np.pi * r**2 * (4 / 3 * r + length), [
        across,
        across,
        (1 - ends) * r**2 / 2 + ends * 2 / 5 * r**2,
    ]


def _cylinder(r, h):
    return 2 * np.pi * r**2 * h, [(3 * r**2 + 4 * h**2) / 12, (3 * r**2 + 4 * h**2) / 12, r**2 / 2]


def _ellipsoid(a, b, c):
    return 4 / 3 * np.pi * a * b * c, [(b**2 + c**2) / 5, (a**2 + c**2) / 5, (a**2 + b**2) / 5]


def _box(a, b, c):
    return 8 * a * b * c, [(b**2 + c**2) / 3, (a**2 + c**2) / 3, (a**2 + b**2) / 3]


# functions that return the volume [m3] and the squared radii of gyration [m2] of a shape
SHAPES: dict[str, Callable[..., tuple[float, list[float]]]] = {
    "sphere": lambda r: _ellipsoid(r, r, r),
    "capsule": _capsule,
    "cylinder": _cylinder,
    "ellipsoid": _ellipsoid,
    "box": _box,
}
