"""Fits to expect of plans against exact designs, closed forms, fits of simulated records, and every
kind of measurement; continuous choices by exact derivatives."""

from functools import partial

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rigs import mass_on_spring
from scipy.optimize import root

import jaxbody as jb

W, MASS = 10.0, 2.0  # natural frequency [rad/s], mass [kg]
K_AND_C = ["spring.stiffness", "spring.damping"]


def oscillator(zeta):
    return mass_on_spring(MASS, MASS * W**2, 2 * zeta * W * MASS)


def response_at(hertz, sensor=jb.Position):
    return jb.MeasuredResponse(
        hertz,
        inputs={"f": jb.PointForce("mass", direction="z")},
        outputs={"x": sensor("mass", axis="z")},
        noise=1e-4,
    )


def D(model, plans, free):
    return jb.fitting.criterion(jb.fitting.information(model, plans, free=free))


@pytest.mark.parametrize(
    "zeta, best",
    [
        (0.1, 0.992485992),
        pytest.param(0.02, 0.999699978, marks=pytest.mark.long),
        pytest.param(0.05, 0.998124122, marks=pytest.mark.long),
        pytest.param(0.3, 0.931412125, marks=pytest.mark.long),
    ],
)
def test_the_best_frequency_is_found_by_tune(zeta, best):
    """REFERENCES2 D1: 7 s^2 - (6 - 12 z^2) s - 1 = 0 with s = (w/wn)^2; tolerance 1e-7 from the
    root of the exact derivative."""
    model, start = oscillator(zeta), 1.1 * W / (2 * np.pi)
    design = jb.tune(
        model,
        partial(D, free=K_AND_C),
        free=["hammer.frequencies"],
        plans={"hammer": response_at([start])},
        bounds={"hammer.frequencies": (0.8 * start, 1.1 * start)},
    )
    assert design.ok
    found = np.asarray(design.plans["hammer"].frequencies) * 2 * np.pi / W
    np.testing.assert_allclose(found, best, atol=1e-6)

    def value(x):
        return D(model, {"hammer": response_at(x * W / (2 * np.pi))}, K_AND_C)

    exact = root(jax.jit(jax.grad(value)), found, tol=1e-13).x
    np.testing.assert_allclose(exact, best, atol=1e-7 if zeta > 0.05 else 2e-7)


def test_the_best_frequency_of_a_velocity():
    """REFERENCES2 D1: 5 s^2 - (2 - 4 z^2) s - 3 = 0."""
    model = oscillator(0.1)

    def value(x):
        return D(model, {"v": response_at(x * W / (2 * np.pi), jb.Velocity)}, K_AND_C)

    np.testing.assert_allclose(
        root(jax.jit(jax.grad(value)), [1.01], tol=1e-13).x, 0.997501572, atol=1e-7
    )


@pytest.mark.parametrize(
    "zeta, best, share",
    [
        (0.05, (0.974844141, 1.019646457), 0.488791),
        pytest.param(0.02, (0.99061303, 1.00850673), 0.495526, marks=pytest.mark.long),
    ],
)
def test_two_frequencies_for_mass_damping_and_stiffness(zeta, best, share):
    """REFERENCES2 D2, frequencies and shares to 1e-5."""
    model, free = oscillator(zeta), [*K_AND_C, "mass.mass"]

    @jax.jit
    @jax.grad
    def slope(x):
        each = (
            jb.fitting.information(model, {"r": response_at(w[None] * W / (2 * np.pi))}, free=free)
            for w in x[:2]
        )
        return jb.fitting.criterion(sum(s * M for s, M in zip((x[2], 1 - x[2]), each, strict=True)))

    start = [1 - zeta / np.sqrt(5), 1 + zeta / np.sqrt(5), 0.5]  # the limit of small damping
    found = root(slope, start, tol=1e-12)
    assert found.success
    np.testing.assert_allclose(found.x, [*best, share], atol=1e-5)


def line(noise=0.3):
    """REFERENCES2 D6: y = a + b t, the bias and the gain of a sensor on a moving table."""
    t = np.arange(12) * 0.25
    ramp = jb.Sampled(t, translation=np.stack([0 * t, 0 * t, t], 1))
    model = jb.Model(
        bodies={"idle": jb.Body(mass=1.0, inertia=[1, 1, 1])}, supports={"table": jb.Support()}
    )
    sensor = jb.Position("table", axis="z", gain=1.0, bias=0.0)
    plan = jb.Experiment(t, sensors={"y": sensor}, motion={"table": ramp}, noise=noise)
    return model, {"run": plan}


def test_expected_information_of_a_line():
    """REFERENCES2 D6: standard deviations, correlation, 5.446966633 nat of expected information."""
    names = ["run.y.bias", "run.y.gain"]
    priors = {"run.y.bias": (0.0, 2.0), "run.y.gain": (0.0, 1.0)}
    fit = jb.expected_fit(*line(), free=names, priors=priors)
    errors = [float(fit.standard_errors[name]) for name in names]
    np.testing.assert_allclose(errors, [0.161790697, 0.099613588], atol=1e-8)
    np.testing.assert_allclose(fit.correlations[0, 1], -0.844995106, atol=1e-8)
    spread = np.array(errors)[:, None] * fit.correlations * errors
    gained = np.log(2.0) + np.log(1.0) - 0.5 * np.linalg.slogdet(spread)[1]
    np.testing.assert_allclose(gained, 5.446966633, atol=1e-8)


def test_intervals_are_those_of_a_fit_of_what_was_planned():
    """The fit of the predicted record with stated noise, but for Student's t: the same standard
    errors where the residuals are as large as stated."""
    model = oscillator(0.05)
    t = jnp.linspace(0.0, 2.0, 401)
    start = jb.State(jnp.array([0.01]), jnp.zeros(1))
    run = partial(jb.Experiment, t, sensors={"x": jb.Position("mass", axis="z")}, initial=start)
    fit = jb.expected_fit(model, {"run": run(noise=1e-3)}, free=K_AND_C)
    x = jb.measure(jb.simulate(model, t, initial=start), {"x": jb.Position("mass", axis="z")})["x"]
    noise = 1e-3 * np.sign(np.random.default_rng(0).normal(size=t.shape))  # of size 1e-3 exactly
    fitted = jb.fit(model, {"run": run(measured={"x": x + noise}, noise=1e-3)}, free=K_AND_C)
    for name in K_AND_C:
        np.testing.assert_allclose(
            fitted.standard_errors[name], fit.standard_errors[name], rtol=0.03
        )
    assert "expected of plans" in str(fit) and "401 samples" in str(fit)
    assert fit.degrees_of_freedom["spring.stiffness"] == np.inf


@pytest.mark.long
def test_the_scatter_of_2000_fits_is_as_expected():
    """Ratio of the deviation of estimates to the expected standard errors: 0.95 to 1.05 (it has
    itself an error of 1.6 %)."""
    t, start = jnp.linspace(0.0, 3.0, 61), jb.State(jnp.array([0.01]), jnp.zeros(1))
    plan = jb.Experiment(t, sensors={"x": jb.Position("mass", axis="z")}, initial=start, noise=3e-4)
    fit = jb.expected_fit(oscillator(0.05), {"run": plan}, free=K_AND_C)
    result = jb.fitting.interval_coverage(fit, replicates=2000)
    assert result.ok.all()
    assert ((result.ratio > 0.95) & (result.ratio < 1.05)).all(), result.ratio
    assert (abs(result.contained - 0.95) < 4 * result.standard_error).all()


PLANS = {
    "modes": lambda **data: jb.MeasuredModes(
        number=[0, 1],
        noise={"frequency": 0.01, "damping_ratio": 1e-3, "shapes": 0.01},
        sensors={"b": jb.Position("body", axis="z"), "w": jb.Position("wheel", axis="z")},
        **data,
    ),
    "response": lambda **data: jb.MeasuredResponse(
        [1.0, 2.0, 9.0],
        inputs={"f": jb.PointForce("body", direction="z")},
        outputs={"z": jb.Position("body", axis="z"), "w": jb.Position("wheel", axis="z")},
        noise={("z", "f"): 1e-6},
        **data,
    ),
    "stiffness": lambda **data: jb.fitting.MeasuredStiffness(
        "suspension", [1.0, 5.0], noise={"magnitude": 50.0}, **data
    ),
}


@pytest.mark.parametrize("kind", PLANS)
def test_plans_of_every_kind_expect_what_their_data_give(kind):
    """The covariance of a fit of exact data with the same stated noise."""
    free = ["suspension.stiffness"] + ["suspension.damping"] * (kind != "stiffness")
    car, plan = jb.presets.quarter_car(damping=1500.0), PLANS[kind]()
    fit = jb.expected_fit(car, {"test": plan}, free=free)
    predicted = fit.predicted["test"]
    if kind == "response":
        given = {"measured": {("z", "f"): predicted["z/f"]}}
    elif kind == "stiffness":
        given = {"magnitude": predicted["magnitude"]}
    else:
        given = {name: predicted[name] for name in predicted}
    with np.errstate(all="ignore"):
        fitted = jb.fit(car, {"test": PLANS[kind](**given)}, free=free)
    J = [np.asarray(jb.fitting.information(car, {"test": plan}, free=free))]
    np.testing.assert_allclose(J[0] @ fit.covariance, np.eye(len(free)), atol=1e-7)
    known = kind == "modes"  # its numbers are too few to estimate the noise, which is as stated
    if known:
        np.testing.assert_allclose(fitted.covariance, fit.covariance, rtol=1e-5)
    assert set(fit.predicted["test"]) == set(PLANS[kind]().channels)


@pytest.mark.long
def test_curves_are_planned():
    corner = jb.suspension.double_wishbone()
    rig = jb.fitting.MeasuredCurves(
        corner.wheel,
        drive={"travel": corner.wheel, "rack": "rack.q"},
        over={"travel": [-0.05, 0.0, 0.05], "rack": 0.0},
        noise={"toe": 1e-4, "camber": 1e-4},
    )
    fit = jb.expected_fit(corner, {"rig": rig}, free=["tie rod inner"])
    assert fit.suspension is not None and set(fit.noise["rig"]) == {"toe", "camber"}
    assert np.isfinite(fit.covariance).all()


def test_derivatives_of_the_information():
    """By a damping and frequencies: forward and reverse against differences of fourth order."""
    model = oscillator(0.1)

    def value(x):
        moved = jb.replace(model, {"spring.damping": x[0]})
        return D(moved, {"r": response_at(x[1:])}, K_AND_C)

    x = jnp.array([4.0, 1.4, 1.8])
    forward, backward = jax.jit(jax.jacfwd(value))(x), jax.jit(jax.grad(value))(x)
    np.testing.assert_allclose(forward, backward, rtol=1e-9)
    f = jax.jit(value)
    for i, h in enumerate(1e-3 * x):
        e = h * jnp.eye(3)[i]
        difference = (8 * (f(x + e) - f(x - e)) - (f(x + 2 * e) - f(x - 2 * e))) / (12 * h)
        np.testing.assert_allclose(forward[i], difference, rtol=1e-6)


def test_plans_that_are_not_whole_are_refused():
    model = oscillator(0.1)

    def refused(code, plan, free=K_AND_C):
        with pytest.raises(jb.JaxbodyError) as error:
            jb.expected_fit(model, {"run": plan}, free=free)
        assert code in str(error.value)
        return str(error.value)

    record = jb.Experiment([0.0, 1.0], sensors={"x": jb.Position("mass", axis="z")})
    assert "'x'" in refused("NO_NOISE", record)
    with pytest.raises(jb.JaxbodyError, match="BAD_OPTION"):
        jb.Experiment([0.0, 1.0], sensors=record.sensors, noise=1.0, leave_out=0.5)
    refused("UNKNOWN_PATH", response_at([1.0]), ["spring.stifness"])
    with pytest.raises(jb.JaxbodyError, match="NO_DATA"):
        jb.MeasuredModes(noise={"frequency": 0.01})
    with pytest.raises(jb.JaxbodyError, match="NO_DATA"):
        jb.fitting.MeasuredStiffness("spring", [1.0])
    with pytest.raises(jb.JaxbodyError, match="expected_fit"):
        jb.fit(model, {"run": response_at([1.0])}, free=K_AND_C)


@pytest.mark.long
def test_what_has_no_derivatives_is_refused_and_no_further_measurement():
    """A body that hangs on one spring turns freely: its equilibrium has no derivatives."""
    spring = jb.Spring(
        ("body", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=9.0, free_length=0.5, damping=1.0
    )
    model = jb.Model(
        bodies={"body": jb.Body(2.0, [1, 1, 1])}, elements={"spring": spring}, gravity=[0, 0, -9.81]
    )
    hammer = jb.MeasuredResponse(
        [1.0, 2.0],
        inputs={"f": jb.PointForce("body", direction="x")},
        outputs={"x": jb.Position("body", axis="x")},
        noise=0.01,
    )
    run = jb.Experiment(
        np.linspace(0, 1, 21), sensors={"z": jb.Velocity("body", axis="z")}, noise=0.1
    )
    with pytest.raises(jb.JaxbodyError, match="NONFINITE_START") as error:
        jb.expected_fit(model, {"h": hammer}, free=K_AND_C)
    assert "derivatives of h.x/f" in str(error.value)
    fit = jb.expected_fit(model, {"run": run}, free=K_AND_C)
    with pytest.raises(jb.JaxbodyError, match="NONFINITE_START"):
        jb.choose({"h": hammer}, n=1, existing=fit)
    further = jb.fitting.further_measurements(fit)
    assert further.measurements[0] == "position of body along z in run"
    assert (further.after > 0).all() and not any(" by a " in x for x in further.measurements)


def test_what_is_not_determined_is_said():
    fit = jb.expected_fit(
        oscillator(0.1),
        {"test": jb.MeasuredModes(number=[0], noise={"frequency": 0.01})},
        free=["mass.mass", "spring.stiffness"],
    )
    assert int(fit.status) == jb.Status.NOT_IDENTIFIABLE
    assert np.isinf(list(fit.standard_errors.values())).all() and "up with" in fit.report()


@pytest.mark.long
def test_plans_of_delayed_sensors_and_poses():
    """Of a delayed record, samples from before the run tell nothing: the more of them, the less is
    known."""
    model, start = oscillator(0.05), jb.State(jnp.array([0.01]), jnp.zeros(1))

    def error(delay):
        sensors = {
            "x": jb.Position("mass", axis="z", delay=delay),
            "pose": jb.sensors.BodyPose("mass"),
        }
        run = jb.Experiment(
            jnp.linspace(0.0, 1.0, 101),
            sensors=sensors,
            initial=start,
            noise={"x": 1e-4, "pose": (1.0, 1.0)},
        )
        fit = jb.expected_fit(model, {"run": run}, free=["spring.stiffness"])
        return float(fit.standard_errors["spring.stiffness"])

    assert error(0.0) < error(0.1) < error(0.4)
