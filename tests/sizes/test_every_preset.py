"""Every preset computes outside and inside a jit, in a vmap and in a grad, with the same numbers, and ends no process."""

import pytest
from size_jobs import LONG_TO_COMPILE, PRESETS, all_ways, failures

pytestmark = pytest.mark.long

IN_ALL_WAYS = {"coupled_gliders", "four_bar"}


@pytest.mark.parametrize("name", PRESETS)
def test_a_preset(name):
    but = () if name in IN_ALL_WAYS else LONG_TO_COMPILE
    assert failures([*all_ways(name, "equilibrium linearize modes simulate", but), f"{name}: fit"]) == []
