"""Changes of a document: new values for entries, from texts such as "left.stiffness=30 N/mm"."""

import fnmatch
import tomllib
from typing import Any

from jaxbody.core.errors import JaxbodyError, Problem, unknown
from jaxbody.files.documents import Document, EntryPath
from jaxbody.files.quantities import table_of

# sections with names that are unique in a model
SECTIONS = ("bodies", "supports", "elements", "closures", "energies", "dissipations")


def set_value(document: Document, text: str) -> None:
    """Set an entry of a document from a text such as "left.stiffness=30 N/mm".

    The path before the equals sign names an entry of a body, support, element or closure, or of
    another section, such as "motion.road.frequency" or "records.run1.file"; "strut.spring.0" is the
    first of several laws. The name of a body,
    support, element or closure may contain * and ?, as in file names: the entry is set in all
    objects that match and have it. Errors: SYNTAX, UNKNOWN_NAME."""
    path, sign, value = text.partition("=")
    name, *below = path.strip().split(".")
    if not sign or not (below or name == "gravity"):
        raise JaxbodyError(
            Problem("SYNTAX", text, "is not a path and a value", text, 'left.stiffness="30 N/mm"')
        )
    things: dict[EntryPath, Any] = {
        (section, known): table
        for section in SECTIONS
        for known, table in table_of(document.values, section).items()
    }
    chosen = [path for path in things if path[1] == name] or [
        path
        for path in things
        if fnmatch.fnmatchcase(str(path[1]), name) and below[:1] and below[0] in things[path]
    ]
    if not chosen and (name == "gravity" or name in document.values):
        things[()], chosen, below = document.values, [()], [name, *below]
    if not chosen:
        raise JaxbodyError(
            unknown(
                path.strip(),
                text,
                tuple(f"{path[1]}.{entry}" for path in things for entry in things[path]),
            )
        )
    for path in chosen:
        _put(things[path], below, _value(value.strip()), text)
        document.replaced[(*path, *below)] = text


def _put(table: Any, below: list[str], value: Any, text: str) -> None:
    """Set an entry at a path below a table; a number counts the items of a list from 0. Errors:
    UNKNOWN_NAME, SYNTAX for one value in place of several laws."""
    *parts, last = (int(part) if part.isdigit() else part for part in below)
    for part in parts:
        table = _item(table, part)
    old = _item(table, last)
    if (
        isinstance(old, list)
        and any(isinstance(item, dict) for item in old)
        and not isinstance(value, list)
    ):
        name = text.partition("=")[0].strip()
        raise JaxbodyError(
            Problem(
                "SYNTAX",
                text,
                f"puts one law in the place of {len(old)}",
                text,
                " ".join(f"{name}.{i}" for i in range(len(old))),
                f"Name the one to change, or give a list, {name}=[...].",
            )
        )
    if not isinstance(table, dict) and old is None:
        raise JaxbodyError(
            Problem(
                "UNKNOWN_NAME",
                text,
                "names nothing that has entries",
                text,
                hint="The words are those of the file.",
            )
        )
    table[last] = value


def _item(table: Any, key: str | int) -> Any:
    """Return an item of a table or a list; None if there is none."""
    if isinstance(table, list) and isinstance(key, int) and key < len(table):
        return table[key]
    return table.get(key) if isinstance(table, dict) else None


def _value(text: str) -> Any:
    """Return a text parsed as a TOML value, or unchanged if it is not one."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except ValueError:
        return text
