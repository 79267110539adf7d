"""Frames: poses, their velocities, the coordinates (chart) of small displacements, and the frames
of a model at one instant."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry import rotations
from jaxbody.geometry.vectors import cross, product, rotate, rotate_back

# force and moment about the frame's origin, in world axes
Wrench = tuple[Float[Array, "3"], Float[Array, "3"]]


class Pose(eqx.Module):
    """The pose of a frame: position p of its origin in world axes [m] and rotation matrix R, frame
    to world; leading axes are the rows of a table of frames."""

    p: Float[Array, "*n 3"]
    R: Float[Array, "*n 3 3"]

    def __getitem__(self, rows) -> Pose:
        return Pose(*(_rows(x, rows) for x in (self.p, self.R)))

    def point(self, a_B: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Return the world position p + R a of a point fixed in the frame."""
        return self.p + rotate(self.R, a_B)

    def __matmul__(self, other: Pose) -> Pose:
        """Return the pose, in world axes, of `other`, which is given relative to this frame."""
        return Pose(self.point(other.p), product(self.R, other.R))

    def inverse(self) -> Pose:
        return Pose(-rotate_back(self.R, self.p), jnp.swapaxes(self.R, -1, -2))

    def at_rest(self) -> Frame:
        """Return the pose as a frame with zero velocity."""
        return Frame(self.p, self.R, jnp.zeros_like(self.p), jnp.zeros_like(self.p))

    def displaced(self, xi: Float[Array, "*n 6"]) -> Pose:
        """Return the pose after a displacement in the chart of a free frame: xi = (displacement of
        the origin, rotation vector), in world axes; R -> exp([theta]) R."""
        return Pose(self.p + xi[..., :3], product(rotations.exp(xi[..., 3:]), self.R))

    @property
    def quaternion(self) -> Float[Array, "*n 4"]:
        return rotations.from_matrix(self.R)


class Frame(Pose):
    """A pose with its motion: velocity v of the origin [m/s] and angular velocity w [rad/s], in
    world axes."""

    v: Float[Array, "*n 3"]
    w: Float[Array, "*n 3"]

    def velocity(self, a_B: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """Return the world velocity v + w x (R a) of a point fixed in the frame."""
        return self.v + cross(self.w, rotate(self.R, a_B))

    def __getitem__(self, rows) -> Frame:
        return Frame(*(_rows(x, rows) for x in (self.p, self.R, self.v, self.w)))

    def rates(self) -> Pose:
        """Return the time derivative of the pose: (v, [w] R)."""
        return Pose(
            self.v, cross(self.w[..., None, :], jnp.swapaxes(self.R, -1, -2)).swapaxes(-1, -2)
        )

    def pose(self) -> Pose:
        return Pose(self.p, self.R)

    def at_time(self, t: Float[Array, ""], state: Any = None) -> Instant:
        """Return the frame, or table of frames, with the time t [s] and the state of the model."""
        return Instant(self.p, self.R, self.v, self.w, t, state)


class Instant(Frame):
    """The frames of a model, or one of them, at time t [s], with the state of the model: the input
    of loads and sensors. If sensors need them, it has also the accelerations a of the origins, the
    angular accelerations alpha, and the force F and moment M about the origin, in world axes: for
    the world and supports those exerted by the bodies and elements attached to them, for a body
    those that it and all bodies carried by it exert on its joint."""

    t: Float[Array, ""]
    state: Any = None
    a: Float[Array, "*n 3"] | None = None
    alpha: Float[Array, "*n 3"] | None = None
    F: Float[Array, "*n 3"] | None = None
    M: Float[Array, "*n 3"] | None = None

    def frame(self, row: int) -> Instant:
        """Return one frame at this instant."""
        return Instant(
            self.p[row],
            self.R[row],
            self.v[row],
            self.w[row],
            self.t,
            self.state,
            *(None if x is None else x[row] for x in (self.a, self.alpha, self.F, self.M)),
        )

    def changes(self) -> Frame:
        """Return the time derivative of the frames: (v, [w] R, a, alpha)."""
        assert self.a is not None and self.alpha is not None
        rates = self.rates()
        return Frame(rates.p, rates.R, self.a, self.alpha)

    def acceleration(self, row: int, a_B: Float[Array, "3"]) -> Float[Array, "3"]:
        """Return the world acceleration a + alpha x r + w x (w x r), r = R a, of a point fixed in a
        frame."""
        assert self.a is not None and self.alpha is not None
        r, w = rotate(self.R[row], a_B), self.w[row]
        return self.a[row] + cross(self.alpha[row], r) + cross(w, cross(w, r))


def _rows(x: Array, rows: Any) -> Array:
    """Return x[rows]; for an array of rows in two operations, where x[rows] would also test for
    negative rows."""
    return jnp.take(x, rows, 0, mode="clip") if isinstance(rows, np.ndarray) else x[rows]


def stack(frames: list[Frame]) -> Frame:
    """Return one table of frames with the rows of several tables."""
    if len(frames) == 1:
        return frames[0]
    return Frame(
        *(jnp.concatenate([getattr(f, name) for f in frames]) for name in ("p", "R", "v", "w"))
    )
