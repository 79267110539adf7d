"""Drawn parts with their pose, scale and color in each frame of an animation, as plain arrays that
do not depend on a renderer, and the camera that sees them."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import product

import numpy as np

from jaxbody.views.scenes.colors import GRAY
from jaxbody.views.scenes.shapes import Mesh, axes_along_lines


@dataclass(frozen=True)
class DrawnPart:
    """A mesh of one color. `p` (n, 3), `R` (n, 3, 3) and `scale` (n, 3) place it in each frame, or
    in all frames if n is 1: x = p + R (scale * vertex)."""

    path: tuple[str, ...]  # group, name, and part of it: ("elements", "AB", "coil")
    mesh: Mesh
    color: str
    p: np.ndarray = field(default_factory=lambda: np.zeros((1, 3)))
    R: np.ndarray = field(default_factory=lambda: np.eye(3)[None])
    scale: np.ndarray = field(default_factory=lambda: np.ones((1, 3)))
    opacity: float = 1.0
    edged: bool = False  # whether its sharp edges are drawn
    below: bool = False  # whether it is a background, without shadow and without names beside it
    # how much nearer it is drawn in pictures [m], so that its body does not hide it
    over: float = 0.0
    framed: bool = True  # whether it has to be in view

    def placed(self, points: np.ndarray, frame: int) -> np.ndarray:
        """Return points (..., 3) of the mesh in world axes."""
        p, R, scale = (x[min(frame, len(x) - 1)] for x in (self.p, self.R, self.scale))
        return (points * scale) @ R.T + p

    def at(self, frame: int) -> Mesh:
        """Return the mesh in world axes in one frame."""
        return Mesh(self.placed(self.mesh.vertices, frame), self.mesh.faces)


@dataclass(frozen=True)
class NameLabel:
    """A name at a point (n, 3) or (1, 3); `kind` is the kind of the named thing: "body", "support"
    or "element", or "title" of one of several animations side by side."""

    path: tuple[str, ...]
    text: str
    p: np.ndarray
    color: str = GRAY
    kind: str = "body"


@dataclass(frozen=True)
class Trail:
    """The path (n, 3) of a point in world axes [m]."""

    path: tuple[str, ...]
    points: np.ndarray
    color: str


@dataclass(frozen=True)
class Animation:
    """Drawn parts and the times at which they are shown: `seconds` of playing of each frame with
    the text of its `clock`; the directions that point `up` and `right` in the view, in world axes,
    and the `size` of the model [m]."""

    seconds: np.ndarray
    clock: tuple[str, ...]
    parts: tuple[DrawnPart, ...]
    labels: tuple[NameLabel, ...]
    trails: tuple[Trail, ...]
    up: np.ndarray
    right: np.ndarray
    size: float
    # direction to the camera: degrees to the right of the front view, and above the horizontal
    seen_from: tuple[float, float] = (32.0, 24.0)
    title: str = ""
    notes: tuple[str, ...] = ()  # scales of motions, arrows and the grid

    @property
    def caption(self) -> str:
        """Title and notes, one a line."""
        return "\n".join(filter(None, (self.title, *self.notes)))

    @property
    def moves(self) -> bool:
        return len(self.seconds) > 1

    @property
    def pauses(self) -> np.ndarray:
        """Time for which each frame is shown [s]; the last one as long as the one before."""
        steps = np.diff(self.seconds)
        return np.append(steps, steps[-1:]) if self.moves else np.zeros(1)

    def part(self, *path: str) -> DrawnPart:
        """Return the part with this path."""
        return next(part for part in self.parts if part.path == path)

    def outline(self) -> np.ndarray:
        """Return the corners (n, 3) of the boxes around the framed parts, in at most 25 frames."""
        frames = np.unique(np.linspace(0, len(self.seconds) - 1, 25).astype(int)).tolist()
        corners = []
        for part in self.parts:
            if part.framed:
                low, high = part.mesh.vertices.min(0), part.mesh.vertices.max(0)
                box = np.array(list(product(*zip(low, high, strict=True))))
                corners += [part.placed(box, i) for i in (frames if len(part.p) > 1 else [0])]
        above = [
            label.p[:1] + 0.3 * self.size * self.up
            for label in self.labels
            if label.kind == "title"
        ]
        return np.concatenate([*corners, *above])

    def shown_at(self, seconds: np.ndarray) -> Animation:
        """Return the animation with frames at other times of playing [s]: at each time, the last
        frame that has begun."""
        rows = np.maximum(np.searchsorted(self.seconds, seconds + 1e-9, side="right") - 1, 0)

        def picked(x: np.ndarray) -> np.ndarray:
            return x[rows] if len(x) > 1 else x

        return replace(
            self,
            seconds=seconds,
            clock=tuple(self.clock[row] for row in rows),
            parts=tuple(
                replace(part, p=picked(part.p), R=picked(part.R), scale=picked(part.scale))
                for part in self.parts
            ),
            labels=tuple(replace(label, p=picked(label.p)) for label in self.labels),
            trails=tuple(replace(trail, points=picked(trail.points)) for trail in self.trails),
        )

    def moved(self, shift: np.ndarray, group: str) -> Animation:
        """Return the animation moved by `shift` (3,) [m], with its parts in a group of this
        name."""
        return replace(
            self,
            parts=tuple(
                replace(part, path=(group, *part.path), p=part.p + shift) for part in self.parts
            ),
            labels=tuple(
                replace(label, path=(group, *label.path), p=label.p + shift)
                for label in self.labels
            ),
            trails=tuple(
                replace(trail, path=(group, *trail.path), points=trail.points + shift)
                for trail in self.trails
            ),
        )


def rod(
    path: tuple[str, ...],
    mesh: Mesh,
    color: str,
    start: np.ndarray,
    end: np.ndarray,
    opacity: float = 1.0,
) -> DrawnPart:
    """Return a part that extends from one point (n, 3) to another in each frame; its mesh has
    length 1 along z."""
    start, end = np.broadcast_arrays(start, end)
    R, length = axes_along_lines(end - start)
    return DrawnPart(
        path,
        mesh,
        color,
        start,
        R,
        np.stack([np.ones_like(length), np.ones_like(length), length], -1),
        opacity,
    )


ANGLE = np.deg2rad(28.0)  # vertical angle of view [rad]
ASPECT = 1.5  # width over height of the picture for which the distance is chosen
FAR = 100.0  # distance of the camera of a parallel projection, relative to the size of the model
FILLED = 0.93  # share of the picture that is used


@dataclass(frozen=True)
class Camera:
    """A camera at `position` that looks at `target`, both in world axes [m]; the columns of `axes`
    point right, up and from the target to the camera. A `parallel` one has no perspective."""

    position: np.ndarray
    target: np.ndarray
    axes: np.ndarray
    parallel: bool = False

    def project(self, points: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Return coordinates (n, 2) to the right and up in a picture plane at distance 1 from the
        camera, or in meters in parallel projection, and depths (n,) [m]."""
        x = (points - self.position) @ self.axes
        depth = -x[:, 2]
        if self.parallel:
            return points @ self.axes[:, :2], depth
        return x[:, :2] / np.where(depth > 0, depth, np.nan)[:, None], depth


def parallel_camera(animation: Animation, axes: np.ndarray) -> Camera:
    """Return the camera for a parallel projection; `axes` as in `Camera`."""
    target = animation.outline().mean(0)
    return Camera(target + FAR * animation.size * axes[:, 2], target, axes, parallel=True)


def camera_for(animation: Animation, direction: np.ndarray | None = None) -> Camera:
    """Return the camera for an animation. `direction`: direction from the scene to the camera, in
    world axes; None takes that of the animation."""
    up, right = animation.up, animation.right
    front = np.cross(right, up)
    aside, above = np.deg2rad(animation.seen_from)
    usual = np.cos(above) * (np.cos(aside) * front + np.sin(aside) * right) + np.sin(above) * up
    z = usual if direction is None else direction / np.linalg.norm(direction)
    x = np.cross(up, z)
    x = right if np.linalg.norm(x) < 1e-6 else x / np.linalg.norm(x)
    axes = np.stack([x, np.cross(z, x), z], -1)
    points = animation.outline()
    low, high = (points @ axes).min(0), (points @ axes).max(0)
    target = axes @ ((low + high) / 2)
    seen = (points - target) @ axes
    half = np.tan(ANGLE / 2) * FILLED
    distance = float(
        np.max(
            seen[:, 2] + np.maximum(np.abs(seen[:, 1]) / half, np.abs(seen[:, 0]) / (ASPECT * half))
        )
    )
    return Camera(target + max(distance, 1e-6 * animation.size) * z, target, axes)
