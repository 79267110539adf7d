"""What `jaxbody.model.joints` offers, written by `python tests/stubs.py`."""

from jaxbody.model.joints.combined_joints import Composite as Composite
from jaxbody.model.joints.combined_joints import Cylindrical as Cylindrical
from jaxbody.model.joints.combined_joints import HeavePitch as HeavePitch
from jaxbody.model.joints.combined_joints import HeavePitchRoll as HeavePitchRoll
from jaxbody.model.joints.combined_joints import Planar as Planar
from jaxbody.model.joints.combined_joints import Translation as Translation
from jaxbody.model.joints.combined_joints import Universal as Universal
from jaxbody.model.joints.joints import Ball as Ball
from jaxbody.model.joints.joints import Fixed as Fixed
from jaxbody.model.joints.joints import Free as Free
from jaxbody.model.joints.joints import Guide as Guide
from jaxbody.model.joints.joints import Hinge as Hinge
from jaxbody.model.joints.joints import Joint as Joint
from jaxbody.model.joints.kinematics import retract as retract
