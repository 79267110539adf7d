"""Frames: poses, their velocities, and the coordinates (chart) of small displacements."""

from __future__ import annotations

import equinox as eqx
import jax.numpy as jnp

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry import rotations
from jaxbody.geometry.vectors import cross, product, rotate, rotate_back

Wrench = tuple[Float[Array, "3"], Float[Array, "3"]]  # force and moment about the frame's origin, in world axes


class Pose(eqx.Module):
    """Position p of a frame's origin and orientation R, frame to world; leading axes are rows of a table."""

    p: Float[Array, "*n 3"]
    R: Float[Array, "*n 3 3"]

    def point(self, a_B: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """World position p + R a of a point fixed in the frame."""
        return self.p + rotate(self.R, a_B)

    def __matmul__(self, other: Pose) -> Pose:
        """The pose of `other`, given in this frame, in the world."""
        return Pose(self.point(other.p), product(self.R, other.R))

    def inverse(self) -> Pose:
        return Pose(-rotate_back(self.R, self.p), jnp.swapaxes(self.R, -1, -2))

    def at_rest(self) -> Frame:
        """The pose as a frame with zero velocity."""
        return Frame(self.p, self.R, jnp.zeros_like(self.p), jnp.zeros_like(self.p))

    def displaced(self, xi: Float[Array, "*n 6"]) -> Pose:
        """The chart of a free frame: xi = (displacement of the origin, rotation vector), in world axes; R -> exp([theta]) R."""
        return Pose(self.p + xi[..., :3], product(rotations.exp(xi[..., 3:]), self.R))

    @property
    def quaternion(self) -> Float[Array, "*n 4"]:
        return rotations.from_matrix(self.R)


class Frame(Pose):
    """A pose with its motion: velocity v of the origin and angular velocity w, in world axes."""

    v: Float[Array, "*n 3"]
    w: Float[Array, "*n 3"]

    def velocity(self, a_B: Float[Array, "*n 3"]) -> Float[Array, "*n 3"]:
        """World velocity v + w x (R a) of a point fixed in the frame."""
        return self.v + cross(self.w, rotate(self.R, a_B))

    def __getitem__(self, rows) -> Frame:
        return Frame(self.p[rows], self.R[rows], self.v[rows], self.w[rows])

    def rates(self) -> Pose:
        """The time derivative of the pose: (v, [w] R)."""
        return Pose(self.v, cross(self.w[..., None, :], jnp.swapaxes(self.R, -1, -2)).swapaxes(-1, -2))

    def pose(self) -> Pose:
        return Pose(self.p, self.R)


def stack(frames: list[Frame]) -> Frame:
    """One table with the rows of several."""
    if len(frames) == 1:
        return frames[0]
    return Frame(*(jnp.concatenate([getattr(f, name) for f in frames]) for name in ("p", "R", "v", "w")))
