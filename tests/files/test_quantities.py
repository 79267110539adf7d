"""Numbers with units in files, against conversions by hand."""

import re
import warnings

import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.errors import Problems
from jaxbody.files.quantities import in_SI, unit_system

TORSION = {"force": "N m", "argument": "rad"}
TURN = 57.29577951308232  # degrees in a radian
DRAWING = unit_system(
    {"length": "mm", "force": "N", "time": "s", "angle": "deg"}, "units", Problems()
)
ADAMS = unit_system(
    {"length": "mm", "mass": "kg", "force": "N", "time": "s", "angle": "deg"}, "units", Problems()
)
MILLINEWTON = unit_system(
    {"length": "mm", "mass": "kg", "time": "s", "angle": "deg"}, "units", Problems()
)
TONNES = unit_system(
    {"length": "mm", "mass": "t", "time": "s", "angle": "deg"}, "units", Problems()
)
CRASH = unit_system(
    {"length": "mm", "force": "kN", "time": "ms", "angle": "rad"}, "units", Problems()
)
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
        (2, "kg", ADAMS, 2.0),
        ([2, 3, 4], "kg m2", ADAMS, [2e-6, 3e-6, 4e-6]),
        (-9806.65, "m/s2", ADAMS, -9.80665),
        (5, "N/m", ADAMS, 5000.0),
        (2, "1/kg", ADAMS, 2.0),
        (0.2, "kg", TONNES, 200.0),
        (5, "N/m", TONNES, 5000.0),  # t mm/s2 are newtons
        (2, "kg", CRASH, 2.0),  # kN ms2/mm are kilograms
        (3, "N s/m", CRASH, 3000.0),
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
    np.testing.assert_allclose(
        in_SI(value, unit, TORSION, system, "f:1 x", problems), expected, rtol=4e-16
    )
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


@pytest.mark.parametrize(
    "value, unit, system, meant",
    [
        (
            85,
            "kg",
            DRAWING,
            "is 85 without a unit, which would be 85000 kg by the units of the file",
        ),  # N s2/mm are tonnes
        (
            2.1,
            "kg m2",
            DRAWING,
            (
                "which would be 0.0021 kg m2 by the units of the file (allowed: a unit such as kg "
                'm2). Write "2.1 kg m2", or add'
            ),
        ),
        (
            -9.81,
            "m/s2",
            DRAWING,
            (
                "which would be -0.00981 m/s2 by the units of the file (allowed: a unit such as "
                'm/s2). Write "-9.81 m/s2".'
            ),
        ),
        # kg mm/s2 are millinewtons
        (60, "N/m", MILLINEWTON, "is 60 without a unit, which would be 60 N/m"),
        (0.1, "N m", MILLINEWTON, 'or add force = "N" to the units of the file'),
    ],
)
def test_numbers_in_a_unit_that_follows_and_is_rarely_meant_are_refused(value, unit, system, meant):
    problems = Problems()
    in_SI(value, unit, {}, system, "f:1 x", problems)
    (problem,) = problems.collected
    assert problem.code == "NO_UNIT" and meant in str(problem)


def test_a_number_too_large_for_a_float_is_infinite():
    assert in_SI(10**400, "m", {}, DRAWING, "f:1 x", Problems()) == float("inf")


@pytest.mark.parametrize(
    "stated",
    [
        "mks",
        3,
        {"length": "mm"},
        {"length": "s", "time": "s", "angle": "rad", "mass": "kg"},
        {"x": "m"},
    ],
)
def test_unit_systems_are_complete(stated):
    problems = Problems()
    unit_system(stated, "f:1 units", problems)
    assert {problem.code for problem in problems.collected} == {"BAD_UNIT"}


def test_what_a_unit_system_lacks_is_said_whole():
    problems = Problems()
    unit_system(
        {"length": "mm", "masses": "kg", "temperature": "K", "angle": "deg"}, "f:1 units", problems
    )
    assert (
        "has no mass or force and no time and has masses, temperature (allowed: length, time"
        in str(problems.collected[0])
    )


SWING = """jaxbody = 1
bodies.arm = {mass = "2 kg", inertia = "1, 1, 1 kg m2"}
joints.arm = {type = "Hinge", parent = "world", axis = [0, 0, 1]}
elements.twist = {type = "Torsion", a = "arm", b = "world", axis = [0, 0, 1], spring = "1 N m/rad", free_angle = ANGLE}
"""  # noqa: E501


@pytest.mark.parametrize(
    "angle, units, warned",
    [
        ('"30 rad"', "", '30 rad, more than a turn; if it is in degrees, write "30 deg"'),
        ('"-30 rad"', "", '30 rad, more than a turn; if it is in degrees, write "30 deg"'),
        ("30", 'units = "SI"', '30 rad, more than a turn; if it is in degrees, write "30 deg"'),
        ('"540 deg"', "", ""),  # a wound spring
        ("540", 'units = {length = "mm", mass = "kg", time = "s", angle = "deg"}', ""),
        ('"6.2 rad"', "", ""),
        ('"0.5 rad"', 'units = "SI"', ""),
    ],
)
def test_more_than_a_turn_in_rad_is_warned_of_once_with_its_line(angle, units, warned, tmp_path):
    path = tmp_path / "swing.toml"
    path.write_text(SWING.replace("ANGLE", angle).replace("jaxbody = 1", f"jaxbody = 1\n{units}"))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        jb.read_model(path)
    assert [str(each.message) for each in caught] == (
        [f"swing.toml:5 elements.twist.free_angle: is {warned} [UNIT]"] if warned else []
    )
    assert not warned or caught[0].filename == __file__


def test_angles_of_every_kind_are_checked(tmp_path):
    """Rows of angles, phases, angles of a state; not angular velocities, nor stiffnesses
    about angles."""
    path = tmp_path / "swing.toml"
    path.write_text(
        SWING.replace("ANGLE", '"0 rad"').replace("1 N m/rad", "100 N m/rad")
        + """supports.table = {}
motion.table = {type = "Harmonic", frequency = "1 Hz", rotation = "0, 0, 20 rad", translation_phase = "90 rad"}
loads.pull = {type = "Force", on = "arm", moment = {type = "Sine", amplitude = "0, 0, 3 N m", frequency = "2 Hz", phase = "45 rad"}}
loads.wheel = {type = "Unbalance", on = "arm", axis = "z", unbalance = "5 kg mm", frequency = "20 Hz", phase = "-9 rad"}
"""  # noqa: E501
    )
    path.write_text(path.read_text().replace('axis = "z"', "axis = [0, 0, 1]"))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        jb.read_study(path)
    said = [str(each.message) for each in caught]
    assert [re.search(r":(\d+) (\S+): is (\S+) rad", text).groups() for text in said] == [
        ("6", "motion.table.rotation", "20"),
        ("6", "motion.table.translation_phase", "90"),
        ("7", "loads.pull.moment.phase", "45"),
        ("8", "loads.wheel.phase", "9"),
    ]


def test_constructors_warn_of_phases_in_degrees():
    for make, where in (
        (
            lambda: jb.Harmonic(frequency=1.0, translation=[0, 0, 1], translation_phase=90.0),
            "Harmonic.translation_phase is 90 rad",
        ),
        (
            lambda: jb.Harmonic(frequency=1.0, rotation=[0, 0, 1], rotation_phase=[0, 0, -90.0]),
            "Harmonic.rotation_phase is 90 rad",
        ),
        (lambda: jb.signals.Sine(amplitude=1.0, frequency=1.0, phase=45.0), "Sine.phase is 45 rad"),
        (
            lambda: jb.inputs.Unbalance(
                "a", axis=[0, 0, 1], unbalance=1.0, frequency=1.0, phase=45.0
            ),
            "Unbalance.phase is 45 rad",
        ),
        (
            lambda: jb.inputs.EngineTorque(
                "a", axis=[0, 0, 1], frequency=1.0, orders=[2], amplitudes=[1], phases=[45]
            ),
            "EngineTorque.phases is 45",
        ),
    ):
        with pytest.warns(jb.JaxbodyWarning, match=where):
            make()


def test_pounds_and_kilograms_of_mass_are_no_forces():
    problems = Problems()
    for text, unit in (("400 lb/in", "N/m"), ("85 kg", "N"), ("9.81 m/s2", "m")):
        in_SI(text, unit, {}, None, "f:1 x", problems)
    hints = [problem.hint for problem in problems.collected]
    assert [problem.code for problem in problems.collected] == 3 * ["WRONG_DIMENSION"]
    assert ["lbf and kgf" in hint for hint in hints] == [True, True, False]
