"""Numbers with units in files, against conversions by hand."""

import numpy as np
import pytest

from jaxbody.core.errors import Problems
from jaxbody.files.quantities import in_SI, unit_system

TORSION = {"force": "N m", "argument": "rad"}
TURN = 57.29577951308232  # degrees in a radian
DRAWING = unit_system({"length": "mm", "force": "N", "time": "s", "angle": "deg"}, "units", Problems())
SI = unit_system("SI", "units", Problems())


@pytest.mark.parametrize(
    "value, unit, system, expected",
    [
        ("21 N/mm", "N/m", None, 21000.0),
        ("21N/mm", "N/m", None, 21000.0),
        ("-2100, 700, 0 mm", "m", None, [-2.1, 0.7, 0.0]),
        ("(1 2 3) cm", "m", None, [0.01, 0.02, 0.03]),
        (["1 mm", "2 cm"], "m", None, [0.001, 0.02]),
        ("5 1/s", "Hz", None, 5.0),
        ("30 %", "", None, 0.3),
        (0.3, "", None, 0.3),
        (5, "N/m", DRAWING, 5000.0),
        (2, "kg", DRAWING, 2000.0),  # N s2/mm are tonnes
        (["1 m", 700], "m", DRAWING, [1.0, 0.7]),
        (5, "N/m", SI, 5.0),
        ("3 N m/deg", "force/argument", None, 3 * TURN),
        ([1, "2 Nm/rad2"], "force/argument^n", SI, [1.0, 2.0]),
        ([[1, 2], [3, 4]], "N/m, N; N, N m/rad", DRAWING, [[1000.0, 2.0], [3.0, 0.004 * TURN]]),
        ([1, 2, 3], "N/m, N; N, N m/rad", DRAWING, [1000.0, 2000.0, 3000.0]),
    ],
)
def test_conversions(value, unit, system, expected):
    problems = Problems()
    np.testing.assert_allclose(in_SI(value, unit, TORSION, system, "f:1 x", problems), expected, rtol=4e-16)
    assert not problems.collected


@pytest.mark.parametrize(
    "value, unit, code",
    [
        (5, "N/m", "NO_UNIT"),
        ("5", "N/m", "NO_UNIT"),
        ("5 m", "N/m", "WRONG_DIMENSION"),
        ("5 m", "", "WRONG_DIMENSION"),
        ("1000 rpm", "Hz", "WRONG_DIMENSION"),
        ("5 N/mn", "N/m", "UNKNOWN_UNIT"),
        ("stiff", "N/m", "NOT_A_NUMBER"),
        (True, "", "NOT_A_NUMBER"),
        (["1 m", {}], "m", "NOT_A_NUMBER"),
        ("1" * 20000, "m", "NOT_A_NUMBER"),
        ("__import__('os')", "m", "NOT_A_NUMBER"),
    ],
)
def test_what_is_no_quantity(value, unit, code):
    problems = Problems()
    in_SI(value, unit, {}, None, "f:1 x", problems)
    assert [problem.code for problem in problems.collected] == [code]


def test_a_number_too_large_for_a_float_is_infinite():
    assert in_SI(10**400, "m", {}, DRAWING, "f:1 x", Problems()) == float("inf")


@pytest.mark.parametrize("stated", ["mks", 3, {"length": "mm"}, {"length": "s", "time": "s", "angle": "rad", "mass": "kg"}, {"x": "m"}])
def test_unit_systems_are_complete(stated):
    problems = Problems()
    unit_system(stated, "f:1 units", problems)
    assert {problem.code for problem in problems.collected} == {"BAD_UNIT"}
