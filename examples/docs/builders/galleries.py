"""Pages of the gallery: every picture of examples/images with the script that makes it, every
example, every notebook."""

import ast
import re
from pathlib import Path

import jupytext
import nbformat

WIDE = ("---", "hide-toc: true", "---", "")


def pages(root: Path) -> dict[str, str]:
    """The gallery, a page for each example and each notebook, by path."""
    paths = sorted((root / "examples").glob("*.py"))
    notebooks = [path for path in paths if is_notebook(path)]
    scripts = [path for path in paths if path not in notebooks]
    found = {"gallery.md": _gallery(root, scripts, notebooks)}
    found |= {f"examples/{path.stem}.md": _example(path) for path in scripts}
    return found | {f"notebooks/{path.stem}.ipynb": _notebook(root, path) for path in notebooks}


def _gallery(root: Path, scripts: list[Path], notebooks: list[Path]) -> str:
    lines = [
        *WIDE,
        "# Gallery",
        "",
        "Every picture with the script that makes it; then all examples and notebooks.",
        "",
    ]
    for image in sorted(
        path
        for path in (root / "examples" / "images").iterdir()
        if path.suffix in (".png", ".gif", ".jpg", ".svg")
    ):
        script = maker(root, image.name)
        made = f"[{script}](examples/{script.stem}.md)"
        if is_notebook(root / script):
            made = f"[{script}](notebooks/{script.stem}.ipynb)"
        about = first_paragraph(root / script)
        lines += [
            f"```{{figure}} ../../images/{image.name}",
            f":alt: {about}",
            "",
            f"{about} Made by {made}.",
            "```",
            "",
        ]
    lines += [
        "## Plots of results",
        "",
        (
            "What `.plot()` of each result, and `jb.plots`, show; drawn by "
            "[gallery.py](examples/gallery.md)."
        ),
        "",
    ]
    plots = sorted((root / "examples" / "images" / "gallery").glob("*.png"))
    lines += [f"![{path.stem}](../../images/gallery/{path.name}){{width=32%}}" for path in plots]
    lines += [
        "",
        "## Examples",
        "",
        *(f"- [{path.stem}](examples/{path.stem}.md): {first_paragraph(path)}" for path in scripts),
        "",
    ]
    lines += ["## Notebooks", "", "Scripts that Jupyter opens as notebooks with jupytext.", ""]
    lines += [*(f"- [{title(path)}](notebooks/{path.stem}.ipynb)" for path in notebooks), ""]
    listing = [f"examples/{path.stem}" for path in scripts] + [
        f"notebooks/{path.stem}" for path in notebooks
    ]
    return "\n".join([*lines, "```{toctree}", ":hidden:", "", *listing, "```", ""])


def is_notebook(path: Path) -> bool:
    """Whether a script has the header by which Jupyter opens it."""
    return path.read_text().startswith("# ---\n# jupyter:\n")


def maker(root: Path, image: str) -> Path:
    """The script that makes a picture: the one that names it, or has its name."""
    stem = Path(image).stem
    for path in sorted((root / "examples").rglob("*.py")):
        if path.stem == stem or re.search(
            rf"\b{re.escape(image)}\b|/ \"{re.escape(image)}\"", path.read_text()
        ):
            return path.relative_to(root)
    raise LookupError(
        f"no script in examples/ names {image}: write its name into the docstring of the "
        "script that makes it"
    )


def title(path: Path) -> str:
    return re.search(r"^# # (.*)$", path.read_text(), re.M)[1]


def first_paragraph(path: Path) -> str:
    """The first paragraph of a script's docstring; of a notebook its title."""
    docstring = ast.get_docstring(ast.parse(path.read_text()))
    return " ".join(docstring.split("\n\n")[0].split()) if docstring else title(path) + "."


def _example(path: Path) -> str:
    about = ast.get_docstring(ast.parse(path.read_text())) or ""
    text = re.sub(r"(?m)^    .*(?:\n    .*)*$", lambda found: f"```text\n{found[0]}\n```", about)
    source = f"```{{literalinclude}} ../../../{path.name}\n:start-at: import\n```"
    return (
        f"---\nhide-toc: true\n---\n\n# {path.name}\n\n{text}\n\n"
        f"To run it: `python examples/{path.name}`\n\n{source}\n"
    )


def _notebook(root: Path, path: Path) -> str:
    """The notebook with its results, if `out/notebooks` has a run of it as it is now; without
    results otherwise."""
    notebook = jupytext.read(path)
    run = root / "out" / "notebooks" / f"{path.stem}.ipynb"
    if run.exists():
        done = nbformat.read(run, as_version=4)
        if [cell.source for cell in done.cells] == [cell.source for cell in notebook.cells]:
            notebook = done
    for number, cell in enumerate(notebook.cells):
        cell["id"] = f"cell-{number}"  # jupytext draws them anew each time
    return nbformat.writes(notebook)
