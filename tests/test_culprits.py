"""What fails is named: the law that has no number, the bushing that is turned too far."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb


def slider(gravity=0.0, **laws):
    """The mass on a guide along x, on an element that is good and on one by these laws."""
    ends = ("mass", [0, 0, 0]), ("base", [-1, 0, 0])
    return jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("base", axis=[1, 0, 0])},
        elements={"good": jb.Spring(*ends, stiffness=10.0, free_length=1.0), "bad": jb.SpringDamper(*ends, free_length=1.0, **laws)},
        gravity=[gravity, 0, 0],
    )


def moving(model, *speeds):
    return jb.State(model.reference.q, np.array(speeds))


LAWS = {
    "spring": ({"spring": lambda x: 5.0 * jnp.sqrt(0.1 - x)}, r"e = 0\.1, e' = 1\.\d+"),  # no number from 0.1 m on
    "damper": ({"damper": lambda v: jnp.sqrt(v + 0.05)}, r"e' = -0\.05"),  # none below -0.05 m/s
}


@pytest.mark.parametrize("case", LAWS)
def test_a_law_without_a_number_in_a_motion_is_named_by_its_element_with_where_that_is(case):
    laws, where = LAWS[case]
    model = slider(**laws)
    with pytest.warns(jb.JaxbodyWarning, match=f"the force of element 'bad' .*{where}") as warned:
        trajectory = jb.simulate(model, [0.0, 0.5, 1.0], initial=moving(model, 2.0))
    assert trajectory.status == jb.Status.NONFINITE and "body" not in str(warned[0].message)


def test_a_law_without_a_number_in_an_equilibrium_is_named_by_its_element():
    with pytest.warns(jb.JaxbodyWarning, match="'bad' is not finite") as warned:
        eq = jb.equilibrium(slider(9.81, spring=lambda x: 5.0 * x * jnp.sqrt(0.1 - x)))  # the good one alone would stretch by 0.98 m
    assert eq.status == jb.Status.NOT_CONVERGED and "max_steps" not in str(warned[0].message)


def test_an_equilibrium_that_needs_more_steps_blames_no_element():
    with pytest.warns(jb.JaxbodyWarning, match="give more max_steps"):
        jb.equilibrium(slider(9.81, spring=lambda x: 100.0 * x**3), max_steps=1)


TURNED = {
    "three coefficients, no resistance to turning": [1e3, 1e3, 2e3],
    "a matrix": np.diag([1e3, 1e3, 1e3, 1.0, 1.0, 1.0]),
}


@pytest.mark.parametrize("case", TURNED)
def test_a_bushing_past_half_a_turn_is_named_with_what_to_do(case):
    ends = ("rotor", [0.1, 0, 0]), ("base", [0.1, 0, 0])
    model = jb.Model(
        bodies={"rotor": jb.Body(mass=1.0, inertia=[0.1, 0.1, 0.1])},
        supports={"base": jb.Support()},
        elements={"mount": jb.Bushing(*ends, stiffness=TURNED[case]), "hanger": jb.Spring(*ends, stiffness=1.0)},
    )
    with pytest.warns(jb.JaxbodyWarning, match="'mount' is turned by 180 degrees; .* half a turn.* joint") as warned:
        trajectory = jb.simulate(model, [0.0, 0.5, 1.0], initial=moving(model, 0.0, 0, 0, 0.3, 0, 12.0))
    assert trajectory.status == jb.Status.DT_MIN
    assert not any(word in str(warned[0].message) for word in ("hanger", "max_steps", "rtol"))
