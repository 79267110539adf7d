"""Sweeps against loops and closed forms: labels, chunks, samples, and messages for bad input."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.workers import batches
from jaxbody.design import sweeps

MS, MU, KT = 375.0, 75.0, 193000.0
K, M = np.geomspace(2e4, 6e4, 7), np.array([300.0, 375.0, 450.0])


@pytest.fixture(scope="module")
def car():
    return jb.presets.quarter_car(damping=1500.0)


def quantities(model):
    lin = jb.linearize(model, model.reference)
    return {
        "frequency": jb.modes(lin).frequency,
        "sag": model["body"].mass * 9.81 / model["suspension"].stiffness,
    }


def frequencies(ks, ms):
    a, b, d = ms * MU, ms * (ks + KT) + MU * ks, ks * KT
    root = np.sqrt(b**2 - 4 * a * d)
    return np.sqrt(np.stack([(b - root) / (2 * a), (b + root) / (2 * a)], -1)) / (2 * np.pi)


@pytest.fixture(scope="module")
def grid(car):
    return jb.sweep(car, quantities, {"suspension.stiffness": K, "body.mass": M})


@pytest.mark.long
def test_a_grid_has_its_labels_and_the_values_of_closed_forms(grid):
    assert grid["frequency"].dims == ("suspension.stiffness", "body.mass", "frequency_0") and grid[
        "sag"
    ].shape == (7, 3)
    np.testing.assert_allclose(grid["frequency"], frequencies(K[:, None], M), rtol=1e-10)
    np.testing.assert_allclose(grid["sag"].sel({"body.mass": 450.0}), 450 * 9.81 / K, rtol=1e-14)


@pytest.mark.long
def test_chunks_change_nothing_and_values_do_not_recompile(car, grid, capsys):
    """Four chunks of six, the last one not full; progress is printed; new values of the model
    are arguments."""
    over = {"suspension.stiffness": K, "body.mass": M}
    parts = jb.sweep(car, quantities, over, chunk=6, progress=True)
    np.testing.assert_allclose(parts["frequency"], grid["frequency"], rtol=1e-13)
    assert capsys.readouterr().err.split("\r")[1:] == [
        "sweep 6 of 21",
        "sweep 12 of 21",
        "sweep 18 of 21",
        "sweep 21 of 21\n",
    ]
    with jb.compile_times() as times:
        softer = jb.sweep(jb.replace(car, {"tyre.stiffness": 1e5}), quantities, over, chunk=6)
    assert (
        not any(word in str(times) for word in ("one", "apart", "quantities"))
        and (softer["frequency"] < grid["frequency"]).all()
    )


@pytest.mark.long
def test_chunks_shrink_to_the_memory_there_is(car, monkeypatch):
    """A quantity of a megabyte on the way: no more than the memory given."""
    monkeypatch.setattr(sweeps, "MEMORY", 2**24)

    def large(model):
        return jnp.linalg.norm(jnp.sort(jnp.sin(jnp.arange(2.0**17) * model["body"].mass)))

    masses = {"body.mass": np.linspace(1.0, 2.0, 64)}
    result = jb.sweep(car, large, masses)
    (program, width), *_ = batches.programs[large].values()
    assert width < 64 and program.memory_analysis().temp_size_in_bytes <= 2**24
    expected = [np.linalg.norm(np.sin(np.arange(2.0**17) * m)) for m in (1.0, 2.0)]
    np.testing.assert_allclose(result["objective"][[0, -1]], expected, rtol=1e-12)


def test_samples_of_a_range_that_begins_at_zero_may_be_valid(car):
    """A mass of zero is none, but no sample has it; samples of negative masses are refused
    by name."""
    ratio = jb.sweep(
        car, lambda model: model["body"].mass / 450.0, {"body.mass": (0.0, 450.0)}, samples=8
    )["objective"]
    assert sorted(np.floor(8 * ratio.values).astype(int)) == list(range(8))
    with pytest.raises(jb.JaxbodyError, match=r"body.*mass"):
        jb.sweep(car, quantities, {"body.mass": (-1.0, 450.0)}, samples=512)


@pytest.mark.parametrize("sampler", ["sobol", "latin"])
def test_samples_are_spread_between_their_ranges(car, sampler):
    over = {"suspension.stiffness": (2e4, 6e4), "body.mass": (300.0, 450.0)}
    result = jb.sweep(car, quantities, over, samples=32, sampler=sampler, key=jax.random.key(3))
    ks, ms = result["suspension.stiffness"].values, result["body.mass"].values
    assert result["frequency"].dims == ("sample", "frequency_0")
    np.testing.assert_allclose(result["frequency"], frequencies(ks, ms), rtol=1e-10)
    for values, (low, high) in ((ks, over["suspension.stiffness"]), (ms, over["body.mass"])):
        # one in each of 32 slices
        assert sorted(np.floor(32 * (values - low) / (high - low)).astype(int)) == list(range(32))
    again = jb.sweep(car, quantities, over, samples=32, sampler=sampler, key=jax.random.key(3))
    assert (again["body.mass"] == result["body.mass"]).all()


BAD = {
    "EMPTY_SWEEP": (dict(over={}), "has no values"),
    "UNKNOWN_PATH": (dict(over={"body.mas": [1.0]}), "Did you mean body.mass"),
    "BAD_MASS": (dict(over={"body.mass": [1.0, -1.0, 2.0]}), "is -1 kg"),
    "NON_FINITE": (dict(over={"body.mass": [1.0, np.nan, 2.0]}), r"sweep\['body.mass'\]: is nan"),
    "BAD_RANGE": (dict(over={"body.mass": (2.0, 1.0)}, samples=4), r"allowed: \(low, high\)"),
    "BAD_SAMPLER": (dict(over={"body.mass": (1.0, 2.0)}, samples=4, sampler="dice"), "sobol latin"),
    "BAD_CHUNK": (dict(over={"body.mass": [1.0]}, chunk=0), "allowed: a whole number >= 1"),
}


@pytest.mark.parametrize("code", BAD)
def test_bad_input_is_reported(car, code):
    options, words = BAD[code]
    with pytest.raises(jb.JaxbodyError, match=words) as caught:
        jb.sweep(car, quantities, **options)
    assert caught.value.code == code
