"""Design optimization, Pareto fronts, sweeps, tolerances, sensitivities, and objectives
for them."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "fronts": ("Front", "pareto"),
    "sensitivity_analyses": ("sensitivities",),
    "sweeps": ("sweep",),
    "tolerance_analyses": ("robust", "tolerances"),
    "tuners": ("tune",),
    "tuning_results": ("Tuning",),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.design", _NAMES)
