"""Shapes in pictures: triangle meshes of solids, coils, wheels, arrows and ribbons, of which those
that are stretched in a drawing have length 1 along z; and the shapes of bodies and supports, meshes
of the user or derived from points, center of mass and inertia. They do not affect the model."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np

ROUND = 24  # sides of a circle
SHARP = np.cos(np.deg2rad(35))  # edges between faces at a larger angle are drawn


class Mesh(NamedTuple):
    """Vertices (v, 3) and triangles (f, 3), counterclockwise as seen from outside."""

    vertices: np.ndarray
    faces: np.ndarray

    def placed(
        self, p: np.ndarray, R: np.ndarray | None = None, scale: float | np.ndarray = 1.0
    ) -> Mesh:
        """Return the mesh scaled, then rotated, then moved by p."""
        scaled = self.vertices * scale
        return Mesh((scaled if R is None else scaled @ R.T) + p, self.faces)

    def normals(self) -> np.ndarray:
        """Return the unit normals of the triangles; zero for a triangle without area."""
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        n = np.cross(b - a, c - a)
        length = np.linalg.norm(n, axis=-1, keepdims=True)
        return n / np.where(length > 0, length, 1.0)

    def volume(self) -> float:
        a, b, c = np.moveaxis(self.vertices[self.faces], 1, 0)
        return float(np.sum(np.cross(a, b) * c)) / 6

    def edges(self) -> tuple[np.ndarray, np.ndarray]:
        """Return the pairs of vertices (e, 2) of sharp edges and of edges of a single triangle, and
        the two triangles of each (e, 2)."""
        pairs = np.sort(
            np.concatenate([self.faces[:, [0, 1]], self.faces[:, [1, 2]], self.faces[:, [2, 0]]]),
            axis=1,
        )
        owners = np.tile(np.arange(len(self.faces)), 3)
        unique, inverse, count = np.unique(pairs, axis=0, return_inverse=True, return_counts=True)
        order = np.argsort(inverse.ravel(), kind="stable")
        first = np.concatenate([[0], np.cumsum(count)[:-1]])
        n = self.normals()
        one, other = owners[order[first]], owners[order[first + (count > 1)]]
        sharp = (count == 1) | (np.sum(n[one] * n[other], -1) < SHARP)
        return unique[sharp], np.stack([one, other], -1)[sharp]


def joined(meshes: Sequence[Mesh]) -> Mesh:
    """Return one mesh of several."""
    starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
    faces = [mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]
    return Mesh(np.concatenate([mesh.vertices for mesh in meshes]), np.concatenate(faces))


def hull(points: np.ndarray) -> Mesh:
    """Return the convex hull of points that span a volume."""
    from scipy.spatial import ConvexHull

    solid = ConvexHull(points - points.mean(0), qhull_options="QJ")
    used, faces = np.unique(solid.simplices, return_inverse=True)
    vertices, faces = points[used], faces.reshape(-1, 3)
    a, b, c = np.moveaxis(vertices[faces], 1, 0)
    inward = np.sum(np.cross(b - a, c - a) * solid.equations[:, :3], -1) < 0
    faces[inward] = faces[inward][:, ::-1]
    return Mesh(vertices, faces)


def box(size: np.ndarray | Sequence[float]) -> Mesh:
    """Return a box with these edge lengths, centered at the origin."""
    corners = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    quads = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    return Mesh(
        corners * size, np.array([face for a, b, c, d in quads for face in ((a, b, c), (a, c, d))])
    )


def revolved(profile: np.ndarray, sides: int = ROUND) -> Mesh:
    """Return the surface of a profile revolved about z. Its rows are (radius, z), with z rising
    along the outside; it ends on the axis, or where it starts."""
    closed = np.array_equal(profile[0], profile[-1])
    angle = 2 * np.pi * np.arange(sides) / sides
    circle = np.stack([np.cos(angle), np.sin(angle)], -1)
    rows = profile[:-1] if closed else profile
    rings = [
        np.array([[r, 0.0, z]])
        if r == 0
        else np.concatenate([r * circle, np.full((sides, 1), z)], -1)
        for r, z in rows
    ]
    starts = np.cumsum([0, *(len(ring) for ring in rings)])
    around = [
        start + (np.arange(sides) if len(ring) > 1 else np.zeros(sides, int))
        for start, ring in zip(starts, rings, strict=False)
    ]
    around = np.array([*around, around[0]] if closed else around)
    return Mesh(np.concatenate(rings), _between(around))


def _between(rings: np.ndarray) -> np.ndarray:
    """Return triangles between successive rings of vertices, given by their indices (n, sides); a
    ring of one vertex repeats its index."""
    a, d = rings[:-1], rings[1:]
    b, c = np.roll(a, -1, axis=1), np.roll(d, -1, axis=1)
    faces = np.stack([np.stack([a, b, c], -1), np.stack([a, c, d], -1)]).reshape(-1, 3)
    return faces[(faces != np.roll(faces, 1, axis=1)).all(1)]  # a ring of one vertex has no sides


def cylinder(radius: float, low: float = 0.0, high: float = 1.0, sides: int = ROUND) -> Mesh:
    """Return a cylinder about z."""
    return revolved(np.array([[0, low], [radius, low], [radius, high], [0, high]]), sides)


def sphere(radius: float, sides: int = 16) -> Mesh:
    """Return a ball centered at the origin."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, sides // 2 + 1)
    profile = radius * np.stack([np.cos(angle), np.sin(angle)], -1)
    profile[[0, -1], 0] = 0
    return revolved(profile, sides)


def arrow(radius: float, head: float) -> Mesh:
    """Return an arrow from 0 to 1 along z. `head`: length of the head, relative to the arrow."""
    return revolved(
        np.array([[0, 0], [radius, 0], [radius, 1 - head], [2.6 * radius, 1 - head], [0, 1]]), 12
    )


def ring(inner: float, outer: float, low: float, high: float) -> Mesh:
    """Return a tube about z between two radii."""
    return revolved(
        np.array([[inner, low], [outer, low], [outer, high], [inner, high], [inner, low]])
    )


def tyre(radius: float, width: float) -> Mesh:
    """Return a tyre about z with rounded shoulders and an opening for the rim."""
    r, w = radius, width / 2
    bead, shoulder = 0.62 * r, 0.10 * r
    half = np.array(
        [
            [bead, 0.8 * w],
            [bead + shoulder, w],
            [r - shoulder, w],
            [r - 0.3 * shoulder, 0.85 * w],
            [r, 0.55 * w],
        ]
    )
    return revolved(np.concatenate([half * [1, -1], half[::-1], half[:1] * [1, -1]]), 36)


def wire(path: np.ndarray, radius: float, sides: int = 6) -> Mesh:
    """Return a round wire along a path (n, 3), closed at its ends."""
    R, _ = axes_along_lines(np.gradient(path, axis=0))
    angle = 2 * np.pi * np.arange(sides)[:, None, None] / sides
    rim = np.cos(angle) * R[..., 0] + np.sin(angle) * R[..., 1]
    rings = np.moveaxis(path + radius * rim, 0, 1).reshape(-1, 3)
    around = np.arange(len(rings)).reshape(-1, sides)
    ends = np.repeat([[len(rings)], [len(rings) + 1]], sides, axis=1)  # the middles of both ends
    vertices = np.concatenate([rings, path[[0, -1]]])
    return Mesh(vertices, _between(np.stack([ends[0], *around, ends[1]])))


def coil(radius: float, thickness: float, length: float, turns: int, points: int = 14) -> Mesh:
    """Return a coil spring about z with straight ends, from z = 0 to 1; its wire is round if it is
    stretched to `length`."""
    straight, lead = 0.08, 0.5  # share of the length, and turns over which the radius grows
    angle = np.linspace(0, turns, turns * points + 1)
    r = radius * np.clip(np.minimum(angle, turns - angle) / lead, 0, 1)
    z = straight + (1 - 2 * straight) * angle / turns
    helix = np.stack([r * np.cos(2 * np.pi * angle), r * np.sin(2 * np.pi * angle), length * z], -1)
    path = np.concatenate(
        [
            [[0, 0, 0], [0, 0, 0.6 * straight * length]],
            helix,
            [[0, 0, (1 - 0.6 * straight) * length], [0, 0, length]],
        ]
    )
    mesh = wire(path, thickness)
    vertices = mesh.vertices / [1, 1, length]
    return Mesh(vertices * [1, 1, 0] + np.clip(vertices * [0, 0, 1], 0, 1), mesh.faces)


def spiral(inner: float, outer: float, thickness: float, turns: float = 2.5) -> Mesh:
    """Return a flat spiral about z, for a torsion spring."""
    s = np.linspace(0, 1, 64)
    r, angle = inner + (outer - inner) * s, 2 * np.pi * turns * s
    return wire(np.stack([r * np.cos(angle), r * np.sin(angle), 0 * s], -1), thickness)


def ribbon(x: np.ndarray, z: np.ndarray, width: float) -> Mesh:
    """Return a strip along x at the heights z, facing up."""
    y = np.full_like(x, width / 2)
    vertices = np.concatenate([np.stack([x, -y, z], -1), np.stack([x, y, z], -1)])
    a = np.arange(len(x) - 1)
    right, left = (
        np.stack([a, a + 1, len(x) + a + 1], -1),
        np.stack([a, len(x) + a + 1, len(x) + a], -1),
    )
    return Mesh(vertices, np.concatenate([right, left]))


def slab(x: np.ndarray, z: np.ndarray, width: float, thickness: float) -> Mesh:
    """Return a strip along x at the heights z, with sides down to `thickness` below the lowest
    height."""
    top, n = ribbon(x, z, width), len(x)
    foot = np.full(n, z.min() - thickness)
    sides = []
    for sign in (-1, 1):
        y = np.full(n, sign * width / 2)
        wall = np.concatenate([np.stack([x, y, foot], -1), np.stack([x, y, z], -1)])
        sides.append(Mesh(wall, top.faces if sign < 0 else top.faces[:, ::-1]))
    return joined([top, *sides])


def across(direction: np.ndarray) -> np.ndarray:
    """Return a unit vector perpendicular to a unit vector, near the world axis least aligned with
    it."""
    least = np.eye(3)[int(np.argmin(np.abs(direction)))]
    rest = least - (least @ direction) * direction
    return rest / np.linalg.norm(rest)


def axes_along_lines(d: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return axes (n, 3, 3) whose third columns are along d (n, 3), turned from frame to frame as
    little as possible, and the lengths (n,).

    A line without length keeps the axes of the frame before."""
    length = np.linalg.norm(d, axis=-1)
    axis, side = np.empty((2, len(d), 3))
    known = length > 0
    u = d[np.argmax(known)] / length[np.argmax(known)] if known.any() else np.array([0.0, 0.0, 1.0])
    x = across(u)
    for i, (row, l) in enumerate(zip(d, length, strict=True)):
        u = row / l if l > 0 else u
        rest = x - (x @ u) * u
        norm = np.linalg.norm(rest)
        x = rest / norm if norm > 1e-6 else across(u)
        axis[i], side[i] = u, x
    return np.stack([side, np.cross(axis, side), axis], -1), length


THICK = 0.014  # half the thickness of a plate or rod, relative to the size of the model
BLOCK = 0.07  # half the edge of the block for a body with a single point
# size of the drawn box, relative to the box of equal mass and inertia; it is smaller, so that
# attached elements stay visible
INNER = 0.55
TENT = 1.5  # least volume of a hull that is a tent, over those of its box and of its points
MOST_POINTS = 4  # a quarter of this, times the spread of the points, limits half an edge


class Shape(NamedTuple):
    """A shape of a body or a support in a view, in the axes of its body [m]; without a color it has
    that of the body."""

    mesh: Mesh
    color: str | None = None
    opacity: float = 1.0


def shape_of(given: Any) -> Shape | None:
    """Return a mesh of trimesh, or another object with vertices and faces, as a shape with the
    color and the opacity of its faces, if they have any; None if it has no triangles."""
    vertices, faces = (np.asarray(getattr(given, name, ())) for name in ("vertices", "faces"))
    if not faces.size or not vertices.shape[1:] == faces.shape[1:] == (3,):
        return None
    visual: Any = getattr(given, "visual", None)
    mesh = Mesh(vertices.astype(float), faces)
    if getattr(visual, "kind", None) not in ("face", "vertex"):
        return Shape(mesh)
    *color, alpha = (int(x) for x in visual.main_color)
    return Shape(mesh, "#" + bytes(color).hex(), alpha / 255)


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
