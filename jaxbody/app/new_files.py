"""New model files to edit, of a mount table: its mounts with a body on them."""

import json
import re
from pathlib import Path

import jax
import numpy as np

import jaxbody as jb
from jaxbody.files.interchange.data_sheets import mounted_frames
from jaxbody.files.model_files import toml_of, values_of

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
    # adding zero removes negative zeros
    text = toml_of(values_of(jax.tree.map(lambda x: x + 0.0, model)), units=True)
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
            placeholders.sub(rf"\g<0>{PLACEHOLDER}", text),
            MOTION.format(support=support) if support else "",
            SENSORS.format(sensors=sensors),
        ]
    )


def toml_key(name: str) -> str:
    """Return a name as a TOML key, in quotes where TOML requires them."""
    return name if re.fullmatch(r"[A-Za-z0-9_-]+", name) else json.dumps(name, ensure_ascii=False)
