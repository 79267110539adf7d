"""Fits of hard points to measured curves of a wheel."""

import os
from pathlib import Path

import numpy as np
import pytest

import jaxbody as jb

POINTS = ["lower outer", "upper outer", "tie rod outer", "wheel center"]


def table():
    """The columns of the published double wishbone, {name: (41,)}."""
    file = Path(os.environ["JAXBODY_DATA"]) / "double_wishbone_41.csv"
    names = (
        next(line for line in file.read_text().splitlines() if "rack_m" in line)
        .lstrip("# ")
        .split(",")
    )
    return dict(zip(names, np.loadtxt(file, delimiter=",").T, strict=True))


def rig_of(rows, wheel, take=slice(None), noise=(1e-9, 1e-10)):
    """Toe, camber and the wheel's center, to about the digits of the table [rad, m]."""
    angles = {name: np.deg2rad(rows[f"{name}_deg"])[take] for name in ("toe", "camber")}
    places = {f"wheel {x}": rows[f"wheel_{x}_m"][take] for x in "xyz"}
    return jb.fitting.MeasuredCurves(
        wheel,
        drive={"travel": wheel, "rack": "rack.q"},
        over={"travel": rows["dz_m"][take], "rack": rows["rack_m"][take]},
        measured=angles | places,
        noise=dict.fromkeys(angles, noise[0]) | dict.fromkeys(places, noise[1]),
    )


def off(names, by=0.005):
    """The corner with these points off by 5 mm along each axis, with alternating signs."""
    corner, signs = jb.suspension.double_wishbone(), np.array([1, -1, 1])
    return corner.moved(
        {name: corner.hard_points[name] + by * signs * (-1) ** i for i, name in enumerate(names)}
    )


@pytest.mark.long
@pytest.mark.skipif("JAXBODY_DATA" not in os.environ, reason="needs the data of JAXBODY_DATA")
def test_hard_points_from_the_published_curves():
    """Four points that start 5 mm off, each along every axis, are found to 1e-9 m: the table has 12
    digits, so that angles are rounded by 1e-13 rad or 1e-12 m, and the least change of a reading is
    0.03 of that of the points."""
    start = off(POINTS)
    fit = jb.fit(start, {"rig": rig_of(table(), start.wheel)}, free=POINTS, rtol=1e-12)
    truth = jb.suspension.double_wishbone().hard_points
    for name in POINTS:
        np.testing.assert_allclose(fit.estimates[name], truth[name], atol=1e-9)
        np.testing.assert_allclose(
            fit.suspension.hard_points[name], fit.estimates[name], atol=1e-15
        )


ALL = [name for name in jb.suspension.double_wishbone().hard_points if "spring" not in name]


@pytest.mark.long
@pytest.mark.skipif("JAXBODY_DATA" not in os.environ, reason="needs the data of JAXBODY_DATA")
def test_what_curves_cannot_tell_is_named():
    """A bearing of an arm may move along its axis, and the inner point of the axle along the axle:
    five motions that change nothing. The singular values of the derivatives of all curves have as
    many that are zero."""
    corner = jb.suspension.double_wishbone()
    with pytest.warns(jb.JaxbodyWarning, match="NOT_IDENTIFIABLE"):
        fit = jb.fit(corner, {"rig": rig_of(table(), corner.wheel)}, free=ALL, rtol=1e-12)
    alone = [
        "lower inner front",
        "lower inner rear",
        "upper inner front",
        "upper inner rear",
        "axle inner",
    ]
    assert len(fit.unidentified) >= len(alone)
    for name in alone:
        assert any(name in text for text in fit.unidentified)


@pytest.mark.long
def test_a_moved_corner_moves_the_wheel_of_its_curves():
    corner = jb.suspension.double_wishbone()
    moved = corner.moved(
        {"wheel center": [-0.02, 0.951, 0.315], "axle inner": [-0.021, 0.8, 0.309]}
    )
    rig = jb.fitting.MeasuredCurves(
        corner.wheel,
        drive=corner.drive,
        over={"travel": [-0.01, 0.0, 0.02], "steering": 0.0},
        measured={"toe": [0.0, 0.0, 0.1]},
    )
    on = rig.on(corner, moved)
    for wheel in (on.wheel, on.drive["travel"]):
        np.testing.assert_allclose(wheel.center, moved.wheel.center, atol=1e-15)
        np.testing.assert_allclose(wheel.axis, moved.wheel.axis, atol=1e-15)
    assert on.drive["steering"] == "rack.q" and on.place(2) == ("travel = 0.02, steering = 0", 0.02)


@pytest.mark.long
def test_bad_input():
    corner = jb.suspension.double_wishbone()

    def rig(measured, over=None, **options):
        drive = {"travel": corner.wheel, "rack": "rack.q"}
        return jb.fitting.MeasuredCurves(
            corner.wheel,
            drive=drive,
            over=over or {"travel": [0.0, 0.01], "rack": 0.0},
            measured=measured,
            **options,
        )

    with pytest.raises(jb.JaxbodyError, match="NO_DATA"):
        rig({})
    with pytest.raises(jb.JaxbodyError, match=r"measured\['toe'\].*\(3,\).*BAD_SHAPE"):
        rig({"toe": [0.0, 0.1, 0.2]})
    with pytest.raises(jb.JaxbodyError, match=r"measured\['toe'\].*ALL_NAN"):
        rig({"toe": [np.nan, np.nan]})
    with pytest.raises(jb.JaxbodyError, match=r"measured\['toe'\].*NON_FINITE"):
        rig({"toe": [np.inf, 0.0]})
    with pytest.raises(jb.JaxbodyError, match=r"noise\['camber'\].*UNKNOWN_NAME"):
        rig({"toe": [0.0, 0.1]}, noise={"camber": 1e-3})
    with pytest.raises(jb.JaxbodyError, match=r"to.*Did you mean 'toe'.*UNKNOWN_NAME"):
        rig({"to": [0.0, 0.1]}).check(corner.model, "rig")
    with pytest.raises(jb.JaxbodyError, match=r"no values of 'rack'.*BAD_SHAPE"):
        rig({"toe": [0.0, 0.1]}, over={"travel": [0.0, 0.01]}).check(corner.model, "rig")
