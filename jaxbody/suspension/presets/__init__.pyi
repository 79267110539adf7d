"""What `jaxbody.suspension.presets` offers, written by `python tests/stubs.py`."""

from jaxbody.suspension.presets.linkages import four_bar as four_bar
from jaxbody.suspension.presets.presets import coupled_gliders as coupled_gliders
from jaxbody.suspension.presets.presets import double_pendulum as double_pendulum
from jaxbody.suspension.presets.presets import elastic_pendulum as elastic_pendulum
from jaxbody.suspension.presets.presets import engine_on_mounts as engine_on_mounts
from jaxbody.suspension.presets.presets import full_car as full_car
from jaxbody.suspension.presets.presets import full_car_on_double_wishbones as full_car_on_double_wishbones
from jaxbody.suspension.presets.presets import half_car as half_car
from jaxbody.suspension.presets.presets import hydraulic_engine_mounts as hydraulic_engine_mounts
from jaxbody.suspension.presets.presets import isolated_table as isolated_table
from jaxbody.suspension.presets.presets import quarter_car as quarter_car
from jaxbody.suspension.presets.presets import rubber_isolators as rubber_isolators
from jaxbody.suspension.presets.presets import stewart_table as stewart_table
