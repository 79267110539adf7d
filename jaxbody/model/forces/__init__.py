"""Forces without a potential: elements that are no derivative of an energy, with readings and
states of their own; public as jaxbody.forces."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "aerodynamic_forces": ("SectionAirloads",),
    "controllers": ("Controller", "ControlLaw"),
    "drives": ("Actuator", "ControlledDamper"),
    "force_elements": ("ForceElement",),
    "magnetic_bearings": ("MagneticBearing",),
    "rotor_forces": ("WhirlForce",),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.model.forces", _NAMES)
