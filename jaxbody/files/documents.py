"""Documents: the content of a TOML or JSON file as dicts, lists, strings and numbers, with the line
number of each entry, and new values for entries from texts such as "left.stiffness=30 N/mm".

Python's own parsers read the values. Before that, a scan of headings, keys and items finds their
line numbers, duplicate names, and nesting that is too deep. Nothing in a file is executed.
"""

import fnmatch
import itertools
import json
import re
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, NamedTuple

from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.core.source_files import check_file, decoded, extension_of
from jaxbody.files.quantities import table_of

EntryPath = tuple[str | int, ...]  # path of an entry: ("elements", "AB", "a", 1)
# {name of a type in files of earlier versions: its current name}
EARLIER_TYPES = {"Stop": "BumpStop", "Table": "Tabulated", "Tilt": "Inclinometer"}
DEEPEST = 20
LARGEST = 2e7  # default of the largest size of a file [bytes]
# bytes of memory per byte of a document; 55 were measured for a model of 10 000 springs
MEMORY = 60.0
TOKEN = re.compile(
    r'(?P<string>"""(?:[^\\]|\\.)*?"""|\'\'\'.*?\'\'\'|"(?:[^"\\\n]|\\.)*"|\'[^\'\n]*\')'
    r"|(?P<skip>#[^\n]*|[ "
    r"\t\r]+)|(?P<newline>\n)|(?P<sign>[\[\]{}=:,.])|(?P<bare>[^\s\[\]{}=:,.\"'#]+|.)",
    re.DOTALL,
)


class Token(NamedTuple):
    """A token of a document and its line number; `kind`: string, bare (a word or a number), sign,
    newline or end."""

    kind: str
    text: str
    line: int


@dataclass
class Document:
    """The content of a file, and the line number of each entry by its path."""

    name: str
    values: dict[str, Any]
    lines: dict[EntryPath, int] = field(default_factory=dict)
    replaced: dict[EntryPath, str] = field(default_factory=dict)  # text of the option `--set`

    def where(self, path: EntryPath) -> str:
        """Return the place of an entry as text, such as "engine.toml:41 elements.AB.stiffness". The
        line is that of the entry, or of the nearest enclosing entry with a known line."""
        around = [path[:n] for n in range(len(path), 0, -1)]
        for entry in around:
            if entry in self.replaced:
                return f"{self.name} with {self.replaced[entry]}"
        line = next((self.lines[entry] for entry in around if entry in self.lines), None)
        if line is None:  # of a section that only entries below it open, [element.fl]
            below = (n for entry, n in self.lines.items() if entry[: len(path)] == path)
            line = next(below, None)
        line = "" if line is None else f":{line}"
        return f"{self.name}{line} {shown(path)}".rstrip()


def shown(path: EntryPath) -> str:
    """Return a path as text, such as elements.AB.a[1]."""
    parts = (
        f"[{part}]"
        if isinstance(part, int)
        else f".{part}"
        if re.fullmatch(r"[\w-]+", part)
        else f".{part!r}"
        for part in path
    )
    return "".join(parts).removeprefix(".")


def read_document(path: Path, largest: float = LARGEST) -> Document:
    """Read a .toml or .json file in UTF-8; `largest`: largest size of the file [bytes].

    Errors: NO_FILE, IS_DIRECTORY, NOT_A_FILE, EMPTY_FILE, TOO_LARGE, ENCODING, WRONG_FORMAT,
    UNKNOWN_FORMAT, SYNTAX, DUPLICATE_NAME."""
    check_file(path, largest, MEMORY, "--largest")
    kind = extension_of(path, ".toml", ".json", hint="A model file is TOML or JSON.")
    return parse_document(decoded(path.read_bytes(), path.name, "utf-8"), path.name, kind[1:])


def parse_document(text: str, name: str, kind: str = "toml") -> Document:
    """Parse a text in the format `kind`, "toml" or "json"; `name` is the name of its file in
    messages."""
    document = Document(name, {})
    text = text.replace("\r\n", "\n")
    with Problems() as problems:
        scan = Scan(text, document, problems, kind)
        scan.value(()) if kind == "json" else scan.statements()
    try:
        document.values = tomllib.loads(text) if kind == "toml" else json.loads(text)
    except (ValueError, RecursionError) as error:
        raise JaxbodyError(_syntax(error, text, document)) from None
    if not isinstance(document.values, dict):
        raise JaxbodyError(
            Problem(
                "SYNTAX",
                name,
                "has no names at its top",
                limit="an object with names",
                hint="Begin with {.",
            )
        )
    return document


def with_current_types(value: Any) -> Any:
    """Return a value of a document with earlier names of types replaced by the current ones."""
    if isinstance(value, list):
        return [with_current_types(each) for each in value]
    if not isinstance(value, dict):
        return value
    current = {name: with_current_types(each) for name, each in value.items()}
    if isinstance(current.get("type"), str):
        current["type"] = EARLIER_TYPES.get(current["type"], current["type"])
    return current


def _syntax(error: Exception, text: str, document: Document) -> Problem:
    """Return the problem of a text that its parser rejects."""
    message = str(error).partition(" (at ")[0].partition(": line ")[0]
    place = re.search(r"\(?(?:at )?line (\d+),? column (\d+)", str(error))
    line, column = (
        (place[1], f", column {place[2]}") if place else (text.rstrip().count("\n") + 1, "")
    )
    return Problem(
        "SYNTAX",
        f"{document.name}:{line}",
        f"{message[:1].lower()}{message[1:].partition(';')[0]}{column}",
        hint='Words and units need quotation marks: stiffness = "21 N/mm".'
        if message.startswith("Invalid value")
        else "",
    )


class Scan:
    """One pass over the text of a document, which records line numbers and duplicate names. It
    accepts malformed text, which is left to the parser to report."""

    def __init__(self, text: str, document: Document, problems: Problems, kind: str):
        self.document, self.problems = document, problems
        self.rest: Iterator[Token] = _tokens(
            text, ("skip", "newline") if kind == "json" else ("skip",)
        )
        self.token = next(self.rest)
        self.headings: set[EntryPath] = set()
        self.counts: dict[EntryPath, int] = {}  # number of tables in each array of tables

    def next(self) -> Token:
        """Return the current token and advance to the next one."""
        token, self.token = self.token, next(self.rest)
        return token

    def takes(self, sign: str) -> bool:
        """Advance past a sign and return True if it is the current token, else return False."""
        return self.token.text == sign and self.token.kind == "sign" and bool(self.next())

    def skip_lines(self) -> None:
        while self.token.kind == "newline":
            self.next()

    def statements(self) -> None:
        """Scan a TOML text, and record the line of each heading and key in the document."""
        table: EntryPath = ()
        while self.token.kind != "end":
            self.skip_lines()
            if self.takes("["):
                table = self.heading(self.takes("["))
            elif self.token.kind != "end":
                self.entry(table)
            while self.token.kind not in ("newline", "end"):
                self.next()

    def heading(self, several: bool) -> EntryPath:
        """Scan a heading and return the path of its table: [a.b], or, if `several`, the next table
        of an array of tables, [[a.b]]."""
        line, names = self.token.line, self.names(("]",))
        path: EntryPath = ()
        for name in names:
            path = (*self.last(path), name)
        if several:
            self.counts[path] = self.counts.get(path, 0) + 1
            path = self.last(path)
        self.note(path, line, path in self.headings and not several)
        self.headings.add(path)
        return path

    def last(self, path: EntryPath) -> EntryPath:
        """Return the path of a table; for an array of tables, that of its last table so far."""
        return (*path, self.counts[path] - 1) if path in self.counts else path

    def entry(self, table: EntryPath, depth: int = 1) -> None:
        """Scan an entry, key = value or "key": value, of a table."""
        line, names = self.token.line, self.names(("=", ":"))
        path = (*table, *names)
        for n in range(1, len(names)):
            self.document.lines.setdefault((*table, *names[:n]), line)
        self.note(path, line, path in self.document.lines)
        self.value(path, depth + len(names))

    def note(self, path: EntryPath, line: int, twice: bool) -> None:
        if twice and path:
            self.problems.add(
                "DUPLICATE_NAME",
                f"{self.document.name}:{line} {shown(path)}",
                f"is stated twice, first in line {self.document.lines[path]}",
                value=path[-1],
                hint="Rename one, or delete it.",
            )
        self.document.lines[path] = line

    def names(self, ends: tuple[str, ...]) -> list[str]:
        """Return the parts of a dotted name up to one of the signs `ends`, which is skipped, or up
        to the end of the line."""
        names: list[str] = []
        while self.token.kind not in ("newline", "end") and not any(map(self.takes, ends)):
            token = self.next()
            if token.kind != "sign":
                names.append(toml_value(token.text) if token.kind == "string" else token.text)
        if len(names) > DEEPEST:
            self.too_deep(self.token.line)
        return names

    def value(self, path: EntryPath, depth: int = 0) -> None:
        """Scan an array, a table in braces, or any other value up to the next comma, bracket or end
        of the line."""
        if depth > DEEPEST:
            self.too_deep(self.token.line)
        if self.takes("{"):
            for _ in self.items("}"):
                self.entry(path, depth)
        elif self.takes("["):
            for i in self.items("]"):
                token, self.document.lines[(*path, i)] = self.token, self.token.line
                self.value((*path, i), depth + 1)
                if self.token is token:  # a sign that belongs to no value
                    self.next()
        else:
            while self.token.kind not in ("newline", "end") and not (
                self.token.kind == "sign" and self.token.text in ",]}"
            ):
                self.next()

    def items(self, end: str) -> Iterator[int]:
        """Yield the index of each item between brackets, with its first token as the current one,
        up to the closing sign `end`."""
        for i in itertools.count():
            self.skip_lines()
            if self.token.kind == "end" or self.takes(end):
                return
            yield i
            self.skip_lines()
            self.takes(",")

    def too_deep(self, line: int) -> None:
        raise JaxbodyError(
            Problem(
                "TOO_LARGE",
                f"{self.document.name}:{line}",
                f"is nested more than {DEEPEST} levels deep",
                limit=f"{DEEPEST} levels",
                hint="A model file needs a few levels only.",
            )
        )


def _tokens(text: str, skipped: tuple[str, ...]) -> Iterator[Token]:
    line = 1
    for match in TOKEN.finditer(text):
        kind, content = str(match.lastgroup), match.group()
        if kind not in skipped:
            yield Token(kind, content, line)
        line += content.count("\n")
    while True:
        yield Token("end", "", line)


# sections with names that are unique in a model
SECTIONS = (
    "bodies",
    "supports",
    "elements",
    "closures",
    "controllers",
    "energies",
    "dissipations",
)


def set_value(document: Document, text: str) -> None:
    """Set an entry of a document from a text such as "left.stiffness=30 N/mm".

    The path before the equals sign names an entry of a body, support, element, closure or
    controller, or of another section, such as "motion.road.frequency" or "records.run1.file";
    "strut.spring.0" is the first of several laws. The name of an object of the model may contain *
    and ?, as in file names: the entry is set in all objects that match and have it. Errors: SYNTAX,
    UNKNOWN_NAME."""
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
        _put(things[path], below, toml_value(value.strip()), text)
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


def toml_value(text: str) -> Any:
    """Return a text parsed as a TOML value, or unchanged if it is not one."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except ValueError:
        return text
