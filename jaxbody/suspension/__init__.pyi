"""What `jaxbody.suspension` offers, written by `python tests/stubs.py`."""

from jaxbody.suspension.alignment_curves import suspension_curves as suspension_curves
from jaxbody.suspension.assemblies import assemble as assemble
from jaxbody.suspension.compliances import Compliance as Compliance
from jaxbody.suspension.compliances import compliant as compliant
from jaxbody.suspension.ready_cars import Car as Car
from jaxbody.suspension.ready_cars import car_on_double_wishbones as car_on_double_wishbones
from jaxbody.suspension.suspensions import Axle as Axle
from jaxbody.suspension.suspensions import Corner as Corner
from jaxbody.suspension.suspensions import Suspension as Suspension
from jaxbody.suspension.suspensions import double_wishbone as double_wishbone
from jaxbody.suspension.suspensions import five_link as five_link
from jaxbody.suspension.suspensions import macpherson as macpherson
from jaxbody.suspension.suspensions import solid_axle as solid_axle
from jaxbody.suspension.wheels import Wheel as Wheel
