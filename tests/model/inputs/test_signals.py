"""Signals and motions are one family: a motion as a signal, a signal of six numbers as a motion,
sums and delays of both."""

from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
from scipy.integrate import solve_ivp
from scipy.interpolate import CubicSpline

import jaxbody as jb
from jaxbody.core.errors import Problems
from jaxbody.geometry.frames import Pose
from jaxbody.model.inputs.signals import Delayed, Function, Samples, Sine, as_signal, kinks_of

TIMES = np.linspace(0, 1, 21)
UP = np.array([0, 0, 1.0])
KNOTS = np.array([-0.5, 0.1, 0.4, 0.9, 2.0])


def shaken(stiffness=300.0):
    return rigs.on_shaken_base(stiffness)


def heights(**options):
    return np.asarray(jb.simulate(shaken(), TIMES, rtol=1e-11, **options).poses["mass"].p[:, 2])


def test_a_motion_is_a_signal():
    """Its six numbers by the interface of signals, also in a sum with other signals, against
    the formula."""
    motion = jb.Harmonic(frequency=0.7, translation=[0.1, 0, 0.2], rotation=[0, 0.3, 0])
    assert isinstance(motion, jb.signals.Signal) and isinstance(
        jb.inputs.Road([0, 1], [0, 0], speed=1.0), jb.signals.Signal
    )
    amplitude = np.array([0.1, 0, 0.2, 0, 0.3, 0])
    t = jnp.array(0.37)
    np.testing.assert_allclose(
        as_signal(motion, "six", Problems(), (6,))(t),
        amplitude * np.cos(2 * np.pi * 0.7 * t),
        rtol=0,
        atol=1e-15,
    )
    both = Sine(amplitude=np.arange(6.0), frequency=2.0, phase=0.4) + motion
    exact = amplitude * np.cos(2 * np.pi * 0.7 * t) + np.arange(6) * np.cos(
        2 * np.pi * 2.0 * t + 0.4
    )
    np.testing.assert_allclose(both(t), exact, rtol=0, atol=2e-15)


F = 4 / (2 * np.pi)
MOTIONS = {  # u = 0.01 cos(4 t) along z, in five words
    "a motion": jb.Harmonic(frequency=F, translation=0.01 * UP),
    "a sine": Sine(amplitude=[0, 0, 0.01, 0, 0, 0], frequency=F),
    "a sum": Sine(amplitude=[0, 0, 0.004, 0, 0, 0], frequency=F)
    + jb.Harmonic(frequency=F, translation=0.006 * UP),
    "a delay": Delayed(Sine(amplitude=[0, 0, 0.01, 0, 0, 0], frequency=F, phase=1.2), 0.3),
    "a function": Function(lambda t: 0.01 * jnp.cos(4 * t) * jnp.array([0, 0, 1.0, 0, 0, 0])),
}


@pytest.mark.long
@pytest.mark.parametrize("case", MOTIONS)
def test_any_signal_of_six_numbers_moves_a_support(case):
    """x - 0.3 against the closed form: m x'' + c x' + k x = k u + c u', from rest at t = 0."""
    m, c, k, w = 2.0, 3.0, 300.0, 4.0
    steady = 0.01 * (k + 1j * w * c) / (k - m * w**2 + 1j * w * c)
    s = np.roots([m, c, k])
    # x = Re(steady e^iwt) + a e^s1 t + b e^s2 t, x(0) = x'(0) = 0
    a, b = np.linalg.solve(np.stack([np.ones(2), s]), [-steady.real, -(1j * w * steady).real])
    exact = (steady * np.exp(1j * w * TIMES)).real + (
        a * np.exp(s[0] * TIMES) + b * np.exp(s[1] * TIMES)
    ).real
    np.testing.assert_allclose(
        heights(motion={"base": MOTIONS[case]}) - 0.3, exact, rtol=0, atol=1e-9 * 0.01
    )


def test_a_signal_of_another_size_is_refused_as_a_motion():
    for motion in (Sine(amplitude=[0, 0, 0.1], frequency=1.0), Sine(amplitude=1.0, frequency=1.0)):
        with pytest.raises(
            jb.JaxbodyError, match=r"motion\['base'\]: returns shape .*6 numbers.*BAD_SHAPE"
        ):
            jb.simulate(shaken(), TIMES, motion={"base": motion})
    with pytest.raises(jb.JaxbodyError, match=r"Force.force: returns shape \(6,\).*BAD_SHAPE"):
        jb.Force("mass", force=jb.Harmonic(frequency=1.0))


@pytest.mark.long
def test_a_signal_moves_the_base_of_an_experiment_and_its_numbers_are_free_in_a_fit():
    sine = Sine(amplitude=[0, 0, 0.01, 0, 0, 0], frequency=0.6, phase=0.3)
    sensors = {"z": jb.Position("mass", axis=UP)}
    measured = jb.measure(jb.simulate(shaken(), TIMES, motion={"base": sine}), sensors)
    guess = Sine(amplitude=[0, 0, 0.01, 0, 0, 0], frequency=0.6, phase=0.1)
    run = jb.Experiment(TIMES, motion={"base": guess}, sensors=sensors, measured=measured)
    fit = jb.fit(shaken(), {"run": run}, free=["run.base.phase"])
    np.testing.assert_allclose(fit.estimates["run.base.phase"], 0.3, rtol=1e-6)


@pytest.mark.parametrize("noise, n, most", [(1e-2, 401, 1.1), (0.0, 2001, 0.2)])
def test_a_record_takes_a_step_a_sample_where_its_cubics_do_not_fit_smoothly_and_fewer_elsewhere(
    noise, n, most
):
    """m x'' = k (u - x) + c (u' - x') in steps that end at the samples, or not; against SciPy from
    sample to sample on the same cubics."""
    t = np.linspace(0, 1, n)
    u = 0.01 * np.sin(2 * np.pi * t) ** 2
    u = u + noise * np.ptp(u) * np.random.default_rng(3).normal(size=t.size)
    run = jb.simulate(
        shaken(), t, motion={"base": jb.Sampled(t, translation=np.outer(u, UP))}, rtol=1e-9
    )
    slopes = [
        (1, np.polynomial.Polynomial.fit(t[part], u[part], 3).deriv()(t[part][0]))
        for part in (slice(4), slice(-1, -5, -1))
    ]
    cubics, y, exact = CubicSpline(t, u, bc_type=slopes), np.array([0.3, 0.0]), [0.3]

    def rates(t, y):
        return [y[1], (300.0 * (cubics(t) + 0.3 - y[0]) + 3.0 * (cubics(t, 1) - y[1])) / 2.0]

    for a, b in pairwise(t):
        y = solve_ivp(rates, (a, b), y, method="DOP853", rtol=1e-12, atol=1e-15).y[:, -1]
        exact.append(y[0])
    np.testing.assert_allclose(run.poses["mass"].p[:, 2], exact, rtol=0, atol=1e-9)
    assert sum(int(n) for n in run.statistics.values()) <= most * n


def test_a_line_through_two_points_bends_at_its_ends_alone():
    """F(t) = 3 t on a free mass at rest: x = 3 t^3/(6 m); and a road of two points, a ramp."""
    model = jb.Model(
        bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=UP)},
    )
    push = {
        "push": jb.Force("mass", force=Samples([0.0, 1.0], np.outer([0, 3], UP), kind="linear"))
    }
    np.testing.assert_allclose(
        jb.simulate(model, TIMES, loads=push).poses["mass"].p[:, 2],
        TIMES**3 / 4,
        rtol=0,
        atol=1e-12,
    )
    np.testing.assert_array_equal(
        np.unique(jb.inputs.Road([1.0, 2.0], [0.0, 0.1], speed=2.0).kinks()), [0.5, 1.0]
    )


def test_sums_and_delays_of_signals_are_loads():
    """F(t) = 2 cos(3 t + 1) + t/2, half a second later, on a free mass that is at rest at t = 0: x
    from two integrals by hand."""
    model = jb.Model(
        bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=UP)},
    )
    signal = Delayed(
        Sine(amplitude=2 * UP, frequency=3 / (2 * np.pi), phase=1.0) + (lambda t: t / 2 * UP), 0.5
    )
    x = (
        jb.simulate(model, TIMES, loads={"push": jb.Force("mass", force=signal)}, rtol=1e-11)
        .poses["mass"]
        .p[:, 2]
    )
    p = 1.0 - 1.5
    sine = 2 / 9 * (np.cos(p) - np.cos(3 * TIMES + p)) - 2 / 3 * np.sin(p) * TIMES
    line = (TIMES - 0.5) ** 3 / 12 + 0.5**3 / 12 - TIMES * 0.5**2 / 4
    np.testing.assert_allclose(x, (sine + line) / 2, rtol=0, atol=1e-10)


def test_what_a_sum_and_a_delay_cover_and_where_they_bend(rng):
    y = rng.normal(size=(5, 3))
    record = Samples(KNOTS, y, kind="linear")
    later = Delayed(record, 0.25)
    total = later + Samples(KNOTS + 0.1, y) + Sine(amplitude=[1, 2, 3], frequency=1.0)
    assert later.covers() == (-0.25, 2.25) and total.covers() == (-0.25, 2.1)
    inner = KNOTS[1:-1] + 0.1  # where the cubics through random values do not fit smoothly
    np.testing.assert_array_equal(total.kinks(), [*np.sort([*KNOTS + 0.25, *inner]), np.inf])
    np.testing.assert_array_equal(
        kinks_of([record, later, Sine(amplitude=1.0, frequency=1.0)]),
        np.sort([*KNOTS, *(KNOTS + 0.25)]),
    )
    t = np.linspace(-0.2, 2.2, 33)
    line = np.stack([np.interp(t - 0.25, KNOTS, column) for column in y.T], 1)
    np.testing.assert_allclose(jax.vmap(later)(t), line, rtol=0, atol=1e-14)
    assert sum([later, record])(jnp.array(0.2)).shape == (3,)


def test_a_motion_sampled_and_a_signal_sampled_are_one_spline(rng):
    values = 0.1 * np.cumsum(rng.normal(size=(30, 3)), 0)
    times = np.cumsum(rng.uniform(0.01, 0.1, size=30))
    t = np.linspace(times[0], times[-1], 101)
    motion, signal = jb.Sampled(times, translation=values), Samples(times, values)
    np.testing.assert_array_equal(jax.jit(jax.vmap(motion))(t)[:, :3], jax.jit(jax.vmap(signal))(t))


def test_a_load_may_be_a_function_that_returns_a_list():
    now = Pose(UP, jnp.eye(3)).at_rest().at_time(jnp.array(2.0))
    assert jb.Force("mass", force=lambda t: [0.0, t, 1.0]).at_point(now)[0].tolist() == [
        0.0,
        2.0,
        1.0,
    ]


@pytest.mark.long
@pytest.mark.parametrize("part", ["amplitude", "frequency", "phase"])
def test_a_sum_with_a_delay_can_be_differentiated_in_its_numbers(part):
    """Against derivatives by hand of a cos(w (t - d) + p) + (t - d)."""
    a, f, p, d, t = 1.3, 0.7, 0.4, 0.2, 0.9
    signal = Delayed(Sine(amplitude=a, frequency=f, phase=p) + (lambda t: t), d)
    slope = jax.grad(lambda signal: signal(jnp.array(t)))(signal)
    angle, w = 2 * np.pi * f * (t - d) + p, 2 * np.pi * f
    exact = {
        "amplitude": np.cos(angle),
        "frequency": -a * 2 * np.pi * (t - d) * np.sin(angle),
        "phase": -a * np.sin(angle),
    }
    assert abs(getattr(slope.signal.terms[0], part) - exact[part]) < 1e-14
    assert abs(slope.delay - (a * w * np.sin(angle) - 1)) < 1e-13


def test_records_say_where_they_bend_and_where_they_begin_to_act():
    """Held values where they jump; lines where their slope changes; of a smooth record the
    beginning of a shock, with parts that become shorter towards it, and nothing of a sine."""
    t = np.arange(0.0, 4.096, 1e-3)

    def finite(kinks):
        return np.sort(np.asarray(kinks)[np.isfinite(kinks)])

    levels = np.where((t > 1.0005) & (t < 2.0005), 3.0, 0.0)
    np.testing.assert_allclose(
        finite(Samples(t, levels, kind="hold").kinks()), [1.001, 2.001], atol=1e-12
    )
    np.testing.assert_allclose(
        finite(Samples(t, levels, kind="linear").kinks()),
        [0, 1.0, 1.001, 2.0, 2.001, t[-1]],
        atol=1e-12,
    )
    s = (t - 3.0) / 0.02
    bump = np.where((s > 0) & (s < 1), 1 - np.cos(2 * np.pi * s), 0.0)
    for values in (bump, np.stack([np.sin(2 * np.pi * t), bump], 1)):
        marks = finite(Samples(t, values).kinks())
        parts = np.diff(np.concatenate([[0.0], marks, [t[-1]]]))
        around = (marks > 2.95) & (marks < 3.07)
        # no step reaches over the shock
        assert around.sum() >= 2 and np.diff(marks[around]).max() < 0.05
        assert len(marks) < 60 and parts.max() > 0.4
    assert len(finite(Samples(t, np.sin(2 * np.pi * t)).kinks())) == 0
