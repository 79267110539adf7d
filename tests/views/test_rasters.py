"""Triangles to pixels: areas, the nearest in front in perspective, translucent colors, no cracks
between neighbors."""

import numpy as np
import pytest

from jaxbody.views.scenes.drawn_frames import Raster

RED, BLUE = np.array([[1.0, 0, 0]]), np.array([[0, 0, 1.0]])


def square(x0, x1, y0, y1):
    corners = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]], float)
    return corners[[[0, 1, 2], [0, 2, 3]]]


def colored(picture, color):
    return np.all(picture == np.round(255 * color[0]).astype(np.uint8), axis=-1)


def test_a_triangle_covers_its_area_and_stays_in_the_picture():
    raster = Raster(80, 100)
    corners = np.array(
        [[[10.0, 10.0], [90.0, 20.0], [30.0, 70.0]], [[-50.0, -50.0], [5.0, -50.0], [-50.0, 5.0]]]
    )
    raster.draw(corners, np.ones((2, 3)), np.repeat(RED, 2, 0))
    (ax, ay), (bx, by) = corners[0, 1] - corners[0, 0], corners[0, 2] - corners[0, 0]
    assert colored(raster.picture(), RED).sum() == pytest.approx((ax * by - ay * bx) / 2, rel=0.01)
    assert raster.picture().shape == (80, 100, 3)


def test_the_first_row_is_the_top():
    raster = Raster(10, 10)
    raster.draw(square(0, 10, 8, 10), np.ones((2, 3)), np.repeat(RED, 2, 0))
    assert colored(raster.picture(), RED).sum(1).tolist() == [10, 10, *[0] * 8]


@pytest.mark.parametrize("swap", [False, True])
def test_the_nearest_is_seen_whatever_the_order_and_planes_cut_each_other_where_they_meet(swap):
    """A wall at the depth 2 and one from 1 to 4: in perspective they are equally deep where 1/depth
    is 1/2: a third across."""
    raster = Raster(60, 90)
    wall, slanted = square(0, 90, 0, 60), square(0, 90, 0, 60)
    depths = np.where(slanted[..., 0] > 0, 4.0, 1.0)
    both = [
        (wall, np.full((2, 3), 2.0), np.repeat(RED, 2, 0)),
        (slanted, depths, np.repeat(BLUE, 2, 0)),
    ]
    for corners, depth, colors in both[::-1] if swap else both:
        raster.draw(corners, depth, colors)
    near = (1.0 - 0.5) / (1.0 - 0.25)  # across, where 1/depth falls linearly from 1 to 1/4
    assert colored(raster.picture(), BLUE).sum(1) == pytest.approx(90 * near, abs=1)


def test_neighbors_leave_no_cracks(rng):
    """A grid of points moved at random, in triangles, covers all."""
    n = 21
    x, y = np.meshgrid(np.linspace(-5, 105, n), np.linspace(-5, 105, n), indexing="ij")
    points = np.stack([x, y], -1)
    points[1:-1, 1:-1] += rng.uniform(-1.5, 1.5, (n - 2, n - 2, 2))
    a, b, c, d = points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]
    corners = np.concatenate(
        [np.stack([a, b, c], 2).reshape(-1, 3, 2), np.stack([a, c, d], 2).reshape(-1, 3, 2)]
    )
    raster = Raster(100, 100)
    raster.draw(corners, np.ones((len(corners), 3)), np.repeat(RED, len(corners), 0))
    assert colored(raster.picture(), RED).all()


def test_translucent_triangles_let_through_what_is_behind_but_not_what_is_before():
    raster = Raster(10, 30)
    raster.draw(square(0, 20, 0, 10), np.full((2, 3), 2.0), np.repeat(RED, 2, 0))
    raster.draw(square(0, 10, 0, 10), np.full((2, 3), 0.5), np.repeat(RED, 2, 0))
    raster.blend(square(0, 30, 0, 10), np.ones((2, 3)), np.repeat(BLUE, 2, 0), np.full(2, 0.25))
    row = raster.picture()[5].tolist()
    assert row[5] == [255, 0, 0] and row[15] == [191, 0, 64] and row[25] == [191, 191, 255]


def test_nothing_to_draw_is_white():
    raster = Raster(4, 4)
    raster.draw(np.zeros((0, 3, 2)), np.zeros((0, 3)), np.zeros((0, 3)))
    assert (raster.picture() == 255).all()
