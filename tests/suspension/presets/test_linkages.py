"""The four-bar linkage: its frequency from the rates of Norton's table, and its equilibrium
under gravity."""

import numpy as np
import pytest

import jaxbody as jb

CRANK, COUPLER, ROCKER, STIFFNESS = 0.04, 0.12, 0.08, 3.0
ANGLES = np.deg2rad([40.0, 20.29788279, 57.32488007])  # REFERENCES2 2.1, crank at 40 degrees
RATES = np.array([-4.12091442, 6.99798524]) / 25.0  # of coupler and rocker, by that of the crank


@pytest.mark.nan
def test_its_frequency_is_that_of_the_inertia_which_the_crank_feels():
    """I = sum of m v^2 + J w^2 by the rate of the crank; f = sqrt(k/I)/(2 pi); digits of
    the table."""
    model = jb.presets.four_bar(stiffness=STIFFNESS)
    along = np.array([np.cos(ANGLES), np.sin(ANGLES)]).T
    across = np.array([-np.sin(ANGLES), np.cos(ANGLES)]).T
    v = CRANK * across[0] + COUPLER / 2 * RATES[0] * across[1]
    inertia = (
        CRANK**3 / 3
        + COUPLER * v @ v
        + COUPLER**3 / 12 * RATES[0] ** 2
        + ROCKER**3 / 3 * RATES[1] ** 2
    )
    eq = jb.equilibrium(model)
    assert eq.ok and eq.stable and set(eq.redundant) == {"pin z", "pin turn 1", "pin turn 2"}
    np.testing.assert_allclose(eq.state.q, 0.0, atol=1e-12)
    frequency = jb.modes(jb.linearize(model, eq)).frequency
    np.testing.assert_allclose(frequency, [np.sqrt(STIFFNESS / inertia) / (2 * np.pi)], rtol=1e-8)
    pin = CRANK * along[0] + COUPLER * along[1]
    # the angles are those of the table
    np.testing.assert_allclose(pin, np.array([0.1, 0.0]) + ROCKER * along[2], atol=1e-10)
    for name, angle in zip(model.layout.bodies, ANGLES, strict=True):
        np.testing.assert_allclose(
            model[name].orientation, [np.cos(angle / 2), 0, 0, np.sin(angle / 2)], atol=1e-9
        )


@pytest.mark.long
def test_under_gravity_the_spring_holds_the_weights():
    """k (turn of the crank) = power of the weights by the rate of the crank, at the
    found angles."""
    model = jb.presets.four_bar(stiffness=STIFFNESS, gravity=9.81)
    eq = jb.equilibrium(model)
    turn, rate = ANGLES[0] + float(eq.state.q[0]), 1e-6
    heights = []
    for sign in (1, -1):
        moved = jb.State(eq.state.q.at[0].add(sign * rate), eq.state.v)
        q = jb.suspension.assemble(model, start=moved, hold=["crank"]).state.q
        angles = (
            turn + sign * rate,
            turn + sign * rate + float(q[1]) + ANGLES[1] - ANGLES[0],
            ANGLES[2] + float(q[2]),
        )
        sines = np.sin(angles)
        heights.append(
            CRANK * CRANK / 2 * sines[0]
            + COUPLER * (CRANK * sines[0] + COUPLER / 2 * sines[1])
            + ROCKER * ROCKER / 2 * sines[2]
        )
    weight = -9.81 * (heights[0] - heights[1]) / (2 * rate)
    assert STIFFNESS * float(eq.state.q[0]) == pytest.approx(weight, rel=1e-6)


def test_lengths_that_do_not_meet():
    with pytest.raises(
        jb.JaxbodyError, match=r"do not meet over 0.07397.*0.2 to 0.5 m.*NOT_CLOSED"
    ):
        jb.presets.four_bar(coupler=0.35, rocker=0.15)
