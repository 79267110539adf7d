"""Control: laws between sensors and drives, optimal gains and estimators, margins; public as
jaxbody.control."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "estimators": ("kalman",),
    "laws": (
        "ControlLaw",
        "LinearFeedback",
        "PID",
        "Proportional",
        "groundhook",
        "on_off_skyhook",
        "skyhook",
        "state_feedback",
    ),
    "margins": ("loop_margins",),
    "regulators": ("lqr",),
    "riccati_equations": ("care", "dare"),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.vibration.control", _NAMES)
