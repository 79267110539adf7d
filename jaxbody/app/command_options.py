"""Options of the commands on model files, and the texts that they take."""

from typing import Any

QUANTITIES = {  # sensors of motion along an axis and of rotation about it
    "displacement": ("Position", "Rotation"),
    "velocity": ("Velocity", "AngularVelocity"),
    "acceleration": ("Acceleration", "AngularAcceleration"),
}


def load_case(text: str) -> tuple[str, list[float]]:
    """Parse a load case, "bump=0,0,3", into its name and acceleration [g]."""
    name, sign, numbers = text.partition("=")
    acceleration = [float(number) for number in numbers.split(",")]
    if not (name and sign and len(acceleration) == 3):
        raise ValueError
    return name, acceleration


def above_zero(text: str) -> float:
    if not 0 < float(text) < float("inf"):
        raise ValueError
    return float(text)


def band(text: str) -> tuple[float, float]:
    low, _, high = text.partition(":")
    if not 0 < float(low) < float(high):
        raise ValueError
    return float(low), float(high)


load_case.__name__ = "name and three numbers, bump=0,0,3,"
above_zero.__name__ = "number above zero,"
band.__name__ = "two frequencies in ascending order, 0.5:20,"  # in messages of argparse


def ports_options(required: bool) -> tuple[Any, ...]:
    several: dict[str, Any] = {"action": "append", "required": required, "default": []}
    directions = "support and x, y, z, rx, ry or rz"
    places = "body and direction, element, or sensor of the file"
    return (
        (("--input",), several | {"metavar": "SUPPORT.z", "help": directions}),
        (("--output",), several | {"metavar": "BODY.z", "help": places}),
        (
            ("--quantity",),
            {
                "choices": list(QUANTITIES),
                "default": "displacement",
                "help": "of the output (default: displacement)",
            },
        ),
    )


def case_option(required: bool) -> tuple[Any, ...]:
    named: dict[str, Any] = {
        "type": load_case,
        "action": "append",
        "required": required,
        "default": [],
    }
    return ("--case",), named | {"metavar": "NAME=X,Y,Z", "help": "acceleration of a load case [g]"}


BAND = (
    ("--frequencies",),
    {
        "type": band,
        "default": (0.1, 50.0),
        "metavar": "LOW:HIGH",
        "help": "[Hz] (default: 0.1:50)",
    },
)
OF_RESPONSE = (
    BAND,
    (
        ("--points",),
        {
            "type": int,
            "default": 400,
            "metavar": "N",
            "help": "number of frequencies (default: 400)",
        },
    ),
    (
        ("--kind",),
        {
            "choices": list(QUANTITIES),
            "default": "displacement",
            "help": "of the input (default: displacement)",
        },
    ),
)
OF_MOTION = (
    (
        ("--duration",),
        {"type": above_zero, "default": 5.0, "metavar": "T", "help": "[s] (default: 5)"},
    ),
    (
        ("--interval",),
        {
            "type": above_zero,
            "default": 0.01,
            "metavar": "DT",
            "help": "between samples [s] (default: 0.01)",
        },
    ),
)
OF_STEPS = (
    (
        ("--rtol",),
        {
            "type": above_zero,
            "metavar": "R",
            "help": "tolerance of the integration (default: 1e-8)",
        },
    ),
    (
        ("--max-steps",),
        {
            "type": int,
            "metavar": "N",
            "help": "largest number of its steps (default: by the number of samples)",
        },
    ),
)
FREE = (
    ("--free",),
    {
        "action": "append",
        "metavar": "PATH",
        "help": "parameter or pattern (default: those of [fit])",
    },
)
DESIGN = (("--design",), {"metavar": "NAME", "help": "design of the file (default: its first one)"})
WRITE = (
    ("--write",),
    {
        "action": "store_true",
        "help": "write the values into the file, in the units that stand there",
    },
)
