"""MJCF and URDF files: their elements with line numbers, for messages; the files that they name,
which must be in their folder; their compilation by MuJoCo."""

import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any, NamedTuple
from xml.etree import ElementTree
from xml.parsers import expat

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.core.source_files import check_file

DEEPEST = 200
LONGEST = 300.0  # time limit of a compilation [s]
LAST_WORDS = 40  # words of MuJoCo's message that are shown


class Node(NamedTuple):
    """An element of an XML file, with the tags of the elements around it, from the root on, and its
    line, such as "engine.xml:12"."""

    tag: str
    around: tuple[str, ...]
    attributes: dict[str, str]
    where: str


def read_nodes(path: Path, largest: float) -> list[Node]:
    """Return the elements of an MJCF or URDF file, then those of the files that it includes;
    `largest`: largest size of each [bytes].

    Errors: those of files, SYNTAX, WRONG_KIND for a document type, WRONG_FORMAT, TOO_LARGE,
    OUTSIDE_FOLDER."""
    nodes = _parsed(path, largest, ())
    root = nodes[0]
    if root.tag not in ("mujoco", "robot"):
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
    included, folder = {path}, path.parent
    with Problems() as problems:
        for node in nodes:  # which grow by those of included files
            for name in _named_files(node) if root.tag == "mujoco" else ():
                file = folder / name
                if not file.resolve().is_relative_to(folder.resolve()):
                    problems.add(
                        "OUTSIDE_FOLDER",
                        node.where,
                        f"names '{name}'",
                        value=name,
                        limit="a file in the folder of this one",
                        hint="Copy it there.",
                    )
                elif node.tag == "include" and file not in included:
                    included.add(file)
                    nodes += _parsed(file, largest, node.around)[1:]
    return nodes


def _named_files(node: Node) -> Iterator[str]:
    """Yield the files and folders that an element of an MJCF file names. A nested model in another
    file, which may name any file, is yielded as a path outside the folder."""
    for name, value in node.attributes.items():
        if name.startswith("file") or name.endswith("dir"):
            yield value if node.tag != "model" else f"../{value}"


def _parsed(path: Path, largest: float, around: tuple[str, ...]) -> list[Node]:
    """Return the elements of a file; `around`: tags of the elements in which it is included, where
    those in its root stand. Document types, and with them entities, are rejected before anything
    is expanded; as in MuJoCo, the encoding is UTF-8, whatever is declared."""
    check_file(path, largest)
    parser, nodes, inside = expat.ParserCreate("utf-8"), [], [around]

    def start(tag: str, attributes: dict[str, str]) -> None:
        where, includes = f"{path.name}:{parser.CurrentLineNumber}", around and not nodes
        nodes.append(Node(tag, inside[-1], attributes, where))
        inside.append(around if includes else (*inside[-1], tag))
        if len(inside[-1]) > DEEPEST:
            raise JaxbodyError(
                Problem(
                    "TOO_LARGE",
                    where,
                    "is nested too deep",
                    limit=f"{DEEPEST} levels",
                    hint="Is it a model?",
                )
            )

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
    parser.EndElementHandler = lambda _: inside.pop()
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(path.read_bytes(), True)
    except expat.ExpatError as error:
        raise JaxbodyError(
            Problem(
                "SYNTAX",
                f"{path.name}:{error.lineno}",
                expat.ErrorString(error.code),
                hint="Is it the XML of a model, in UTF-8?",
            )
        ) from None
    return nodes


def compiled(path: Path, kind: str) -> dict[str, np.ndarray]:
    """Return the arrays of MuJoCo's compiled model, by their names there, of a file with the root
    element `kind`. Error: UNREADABLE with MuJoCo's message."""
    with tempfile.TemporaryDirectory() as folder:
        source, target = path.resolve(), Path(folder, "arrays.npz")
        if kind == "robot":
            source = _without_shapes(path, Path(folder, "robot.urdf"))
        program = Path(__file__).with_name("mujoco_process.py")
        try:
            subprocess.run(
                [sys.executable, "-P", program, source, target],
                check=True,
                cwd=folder,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=LONGEST,
            )
        except subprocess.TimeoutExpired:
            message = f"takes MuJoCo's compiler more than {LONGEST:g} s"
        except subprocess.CalledProcessError as error:
            message = (
                f"is refused by MuJoCo's compiler: {' '.join(error.stderr.split()[-LAST_WORDS:])}"
                if error.returncode == 1
                else f"ends MuJoCo's compiler with the exit code {error.returncode}"
            )
        else:
            with np.load(target) as arrays:
                return dict(arrays)
    raise JaxbodyError(Problem("UNREADABLE", path.name, message))


def _without_shapes(path: Path, target: Path) -> Path:
    """Write a copy of a URDF without its shapes and the files that these name; return its path."""
    tree = ElementTree.parse(path, ElementTree.XMLParser(encoding="utf-8"))
    for link in tree.iter("link"):
        for child in (*link.findall("visual"), *link.findall("collision")):
            link.remove(child)
    tree.write(target)
    return target
