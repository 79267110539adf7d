"""Inputs of a model as functions of time: motions of supports, signals, roads, loads."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "base_motions": ("base_motion",),
    "loads": ("EngineTorque", "Force", "Load", "Unbalance"),
    "motions": ("AtRest", "Harmonic", "Motion", "Sampled"),
    "port_inputs": ("BaseMotion", "Command", "PointForce"),
    "pulses": ("HalfSine", "Sawtooth", "Trapezoid", "Triangle"),
    "roads": ("Road",),
    "splines": ("Spline",),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.model.inputs", _NAMES)
