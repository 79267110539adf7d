"""The list of bad inputs: each has a test, and each code of the package is met by one."""

import re
from pathlib import Path

import pytest
from catalogue import CATALOGUE

from jaxbody.core.codes import CODES

TESTS = Path(__file__).parents[1]


def test_the_list_has_96_entries():
    assert list(CATALOGUE) == list(range(1, 97))


@pytest.mark.parametrize("entry", CATALOGUE)
def test_each_entry_has_its_tests(entry):
    what, *places = CATALOGUE[entry]
    assert what and places
    for place in places:
        if place.startswith("no "):
            continue
        file, _, names = place.partition(": ")
        text = (TESTS / file).read_text()
        for name in names.split(", "):
            wanted = rf"def {name}\(" if name.startswith("test_") else rf"[\"'f]{re.escape(name)}\b"
            assert re.search(wanted, text), f"{file} has no {name}"


def test_each_code_is_in_a_test():
    text = "\n".join(path.read_text() for path in TESTS.rglob("test_*.py"))
    assert [code for code in CODES if not re.search(rf"\b{code}\b", text)] == []
