"""Causes of failure are named: laws that are not finite, excessive rotation of elements, springs
that pass through zero length."""

import re

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb


def slider(gravity=0.0, **laws):
    """A mass on a guide along x, on a spring and on an element with these laws."""
    ends = ("mass", [0, 0, 0]), ("base", [-1, 0, 0])
    return jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("base", axis=[1, 0, 0])},
        elements={
            "good": jb.Spring(*ends, stiffness=10.0, free_length=1.0),
            "bad": jb.SpringDamper(*ends, free_length=1.0, **laws),
        },
        gravity=[gravity, 0, 0],
    )


def moving(model, *speeds):
    return jb.State(model.reference.q, np.array(speeds))


LAWS = {
    # no number from 0.1 m on
    "spring": ({"spring": lambda x: 5.0 * jnp.sqrt(0.1 - x)}, r"e = 0\.1, e' = 1\.\d+"),
    "damper": ({"damper": lambda v: jnp.sqrt(v + 0.05)}, r"e' = -0\.05"),  # none below -0.05 m/s
}


@pytest.mark.long
@pytest.mark.parametrize("case", LAWS)
def test_a_nonfinite_law_in_a_motion_is_named_with_its_element_and_deformation(case):
    laws, where = LAWS[case]
    model = slider(**laws)
    with pytest.warns(jb.JaxbodyWarning, match=f"the force of element 'bad' .*{where}") as warned:
        trajectory = jb.simulate(model, [0.0, 0.5, 1.0], initial=moving(model, 2.0))
    assert trajectory.status == jb.Status.NONFINITE and "body" not in str(warned[0].message)


@pytest.mark.long
def test_a_nonfinite_law_in_an_equilibrium_is_named_with_its_element():
    with pytest.warns(jb.JaxbodyWarning, match="'bad' is not finite") as warned:
        # the good one alone would stretch by 0.98 m
        eq = jb.equilibrium(slider(9.81, spring=lambda x: 5.0 * x * jnp.sqrt(0.1 - x)))
    assert eq.status == jb.Status.NOT_CONVERGED and "max_steps" not in str(warned[0].message)


@pytest.mark.long
def test_an_equilibrium_that_needs_more_steps_names_no_element():
    with pytest.warns(jb.JaxbodyWarning, match="give more max_steps"):
        jb.equilibrium(slider(9.81, spring=lambda x: 100.0 * x**3), max_steps=1)


TURNED = {
    "three coefficients, no resistance to turning": [1e3, 1e3, 2e3],
    "a matrix": np.diag([1e3, 1e3, 1e3, 1.0, 1.0, 1.0]),
}


@pytest.mark.long
@pytest.mark.parametrize("case", TURNED)
def test_a_bushing_past_half_a_turn_is_named_with_the_remedy(case):
    ends = ("rotor", [0.1, 0, 0]), ("base", [0.1, 0, 0])
    model = jb.Model(
        bodies={"rotor": jb.Body(mass=1.0, inertia=[0.1, 0.1, 0.1])},
        supports={"base": jb.Support()},
        elements={
            "mount": jb.Bushing(*ends, stiffness=TURNED[case]),
            "hanger": jb.Spring(*ends, stiffness=1.0),
        },
    )
    with pytest.warns(
        jb.JaxbodyWarning, match="'mount' is turned by 180 degrees; .* half a turn.* joint"
    ) as warned:
        trajectory = jb.simulate(
            model, [0.0, 0.5, 1.0], initial=moving(model, 0.0, 0, 0, 0.3, 0, 12.0)
        )
    assert trajectory.status == jb.Status.DT_MIN
    assert not any(word in str(warned[0].message) for word in ("hanger", "max_steps", "rtol"))


def on_a_line(offset=0.0, element=jb.Spring, **law):
    """A mass on a guide along x, on a spring of 1 m to a point 1 m behind it and `offset` to the
    side of the guide."""
    return jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
        elements={
            "s": element(
                ("mass", [0, 0, 0]),
                ("world", [-1, offset, 0]),
                **({"free_length": 1.0} | (law or {"stiffness": 50.0})),
            )
        },
    )


TIMES = np.linspace(0, 0.5, 21)
TOWARDS = jb.State(jnp.zeros(1), jnp.array([-8.0]))
THROUGH = np.arcsin(np.sqrt(50) / 8) / np.sqrt(50)  # 8/w sin wt = 1 m, w^2 = 50
# Where the acceleration jumps by a between samples h apart, the error of the cubic is s^2 (1 - s)^2
# (1 - 2 s)/2 a h^2 at most, 0 < s < 1
SLACK = 0.009 * 100 * 0.025**2 / np.sqrt(64 - 50)  # of the time, at the speed there


def time_of(message):
    return float(re.search(r" at t = ([\d.]+) s; ", message)[1])


@pytest.mark.parametrize("rtol", [1e-3, 1e-8])
def test_a_spring_that_passes_through_zero_length_is_named_with_the_time(rtol):
    """x = -8/w sin wt until then."""
    with pytest.warns(
        jb.JaxbodyWarning,
        match=r"^simulate: 's' has shrunk to a point at t = .*its direction jumps there",
    ) as warned:
        trajectory = jb.simulate(on_a_line(), TIMES, initial=TOWARDS, rtol=rtol)
    assert trajectory.ok and [w.message.code for w in warned] == ["SPRING_COLLAPSED"]
    assert abs(time_of(str(warned[0].message)) - THROUGH) <= SLACK
    assert f"ok; 's' has shrunk to a point at t = {THROUGH:.3f}" in repr(trajectory)


@pytest.mark.long
def test_a_spring_that_passes_through_zero_length_is_named_under_derivatives_too():
    with pytest.warns(jb.JaxbodyWarning, match="'s' has shrunk to a point at t = "):
        jax.grad(
            lambda k: jb.simulate(
                jb.replace(on_a_line(), {"s.stiffness": k}), TIMES, initial=TOWARDS
            ).state.q[-1, 0]
        )(50.0)


@pytest.mark.long
def test_with_constant_steps_only_the_summary_shows_a_collapse():
    constant = {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 1e-3}
    trajectory = jb.simulate(on_a_line(), TIMES, initial=TOWARDS, **constant)
    assert abs(time_of(trajectory.summary()) - THROUGH) <= SLACK


NO_JUMP = {
    "beside, by a fiftieth": {"offset": 0.02},
    "zero free length": {"free_length": 0.0, "stiffness": 50.0},
    "a rope": {"element": jb.SpringDamper, "spring": jb.laws.TensionOnly(50.0)},
}


@pytest.mark.long
@pytest.mark.parametrize("case", NO_JUMP)
def test_a_spring_whose_force_does_not_jump_is_not_named(case):
    trajectory = jb.simulate(on_a_line(**NO_JUMP[case]), TIMES, initial=TOWARDS)
    assert trajectory.state.q[:, 0].min() < -1.2 and "shrunk" not in trajectory.summary()


@pytest.mark.long
@pytest.mark.parametrize("turns", [0.5, 0.4, 2.5, 3.1])
def test_a_spring_that_swings_round_between_two_samples_is_not_named(turns):
    """Its length stays constant, although the straight line between two samples passes near its
    other end, and through it at half turns."""
    model = jb.Model(
        bodies={"arm": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"arm": jb.Hinge("world", axis=[0, 0, 1])},
        elements={
            "s": jb.Spring(
                ("arm", [1.0, 0, 0]), ("world", [0, 0, 0]), stiffness=50.0, free_length=0.9
            )
        },
    )
    trajectory = jb.simulate(
        model, np.arange(9.0), initial=jb.State(jnp.zeros(1), jnp.array([2 * np.pi * turns]))
    )
    assert (
        np.abs(trajectory.elongations["s"] - 0.1).max() <= 1e-9
        and "shrunk" not in trajectory.summary()
    )


@pytest.mark.long
def test_a_torsion_spring_past_half_a_turn_is_named_with_the_time():
    """theta = 8/w sin wt = pi, w^2 = 2; up to there its angle is that of the hinge, then it jumps
    by 2 pi. The slack is twice 0.009 x 4 pi rad/s^2 x (25 ms)^2 at 6.7 rad/s."""
    model = jb.Model(
        bodies={"arm": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        joints={"arm": jb.Hinge("world", axis=[0, 0, 1])},
        elements={"t": jb.Torsion("world", "arm", axis=[0, 0, 1], spring=2.0)},
    )
    with pytest.warns(
        jb.JaxbodyWarning,
        match=r"^simulate: 't' is turned by 180 degrees at t = .*half a turn.*`orientation`",
    ) as warned:
        trajectory = jb.simulate(model, TIMES, initial=jb.State(jnp.zeros(1), jnp.array([8.0])))
    assert trajectory.ok and [w.message.code for w in warned] == ["HALF_TURN"]
    assert (
        abs(time_of(str(warned[0].message)) - np.arcsin(np.pi * np.sqrt(2) / 8) / np.sqrt(2))
        <= 25e-6
    )
    jump = np.asarray(trajectory.state.q[:, 0] - trajectory.elongations["t"])
    assert set(np.round(jump / (2 * np.pi), 9)) == {0, 1}


def test_a_body_that_escapes_is_warned_of():
    ends = ("mass", [0, 0, 0]), ("base", [0, 0, 0])
    with pytest.warns(jb.JaxbodyWarning, match="NEGATIVE_DAMPING"):
        rubber = jb.Bushing(*ends, stiffness=[10.0] * 3, damping=[-4.0, 0, 0], allow_negative=True)
    model = jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("base", axis=[1, 0, 0])},
        elements={"rubber": rubber},
    )
    rate, w, times = 2.0, np.sqrt(10.0 - 4.0), np.linspace(0, 12, 481)  # of x'' - 4 x' + 10 x = 0
    x = 5e-3 / w * np.exp(rate * times) * np.sin(w * times)
    first = times[np.argmax(np.abs(x) > 1e6)]
    with pytest.warns(jb.JaxbodyWarning, match="DIVERGED") as warned:
        trajectory = jb.simulate(model, times, initial=moving(model, 5e-3), rtol=1e-10)
    assert [
        f"from t = {first:.6g} s on" in str(w.message) and "'mass'" in str(w.message)
        for w in warned
    ] == [True]
    assert np.allclose(trajectory.state.q[:, 0], x, rtol=0, atol=1e-6 * np.abs(x).max())


@pytest.mark.long
def test_a_body_that_travels_with_its_support_or_falls_has_not_escaped():
    times, s = np.linspace(0, 3000, 301), np.linspace(0, 1, 301)
    base = jb.Sampled(
        times, translation=np.stack([3e6 * s**3 * (10 - 15 * s + 6 * s**2), 0 * s, 0 * s], 1)
    )
    # of 3e6 m
    trajectory = jb.simulate(slider(damper=4.0), times, motion={"base": base}, rtol=1e-4)
    assert float(trajectory.poses["mass"].p[-1, 0]) > 2e6
    stone = jb.Model(bodies={"stone": jb.Body(mass=1.0, inertia=[1, 1, 1])}, gravity=[0, 0, -9.81])
    with pytest.warns(jb.JaxbodyWarning) as warned:
        jb.simulate(stone, [0.0, 1e3])
    assert [w.message.code for w in warned] == ["UNATTACHED"]
