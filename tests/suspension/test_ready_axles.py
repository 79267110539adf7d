"""A solid axle with a Panhard rod: its path in bounce, its roll center, and its frequencies,
by hand."""

import numpy as np
import pytest
from scipy.optimize import fsolve

import jaxbody as jb

# lengths of links and of the Panhard rod, distance of the springs
LINK, ROD, HEIGHT, TRACK, SPRINGS = 0.5, 0.96, 0.33, 1.5, 1.0
MASS, STIFFNESS = 90.0, 25e3
ABOUT = (20.0, 3.0, 21.0)


def level_axle(**options):
    """All links level and parallel, so that in bounce the axle does not turn; springs upright."""
    points = {
        "upper link front": [LINK, 0, 0.46],
        "upper link rear": [0, 0, 0.46],
        "Panhard rod body": [0, ROD / 2, HEIGHT],
        "Panhard rod axle": [0, -ROD / 2, HEIGHT],
    }
    for side, y in (("left", 1), ("right", -1)):
        points |= {
            f"{side} lower link front": [LINK, 0.5 * y, 0.27],
            f"{side} lower link rear": [0, 0.5 * y, 0.27],
        }
        points |= {
            f"{side} spring lower": [0, y * SPRINGS / 2, 0.31],
            f"{side} spring upper": [0, y * SPRINGS / 2, 0.62],
        }
    return jb.suspension.solid_axle(
        points, mass=MASS, inertia=ABOUT, stiffness=STIFFNESS, **options
    )


@pytest.fixture(scope="module")
def curves():
    return level_axle().curves([-0.08, 0.0, 0.06, 0.02], [-0.08, 0.0, 0.06, -0.02])


@pytest.mark.long
def test_in_bounce_the_panhard_rod_moves_the_axle_sideways(curves):
    """(L - x)^2 + y^2 + z^2 = L^2 of the links, x^2 + (l - y)^2 + z^2 = l^2 of the rod."""
    for i, z in enumerate([-0.08, 0.0, 0.06]):
        gaps = lambda p, z=z: [  # noqa: E731
            (LINK - p[0]) ** 2 + p[1] ** 2 + z**2 - LINK**2,
            p[0] ** 2 + (ROD - p[1]) ** 2 + z**2 - ROD**2,
        ]
        x, y = fsolve(gaps, [z**2, z**2], xtol=1e-12)
        np.testing.assert_allclose(
            [curves["wheel x"][i], curves["wheel y"][i] - TRACK / 2], [x, y], atol=1e-11
        )
    np.testing.assert_allclose(curves["camber"][:3], 0, atol=1e-12)
    np.testing.assert_allclose(curves["toe"][:3], 0, atol=1e-12)
    assert float(np.sin(-curves["camber"][3])) == pytest.approx(0.04 / TRACK, rel=1e-9)


@pytest.mark.long
def test_it_rolls_about_the_middle_of_the_panhard_rod(curves):
    """At the design position the point of the axle at height h over y = 0 stays:
    dy/dleft - dy/dright of a wheel at height z is -(z - h) dphi with dphi = 2/track."""
    slopes = [float(curves.slopes[side]["wheel y"][1]) for side in ("left", "right")]
    assert slopes[0] - slopes[1] == pytest.approx(-(0.31 - HEIGHT) * 2 / TRACK, abs=1e-9)


@pytest.mark.long
def test_bounce_and_roll_frequencies_are_those_of_two_springs():
    """2 k/m, and 2 k (d/2)^2/(J + m (z - h)^2) with the center of mass at z."""
    model = level_axle(force=0.0).model
    eq = jb.equilibrium(model)
    assert eq.ok and eq.stable and eq.redundant == ()
    rates = sorted(
        [
            2 * STIFFNESS / MASS,
            STIFFNESS * SPRINGS**2 / 2 / (ABOUT[0] + MASS * (0.31 - HEIGHT) ** 2),
        ]
    )
    np.testing.assert_allclose(
        jb.modes(jb.linearize(model, eq)).frequency, np.sqrt(rates) / (2 * np.pi), rtol=1e-9
    )


def test_bad_input():
    with pytest.raises(jb.JaxbodyError, match=r"panhard rod body.*Did you mean 'Panhard rod body'"):
        jb.suspension.solid_axle({"panhard rod body": [0, 0.5, 0.3]})
