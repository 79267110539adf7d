"""No ordinary model ends the Python process: those that did with jaxlib 0.12, and the smallest and
largest, on every Python."""

import pytest
from size_jobs import failures, jobs

pytestmark = pytest.mark.everywhere


def test_what_ended_the_process():
    """21 masses, six free bodies, an implicit solver; outside a jit."""
    names = [
        "chain of 21: linearize",
        "chain of 21: equilibrium",
        "chain of 21: modes",
        "6 on bushings: linearize",
    ]
    names += [
        "6 on bushings: equilibrium",
        "chain of 1 by Kvaerno5: simulate",
        "chain of 1 by Kvaerno5: simulate in a vmap",
    ]
    assert failures(names) == []


@pytest.mark.long
def test_implicit_solvers_and_simulations_of_many_bodies():
    names = [f"chain of 1 by Kvaerno5: simulate{way}" for way in ("", " in a jit", " in a grad")]
    names += [
        "6 on bushings: simulate",
        "chain of 21: modes",
        "chain of 21: modes in a grad",
        "chain of 21: modes in a jit",
    ]
    assert failures(names) == []


@pytest.mark.long
def test_the_largest():
    names = [
        "chain of 60: modes",
        "60 on bushings: linearize",
        "1 on 500 springs: modes",
        "5 on 200 springs: equilibrium",
    ]
    assert failures([*names, *jobs("chain of 1", "equilibrium linearize modes")]) == []


@pytest.mark.long
def test_a_car_with_closed_loops():
    assert (
        failures([f"full_car_on_double_wishbones: {f}" for f in ("linearize", "equilibrium")]) == []
    )
