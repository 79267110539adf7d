"""What `jaxbody.model.forces` offers, written by `python tests/stubs.py`."""

from jaxbody.model.forces.aerodynamic_forces import SectionAirloads as SectionAirloads
from jaxbody.model.forces.controllers import ControlLaw as ControlLaw
from jaxbody.model.forces.controllers import Controller as Controller
from jaxbody.model.forces.drives import Actuator as Actuator
from jaxbody.model.forces.drives import ControlledDamper as ControlledDamper
from jaxbody.model.forces.force_elements import ForceElement as ForceElement
from jaxbody.model.forces.magnetic_bearings import MagneticBearing as MagneticBearing
from jaxbody.model.forces.rotor_forces import WhirlForce as WhirlForce
