"""Joints of every kind: the base class, single joints (such as hinges) and combined ones."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "combined_joints": (
        "Composite",
        "Cylindrical",
        "HeavePitch",
        "HeavePitchRoll",
        "Planar",
        "Translation",
        "Universal",
    ),
    "joints": ("Ball", "Fixed", "Free", "Guide", "Hinge", "Joint"),
    "kinematics": ("retract",),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.model.joints", _NAMES)
