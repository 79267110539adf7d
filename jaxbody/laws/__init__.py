"""Force laws F(x) of one number, of springs and dampers; public as jaxbody.laws."""

from jaxbody.laws.laws import (
    AirSpring,
    Digressive,
    Friction,
    Function,
    Law,
    Linear,
    Polynomial,
    Stop,
    Sum,
    Table,
    TensionOnly,
    TwoSided,
)

__all__ = [
    "AirSpring",
    "Digressive",
    "Friction",
    "Function",
    "Law",
    "Linear",
    "Polynomial",
    "Stop",
    "Sum",
    "Table",
    "TensionOnly",
    "TwoSided",
]


def __dir__():
    return __all__
