"""Force laws F(x) of one number, of springs and dampers, with and without memory; public as jaxbody.laws."""

from jaxbody.laws.damper_laws import Digressive, Friction
from jaxbody.laws.hydraulic_mounts import Hydraulic
from jaxbody.laws.hysteresis_laws import BoucWen, Dahl, LuGre
from jaxbody.laws.laws import Function, Law, Linear, Sum, TwoSided
from jaxbody.laws.measured_curves import Table
from jaxbody.laws.memory_laws import Hysteretic, Inertial, Viscoelastic
from jaxbody.laws.rubber_laws import Maxwell
from jaxbody.laws.spring_laws import AirSpring, Polynomial, Stop, TensionOnly

__all__ = [
    "AirSpring",
    "BoucWen",
    "Dahl",
    "Digressive",
    "Friction",
    "Function",
    "Hydraulic",
    "Hysteretic",
    "Inertial",
    "Law",
    "Linear",
    "LuGre",
    "Maxwell",
    "Polynomial",
    "Stop",
    "Sum",
    "Table",
    "TensionOnly",
    "TwoSided",
    "Viscoelastic",
]
