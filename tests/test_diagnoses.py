"""Blunders planted in a measured record are named, and a sound record is let pass."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from rigs import plate

import jaxbody as jb

TIMES = np.linspace(0, 4, 201)
SENSORS = {
    "corner": jb.Position("plate", [0.4, 0.3, 0.0]),
    "edge": jb.Position("plate", [-0.4, 0.1, 0.0], axis=[0, 0, 1]),
    "side": jb.Position("plate", [0.1, -0.3, 0.0], axis=[1, 0, 0]),
}


@pytest.fixture(scope="module")
def swing():
    """The model, where it starts, and what it reads: along, across and upwards at different frequencies."""
    model = plate(damping=0.5)
    eq = jb.equilibrium(model)
    initial = jb.State(eq.state.q.at[:3].add(jnp.array([0.02, -0.015, 0.01])), jnp.array([0.05, 0.1, -0.1, 0.3, -0.2, 0.4]))
    return model, initial, jb.measure(jb.simulate(model, TIMES, initial=initial), SENSORS)


def diagnosed(swing, change, key=0):
    model, initial, readings = swing
    levels = jax.random.split(jax.random.key(key), 3)
    noisy = {name: np.asarray(x + 2e-4 * jax.random.normal(k, x.shape)) for (name, x), k in zip(readings.items(), levels, strict=True)}
    run = jb.Experiment(TIMES, initial=initial, sensors=SENSORS, measured=noisy | change(noisy))
    with warnings.catch_warnings(record=True) as told:
        warnings.simplefilter("always", jb.JaxbodyWarning)
        result = jb.diagnose(model, {"run": run})
    return result, sorted({w.message.code for w in told if isinstance(w.message, jb.JaxbodyWarning)})


def later(x, delay):
    return np.interp(TIMES - delay, TIMES, x)


def mirrored(x):
    return x * [1, 1, -1] + [0, 0, 2 * x[:, 2].mean()]


PLANTED = {
    "millimeters": (lambda m: {"edge": 1e3 * m["edge"]}, "GAIN_FACTOR", "run.edge thousandths"),
    "inches": (lambda m: {"side": m["side"] / 0.0254}, "GAIN_FACTOR", "run.side inches"),
    "g": (lambda m: {"edge": m["edge"] / 9.81}, "GAIN_FACTOR", "run.edge in g"),
    "degrees": (lambda m: {"edge": np.rad2deg(m["edge"])}, "GAIN_FACTOR", "run.edge degrees"),
    "sign": (lambda m: {"edge": -m["edge"]}, "GAIN_FACTOR", "run.edge turned round"),
    "late": (lambda m: {"edge": later(m["edge"], 0.012)}, "DELAY", "run.edge 0.6 samples later"),
    "early": (lambda m: {"edge": later(m["edge"], -0.02)}, "DELAY", "run.edge samples earlier"),
    "swapped": (lambda m: {"edge": m["side"], "side": m["edge"]}, "SWAPPED", "run.edge run.side exchanged"),
    "left-handed": (lambda m: {"corner": mirrored(m["corner"])}, "LEFT_HANDED", "run.corner mirrored"),
}


@pytest.mark.parametrize("case", PLANTED)
def test_a_planted_blunder_is_named(swing, case):
    change, code, words = PLANTED[case]
    result, codes = diagnosed(swing, change)
    assert code in codes, (codes, str(result))
    text = " ".join(result.words)
    assert [word for word in words.split() if word not in text] == [], text


def test_sound_records_pass(swing):
    """20 realizations of noise: a delay is told at four standard errors, which white noise passes once in 16000."""
    for key in range(20):
        result, codes = diagnosed(swing, lambda m: {}, key)
        assert codes == [] and result.words == () and "nothing to remark" in str(result)
    assert all(abs(c.gain - 1) < 0.05 and abs(c.delay) < 0.1 for c in result.channels)


def test_gaps_are_left_out(swing):
    def holed(m):
        x = m["edge"].copy()
        x[20:40] = np.nan
        return {"edge": 1e3 * x}

    result, codes = diagnosed(swing, holed)
    assert codes == ["GAIN_FACTOR"] and "run.edge" in result.words[0]
