"""Options of the commands on model files, and the texts that they take."""

from typing import Any

KINDS = ("displacement", "velocity", "acceleration")
QUANTITIES = {  # sensors of an output along an axis, about it, and of an element
    "displacement": ("Position", "Rotation", "Elongation"),
    "velocity": ("Velocity", "AngularVelocity", "Elongation"),
    "acceleration": ("Acceleration", "AngularAcceleration", "Elongation"),
    "force": ("Reaction", "Reaction", "LoadCell"),
}


def load_case(text: str) -> tuple[str, list[float]]:
    """Parse a load case, "bump=0,0,3", into its name and acceleration [g]."""
    name, sign, numbers = text.partition("=")
    acceleration = [float(number) for number in numbers.split(",")]
    if not (name and sign and len(acceleration) == 3):
        raise ValueError
    return name, acceleration


def above_zero(text: str) -> float:
    """Parse a number above zero."""
    if not 0 < float(text) < float("inf"):
        raise ValueError
    return float(text)


def band(text: str) -> tuple[float, float]:
    """Parse "0.5:20" into two frequencies [Hz] in ascending order."""
    low, _, high = text.partition(":")
    if not 0 < float(low) < float(high):
        raise ValueError
    return float(low), float(high)


def unit_of(text: str) -> tuple[str, str]:
    """Parse "acc=g" into the name of a column and its unit."""
    name, sign, unit = text.rpartition("=")
    if not (name and sign and unit):
        raise ValueError
    return name, unit


def span(text: str) -> tuple[str, str, str]:
    """Parse "left.stiffness=100 N/mm : 400 N/mm" into a path and two texts; the unit of the second
    is that of the first if it has none."""
    path, sign, ends = text.partition("=")
    low, colon, high = (part.strip() for part in ends.partition(":"))
    if not (path and sign and low and colon and high):
        raise ValueError
    unit = high.lstrip("+-.0123456789e").strip()
    return path.strip(), low if low[-1:].isalpha() or not unit else f"{low} {unit}", high


span.__name__ = "path, and two values with their unit, left.stiffness=100:400 N/mm,"
load_case.__name__ = "name and three numbers, bump=0,0,3,"
unit_of.__name__ = "name and unit, acc=g,"
above_zero.__name__ = "number above zero,"
band.__name__ = "two frequencies in ascending order, 0.5:20,"  # in messages of argparse


def ports_options(required: bool) -> tuple[Any, ...]:
    """Return the options that name inputs and outputs of a linear system."""
    several: dict[str, Any] = {"action": "append", "required": required, "default": []}
    directions = (
        "support or body and x, y, z, rx, ry or rz: a motion, or a force or moment; a load of the "
        "file, such as an Unbalance; or an actuator or controlled damper: its command"
    )
    places = "body or element and direction, element, or sensor of the file"
    return (
        (("--input",), several | {"metavar": "NAME.z", "help": directions}),
        (("--output",), several | {"metavar": "NAME.z", "help": places}),
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
    """Return the option that states a load case; it may be given several times."""
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


def number_of(flag: str, what: str, default: int) -> tuple[Any, ...]:
    """Return an option that takes a whole number."""
    return (flag,), {
        "type": int,
        "default": default,
        "metavar": "N",
        "help": f"{what} (default: {default})",
    }


OF_RESPONSE = (
    BAND,
    number_of("--points", "number of frequencies", 400),
    (
        ("--kind",),
        {
            "choices": KINDS,
            "default": "displacement",
            "help": "of the motion of a support (default: displacement)",
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
            "metavar": "DT",
            "help": "between samples [s] (default: 0.01, or a twentieth of the shortest period of "
            "harmonic motions and loads)",
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
OVER = (
    (
        ("--over",),
        {
            "type": span,
            "required": True,
            "metavar": "PATH=LOW:HIGH",
            "help": 'a parameter and its range, such as "left.stiffness=100:400 N/mm"',
        },
    ),
    number_of("--points", "number of values", 11),
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
SEVERAL: dict[str, Any] = {"action": "append", "required": True, "metavar": "NAME,..."}
OF_ESTIMATE: tuple[Any, ...] = (
    (("file",), {"nargs": "+", "help": "record, or several records of the same test"}),
    (("--input",), SEVERAL | {"help": "columns of the inputs, such as forces"}),
    (("--output",), SEVERAL | {"help": "columns of the outputs"}),
    (("--time",), {"metavar": "NAME", "help": "column of the times"}),
    (
        ("--rate",),
        {"type": above_zero, "metavar": "F", "help": "samples per second, without times"},
    ),
    (
        ("--unit",),
        {
            "type": unit_of,
            "action": "append",
            "default": [],
            "metavar": "NAME=UNIT",
            "help": "unit of a column that states none in the file, such as acc=g",
        },
    ),
    (("--decimal",), {"default": ".", "choices": ".,", "help": "decimal mark of text files"}),
    (("--method",), {"default": "H1", "help": "H1, H2 or Hv (default: H1)"}),
    (
        ("--segment",),
        {
            "type": above_zero,
            "metavar": "T",
            "help": "length of a segment [s] (default: the period of the inputs, or 16 segments in "
            "the record)",
        },
    ),
    (("--window",), {"help": "window of scipy.signal (default: none for whole periods, or hann)"}),
    (
        ("--pulse",),
        {
            "type": above_zero,
            "metavar": "T",
            "help": "of a test with an impact hammer: length of the force pulse [s]",
        },
    ),
    (
        ("--decay",),
        {
            "type": above_zero,
            "metavar": "T",
            "help": "of a test with an impact hammer: time constant of the exponential window [s]",
        },
    ),
    (("--band",), {"type": band, "metavar": "LOW:HIGH", "help": "[Hz] (default: all)"}),
    (("--order",), {"type": int, "metavar": "N", "help": "highest order of the polynomials"}),
    (
        ("--draw",),
        {
            "choices": ("responses", "modes"),
            "default": "responses",
            "help": "what --out draws (default: responses)",
        },
    ),
)
