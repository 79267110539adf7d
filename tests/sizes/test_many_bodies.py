"""1 to 60 bodies, and 1 to 500 springs, compute outside and inside a jit, in a vmap and in a grad, with the same numbers, those of closed
forms, and end no process."""

import pytest
from size_jobs import LONG_TO_COMPILE, SIZES, all_ways, failures

pytestmark = pytest.mark.long

IN_ALL_WAYS = {"chain of 1", "1 on bushings"}
LARGE = {"chain of 40", "chain of 60", "20 on bushings", "60 on bushings", "5 on 200 springs"}


@pytest.mark.parametrize("name", SIZES)
def test_a_size(name):
    but = () if name in IN_ALL_WAYS else LONG_TO_COMPILE
    motions = [f"{name}: simulate"] if name in LARGE else [*all_ways(name, "simulate", but), f"{name}: fit"]
    assert failures([*all_ways(name, "equilibrium linearize modes", but), *motions]) == []
