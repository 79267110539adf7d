"""Margins of loops: closed forms, python-control, the ends of the frequency axis, derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.vibration.control.margins import loop_margins


def third_order(k):
    """k/(s + 1)^3: real at w = root of 3, where it is -k/8."""
    A = jnp.array([[-1.0, 1, 0], [0, -1, 1], [0, 0, -1]])
    return A, jnp.array([0.0, 0, 1]), k * jnp.array([1.0, 0, 0])


@pytest.mark.nan
def test_closed_forms_of_three_equal_lags():
    k = 4.0
    margins = loop_margins(*third_order(k))
    crossing = np.sqrt(k ** (2 / 3) - 1)
    phase = np.pi - 3 * np.arctan(crossing)
    np.testing.assert_allclose(margins.gain, 8 / k, rtol=1e-13)
    np.testing.assert_allclose(margins.phase, phase, rtol=1e-13)
    np.testing.assert_allclose(margins.delay, phase / crossing, rtol=1e-13)
    expected = np.array([np.sqrt(3), np.nan, crossing, crossing]) / (2 * np.pi)
    np.testing.assert_allclose(margins.frequencies[:4], expected, rtol=1e-13)
    assert margins.lower_gain == 0 and "2 at 0.2757 Hz" in str(margins)


@pytest.mark.long
def test_derivatives_by_the_gain_of_the_loop():
    """Of the closed forms above; of the peak by central differences."""
    values = lambda k: jnp.stack(  # noqa: E731
        [(m := loop_margins(*third_order(k))).gain, m.phase, m.delay, m.sensitivity]
    )
    k = 4.0
    crossing, by_k = np.sqrt(k ** (2 / 3) - 1), k ** (-1 / 3) / 3
    by_k = by_k / crossing
    phase = np.pi - 3 * np.arctan(crossing)
    turn = -3 / (1 + crossing**2) * by_k
    slope = jax.jit(jax.jacfwd(values))(k)
    expected = [-8 / k**2, turn, turn / crossing - phase / crossing**2 * by_k]
    np.testing.assert_allclose(slope[:3], expected, rtol=1e-12)
    h, peak = 1e-4, jax.jit(values)
    np.testing.assert_allclose(slope[3], ((peak(k + h) - peak(k - h)) / (2 * h))[3], rtol=1e-7)
    np.testing.assert_allclose(jax.jit(jax.jacrev(values))(k), slope, rtol=1e-9)


@pytest.mark.nan
@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(i, marks=pytest.mark.long) for i in range(2, 8))]
)
def test_margins_are_those_of_python_control(seed):
    control = pytest.importorskip("control")
    np.random.seed(seed)  # noqa: NPY002  python-control draws with it
    system = control.rss(3 + seed % 3, 1, 1, strictly_proper=seed % 2 == 0)
    A, b, c, d = system.A, system.B[:, 0], 2 * system.C[0], 2 * system.D[0, 0]
    gains, phases, distances, w_gain, w_phase, w_distance = control.stability_margins(
        control.ss(A, b[:, None], c[None], d), returnall=True
    )
    with np.errstate(all="ignore"):
        margins = jax.jit(lambda *x: loop_margins(*x))(A, b, c, d)
    at = 2 * np.pi * np.asarray(margins.frequencies)

    def check(value, frequency, known, frequencies):
        """The finite ones; python-control looks at neither end of the axis of frequencies."""
        inside = np.isfinite(frequency) & (frequency > 0)
        if inside:
            i = np.argmin(np.abs(frequencies - frequency))
            np.testing.assert_allclose([value, frequency], [known[i], frequencies[i]], rtol=1e-9)
        return known[frequencies > 0]

    above, below, near = gains > 1, gains < 1, 1e-9
    least = check(margins.gain, at[0], gains[above], w_gain[above])
    assert (margins.gain <= least * (1 + near)).all()
    most = check(margins.lower_gain, at[1], gains[below], w_gain[below])
    assert (margins.lower_gain >= most * (1 - near)).all()
    least = check(margins.phase, at[2], np.deg2rad(np.abs(phases)), w_phase)
    assert (margins.phase <= least * (1 + near)).all()
    check(margins.sensitivity, at[4], 1 / distances, w_distance)
    assert len(phases) == 0 or np.isfinite(margins.phase)
    assert (margins.sensitivity >= (1 - 1e-9) / distances).all()


@pytest.mark.nan
def test_a_delay_of_the_margin_is_the_limit_of_stability():
    """An integrator k/s: w = k, delay pi/2/k; a phase margin alone cannot say it."""
    margins = loop_margins(jnp.zeros((1, 1)), jnp.ones(1), 3 * jnp.ones(1))
    np.testing.assert_allclose([margins.delay, margins.phase], [np.pi / 6, np.pi / 2], rtol=1e-13)


@pytest.mark.nan
def test_an_unstable_plant_has_a_lower_margin_at_rest():
    """2/(s - 1): stable for gains above 1/2, where L(0) = -1."""
    margins = loop_margins(jnp.ones((1, 1)), jnp.ones(1), 2 * jnp.ones(1))
    np.testing.assert_allclose(margins.lower_gain, 0.5, rtol=1e-14)
    assert margins.gain == np.inf and margins.frequencies[1] == 0


@pytest.mark.nan
@pytest.mark.parametrize("kp, kd", [(10.0, 5.0), (30.0, 12.0)])
def test_held_feedback_of_a_mass_up_to_its_limits(kp, kd):
    """REFERENCES3 5: stable if and only if kd < 2/T and kp T < 2 kd; both scale with the gain, so
    that the factor is 2/(T kd), of an oscillation between samples, at half the rate."""
    T = 0.1
    A, b = jnp.array([[1.0, T], [0, 1]]), jnp.array([T**2 / 2, T])
    margins = loop_margins(A, b, jnp.array([kp, kd]), every=T)
    np.testing.assert_allclose(margins.gain, 2 / T / kd, rtol=1e-12)
    np.testing.assert_allclose(margins.frequencies[0], 1 / (2 * T), rtol=1e-12)


@pytest.mark.nan
def test_an_unstable_loop_is_reported():
    with pytest.warns(jb.JaxbodyWarning, match="UNSTABLE"):
        margins = loop_margins(*third_order(10.0))
    np.testing.assert_allclose(margins.lower_gain, 0.8, rtol=1e-12)


def test_times_between_samples_are_positive():
    with pytest.raises(jb.JaxbodyError, match="BAD_NUMBER"):
        loop_margins(*third_order(1.0), every=-1.0)


def test_margins_of_many_loops_at_once():
    each = jax.jit(jax.vmap(lambda k: loop_margins(*third_order(k)).gain))(jnp.array([1.0, 4.0]))
    np.testing.assert_allclose(each, [8, 2], rtol=1e-13)
