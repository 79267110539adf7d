"""Profiles, validation on held-out runs, bands and their plots: a mass released on two springs,
whose motion has a closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize
from scipy.stats import t as student

import jaxbody as jb
from jaxbody import plots

SIGMA, X0, MASS = 0.02, 0.2, 2.0
TIMES = np.linspace(0, 1.2, 61)
FREE = ("spring.stiffness", "spring.damping")
TRUTH = np.array([50.0, 1.5])


def motion(k, c, times=TIMES):
    """Underdamped: x'' = -k x/m - c x'/m."""
    d = c / (2 * MASS)
    w = np.sqrt(k / MASS - d**2)
    return X0 * np.exp(-d * times) * (np.cos(w * times) + d / w * np.sin(w * times))


def oscillator(values=(60.0, 1.0)):
    return jb.Model(
        bodies={"mass": jb.Body(mass=MASS, inertia=[1, 1, 1], position=[1, 0, 0])},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
        elements={
            "spring": jb.Spring(
                ("mass", [0, 0, 0]),
                ("world", [0, 0, 0]),
                stiffness=values[0],
                free_length=1.0,
                damping=values[1],
            )
        },
    )


def run(x, times=TIMES):
    initial = jb.State(jnp.array([X0]), jnp.array([0.0]))
    sensors = {"x": jb.Position("mass", axis=[1, 0, 0])}
    return {"run": jb.Experiment(times, initial=initial, sensors=sensors, measured={"x": 1 + x})}


def fit(experiments, **options):
    return jb.fit(oscillator(), experiments, free=FREE, max_steps=2000, **options)


@pytest.fixture(scope="module")
def record():
    return motion(*TRUTH) + SIGMA * np.random.default_rng(6).normal(size=len(TIMES))


@pytest.fixture(scope="module")
def result(record):
    return fit(run(record))


def least(record, fixed):
    """The least sum of squares with the damping fixed, by SciPy."""
    squares = lambda k: np.sum((motion(k, fixed) - record) ** 2)  # noqa: E731
    return scipy.optimize.minimize_scalar(
        squares, bounds=(20, 100), method="bounded", options={"xatol": 1e-9}
    ).fun


@pytest.fixture(scope="module")
def profile(result):
    return jb.fitting.profile_likelihood(result, "spring.damping")


def test_a_profile_ends_where_the_sum_of_squares_has_risen_enough(result, record, profile):
    """SciPy's root of S(c) = S (1 + t^2/(n - p)), on both sides; the damping is known badly and its
    interval skewed."""
    S = np.sum((motion(*(float(x) for x in result.estimates.values())) - record) ** 2)
    limit = S * (1 + student.ppf(0.975, len(TIMES) - 2) ** 2 / (len(TIMES) - 2))
    best = float(result.estimates["spring.damping"])
    expected = [
        scipy.optimize.brentq(lambda c: least(record, c) - limit, *ends)
        for ends in ((1e-9, best), (best, 6.0))
    ]
    print(profile.interval, expected, result.intervals()["spring.damping"])
    np.testing.assert_allclose(profile.interval, expected, rtol=2e-3)  # of the cubic between points
    assert profile.ok and profile.tau[0] < 0 < profile.tau[-1] and (np.diff(profile.tau) > 0).all()
    low, high = result.intervals()["spring.damping"]
    assert 0 < low < best < high and abs(float(low) / expected[0] - 1) > 0.01
    assert f"interval {profile.interval[0]:.6g} to" in str(profile)


def test_a_profile_at_a_bound_has_one_side(record):
    with pytest.warns(jb.JaxbodyWarning, match="AT_BOUND"):
        held = fit(run(record), bounds={"spring.stiffness": (54, 80)})
    side = jb.fitting.profile_likelihood(held, "spring.stiffness")
    low, high = held.intervals()["spring.stiffness"]
    print(side.interval, low, high)
    assert side.interval[0] == pytest.approx(54) == float(low) and float(high) == pytest.approx(
        side.interval[1], rel=0.01
    )
    assert "at its bound" in str(held) and np.isinf(held.standard_errors["spring.stiffness"])


@pytest.mark.long
def test_of_a_robust_loss_the_profile_is_as_wide_as_the_standard_error(record):
    spoiled = record.copy()
    spoiled[::13] += 15 * SIGMA
    for loss in ("soft_l1", "cauchy"):
        robust = fit(run(spoiled), loss=loss)
        ends, (low, high) = (
            jb.fitting.profile_likelihood(robust, "spring.stiffness").interval,
            robust.intervals()["spring.stiffness"],
        )
        print(ends, low, high)
        np.testing.assert_allclose(ends[1] - ends[0], high - low, rtol=0.1)


def test_what_has_no_profile_is_reported(result):
    for arguments, code in (
        (("spring.stifness",), "UNKNOWN_PATH"),
        (("spring.stiffness", 1.5), "BAD_LEVEL"),
    ):
        with pytest.raises(jb.JaxbodyError) as error:
            jb.fitting.profile_likelihood(
                result, arguments[0], **({"level": arguments[1]} if arguments[1:] else {})
            )
        assert error.value.code == code


def test_validation_on_a_run_held_out(result):
    times = np.linspace(0, 2.4, 61)  # as many: one program serves all
    noise = SIGMA * np.random.default_rng(8).normal(size=len(times))
    later, again = (
        run(x, t)["run"]
        for x, t in ((motion(*TRUTH, times) + noise, times), (motion(*TRUTH), TIMES))
    )
    # not in the order of the alphabet
    message = jb.validate(result, {"later": later, "again": again})
    estimates = [float(x) for x in result.estimates.values()]
    measured = 1 + motion(*TRUTH, times) + noise
    expected = np.sqrt(np.mean((1 + motion(*estimates, times) - measured) ** 2)) / np.std(measured)
    assert message.nrmse["later.x"] == pytest.approx(expected, rel=1e-6) and message.ok
    assert message.nrmse["again.x"] < 0.1 and message.excess["later.x"] == pytest.approx(
        message.rms["later.x"] / float(result.noise["run"]["x"])
    )
    assert message.whiteness["later.x"].lags > 5 and f"{100 * (1 - expected):.2f} %" in str(message)


def test_a_validation_is_drawn_over_time(result):
    """What was measured, what the fitted model predicts there, and their difference below."""
    again = run(motion(*TRUTH) + SIGMA * np.random.default_rng(10).normal(size=len(TIMES)))["run"]
    validation = jb.validate(result, {"again": again})
    above, below = validation.plot().figure.axes
    measured, predicted = (line.get_ydata() for line in above.lines)
    np.testing.assert_array_equal(measured, again.measured["x"])
    np.testing.assert_allclose(
        predicted, 1 + motion(*map(float, result.estimates.values())), atol=1e-6
    )  # of the integration
    np.testing.assert_allclose(below.lines[0].get_ydata(), measured - predicted, atol=1e-15)
    assert (above.get_ylabel(), below.get_xlabel(), below.get_ylabel()) == (
        "x [m]",
        "time [s]",
        "residual [m]",
    )
    assert above.get_title() == f"again, x: fit {100 * (1 - validation.nrmse['again.x']):.1f} %"
    assert {text.get_text() for text in above.get_legend().texts} == {"measured", "predicted"}
    with pytest.raises(jb.JaxbodyError, match="'y' is unknown"):
        validation.plot(sensor="y")


@pytest.mark.long
def test_a_pose_is_validated_component_by_component(result):
    """Of a sensor with two units; small rotations were read with noise. Each unit has a panel of
    its own."""
    noise = np.random.default_rng(9).normal(size=(len(TIMES), 6)) * np.repeat([SIGMA, 1e-3], 3)
    turn = np.concatenate([np.ones((len(TIMES), 1)), noise[:, 3:] / 2], axis=1)
    position = np.array([1.0, 0, 0]) + motion(*TRUTH)[:, None] * [1, 0, 0] + noise[:, :3]
    measured = {
        "pose": np.concatenate([position, turn / np.linalg.norm(turn, axis=1)[:, None]], axis=1)
    }
    start = jb.State(jnp.array([X0]), jnp.array([0.0]))
    posed = jb.Experiment(
        TIMES, initial=start, sensors={"pose": jb.sensors.BodyPose("mass")}, measured=measured
    )
    message = jb.validate(result, {"posed": posed})
    along = 1 + motion(*map(float, result.estimates.values())) - position[:, 0]
    for channel, expected in (
        ("posed.pose[0]", along),
        ("posed.pose[1]", noise[:, 1]),
        ("posed.pose[5]", noise[:, 5]),
    ):
        assert message.rms[channel] == pytest.approx(np.sqrt(np.mean(expected**2)), rel=1e-4), (
            channel
        )
    titles = [title for ax in message.plot().figure.axes if (title := ax.get_title())]
    assert [title.partition(":")[0] for title in titles] == [
        "posed, pose position",
        "posed, pose orientation",
    ]
    assert titles[0].count("%") == titles[1].count("%") == 3


@pytest.mark.nan
def test_a_run_that_cannot_be_simulated_has_a_status(result):
    """A run so long that it needs more steps than the fit was allowed."""
    with pytest.warns(jb.JaxbodyWarning, match="NONFINITE"):
        message = jb.validate(
            result, {"long": run(motion(*TRUTH), np.linspace(0, 4000, len(TIMES)))["run"]}
        )
    assert message.status == jb.Status.NONFINITE and "long: MAX_STEPS" in message.report()
    with pytest.raises(jb.JaxbodyError, match="NO_DATA"):
        jb.validate(result, {})


def frequency(model):
    return jnp.sqrt(model["spring"].stiffness / MASS) / (2 * jnp.pi) * jnp.array([1.0, 2.0])


def test_bands_are_the_delta_method_and_draws_agree(result):
    k, error = (float(x["spring.stiffness"]) for x in (result.estimates, result.standard_errors))
    message = jb.confidence_bands(result, frequency)
    f = np.sqrt(k / MASS) / (2 * np.pi) * np.array([1.0, 2.0])
    np.testing.assert_allclose(message.value, f, rtol=1e-12)
    np.testing.assert_allclose(message.standard_error, f * error / (2 * k), rtol=1e-9)
    np.testing.assert_allclose(
        message.upper - f, student.ppf(0.975, len(TIMES) - 2) * message.standard_error, rtol=1e-6
    )
    drawn = jb.confidence_bands(result, frequency, samples=2000, key=jax.random.key(1))
    np.testing.assert_allclose(
        drawn.standard_error, message.standard_error, rtol=4 / np.sqrt(2 * 2000)
    )


@pytest.mark.nan
def test_bands_of_what_has_none_are_reported(result):
    with pytest.raises(jb.JaxbodyError, match="WRONG_KIND"):
        jb.confidence_bands(result, lambda model: 1j * frequency(model))
    with pytest.raises(jb.JaxbodyError, match="NO_KEY"):
        jb.confidence_bands(result, frequency, samples=10)
    with pytest.warns(jb.JaxbodyWarning, match="NONFINITE"):
        message = jb.confidence_bands(
            result, lambda model: jnp.sqrt(model["spring"].stiffness * 0.0)
        )
    assert np.isinf(message.standard_error)


@pytest.mark.long
def test_draws_need_data_that_determine_all_parameters(record):
    """Mass and stiffness of a free oscillation: only their ratio is known."""
    with pytest.warns(jb.JaxbodyWarning, match="NOT_IDENTIFIABLE"):
        result = jb.fit(oscillator(), run(record), free=(*FREE, "mass.mass"), max_steps=2000)
    with pytest.raises(jb.JaxbodyError, match=r"not determined.*UNDETERMINED"):
        jb.confidence_bands(result, frequency, samples=10, key=jax.random.key(0))


def test_intervals_and_notes_print(result):
    low, high = result.intervals()["spring.stiffness"]
    assert (
        f"{low:.6g} to {high:.6g}" in str(result)
        and "noise white" in str(result)
        and "95 % interval" in str(result)
    )
    with pytest.raises(jb.JaxbodyError, match="BAD_LEVEL"):
        result.intervals(95)


@pytest.mark.long
def test_missing_samples_and_the_order_of_runs_change_nothing(record):
    """Against a fit to the samples that there are, and to the same two runs, one with five times
    the noise, in the other order."""
    gaps = np.where(np.arange(len(TIMES)) % 3 == 2, np.nan, record)
    with pytest.warns(jb.JaxbodyWarning, match="MISSING"):
        masked = fit(run(gaps))
    there = np.isfinite(gaps)
    alone = fit(run(record[there], TIMES[there]))
    loud = motion(*TRUTH) + 5 * SIGMA * np.random.default_rng(1).normal(size=len(TIMES))
    both = {"b": run(record)["run"], "a": run(loud)["run"]}
    one, other = fit(both), fit(dict(reversed(both.items())))
    for result, expected in ((masked, alone), (one, other)):
        for path in FREE:
            np.testing.assert_allclose(result.estimates[path], expected.estimates[path], rtol=1e-6)
            np.testing.assert_allclose(
                result.standard_errors[path], expected.standard_errors[path], rtol=1e-4
            )
    assert masked.uncertainty.samples == there.sum()


def test_pictures_of_a_fit_show_its_numbers(result, record, profile):
    axes = plots.plot_fit(result)
    below = axes.figure.axes[1]
    pale = below.patches[0].get_extents().transformed(below.transData.inverted())
    np.testing.assert_allclose(pale.height, 2 * 1.96 * float(result.noise["run"]["x"]), rtol=1e-6)
    heat = plots.plot_correlations(result)
    rho = result.covariance[0, 1] / np.sqrt(result.covariance[0, 0] * result.covariance[1, 1])
    np.testing.assert_allclose(np.asarray(heat.images[0].get_array())[0, 1], rho)
    r = np.asarray(result.predicted["run"]["x"]) - 1 - record
    bars = plots.plot_autocorrelation(result)
    np.testing.assert_allclose(bars.lines[0].get_ydata()[0], r[1:] @ r[:-1] / (r @ r), rtol=1e-6)
    line = plots.plot_profile_likelihood(profile).lines[0]
    np.testing.assert_array_equal(line.get_xdata(), profile.values)
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_NAME"):
        plots.plot_autocorrelation(result, sensor="y")


@pytest.mark.long
def test_few_degrees_of_freedom_are_printed_where_they_widen_intervals(result, record):
    """Of white noise they are samples less parameters, 8 - 2: t is 25 % more than the normal
    distribution's 1.96; of 61 samples nothing is said."""
    few = fit(run(record[::8], TIMES[::8]))
    assert len(TIMES[::8]) == 8 and not any(few.uncertainty.orders.values())
    k, error = (
        float(few.estimates["spring.stiffness"]),
        float(few.standard_errors["spring.stiffness"]),
    )
    far = student.ppf(0.975, 6) * error / k
    np.testing.assert_allclose(
        few.intervals()["spring.stiffness"], [k * np.exp(-far), k * np.exp(far)], rtol=1e-6
    )
    for freedom in few.degrees_of_freedom.values():
        np.testing.assert_allclose(freedom, 6, rtol=1e-9)
    text = (
        "intervals use Student's t with 6 degrees of freedom, which makes them "
        f"{student.ppf(0.975, 6) / 1.959964:.2g} times wider"
    )
    assert text in str(few) and "degrees of freedom" in repr(few).splitlines()[1]
    with np.errstate(all="ignore"):
        side = jb.fitting.profile_likelihood(few, "spring.stiffness")
    assert (
        side.degrees_of_freedom == pytest.approx(6)
        and side.limit == pytest.approx(student.ppf(0.975, 6))
        and text in str(side)
    )
    band = jb.confidence_bands(few, lambda model: model["spring"].stiffness)
    assert band.degrees_of_freedom == pytest.approx(6) and text in str(band)
    np.testing.assert_allclose(result.degrees_of_freedom["spring.damping"], 59, rtol=1e-9)
    assert "freedom" not in str(result) + str(
        jb.confidence_bands(result, lambda model: model["spring"].stiffness)
    )
