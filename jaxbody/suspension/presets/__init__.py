"""Ready models; public as `jb.presets`."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "linkages": ("four_bar",),
    "presets": (
        "coupled_gliders",
        "double_pendulum",
        "elastic_pendulum",
        "engine_on_mounts",
        "full_car",
        "full_car_on_double_wishbones",
        "half_car",
        "hydraulic_engine_mounts",
        "isolated_table",
        "quarter_car",
        "rubber_isolators",
        "stewart_table",
    ),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.suspension.presets", _NAMES)
