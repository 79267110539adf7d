"""The text of a file: lines of all entries, names stated twice, limits, and what is not
well formed."""

import json

import pytest

from jaxbody.core.errors import JaxbodyError
from jaxbody.files.documents import parse_document, read_document

TOML = '''units = "SI" # a "comment" [x]
a.b.c = 3
[elements.AB]
type = "Spring"
a = ["plate", [
   1, 2,
   3]]
law = { type = "BumpStop", gap = "3 mm" }
[[runs]]
x = 1
[runs.deep]
y = 2
[[runs]]
x = """
several # lines [
"""
z = 2
[elements."strange.name"]
k = 1
'''
LINES = {
    ("units",): 1,
    ("a", "b"): 2,
    ("a", "b", "c"): 2,
    ("elements", "AB"): 3,
    ("elements", "AB", "type"): 4,
    ("elements", "AB", "a", 0): 5,
    ("elements", "AB", "a", 1): 5,
    ("elements", "AB", "a", 1, 1): 6,
    ("elements", "AB", "a", 1, 2): 7,
    ("elements", "AB", "law", "gap"): 8,
    ("runs", 0, "x"): 10,
    ("runs", 0, "deep", "y"): 12,
    ("runs", 1): 13,
    ("runs", 1, "x"): 14,
    ("runs", 1, "z"): 17,
    ("elements", "strange.name", "k"): 19,
}


def test_each_entry_of_toml_has_its_line():
    document = parse_document(TOML, "e.toml")
    assert LINES.items() <= document.lines.items()
    assert document.where(("elements", "AB", "a", 1, 2)) == "e.toml:7 elements.AB.a[1][2]"
    assert document.where(("elements", "AB", "missing")) == "e.toml:3 elements.AB.missing"
    assert parse_document(TOML.replace("\n", "\r\n"), "e.toml").lines == document.lines


def test_each_entry_of_json_has_its_line():
    text = json.dumps(parse_document(TOML, "e.toml").values, indent=1)
    lines = parse_document(text, "e.json", "json").lines
    for path in LINES:
        said = text.splitlines()[lines[path] - 1]
        assert isinstance(path[-1], int) or json.dumps(path[-1]) in said
    spread = parse_document('{"a":\n\n{\n"b"\n:\n1,\n"c": [\n2]}}', "e.json", "json").lines
    assert spread == {("a",): 1, ("a", "b"): 4, ("a", "c"): 7, ("a", "c", 0): 8}


@pytest.mark.parametrize(
    "text, kind, message",
    [
        (
            "a = 1\na = 2",
            "toml",
            "f:2 a: is stated twice, first in line 1. Rename one, or delete it. [DUPLICATE_NAME]",
        ),
        (
            "[x.y]\nz = 1\n[x]\n[x.y]",
            "toml",
            "f:4 x.y: is stated twice, first in line 1. Rename one, or delete it. [DUPLICATE_NAME]",
        ),
        (
            "a = {b = 1, b = 2}",
            "toml",
            "f:1 a.b: is stated twice, first in line 1. Rename one, or delete it. [DUPLICATE_NAME]",
        ),
        (
            '{"a": 1,\n"a": {}}',
            "json",
            "f:2 a: is stated twice, first in line 1. Rename one, or delete it. [DUPLICATE_NAME]",
        ),
        (
            "a = 1\nb = yes",
            "toml",
            (
                "f:2: invalid value, column 5. Words and units need quotation marks: stiffness "
                '= "21 N/mm". [SYNTAX]'
            ),
        ),
        ("a = 1\n[b", "toml", "f:2: expected ']' at the end of a table declaration. [SYNTAX]"),
        (
            "a = {}\na.b = 1",
            "toml",
            "f:2: cannot mutate immutable namespace ('a',), column 8. [SYNTAX]",
        ),
        ('{"a": 1,\n "b" 2}', "json", "f:2: expecting ':' delimiter, column 6. [SYNTAX]"),
        (
            "[1, 2]",
            "json",
            "f: has no names at its top (allowed: an object with names). Begin with {. [SYNTAX]",
        ),
    ],
)
def test_what_is_not_well_formed_has_its_line(text, kind, message):
    with pytest.raises(JaxbodyError) as error:
        parse_document(text, "f", kind)
    # as other versions of Python say it in other words
    if "namespace" not in message and "declaration" not in message:
        assert str(error.value) == message
    assert error.value.where.partition(" ")[0] == message.partition(": ")[0].partition(" ")[0]


@pytest.mark.parametrize(
    "text, kind",
    [
        ("a = " + "[" * 100000, "toml"),
        ("[" * 100000, "json"),
        (".".join("a" * 1000) + " = 1", "toml"),
    ],
)
def test_deep_nesting_is_refused_before_it_is_parsed(text, kind):
    with pytest.raises(JaxbodyError, match="is nested more than 20 levels deep") as error:
        parse_document(text, "f", kind)
    assert error.value.code == "TOO_LARGE"


@pytest.mark.parametrize(
    "text",
    [
        "a = " + "9" * 5000,
        '"""',
        'a = """\n\n',
        "[",
        "=",
        "a",
        '"\\',
        "a = [1, {b",
        "]",
        "}",
        "a.",
        "\0",
    ],
)
def test_text_that_ends_early_is_a_clear_error(text):
    with pytest.raises(JaxbodyError) as error:
        parse_document(text, "f")
    assert error.value.code == "SYNTAX"


def test_files_are_checked_before_they_are_read(tmp_path):
    def code(name, content=None):
        if content is not None:
            (tmp_path / name).write_bytes(content)
        with pytest.raises(JaxbodyError) as error:
            read_document(tmp_path / name, largest=100)
        return error.value.code

    assert code("missing.toml") == "NO_FILE"
    assert code("empty.toml", b"") == "EMPTY_FILE"
    assert code("large.toml", b"#" * 101) == "TOO_LARGE"
    assert code("model.yaml", b"a: 1") == "UNKNOWN_FORMAT"
    assert code("latin.toml", 'a = "5 µm"'.encode("latin-1")) == "ENCODING"
    assert code("wide.toml", "a = 1".encode("utf-16")) == "ENCODING"
    (tmp_path / "mark.toml").write_bytes("a = 1".encode("utf-8-sig"))
    assert read_document(tmp_path / "mark.toml").values == {"a": 1}
