"""Properties of the mechanics over a few random models; `benchmarks/properties.py` has thousands."""

import warnings

import mechanics_properties as properties
import numpy as np
import pytest
from random_mechanics import Structure

import jaxbody as jb

SEEDS = range(6)
NEAR = (13, 14)  # four free bodies, bushings, inerters and hardening springs: over six decades, and a special layout
RESTS = (8, 10)  # three bodies on joints and bushings
REORDERED = [name for name in properties.LIMITS if name.startswith("T12")]
HERE = [name for name in properties.LIMITS if name not in REORDERED]


def joined(results):
    return {name: np.concatenate([result[name] for result in results if name in result]) for result in results for name in result}


@pytest.fixture(scope="module")
def programs():
    return properties.Programs()


@pytest.fixture(scope="module")
def found(programs):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)  # random numbers are implausible ones
        near = [properties.at_random_states(Structure(number), SEEDS, programs) for number in NEAR]
        return joined(near + [properties.at_rest(Structure(number), SEEDS, programs)[0] for number in RESTS])


@pytest.mark.parametrize("name", HERE)
def test_property(found, name):
    assert np.sum(found[name] >= 0) >= len(SEEDS) // 2  # where it applies
    assert np.max(found[name]) <= properties.LIMITS[name]


@pytest.mark.long
def test_properties_in_another_order(programs):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        found = properties.reordered(Structure(8), SEEDS, programs)
    for name in REORDERED:
        assert np.max(found[name]) >= 0 and np.max(found[name]) <= properties.LIMITS[name]


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_loads_in_one_in_six_and_in_sixty_stages(seed):
    """A dead force and a moment that turns with its body carry three bodies to the same rest."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        structure = Structure(8)
        model = structure.model(seed)
    size, rng = structure.size(seed), structure.rng(seed, "load")
    point, force = size * rng.normal(size=3), 100 * size * rng.normal(size=3)
    rest, ends = jb.equilibrium(model), []
    assert rest.ok
    for stages in (1, 6, 60):
        start = rest.state
        for i in range(stages):
            loads = {"push": jb.Force((model.layout.bodies[-1], point), force=(i + 1) / stages * force)}
            eq = jb.equilibrium(model, start=start, loads=loads)
            assert eq.ok
            start = eq.state
        ends.append(start.q)
    scale = np.abs(np.asarray(ends[0]) - np.asarray(rest.state.q)).max()
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], rtol=0, atol=1e-10 * max(scale, 1.0))
