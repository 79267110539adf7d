"""What `jaxbody.model.inputs` offers, written by `python tests/stubs.py`."""

from jaxbody.model.inputs.base_motions import base_motion as base_motion
from jaxbody.model.inputs.loads import EngineTorque as EngineTorque
from jaxbody.model.inputs.loads import Force as Force
from jaxbody.model.inputs.loads import Load as Load
from jaxbody.model.inputs.loads import Unbalance as Unbalance
from jaxbody.model.inputs.motions import AtRest as AtRest
from jaxbody.model.inputs.motions import Harmonic as Harmonic
from jaxbody.model.inputs.motions import Motion as Motion
from jaxbody.model.inputs.motions import Sampled as Sampled
from jaxbody.model.inputs.port_inputs import BaseMotion as BaseMotion
from jaxbody.model.inputs.port_inputs import Command as Command
from jaxbody.model.inputs.port_inputs import PointForce as PointForce
from jaxbody.model.inputs.pulses import HalfSine as HalfSine
from jaxbody.model.inputs.pulses import Sawtooth as Sawtooth
from jaxbody.model.inputs.pulses import Trapezoid as Trapezoid
from jaxbody.model.inputs.pulses import Triangle as Triangle
from jaxbody.model.inputs.roads import Road as Road
from jaxbody.model.inputs.splines import Spline as Spline
