"""Draws the pictures of the notebooks: `python examples/images/draw.py [NAME ...]` runs them and
saves the `figure` of each beside this file as NAME.png."""

import os
import runpy
import sys
from pathlib import Path

import matplotlib
from PIL import Image  # of matplotlib's own requirements

HERE = Path(__file__).resolve().parent
COLORS = 64  # a palette of so many keeps a picture small, without a difference that is seen


def notebooks() -> list[Path]:
    """The examples that open as notebooks: they start with a header for Jupyter."""
    return [
        path
        for path in sorted(HERE.parent.glob("*.py"))
        if path.read_text().startswith("# ---\n# jupyter:\n")
    ]


def save(figure, picture: Path) -> None:
    """Save a figure of matplotlib with few colors."""
    figure.savefig(picture, dpi=110)
    with Image.open(picture) as image:
        image.convert("RGB").quantize(COLORS).save(picture, optimize=True)
    print(f"{picture}: {picture.stat().st_size / 1000:.0f} kB")


if __name__ == "__main__":
    matplotlib.use("Agg")
    os.chdir(HERE.parent)  # where Jupyter runs them
    for path in [HERE.parent / f"{name}.py" for name in sys.argv[1:]] or notebooks():
        save(runpy.run_path(str(path))["figure"], HERE / f"{path.stem}.png")
