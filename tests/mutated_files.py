"""Files with characters, words and values deleted, doubled, exchanged or replaced: each is read, or
ends in a clear error."""

import json
import re
from typing import Any

import numpy as np

import jaxbody as jb
from jaxbody.files.documents import read_document

ODD = [
    "",
    "nan",
    "-1",
    "1e400",
    "9" * 5000,
    '"',
    "[",
    "{",
    "}",
    "=",
    "\n",
    "\0",
    "é",
    "type",
    "true",
    '"1 kg"',
    "[[]]",
    "1979-05-27",
    '"""',
]
ODD_VALUES = [
    None,
    True,
    -1,
    1e400,
    10**400,
    "",
    "1 kg",
    "nan m",
    [],
    [[1], 2],
    {},
    {"type": "BumpStop"},
    {"type": 3},
    "world",
    ["world", 1],
]


def changed_text(rng, path):
    """The path of a changed copy of a file."""
    changed = path.with_stem("changed")
    changed.write_text(_text(rng, path.read_text()), encoding="utf-8")
    return changed


def changed_value(rng, path):
    """The same as JSON, with one value changed."""
    changed = path.with_name("changed.json")
    changed.write_text(_value(rng, json.dumps(read_document(path).values)), encoding="utf-8")
    return changed


def check_changed(path, count, read):
    """Change a file this many times, as TOML and as JSON; the number of changed files that are read
    without an error."""
    rng = np.random.default_rng(0)
    text, values = path.read_text(), json.dumps(read_document(path).values)
    return sum(
        _is_read(path.with_suffix(".json"), _value(rng, values), read)
        if rng.random() < 0.3
        else _is_read(path, _text(rng, text), read)
        for _ in range(count)
    )


def check_changed_text(path, count, read):
    """The same for a file of another format."""
    rng, text = np.random.default_rng(0), path.read_text()
    return sum(_is_read(path, _text(rng, text), read) for _ in range(count))


def _is_read(path, changed, read):
    path.write_text(changed, encoding="utf-8")
    try:
        read(path)
    except jb.JaxbodyError as error:
        assert error.code and len(str(error).splitlines()) <= 12
        return False
    return True


def _value(rng, values):
    changed: Any = json.loads(values)
    holder = changed
    while True:
        key = (
            rng.choice(list(holder)) if isinstance(holder, dict) else int(rng.integers(len(holder)))
        )
        if rng.random() < 0.3 or not (isinstance(holder[key], dict | list) and holder[key]):
            break
        holder = holder[key]
    holder[key] = ODD_VALUES[rng.integers(len(ODD_VALUES))]
    return json.dumps(changed)


def _text(rng, text):
    parts = re.split(r"(\b)", text) if rng.random() < 0.5 else list(text)
    for _ in range(rng.integers(1, 3)):
        i, j = sorted(rng.integers(0, len(parts), 2))
        new = [
            [],
            parts[i : i + 1] * 2,
            [parts[j]],
            [str(rng.choice(ODD))],
            [chr(rng.integers(1, 0x2FF))],
        ][rng.integers(5)]
        parts[i : i + 1] = new
    return "".join(parts)
