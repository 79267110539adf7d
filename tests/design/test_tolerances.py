"""Tolerances, robust designs and sensitivities against polynomials with known moments and against
differences; their plots."""

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import pytest
import scipy.stats
from rigs import hung

import jaxbody as jb
from jaxbody import plots

K0, C0, SK, SC = 50.0, 1.0, 2.0, 0.1


@pytest.fixture(scope="module")
def weight():
    return hung(
        jb.Body(mass=2.0, inertia=[1, 1, 1]),
        to=(0, 0, 1),
        stiffness=K0,
        free_length=1.0,
        damping=C0,
    )


def quadratic(model):
    k, c = model["spring"].stiffness - K0, model["spring"].damping - C0
    return {
        "f": 3 + 2 * k + 5 * c + 0.5 * k**2 + 4 * k * c - 6 * c**2,
        "pair": jnp.stack([k, 10 * c]),
    }


@pytest.fixture(scope="module")
def result(weight):
    return jb.tolerances(
        weight,
        quadratic,
        {"spring.stiffness": SK, "spring.damping": SC},
        samples=20_000,
        key=jax.random.key(1),
    )


def test_the_moments_of_a_quadratic_are_exact_and_those_of_its_samples(result):
    """Second order is exact for it; samples are within four standard errors."""
    mean = 3 + 0.5 * SK**2 - 6 * SC**2
    first = np.hypot(2 * SK, 5 * SC)
    second = np.sqrt(first**2 + (1.0 * SK**2) ** 2 / 2 + (4 * SK * SC) ** 2 + (12 * SC**2) ** 2 / 2)
    assert (
        result.ok
        and result.quantities == ("f", "pair[0]", "pair[1]")
        and result.parameters == ("spring.stiffness", "spring.damping")
    )
    np.testing.assert_allclose(
        [result.nominal[0], result.first[0], result.mean[0], result.deviation[0]],
        [3.0, first, mean, second],
        rtol=1e-12,
    )
    np.testing.assert_allclose(result.first[1:], [SK, 10 * SC], rtol=1e-12)
    n = len(result.samples)
    assert abs(result.sampled_mean[0] - mean) < 4 * second / n**0.5
    assert abs(result.sampled_deviation[0] / second - 1) < 4 * np.sqrt(0.5 / n) * 2
    np.testing.assert_allclose(
        result.shares[0], [(2 * SK) ** 2 / first**2, (5 * SC) ** 2 / first**2], rtol=1e-12
    )
    assert "spring.stiffness 98 %" in str(result) and "20000 samples; ok" in str(result)


@pytest.mark.long
def test_the_second_order_of_a_frequency_is_that_of_its_closed_form():
    """f = sqrt(k/m)/(2 pi) by the library's eigenvalues; k and m scatter by a = 8 % and b = 5 %:
    mean f (1 - a^2/8 + 3 b^2/8), variance f^2 (a^2/4 + b^2/4 + a^4/32 + 9 b^4/32 + a^2 b^2/16).
    Samples are within four standard errors."""
    k, m, a, b = 50.0, 2.0, 0.08, 0.05
    spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=k, free_length=1.0)
    up = {"mass": jb.Guide("world", axis=[0, 0, 1])}
    model = jb.Model(
        bodies={"mass": jb.Body(mass=m, inertia=[1, 1, 1])}, joints=up, elements={"spring": spring}
    )
    scatter = {"spring.stiffness": a * k, "mass.mass": b * m}

    def frequency(model):
        return jb.modes(jb.linearize(model, model.reference)).frequency[0]

    result = jb.tolerances(model, frequency, scatter, samples=4000)
    f, n = np.sqrt(k / m) / (2 * np.pi), 4000
    mean = f * (1 - a**2 / 8 + 3 * b**2 / 8)
    deviation = f * np.sqrt(a**2 / 4 + b**2 / 4 + a**4 / 32 + 9 * b**4 / 32 + a**2 * b**2 / 16)
    np.testing.assert_allclose([result.mean[0], result.deviation[0]], [mean, deviation], rtol=1e-12)
    assert abs(result.sampled_mean[0] - mean) < 4 * deviation / n**0.5
    assert abs(result.sampled_deviation[0] / deviation - 1) < 4 * np.sqrt(0.5 / n)
    high = jb.design.robust(frequency, scatter)(model)["objective high"]
    np.testing.assert_allclose(high, mean + 3 * deviation, rtol=1e-12)


def test_a_curved_quantity_has_exact_second_derivatives(weight):
    """q = exp(r k) c: f_kk = r^2 q, f_kc = r q/c; third and higher ones, which differences would
    bring in, are left out."""
    r = 0.3

    def curved(model):
        return jnp.exp(r * (model["spring"].stiffness - K0)) * model["spring"].damping

    result = jb.tolerances(
        weight, curved, {"spring.stiffness": SK, "spring.damping": SC}, samples=2
    )
    np.testing.assert_allclose(result.mean[0], C0 * (1 + (r * SK) ** 2 / 2), rtol=1e-13)
    variance = (C0 * r * SK) ** 2 + SC**2 + (C0 * (r * SK) ** 2) ** 2 / 2 + (r * SK * SC) ** 2
    np.testing.assert_allclose(result.deviation[0], np.sqrt(variance), rtol=1e-13)


@pytest.mark.nan
def test_samples_without_numbers_are_reported(weight):
    with pytest.warns(jb.JaxbodyWarning, match=r"NONFINITE: .*; \d+ of 200 samples are not finite"):
        result = jb.tolerances(
            weight,
            lambda model: jnp.sqrt(model["spring"].damping - 0.9),
            {"spring.damping": 0.1},
            samples=200,
        )
    assert np.isfinite(result.sampled_mean).all() and np.isfinite(result.first).all()


def test_a_design_for_the_mean_plus_three_sigma(weight):
    """(x - 1)^2 + p x^2 with p of zero mean and deviation s is least at x = 1/(1 + 3 s),
    not at 1."""
    s = 0.1

    def cost(model):
        x, p = model["spring"].stiffness / K0, model["spring"].damping - C0
        return {"cost": (x - 1) ** 2 + p * x**2}

    made = jb.design.robust(cost, {"spring.damping": s})
    free = dict(free="spring.stiffness", bounds={"spring.stiffness": (10.0, 200.0)})
    result = jb.tune(weight, made, minimize="cost high", **free)
    np.testing.assert_allclose(result.values["spring.stiffness"], K0 / (1 + 3 * s), rtol=1e-5)
    np.testing.assert_allclose(result.after["cost high"], 3 * s / (1 + 3 * s), rtol=1e-9)
    softer = jb.replace(weight, {"spring.stiffness": 40.0})
    plain = jb.tune(softer, made, minimize="cost", limits={"cost high": (None, 0.25)}, **free)
    x = plain.after["cost high"]  # the limit lies between the two designs
    assert (
        float(x) == pytest.approx(0.25, rel=1e-6)
        and K0 / 1.3 < float(plain.values["spring.stiffness"]) < K0
    )


BAD = {
    "UNKNOWN_PATH": ({"sprong.damping": 1.0}, "Did you mean spring.damping"),
    "BAD_SCATTER": ({"spring.damping": -1.0}, "standard deviations"),
    "LISTED_TWICE": ({"*.damping": 1.0, "spring.damping": 1.0}, "spring.damping twice"),
}


@pytest.mark.parametrize("code", BAD)
def test_bad_scatter_is_reported(weight, code):
    scatter, words = BAD[code]
    for call in (
        lambda: jb.tolerances(weight, quadratic, scatter),
        lambda: jb.design.robust(quadratic, scatter)(weight),
    ):
        with pytest.raises(jb.JaxbodyError, match=words) as caught:
            call()
        assert caught.value.code == code


def modal(model):
    lin = jb.linearize(model, model.reference)
    return {"frequency": jb.modes(lin).frequency}


@pytest.fixture(scope="module")
def ranked():
    car = jb.presets.quarter_car(damping=1500.0)
    return car, jb.design.sensitivities(car, modal, free=["*.stiffness", "*.mass"], change=0.2)


@pytest.mark.long
def test_sensitivities_are_differences_and_ranked(ranked):
    """Slopes to differences; both ends exactly; the body's mode follows its spring and mass, the
    wheel's its own."""
    car, result = ranked
    frequency = jax.jit(lambda model: modal(model)["frequency"])
    for i, path in enumerate(result.parameters):
        value = float(jb.parameter_paths(car)[path])
        at = lambda x, path=path: np.asarray(frequency(jb.replace(car, {path: x})))  # noqa: E731
        np.testing.assert_allclose(
            result.slopes[:, i],
            (at(value * 1.0001) - at(value * 0.9999)) / (2e-4 * value),
            rtol=1e-6,
        )
        np.testing.assert_allclose(result.low[:, i], at(0.8 * value), rtol=1e-12)
        np.testing.assert_allclose(result.high[:, i], at(1.2 * value), rtol=1e-12)
    assert result.ranked("frequency[0]")[:2] == ("body.mass", "suspension.stiffness")
    assert result.ranked("frequency[1]")[:2] == ("wheel.mass", "tyre.stiffness")
    assert "20 % less" in str(result)
    with pytest.raises(jb.JaxbodyError, match="Did you mean"):
        result.ranked("frequency")
    with pytest.raises(jb.JaxbodyError, match="BAD_CHANGE"):
        jb.design.sensitivities(car, modal, free="*.mass", change=1.5)


@pytest.mark.long
def test_a_tornado_and_a_histogram_show_what_was_found(ranked, result, weight):
    _, sensitive = ranked
    ax = plots.plot_tornado(sensitive, "frequency[1]")
    names = [label.get_text() for label in ax.get_yticklabels()]
    assert names == list(sensitive.ranked("frequency[1]")) and ax.get_xlabel() == "frequency[1]"
    reached = sorted(
        bar.get_x() + bar.get_width() for bar in ax.patches if abs(bar.get_width()) > 0
    )
    np.testing.assert_allclose(
        [reached[0], reached[-1]],
        [
            min(sensitive.low[1].min(), sensitive.high[1].min()),
            max(sensitive.low[1].max(), sensitive.high[1].max()),
        ],
        rtol=1e-12,
    )
    below = plots.plot_tolerances(result)
    heights = np.array([[bar.get_height(), bar.get_width()] for bar in below.patches])
    np.testing.assert_allclose(np.sum(heights.prod(1)), 1.0, rtol=1e-12)
    for line, mean, deviation in zip(
        below.lines[:2],
        (result.nominal, result.mean),
        (result.first, result.deviation),
        strict=True,
    ):
        x = line.get_xdata()
        shown = scipy.stats.norm(float(mean[0]), float(deviation[0])).cdf(x[[-1, 0]])
        np.testing.assert_allclose(
            np.trapezoid(line.get_ydata(), x), shown[0] - shown[1], rtol=1e-3
        )
    tuned = jb.tune(
        weight, lambda model: (model["spring"].stiffness - 40.0) ** 2, free="spring.stiffness"
    )
    course = plots.plot_tuning(tuned)
    np.testing.assert_allclose(course.lines[0].get_ydata(), tuned.history[:, 0])
    plt.close("all")
