"""Fits against an independent simulation and least-squares program in SciPy: optimum, standard
errors, messages of failures."""

import re
from typing import ClassVar

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optax
import optimistix
import pytest
import scipy.optimize
from scipy.integrate import solve_ivp

import jaxbody as jb
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.fitting.parameters.spaces import units_of
from jaxbody.model.leaf_paths import leaves_of

# A cart on a guide of a shaken base, on three springs. With two of them, their damper and the mass
# unknown, the third sets the scale.
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
            name: jb.Spring(
                ("cart", [0, 0, 0]),
                ("base", end),
                stiffness=stiffness[name],
                free_length=lengths[name],
                damping=damping.get(name, 0.0),
            )
            for name, end in ENDS.items()
        },
        gravity=[gravity, 0, -9.81],
    )


def independent(
    values, *, times=TIMES, q=0.25, v=0.0, hold=HOLD, gravity=GRAVITY, frequency=FREQUENCY
):
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
        return [
            y[1],
            gravity + AMPLITUDE * omega**2 * np.cos(omega * t) + tension @ (along / L) / m,
        ]

    solution = solve_ivp(
        rate, (times[0], times[-1]), [q, v], method="DOP853", rtol=1e-12, atol=1e-13, t_eval=times
    )
    return AMPLITUDE * np.cos(omega * times) + solution.y[0], lengths(solution.y[0])[0][
        :, 0
    ] - free[0]


def noisy(x, seed=0, level=NOISE):
    return x + level * np.random.default_rng(seed).normal(size=np.shape(x))


def tracked(
    x, *, times=TIMES, noise=NOISE, q=0.25, v=0.0, frequency=FREQUENCY, amplitude=AMPLITUDE
):
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


def fit(model, experiments, *, free=FREE, **options):
    """All fits of this model with these free parameters are one compiled program."""
    return jb.fit(model, experiments, free=free, max_steps=1000, **options)


def values_of(result, paths=FREE):
    return np.array([result.estimates[path] for path in paths])


def minimum(residual, start):
    """Least squares by SciPy, with derivatives by differences, in logarithms."""
    options = dict(x_scale="jac", jac="3-point", xtol=1e-15, ftol=1e-15, gtol=1e-15)
    return np.exp(
        scipy.optimize.least_squares(lambda u: residual(np.exp(u)), np.log(start), **options).x
    )


@pytest.fixture(scope="module")
def clean():
    return independent(TRUTH)[0]


@pytest.fixture(scope="module")
def record(clean):
    return noisy(clean)


@pytest.fixture(scope="module")
def optimum(record):
    return minimum(lambda p: (independent(p)[0] - record) / NOISE, TRUTH)


@pytest.mark.long
def test_other_data_and_another_start_compile_nothing(record):
    fit(cart(), tracked(record))
    guess = jb.replace(cart(), {"*.stiffness": 77.0})
    with jb.compile_times() as spent:
        other = fit(guess, tracked(noisy(1.001 * np.asarray(record))))
    assert spent.count == 0, spent
    assert other.ok


METHODS = {
    "lbfgs": optax.lbfgs(),
    "adam": optax.adam(0.1),
    "least_squares": "least_squares",
    "levenberg_marquardt": optimistix.LevenbergMarquardt(rtol=1e-10, atol=1e-10),
}
QUICK = [
    pytest.param(name, marks=[pytest.mark.long] if name == "levenberg_marquardt" else [])
    for name in METHODS
]


@pytest.fixture(scope="module")
def result(record):
    return fit(cart(), tracked(record), rtol=FINE)


@pytest.mark.long
def test_the_fit_says_what_it_found(result, record, optimum):
    r = (independent(optimum)[0] - record) / NOISE
    print(values_of(result) / optimum - 1, result.cost / (0.5 * r @ r) - 1)
    np.testing.assert_allclose(values_of(result), optimum, rtol=1e-8)
    np.testing.assert_allclose(result.cost, 0.5 * r @ r, rtol=1e-7)
    np.testing.assert_allclose(result.predicted["run"]["x"], r * NOISE + record, rtol=0, atol=1e-9)
    np.testing.assert_allclose(result.noise["run"]["x"], NOISE * np.sqrt(np.mean(r**2)), rtol=1e-7)
    np.testing.assert_allclose(result.correlation, r[1:] @ r[:-1] / (r @ r), rtol=1e-6)
    assert (
        result.cost in result.history
        and result.cost <= min(result.history) * (1 + 1e-8)
        and len(result.history) == result.evaluations
    )
    assert values_of(result).tolist() == [
        float(jb.parameter_paths(result.model)[path]) for path in FREE
    ]
    assert re.search(r"\n  s.stiffness +79.92\d* +N/m +0.\d+ ", str(result)) and re.search(
        r"\n  s.damping +\S+ +N s/m ", str(result)
    )
    assert (
        "41 samples" in str(result)
        and str(result).rstrip().endswith("ok")
        and "not determined" not in str(result)
    )


@pytest.mark.parametrize("method", QUICK)
def test_every_method_reaches_the_optimum_that_scipy_finds_by_itself(method, record, optimum):
    result = fit(cart(), tracked(record), method=METHODS[method])
    assert result.ok and result.paths == FREE
    np.testing.assert_allclose(values_of(result), optimum, rtol=1e-6)
    print(method, values_of(result) / optimum - 1, result.evaluations)


@pytest.mark.long
@pytest.mark.parametrize("method", ["least_squares", "levenberg_marquardt"])
def test_constant_steps_or_a_controller_of_ones_own_give_the_same_estimates(method, record, result):
    for steps in (
        {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": TIMES[1] / 5},
        {"stepsize_controller": diffrax.PIDController(rtol=1e-11, atol=1e-11)},
    ):
        other = fit(cart(), tracked(record), method=METHODS[method], **steps)
        assert other.ok
        np.testing.assert_allclose(values_of(other), values_of(result), rtol=1e-7)


@pytest.mark.parametrize(
    "method",
    [pytest.param(name, marks=[pytest.mark.long] * (name != "least_squares")) for name in METHODS],
)
def test_data_without_noise_give_the_truth_back(method, clean):
    result = fit(cart(), tracked(clean), method=METHODS[method], rtol=FINE)
    print(method, values_of(result) / TRUTH - 1, result.evaluations)
    np.testing.assert_allclose(values_of(result), TRUTH, rtol=1e-8)


def test_standard_errors_are_those_of_a_jacobian_by_differences(result, record):
    p = values_of(result)

    def x(u):
        return independent(np.exp(u))[0]

    h = 1e-3
    steps = [h * row for row in np.eye(4)]
    J = np.stack(
        [
            (
                8 * (x(np.log(p) + d) - x(np.log(p) - d))
                - (x(np.log(p) + 2 * d) - x(np.log(p) - 2 * d))
            )
            / (12 * h)
            for d in steps
        ],
        1,
    )
    r = x(np.log(p)) - record
    covariance = r @ r / (len(r) - 4) * np.linalg.inv(J.T @ J)
    expected = p * np.sqrt(np.diag(covariance))
    print(np.array([result.standard_errors[path] for path in FREE]) / expected - 1)
    np.testing.assert_allclose([result.standard_errors[path] for path in FREE], expected, rtol=1e-5)
    np.testing.assert_allclose(
        result.covariance, covariance, rtol=1e-5 * np.linalg.cond(covariance) ** 0.5
    )
    np.testing.assert_allclose(result.singular_values * NOISE, np.linalg.svd(J)[1], rtol=1e-6)


LEVENBERG_MARQUARDT = METHODS["levenberg_marquardt"]
GAUSS_NEWTON = optimistix.GaussNewton(rtol=1e-5, atol=1e-5)


@pytest.fixture(scope="module")
def many():
    """Fits of a batch of records, by one program: estimates and status."""

    @jax.jit
    @jax.vmap
    def fits(record):
        result = fit(cart(TRUTH), tracked(record), method=GAUSS_NEWTON)
        return result.estimates, result.status

    return fits


REALIZATIONS = 200


@pytest.fixture(scope="module")
def realizations(many, clean):
    records = noisy(np.tile(clean, (REALIZATIONS, 1)), seed=1)
    estimates, status = many(records)
    assert not np.any(status)
    return records, np.stack([estimates[path] for path in FREE], 1)


@pytest.mark.long
def test_two_hundred_realizations_of_the_noise_scatter_as_the_standard_errors_say(
    result, realizations
):
    """The standard deviation of n normal numbers is itself known to 1/sqrt(2 n): 5 % here; limits
    are four of these."""
    _, estimates = realizations
    n = REALIZATIONS
    # of the noise that was made, not the one estimated
    covariance = result.covariance * (n_free(result) / (2 * float(result.cost)))
    u = np.log(estimates / values_of(result))
    ratio = u.std(0, ddof=1) / np.sqrt(np.diag(covariance))
    print(ratio)
    np.testing.assert_allclose(ratio, 1, atol=4 / np.sqrt(2 * (n - 1)))
    away = u - np.log(TRUTH / values_of(result))
    assert (np.abs(away.mean(0)) < 4 * np.sqrt(np.diag(covariance) / n)).all()
    # of chi-squared, four degrees of freedom
    square = np.einsum("ni,ij,nj->n", away, np.linalg.inv(covariance), away).mean()
    print(square)
    assert abs(square - 4) < 4 * np.sqrt(8 / n)


def n_free(result):
    """Samples less parameters."""
    return len(TIMES) - len(result.paths)


@pytest.mark.long
def test_fits_side_by_side_are_those_one_by_one(realizations):
    records, estimates = realizations
    for i in (0, 17):
        one = fit(cart(), tracked(records[i]))
        np.testing.assert_allclose(values_of(one), estimates[i], rtol=1e-6)


@pytest.mark.long
def test_the_derivative_of_the_estimates_in_the_data_is_that_of_differences(record, many):
    towards = np.random.default_rng(2).normal(size=len(TIMES)) * NOISE

    @jax.jit
    def slope(record, towards):
        def estimates(record):
            return fit(cart(), tracked(record), method=LEVENBERG_MARQUARDT, rtol=FINE).estimates

        return jax.jvp(estimates, (record,), (towards,))[1]

    def estimates(step):
        return values_of(fit(cart(), tracked(record + step * towards), rtol=FINE))

    result = slope(record, towards)
    near, far = ((estimates(h) - estimates(-h)) / (2 * h) for h in (1.0, 2.0))
    expected = (4 * near - far) / 3
    print(np.array([result[path] for path in FREE]) / expected - 1)
    np.testing.assert_allclose([result[path] for path in FREE], expected, rtol=1e-6)


def test_inside_jit_only_optimistix_and_stated_noise(record):
    for method, noise, code in (
        ("least_squares", NOISE, "TRACED"),
        (optax.lbfgs(), NOISE, "TRACED"),
        (GAUSS_NEWTON, {"x": NOISE}, "NO_NOISE"),
    ):

        def estimated(x, method=method, noise=noise, code=code):
            (run,) = tracked(x, noise=noise).values()
            if code == "NO_NOISE":  # of two sensors one has none
                both = {"x": run.sensors["x"], "gap": jb.Elongation("s")}
                run = jb.Experiment(
                    TIMES,
                    motion=run.motion,
                    initial=run.initial,
                    sensors=both,
                    measured={"x": x, "gap": x},
                    noise=noise,
                )
            return fit(cart(), {"run": run}, method=method).u

        with pytest.raises(jb.JaxbodyError) as caught:
            jax.jit(estimated)(record)
        assert caught.value.code == code and caught.value.hint


# What the fit says where it cannot be trusted


def fit_with_warning(code, *arguments, **options):
    with pytest.warns(jb.JaxbodyWarning) as caught:
        result = fit(*arguments, **options)
    assert [warning.message.code for warning in caught] == [code]
    return result


@pytest.mark.long
@pytest.mark.parametrize("method", ["least_squares", "lbfgs"])
def test_what_the_data_cannot_tell_is_said_in_words_and_has_no_number(method, clean):
    """Without the spring that is known, all stiffnesses, the damping and the mass may be multiplied
    by one number."""
    x = noisy(independent(TRUTH, hold=0.0)[0])
    result = fit_with_warning(
        "NOT_IDENTIFIABLE", cart(hold=0.0), tracked(x), method=METHODS[method]
    )
    assert (
        not result.ok
        and result.status == jb.Status.NOT_IDENTIFIABLE
        and result.uncertainty.rank == 3
    )
    assert all(np.isinf(result.standard_errors[path]) for path in FREE)
    (words,) = result.unidentified
    assert sorted(words.split(" with ")) == sorted(f"{path} up" for path in FREE)
    assert (
        result.singular_values[-1] < 1e-6 * result.singular_values[0] < result.singular_values[-2]
    )
    assert (
        "rank 3 of 4" in result.report()
        and words in str(result)
        and str(result).count("not determined") == 4
    )
    ratios, truth = values_of(result) / result.estimates["cart.mass"], TRUTH / TRUTH[3]
    np.testing.assert_allclose(ratios, truth, rtol=0.02)  # what can be told
    with pytest.raises(jb.JaxbodyError, match="NOT_IDENTIFIABLE"):
        result.raise_if_failed()


def test_parameters_without_any_effect_are_named():
    """A cart at rest with nothing that moves it feels neither stiffness, damping nor mass."""
    still = cart(
        gravity=0.0, lengths={name: float(np.linalg.norm(end)) for name, end in ENDS.items()}
    )
    run = tracked(noisy(np.zeros(41)), q=0.0, amplitude=0.0)
    result = fit_with_warning("NEVER_MOVED", still, run)
    assert result.status == jb.Status.NEVER_MOVED
    assert [word.split()[0] for word in result.unidentified] == list(
        FREE
    ) and "s.damping has no effect" in result.report()
    assert all(np.isinf(result.standard_errors[path]) for path in FREE)
    np.testing.assert_array_equal(values_of(result), START)


class Mine(jb.Position):
    """A sensor of a user's."""


RIG_OF_ALL = jb.Model(
    bodies={
        "plate": jb.Body(mass=3.0, inertia=[0.3, 0.4, 0.5]),
        "arm": jb.Body(mass=1.0, inertia=[1, 1, 1]),
    },
    supports={"base": jb.Support()},
    joints={"arm": jb.Hinge("base", axis=[0, 0, 1])},
    elements={
        "strut": jb.SpringDamper(
            ("plate", [0, 0, 0]),
            ("base", [0, 0, 1]),
            spring=jb.laws.Linear(1.0) + jb.laws.BumpStop(gap=0.1, stiffness=1.0),
            damper=2.0,
        ),
        "torsion": jb.Torsion(
            "arm",
            "base",
            axis=[0, 0, 1],
            spring=2.0,
            damper=jb.laws.Friction(level=1.0, velocity=1e-3),
        ),
        "mount": jb.Bushing(("plate", [0, 0, 0]), ("base", [0, 0, 0]), stiffness=np.eye(6)),
    },
)
RUN_OF_ALL = jb.Experiment(
    [0.0, 1.0],
    motion={"base": jb.Harmonic(frequency=1.0, translation=[0, 0, 0.01])},
    initial=RIG_OF_ALL.reference,
    sensors={
        "plate6": jb.sensors.ForcePlate("base", gain=1.0, bias=np.zeros(6)),
        "pose": jb.sensors.BodyPose("plate", bias=np.zeros(6)),
        "acc": jb.Accelerometer("plate", axis=[0, 0, 1], bias=0.0, delay=0.0, lag=1e-3),
        "mine": Mine("plate", axis=[0, 0, 1], bias=0.0),
    },
    measured={
        "plate6": np.zeros((2, 6)),
        "pose": np.tile([0, 0, 0, 1.0, 0, 0, 0], (2, 1)),
        "acc": [0, 0],
        "mine": [0, 0],
    },
)


class Weighed(Measurement):
    """A reading without a simulation: times the stiffness of s along x."""

    measured: dict = eqx.field(default_factory=dict)
    noise: dict | None = None
    channels: ClassVar = {("force"): jb.sensors.ForcePlate("base")}  # pyright: ignore[reportIncompatibleMethodOverride]

    def readings(self, model, integration, lin):
        along = model["s"].stiffness * model.joint("cart").axis
        return {"force": jnp.arange(1.0, 5.0)[:, None] * jnp.concatenate([along, along])}

    def axis(self, channel):
        return "sample", np.arange(4), ""

    def place(self, row):
        return "sample", float(row)


@pytest.mark.nan
def test_a_direction_that_the_data_cannot_tell_has_no_number_along_it_either():
    """The first derivative of a unit vector along itself is zero; what there is of it moves with
    what is not known."""
    along = np.multiply.outer(np.arange(1.0, 5.0), [120.0, 0, 0, 120.0, 0, 0])
    along[:, [1, 2, 4, 5]] = np.nan
    result = fit_with_warning(
        "NEVER_MOVED",
        cart(),
        {"run": Weighed({"force": jnp.asarray(along)})},
        free=["s.stiffness", "cart.axis"],
    )
    np.testing.assert_array_equal(result.standard_errors["cart.axis"], np.inf)
    np.testing.assert_array_equal(result.intervals()["cart.axis"], [[-np.inf] * 3, [np.inf] * 3])
    assert float(result.standard_errors["s.stiffness"]) < 1e-6 and float(
        result.estimates["s.stiffness"]
    ) == pytest.approx(120)
    printed = str(result)
    assert printed.count("not determined") == 3 and re.search(
        r"\n  cart.axis\[0\] +1 +not determined\n", printed
    )
    assert (
        "\n  run.force force " in printed
        and "\n  run.force moment " in printed
        and "%" not in printed.split("interval")[1]
    )


@pytest.mark.parametrize(
    ("path", "units"),
    [
        ("plate.mass", ["kg"]),
        ("plate.inertia", ["kg m2"] * 9),
        ("plate.com", ["m"] * 3),
        ("plate.orientation", [""] * 4),
        ("arm.axis", [""] * 3),
        ("gravity", ["m/s2"] * 3),
        ("strut.spring.terms.0.coefficient", ["N/m"]),
        ("strut.spring.terms.1.gap", ["m"]),
        ("strut.damper.coefficient", ["N s/m"]),
        ("torsion.spring.coefficient", ["N m/rad"]),
        ("torsion.damper.level", ["N m"]),
        ("torsion.damper.velocity", ["rad/s"]),
        ("torsion.free_angle", ["rad"]),
        ("torsion.a", ["m"] * 3),
        ("mount.stiffness", [*(["N/m"] * 3 + ["N"] * 3) * 3, *(["N"] * 3 + ["N m/rad"] * 3) * 3]),
        ("run.initial.q", ["m"] * 3 + [""] * 4 + ["rad"]),
        ("run.initial.v", ["m/s"] * 3 + ["rad/s"] * 4),
        ("run.base.frequency", ["Hz"]),
        ("run.base.rotation", ["rad"] * 3),
        ("run.plate6.bias", ["N"] * 3 + ["N m"] * 3),
        ("run.plate6.gain", [""]),
        ("run.pose.bias", ["m"] * 3 + ["rad"] * 3),
        ("run.acc.bias", ["m/s2"]),
        ("run.acc.lag", ["s"]),
        ("run.acc.delay", ["s"]),
        ("run.mine.bias", ["m"]),
    ],
)
def test_each_number_of_a_parameter_has_its_unit(path, units):
    trees = {"": RIG_OF_ALL, "run": RUN_OF_ALL}
    run = "run" if path.startswith("run.") else ""
    leaf = next(
        leaf for leaf in leaves_of(trees[run], f"{run}." if run else "") if leaf.path == path
    )
    value = np.asarray(leaf.read(jax.tree.leaves(trees[run])))
    assert units_of(leaf, RIG_OF_ALL, value) == units


def test_correlated_residuals_are_reported_and_white_ones_are_not(clean, result):
    assert not result.uncertainty.correlated and "correlated" not in str(result)
    shocks, colored = NOISE * np.random.default_rng(4).normal(size=1041), np.zeros(1041)
    for i in range(1, 1041):
        colored[i] = 0.8 * colored[i - 1] + shocks[i]
    other = fit_with_warning("CORRELATED_RESIDUALS", cart(), tracked(clean + colored[-41:]))
    assert other.ok and other.uncertainty.correlated and other.correlation > 0.5
    assert f"correlated (lag one {other.correlation:.2f})" in str(
        other
    ) and "for white noise would be up to" in str(other)


def test_a_bound_that_is_met_is_named_and_the_rest_is_the_optimum_on_it(record):
    result = fit_with_warning(
        "AT_BOUND", cart(), tracked(record), bounds={"s.stiffness": (90, 110), "*.damping": (0, 5)}
    )
    assert result.at_bound == ["s.stiffness (lower)"] and "s.stiffness (lower)" in result.report()
    np.testing.assert_allclose(result.estimates["s.stiffness"], 90, rtol=1e-6)
    rest = minimum(lambda p: (independent([90.0, *p])[0] - record) / NOISE, TRUTH[1:])
    print(values_of(result)[1:] / rest - 1)
    np.testing.assert_allclose(values_of(result)[1:], rest, rtol=1e-5)


def test_bounds_that_are_not_met_change_nothing(record, optimum):
    result = fit(
        cart(), tracked(record), bounds={"*.stiffness": (0.0, np.inf), "cart.mass": (1.5, 2.5)}
    )
    assert result.ok and result.at_bound == []
    np.testing.assert_allclose(values_of(result), optimum, rtol=1e-6)


@pytest.mark.long
def test_trials_that_cannot_be_simulated_are_steps_rejected_and_counted(record, optimum):
    """From far too soft a spring the first steps lead to stiffnesses that need more steps of
    integration than there are."""
    far = cart(START * [1e-4, 1, 1, 1])
    result = fit(far, tracked(record))
    print(result.failed, result.evaluations)
    assert result.ok and result.failed >= 2 and np.isnan(result.history).sum() == result.failed
    np.testing.assert_allclose(values_of(result), optimum, rtol=1e-6)
    with pytest.warns(jb.JaxbodyWarning) as caught:
        result = fit(far, tracked(record), max_evaluations=5)
    assert [warning.message.code for warning in caught] == ["NOT_CONVERGED", "FAILED_TRIALS"]
    np.testing.assert_array_equal(values_of(result), START * [1e-4, 1, 1, 1])


@pytest.mark.long
@pytest.mark.parametrize("method", METHODS)
def test_at_the_largest_number_of_evaluations_the_best_is_kept_with_a_status(method, record):
    result = fit_with_warning(
        "NOT_CONVERGED", cart(), tracked(record), method=METHODS[method], max_evaluations=3
    )
    start = np.sum(((independent(START)[0] - record) / NOISE) ** 2) / 2
    assert (
        result.status == jb.Status.NOT_CONVERGED and result.evaluations <= 5 and result.cost < start
    )
    assert result.cost == min(result.history) and "evaluations" in result.report()


def test_progress_is_reported_by_evaluation(record, capsys):
    result = fit(cart(), tracked(record), progress=True)
    lines = capsys.readouterr().out.splitlines()
    assert (
        len(lines) == result.evaluations
        and lines[0].startswith("evaluation 1: cost ")
        and lines[-1].startswith(f"evaluation {len(lines)}:")
    )
    fit(cart(), tracked(record))
    assert capsys.readouterr().out == ""


def problems_of(*arguments, **options):
    with pytest.raises(jb.JaxbodyError) as caught:
        fit(*arguments, **options)
    return caught.value.problems


@pytest.mark.long
def test_a_start_that_cannot_be_simulated_names_the_element_the_time_and_the_channel(record):
    (problem,) = problems_of(cart(hold=1.7e308), tracked(record, q=2.0))
    assert problem.code == "NONFINITE_START" and problem.where == "run.x" and problem.hint
    assert (
        "'hold'" in problem.message
        and "from t = 0.05 s on" in problem.message
        and problem.value == 0.05
    )


@pytest.mark.parametrize(
    ("options", "codes", "message"),
    [
        (
            {"free": ["s.stifness", "cart.mass", "run.bas.frequency"]},
            ["UNKNOWN_PATH"] * 2,
            ["s.stiffness", "run.base.frequency"],
        ),
        (
            {"free": ["s.stiffness", "*.stiffness", "s.*"]},
            ["LISTED_TWICE"] * 2,
            ["lists s.stiffness twice, also by '*.stiffness'", "'s.*'"],
        ),
        ({"free": []}, ["NOTHING_FREE"], [""]),
        ({"free": ["*.damping"]}, ["START_ON_BOUND"] * 2, ["t.damping", "hold.damping"]),
        ({"stepsize_controller": diffrax.ConstantStepSize()}, ["NO_STEP"], ["fit.dt0"]),
        ({"solver": jb.Gauss()}, ["NO_ERROR_ESTIMATE"], ["fit.solver"]),
        ({"rtol": -1.0, "dt0": 0.0}, ["BAD_NUMBER"] * 2, ["fit.dt0: is 0.0", "fit.rtol: is -1.0"]),
        ({"method": "simplex"}, ["UNKNOWN_METHOD"], ["simplex"]),
        (
            {"max_evaluations": 0},
            ["BAD_NUMBER"],
            ["fit.max_evaluations: is 0 (allowed: a whole number >= 1)"],
        ),
        (
            {"free": None},
            ["WRONG_KIND"],
            [
                (
                    "fit.free: is None (allowed: paths or patterns). Name the "
                    'unknowns: free=["*.stiffness"'
                )
            ],
        ),
        (
            {"free": ["run.x.bias"]},
            ["UNKNOWN_PATH"],
            ["Sensor 'x' has no bias: construct it with bias=0.0."],
        ),
        (
            {"free": ["run.*.lag", "run.x.start"]},
            ["UNKNOWN_PATH"] * 2,
            ["construct it with lag=1e-3.", "construct it with lag=1e-3, start=0.0."],
        ),
        (
            {"free": ["s.stiffness =", "run.x.biass"]},
            ["UNKNOWN_PATH"] * 2,
            ["'s.stiffness =' ties nothing on one side", "matches nothing. Did you"],
        ),
        (
            {"priors": {"s.stiffness": (400, -1), "s.x": (1, 1)}},
            ["UNKNOWN_PATH", "BAD_PRIOR"],
            ["'s.x' matches", "(400, -1)"],
        ),
        (
            {"bounds": {"s.stiffness": (2, 1), "s.x": (1, 1)}},
            ["UNKNOWN_PATH", "BAD_BOUNDS"],
            ["'s.x' matches", "lower 2"],
        ),
        (
            {"bounds": [(300.0, 600.0)]},
            ["WRONG_KIND"],
            [
                (
                    "fit.bounds: is a list (allowed: a dict {path: (lower, upper)}). Write "
                    'bounds={"...": (lower'
                )
            ],
        ),
        (
            {"priors": [(300.0, 6.0)]},
            ["WRONG_KIND"],
            ['Write priors={"...": (mean, standard deviation)}'],
        ),
        (
            {"bounds": {"cart.mass": (1, 3)}, "method": optax.adam(0.1)},
            ["BAD_BOUNDS"],
            ["least_squares"],
        ),
        (
            {"bounds": {"cart.mass": (1, 3)}, "method": GAUSS_NEWTON},
            ["BAD_BOUNDS"],
            ["least_squares"],
        ),
        ({"bounds": {"hold.stiffness": (1, 3)}}, ["UNKNOWN_PATH"], ["hold.stiffness"]),
        (
            {"free": ["gravity", "run.initial.q"], "bounds": {"*": (0, 1, 2)}},
            ["BAD_BOUNDS"] * 2,
            ["gravity", "cannot have bounds"],
        ),
        (
            {"bounds": {"cart.mass": (2, 2), "s.*": (1, 2), "t.stiffness": (np.nan, 90)}},
            ["START_OUTSIDE", "BAD_BOUNDS", "BAD_BOUNDS"],
            [
                "excludes the start 104.0, which is outside by 102",
                "is (nan, 90), which has a NaN",
                "lower 2 >= upper 2",
            ],
        ),
    ],
    ids=[
        "unknown",
        "twice",
        "nothing",
        "start",
        "steps",
        "solver",
        "tolerance",
        "method",
        "evaluations",
        "none",
        "bias",
        "lag",
        "tie",
        "priors",
        "bounds",
        "list",
        "list of priors",
        "optax",
        "optimistix",
        "elsewhere",
        "shapes",
        "several",
    ],
)
def test_what_is_wrong_with_a_fit_is_reported_at_once(record, options, codes, message):
    result = problems_of(cart(), tracked(record), **options)
    assert [problem.code for problem in result] == codes
    assert all(word in str(problem) for word, problem in zip(message, result, strict=True)), [
        str(problem) for problem in result
    ]


def test_what_is_wrong_with_the_experiments_is_reported_at_once(record):
    (run,) = tracked(record).values()
    assert [p.code for p in problems_of(cart(), {})] == ["NO_DATA"]
    result = problems_of(
        cart(), {"cart": run, "a.b": run, "s": run, "base": run, "world": run, 1: run, "c": 3}
    )
    assert [p.code for p in result] == ["WRONG_KIND", *["BAD_NAME"] * 6]
    for message, problem in zip(
        (
            "name of a body",
            "has . in",
            "of an element",
            "of a support",
            "is reserved",
            "not a string",
        ),
        result[1:],
        strict=True,
    ):
        assert message in problem.message
    other = jb.Experiment(
        TIMES, sensors={"x": jb.Position("card")}, measured={"x": np.arange(123.0).reshape(41, 3)}
    )
    (problem,) = problems_of(cart(), {"run": other})
    assert (
        problem.code == "UNKNOWN_NAME"
        and problem.where == "run.sensors['x']"
        and "'cart'" in problem.hint
    )
    base = {"tabel": jb.Harmonic(frequency=1.0)}
    lost = jb.Experiment(
        TIMES,
        motion=base,
        sensors={"x": jb.Position("cat", axis=[1, 0, 0])},
        measured={"x": record},
    )
    assert [p.where for p in problems_of(cart(), {"run": lost, "two": other})] == [
        "run.motion",
        "run.sensors['x']",
        "two.sensors['x']",
    ]
    late = jb.Experiment(
        TIMES,
        sensors={"x": jb.Position("cart", axis=[1, 0, 0], delay=100.0)},
        measured={"x": record},
    )
    (problem,) = problems_of(cart(), {"run": late})
    assert (
        problem.code == "BAD_DELAY"
        and problem.where == "run.sensors['x'].delay"
        and "is 100 s in a record of 2 s" in problem.message
    )
    short = jb.State(jnp.zeros(2), jnp.zeros(1))
    (problem,) = problems_of(
        cart(),
        {"run": jb.Experiment(TIMES, initial=short, sensors=run.sensors, measured=run.measured)},
    )
    assert problem.code == "BAD_SHAPE" and problem.where == "run.initial.q"


def test_what_is_of_another_kind_is_reported_and_no_traceback(record):
    (run,) = tracked(record).values()
    cases = [
        (
            lambda: fit(cart(), run),
            (
                "fit.experiments: is one Experiment without a name (allowed: a dict of experiments "
                'by name). Write {"run": experiment}'
            ),
        ),
        (lambda: jb.validate(None, run), "validate.experiments: is one Experiment"),
        (
            lambda: jb.fitting.multiple_shooting(cart(), run, free=FREE, segments=2),
            "multiple_shooting.experiments: is one Experiment",
        ),
        (lambda: fit("osc", {"run": run}), "fit.model: is a str (allowed: jb.Model)"),
    ]
    for call, message in cases:
        with pytest.raises(jb.JaxbodyError) as caught:
            call()
        assert caught.value.code == "WRONG_KIND" and message in str(caught.value)


def test_an_experiment_without_an_initial_state_says_so(record):
    run = jb.Experiment(
        TIMES, sensors={"x": jb.Position("cart", axis=[1, 0, 0])}, measured={"x": record}
    )
    (problem,) = problems_of(cart(), {"run": run}, free=["run.initial.*"])
    assert problem.code == "UNKNOWN_PATH" and problem.hint.startswith(
        "The experiment has no initial state: give it initial=State(q, v)"
    )


def test_one_pattern_may_stand_alone(record):
    """And not be taken for a list of letters, `*` among them."""
    (problem,) = problems_of(cart(), tracked(record), free="*.mas")
    assert problem.value == "*.mas"


def test_float32_is_refused(record):
    with jax.enable_x64(False):
        (problem,) = problems_of(cart(), tracked(record))
        assert problem.code == "FLOAT32" and "jax_enable_x64" in problem.hint
