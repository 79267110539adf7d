"""What `jaxbody.model.laws` offers, written by `python tests/stubs.py`."""

from jaxbody.model.laws.hydraulic_mounts import Hydraulic as Hydraulic
from jaxbody.model.laws.hysteresis_laws import BoucWen as BoucWen
from jaxbody.model.laws.hysteresis_laws import Dahl as Dahl
from jaxbody.model.laws.hysteresis_laws import LuGre as LuGre
from jaxbody.model.laws.laws import Function as Function
from jaxbody.model.laws.laws import Law as Law
from jaxbody.model.laws.laws import Linear as Linear
from jaxbody.model.laws.laws import Sum as Sum
from jaxbody.model.laws.laws import TwoSided as TwoSided
from jaxbody.model.laws.memory_laws import Hysteretic as Hysteretic
from jaxbody.model.laws.memory_laws import Inertial as Inertial
from jaxbody.model.laws.memory_laws import Viscoelastic as Viscoelastic
from jaxbody.model.laws.rubber_laws import Maxwell as Maxwell
from jaxbody.model.laws.spring_laws import AirSpring as AirSpring
from jaxbody.model.laws.spring_laws import BumpStop as BumpStop
from jaxbody.model.laws.spring_laws import Digressive as Digressive
from jaxbody.model.laws.spring_laws import Friction as Friction
from jaxbody.model.laws.spring_laws import Polynomial as Polynomial
from jaxbody.model.laws.spring_laws import TensionOnly as TensionOnly
from jaxbody.model.laws.tabulated_laws import Tabulated as Tabulated
