"""Ready models; public as jaxbody.presets."""

from jaxbody.presets.linkages import four_bar
from jaxbody.presets.presets import (
    coupled_gliders,
    double_pendulum,
    elastic_pendulum,
    engine_on_mounts,
    full_car,
    full_car_on_double_wishbones,
    half_car,
    hydraulic_engine_mounts,
    isolated_table,
    quarter_car,
    stewart_table,
)
from jaxbody.presets.rubber_presets import rubber_isolators

__all__ = [
    "coupled_gliders",
    "double_pendulum",
    "elastic_pendulum",
    "engine_on_mounts",
    "four_bar",
    "full_car",
    "full_car_on_double_wishbones",
    "half_car",
    "hydraulic_engine_mounts",
    "isolated_table",
    "quarter_car",
    "rubber_isolators",
    "stewart_table",
]
