"""A setting of the process that threads share is as before when the last of them leaves."""

import gc

import pytest

import jaxbody as jb
from jaxbody.compilation.shared_settings import MANY, little_garbage, shared

pytestmark = pytest.mark.everywhere


def test_the_last_to_leave_restores_what_the_first_has_found():
    value = ["own"]

    def change():
        before, value[0] = value[0], "changed"
        return before

    inside = shared(change, lambda before: value.__setitem__(0, before))
    one, other = inside(), inside()
    seen = []
    for step in (one.__enter__, other.__enter__, lambda: one.__exit__(None, None, None), lambda: other.__exit__(None, None, None)):
        step()
        seen.append(value[0])
    assert seen == ["changed", "changed", "changed", "own"]
    with pytest.raises(ZeroDivisionError), inside():
        assert value == ["changed"] and 1 / 0
    assert value == ["own"]


@pytest.mark.parametrize(
    ("own", "within"), [((700, 10, 10), (MANY, 10, 10)), ((10 * MANY, 5, 5), (10 * MANY, 5, 5)), ((0, 10, 10), (0, 10, 10))]
)
def test_garbage_is_looked_for_less_often_unless_the_user_wants_it_never_or_less(own, within):
    before = gc.get_threshold()
    try:
        gc.set_threshold(*own)
        with little_garbage():
            assert gc.get_threshold() == within
        assert gc.get_threshold() == own
    finally:
        gc.set_threshold(*before)


def test_programs_are_traced_so():
    before, seen = gc.get_threshold(), []

    def push(t):
        seen.append(gc.get_threshold()[0])
        return [0.0 * t, 0.0 * t, 0.01 * t]

    car = jb.presets.quarter_car()
    jb.simulate(car, [0.0, 0.01], initial=car.reference, loads={"push": jb.Force("body", force=push)})
    assert set(seen) == {MANY} and gc.get_threshold() == before
