"""MJCF documents: the elements of an XML file with their lines, included files in place, attributes
with the defaults of their class."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from xml.parsers import expat

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.core.source_files import check_file

DEEPEST = 200
ROOTS = ("mujoco", "robot")  # of MJCF and URDF
MAIN = "main"  # the class of all elements
ALIASES = {"spatial": "tendon", "fixed": "tendon"}  # whose defaults are stated by another name
NO_DTD = "Entities can make a small file endless: write their text in their places."


@dataclass
class Node:
    """An element of a file."""

    tag: str
    attributes: dict[str, str]
    where: str  # "engine.xml:12"
    children: list[Node] = field(default_factory=list)

    def all(self, *tags: str) -> Iterator[Node]:
        """The children of these tags."""
        return (child for child in self.children if child.tag in tags)


@dataclass
class MjcfDocument:
    """A file with those it includes: the tag of its root, its sections, and the attributes that
    each class gives to elements of a tag."""

    root: str
    sections: list[Node]
    classes: dict[str, dict[str, dict[str, str]]]
    problems: Problems

    def all(self, section: str) -> Iterator[Node]:
        """The sections of this tag."""
        return (node for node in self.sections if node.tag == section)

    def settings(self, section: str) -> dict[str, str]:
        """The attributes of all sections of this tag; a later one counts."""
        return {
            name: value for node in self.all(section) for name, value in node.attributes.items()
        }

    def attributes(self, node: Node, kind: str) -> Attributes:
        """The attributes of an element, with those of its class, or of the class `kind` of all
        elements around it."""
        name = node.attributes.get("class", kind)
        if name not in self.classes:
            self.problems.add(
                "UNKNOWN_NAME",
                node.where,
                f"the class '{name}' is not known",
                value=name,
                limit=", ".join(self.classes),
            )
        own = self.classes.get(name, {}).get(ALIASES.get(node.tag, node.tag), {})
        return Attributes(own | node.attributes, f"{node.where} {node.tag}", self.problems)


@dataclass
class Attributes:
    """The attributes of an element, as text or as numbers."""

    values: dict[str, str]
    where: str
    problems: Problems

    def __contains__(self, name: str) -> bool:
        return name in self.values

    def text(self, name: str, default: str = "") -> str:
        return self.values.get(name, default)

    def flag(self, name: str, default: bool = False) -> bool:
        return self.values.get(name, str(default)).lower() == "true"

    def row(self, name: str, default: Any = (), sizes: tuple[int, ...] = ()) -> np.ndarray:
        """Numbers separated by blanks. Errors: NOT_A_NUMBER, NON_FINITE, BAD_SHAPE if their count
        is none of `sizes`."""
        if name not in self.values:
            return np.array(default, float)
        text = self.values[name]
        try:
            numbers = np.array([float(word) for word in text.split()])
        except ValueError:
            self.problems.add(
                "NOT_A_NUMBER",
                f"{self.where} {name}",
                f"is '{text:.60}'",
                value=text,
                limit="numbers with blanks between",
            )
            return np.array(default, float)
        if sizes and len(numbers) not in sizes:
            self.problems.add(
                "BAD_SHAPE",
                f"{self.where} {name}",
                f"has {len(numbers)} numbers",
                value=text,
                limit=" or ".join(map(str, sizes)),
            )
            return np.array(default, float)
        if not np.isfinite(numbers).all():
            self.problems.add(
                "NON_FINITE", f"{self.where} {name}", f"is '{text:.60}'", value=text, limit="finite"
            )
            return np.array(default, float)
        return numbers

    def number(self, name: str, default: float = 0.0) -> float:
        return float(self.row(name, [default], (1,))[0])

    def vector(self, name: str, default: Any = (0, 0, 0)) -> np.ndarray:
        return self.row(name, default, (3,))


def read_document(path: Path, largest: float) -> MjcfDocument:
    """The document in a file.

    Errors: those of files, SYNTAX, ENCODING, WRONG_KIND for a document type, WRONG_FORMAT,
    TOO_LARGE, OUTSIDE_FOLDER, LOOP."""
    with Problems() as problems:
        root = _content(path, path.parent, largest, set())
        sections = root.children
    classes: dict[str, dict[str, dict[str, str]]] = {MAIN: {}}
    for node in sections:
        if node.tag == "default":
            _collect(node, MAIN, {}, classes)
            classes[node.attributes.get("class", MAIN)] = classes[MAIN]
    return MjcfDocument(root.tag, sections, classes, problems)


def _content(path: Path, folder: Path, largest: float, read: set[Path]) -> Node:
    """The root of a file, with the elements of the files that it includes in their places."""
    root = _parsed(path, largest)
    if root.tag not in ROOTS and not read:
        raise JaxbodyError(
            Problem(
                "WRONG_FORMAT",
                root.where,
                f"has the root element '{root.tag:.60}'",
                root.tag,
                ", ".join(ROOTS),
                "Is it another XML file?",
            )
        )
    read.add(path)
    _include(root, folder, largest, read)
    return root


def _include(node: Node, folder: Path, largest: float, read: set[Path]) -> None:
    children: list[Node] = []
    for child in node.children:
        if child.tag != "include":
            _include(child, folder, largest, read)
            children.append(child)
            continue
        name = child.attributes.get("file", "")
        if not name or Path(name).is_absolute() or ".." in Path(name).parts:
            raise JaxbodyError(
                Problem(
                    "OUTSIDE_FOLDER",
                    child.where,
                    f"includes '{name}'",
                    name,
                    "a file in the folder of this one",
                    "Copy it there.",
                )
            )
        if folder / name in read:
            raise JaxbodyError(
                Problem("LOOP", child.where, f"includes '{name}' once more", name, "each file once")
            )
        children += _content(folder / name, folder, largest, read).children
    node.children = children


def _parsed(path: Path, largest: float) -> Node:
    """The root element of a file; entities and document types are refused before anything
    is expanded."""
    check_file(path, largest)
    parser, root = expat.ParserCreate(), Node("", {}, path.name)
    around = [root]

    def start(tag: str, attributes: dict[str, str]) -> None:
        node = Node(tag, attributes, f"{path.name}:{parser.CurrentLineNumber}")
        if len(around) > DEEPEST:
            raise JaxbodyError(
                Problem(
                    "TOO_LARGE",
                    node.where,
                    "is nested too deep",
                    limit=f"{DEEPEST} levels",
                    hint="Is it a model?",
                )
            )
        around[-1].children.append(node)
        around.append(node)

    def refuse(*_: Any) -> None:
        where = f"{path.name}:{parser.CurrentLineNumber}"
        raise JaxbodyError(
            Problem(
                "WRONG_KIND",
                where,
                "declares a document type",
                limit="elements and attributes",
                hint=NO_DTD,
            )
        )

    parser.StartElementHandler = start
    parser.EndElementHandler = lambda _: around.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        message = re.sub(r": line \d+, column (\d+)", r", column \1", str(error))
        raise JaxbodyError(
            Problem(
                "SYNTAX", f"{path.name}:{error.lineno}", message, hint="Is it the XML of a model?"
            )
        ) from None
    except JaxbodyError:
        raise
    except (LookupError, ValueError) as error:  # the encoding that the file states
        raise JaxbodyError(
            Problem("ENCODING", path.name, str(error), hint="Save it as UTF-8.")
        ) from None
    return root.children[0]


def _collect(
    node: Node,
    name: str,
    inherited: dict[str, dict[str, str]],
    classes: dict[str, dict[str, dict[str, str]]],
) -> None:
    """The attributes that a class states, on top of those of the class around it."""
    mine = {tag: dict(values) for tag, values in (classes.get(name) or inherited).items()}
    for child in node.children:
        if child.tag != "default":
            mine[child.tag] = mine.get(child.tag, {}) | child.attributes
    classes[name] = mine
    for child in node.all("default"):
        _collect(child, child.attributes.get("class", MAIN), mine, classes)
