"""MJCF documents: the elements of an XML file with their line numbers, included files in place,
attributes with the defaults of their class."""

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

MAIN = "main"  # the default class of elements that state none
ALIASES = {"spatial": "tendon", "fixed": "tendon"}  # names of tags in default classes


@dataclass
class Node:
    """An element of an XML file."""

    tag: str
    attributes: dict[str, str]
    where: str  # "engine.xml:12"
    children: list[Node] = field(default_factory=list)

    def all(self, tag: str) -> Iterator[Node]:
        """Return the children with this tag."""
        return (child for child in self.children if child.tag == tag)

    def within(self) -> Iterator[Node]:
        """Yield all elements below this one, in the order of the file."""
        for child in self.children:
            yield child
            yield from child.within()


@dataclass
class MjcfDocument:
    """An MJCF or URDF file with the files that it includes: its `root` element, and `classes`,
    {class: {tag of elements: default attributes}}."""

    root: Node
    classes: dict[str, dict[str, dict[str, str]]]
    problems: Problems

    def settings(self, section: str) -> Attributes:
        """Return the attributes of all sections with this tag; a later section overrides an earlier
        one."""
        values = {
            name: value
            for node in self.root.all(section)
            for name, value in node.attributes.items()
        }
        return Attributes(values, f"{self.root.where.rpartition(':')[0]} {section}", self.problems)

    def attributes(self, node: Node, kind: str) -> Attributes:
        """Return the attributes of an element, with the defaults of its class, or, where it states
        none, of the class `kind` of the elements around it."""
        name = node.attributes.get("class", kind)
        if name not in self.classes:
            self.problems.add(
                "UNKNOWN_NAME",
                node.where,
                f"the class '{name}' is not known",
                value=name,
                limit=", ".join(self.classes),
            )
        of_class = self.classes.get(name, {}).get(ALIASES.get(node.tag, node.tag), {})
        return Attributes(of_class | node.attributes, f"{node.where} {node.tag}", self.problems)


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
        """Return the numbers of an attribute, separated by blanks; `default` where it is missing or
        wrong. Problems: NOT_A_NUMBER, NON_FINITE, BAD_SHAPE if their count is none of `sizes`."""
        numbers = self.problems.gather(
            lambda: _numbers(self.values.get(name), f"{self.where} {name}", sizes)
        )
        return np.array(default, float) if numbers is None else numbers

    def number(self, name: str, default: float = 0.0) -> float:
        return float(self.row(name, [default], (1,))[0])

    def vector(self, name: str, default: Any = (0, 0, 0)) -> np.ndarray:
        return self.row(name, default, (3,))


def _numbers(text: str | None, where: str, sizes: tuple[int, ...]) -> np.ndarray | None:
    if text is None:
        return None
    try:
        numbers = np.array([float(word) for word in text.split()])
    except ValueError:
        raise JaxbodyError(
            Problem("NOT_A_NUMBER", where, f"is '{text:.60}'", text, "numbers with blanks between")
        ) from None
    if sizes and len(numbers) not in sizes:
        raise JaxbodyError(
            Problem(
                "BAD_SHAPE",
                where,
                f"has {len(numbers)} numbers",
                text,
                " or ".join(map(str, sizes)),
            )
        )
    if not np.isfinite(numbers).all():
        raise JaxbodyError(Problem("NON_FINITE", where, f"is '{text:.60}'", text, "finite"))
    return numbers


def read_document(path: Path, largest: float) -> MjcfDocument:
    """Read an MJCF or URDF file with the files that it includes; `largest`: largest size of each
    [bytes].

    Errors: those of files, SYNTAX, ENCODING, WRONG_KIND for a document type, WRONG_FORMAT,
    TOO_LARGE, OUTSIDE_FOLDER, LOOP."""
    root = _content(path, path.parent, largest, set())
    classes: dict[str, dict[str, dict[str, str]]] = {MAIN: {}}
    for node in root.all("default"):
        _collect(node, MAIN, {}, classes)
        classes[node.attributes.get("class", MAIN)] = classes[MAIN]
    return MjcfDocument(root, classes, Problems())


def _content(path: Path, folder: Path, largest: float, read: set[Path]) -> Node:
    """Return the root of a file, with the elements of included files in place; `read`: files read
    so far."""
    root = _parsed(path, largest)
    if root.tag not in ("mujoco", "robot") and not read:
        raise JaxbodyError(
            Problem(
                "WRONG_FORMAT",
                root.where,
                f"has the root element '{root.tag:.60}'",
                root.tag,
                "mujoco, robot",
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
    """Return the root element of a file. Document types, and with them entities, are rejected
    before anything is expanded."""
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
        raise JaxbodyError(
            Problem(
                "WRONG_KIND",
                f"{path.name}:{parser.CurrentLineNumber}",
                "declares a document type",
                limit="elements and attributes",
                hint="Entities can make a small file endless: write their text in their places.",
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
    except (LookupError, ValueError) as error:  # unknown or wrong encoding
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
    """Collect the default attributes of a class, on top of those of the class around it."""
    classes[name] = dict(classes.get(name) or inherited)
    for child in node.children:
        if child.tag != "default":
            classes[name][child.tag] = classes[name].get(child.tag, {}) | child.attributes
    for child in node.all("default"):
        _collect(child, child.attributes.get("class", MAIN), classes[name], classes)
