"""Every preset computes outside and inside a jit, in a vmap and in a grad, with the same numbers,
and ends no process."""

import pytest
from size_jobs import OUTSIDE_AND_INSIDE, PRESETS, WAYS, failures, jobs

pytestmark = pytest.mark.long

# slopes of these take minutes and gigabytes to compile
ALONE = {"full_car_on_double_wishbones", "hydraulic_engine_mounts", "rubber_isolators"}


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset(name):
    ways = WAYS if name == "coupled_gliders" else ("",) if name in ALONE else OUTSIDE_AND_INSIDE
    assert (
        failures([*jobs(name, "equilibrium linearize modes simulate", ways), f"{name}: fit"]) == []
    )
