"""Fits of models whose elements have memory: from stiffness curves, and from a record with the
states of its start."""

import jax
import numpy as np
import pytest

import jaxbody as jb

FREQUENCIES = np.geomspace(0.5, 200.0, 25)


def model_of(k0=2e4, k1=6e4, tau=0.01):
    spring = jb.laws.Linear(k0) + jb.laws.Maxwell(stiffness=k1, relaxation_time=tau)
    return jb.Model(
        bodies={"m": jb.Body(mass=50.0)},
        joints={"m": jb.Guide("world", axis="x")},
        elements={
            "s": jb.SpringDamper(
                ("m", [0, 0, 0]), ("world", [1, 0, 0]), free_length=1.0, spring=spring
            )
        },
    )


FREE = ["s.spring.terms.0.coefficient", "s.spring.terms.1.*"]
TRUTH = {
    "s.spring.terms.0.coefficient": 2e4,
    "s.spring.terms.1.stiffness": 6e4,
    "s.spring.terms.1.relaxation_time": 0.01,
}


def close_to_truth(fit, rtol):
    for path, value in TRUTH.items():
        np.testing.assert_allclose(fit.estimates[path], value, rtol=rtol, err_msg=path)


def test_a_fit_of_a_stiffness_curve():
    exact = jb.vibration.dynamic_stiffness(model_of()["s"], FREQUENCIES)
    rng = np.random.default_rng(2)
    sheet = jb.fitting.MeasuredStiffness(
        "s",
        FREQUENCIES,
        magnitude=np.asarray(exact.magnitude) * (1 + 0.002 * rng.normal(size=25)),
        loss_angle=np.asarray(exact.loss_angle) + 0.002 * rng.normal(size=25),
        noise={"magnitude": 0.002 * np.asarray(exact.magnitude), "loss_angle": 0.002},
    )
    fit = jb.fit(model_of(2.6e4, 4.2e4, 0.013), {"sheet": sheet}, free=FREE)
    close_to_truth(fit, 5e-3)


@pytest.mark.long
def test_a_fit_of_a_record_with_its_initial_state():
    times = np.linspace(0, 0.5, 101)
    start = jb.State(np.array([0.01]), np.zeros(1), np.array([0.004]))
    sensors = {"x": jb.Position("m", axis="x")}
    measured = jb.measure(
        jb.simulate(model_of(), times, initial=start), sensors, noise=1e-6, key=jax.random.key(1)
    )
    guess = jb.State(np.array([0.01]), np.zeros(1), np.array([0.0]))
    run = jb.Experiment(times, initial=guess, sensors=sensors, measured=measured, noise=1e-6)
    fit = jb.fit(model_of(2.2e4, 5e4, 0.012), {"run": run}, free=[*FREE, "run.initial.z"])
    close_to_truth(fit, 0.02)
    np.testing.assert_allclose(fit.estimates["run.initial.z"], [0.004], rtol=0.02)


@pytest.mark.long
def test_beta_is_not_told_from_gamma_and_delta():
    """Only beta gamma and beta delta are in the equation: a fit of all three names them."""
    law = jb.laws.Linear(5e4) + jb.laws.BoucWen(alpha=5e4, beta=1e3, gamma=0.8, delta=-0.5)
    mount = jb.SpringDamper(
        ("m", [0, 0, 0]), ("world", [1, 0, 0]), free_length=1.0, spring=law, damper=10.0
    )
    model = jb.Model(
        bodies={"m": jb.Body(mass=2.0)},
        joints={"m": jb.Guide("world", axis="x")},
        elements={"mount": mount},
    )
    times, start = np.linspace(0, 0.1, 41), jb.State(np.array([1e-3]), np.zeros(1), np.zeros(1))
    sensors = {"x": jb.Position("m", axis="x")}
    measured = jb.measure(
        jb.simulate(model, times, initial=start), sensors, noise=1e-6, key=jax.random.key(3)
    )
    run = jb.Experiment(times, initial=start, sensors=sensors, measured=measured, noise=1e-6)
    free = [f"mount.spring.terms.1.{name}" for name in ("beta", "gamma", "delta")]
    with pytest.warns(jb.JaxbodyWarning, match="NOT_IDENTIFIABLE"):
        fit = jb.fit(model, {"run": run}, free=free)
    (direction,) = fit.unidentified
    assert all(path in direction for path in free)
    both = fit.estimates[free[0]] * np.array([fit.estimates[free[1]], fit.estimates[free[2]]])
    np.testing.assert_allclose(both, [800.0, -500.0], rtol=0.02)
