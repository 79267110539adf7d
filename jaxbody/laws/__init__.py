"""Force laws F(x) of one number, of springs and dampers; public as jaxbody.laws."""

from jaxbody.laws.damper_laws import Digressive, Friction
from jaxbody.laws.laws import Function, Law, Linear, Sum, TwoSided
from jaxbody.laws.measured_curves import Table
from jaxbody.laws.spring_laws import AirSpring, Polynomial, Stop, TensionOnly

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
