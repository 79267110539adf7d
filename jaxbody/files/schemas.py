"""Check of a document against the schema of model files: known names, required entries, numbers in
SI. It does not import JAX.

The schema is a JSON schema, which editors can use too, with additional keywords: `unit` (SI unit of
the numbers of an entry), `words` (meaning of words in the units below it), `name_of` (kind of
object that a name refers to), `coordinates` (units of the coordinates of a joint) and `couples`
(whether words in units depend on the coordinates that the entry names).
"""

import functools
import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.files.documents import Document, EntryPath, with_current_types
from jaxbody.files.quantities import (
    coordinate_units,
    in_SI,
    owner,
    table_of,
    unit_system,
    with_own_joints,
    words_of_coupling,
)

VERSION = 1
SCHEMA_FILE = Path(__file__).with_name("schema.json")
TYPES = {
    "string": str,
    "boolean": bool,
    "number": (int, float),
    "integer": int,
    "array": list,
    "object": dict,
}
ANYTHING = {"type": list(TYPES)}
CALLED = {
    "string": "a text",
    "boolean": "true or false",
    "number": "a number",
    "integer": "a whole number",
    "array": "a list",
    "object": "a table",
}


@functools.cache
def schema() -> dict[str, Any]:
    """Return the schema of model files."""
    return json.loads(SCHEMA_FILE.read_text(encoding="utf-8"))


def checked_values(document: Document) -> dict[str, Any]:
    """Return the values of a document, with all numbers in SI. One error lists all problems with
    their line numbers.

    Errors: FILE_VERSION, UNKNOWN_NAME, UNKNOWN_BODY, MISSING_ENTRY, WRONG_KIND, those
    of quantities."""
    _check_version(document)
    document.values = with_current_types(document.values)
    with Problems() as problems:
        check = Check(document, problems)
    with problems:
        return check.value(document.values, schema(), (), {})


def _check_version(document: Document) -> None:
    version = document.values.get("jaxbody")
    if version != VERSION or isinstance(version, bool):
        newer = isinstance(version, int) and version > VERSION
        raise JaxbodyError(
            Problem(
                "FILE_VERSION",
                document.where(("jaxbody",)),
                "does not state its version" if version is None else f"is version {version!r:.20}",
                version,
                str(VERSION),
                f"This jaxbody reads version {VERSION}: install a newer one."
                if newer
                else f"Write jaxbody = {VERSION} in its first line.",
            )
        )


class Check:
    """Check of the values of a document against the schema, entry by entry."""

    def __init__(self, document: Document, problems: Problems):
        self.document, self.problems = document, problems
        self.system = unit_system(
            document.values.get("units"), document.where(("units",)), problems
        )
        self.coordinates = coordinate_units(document.values, schema()["$defs"])
        self.own_joints = with_own_joints(document.values)
        names = {
            section: tuple(table_of(document.values, section))
            for section in ("bodies", "supports", "elements", "records", "sensors")
        }
        self.known = {
            "frame": (*names["bodies"], *names["supports"], "world"),
            "element": names["elements"],
            "record": names["records"],
            "sensor": names["sensors"],
        }

    def value(
        self, value: Any, node: dict[str, Any], path: EntryPath, words: dict[str, str]
    ) -> Any:
        """Return a value with its numbers in SI, unchanged where there is a problem; `words`:
        meaning of words in units, from the schemas around it."""
        words = words | node.get("words", {})
        node = resolved(node)
        if "oneOf" in node:
            chosen = self.alternative(value, node, path)
            return value if chosen is None else self.value(value, chosen, path, words)
        if "unit" in node:
            return self.quantity(value, node, path, words)
        if not accepts(node, value):
            self.wrong_kind(value, node, path)
            return value
        if isinstance(value, dict):
            return (
                self.coupling(value, node, path)
                if "couples" in node
                else self.table(value, node, path, words)
            )
        if isinstance(value, list):
            self.count(value, node, path)
            return [
                self.value(x, of, (*path, i), words)
                for i, (x, of) in enumerate(zip(value, _items(node, len(value)), strict=True))
            ]
        if "name_of" in node:
            self.name(value, node["name_of"], path)
        if value not in node.get("enum", [value]):
            self.problems.collected.append(
                unknown(value, self.document.where(path), tuple(node["enum"]))
            )
        return value

    def name(self, value: str, kind: str, path: EntryPath) -> None:
        """Check the name of a frame, an element, a coordinate, a record or a sensor."""
        known = tuple(self.coordinates) if kind == "coordinate" else self.known[kind]
        of_own_joint = kind == "coordinate" and owner(value) in self.own_joints
        if value not in known and not of_own_joint:
            code, what = (
                ("UNKNOWN_BODY", "body or support") if kind == "frame" else ("UNKNOWN_NAME", kind)
            )
            problem = unknown(value, self.document.where(path), known)
            self.problems.collected.append(
                replace(problem, code=code, message=f"{what} {problem.message}")
            )

    def quantity(
        self, value: Any, node: dict[str, Any], path: EntryPath, words: dict[str, str]
    ) -> Any:
        if not isinstance(value, list | str | int | float):
            self.wrong_kind(value, node, path)
            return value
        numbers = in_SI(
            value, node["unit"], words, self.system, self.document.where(path), self.problems
        )
        self.count(numbers, node, path)
        return numbers

    def count(self, value: Any, node: dict[str, Any], path: EntryPath) -> None:
        """Check the number of items if the schema states it."""
        count = len(value) if isinstance(value, list) else 1
        expected = node.get("minItems", count)
        if count != expected:
            self.problems.add(
                "BAD_SHAPE",
                self.document.where(path),
                f"has {count} of {expected} items",
                value=value,
                limit=str(expected),
            )

    def table(
        self, value: dict[str, Any], node: dict[str, Any], path: EntryPath, words: dict[str, str]
    ) -> dict[str, Any]:
        known, others = node.get("properties", {}), node.get("additionalProperties", False)
        for name in node.get("required", []):
            if name not in value:
                text = resolved(known[name]).get("description", "")
                self.problems.add(
                    "MISSING_ENTRY",
                    self.document.where(path),
                    f"has no '{name}'",
                    value=name,
                    hint=f"Give {name} = ...{': ' + text if text else ''}",
                )
        values = {}
        for name, entry in value.items():
            if name == "type" and name in known:
                values[name] = entry
            elif name in known or others:
                values[name] = self.value(entry, known.get(name, others), (*path, name), words)
            else:
                self.problems.collected.append(
                    unknown(name, self.document.where((*path, name)), tuple(known))
                )
        return values

    def coupling(
        self, value: dict[str, Any], node: dict[str, Any], path: EntryPath
    ) -> dict[str, Any]:
        """Check a coupling, in the units of its coordinates; where these are not known yet, only
        its names are checked."""
        words = words_of_coupling(value, self.coordinates)
        if words is None:
            node = node | {
                "properties": {
                    name: of if "name_of" in of else ANYTHING
                    for name, of in node["properties"].items()
                }
            }
        return self.table(value, node, path, words or {})

    def alternative(
        self, value: Any, node: dict[str, Any], path: EntryPath
    ) -> dict[str, Any] | None:
        """Return that of several alternative schemas that applies to a value. Return None if there
        is a problem, or for a user-defined class, which is checked once it is imported."""
        options = [resolved(option) for option in node["oneOf"]]
        fitting = [option for option in options if accepts(option, value)]
        types = {
            option["properties"]["type"]["const"]: option
            for option in fitting
            if "type" in option.get("properties", {})
        }
        if isinstance(value, dict) and types:
            by_default = (name for name, of in types.items() if "type" not in of["required"])
            name = value.get("type", next(by_default, None))
            if isinstance(name, str) and ":" in name:
                return None
            if name is None:
                self.problems.add(
                    "MISSING_ENTRY",
                    self.document.where(path),
                    "has no 'type'",
                    value=value,
                    limit="type",
                    hint=f"Known: {', '.join(types)}.",
                )
            elif str(name) not in types:
                self.problems.collected.append(
                    unknown(str(name), self.document.where((*path, "type")), tuple(types))
                )
            return types.get(str(name))
        if not fitting:
            self.wrong_kind(
                value, {"type": [kind for option in options for kind in _types(option)]}, path
            )
            return None
        return fitting[0]

    def wrong_kind(self, value: Any, node: dict[str, Any], path: EntryPath) -> None:
        self.problems.add(
            "WRONG_KIND",
            self.document.where(path),
            f"is {value!r:.60}",
            value=value,
            limit=" or ".join(dict.fromkeys(CALLED[kind] for kind in _types(node))),
        )


def resolved(node: dict[str, Any]) -> dict[str, Any]:
    """Return the definition that a schema refers to, with the description next to the reference."""
    if "$ref" not in node:
        return node
    about = {name: text for name, text in node.items() if name == "description"}
    return schema()["$defs"][node["$ref"].rpartition("/")[2]] | about


def accepts(node: dict[str, Any], value: Any) -> bool:
    """Return whether a value is of a type of a schema, and a text matches its pattern."""
    if isinstance(value, str) and not re.search(node.get("pattern", ""), value):
        return False
    kinds = ["boolean"] if isinstance(value, bool) else TYPES
    return any(kind in kinds and isinstance(value, TYPES[kind]) for kind in _types(node))


def _types(node: dict[str, Any]) -> list[str]:
    kinds = node.get("type", [])
    return [kinds] if isinstance(kinds, str) else kinds


def _items(node: dict[str, Any], n: int) -> list[dict[str, Any]]:
    """Return the schemas of n items. Items beyond those that the schema states may be anything; the
    constructor rejects them."""
    return [*node.get("prefixItems", []), *[node.get("items", ANYTHING)] * n][:n]
