"""Fits against an independent simulation and least-squares program in SciPy: optimum, standard errors, and what is said where they fail."""

import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
import pytest
import scipy.optimize
from rigs import PARAMETERS, SHAKING, rig
from scipy.integrate import solve_ivp

import jaxbody as jb
from jaxbody.parametrizations import parametrize
from jaxbody.uncertainties import assess

# A cart on a guide of a shaken base, on three springs. With two of them, their damper and the mass unknown, the third sets the scale.
ENDS = {"s": [0.6, 0.5, 0.0], "t": [-0.3, 0.7, 0.0], "hold": [-0.6, -0.3, 0.0]}
LENGTHS = {"s": 0.9, "t": 0.6, "hold": 0.6}
FREE = ("s.stiffness", "t.stiffness", "s.damping", "cart.mass")
TRUTH = np.array([80.0, 50.0, 1.0, 2.0])
START = TRUTH * np.array([1.3, 0.75, 1.5, 0.8])
HOLD, GRAVITY, AMPLITUDE, FREQUENCY, NOISE = 100.0, 0.7, 0.05, 0.8, 1e-4
TIMES = np.linspace(0, 2, 41)
FINE = 1e-12  # tolerance of integration where two programs are compared digit by digit
RANDOM = np.random.default_rng(20)


def cart(values=START, hold=HOLD, gravity=GRAVITY, lengths=LENGTHS):
    k_s, k_t, c_s, m = values
    stiffness, damping = {"s": k_s, "t": k_t, "hold": hold}, {"s": c_s}
    return jb.Model(
        bodies={"cart": jb.Body(mass=m, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"cart": jb.Guide("base", axis=[1, 0, 0])},
        elements={
            name: jb.Spring(("cart", [0, 0, 0]), ("base", end), stiffness=stiffness[name], free_length=lengths[name], damping=damping.get(name, 0.0))
            for name, end in ENDS.items()
        },
        gravity=[gravity, 0, -9.81],
    )  # fmt: skip


def independent(values, *, times=TIMES, q=0.25, v=0.0, hold=HOLD, gravity=GRAVITY, frequency=FREQUENCY):
    """World position of the cart and elongation of s: Newton's law along the guide, written out."""
    k_s, k_t, c_s, m = values
    omega, k, c = 2 * np.pi * frequency, np.array([k_s, k_t, hold]), np.array([c_s, 0.0, 0.0])
    ends, free = np.array(list(ENDS.values())), np.array(list(LENGTHS.values()))

    def lengths(q):
        d = ends - np.multiply.outer(np.asarray(q), [1.0, 0, 0])[..., None, :]
        return np.linalg.norm(d, axis=-1), d[..., 0]

    def rate(t, y):
        L, along = lengths(y[0])
        tension = k * (L - free) - c * y[1] * along / L
        return [y[1], gravity + AMPLITUDE * omega**2 * np.cos(omega * t) + tension @ (along / L) / m]

    solution = solve_ivp(rate, (times[0], times[-1]), [q, v], method="DOP853", rtol=1e-12, atol=1e-13, t_eval=times)
    return AMPLITUDE * np.cos(omega * times) + solution.y[0], lengths(solution.y[0])[0][:, 0] - free[0]


def noisy(x, seed=0, level=NOISE):
    return x + level * np.random.default_rng(seed).normal(size=np.shape(x))


def tracked(x, *, times=TIMES, noise=NOISE, q=0.25, v=0.0, frequency=FREQUENCY, amplitude=AMPLITUDE):
    """The experiment of a record of the cart's position along the guide."""
    return {
        "run": jb.Experiment(
            times,
            motion={"base": jb.Harmonic(frequency=frequency, translation=[amplitude, 0, 0])},
            initial=jb.State(jnp.array([q]), jnp.array([v])),
            sensors={"x": jb.Position("cart", axis=[1, 0, 0])},
            measured={"x": x},
            noise=noise,
        )
    }


def values_of(found, paths=FREE):
    return np.array([found.estimates[path] for path in paths])


def minimum(residual, start):
    """Least squares by SciPy, with derivatives by differences, in logarithms."""
    options = dict(x_scale="jac", jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return np.exp(scipy.optimize.least_squares(lambda u: residual(np.exp(u)), np.log(start), **options).x)


@pytest.fixture(scope="module")
def clean():
    return independent(TRUTH)[0]


@pytest.fixture(scope="module")
def record(clean):
    return noisy(clean)


@pytest.fixture(scope="module")
def optimum(record):
    return minimum(lambda p: (independent(p)[0] - record) / NOISE, TRUTH)


METHODS = {
    "lbfgs": optax.lbfgs(),
    "adam": optax.adam(0.1),
    "least_squares": "least_squares",
    "levenberg_marquardt": optimistix.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
}


@pytest.fixture(scope="module")
def found(record):
    return jb.fit(cart(), tracked(record), free=FREE, rtol=FINE)


def test_the_fit_says_what_it_found(found, record, optimum):
    r = (independent(optimum)[0] - record) / NOISE
    print(values_of(found) / optimum - 1, found.cost / (0.5 * r @ r) - 1)
    np.testing.assert_allclose(values_of(found), optimum, rtol=1e-8)
    np.testing.assert_allclose(found.cost, 0.5 * r @ r, rtol=1e-7)
    np.testing.assert_allclose(found.predicted["run"]["x"], r * NOISE + record, rtol=0, atol=1e-9)
    np.testing.assert_allclose(found.noise["run"]["x"], NOISE * np.sqrt(np.mean(r**2)), rtol=1e-7)
    np.testing.assert_allclose(found.correlation, r[1:] @ r[:-1] / (r @ r), rtol=1e-6)
    assert found.cost in found.history and found.cost <= min(found.history) * (1 + 1e-8) and len(found.history) == found.evaluations
    assert values_of(found).tolist() == [float(jb.paths(found.model)[path]) for path in FREE]
    assert "79.92" in str(found) and "41 samples" in str(found) and str(found).endswith("ok") and "not determined" not in str(found)


@pytest.mark.parametrize("method", METHODS)
def test_every_method_reaches_the_optimum_that_scipy_finds_by_itself(method, record, optimum):
    found = jb.fit(cart(), tracked(record), free=FREE, method=METHODS[method])
    assert found.ok and found.paths == FREE
    np.testing.assert_allclose(values_of(found), optimum, rtol=1e-6)
    print(method, values_of(found) / optimum - 1, found.evaluations)


@pytest.mark.parametrize("method", METHODS)
def test_data_without_noise_give_the_truth_back(method, clean):
    found = jb.fit(cart(), tracked(clean), free=FREE, method=METHODS[method], rtol=FINE)
    print(method, values_of(found) / TRUTH - 1, found.evaluations)
    np.testing.assert_allclose(values_of(found), TRUTH, rtol=1e-8)


def test_standard_errors_are_those_of_a_jacobian_by_differences(found, record):
    p = values_of(found)

    def x(u):
        return independent(np.exp(u))[0]

    h = 1e-3
    steps = [h * row for row in np.eye(4)]
    J = np.stack([(8 * (x(np.log(p) + d) - x(np.log(p) - d)) - (x(np.log(p) + 2 * d) - x(np.log(p) - 2 * d))) / (12 * h) for d in steps], 1)
    r = x(np.log(p)) - record
    covariance = r @ r / (len(r) - 4) * np.linalg.inv(J.T @ J)
    expected = p * np.sqrt(np.diag(covariance))
    print(np.array([found.standard_errors[path] for path in FREE]) / expected - 1)
    np.testing.assert_allclose([found.standard_errors[path] for path in FREE], expected, rtol=1e-5)
    np.testing.assert_allclose(found.covariance, covariance, rtol=1e-5 * np.linalg.cond(covariance) ** 0.5)
    np.testing.assert_allclose(found.singular_values * NOISE, np.linalg.svd(J)[1], rtol=1e-6)


LEVENBERG_MARQUARDT = METHODS["levenberg_marquardt"]
GAUSS_NEWTON = optimistix.GaussNewton(rtol=1e-5, atol=1e-5)


@pytest.fixture(scope="module")
def many():
    """Fits of a batch of records, by one program: estimates and status."""

    @jax.jit
    @jax.vmap
    def fits(record):
        found = jb.fit(cart(TRUTH), tracked(record), free=FREE, method=GAUSS_NEWTON)
        return found.estimates, found.status

    return fits


REALIZATIONS = 200


@pytest.fixture(scope="module")
def realizations(many, clean):
    records = noisy(np.tile(clean, (REALIZATIONS, 1)), seed=1)
    estimates, status = many(records)
    assert not np.any(status)
    return records, np.stack([estimates[path] for path in FREE], 1)


def test_two_hundred_realizations_of_the_noise_scatter_as_the_standard_errors_say(found, realizations):
    """The standard deviation of n normal numbers is itself known to 1/sqrt(2 n): 5 % here; limits are four of these."""
    _, estimates = realizations
    n = REALIZATIONS
    covariance = found.covariance * (n_free(found) / (2 * float(found.cost)))  # of the noise that was made, not the one estimated
    u = np.log(estimates / values_of(found))
    ratio = u.std(0, ddof=1) / np.sqrt(np.diag(covariance))
    print(ratio)
    np.testing.assert_allclose(ratio, 1, atol=4 / np.sqrt(2 * (n - 1)))
    away = u - np.log(TRUTH / values_of(found))
    assert (np.abs(away.mean(0)) < 4 * np.sqrt(np.diag(covariance) / n)).all()
    square = np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away).mean()  # of chi-squared, four degrees of freedom
    print(square)
    assert abs(square - 4) < 4 * np.sqrt(8 / n)


def n_free(found):
    """Samples less parameters."""
    return len(TIMES) - len(found.paths)


def test_fits_side_by_side_are_those_one_by_one(realizations):
    records, estimates = realizations
    for i in (0, 17):
        one = jb.fit(cart(), tracked(records[i]), free=FREE)
        np.testing.assert_allclose(values_of(one), estimates[i], rtol=1e-6)


def test_the_derivative_of_the_estimates_in_the_data_is_that_of_differences(record, many):
    towards = np.random.default_rng(2).normal(size=len(TIMES)) * NOISE

    @jax.jit
    def slope(record, towards):
        def estimates(record):
            return jb.fit(cart(), tracked(record), free=FREE, method=LEVENBERG_MARQUARDT, rtol=FINE).estimates

        return jax.jvp(estimates, (record,), (towards,))[1]

    def estimates(step):
        return values_of(jb.fit(cart(), tracked(record + step * towards), free=FREE, rtol=FINE))

    found = slope(record, towards)
    near, far = ((estimates(h) - estimates(-h)) / (2 * h) for h in (1.0, 2.0))
    expected = (4 * near - far) / 3
    print(np.array([found[path] for path in FREE]) / expected - 1)
    np.testing.assert_allclose([found[path] for path in FREE], expected, rtol=1e-6)
