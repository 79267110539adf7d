"""Hard points from a table: places in meters, problems with their lines."""

import numpy as np
import pytest

import jaxbody as jb

SHEET = """# corner, issue 2
name; z [mm]; x [mm]; y
lower outer; 200; 0; 900 mm
upper outer; 50 cm; -25; 0.75 m
"""


def test_points_are_in_meters_whatever_the_columns(tmp_path):
    (tmp_path / "corner.csv").write_text(SHEET)
    points = jb.files.read_hard_points(tmp_path / "corner.csv")
    assert list(points) == ["lower outer", "upper outer"]
    np.testing.assert_allclose(points["lower outer"], [0, 0.9, 0.2], rtol=1e-15)
    np.testing.assert_allclose(points["upper outer"], [-0.025, 0.75, 0.5], rtol=1e-15)


@pytest.mark.parametrize(
    "old, new, message",
    [
        (
            "900 mm",
            "900",
            (
                "corner.csv:3 y: is 900 without a unit (allowed: a unit such as mm). Write it "
                "in the heading, y [m],"
            ),
        ),
        ("900 mm", "900 N", "corner.csv:3 y: is '900 N', in N"),
        ("900 mm", "", "corner.csv:3 y: is empty (allowed: a number). Write 0 if it is zero."),
        (
            "upper outer;",
            "lower outer;",
            "corner.csv:4: 'lower outer' is the name of a point above",
        ),
        ("; y\n", "; why\n", "corner.csv:2: has no column 'y'"),
        (SHEET[18:], "", "corner.csv: has no line of headings and lines of hard points"),
    ],
)
def test_problems_are_reported_with_their_line(old, new, message, tmp_path):
    assert old in SHEET
    (tmp_path / "corner.csv").write_text(SHEET.replace(old, new, 1))
    with pytest.raises(jb.JaxbodyError) as error:
        jb.files.read_hard_points(tmp_path / "corner.csv")
    assert message in str(error.value)
