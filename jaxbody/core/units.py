"""Units by name, as instruments and files state them, with their factors to SI.

    value [SI] = factor * value [unit];   dimension = exponents of (m, kg, s, rad, A)

Angles have a dimension of their own, so that degrees given for meters are detected. Products are "N
m", "N.m", "N-m" or "N*m"; powers are "m/s^2", "m/s2", "m s-2" or "m/s**2". A slash divides by the
next unit only, or by a product in parentheses.
"""

import difflib
import math
import re
from dataclasses import dataclass

from jaxbody.core.errors import JaxbodyError, Problem

__all__ = [
    "Unit",
    "is_unit",
    "parse",
]


def __dir__():
    return __all__


Dimension = tuple[int, int, int, int, int]
GRAVITY = 9.80665  # m/s2, standard gravity
EARTH = (9.7, 9.9)  # m/s2, range of the gravity of the Earth
POUND = 4.4482216152605  # N
TURN = 2 * math.pi

LENGTH: Dimension = (1, 0, 0, 0, 0)
MASS: Dimension = (0, 1, 0, 0, 0)
TIME: Dimension = (0, 0, 1, 0, 0)
ANGLE: Dimension = (0, 0, 0, 1, 0)
RATE: Dimension = (0, 0, -1, 0, 0)
SPEED: Dimension = (1, 0, -1, 0, 0)
ANGULAR_RATE: Dimension = (0, 0, -1, 1, 0)
ACCELERATION: Dimension = (1, 0, -2, 0, 0)
FORCE: Dimension = (1, 1, -2, 0, 0)
MOMENT: Dimension = (2, 1, -2, 0, 0)
VOLTAGE: Dimension = (2, 1, -3, 0, -1)
PRESSURE: Dimension = (-1, 1, -2, 0, 0)
CURRENT: Dimension = (0, 0, 0, 0, 1)
NONE: Dimension = (0, 0, 0, 0, 0)

PREFIXES = {
    "": 1.0,
    "n": 1e-9,
    "u": 1e-6,
    "m": 1e-3,
    "c": 1e-2,
    "d": 0.1,
    "k": 1e3,
    "M": 1e6,
    "G": 1e9,
}
PREFIXED = {  # SI units with their usual prefixes
    "m": (LENGTH, "numcdk"),
    "s": (TIME, "num"),
    "N": (FORCE, "umkM"),
    "V": (VOLTAGE, "numkM"),
    "A": (CURRENT, "numk"),
    "Pa": (PRESSURE, "kMG"),
    "Hz": (RATE, "mkM"),
    "rad": (ANGLE, "num"),
    "J": (MOMENT, "mk"),
}
PLAIN = {
    "kg": (1.0, MASS),
    "t": (1e3, MASS),
    "lb": (POUND / GRAVITY, MASS),
    "slug": (POUND / 0.3048, MASS),
    "in": (0.0254, LENGTH),
    "mil": (2.54e-5, LENGTH),
    "ft": (0.3048, LENGTH),
    "yd": (0.9144, LENGTH),
    "mi": (1609.344, LENGTH),
    "min": (60.0, TIME),
    "h": (3600.0, TIME),
    "mph": (1609.344 / 3600, SPEED),
    "kph": (1 / 3.6, SPEED),
    "ips": (0.0254, SPEED),
    "deg": (TURN / 360, ANGLE),
    "rev": (TURN, ANGLE),
    "rpm": (TURN / 60, ANGULAR_RATE),
    "dps": (TURN / 360, ANGULAR_RATE),
    "g": (GRAVITY, ACCELERATION),
    "Gal": (0.01, ACCELERATION),
    "Nm": (1.0, MOMENT),
    "Nmm": (1e-3, MOMENT),
    "kNm": (1e3, MOMENT),
    "Ns": (1.0, (1, 1, -1, 0, 0)),
    "daN": (10.0, FORCE),
    "kgf": (GRAVITY, FORCE),
    "kp": (GRAVITY, FORCE),
    "lbf": (POUND, FORCE),
    "kip": (1e3 * POUND, FORCE),
    "bar": (1e5, PRESSURE),
    "psi": (POUND / 0.0254**2, PRESSURE),
    "ksi": (1e3 * POUND / 0.0254**2, PRESSURE),
    "%": (0.01, NONE),
    "1": (1.0, NONE),
    "-": (1.0, NONE),
}
ALSO = {
    "volt": "V",
    "volts": "V",
    "sec": "s",
    "second": "s",
    "seconds": "s",
    "msec": "ms",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "radian": "rad",
    "radians": "rad",
    "meter": "m",
    "meters": "m",
    "metre": "m",
    "metres": "m",
    "newton": "N",
    "newtons": "N",
    "g0": "g",
    "gn": "g",
    "lbs": "lb",
    "lbm": "lb",
    "thou": "mil",
    "mils": "mil",
    "rpm": "rpm",
    "dps": "dps",
    "inch": "in",
    "inches": "in",
    "hertz": "Hz",
    "percent": "%",
}
KNOWN = PLAIN | {
    prefix + name: (PREFIXES[prefix], dimension)
    for name, (dimension, prefixes) in PREFIXED.items()
    for prefix in ("", *prefixes)
}
WORDS = {
    LENGTH: "m",
    SPEED: "m/s",
    ACCELERATION: "m/s2",
    ANGLE: "rad",
    ANGULAR_RATE: "rad/s",
    (0, 0, -2, 1, 0): "rad/s2",
    TIME: "s",
    MASS: "kg",
    RATE: "1/s",
    FORCE: "N",
    MOMENT: "N m",
    (0, 1, -2, 0, 0): "N/m",
    (0, 1, -1, 0, 0): "N s/m",
    (1, 1, -3, 0, 0): "N/s",
    (2, 1, -2, -1, 0): "N m/rad",
    (0, -1, 2, 0, 0): "m/N",
    (0, -1, 1, 0, 0): "m/(N s)",
    (0, -1, 0, 0, 0): "1/kg",
    VOLTAGE: "V",
    CURRENT: "A",
    PRESSURE: "Pa",
    NONE: "1",
}
TWOFOLD = {
    "mg": "g for gravity, kg for mass",
    "gal": "Gal",
    "M": "m",
    "Sec": "s",
    "G": "g",
}
SUPERSCRIPTS = str.maketrans(
    {
        "²": "2",
        "³": "3",
        "⁴": "4",
        "⁻": "-",
        "¹": "1",
        "µ": "u",
        "μ": "u",
        "·": "*",
        "⋅": "*",
        "º": "°",
    }
)
TOKEN = re.compile(
    r"\s*(?:(?P<power>\*\*|\^)|(?P<sign>[*/.()]|-(?=[A-Za-z°]))|(?P<number>[+-]?\d+)|(?P<word>[A-Za-z°%]+\d?(?=$|[^\d])|[A-Za-z°%]+)|(?P<other>\S))"
)


@dataclass(frozen=True)
class Unit:
    """A unit: its text, its factor to SI, its dimension.

    >>> parse("km/h", "speed").si
    'm/s'
    """

    text: str
    factor: float
    dimension: Dimension

    @property
    def si(self) -> str:
        """The SI unit of its dimension, as text."""
        return si_words(self.dimension)


def si_words(dimension: Dimension) -> str:
    """Return the usual name of an SI unit, "m/s2", or else its base units, "kg m s-1"."""
    if dimension in WORDS:
        return WORDS[dimension]
    m, kg, *others = dimension
    powers = zip(("kg", "m", "s", "rad", "A"), (kg, m, *others), strict=True)
    return " ".join([name + (str(n) if n != 1 else "") for name, n in powers if n])


def parse(text: str, where: str) -> Unit:
    """Return the unit with this name; messages begin with `where`. Errors: UNKNOWN_UNIT, with the
    nearest names; NO_UNIT for an empty name.

    >>> parse("mm", "stroke").factor
    0.001
    """
    written = str(text).strip()
    if not written:
        raise JaxbodyError(
            Problem(
                "NO_UNIT",
                where,
                "has an empty unit",
                text,
                'such as "m/s2"',
                'Write "1" for a number without a unit.',
            )
        )
    if written in PLAIN:
        return Unit(written, *PLAIN[written])
    tokens = TOKEN.finditer(written.translate(SUPERSCRIPTS))
    rest = [(str(match.lastgroup), match.group().strip()) for match in tokens]
    _require(len(written) <= 60 and "other" not in dict(rest), written, written, where)
    rest.append(("end", ""))
    factor, dimension = _product(rest, written, where)
    _require(rest[0][0] == "end", written, written, where)
    return Unit(written, factor, dimension)


def is_unit(text: str) -> bool:
    """Return whether a text is the name of a unit.

    >>> is_unit("N/mm"), is_unit("left")
    (True, False)
    """
    try:
        parse(text, "")
    except JaxbodyError:
        return False
    return True


def _product(
    rest: list[tuple[str, str]], written: str, where: str, depth: int = 0
) -> tuple[float, Dimension]:
    """Return factor and dimension of the product of the units up to the end or a closing
    parenthesis; they are removed from `rest`."""
    factor, dimension, sign, divided = 1.0, NONE, 1, False
    while True:
        f, d = _power(rest, written, where, depth)
        factor *= f**sign
        dimension = tuple(a + sign * b for a, b in zip(dimension, d, strict=True))
        kind, token = rest[0]
        if kind == "end" or token == ")":
            return factor, dimension  # pyright: ignore[reportReturnType]
        sign = -1 if token == "/" else 1
        if divided and sign == 1:
            raise JaxbodyError(
                Problem(
                    "UNKNOWN_UNIT",
                    where,
                    f"unit '{written}' can be read in two ways",
                    written,
                    "N/(m s) or N s/m",
                    "A product after a slash may belong above or below it: use parentheses.",
                )
            )
        divided = divided or sign == -1
        if kind == "sign" and token in "*/.-":
            rest.pop(0)


def _power(
    rest: list[tuple[str, str]], written: str, where: str, depth: int
) -> tuple[float, Dimension]:
    """Return factor and dimension of one unit, or a product in parentheses, with its power."""
    kind, token = rest.pop(0)
    power = 1
    if token == "(" and depth < 5:
        factor, dimension = _product(rest, written, where, depth + 1)
        _require(rest.pop(0)[1] == ")", written, written, where)
    elif (kind, token) == ("number", "1"):
        factor, dimension = 1.0, NONE
    else:
        _require(kind == "word", written, written, where)
        name, power = (
            (token[:-1], int(token[-1]))
            if token[-1].isdigit() and token not in ALSO
            else (token, 1)
        )
        name = name if name in KNOWN else ALSO.get(name.lower(), name)
        _require(name in KNOWN, name, written, where)
        factor, dimension = KNOWN[name]
    if rest[0][0] == "power":
        rest.pop(0)
        _require(rest[0][0] == "number", written, written, where)
    if rest[0][0] == "number":
        power = int(rest.pop(0)[1])
    _require(1 <= abs(power) <= 6, written, written, where)
    return factor**power, tuple(power * n for n in dimension)  # pyright: ignore[reportReturnType]


def _require(good: bool, name: str, written: str, where: str) -> None:
    """Raise UNKNOWN_UNIT, with the nearest names, unless a unit is `good`."""
    if good:
        return
    near = [known for known in KNOWN if known.lower() == name.lower()]
    near = near or difflib.get_close_matches(name, KNOWN, 3, 0.6)
    hint = (
        f"Did you mean {TWOFOLD[name]}?"
        if name in TWOFOLD
        else f"Did you mean {' or '.join(near)}?"
        if near
        else "Convert the numbers first."
    )
    message = f"unit '{written:.60}' is unknown" + (f": '{name}'" if name != written else "")
    raise JaxbodyError(
        Problem(
            "UNKNOWN_UNIT",
            where,
            message,
            written,
            "m mm in deg rad s g N kN lbf V ... and products of them",
            hint,
        )
    )
