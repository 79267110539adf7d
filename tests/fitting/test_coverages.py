"""Coverage of intervals: of a linear problem the stated level, less where intervals are too narrow;
processes and stores change nothing."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.stats import norm

import jaxbody as jb

pytestmark = pytest.mark.long
MASS = jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])
MODEL = jb.Model(
    bodies={"mass": MASS},
    elements={"spring": jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=36.0)},
    joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
)


@pytest.fixture(scope="module")
def fitted():
    """A natural frequency measured eight times, which is as near to a linear problem as a
    model is."""
    frequencies = 1.0 + 0.01 * jax.random.normal(jax.random.key(1), (8,))
    tests = {
        f"test {i}": jb.MeasuredModes(frequency=[f], noise={"frequency": 0.01})
        for i, f in enumerate(frequencies)
    }
    return jb.fit(MODEL, tests, free=["spring.stiffness"])


def test_intervals_of_a_linear_problem_contain_what_they_state(fitted):
    """The estimate of a mean from 8 numbers of known noise: 95 % and 50 %, deviations as stated, no
    bias, to four standard errors."""
    for level in (0.95, 0.5):
        result = jb.fitting.interval_coverage(fitted, replicates=1000, level=level)
        assert result.ok.all() and result.parameters == ("spring.stiffness",)
        assert abs(result.contained[0] - level) < 4 * result.standard_error[0]
    assert abs(result.bias[0]) < 4 / np.sqrt(1000) and abs(result.ratio[0] - 1) < 4 / np.sqrt(2000)
    text = str(result)
    assert (
        "Coverage of 50 % intervals" in text
        and "spring.stiffness" in text
        and "1000 replicates: 1000 OK" in text
    )


def test_intervals_that_are_too_narrow_contain_less(fitted):
    """Of intervals scaled to 1/2 of their width, those of a normal distribution contain
    2 Phi(1.96/2) - 1."""
    result = jb.fitting.interval_coverage(fitted, replicates=1000)
    narrow = dataclasses.replace(
        result, lower=(result.lower + result.u) / 2, upper=(result.upper + result.u) / 2
    )
    expected = 2 * norm.cdf(norm.ppf(0.975) / 2) - 1
    assert abs(narrow.contained[0] - expected) < 4 * np.sqrt(expected * (1 - expected) / 1000)


def record(noise):
    sensors, times = {"x": jb.Position("mass", axis=[1, 0, 0])}, jnp.linspace(0, 1, 12)
    x = jnp.cos(2 * jnp.pi * times) + 0.05 * jax.random.normal(jax.random.key(3), times.shape)
    return jb.Experiment(times, sensors=sensors, measured={"x": x.at[4].set(jnp.nan)}, noise=noise)


@pytest.mark.parametrize("noise", [None, 0.05], ids=["estimated", "stated"])
def test_replicates_are_as_whole_fits_of_records_with_noise(noise):
    """The same numbers as `fit` of records to which the noise of the first replicates is added:
    estimates to the tolerance of the fit."""
    fitted = jb.fit(MODEL, {"run": record(noise)}, free=["spring.stiffness"])
    result = jb.fitting.interval_coverage(fitted, replicates=4)
    run, rows = fitted.experiments["run"], np.arange(12) != 4
    level = (
        0.05
        if noise
        else float(
            np.sqrt(np.sum((fitted.predicted["run"]["x"] - run.measured["x"])[rows] ** 2) / 10)
        )
    )
    for i, key in enumerate(jax.random.split(jax.random.key(0), 4)):
        x = fitted.predicted["run"]["x"] + level * jax.random.normal(key, (12,))
        again = jb.fit(
            fitted.model,
            {"run": dataclasses.replace(run, measured={"x": jnp.where(rows, x, jnp.nan)})},
            free=["spring.stiffness"],
        )
        low, high = (np.log(end / 36.0) for end in again.intervals()["spring.stiffness"])
        np.testing.assert_allclose(
            np.log(again.estimates["spring.stiffness"] / 36.0), result.u[i, 0], atol=1e-6
        )
        np.testing.assert_allclose([low, high], [result.lower[i, 0], result.upper[i, 0]], atol=1e-5)


def test_two_processes_and_a_store_have_the_same_replicates(fitted, tmp_path):
    pytest.importorskip("loky", reason="needs jaxbody[cluster]")
    pytest.importorskip("zarr", reason="needs jaxbody[cluster]")
    whole, out = jb.fitting.interval_coverage(fitted, replicates=40), tmp_path / "c.zarr"
    with pytest.warns(jb.JaxbodyWarning, match="INTERRUPTED"):
        part = jb.fitting.interval_coverage(fitted, replicates=40, out=out, chunks=[1])
    assert (
        part.ok.sum() == 16
        and (part.u[16:32] == whole.u[16:32]).all()
        and np.isnan(part.u[:16]).all()
    )
    by_two = jb.fitting.interval_coverage(fitted, replicates=40, out=out, workers=2)
    for name in ("u", "lower", "upper", "status"):
        np.testing.assert_array_equal(getattr(by_two, name), getattr(whole, name))
    with pytest.raises(
        jb.JaxbodyError, match=r"is of another call: .*level 0\.95 there, 0\.9 here"
    ):
        jb.fitting.interval_coverage(fitted, replicates=40, out=out, level=0.9)


def test_fits_without_a_normal_optimum_are_refused(fitted):
    robust = dataclasses.replace(fitted, task=dataclasses.replace(fitted.task, loss="cauchy"))
    bound = dataclasses.replace(fitted, status=jnp.asarray(jb.Status.AT_BOUND.value))
    for result, words in ((robust, "has the loss 'cauchy'"), (bound, "has the status AT_BOUND")):
        with pytest.raises(jb.JaxbodyError, match=words):
            jb.fitting.interval_coverage(result)
