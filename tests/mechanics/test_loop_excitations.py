"""The generalized force of displaced supports on a closed loop: by hand for a slider-crank, and to
first order as K~ Xi."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs

import jaxbody as jb

G = 9.81
CRANK, COUPLER = 0.2, 0.3
# of both links, whose centers are at half the height of the pin; of the spring at the crank
WEIGHT, TORQUE, ANGLE = 4.0 * G, 30.0, 0.6


def slider_crank():
    """The coupler's end slides along x on a base that moves."""
    spring = jb.Torsion("world", "crank", axis="z", spring=TORQUE)
    return rigs.slider_crank({"spring": spring}, "base", CRANK, COUPLER)


def closed(height, turn):
    """The turn b of the coupler relative to the crank: its end is on the line through (0, h) with
    slope tan(turn)."""

    def gap(b):
        x, y = (
            CRANK * np.cos(ANGLE) + COUPLER * np.cos(ANGLE + b),
            CRANK * np.sin(ANGLE) + COUPLER * np.sin(ANGLE + b),
        )
        return np.cos(turn) * (y - height) - np.sin(turn) * x

    low, high = -np.pi / 2 - ANGLE, np.pi / 2 - ANGLE
    for _ in range(200):
        middle = (low + high) / 2
        low, high = (middle, high) if gap(middle) < 0 else (low, middle)
    return middle


def slope(height, turn):
    """dV/da of the crank's angle a with the end on the line: y_2 follows by c_a + c_b b' = 0."""
    b = closed(height, turn)
    e = np.array([-np.sin(turn), np.cos(turn)])
    of_pin, of_end = (np.array([-np.sin(x), np.cos(x)]) for x in (ANGLE, ANGLE + b))
    follows = -(CRANK * e @ of_pin + COUPLER * e @ of_end) / (COUPLER * e @ of_end)
    # of the coupler's center
    rise = CRANK * np.cos(ANGLE) + COUPLER / 2 * np.cos(ANGLE + b) * (1 + follows)
    return TORQUE * ANGLE + G * CRANK / 2 * np.cos(ANGLE) + 3.0 * G * rise


def test_the_excitation_of_a_slider_crank_is_the_change_of_its_slope():
    model = slider_crank()
    state = jb.State(jnp.array([ANGLE, closed(0.0, 0.0)]), jnp.zeros(2))
    lin = jb.linearize(model, state)
    assert lin.coordinates == ("crank turn about its hinge",)

    force = jax.jit(lambda xi: jb.excitation(model, state, {"base": xi}))
    for height, turn in ((0.03, 0.0), (0.0, 0.2), (-0.05, -0.3)):
        found = force(jnp.array([0, height, 0, 0, 0, turn]))
        np.testing.assert_allclose(found, [slope(0.0, 0.0) - slope(height, turn)], rtol=1e-10)
    np.testing.assert_allclose(
        jax.jit(jax.jacfwd(force))(jnp.zeros(6)), lin.K_tilde, rtol=1e-9, atol=1e-9
    )
    assert np.isnan(force(jnp.array([0, 0.6, 0, 0, 0, 0]))).all()  # beyond reach


@pytest.mark.nan
def test_an_excitation_beyond_reach_has_no_derivative():
    model, state = slider_crank(), jb.State(jnp.array([ANGLE, closed(0.0, 0.0)]), jnp.zeros(2))
    force = lambda h: jb.excitation(model, state, {"base": jnp.zeros(6).at[1].set(h)})  # noqa: E731
    for of in (jax.jacfwd, jax.jacrev):
        assert np.isnan(jax.jit(of(force))(0.6)).all()
