"""New model files to edit: a ready model (`jaxbody.presets`) with a motion, sensors, a design and,
as comments, measured data; or the mounts of a mount table with a body on them."""

import dataclasses
import json
import re
from pathlib import Path

import jax
import numpy as np

import jaxbody as jb
from jaxbody.files.interchange.data_sheets import mounted_frames
from jaxbody.files.writers import toml_of, values_of

HEADING = """# A model for jaxbody. Check it with `jaxbody check FILE`; `jaxbody --help` lists what comes next.
# Numbers without a unit are in SI; "21 N/mm" is a number with its own. Bodies: `position` is where the origin O of the body's axes is
# before the model settles, `com` the center of mass from O. Elements: each end is a body, a support or "world", and a point in its axes.
"""  # noqa: E501
OF_SHEET = """# The mounts are those of {file}, in its axes. Mass, center of mass and inertia of {bodies} are not in it: write yours below.
"""  # noqa: E501
PLACEHOLDER = ", not in the sheet: a placeholder"
PLACEHOLDER_MASS, PLACEHOLDER_INERTIA = 100.0, [5.0, 5.0, 5.0]
MOTION = """
# the motion of a support, for `jaxbody simulate FILE`
[motion]
{support} = {{type = "Harmonic", frequency = "1.5 Hz", translation = "0, 0, 5 mm"}}
"""
SENSORS = """
# what is read: in `jaxbody simulate FILE --out motion.csv`, and below
[sensors]
{sensors}
"""
DESIGN = """
# what `jaxbody tune FILE` chooses; with --write, the numbers are written into the file
[designs.first]
{design}
"""
MEASURED = """
# measured data for `jaxbody fit FILE`: remove the # before the lines that you have data for
# [records.run1]
# file = "run1.csv"                      # a text file beside this one, with the columns t [s], x [{unit}]{base}
# time = "t"
# channels = {{reading = "x"{channel}}}
# [experiments.run1]
# record = "run1"                        # a channel is read by the sensor of the same name
# initial = {initial}
{motion}# # validate = true                      # to hold it out, and validate by it what is fitted to the others
# [experiments.modal]
# type = "MeasuredModes"
# frequency = "{frequencies} Hz"
# noise = {{frequency = "0.02 Hz"}}        # standard deviation; without it, estimated
# [fit]
# free = ["{fitted}"]
"""  # noqa: E501
ON_BASE = (
    '# motion.{support} = {{type = "Sampled", record = "run1", translation = "base", axis = "z"}}\n'
)


@dataclasses.dataclass(frozen=True)
class Start:
    """Parts of the file of a ready model, as TOML text: frequencies, sensors, parameters to fit and
    a design to tune; `unit`: unit of the measured readings; `initial`: initial state of an
    experiment without a moving support."""

    frequencies: str  # [Hz]
    sensors: str
    fitted: str
    design: str = ""
    unit: str = "mm"
    initial: str = '"rest"'


STARTS = {
    "quarter_car": Start(
        "1.41, 8.8",
        'reading = {type = "Position", on = "body", axis = "z"}',
        "suspension.stiffness",
        """free = ["suspension.stiffness"]
minimize = "bounce"
limits = {sag = ["-120 mm", inf]}        # lower and upper
bounds = {"suspension.stiffness" = ["10 N/mm", "90 N/mm"]}
[designs.first.quantities]
bounce = {type = "frequency", mode = 1}
sag = {type = "deflection", element = "suspension"}  # negative in compression""",
    ),
    "half_car": Start(
        "0.93, 1.5",
        'reading = {type = "Position", on = "body", axis = "z"}',
        "front spring.stiffness",
        """free = ["front spring.stiffness", "rear spring.stiffness"]
minimize = "coupling"
limits = {lowest = ["0.9 Hz", inf]}      # lower and upper
bounds = {"*.stiffness" = ["10 N/mm", "90 N/mm"]}
[designs.first.quantities]
coupling = {type = "coupling_of_modes"}  # of heave and pitch
lowest = {type = "frequency", mode = 1}""",
    ),
    "full_car": Start(
        "1.34, 1.57",
        'reading = {type = "Acceleration", on = "car", axis = "z"}\n'
        'travel = {type = "Elongation", on = "spring fl"}',
        "car.mass",
        """free = ["spring fl.damping = spring fr.damping", "spring rl.damping = spring rr.damping"]
minimize = "discomfort"
limits = {travel = ["-inf", "60 mm"]}    # lower and upper
bounds = {"*.damping" = ["0.2 N s/mm", "9 N s/mm"]}
[designs.first.roads]
"road fl" = {class = "C", speed = "72 km/h"}
"road fr" = {class = "C", speed = "72 km/h"}
"road rl" = {class = "C", speed = "72 km/h"}
"road rr" = {class = "C", speed = "72 km/h"}
[designs.first.quantities]
discomfort = {type = "comfort", weights = {reading = "Wk"}}
travel = {type = "stroke", sensor = "travel"}""",
        unit="g",
    ),
    "full_car_on_double_wishbones": Start(
        "1.33, 1.55",
        'reading = {type = "Acceleration", on = "car", axis = "z"}',
        "car.mass",
        unit="g",
    ),
    "four_bar": Start(
        "18.2",
        'reading = {type = "Position", on = "rocker", point = [0.08, 0, 0], axis = "x"}',
        "spring.spring.coefficient",
        """free = ["spring.spring.coefficient"]
minimize = "near"
bounds = {"spring.spring.coefficient" = ["0.5 N m/rad", "20 N m/rad"]}
[designs.first.quantities]
near = {type = "band_intrusion", band = "15, 25 Hz"}  # 0 if no natural frequency lies there""",
    ),
    "engine_on_mounts": Start(
        "7.5, 8.63",
        'reading = {type = "Position", on = "engine", axis = "z"}',
        "engine.mass",
        """free = ["mount 2.stiffness"]
minimize = "coupling"
limits = {lowest = ["7 Hz", inf]}        # lower and upper
bounds = {"*.stiffness" = ["40 N/mm", "1 kN/mm"]}
[designs.first.quantities]
coupling = {type = "coupling_of_modes"}
lowest = {type = "frequency", mode = 1}""",
    ),
    "isolated_table": Start(
        "3.62, 3.73",
        'reading = {type = "Position", on = "table", axis = "z"}',
        "table.mass",
        """free = ["isolator 1.stiffness = isolator *.stiffness"]
minimize = "near"
limits = {lowest = ["4 Hz", inf]}        # lower and upper
bounds = {"*.stiffness" = ["10 N/mm", "0.2 kN/mm"]}
[designs.first.quantities]
near = {type = "band_intrusion", band = "5, 9 Hz"}  # 0 if no natural frequency lies there
lowest = {type = "frequency", mode = 1}""",
    ),
    "rubber_isolators": Start(
        "4.39, 4.42",
        'reading = {type = "Position", on = "instrument", axis = "z"}',
        "instrument.mass",
        """free = ["isolator 1.z.terms.0.coefficient = isolator *.z.terms.0.coefficient"]
minimize = "stiffness"
limits = {bounce = ["8 Hz", inf]}        # lower and upper
bounds = {"isolator 1.z.terms.0.coefficient" = ["5 N/mm", "90 N/mm"]}
[designs.first.quantities]
stiffness = {type = "value", path = "isolator 1.z.terms.0.coefficient"}
bounce = {type = "frequency", mode = 4}  # of slow motions, in which the branches are relaxed""",
    ),
    "stewart_table": Start(
        "2.69, 2.69",
        'reading = {type = "Position", on = "table", axis = "z"}',
        "table.mass",
        """free = ["leg 1.stiffness = leg *.stiffness"]
minimize = "stiffness"
limits = {lowest = ["3 Hz", inf]}        # lower and upper
bounds = {"*.stiffness" = ["1 N/mm", "90 N/mm"]}
[designs.first.quantities]
stiffness = {type = "value", path = "leg 1.stiffness"}
lowest = {type = "frequency", mode = 1}""",
    ),
    "elastic_pendulum": Start(
        "0.5, 0.5",
        'reading = {type = "Position", on = "bob", axis = "z"}',
        "spring.stiffness",
        """free = ["spring.stiffness"]
minimize = "stiffness"
limits = {bounce = ["1.2 Hz", inf]}      # lower and upper
bounds = {"spring.stiffness" = ["10 N/m", "90 N/m"]}
[designs.first.quantities]
stiffness = {type = "value", path = "spring.stiffness"}
bounce = {type = "frequency", mode = 3}""",
        initial='{q = "0, 0, 20 mm", v = "0, 0, 0 m/s"}',
    ),
    "double_pendulum": Start(
        "0.43, 1.14",
        'reading = {type = "JointAngle", on = "lower"}',
        "lower.mass",
        unit="deg",
        initial='{q = "10, 0 deg", v = "0, 0 deg/s"}',
    ),
    "coupled_gliders": Start(
        "0.5, 0.87",
        'reading = {type = "Position", on = "one", axis = "x"}',
        "middle.stiffness",
        """free = ["middle.stiffness"]
minimize = "stiffness"
limits = {second = ["1 Hz", inf]}        # lower and upper
bounds = {"middle.stiffness" = ["1 N/m", "20 N/m"]}
[designs.first.quantities]
stiffness = {type = "value", path = "middle.stiffness"}
second = {type = "frequency", mode = 2}""",
        initial='{q = "20, 0 mm", v = "0, 0 m/s"}',
    ),
}
STARTS["hydraulic_engine_mounts"] = dataclasses.replace(
    STARTS["engine_on_mounts"], frequencies="7.5, 8.6"
)


def text_of(name: str) -> str:
    """Return the text of the file of a ready model."""
    model, start = getattr(jb.presets, name)(), STARTS[name]
    support = next((toml_key(name) for name in model.layout.supports), "")
    on_base = {
        "base": ", base [mm]",
        "channel": ', base = "base"',
        "motion": ON_BASE.format(support=support),
    }
    return "".join(
        [
            HEADING,
            _text_of_model(model),
            MOTION.format(support=support) if support else "",
            SENSORS.format(sensors=start.sensors),
            DESIGN.format(design=start.design) if start.design else "",
            MEASURED.format(
                **dataclasses.asdict(start), **(on_base if support else dict.fromkeys(on_base, ""))
            ),
        ]
    )


def text_of_mounts(path: Path) -> str:
    """Return the text of a file with the mounts of a mount table. The names in column a become
    bodies with placeholder masses, at the origin, so that points in their axes are those of the
    table."""
    bodies, supports = mounted_frames(path)
    bodies, supports = bodies or ["engine"], supports or ["frame"]
    origin = dict.fromkeys([bodies[0], *supports, *bodies[1:]], jb.Support())
    mounts = jb.files.read_mounts(path, origin)
    ends = [
        end for mount in mounts.values() for end in zip(mount.between, mount.points, strict=True)
    ]
    places = {name: [point for end, point in ends if end == name] for name in origin}
    centers = {name: np.mean(points, 0).round(3) for name, points in places.items() if points}
    model = jb.Model(
        bodies={
            name: jb.Body(PLACEHOLDER_MASS, PLACEHOLDER_INERTIA, com=centers[name])
            for name in bodies
            if name in centers
        },
        supports={name: jb.Support() for name in supports if name in centers},
        elements=mounts,
        gravity=[0, 0, -9.81],
    )
    placeholders = re.compile("^(?:mass|inertia|com) = .*$", re.M)
    support = toml_key(model.layout.supports[0]) if model.layout.supports else ""
    sensors = "\n".join(
        f'{toml_key(f"{name}_z")} = {{type = "Position", on = "{name}", axis = "z"}}'
        for name in model.layout.bodies
    )
    return "".join(
        [
            HEADING,
            OF_SHEET.format(file=path.name, bodies=" and ".join(model.layout.bodies)),
            placeholders.sub(rf"\g<0>{PLACEHOLDER}", _text_of_model(model)),
            MOTION.format(support=support) if support else "",
            SENSORS.format(sensors=sensors),
        ]
    )


def _text_of_model(model: jb.Model) -> str:
    """Return the text of a model with its units, without negative zeros."""
    text = toml_of(values_of(jax.tree.map(lambda x: x + 0.0, model)), units=True)
    return text.replace(
        "gravity = [0.0, 0.0, 0.0] # m/s2",
        "gravity = [0.0, 0.0, 0.0] # m/s2; zero, as in the source of this model",
    )


def toml_key(name: str) -> str:
    """Return a name as a TOML key, in quotes where TOML requires them."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)
