"""Static values become text and are the same again; what has no name has no text, and no text
runs anything."""

import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.compilation.plain_data import Unnamed, text_of, value_of
from jaxbody.core.errors import Status
from jaxbody.model.leaf_paths import Leaf, numbered

pytestmark = pytest.mark.everywhere

MODEL = jb.presets.quarter_car(damping=1500.0)


class Own:
    pass


VALUES = {
    "none": None,
    "numbers": (True, 1, -0.0, 1.5, 1 + 2j, float("inf"), 0.1),
    "text": ("", "[1]", "K~ µ", 'a "b" \\'),
    "collections": [[], (), {}, {"a": (1,), 2: [None]}, {1, 2}, frozenset({"x"})],
    "enumeration": Status.AT_BOUND,
    "number of NumPy": np.float32(0.1),
    "type": np.dtype("float64"),
    "class": (jb.Spring, int, type(None)),
    "function": (jb.modes, numbered),
    "dataclass": Leaf("AB.stiffness", 3, 0, 0),
}


@pytest.mark.parametrize("name", VALUES)
def test_values_are_the_same_again(name):
    value = VALUES[name]
    again = value_of(text_of(value))
    assert again == value and type(again) is type(value) and text_of(again) == text_of(value)
    assert repr(again) == repr(value)  # also the sign of zero


def test_not_a_number_is_one_again():
    assert np.isnan(value_of(text_of(float("nan"))))


@pytest.mark.parametrize("value", [lambda x: x, Own, Own(), np.zeros(2), MODEL.joint, object()])
def test_what_has_no_name_has_no_text(value):
    with pytest.raises(Unnamed):
        text_of((1, value))


def test_a_function_made_in_another_has_no_text():
    def inner():
        pass

    inner.__module__ = "jaxbody.core.compilation.plain_data"
    with pytest.raises(Unnamed, match="<locals>"):
        text_of(inner)


@pytest.mark.parametrize(
    "text",
    [
        "",
        "{}",
        "[]",
        '["unknown",1]',
        '["name","os:system"]',
        '["name","builtins:eval"]',
        '["name","jaxbody.core.units:no such thing"]',
        '["object","subprocess:Popen",["args",["list","true"]]]',
        '["object","jaxbody.core.units:length"]',
        '["float","not a number"]',
        "[" * 100_000,
    ],
)
def test_other_texts_are_refused(text):
    with pytest.raises(ValueError):
        value_of(text)
