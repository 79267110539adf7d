"""Noise in records of imposed motions and loads is told apart from noise of what is measured and
from what a model lacks: records of a machine on a shaker by SciPy, and smoothed records in
closed form."""

import contextlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.signal
import shaken_machine
from scipy.integrate import solve_ivp

import jaxbody as jb
from jaxbody.fitting.noisy_inputs import _smooth

K, C, PHASES = 370e3, 550.0, np.array([0.3, 1.9, 4.0, 5.1, 2.2])
FREE = ["mount.stiffness", "mount.damping"]
TRUTH = {"mount.stiffness": K, "mount.damping": C}
UP = jnp.array([0.0, 0.0, 1.0])


def machine(stiffness=250e3, damping=300.0):
    mount = jb.Spring(
        ("machine", [0, 0, 0]),
        ("floor", [0, 0, 0]),
        stiffness=stiffness,
        damping=damping,
        free_length=0.1,
    )
    return jb.Model(
        bodies={"machine": jb.Body(mass=shaken_machine.MASS, inertia=[1, 1, 1])},
        supports={"floor": jb.Support(position=[0, 0, -0.1])},
        joints={"machine": jb.Guide("world", axis="z")},
        elements={"mount": mount},
    )


SENSORS = {"top": jb.Position("machine", axis="z"), "acc": jb.Acceleration("machine", axis="z")}


def fit_of(times, x, a, **run):
    run = {"initial": "rest"} | run
    experiment = jb.Experiment(times, sensors=SENSORS, measured={"top": x, "acc": a}, **run)
    return jb.fit(machine(), {"shaker": experiment}, free=FREE, progress=False)


def shaken(duration, rate, floor_noise, seed):
    times = np.arange(round(duration * rate) + 1) / rate
    return shaken_machine.record(times, K, C, PHASES, floor_noise, np.random.default_rng(seed)).T


def moved(times, b):
    return {"floor": jb.Sampled(times, translation=b[:, None] * UP)}


@pytest.mark.parametrize(("duration", "rate", "seed"), [(2, 100, 0), (4, 400, 1)])
def test_noise_of_the_floor_has_its_status_and_a_clean_floor_has_none(duration, rate, seed):
    t, b, x, a = shaken(duration, rate, 2e-5, seed)
    with pytest.warns(jb.JaxbodyWarning, match="NOISY_INPUT"):
        noisy = fit_of(t, x, a, motion=moved(t, b))
    assert noisy.status == jb.Status.NOISY_INPUT
    assert "'shaker' do not follow the fast part" in noisy.report()
    t, b, x, a = shaken(duration, rate, 0.0, seed)
    assert fit_of(t, x, a, motion=moved(t, b)).ok


def test_a_filtered_record_is_the_remedy():
    t, b, x, a = shaken(10, 400, 2e-5, 1)
    b = scipy.signal.sosfiltfilt(scipy.signal.butter(4, 40.0, fs=400, output="sos"), b)
    # noise that is as slow as the motion is left in the record
    with pytest.warns(jb.JaxbodyWarning, match="CORRELATED_RESIDUALS"):
        fit = fit_of(t, x, a, motion=moved(t, b))
    assert fit.status == jb.Status.OK
    assert all(low < TRUTH[path] < high for path, (low, high) in fit.intervals(0.99).items())


def test_noise_of_a_load_has_the_status_too():
    t, rng = np.arange(801) / 400, np.random.default_rng(2)

    def force(t):
        return 400 * np.sin(2 * np.pi * 7 * t) + 300 * np.sin(2 * np.pi * 12 * t)

    def rate(t, y):
        return [y[1], (force(t) - K * y[0] - C * y[1]) / shaken_machine.MASS]

    y = solve_ivp(rate, (0, t[-1]), [0.0, 0.0], method="DOP853", t_eval=t, rtol=1e-10, atol=1e-13).y
    x, a = y[0] + 3e-5 * rng.normal(size=len(t)), rate(t, y)[1] + 0.15 * rng.normal(size=len(t))
    for noise, status in ((0.0, jb.Status.OK), (30.0, jb.Status.NOISY_INPUT)):
        samples = jb.signals.Samples(t, (force(t) + noise * rng.normal(size=len(t)))[:, None] * UP)
        with (
            contextlib.nullcontext()
            if status == jb.Status.OK
            else pytest.warns(jb.JaxbodyWarning, match=status.name)
        ):
            fit = fit_of(t, x, a, loads={"push": jb.Force("machine", force=samples)}, initial=None)
        assert fit.status == status


def test_what_a_model_lacks_is_no_noise_of_the_floor(monkeypatch):
    """A spring that hardens, of which the fit has the linear part, on a floor that moves slowly for
    its sampling: sixth differences are small, and h is like r but 36 times smaller."""
    monkeypatch.setattr(shaken_machine, "OMEGA", 2 * np.pi * np.array([9.7]))
    monkeypatch.setattr(shaken_machine, "AMPLITUDES", np.array([8e-4]))
    t, rng = np.arange(501) / 100, np.random.default_rng(3)

    def rate(t, y):
        b, speed = shaken_machine.floor(t, PHASES[:1])
        e = y[0] - b
        return [y[1], (-K * e - 3e10 * e**3 - C * (y[1] - speed)) / shaken_machine.MASS]

    options = dict(method="DOP853", t_eval=t, rtol=1e-9, atol=1e-12, max_step=0.02)
    y = solve_ivp(rate, (0, t[-1]), [0.0, 0.0], **options).y
    x = y[0] + 3e-5 * rng.normal(size=len(t))
    a = [rate(now, z)[1] for now, z in zip(t, y.T, strict=True)] + 0.15 * rng.normal(size=len(t))
    floor = np.array([shaken_machine.floor(now, PHASES[:1])[0] for now in t])
    with pytest.warns(jb.JaxbodyWarning, match="CORRELATED_RESIDUALS"):
        fit = fit_of(t, x, a, motion=moved(t, floor))
    assert fit.status == jb.Status.OK


def test_smoothing_leaves_polynomials_and_takes_the_highest_frequency():
    t = np.arange(40) * 0.1
    slow, fast = (t / 4) ** 5 - t, 0.3 * (-1.0) ** np.arange(40)
    inner = slice(3, -3)
    smooth = _smooth(jb.Sampled(t, translation=(slow + fast)[:, None] * UP))
    np.testing.assert_allclose(smooth.values[inner, 2], slow[inner], atol=1e-13)
    assert _smooth(jb.signals.Samples(t, slow + fast, kind="hold")).curvatures is None
    # acceleration linear in time, of which sixth differences vanish: the motion is unchanged, from
    # its first position and speed on
    line = jb.Sampled.from_accelerations(
        t, translation=(2 - 0.5 * t)[:, None] * UP, initial_velocity=[0, 0, -3.0, 0, 0, 0]
    )
    instants = jnp.linspace(0, 3.9, 17)
    np.testing.assert_allclose(
        jax.vmap(_smooth(line))(instants), jax.vmap(line)(instants), atol=1e-12
    )
    np.testing.assert_allclose(
        jax.vmap(line)(instants)[:, 2], -3 * instants + instants**2 - instants**3 / 12, atol=1e-12
    )
    # a smoothed record of accelerations is the motion of the smoothed accelerations
    rough = jb.Sampled.from_accelerations(t, translation=(slow + fast)[:, None] * UP)
    smooth = _smooth(rough)
    accelerations = smooth.curvatures[:, 2, None] * UP
    again = jb.Sampled.from_accelerations(t, translation=accelerations)
    np.testing.assert_allclose(smooth.curvatures[inner, 2], slow[inner], atol=1e-13)
    np.testing.assert_allclose(smooth.values, again.values, rtol=1e-12, atol=1e-12)
