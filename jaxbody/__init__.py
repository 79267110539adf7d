"""jaxbody: rigid bodies on springs from a base whose motion is imposed, differentiable."""

from jaxbody.bodies import Body, Support
from jaxbody.elements import Bushing, Element, Spring
from jaxbody.errors import JaxbodyError, JaxbodyWarning, Status
from jaxbody.experiments import Experiment
from jaxbody.identification import Fit, fit
from jaxbody.joints import Ball, Fixed, Free, Guide, Hinge, Joint
from jaxbody.kinematics import retract
from jaxbody.linearizations import excitation, linearize
from jaxbody.mechanics import dissipation, kinetic_energy, lagrangian, potential_energy
from jaxbody.models import Model, State
from jaxbody.motions import AtRest, Harmonic, Motion, Sampled
from jaxbody.naming import paths, replace
from jaxbody.nonlinearities import backbones
from jaxbody.sensors import BodyPose, Elongation, Position, measure
from jaxbody.simulations import simulate
from jaxbody.statics import equilibrium
from jaxbody.vibrations import modes
