"""Places of frames in frames: positions and orientations in NumPy, for files of MuJoCo."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxbody.geometry.points_and_orientations import IDENTITY, matrix, product


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
