"""A hydraulic mount from its stiffness curves at two amplitudes: all six parameters, with the lower
chamber known."""

import numpy as np
import pytest

import jaxbody as jb

NAMES = (
    "stiffness",
    "damping",
    "upper_stiffness",
    "fluid_mass",
    "fluid_damping",
    "quadratic_damping",
)
TRUTH = np.array([2e5, 150.0, 3e5, 60.0, 800.0, 3e4])
FREQUENCIES = np.geomspace(2.0, 50.0, 16)
AMPLITUDES = {"small": 2e-4, "large": 1e-3}
NOISE = 0.01  # of the magnitude, and rad


def model_of(values):
    law = jb.laws.Hydraulic(**dict(zip(NAMES, values, strict=True)), lower_stiffness=2e4)
    mount = jb.SpringDamper(("m", [0, 0, 0]), ("world", [1, 0, 0]), free_length=1.0, spring=law)
    return jb.Model(
        bodies={"m": jb.Body(mass=100.0)},
        joints={"m": jb.Guide("world", axis="x")},
        elements={"mount": mount},
    )


def sheets(exact, seed):
    rng = np.random.default_rng(seed)
    return {
        name: jb.fitting.MeasuredStiffness(
            "mount",
            FREQUENCIES,
            amplitude=X,
            magnitude=np.asarray(exact[name].magnitude)
            * (1 + NOISE * rng.normal(size=FREQUENCIES.size)),
            loss_angle=np.asarray(exact[name].loss_angle)
            + NOISE * rng.normal(size=FREQUENCIES.size),
            noise={"magnitude": NOISE * np.asarray(exact[name].magnitude), "loss_angle": NOISE},
        )
        for name, X in AMPLITUDES.items()
    }


@pytest.fixture(scope="module")
def exact():
    element = model_of(TRUTH)["mount"]
    return {
        name: jb.vibration.dynamic_stiffness(element, FREQUENCIES, amplitude=X)
        for name, X in AMPLITUDES.items()
    }


@pytest.mark.long
def test_a_fit_recovers_six_parameters(exact):
    """From 30 % off; the truth within four standard errors of each."""
    guess = model_of(TRUTH * np.array([1.3, 0.7, 0.7, 1.3, 0.7, 1.3]))
    fit = jb.fit(guess, sheets(exact, 1), free=[f"mount.spring.{name}" for name in NAMES])
    assert int(fit.status) == 0
    for name, true in zip(NAMES, TRUTH, strict=True):
        path = f"mount.spring.{name}"
        assert abs(float(fit.estimates[path]) - true) < 4 * float(fit.standard_errors[path]), name
        assert float(fit.standard_errors[path]) < 0.1 * true, name


def test_one_curve_at_a_small_amplitude_cannot_tell_the_quadratic_loss():
    element = model_of(TRUTH)["mount"]
    K = jb.vibration.dynamic_stiffness(element, FREQUENCIES)
    sheet = jb.fitting.MeasuredStiffness(
        "mount",
        FREQUENCIES,
        magnitude=K.magnitude,
        loss_angle=K.loss_angle,
        noise={"magnitude": 1e3, "loss_angle": NOISE},
    )
    with pytest.warns(
        jb.JaxbodyWarning, match="mount.spring.quadratic_damping has no effect on the data"
    ):
        fit = jb.fit(
            model_of(TRUTH * np.array([1, 1, 1, 1.1, 1.1, 1.1])),
            {"sheet": sheet},
            free=[f"mount.spring.{name}" for name in NAMES[3:]],
        )
    assert len(fit.unidentified) == 1
    np.testing.assert_allclose(fit.estimates["mount.spring.fluid_mass"], 60.0, rtol=1e-6)
