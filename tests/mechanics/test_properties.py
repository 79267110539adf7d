"""Properties of the mechanics over a few random models; `benchmarks/properties.py`
has thousands."""

import warnings

import jax
import jax.numpy as jnp
import mechanics_properties as properties
import numpy as np
import pytest
import rigs
from random_mechanics import PLAIN, Structure

import jaxbody as jb

SEEDS = range(6)
# four free bodies, bushings, inerters and hardening springs: over six decades, and a special layout
NEAR = (13, 14)
RESTS = (8, 10)  # three bodies on joints and bushings
REORDERED = [name for name in properties.LIMITS if name.startswith("T12")]
HERE = [name for name in properties.LIMITS if name not in REORDERED]


def joined(results):
    return {
        name: np.concatenate([result[name] for result in results if name in result])
        for result in results
        for name in result
    }


@pytest.fixture(scope="module")
def programs():
    return properties.Programs()


@pytest.fixture(scope="module")
def found(programs):
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)  # random numbers are implausible ones
        near = [properties.at_random_states(Structure(number), SEEDS, programs) for number in NEAR]
        return joined(
            near + [properties.at_rest(Structure(number), SEEDS, programs)[0] for number in RESTS]
        )


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
            loads = {
                "push": jb.Force((model.layout.bodies[-1], point), force=(i + 1) / stages * force)
            }
            eq = jb.equilibrium(model, start=start, loads=loads)
            assert eq.ok
            start = eq.state
        ends.append(start.q)
    scale = np.abs(np.asarray(ends[0]) - np.asarray(rest.state.q)).max()
    for end in ends[1:]:
        np.testing.assert_allclose(end, ends[0], rtol=0, atol=1e-10 * max(scale, 1.0))


@pytest.mark.long
def test_motions_in_other_units_moved_and_turned():
    """The same steps, within one, and the same motion: in other units to 1e-9, moved and turned to
    100 times the tolerance."""
    structure, seed, rtol = Structure(8), 0, 1e-9
    moved, scaled = properties.views(structure, seed)
    found = {}
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        fastest = structure.model(seed)
        period = 1 / float(jb.modes(jb.linearize(fastest, jb.equilibrium(fastest))).frequency[-1])
        for name, view in (("plain", PLAIN), ("moved", moved), ("scaled", scaled)):
            model = structure.model(seed, view)
            state = structure.state(seed, model, view, angle=0.1)
            found[name] = jb.simulate(
                model, np.linspace(0, 10 * period * view.time, 11), initial=state, rtol=rtol
            )
            assert found[name].ok
    size = structure.size(seed)
    steps = [int(trajectory.statistics["num_accepted_steps"]) for trajectory in found.values()]
    assert max(steps) - min(steps) <= 1
    for name, view, limit in (("moved", moved, 100 * rtol), ("scaled", scaled, 1e-9)):
        for body in structure.bodies:
            p, R = found["plain"].poses[body].p, found["plain"].poses[body].R
            there = np.array([view.point(np.asarray(x)) for x in p])
            turn = rigs.turned(view.turn)
            np.testing.assert_allclose(
                found[name].poses[body].p, there, rtol=0, atol=limit * size * view.length
            )
            np.testing.assert_allclose(
                found[name].poses[body].R, turn @ np.asarray(R), rtol=0, atol=limit
            )


@jax.jit
def slopes_at_rest(model):
    """The derivatives of the sum of the eigenvalues, which repeated ones have too, and the statuses
    of rest and modes."""

    def total(model):
        eq = jb.equilibrium(model)
        found = jb.modes(jb.linearize(model, eq))
        return jnp.sum(found.eigenvalues), (eq.status, found.status)

    return jax.grad(total, has_aux=True)(model)


@pytest.mark.long
@pytest.mark.parametrize("number", [8, 9, 10, 11, 16])  # the last has repeated frequencies
def test_gradients_of_rests_are_finite(number):
    """With respect to every number of a model."""
    structure = Structure(number)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        for seed in SEEDS:
            gradient, statuses = slopes_at_rest(structure.model(seed))
            if not any(map(int, statuses)):
                assert all(np.isfinite(x).all() for x in jax.tree.leaves(gradient))
