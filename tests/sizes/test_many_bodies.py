"""1 to 60 bodies, and 1 to 500 springs, compute outside and inside a jit, in a vmap and in a grad,
with the same numbers, those of closed forms, and end no process."""

import pytest
from size_jobs import OUTSIDE_AND_INSIDE, SIZES, WAYS, failures, jobs

pytestmark = pytest.mark.long

LARGE = {"chain of 40", "chain of 60", "20 on bushings", "60 on bushings", "5 on 200 springs"}


@pytest.mark.parametrize("name", SIZES)
def test_a_size(name):
    ways = WAYS if name == "chain of 1" else OUTSIDE_AND_INSIDE
    motions = (
        [f"{name}: simulate"] if name in LARGE else [*jobs(name, "simulate", ways), f"{name}: fit"]
    )
    assert failures([*jobs(name, "equilibrium linearize modes", ways), *motions]) == []
