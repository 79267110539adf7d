"""Pulses: their shapes, and motions whose acceleration they are; a simulation ends its steps where
they are not smooth."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import quad

import jaxbody as jb

T, A, START = 0.4, 3.0, 0.1
PULSES = {
    "half sine": (jb.inputs.HalfSine(A, T, START), lambda u: np.sin(np.pi * u)),
    "sawtooth": (jb.inputs.Sawtooth(A, T, START), lambda u: u),
    "triangle": (jb.inputs.Triangle(A, T, START), lambda u: 1 - abs(2 * u - 1)),
    "trapezoid": (
        jb.inputs.Trapezoid(A, T, START, rise=0.1, fall=0.2),
        lambda u: min(u / 0.25, 1.0, (1 - u) / 0.5),
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("name", PULSES)
def test_a_motion_has_the_acceleration_of_its_pulse(name):
    pulse, shape = PULSES[name]
    motion = pulse.motion([0, 0, 2.0])
    rate = jax.jacfwd(motion)
    second = jax.jit(jax.vmap(jax.jacfwd(rate)))
    times = np.array([0.0, 0.1 - 1e-9, 0.13, 0.27, 0.31, 0.4999, 0.5, 0.7, 30.0])
    exact = np.array([A * shape((t - START) / T) if START <= t < START + T else 0.0 for t in times])
    np.testing.assert_allclose(jax.vmap(pulse)(times), exact, atol=1e-14)
    np.testing.assert_allclose(second(times)[:, 2], exact, atol=1e-13)
    for t in (0.2, 0.5, 0.9):
        corners = [float(x) for x in pulse.kinks()]
        velocity = quad(
            lambda x: A * shape((x - START) / T), START, min(t, START + T), points=corners
        )[0]
        moved = quad(
            lambda x, t=t: (t - x) * A * shape((x - START) / T),
            START,
            min(t, START + T),
            points=corners,
        )[0]
        np.testing.assert_allclose(
            [motion(jnp.array(t))[2], rate(jnp.array(t))[2]], [moved, velocity], rtol=1e-12
        )


def test_half_sine_of_15_g_changes_the_velocity_by_a_meter_a_second():
    """2 A T/pi, and the free fall without rebound v^2/2g; IEC 60068-2-27 prints 1.0 m/s."""
    motion = jb.inputs.HalfSine(15 * 9.80665, 0.011).motion("z")
    v = float(jax.jacfwd(motion)(jnp.array(0.011))[2])
    np.testing.assert_allclose([v, v**2 / (2 * 9.80665)], [1.0301127, 0.0541027], rtol=1e-6)


def test_samples_keep_the_impulse_of_a_pulse_that_jumps():
    times, values = jb.inputs.Sawtooth(A, T, START).samples(count=50, lengths=3)
    assert times.shape == (151,) and float(times[0]) == START and float(values[50]) == A / 2
    np.testing.assert_allclose(np.trapezoid(values, times), A * T / 2, rtol=1e-12)


@pytest.mark.long
def test_a_simulation_follows_a_pulse_that_jumps():
    """An undamped mass on a sawtooth, against the closed form during and after it."""
    m, k = 2.0, 800.0
    w = np.sqrt(k / m)
    model = jb.Model(
        bodies={"mass": jb.Body(m, [1, 1, 1], position=[0, 0, 1])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("world", axis="z")},
        elements={
            "spring": jb.Spring(
                ("mass", [0, 0, 0]), ("base", [0, 0, 0]), stiffness=k, free_length=1.0
            )
        },
    )
    times = np.linspace(0, 1.0, 21)
    motion = jb.inputs.Sawtooth(A, T, START).motion("z")
    run = jb.simulate(model, times, motion={"base": motion}, initial="rest", rtol=1e-10)
    base = np.asarray(jax.vmap(motion)(times))[:, 2]
    s, end = np.clip(times - START, 0, T), w * T
    x, v = -A / T * (s / w**2 - np.sin(w * s) / w**3), -A / T * (1 - np.cos(w * s)) / w**2
    after = times - START - s
    stroke = np.where(after > 0, x * np.cos(w * after) + v / w * np.sin(w * after), x)
    assert end > 2 * np.pi
    np.testing.assert_allclose(run.elongations["spring"], stroke, atol=1e-8 * np.abs(stroke).max())
    np.testing.assert_allclose(run.poses["mass"].p[:, 2] - base - 1, stroke, atol=1e-8)


@pytest.mark.long
def test_bad_pulses_are_refused():
    with pytest.raises(jb.JaxbodyError) as raised:
        jb.inputs.HalfSine(np.nan, -1.0, [0, 0])
    assert [p.code for p in raised.value.problems] == ["NON_FINITE", "BAD_NUMBER", "BAD_SHAPE"]
    with pytest.raises(jb.JaxbodyError, match=r"rise and fall: are 3 s.*BAD_NUMBER"):
        jb.inputs.Trapezoid(1.0, 2.0, rise=1.5)
    with pytest.raises(jb.JaxbodyError, match=r"samples\.count"):
        jb.inputs.Triangle(1.0, 1.0).samples(count=1.5)
