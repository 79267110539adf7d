"""Reports: results with their tables and pictures in one HTML file, which needs no network and can
be printed."""

import base64
import functools
import hashlib
import io
import platform
from collections.abc import Callable, Iterable, Iterator
from datetime import UTC, datetime
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problems
from jaxbody.core.source_files import check_file, extension_of, writing
from jaxbody.core.tables import Printed, PrintedTable, in_numpy, number
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.validations import Validation
from jaxbody.motion.trajectories import Trajectory
from jaxbody.vibration.linearizations import Linearization
from jaxbody.vibration.natural_modes import modes
from jaxbody.views import plots
from jaxbody.views.plots.plots_of_results import picture_of

Pictures = Iterable[tuple[str, Any]]  # (caption, axes); a caption without axes is printed as a note
MOST_MODES = 6  # largest number of modes that are drawn
MOST_RECORDS = 6  # largest number of records of a fit that are drawn
LARGEST_DRAWING = 300_000  # largest size of a vector drawing [bytes]; others are drawn in pixels
LIBRARIES = ("jaxbody", "jax", "jaxlib", "diffrax", "numpy", "scipy")

STYLE = """
:root { color: #2b2f36; font: 15px/1.5 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
body { max-width: 60rem; margin: 0 auto; padding: 1rem; }
h1 { font-size: 1.7rem; line-height: 1.2; margin: .5rem 0; }
h2 { font-size: 1.25rem; margin: 2rem 0 .5rem; padding-top: .5rem; border-top: 1px solid #c5ccd6; }
nav ul { padding-left: 1.2rem; columns: 14rem; }
a { color: #1f5f9b; }
.table { overflow-x: auto; margin: .7rem 0; }
table { border-collapse: collapse; font-size: .87rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding: .2rem 0; }
th, td { padding: .15rem .8rem .15rem 0; text-align: right; white-space: nowrap; border-bottom: 1px solid #e4e8ee; }
th:first-child { text-align: left; }
thead th { border-bottom: 1px solid #8a8f98; vertical-align: bottom; }
tbody th { font-weight: 400; }
.note { font-size: .87rem; white-space: pre-line; margin: .3rem 0; }
.failed { border-left: 4px solid #b8344a; padding: .3rem .8rem; background: #fbeef0; }
.pictures { display: grid; grid-template-columns: repeat(auto-fit, minmax(min(22rem, 100%), 1fr)); gap: 1rem; align-items: end; }
.pictures > .note { grid-column: 1 / -1; }
figure { margin: .5rem 0; break-inside: avoid; }
figure img { max-width: 100%; height: auto; }
figcaption { font-size: .87rem; color: #555b66; }
footer { margin-top: 2.5rem; border-top: 1px solid #c5ccd6; font-size: .8rem; overflow-wrap: anywhere; }
@media print {
  :root { font-size: 10pt; }
  body { max-width: none; padding: 0; }
  nav { display: none; }
  h2 { break-after: avoid; }
  tr, .failed { break-inside: avoid; }
  .table { overflow: visible; break-inside: avoid; }
  th, td { white-space: normal; padding-right: .4rem; }
  a { color: inherit; text-decoration: none; }
  figure img { max-height: 18cm; }
}
@page { margin: 18mm; }
"""  # noqa: E501


# with this policy, a browser loads nothing from elsewhere and reports an attempt as an error
PAGE = (
    "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'>"
    '<meta http-equiv="Content-Security-Policy" '
    "content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'\">"
    "<meta name='viewport' content='width=device-width, initial-scale=1'>"
    "<title>{heading}</title><style>{style}</style></head>"
    "<body><main><h1>{heading}</h1>{contents}{sections}</main>{footer}</body></html>\n"
)


def report(
    results: dict[str, Any],
    path: Any,
    *,
    title: str = "",
    files: Iterable[Any] = (),
    command: str = "",
) -> Path:
    """Write a report: a section for each result, with its status, its tables and its pictures.
    Return its path.

    Args:
        results: {heading: result of jaxbody}; a section has its tables and the picture of its
            `plot`, for a linearization its modes, for a fit its records
        path: path of the file, .html; it replaces one of the same name
        title: title of the report; default: the name of the file
        files: paths of the files that the results are from; their hashes are listed
        command: command that writes the report again; it is printed at the end

    Errors: UNKNOWN_FORMAT, WRONG_KIND, NO_DATA, NO_FILE, NOT_SAVED.

    >>> import pathlib, tempfile
    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> path = pathlib.Path(tempfile.mkdtemp(), "car.html")
    >>> text = jb.report(
    ...     {"Car": car, "Modes": jb.modes(jb.linearize(car, car.reference))},
    ...     path,
    ...     title="Quarter car",
    ... ).read_text()
    >>> "<h1>Quarter car</h1>" in text, "<script" in text
    (True, False)
    """
    path = Path(path)
    with Problems() as problems:
        for name, result in results.items():
            if not isinstance(result, Printed):
                problems.add(
                    "WRONG_KIND",
                    f"report['{name}']",
                    f"is a {type(result).__name__}",
                    value=result,
                    limit="a result of jaxbody",
                )
        problems.gather(lambda: extension_of(path, ".html"))
        if not results:
            problems.add(
                "NO_DATA",
                "report.results",
                "is empty",
                limit="at least one",
                hint='Give {"Modes": modes}.',
            )
    hashes = [(Path(file).name, _hash(Path(file))) for file in files]
    sections = "".join(
        f"<section id='s{i}'>{_section(name, result)}</section>"
        for i, (name, result) in enumerate(results.items())
    )
    links = "".join(
        f"<li><a href='#s{i}'>{escape(name)}</a></li>" for i, name in enumerate(results)
    )
    page = PAGE.format(
        style=STYLE,
        heading=escape(title or path.stem),
        contents=f"<nav aria-label='Contents'><ul>{links}</ul></nav>" if len(results) > 3 else "",
        sections=sections,
        footer=_footer(hashes, command),
    )
    with writing(path):
        path.write_text(page, encoding="utf-8")
    return path


def _section(name: str, result: Any) -> str:
    """Return the HTML of the section of a result."""
    parts = [f"<h2>{escape(name)}</h2>"]
    if not np.all(getattr(result, "ok", True)):
        parts.append(f"<p class='failed'>{escape(result.report())}</p>")
    parts += map(_table, in_numpy(result)._tables())
    pictures = "".join(_figure(caption, ax) for caption, ax in _pictures(result))
    return "".join(parts) + (f"<div class='pictures'>{pictures}</div>" if pictures else "")


def _pictures(result: Any) -> Pictures:
    """Yield the captions and axes of the pictures of a result; a note for a result that cannot be
    drawn, such as a batch."""
    try:
        if type(result) in SEVERAL:
            yield from SEVERAL[type(result)](result)
        elif hasattr(result, "plot"):
            yield picture_of(type(result)).caption, result.plot()
    except JaxbodyError as error:
        yield f"Not drawn: {error}", None


def _figure(caption: str, ax: Any) -> str:
    if ax is None:
        return f"<p class='note'>{escape(caption)}</p>"
    return (
        f"<figure><img src='{_image(ax)}' "
        f"alt='{escape(caption)}'><figcaption>{escape(caption)}</figcaption></figure>"
    )


def _table(table: PrintedTable) -> str:
    caption = f"<caption>{escape(table.title)}</caption>" if table.title else ""
    head = "".join(f"<th scope='col'>{escape(column)}</th>" for column in table.columns)
    rows = [
        f"<tr><th scope='row'>{escape(number(row[0]))}</th>"
        + "".join(f"<td>{escape(number(cell))}</td>" for cell in row[1:])
        + "</tr>"
        for row in table.rows
    ]
    note = f"<p class='note'>{escape(table.note)}</p>" if table.note else ""
    return (
        "<div "
        f"class='table'><table>{caption}<thead><tr>{head}</tr></thead><tbody>{''.join(rows)}</tbody></table></div>{note}"
    )


def _image(ax: Any) -> str:
    """Return a figure as a data URI: a vector drawing, or pixels if that is large."""
    import matplotlib.pyplot as plt

    figure, data = ax.figure, io.BytesIO()
    with plt.rc_context({"svg.hashsalt": "jaxbody"}):
        figure.savefig(data, format="svg", metadata={"Date": None}, bbox_inches="tight")
    kind = "svg+xml"
    if len(data.getvalue()) > LARGEST_DRAWING:
        kind, data = "png", io.BytesIO()
        figure.savefig(
            data, format="png", dpi=170, metadata={"Software": None}, bbox_inches="tight"
        )
    plt.close(figure)
    return f"data:image/{kind};base64,{base64.b64encode(data.getvalue()).decode()}"


def _hash(path: Path) -> str:
    check_file(path)
    return hashlib.sha256(path.read_bytes()).hexdigest()


def _footer(hashes: list[tuple[str, str]], command: str) -> str:
    versions = ", ".join(
        [*(f"{name} {version(name)}" for name in LIBRARIES), f"Python {platform.python_version()}"]
    )
    lines = [f"Made on {datetime.now(UTC):%Y-%m-%d %H:%M} UTC with {versions}."]
    lines += [f"{escape(name)}: SHA-256 {digest}" for name, digest in hashes]
    lines += [f"Made again by <code>{escape(command)}</code>"] if command else []
    return "<footer>" + "".join(f"<p>{line}</p>" for line in lines) + "</footer>"


def _of_modes(lin: Linearization) -> Iterator[tuple[str, Any]]:
    """Yield pictures of the first natural modes."""
    natural = modes(lin)
    for i, (f, name) in enumerate(
        zip(np.asarray(natural.frequency)[:MOST_MODES], natural.names, strict=False), 1
    ):
        yield f"Mode {i}, {f:.4g} Hz, {name}", plots.draw_mode(lin, natural, i)


def _of_motion(run: Trajectory) -> Iterator[tuple[str, Any]]:
    yield picture_of(Trajectory).caption, run.plot()
    yield "Forces of the elements", plots.plot_forces(run)


def _of_fit(fit: Fit) -> Pictures:
    """Yield pictures of records, those with the largest misfits if there are many, and of
    correlations."""
    yield from _records(fit, "plot_fit(fit", "measured and fitted, with the residual")
    if fit.uncertainty is not None and fit.u.size > 1:
        yield "Correlations of the estimates", plots.plot_correlations(fit)


def _records(result: Fit | Validation, drawn_by: str, what: str) -> Pictures:
    """Yield pictures of records; if there are many, a note and those with the largest misfits."""
    records = [(run, sensor) for run, sensors in result.predicted.items() for sensor in sensors]
    if len(records) > MOST_RECORDS:
        yield (
            f"{MOST_RECORDS} of {len(records)} records are drawn, those with the largest residuals "
            "relative to the measured variation. "
            f"jaxbody.plots.{drawn_by}, run=..., sensor=...) draws any other.",
            None,
        )
        records = sorted(records, key=lambda record: -misfit(result, *record))[:MOST_RECORDS]
    for run, sensor in records:
        yield f"{run}, {sensor}: {what}", result.plot(run=run, sensor=sensor)


def misfit(fit: Fit | Validation, run: str, sensor: str) -> float:
    """Return the rms residual of a record relative to the variation of the measured values, or to
    their rms where they do not vary; the largest over several components. Missing samples are left
    out."""
    measured, predicted = (
        np.asarray(fit.experiments[run].measured[sensor]),
        np.asarray(fit.predicted[run][sensor]),
    )
    present = ~np.isnan(measured)

    def mean(x: np.ndarray) -> np.ndarray | np.floating:
        return np.sum(np.where(present, x, 0), 0) / np.maximum(present.sum(0), 1)

    def rms(x: np.ndarray) -> np.ndarray | np.floating:
        return np.sqrt(mean(np.abs(x) ** 2))

    variation, size = rms(measured - mean(measured)), rms(measured)
    scale = np.where(variation > 0, variation, np.where(size > 0, size, 1.0))
    return float(np.max(rms(predicted - measured) / scale))


# functions that yield pictures; other results have one picture, from `plot`
SEVERAL: dict[type, Callable[[Any], Pictures]] = {
    Linearization: _of_modes,
    Trajectory: _of_motion,
    Fit: _of_fit,
    Validation: functools.partial(
        _records,
        drawn_by="plot_validation(validation",
        what="measured, and predicted without a fit to it",
    ),
}
