"""Motions, laws and loads of the user that JAX cannot trace, or that return a wrong type, cause an
error that names them."""

import math
from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb


def slider(spring=100.0, damper=None):
    return jb.Model(
        bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("base", axis=[1, 0, 0])},
        elements={
            "s": jb.SpringDamper(
                ("mass", [0, 0, 0]),
                ("base", [-1, 0, 0]),
                spring=spring,
                damper=damper,
                free_length=1.0,
            )
        },
    )


class Counted(jb.inputs.Motion):
    """A motion that counts its calls."""

    amplitude: jax.Array
    calls: ClassVar[list] = []

    def __call__(self, t):
        self.calls.append(t)
        return jnp.full(6, self.amplitude)


class Sine(jb.inputs.Motion):
    amplitude: jax.Array

    def __call__(self, t):
        return np.sin(self.amplitude * t) * np.ones(6)


class Pair(jb.laws.Law):
    stiffness: jax.Array

    def force(self, x):
        return self.stiffness * jnp.stack([x, x])


class Root(jb.laws.Law):
    """Its field is traced as its argument is."""

    stiffness: jax.Array

    def force(self, x):
        return math.sqrt(self.stiffness) * x


MOTIONS = {
    "np.sin": (lambda t: np.array([np.sin(t), 0, 0, 0, 0, 0]), "NOT_TRACEABLE"),
    "math.sin": (lambda t: jnp.zeros(6).at[0].set(math.sin(t)), "NOT_TRACEABLE"),
    "if": (lambda t: jnp.zeros(6) if t < 1 else jnp.ones(6), "NOT_TRACEABLE"),
    "a list": (lambda t: [jnp.sin(t), 0, 0, 0, 0, 0], "BAD_SHAPE"),
    "three numbers": (lambda t: jnp.array([jnp.sin(t), 0, 0]), "BAD_SHAPE"),
    "nothing": (lambda t: None, "BAD_SHAPE"),
    "a class": (Sine(jnp.array(1.0)), "NOT_TRACEABLE"),
    "a delayed one": (jb.signals.Delayed(lambda t: np.sin(t) * np.ones(6), 0.1), "NOT_TRACEABLE"),
    "one of a sum": (jb.inputs.AtRest() + (lambda t: jnp.zeros(3)), "FUNCTION_FAILED"),
}


@pytest.mark.untyped
@pytest.mark.parametrize("case", MOTIONS)
def test_a_motion_that_jax_cannot_trace_or_of_another_shape_is_refused_by_its_support(case):
    motion, code = MOTIONS[case]
    with pytest.raises(jb.JaxbodyError) as raised, jb.compile_times() as times:
        jb.simulate(slider(), np.array([0.0, 1.0]), motion={"base": motion})
    assert raised.value.code == code and raised.value.where == "motion['base']"
    assert (
        ("jnp.sin" in str(raised.value))
        if code == "NOT_TRACEABLE"
        else ("6 numbers" in str(raised.value))
    )
    assert raised.value.__cause__ is None and raised.value.__context__ is None
    assert "integrate" not in times.programs


@pytest.mark.long
def test_a_motion_is_traced_once_for_the_check_however_often_it_is_used():
    for amplitude in (1.0, 2.0, 3.0):
        jb.simulate(slider(), np.array([0.0, 0.1]), motion={"base": Counted(jnp.array(amplitude))})
        seen = len(Counted.calls)
        jb.simulate(
            slider(), np.array([0.0, 0.1]), motion={"base": Counted(jnp.array(amplitude + 1))}
        )
        assert len(Counted.calls) == seen


LAWS = {
    "math.sin": (lambda x: math.sin(x), "NOT_TRACEABLE"),
    "np.sin": (lambda x: np.sin(x), "NOT_TRACEABLE"),
    "if": (lambda x: x if x > 0 else 2 * x, "NOT_TRACEABLE"),
    "math of a field": (Root(np.array(4.0)), "NOT_TRACEABLE"),
    "two numbers": (lambda x: jnp.stack([x, x]), "BAD_SHAPE"),
    "two numbers of a class": (Pair(np.array(1.0)), "BAD_SHAPE"),
    "two numbers in a sum": (jb.laws.Linear(3.0) + Pair(np.array(1.0)), "BAD_SHAPE"),
    "a mistake": (lambda x: {}["stiffness"], "FUNCTION_FAILED"),
}


@pytest.mark.parametrize("field", ["spring", "damper"])
@pytest.mark.parametrize("case", LAWS)
def test_a_law_that_jax_cannot_trace_or_of_two_numbers_is_refused_by_its_element(case, field):
    law, code = LAWS[case]
    with pytest.raises(jb.JaxbodyError) as raised, jb.compile_times() as times:
        slider(**{field: law})
    assert raised.value.code == code and raised.value.where == f"elements['s'].{field}"
    assert (
        ("jnp.sin" in str(raised.value))
        if code == "NOT_TRACEABLE"
        else ("one number" in str(raised.value).lower())
    )
    assert times.count == 0


def test_a_force_that_jax_cannot_trace_or_of_another_shape_is_refused():
    for function, code in (
        (lambda t: np.sin(t) * np.ones(3), "NOT_TRACEABLE"),
        (lambda t: jnp.zeros(2), "BAD_SHAPE"),
    ):
        with pytest.raises(jb.JaxbodyError) as raised:
            jb.Force("mass", force=function)
        assert raised.value.code == code and raised.value.where == "Force.force"
