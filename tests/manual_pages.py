"""Pages of the manual as they run: their blocks of Python in order, in one process, and what each
prints beside what the page shows.

python tests/manual_pages.py examples/docs/guide/models.md ... runs pages and writes what they print
into them."""

import contextlib
import io
import re
import sys
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

DOCS = Path(__file__).parents[1] / "examples" / "docs"
sys.path.append(str(DOCS.parent / "images"))
import draw  # noqa: E402

FENCE = re.compile(r"^```(?P<kind>[^\n`]*)\n(?P<text>.*?)^```\n", re.M | re.S)
PICTURE = re.compile(r"\s*!\[[^\]]*\]\((?P<path>\S*images/pages/\S+\.png)\)")
NUMBER = re.compile(r"[-+]?\d+\.?\d*(?:e[-+]?\d+)?")


@dataclass
class Block:
    """A block of code, the text that the page shows below it, the places of both, and the file of
    the picture below them."""

    code: str
    shown: str
    end: int
    shown_end: int
    picture: Path | None


def blocks(page: Path) -> list[Block]:
    """The blocks of Python of a page, whole files that it includes too; a block of text directly
    below one is what it prints."""
    source = page.read_text()
    fences, found = list(FENCE.finditer(source)), []
    for fence, after in zip(fences, [*fences, None][1:], strict=True):
        kind, code = fence["kind"].strip(), fence["text"]
        if (
            kind.startswith("{literalinclude}")
            and kind.endswith(".py")
            and ":pyobject:" not in code
        ):
            code = (page.parent / kind.split()[1]).read_text()
        elif kind != "python":
            continue
        below = (
            after is not None
            and after["kind"].strip() == "text"
            and not source[fence.end() : after.start()].strip()
        )
        shown, end = (after["text"], after.end()) if below and after else ("", fence.end())
        picture = PICTURE.match(source, end)
        path = (page.parent / picture["path"]).resolve() if picture else None
        found.append(Block(code, shown, fence.end(), end, path))
    return found


def printed(found: list[Block], name: str, *, save: bool = False) -> list[str]:
    """Return what each block prints. A block above a picture leaves a figure of matplotlib, which
    is saved if asked for."""
    names: dict = {"__name__": "__page__"}
    texts = []
    with np.printoptions():  # which a page may set for itself
        for number, block in enumerate(found):
            out = io.StringIO()
            with contextlib.redirect_stdout(out):
                exec(compile(block.code, f"{name}, block {number + 1}", "exec"), names)
            texts.append(out.getvalue())
            if block.picture:
                assert plt.get_fignums(), f"{name}: there is no figure for {block.picture.name}"
                if save:
                    draw.save(plt.gcf(), block.picture)
            plt.close("all")
    return texts


def assert_same(shown: str, text: str) -> None:
    """The same words, and numbers to a part in a thousand; the number of evaluations of a search
    may depend on the platform."""
    shown, text = (re.sub(r"\d+ (evaluations|steps)", r"\1", each) for each in (shown, text))
    assert NUMBER.sub(" # ", shown).split() == NUMBER.sub(" # ", text).split()
    numbers = [np.array([float(x) for x in NUMBER.findall(each)]) for each in (shown, text)]
    np.testing.assert_allclose(*numbers, rtol=1e-3, atol=1e-9)


def write(page: Path) -> None:
    """Put what the blocks of a page print into it."""
    source, found = page.read_text(), blocks(page)
    for block, text in reversed(
        list(zip(found, printed(found, page.name, save=True), strict=True))
    ):
        shown = (
            "\n```text\n" + re.sub(r"\n{3,}", "\n\n", text).strip("\n").rstrip() + "\n```\n"
            if text.strip()
            else ""
        )
        source = source[: block.end] + shown + source[block.shown_end :]
    page.write_text(source)


if __name__ == "__main__":
    for name in sys.argv[1:]:
        write(Path(name))
