"""Units and domains of all fields of the package and of a user's own class."""

import dataclasses

import pytest
from fields import owners

import jaxbody as jb
from jaxbody.geometry.fields import Kind, resolved, units_of


def test_every_field_of_the_package_says_its_unit_and_domain():
    result = list(owners())
    assert len(result) > 50
    without = [
        f"{kind.__name__}.{field.name}"
        for kind in result
        for field in dataclasses.fields(kind)
        if not field.metadata.get("static") and "kind" not in field.metadata
    ]
    assert not without, f"no jb.field: {without}"


@pytest.mark.parametrize(
    ("formula", "words", "unit"),
    [
        ("force/argument", {"force": "N", "argument": "m"}, "N/m"),
        ("force/argument", {"force": "N", "argument": "m/s"}, "N s/m"),
        ("force/argument", {"force": "N m", "argument": "rad"}, "N m/rad"),
        ("force/argument", {"force": "N m", "argument": "rad/s"}, "N m s/rad"),
        ("force/argument^3", {"force": "N", "argument": "m/s"}, "N s3/m3"),
        ("argument", {"argument": "rad/s"}, "rad/s"),
        ("force", {}, ""),
        ("kg m2", {}, "kg m2"),
        ("value/s2", {"value": "N m"}, "N m/s2"),
        ("m, rad", {}, "m, rad"),
    ],
)
def test_formulas_of_units_are_read_in_the_words_of_the_owner(formula, words, unit):
    assert resolved(formula, None, words) == unit


def test_units_of_parts_belong_to_the_numbers_of_these_parts():
    blocks = Kind("N/m, N; N, N m/rad")
    assert units_of(blocks, (6, 6)) == [
        *(["N/m"] * 3 + ["N"] * 3) * 3,
        *(["N"] * 3 + ["N m/rad"] * 3) * 3,
    ]
    assert units_of(blocks, (3,)) == ["N/m"] * 3
    assert units_of(Kind("m, rad"), (2, 6)) == (["m"] * 3 + ["rad"] * 3) * 2
    assert units_of(Kind("N, N m"), ()) == [""]  # one number for both


def test_a_domain_that_is_none_is_refused():
    with pytest.raises(jb.JaxbodyError, match=r"'negative'.*nonnegative.*UNKNOWN_DOMAIN"):
        jb.field("m", "negative")
