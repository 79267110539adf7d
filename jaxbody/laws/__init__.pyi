"""Force laws F(x) of one number, of springs and dampers, with and without memory; public
as jaxbody.laws."""

from jaxbody.laws.damper_laws import Digressive as Digressive
from jaxbody.laws.damper_laws import Friction as Friction
from jaxbody.laws.hydraulic_mounts import Hydraulic as Hydraulic
from jaxbody.laws.hysteresis_laws import BoucWen as BoucWen
from jaxbody.laws.hysteresis_laws import Dahl as Dahl
from jaxbody.laws.hysteresis_laws import LuGre as LuGre
from jaxbody.laws.laws import Function as Function
from jaxbody.laws.laws import Law as Law
from jaxbody.laws.laws import Linear as Linear
from jaxbody.laws.laws import Sum as Sum
from jaxbody.laws.laws import TwoSided as TwoSided
from jaxbody.laws.measured_curves import Table as Table
from jaxbody.laws.memory_laws import Hysteretic as Hysteretic
from jaxbody.laws.memory_laws import Inertial as Inertial
from jaxbody.laws.memory_laws import Viscoelastic as Viscoelastic
from jaxbody.laws.rubber_laws import Maxwell as Maxwell
from jaxbody.laws.spring_laws import AirSpring as AirSpring
from jaxbody.laws.spring_laws import Polynomial as Polynomial
from jaxbody.laws.spring_laws import Stop as Stop
from jaxbody.laws.spring_laws import TensionOnly as TensionOnly
