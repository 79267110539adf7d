"""Reports read again: headings, tables and pictures, and the golden files of them."""

import json
from html.parser import HTMLParser
from pathlib import Path

GOLDEN = Path(__file__).parent / "golden"


class Page(HTMLParser):
    """Headings, tables as rows of cells, captions of pictures, and all that is referred to."""

    def __init__(self, path):
        super().__init__()
        self.headings, self.tables, self.pictures, self.links, self.notes = [], [], [], [], []
        self.summary = []  # lines of the summary: what results say, and their status
        self.inside = ""
        self.feed(path.read_text())
        self.close()

    def handle_starttag(self, tag, attributes):
        stated = dict(attributes)
        self.links += [
            stated[name] for name in ("src", "href", "srcset", "action") if name in stated
        ]
        self.inside = tag + (f".{stated['class']}" if "class" in stated else "")
        if tag == "table":
            self.tables.append([])
        elif tag == "tr":
            self.tables[-1].append([])
        elif tag in ("th", "td"):
            self.tables[-1][-1].append("")
        elif tag == "img":
            assert stated["alt"]
            self.pictures.append(stated["alt"])

    def handle_data(self, text):
        if self.inside in ("h1", "h2"):
            self.headings.append(text)
        elif self.inside.split(".")[0] in ("th", "td"):
            self.tables[-1][-1][-1] += text
        elif self.inside in ("p", "p.ok", "p.failed"):
            self.summary += text.splitlines()
        elif self.inside == "p.note":
            self.notes.append(text)


def cell(page, row, heading):
    """The cell of a row under a heading, of the one table that has both."""
    found = {
        line[table[0].index(heading)]
        for table in page.tables
        if heading in table[0]
        for line in table[1:]
        if line[0] == row
    }
    (text,) = found
    return _number(text)


def numbers(page):
    """The cells of all tables, with numbers as such."""
    return [[[_number(cell) for cell in row] for row in table] for table in page.tables]


def _number(cell):
    try:
        return float(cell)
    except ValueError:
        return cell


def check_golden(name, page):
    """Structure as it was; numbers, also those in a text, to 1e-3, as an optimum is found to its
    tolerance; zeros by rounding errors."""
    known = json.loads((GOLDEN / f"{name}.json").read_text())
    assert page.headings == known["headings"] and page.pictures == known["pictures"]
    assert [[len(row) for row in table] for table in page.tables] == [
        [len(row) for row in table] for table in known["tables"]
    ]
    found, expected = (
        [
            _number(word)
            for table in tables
            for row in table
            for cell in row
            for word in str(cell).split()
        ]
        for tables in (numbers(page), known["tables"])
    )
    for word, other in zip(found, expected, strict=True):
        assert word == other or abs(word - other) <= 1e-3 * abs(other) + 1e-9
