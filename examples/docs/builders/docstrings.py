"""Docstrings of jaxbody, which are plain text with formulas, as reStructuredText."""

import re
import textwrap

from jaxbody.core.codes import CODES

LABELS = ("Errors", "Error", "Warns", "Source", "Sources")


def to_rst(text: str) -> list[str]:
    """The lines of a docstring: prose escaped, names and codes linked, formulas and examples as
    they stand, arguments as a list."""
    lines: list[str] = []
    for block in _blocks(text.splitlines()):
        if block[0].lstrip().startswith(">>>"):
            lines += textwrap.dedent("\n".join(block)).splitlines()
        elif block[0].startswith("    "):
            lines += [".. code-block:: text", "", *block]
        elif block[0] in ("Args:", "Arguments:"):
            lines += _arguments(block[1:])
        elif block[0].startswith("- "):
            lines += [
                part
                for item in re.split(r"\n(?=- )", "\n".join(block))
                for part in ["- " + _prose(item[2:]), ""]
            ]
        else:
            lines += _paragraphs(" ".join(line.strip() for line in block))
        lines.append("")
    return lines


def _blocks(lines: list[str]) -> list[list[str]]:
    """Parts of a docstring between blank lines; an example and a list begin a new part, and a list
    of arguments has no blank lines."""
    blocks: list[list[str]] = [[]]
    for line in lines:
        last = blocks[-1]
        starts = line.lstrip().startswith(">>>") and last and not last[0].lstrip().startswith(">>>")
        starts = starts or (line.startswith("- ") and last and not last[0].startswith("- "))
        if not line.strip() or starts:
            blocks.append([])
        if line.strip():
            blocks[-1].append(line.rstrip())
    return [block for block in blocks if block]


def _arguments(lines: list[str]) -> list[str]:
    entries: list[list[str]] = []
    for line in lines:
        found = re.match(r" {4}([\w, *]+): (.*)", line)
        if found:
            entries.append([found[1], found[2]])
        else:
            entries[-1][1] += " " + line.strip()
    result = ["**Arguments**", ""]
    for names, text in entries:
        result += [
            ", ".join(f"``{name.strip()}``" for name in names.split(",")),
            f"   {_prose(text)}",
            "",
        ]
    return result


def _paragraphs(text: str) -> list[str]:
    """A paragraph, cut before the sentences that state errors or the source."""
    parts = re.split(rf"(?:^|(?<=[.;)] ))(?=(?:{'|'.join(LABELS)})\b)", text)
    result: list[str] = []
    for part in filter(None, (part.strip() for part in parts)):
        label = re.match(rf"({'|'.join(LABELS)})(:|,[^:]*:)? ", part)
        rest = part[label.end() :] if label else part
        result += [
            (f"**{label[1]}{(label[2] or '').rstrip(':')}** " if label else "") + _prose(rest),
            "",
        ]
    return result


def _prose(text: str) -> str:
    """Text with its special characters escaped; code in backquotes stays code, an error code links
    to its entry."""
    parts = re.split(r"(`[^`]+`)", text)
    return "".join(f"`{part}`" if part[0] == "`" else _words(part) for part in parts if part)


def _words(text: str) -> str:
    text = re.sub(r"([\\*|_])", r"\\\1", text)
    return re.sub(r"\b[A-Z][A-Z0-9]*(?:\\_[A-Z0-9]+)*\b", _linked, text)


def _linked(found: re.Match) -> str:
    code = found[0].replace("\\_", "_")
    return f":ref:`{code} <code-{code.lower()}>`" if code in CODES else found[0]
