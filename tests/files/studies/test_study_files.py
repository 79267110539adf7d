"""Studies in files: motions, loads, sensors and experiments, as in Python, and problems with
their lines."""

import re
import tomllib

import jax
import numpy as np
import pytest
from mutated_files import check_changed

import jaxbody as jb
from jaxbody.files.builders import in_words_of_files
from jaxbody.files.kinds import SENSORS
from jaxbody.files.schemas import schema

SHAKER = """jaxbody = 1
units = {length = "mm", mass = "kg", time = "s", angle = "deg"}
bodies.box = {mass = 2, inertia = "1, 1, 1 kg m2"}
supports.table = {}
supports.floor = {}
joints.box = {type = "Fixed", parent = "table"}

[motion.table]
type = "Harmonic"
frequency = "90 1/min"
translation = [0, 0, 10]
rotation = "0, 2, 0 deg"
translation_phase = 90
"""


def test_motions_are_those_of_python(tmp_path):
    (tmp_path / "shaker.toml").write_text(SHAKER)
    study = jb.read_study(tmp_path / "shaker.toml")
    expected = jb.Harmonic(
        frequency=1.5,
        translation=[0, 0, 0.01],
        rotation=[0, np.deg2rad(2), 0],
        translation_phase=np.pi / 2,
    )
    assert list(study.motion) == ["table"] and study.model.layout.bodies == ("box",)
    for name, value in vars(expected).items():
        np.testing.assert_allclose(getattr(study.motion["table"], name), value, rtol=1e-15)
    same = jb.read_model(tmp_path / "shaker.toml")
    assert jb.parameter_paths(same).keys() == jb.parameter_paths(study.model).keys()


@pytest.mark.parametrize(
    "old, new, message",
    [
        (
            "[motion.table]",
            "[motion.tabel]",
            "shaker.toml:8 motion.tabel: 'tabel' is unknown. Did you mean 'table'?",
        ),
        (
            "Harmonic",
            "Harmonik",
            "shaker.toml:9 motion.table.type: 'Harmonik' is unknown. Did you mean 'Harmonic'?",
        ),
        ("90 1/min", "90 mm", "shaker.toml:10 motion.table.frequency: is '90 mm', in m"),
        ("[0, 0, 10]", "[0, 10]", "shaker.toml:11 motion.table.translation: has shape (2,)"),
        (
            "translation =",
            "amplitude =",
            "shaker.toml:11 motion.table.amplitude: 'amplitude' is unknown",
        ),
    ],
)
def test_problems_are_reported_with_their_line(old, new, message, tmp_path):
    (tmp_path / "shaker.toml").write_text(SHAKER.replace(old, new, 1))
    with pytest.raises(jb.JaxbodyError) as error:
        jb.read_study(tmp_path / "shaker.toml")
    assert message in str(error.value)


CAR = """jaxbody = 1
gravity = "0, 0, -9.81 m/s2"
supports.road = {}
joints.car = {type = "Guide", parent = "road", axis = [0, 0, 1]}
[bodies.car]
mass = "400 kg"
inertia = "1, 1, 1 kg m2"
position = "0, 0, 600 mm"
[elements.spring]
type = "Spring"
a = ["car", "0, 0, 0 m"]
b = ["road", "0, 0, 0 m"]
free_length = "700 mm"
stiffness = "30 N/mm"
[records.run1]
file = "run1.csv"
time = "t"
channels = {height = "z", acc = {columns = "a", unit = "g"}, base = "zb", pull = "F"}
part = "0, 0.2 s"
[sensors]
height = {type = "Position", on = "car", axis = "z", bias = "1 mm"}
acc = {type = "Acceleration", on = "car", axis = "z"}
[loads.push]
type = "Force"
on = "car"
force = {type = "Samples", record = "run1", channel = "pull", axis = "z", kind = "linear"}
[motion.road]
type = "Sampled"
record = "run1"
translation = "base"
axis = "z"
[experiments.run1]
record = "run1"
initial = "rest"
noise = {height = "0.1 mm", acc = "0.01 g"}
[experiments.free]
record = "run1"
sensors = ["height"]
motion = {}
loads = {kick = {type = "Unbalance", on = "car", axis = [0, 1, 0], unbalance = "5 kg mm", frequency = "20 Hz"}}
initial = {q = ["5 mm"], v = "-1 mm/s"}
leave_out = "50 ms"
[fit]
free = ["spring.stiffness", "free.initial.v"]
bounds = {"spring.stiffness" = ["10 N/mm", inf], "free.initial.v" = ["-1 cm/s", "1 cm/s"]}
priors = {"spring.stiffness" = ["30 N/mm", "3 N/mm"]}
"""  # noqa: E501
t = np.arange(31) / 100
z, a, zb, F = 600 + t, 0.1 - t, 10 * np.sin(2 * t), 100 * t**2  # mm, g, mm, N


@pytest.fixture
def car(tmp_path):
    lines = [",".join(map(repr, row)) for row in np.stack([t, z, a, zb, F], 1).tolist()]
    (tmp_path / "run1.csv").write_text("\n".join(["t [s],z [mm],a,zb [mm],F [N]", *lines]))
    (tmp_path / "car.toml").write_text(CAR)
    return tmp_path / "car.toml"


def same(found, expected):
    """Whether two trees hold the same numbers, and the same names and options."""
    leaves, structure = jax.tree.flatten(found)
    others, of_others = jax.tree.flatten(expected)
    assert structure == of_others
    for leaf, other in zip(leaves, others, strict=True):
        np.testing.assert_allclose(
            leaf, other, rtol=1e-12, atol=1e-12 * np.abs(np.nan_to_num(other)).max(initial=0.0)
        )  # rounding of mm and g to SI


def test_experiments_are_those_of_python(car):
    study = jb.read_study(car)
    n = 21  # the part from 0 to 0.2 s
    along_z = lambda x: np.stack([0 * x[:n], 0 * x[:n], x[:n]], 1)  # noqa: E731
    motion = {"road": jb.Sampled(t[:n], translation=along_z(zb / 1000))}
    push = jb.Force("car", force=jb.signals.Samples(t[:n], along_z(F), kind="linear"))
    sensors = {
        "height": jb.Position("car", axis="z", bias=1e-3),
        "acc": jb.Acceleration("car", axis="z"),
    }
    g = 9.80665
    measured = {"height": z[:n] / 1000, "acc": a[:n] * g}
    options = {"initial": "rest", "noise": {"height": 1e-4, "acc": 0.01 * g}}
    expected = jb.Experiment(
        t[:n], sensors=sensors, measured=measured, motion=motion, loads={"push": push}, **options
    )
    same(study.experiments["run1"], expected)
    same(study.sensors, sensors)
    kick = jb.inputs.Unbalance("car", axis=[0, 1, 0], unbalance=5e-3, frequency=20.0)
    start = jb.State(np.array([0.005]), np.array([-0.001]))
    height = {"height": sensors["height"]}
    free = jb.Experiment(
        t[:n],
        sensors=height,
        measured={"height": z[:n] / 1000},
        loads={"kick": kick},
        initial=start,
        leave_out=0.05,
    )
    same(study.experiments["free"], free)
    assert study.fit["free"] == ["spring.stiffness", "free.initial.v"]
    np.testing.assert_allclose(study.fit["bounds"]["spring.stiffness"], (1e4, np.inf))
    np.testing.assert_allclose(np.ravel(study.fit["bounds"]["free.initial.v"]), (-0.01, 0.01))
    np.testing.assert_allclose(study.fit["priors"]["spring.stiffness"], (3e4, 3e3))


MISTAKES = [
    ('"run1.csv"', '"run2.csv"', "car.toml:15 records.run1: "),
    ('"run1.csv"', '"../run1.csv"', "car.toml:16 records.run1.file: names '../run1.csv'"),
    ('height = "z"', 'height = "y"', "car.toml:15 records.run1: run1.csv"),
    (
        '{columns = "a", unit = "g"}',
        '"a"',
        (
            "car.toml:18 records.run1.channels.acc: has no unit in the file (allowed: one unit). "
            'Write channels.acc = {columns = "a", unit = "m/s2"} with its unit, or unit = "1" for '
            "numbers without one."
        ),
    ),
    (
        'time = "t"',
        'time = "a"',
        (
            "car.toml:17 records.run1.time: has no unit in the file (allowed: one unit). Write "
            'time = {columns = "a", unit = "ms"} with'
        ),
    ),
    ('time = "t"\n', "", 'Give time = {columns = "t", unit = "s"}, or rate [Hz].'),
    (
        "part =",
        "parts =",
        "car.toml:19 records.run1.parts: 'parts' is unknown. Did you mean 'part'?",
    ),
    ('"0, 0.2 s"', '"5, 6 s"', "car.toml:15 records.run1: Record.part: has 0 samples"),
    (
        '"Position", on = "car"',
        '"Position", on = "cart"',
        "car.toml:21 sensors.height.on: body or support 'cart' is unknown",
    ),
    (
        'bias = "1 mm"',
        'bias = "1 N"',
        "car.toml:21 sensors.height.bias: is '1 N', in N (allowed: a unit such as m)",
    ),
    (
        'on = "car", axis = "z"}\n[loads',
        'on = "car", axis = "w"}\n[loads',
        "car.toml:22 sensors.acc.axis: 'w' is unknown",
    ),
    (
        'channel = "pull"',
        'channel = "pul"',
        "car.toml:26 loads.push.force: Record: has no channel 'pul'",
    ),
    (
        'channel = "pull"',
        'channel = "base"',
        "car.toml:26 loads.push.force.channel: is the channel 'base', which is in m",
    ),
    (
        'record = "run1"\ntranslation',
        'record = "run"\ntranslation',
        "car.toml:29 motion.road.record: record 'run' is unknown",
    ),
    (
        'translation = "base"',
        'rotation = "base"',
        "car.toml:30 motion.road.rotation: is the channel 'base', which is in m",
    ),
    (
        'type = "Position", on',
        'type = "jaxbody.model.laws:Linear", on',
        "car.toml:21 sensors.height",
    ),
    (
        'translation = "base"\naxis = "z"',
        'translation = "base"',
        "car.toml:30 motion.road.translation: is the channel 'base' of one",
    ),
    (
        'height = "0.1 mm"',
        'height = "0.1 g"',
        "car.toml:35 experiments.run1.noise.height: is '0.1 g'",
    ),
    (
        'height = "0.1 mm"',
        'heigt = "0.1 mm"',
        "car.toml:35 experiments.run1.noise['heigt']: 'heigt' is unknown",
    ),
    (
        '["height"]',
        '["hight"]',
        "car.toml:38 experiments.free.sensors[0]: sensor 'hight' is unknown",
    ),
    ('["5 mm"]', '["5 deg"]', "car.toml:41 experiments.free.initial.q: is '5 deg'"),
    (
        '"Unbalance", on = "car"',
        '"Unbalance", on = "road"',
        "car.toml:40 experiments.free.loads.kick: is on 'road', which is not a body",
    ),
    (
        'free = ["spring.stiffness"',
        'free = ["spring.stifness"',
        "car.toml:44 fit.free: 'spring.stifness' matches nothing",
    ),
    (
        '["10 N/mm", inf]',
        '["10 N/m2", inf]',
        "car.toml:45 fit.bounds.'spring.stiffness': is '10 N/m2'",
    ),
    (
        '"free.initial.v" = ["-1',
        '"free.initial.w" = ["-1',
        "car.toml:45 fit.bounds.'free.initial.w': 'free.initial.w' matches nothing",
    ),
]


@pytest.mark.parametrize("old, new, message", MISTAKES)
def test_problems_of_studies_are_reported_with_their_line(old, new, message, car):
    assert old in CAR
    car.write_text(CAR.replace(old, new, 1))
    with pytest.raises(jb.JaxbodyError) as error:
        jb.read_study(car)
    assert message in str(error.value)


def test_a_study_prints_what_is_in_it(car):
    car.write_text(
        CAR.replace('leave_out = "50 ms"', 'leave_out = "50 ms"\nvalidate = true')
        .replace(', "free.initial.v"]', "]", 1)
        .replace(', "free.initial.v" = ["-1 cm/s", "1 cm/s"]', "")
        + DESIGN
    )
    study = jb.read_study(car)
    text = str(study)
    assert (
        re.search(r"car +guide +road +400 ", text)
        and "motion of: road\nloads: push\nsensors: height, acc" in text
    )
    assert re.search(r"run1 +Experiment +height, acc +21 of time, 0 to 0.2 s +fit\n", text)
    assert re.search(r"free +Experiment +height +21 of time, 0 to 0.2 s +validation\n", text)
    assert "free in the fit\n  spring.stiffness\n" in text
    (name, design), *_ = study.designs.items()
    assert (
        re.search(rf"{name} +{design['minimize']} ", text)
        and "array(" not in text
        and len(text) < 1500
    )
    assert "validation" in study._repr_html_()


IN_ONE_EXPERIMENT = [
    ".noise.height: ",
    ".loads.kick: ",
    ".initial.q: ",
    "fit.free: ",
    "fit.bounds.'spring.stiffness': ",
]
TOGETHER = {  # mistakes of one file, by what is reported of them
    "in a record and what does not need it": [
        "records.run1: run1.csv",
        ".channels.acc: ",
        ".time: ",
        *IN_ONE_EXPERIMENT,
    ],
    "in what is made of a record": ["channel 'pul'", "motion.road.rotation: ", *IN_ONE_EXPERIMENT],
    "in a sensor": [
        "sensors.height.bias: ",
        ".loads.kick: ",
        ".initial.q: ",
        "fit.bounds.'spring.stiffness': ",
    ],
}


@pytest.mark.parametrize("case", TOGETHER)
def test_several_mistakes_are_reported_at_once(case, car):
    """Each of them, and nothing that only follows from them."""
    text, expected = CAR, []
    for word in TOGETHER[case]:
        old, new, message = next(mistake for mistake in MISTAKES if word in mistake[2])
        assert old in text
        text, expected = text.replace(old, new, 1), [*expected, message]
    car.write_text(text)
    with pytest.raises(jb.JaxbodyError) as error:
        jb.read_study(car)
    reported = [str(problem) for problem in error.value.problems]
    assert len(reported) == len(expected) and all(
        any(message in line for line in reported) for message in expected
    ), reported


def test_hints_are_in_the_words_of_files():
    for python, written in (
        (
            "Give irregular=True if the times are correct.",
            "Give irregular = true if the times are correct.",
        ),
        ('give decimal=",", separator=";"', 'give decimal = ",", separator = ";"'),
        ("give footer=3.", "give footer = 3."),
        ("Leave out rate= to use the times.", "Leave out rate to use the times."),
        ("jb.replace(model, {path: 1}) for a == b", "jb.replace(model, {path: 1}) for a == b"),
    ):
        assert in_words_of_files(python) == written


def test_a_motion_needs_a_channel_of_lengths(car):
    car.write_text(
        CAR.replace('unit = "g"', 'unit = "1"').replace(
            'translation = "base"', 'translation = "acc"'
        )
    )
    with pytest.raises(
        jb.JaxbodyError,
        match=(
            r"car.toml:30 motion.road.translation: is the channel 'acc', which is "
            r"in .*WRONG_DIMENSION"
        ),
    ):
        jb.read_study(car)


ALL_SENSORS = """
a1 = {type = "Position", on = "box", point = "10, 0, 0 mm", axis = [0, 3, 4], relative_to = "table", gain = 1.5, delay = "2 ms"}
a2 = {type = "Velocity", on = "box", lag = "3 ms", start = ["1 mm/s", 0, 0]}
a3 = {type = "Acceleration", on = "table", axis = "x"}
a4 = {type = "Rotation", on = "box", axis = "y", bias = "2 deg"}
a5 = {type = "AngularVelocity", on = "box"}
a6 = {type = "AngularAcceleration", on = "box"}
a7 = {type = "Accelerometer", on = "box", orientation = {sequence = "xyz", angles = "10, 20, 30 deg"}}
a8 = {type = "Gyro", on = "box", axis = "z", gain = 0.99}
a9 = {type = "Inclinometer", on = "box", axis = [1, 0, 0]}
b1 = {type = "Elongation", on = "mount", component = 4, bias = "1 deg"}
b2 = {type = "LoadCell", on = "twist", bias = "1 N mm"}
b3 = {type = "ForcePlate", on = "table", bias = ["1 N", "0 N", "0 N", "2 N m", "0 N m", "0 N m"]}
b4 = {type = "Reaction", on = "arm", point = "0, 0, 1 cm", component = 3, bias = "1 N mm"}
b5 = {type = "JointAngle", on = "arm", delay = "-1 ms"}
b6 = {type = "Displacement", a = ["box", "0, 0, 1 cm"], b = "table", axis = "z"}
b7 = {type = "StringPotentiometer", a = ["box", "0, 0, 1 cm"], b = ["table", "0, 0, -50 cm"], bias = "2 mm"}
b8 = {type = "LaserVibrometer", on = "box", axis = "z", origin = "0, 0, -1 m", normal = [0, 0, 1]}
b9 = {type = "LaserDistance", on = "box", origin = "0, 0, -1 m", axis = "z", normal = [0, 0, 1], bias = "1 mm"}
c1 = {type = "BodyPose", on = "box", bias = ["1 mm", 0, 0, "1 deg", "0 deg", "0 deg"]}
c2 = {type = "Orientation", on = "box", orientation = [0, 1, 0, 0], bias = "0, 1, 0 deg"}
"""  # noqa: E501


def test_sensors_of_every_kind_are_those_of_python(tmp_path):
    (tmp_path / "box.toml").write_text(
        """jaxbody = 1
gravity = "0, 0, -9.81 m/s2"
bodies.box = {mass = "2 kg", inertia = "1, 1, 1 kg m2"}
bodies.arm = {mass = "2 kg", inertia = "1, 1, 1 kg m2"}
supports.table = {}
joints.arm = {type = "Hinge", parent = "table", axis = [0, 0, 1]}
elements.mount = {type = "Bushing", a = ["box", "0, 0, 0 m"], b = ["table", "0, 0, 0 m"], stiffness = "1, 1, 1 N/mm"}
elements.twist = {type = "Torsion", a = "box", b = "table", axis = [0, 0, 1], spring = "1 N m/rad"}
[sensors]"""  # noqa: E501
        + ALL_SENSORS
    )
    deg = np.deg2rad(1)
    expected = {
        "a1": jb.Position(
            "box", [0.01, 0, 0], axis=[0, 3, 4], relative_to="table", gain=1.5, delay=0.002
        ),
        "a2": jb.Velocity("box", lag=0.003, start=[0.001, 0, 0]),
        "a3": jb.Acceleration("table", axis="x"),
        "a4": jb.sensors.Rotation("box", axis="y", bias=2 * deg),
        "a5": jb.sensors.AngularVelocity("box"),
        "a6": jb.sensors.AngularAcceleration("box"),
        "a7": jb.Accelerometer(
            "box", orientation=jb.EulerAngles("xyz", [10 * deg, 20 * deg, 30 * deg])
        ),
        "a8": jb.sensors.Gyro("box", axis="z", gain=0.99),
        "a9": jb.sensors.Inclinometer("box", axis=[1, 0, 0]),
        "b1": jb.Elongation("mount", component=4, bias=deg),
        "b2": jb.sensors.LoadCell("twist", bias=0.001),
        "b3": jb.sensors.ForcePlate("table", bias=[1, 0, 0, 2, 0, 0]),
        "b4": jb.sensors.Reaction("arm", [0, 0, 0.01], component=3, bias=0.001),
        "b5": jb.sensors.JointAngle("arm", delay=-0.001),
        "b6": jb.sensors.Displacement(("box", [0, 0, 0.01]), "table", axis="z"),
        "b7": jb.sensors.StringPotentiometer(
            ("box", [0, 0, 0.01]), ("table", [0, 0, -0.5]), bias=0.002
        ),
        "b8": jb.sensors.LaserVibrometer("box", axis="z", origin=[0, 0, -1], normal=[0, 0, 1]),
        "b9": jb.sensors.LaserDistance(
            "box", origin=[0, 0, -1], axis="z", normal=[0, 0, 1], bias=0.001
        ),
        "c1": jb.sensors.BodyPose("box", bias=[0.001, 0, 0, deg, 0, 0]),
        "c2": jb.sensors.Orientation("box", orientation=[0, 1, 0, 0], bias=[0, deg, 0]),
    }
    found = jb.read_study(tmp_path / "box.toml").sensors
    # those of the command and the force of a drive are in test_controllers_in_files.py
    assert len({type(sensor) for sensor in expected.values()}) == len(SENSORS) - 2
    for name, sensor in expected.items():
        same(found[name], sensor)


def test_loads_roads_and_base_motions_are_those_of_python(tmp_path):
    times = np.arange(200) / 100
    acc = 0.3 + np.sin(2 * np.pi * 2 * times)
    rows = [f"{x!r},{y!r}" for x, y in zip(times.tolist(), acc.tolist(), strict=True)]
    (tmp_path / "base.csv").write_text("\n".join(["t [s],ax [m/s2]", *rows]))
    (tmp_path / "table.toml").write_text("""jaxbody = 1
bodies.box = {mass = "2 kg", inertia = "1, 1, 1 kg m2"}
supports = {table = {}, road = {}, drop = {}}
records.base = {file = "base.csv", time = "t", channels = {a = "ax"}}
motion.table = {type = "base_motion", record = "base", acceleration = "a", axis = "x", cutoff = "0.5 Hz"}
motion.road = {type = "Road", distances = "0, 5, 10 m", heights = "0, 20, 0 mm", speed = "36 km/h", footprint = "10 cm"}
motion.drop = {type = "PulseMotion", axis = "z", pulse = {type = "HalfSine", amplitude = "15 m/s2", duration = "11 ms"}}
loads.engine = {type = "EngineTorque", on = "box", axis = [1, 0, 0], frequency = "780 1/min", orders = [2, 4], amplitudes = "60, 15 N m"}
loads.pull = {type = "Force", on = ["box", "0, 0, 2 cm"], moment = {type = "Sine", amplitude = "0, 0, 3 kN mm", frequency = "2 Hz"}}
""")  # noqa: E501
    study = jb.read_study(tmp_path / "table.toml")
    record = jb.Record(times, {"a": (acc, "m/s2")})
    same(
        study.motion["table"], jb.inputs.base_motion(record, "a", axis=[1, 0, 0], cutoff=0.5).motion
    )
    same(study.motion["road"], jb.inputs.Road([0, 5, 10], [0, 0.02, 0], speed=10.0, footprint=0.1))
    same(study.motion["drop"], jb.inputs.HalfSine(15.0, 0.011).motion("z"))
    same(
        study.loads["engine"],
        jb.inputs.EngineTorque(
            "box", axis=[1, 0, 0], frequency=13.0, orders=[2, 4], amplitudes=[60, 15]
        ),
    )
    same(
        study.loads["pull"],
        jb.Force(
            ("box", [0, 0, 0.02]), moment=jb.signals.Sine(amplitude=[0, 0, 3.0], frequency=2.0)
        ),
    )


def test_editors_accept_studies_and_refuse_what_is_unknown():
    jsonschema = pytest.importorskip("jsonschema")
    check = jsonschema.Draft202012Validator(schema())
    boxes = 'jaxbody = 1\nbodies.box = {mass = "2 kg"}\n[sensors]' + ALL_SENSORS
    assert check.is_valid(tomllib.loads(CAR + DESIGN)) and check.is_valid(tomllib.loads(boxes))
    for old, new in (
        ('bias = "1 mm"', 'biass = "1 mm"'),
        ("mode = 1", 'mode = "1"'),
        ('record = "run1"\ninitial', "initial"),
    ):
        assert old in CAR + DESIGN and not check.is_valid(
            tomllib.loads((CAR + DESIGN).replace(old, new, 1))
        )


@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
@pytest.mark.parametrize("count", [200, pytest.param(3000, marks=pytest.mark.long)])
def test_mutated_studies_are_studies_or_clear_errors(count, car):
    car.write_text(CAR + DESIGN)
    jb.read_study(car)
    assert check_changed(car, count, jb.read_study) > count / 20


DESIGN = """
[designs.soft]
free = ["spring.stiffness"]
minimize = "ride"
limits = {f = ["1 Hz", "2 Hz"], k = "30 N/mm"}
bounds = {"spring.stiffness" = ["10 N/mm", "90 N/mm"]}
catalogues = {"spring.stiffness" = "20, 30 N/mm"}
quantities = {ride = {type = "rms", sensor = "acc"}, f = {type = "frequency", mode = 1}, k = {type = "value", path = "spring.stiffness"}}
roads.road = {class = "C", speed = "20 m/s"}
"""  # noqa: E501
