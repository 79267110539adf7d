"""Triangles to pixels: each pixel has the color of the nearest triangle, all of them at once
in NumPy."""

from __future__ import annotations

import numpy as np

MOST = 3_000_000  # pixels that are tried at once
# of triangles: pixel, nearness, and number of the triangle
Fragments = tuple[np.ndarray, np.ndarray, np.ndarray]


class Raster:
    """A picture of height x width pixels, white at first."""

    def __init__(self, height: int, width: int):
        self.height, self.width = height, width
        self.colors = np.full((height * width, 3), 255, np.uint8)
        self.nearest = np.zeros(height * width, np.float32)  # 1/depth

    def draw(self, corners: np.ndarray, depths: np.ndarray, colors: np.ndarray) -> None:
        """Draw opaque triangles.

        Args:
            corners: (f, 3, 2), in pixels from the lower left, counterclockwise.
            depths: (f, 3), distances from the camera.
            colors: (f, 3), from 0 to 1."""
        pixel, nearness, owner = self._fragments(corners, depths)
        np.maximum.at(self.nearest, pixel, nearness)
        seen = nearness >= self.nearest[pixel]
        self.colors[pixel[seen]] = np.round(255 * colors).astype(np.uint8)[owner[seen]]

    def blend(
        self, corners: np.ndarray, depths: np.ndarray, colors: np.ndarray, opacity: np.ndarray
    ) -> None:
        """Draw translucent triangles (opacity (f,)) over what has been drawn; of several in a pixel
        the nearest counts."""
        pixel, nearness, owner = self._fragments(corners, depths)
        top = self.nearest.copy()
        np.maximum.at(top, pixel, nearness)
        seen = (nearness >= top[pixel]) & (nearness > self.nearest[pixel])
        pixel, owner = pixel[seen], owner[seen]
        share = opacity[owner, None]
        self.colors[pixel] = np.round(
            share * 255 * colors[owner] + (1 - share) * self.colors[pixel]
        ).astype(np.uint8)

    def picture(self) -> np.ndarray:
        """The pixels (height, width, 3), from the top."""
        return self.colors.reshape(self.height, self.width, 3)[::-1]

    def _fragments(self, corners: np.ndarray, depths: np.ndarray) -> Fragments:
        """The pixels whose middles are inside of triangles."""
        found: list[Fragments] = []
        size = np.array([self.width, self.height])
        low = np.clip(np.floor(corners.min(1)), 0, size).astype(int)
        high = np.clip(np.ceil(corners.max(1)), 0, size).astype(int)
        extent = (high - low).max(1)
        for step in 2 ** np.arange(12):
            rows = np.flatnonzero(
                (extent > step // 2) & (extent <= step) & ((high - low) > 0).all(1)
            )
            for part in np.array_split(rows, max(1, -(-len(rows) * step**2 // MOST))):
                if len(part):
                    found.append(
                        self._inside(part, corners[part], depths[part], low[part], int(step))
                    )
        if not found:
            return np.zeros(0, int), np.zeros(0, np.float32), np.zeros(0, int)
        pixel, nearness, owner = (np.concatenate(column) for column in zip(*found, strict=True))
        return pixel, nearness, owner

    def _inside(
        self, rows: np.ndarray, corners: np.ndarray, depths: np.ndarray, low: np.ndarray, step: int
    ) -> Fragments:
        """Those of triangles whose boxes begin at `low` (f, 2) and are at most `step` wide
        and high."""
        dy, dx = (x.ravel() for x in np.mgrid[:step, :step])
        x, y = np.stack([dx, dy]).astype(np.float32) + 0.5
        corner = (corners - low[:, None]).astype(np.float32)  # small numbers: no digits are lost
        areas = []
        # twice the area of the triangle of these corners and the pixel
        for one, other in ((1, 2), (2, 0), (0, 1)):
            d, at = corner[:, other] - corner[:, one], corner[:, one]
            areas.append(
                d[:, :1] * y - d[:, 1:] * x + (d[:, 1] * at[:, 0] - d[:, 0] * at[:, 1])[:, None]
            )
        inside = (areas[0] >= 0) & (areas[1] >= 0) & (areas[2] >= 0)
        cut = (low + step > [self.width, self.height]).any(1)
        inside[cut] &= (low[cut, :1] + dx < self.width) & (low[cut, 1:] + dy < self.height)
        k, j = np.nonzero(inside)
        a, b, c = (area[k, j] for area in areas)
        near = (1 / depths).astype(np.float32)[k]  # linear in the picture
        nearness = (a * near[:, 0] + b * near[:, 1] + c * near[:, 2]) / np.maximum(
            a + b + c, np.finfo(np.float32).tiny
        )
        return (
            (low[:, 1] * self.width + low[:, 0])[k] + (dy * self.width + dx)[j],
            nearness,
            rows[k],
        )
