"""Rows of numbers in order, such as the points of a table, stay in order when they are fitted
or tuned."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import pytest
from test_domains import AT, ENDS, TABLE, Given, force, holding

import jaxbody as jb
from jaxbody.fitting.parameters import transforms
from jaxbody.model.laws import Tabulated

A = np.array(
    [[1.0, 0, 0, 0], [1, 1, 0, 0], [0, 1, -1, 0], [0, 0, 1, 1], [0, 2, 0, 1], [1, 0, 0, 3]]
)
LAW = Tabulated([-1.0, 0.0, 1.0, 3.0], [-2.0, -0.5, 0.25, 1.0])
RISE = np.array([-1.5, -0.75, 0.5, 1.5])
E = np.array([1.0, -0.5, 0.75, -1.0, 0.25, 0.5])


def row(name, weights=((1, 0, 0, 0), (0, 1, 0, 0), (0, 0, 1, 0), (0, 0, 0, 1))):
    """Weighted sums of a row of numbers of the table."""
    return lambda model, _: jnp.asarray(weights) @ getattr(model["s"].spring, name)


def measured(numbers, function, noise=0.01):
    return {
        "run": Given(
            function, {"numbers": jnp.asarray(numbers)}, noise={"numbers": jnp.asarray(noise)}
        )
    }


@pytest.mark.long
def test_a_fitted_table_does_not_fall():
    """Measured is as much beyond a table whose last two forces are equal as the start is
    before it."""
    flat = jb.replace(holding(TABLE), {"s.spring.forces": [-10.0, 0.0, 10.0, 10.0]})
    at = np.linspace(-0.9, 1.9, 29)
    first, last = (np.asarray(force(at)(model, None)) for model in (holding(TABLE), flat))
    with pytest.warns(
        jb.JaxbodyWarning, match=r"ends with s.spring.forces\[3\] - \[2\] \(zero\).*FAR_OFF"
    ):
        result = jb.fit(
            holding(TABLE),
            {"run": Given(force(at), {"numbers": jnp.asarray(2 * last - first)})},
            free=["s.spring.forces"],
        )
    steps = np.diff(result.estimates["s.spring.forces"])
    assert (steps[:2] > 1).all() and 0 < steps[2] < 0.3


@pytest.mark.long
def test_the_points_of_a_fitted_table_stay_sorted_and_have_standard_errors(rng):
    """The data are of a table with other points, and noise; standard errors up to its level, by
    differences of the data in the points."""
    at, x = np.linspace(-0.9, 1.9, 29), np.array([-1.2, 0.1, 0.8, 2.1])

    def forces(x):
        return np.asarray(force(at)(jb.replace(holding(TABLE), {"s.spring.x": x}), None))

    numbers = jnp.asarray(forces(x) + 1e-3 * rng.normal(size=len(at)))
    result = jb.fit(
        holding(TABLE), {"run": Given(force(at), {"numbers": numbers})}, free=["s.spring.x"]
    )
    estimates, errors = (
        np.asarray(each["s.spring.x"]) for each in (result.estimates, result.standard_errors)
    )
    assert (np.abs(estimates - x) < 4 * errors).all()
    J = (
        np.stack([forces(estimates + h) - forces(estimates - h) for h in 1e-6 * np.eye(4)], 1)
        / 2e-6
    )
    ratio = errors / np.sqrt(np.diag(np.linalg.inv(J.T @ J)))
    assert 0.5e-3 < ratio[0] < 2e-3
    np.testing.assert_allclose(ratio, ratio[0], rtol=1e-4)


def test_a_table_with_equal_forces_is_refused_by_a_fit_with_the_remedy():
    flat = holding(jb.laws.Tabulated([-1, 0, 1, 2], [-10, 0, 0, 40]))
    with pytest.raises(
        jb.JaxbodyError, match=r"a step of zero.*Start with numbers that all differ.*START_ON_BOUND"
    ):
        jb.fit(
            flat, {"run": Given(force(), {"numbers": jnp.zeros(len(AT))})}, free=["s.spring.forces"]
        )


@pytest.mark.parametrize("name", ["x", "forces"])
def test_rows_in_order_are_fitted_as_if_free_where_the_data_keep_the_order(name):
    """A row y from six measured sums A y + e: least squares, with the covariance s^2 (A'A)^-1
    and s^2 = r'r/(6 - 4)."""
    result = jb.fit(
        holding(LAW), measured(A @ RISE + 0.01 * E, row(name, A)), free=[f"s.spring.{name}"]
    )
    best, (squares,), *_ = np.linalg.lstsq(A, A @ RISE + 0.01 * E, rcond=None)
    error = np.sqrt(squares / 2) * np.sqrt(np.diag(np.linalg.inv(A.T @ A)))
    np.testing.assert_allclose(result.estimates[f"s.spring.{name}"], best, rtol=1e-6)
    np.testing.assert_allclose(result.standard_errors[f"s.spring.{name}"], error, rtol=1e-6)
    low, high = result.intervals(0.95)[f"s.spring.{name}"]
    np.testing.assert_allclose(
        [best - low, high - best], np.array([error, error]) * 4.302653, rtol=1e-5
    )
    assert result.status == jb.Status.OK


def test_numbers_that_the_data_would_put_out_of_order_meet():
    """The nearest numbers in order to 0, 2, 1, 3 are 0, 1.5, 1.5, 3. Three of the four remain free,
    so that s^2 = 0.5^2 + 0.5^2, and the mean of two has the standard error s/sqrt(2)."""
    with pytest.warns(jb.JaxbodyWarning, match=r"s.spring.forces\[2\] - \[1\] \(zero\) \[AT_BOUND"):
        result = jb.fit(
            holding(LAW), measured([0.0, 2, 1, 3], row("forces")), free=["s.spring.forces"]
        )
    forces = np.asarray(result.estimates["s.spring.forces"])
    np.testing.assert_allclose(forces, [0, 1.5, 1.5, 3], atol=1e-4)
    np.testing.assert_allclose(
        result.standard_errors["s.spring.forces"], [0.5**0.5, 0.5, 0.5, 0.5**0.5], rtol=1e-3
    )
    assert (np.diff(forces) > 0).all() and result.status == jb.Status.AT_BOUND
    assert jb.replace(result.model, {"s.spring.forces": forces})["s"].spring.forces.shape == (4,)


@pytest.mark.long
def test_rows_have_priors_ties_and_traced_fits_but_no_bounds():
    """With a prior of the deviation of the data the estimate is halfway; two tied rows have one
    number each."""
    path, model = "s.spring.forces", holding(LAW)
    prior = jb.fit(
        model, measured(RISE, row("forces")), free=[path], priors={path: ([-2.0, -1, 0, 2], 0.01)}
    )
    np.testing.assert_allclose(
        prior.estimates[path], (RISE + np.array([-2.0, -1, 0, 2])) / 2, rtol=1e-6
    )
    solver = optimistix.LevenbergMarquardt(rtol=1e-9, atol=1e-9)
    runs = measured(RISE, row("forces"))
    slopes = jax.jit(
        jax.jacfwd(
            lambda y: jb.fit(
                model,
                {"run": eqx.tree_at(lambda run: run.measured["numbers"], runs["run"], y)},
                free=[path],
                method=solver,
            ).estimates[path]
        )
    )(jnp.asarray(RISE))
    np.testing.assert_allclose(slopes, np.eye(4), atol=1e-6)
    for solve in (jb.fit, jb.tune):
        given = runs if solve is jb.fit else lambda model: model["s"].spring.forces[0] ** 2
        with pytest.raises(
            jb.JaxbodyError, match=r"cannot have bounds.*do not depend on each other.*BAD_BOUNDS"
        ):
            solve(model, given, free=[path], bounds={path: (-3.0, 3.0)})
    with pytest.raises(jb.JaxbodyError, match="WRONG_KIND"):
        jb.fitting.profile_likelihood(prior, f"{path}[2] - [1]")
    both = holding(jb.SpringDamper(*ENDS, spring=LAW, damper=Tabulated(LAW.x, 2 * LAW.forces)))
    tied = jb.fit(
        both, measured(RISE, row("forces")), free=["s.damper.forces = s.spring.forces * 2"]
    )
    np.testing.assert_allclose(tied.model["s"].spring.forces, RISE, rtol=1e-6)
    np.testing.assert_allclose(tied.model["s"].damper.forces, 2 * RISE, rtol=1e-6)
    with pytest.raises(jb.JaxbodyError, match=r"rows in order, by a number.*BAD_TIE"):
        jb.fit(both, runs, free=["s.damper.forces = s.spring.forces * [2, 2, 2, 2]"])


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_rows_stay_in_order_in_random_starts_and_when_tuned():
    path, model = "s.spring.forces", holding(LAW)
    tuned = jb.tune(
        model,
        lambda model: ((model["s"].spring.forces - RISE) ** 2).sum(),
        free=path,
        starts=4,
        key=jax.random.key(1),
    )
    np.testing.assert_allclose(tuned.model["s"].spring.forces, RISE, atol=1e-4)
    assert tuned.ok and (np.diff(tuned.runs.values[path]) > 0).all()
    pulled = jb.tune(
        model,
        lambda model: ((model["s"].spring.forces - jnp.array([0.0, 2, 1, 3])) ** 2).sum(),
        free=path,
    )
    np.testing.assert_allclose(pulled.model["s"].spring.forces, [0, 1.5, 1.5, 3], atol=1e-3)
    assert (np.diff(pulled.model["s"].spring.forces) > 0).all()
    met = jb.tune(
        model, lambda model: model["s"].spring.forces[2] - model["s"].spring.forces[1], free=path
    )
    assert met.places == {f"{path}[2]": "at its bound"} and "at its bound" in str(met)
    several = jb.fitting.multistart(model, measured(RISE, row("forces")), free=[path], starts=4)
    np.testing.assert_allclose(several.estimates[path], RISE[None], rtol=1e-5)
    bent = jb.design.sensitivities(
        model, lambda model: {"last": model["s"].spring.forces[-1] ** 2}, free=path
    )
    np.testing.assert_allclose(bent.slopes, [[2.0, 2, 2, 2]], rtol=1e-9)
    np.testing.assert_allclose(bent.high, [[1.2**2, 1.15**2, 1.075**2, 1.075**2]], rtol=1e-9)


@pytest.mark.long
@pytest.mark.parametrize("start", [[-2.0, -0.5, 0.25, 1.0], [0.0, 1e-3, 5.0, 5.001]])
def test_the_numbers_of_a_row_follow_u_in_order_with_their_derivatives(start):
    form = transforms.Ordered(jnp.asarray(start), jnp.asarray(2.0))
    u = np.array([0.3, -0.5, 0.7, 0.2])
    expected = start[0] + 2 * u[0] + np.r_[0, np.cumsum(np.diff(start) * np.exp(u[1:]))]
    np.testing.assert_allclose(eqx.filter_jit(form.value)(u), expected, rtol=1e-14)
    forward, reverse = (
        jax.jit(slope(lambda u: form.value(u)))(u) for slope in (jax.jacfwd, jax.jacrev)
    )
    differences = np.stack(
        [(form.value(u + d) - form.value(u - d)) / 2e-6 for d in 1e-6 * np.eye(4)], axis=1
    )
    np.testing.assert_allclose(forward, reverse, rtol=1e-14)
    np.testing.assert_allclose(forward, differences, atol=1e-8)
    for seed in range(20):
        assert (np.diff(form.value(5 * np.random.default_rng(seed).normal(size=4))) > 0).all()
