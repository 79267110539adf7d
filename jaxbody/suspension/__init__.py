"""Closed loops: assembled configurations, driven positions, curves; ready cars and models."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "alignment_curves": ("suspension_curves",),
    "assemblies": ("assemble",),
    "compliances": ("Compliance", "compliant"),
    "ready_cars": ("Car", "car_on_double_wishbones"),
    "suspensions": (
        "Axle",
        "Corner",
        "Suspension",
        "double_wishbone",
        "five_link",
        "macpherson",
        "solid_axle",
    ),
    "wheels": ("Wheel",),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.suspension", _NAMES)
