"""Reports: results with their tables and pictures in one HTML file, which needs no network and can
be printed."""

import base64
import functools
import hashlib
import io
import platform
import re
from collections.abc import Callable, Iterable, Iterator
from dataclasses import replace
from datetime import UTC, datetime
from html import escape
from importlib.metadata import version
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.app.outcomes import fitting_modes
from jaxbody.app.report_contents import fitting, inputs, matrices, sentences, tables_of
from jaxbody.core.errors import JaxbodyError, Problems
from jaxbody.core.printed_tables import Words, text_in, unit_words
from jaxbody.core.source_files import check_file, extension_of, writing
from jaxbody.core.tables import Printed, PrintedTable, in_numpy, number
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.validations import Validation
from jaxbody.model.models import Model
from jaxbody.motion.trajectories import Trajectory
from jaxbody.vibration.linearizations import Linearization, LinearSystem
from jaxbody.vibration.natural_modes import ModalResult
from jaxbody.views import plots
from jaxbody.views.plots.plot_units import label_in
from jaxbody.views.plots.plots_of_results import picture_of

Pictures = Iterable[tuple[str, Any]]  # (caption, axes); a caption without axes is printed as a note
MOST_MODES = 6  # largest number of modes that are drawn
MOST_RECORDS = 6  # largest number of records of a fit that are drawn
LARGEST_DRAWING = 300_000  # largest size of a vector drawing [bytes]; others are drawn in pixels
NUMERIC = re.compile(r"[-+<>=.\d]|nan|$")  # the beginning of cells of a column of numbers
INSIDE_UNIT = re.compile(r" (?=[^\[]*\])")  # spaces at which a heading is not broken
LIBRARIES = ("jaxbody", "jax", "jaxlib", "diffrax", "numpy", "scipy")

STYLE = """
:root { color-scheme: light; --text: #23272e; --page: #ffffff; --faint: #555b66; --line: #d5dae1; --strong: #858b95; --link: #1b5a96;
  --good: #1a6b3c; --bad: #a3243b; --card: #f3f5f8; color: var(--text); background: var(--page);
  font: 15px/1.5 system-ui, "Segoe UI", Helvetica, Arial, sans-serif; }
@media screen and (prefers-color-scheme: dark) {
  :root { color-scheme: dark; --text: #e4e7ec; --page: #16191e; --faint: #a9b0bb; --line: #343a43; --strong: #757d89; --link: #86bdf0;
    --good: #6fce96; --bad: #f593a2; --card: #20252c; }
  figure img { background: #ffffff; padding: .5rem; border-radius: .4rem; box-sizing: border-box; }
}
body { max-width: 1400px; margin: 0 auto; padding: 1rem clamp(1rem, 3vw, 2.5rem); box-sizing: border-box; overflow-wrap: anywhere; }
h1 { font-size: 1.8rem; line-height: 1.2; margin: .5rem 0 1rem; }
h2 { font-size: 1.3rem; margin: 2.2rem 0 .6rem; padding-top: .6rem; border-top: 1px solid var(--line); }
a { color: var(--link); }
.summary { background: var(--card); padding: .4rem 1rem 1rem; border-radius: .4rem; }
.summary h2 { border: 0; margin: 0; }
dl { display: grid; grid-template-columns: fit-content(14rem) 1fr; gap: .5rem 1.2rem; margin: .5rem 0; }
dt { font-weight: 600; }
dd { margin: 0; max-width: 80rem; }
dd p { margin: 0; white-space: pre-line; }
.ok { color: var(--good); }
.failed { color: var(--bad); font-weight: 600; }
.content { display: grid; grid-template-columns: minmax(0, 1fr); gap: 0 2.5rem; align-items: start; }
@media (min-width: 1200px) { .content:has(> :nth-child(2)) { grid-template-columns: minmax(0, 3fr) minmax(0, 2fr); } }
.tables { display: flex; flex-wrap: wrap; gap: .4rem 3rem; align-items: flex-start; }
.table { max-width: 100%; overflow-x: auto; margin: .5rem 0; }
table { border-collapse: collapse; font-size: .87rem; font-variant-numeric: tabular-nums; }
caption { text-align: left; font-weight: 600; padding: .2rem 0; }
th, td { padding: .15rem 0 .15rem .9rem; text-align: right; vertical-align: top; white-space: nowrap; overflow-wrap: normal; border-bottom: 1px solid var(--line); }
thead th { border-bottom: 1px solid var(--strong); vertical-align: bottom; white-space: normal; font-weight: 600; }
tbody th { font-weight: 400; }
th:first-child { padding-left: 0; }
.text { text-align: left; }
td.text { white-space: normal; min-width: 5rem; max-width: 26rem; }
.note { font-size: .87rem; color: var(--faint); white-space: pre-line; margin: .3rem 0; flex-basis: 100%; max-width: 80rem; }
.pictures { display: grid; grid-template-columns: repeat(auto-fill, minmax(min(26rem, 100%), 1fr)); gap: 1rem 1.5rem; align-items: end; margin: .5rem 0; }
.pictures > .note { grid-column: 1 / -1; }
figure { margin: 0; break-inside: avoid; }
figure img { max-width: 100%; max-height: 36rem; }
figcaption { font-size: .87rem; color: var(--faint); }
iframe { width: 100%; height: 34rem; border: 1px solid var(--line); background: #ffffff; }
footer { margin-top: 2.5rem; border-top: 1px solid var(--line); font-size: .8rem; color: var(--faint); }
@media (max-width: 700px) { dl { display: block; } dd { margin: 0 0 .7rem; } table { font-size: .8rem; } th, td { padding-left: .5rem; } }
@media print {
  :root { font-size: 9.5pt; }
  body { max-width: none; padding: 0; }
  .summary { padding: 0; background: none; }
  h2, caption, thead { break-after: avoid; }
  tr, dd { break-inside: avoid; }
  .content, .tables { display: block; }
  .table { overflow: visible; break-inside: avoid; }
  th, td { padding-left: .6rem; }
  .pictures { grid-template-columns: 1fr 1fr; }
  a { color: inherit; text-decoration: none; }
  figure img { max-height: 11cm; }
  iframe { display: none; }
}
@page { margin: 16mm; }
"""  # noqa: E501


# with this policy, a browser loads nothing from elsewhere and reports an attempt as an error; a
# frame inherits it, so that with a view in three dimensions scripts in the page are permitted
PAGE = (
    "<!DOCTYPE html>\n<html lang='en'><head><meta charset='utf-8'>"
    '<meta http-equiv="Content-Security-Policy" '
    "content=\"default-src 'none'; img-src data:; style-src 'unsafe-inline'{policy}\">"
    "<meta name='viewport' content='width=device-width, initial-scale=1'>"
    "<title>{heading}</title><style>{style}</style></head>"
    "<body><main><h1>{heading}</h1>{sections}</main>{footer}</body></html>\n"
)
SCRIPTS = "; script-src 'unsafe-inline' 'wasm-unsafe-eval'; connect-src data: blob:"


def report(
    results: dict[str, Any],
    path: Any,
    *,
    title: str = "",
    files: Iterable[Any] = (),
    command: str = "",
    units: Any = None,
    view: bool = False,
) -> Path:
    """Write a report: a summary of what was analyzed and found, with the status of each result; the
    inputs of the models; a section for each result, with its tables and its pictures; the matrices
    of small motions. Return its path.

    Args:
        results: {heading: result of jaxbody}; a section has its tables and the picture of its
            `plot`, for a linearization its modes, for a fit its records
        path: path of the file, .html; it replaces one of the same name
        title: title of the report; default: the name of the file
        files: paths of the files that the results are from; their hashes are listed
        command: command that writes the report again; it is printed at the end
        units: units of all numbers, as in `summary` of a result: "mm", "SI", or those of a
            model file, `study.printed_units`; None: SI with six digits
        view: whether a motion, the modes or the model is shown in three dimensions, which needs
            scripts in the page, but no network, and `pip install 'jaxbody[view]'`

    Errors: UNKNOWN_FORMAT, WRONG_KIND, NO_DATA, NO_FILE, NOT_SAVED, UNKNOWN_NAME, UNKNOWN_UNIT;
    for a view MISSING_EXTRA.

    >>> import pathlib, tempfile
    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> path = pathlib.Path(tempfile.mkdtemp(), "car.html")
    >>> text = jb.report(
    ...     {"Car": car, "Modes": jb.modes(jb.linearize(car, car.reference))},
    ...     path,
    ...     title="Quarter car",
    ...     units="mm",
    ... ).read_text()
    >>> "<h1>Quarter car</h1>" in text, "<td>35</td>" in text, "<script" in text
    (True, True, False)
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
        words = None if units is None else problems.gather(lambda: unit_words(units))
        if not results:
            problems.add(
                "NO_DATA",
                "report.results",
                "is empty",
                limit="at least one",
                hint='Give {"Modes": modes}.',
            )
    hashes = [(Path(file).name, _hash(Path(file))) for file in files]
    ordered = sorted(results.items(), key=lambda item: not isinstance(item[1], Model))
    sections = [_summary(dict(ordered), words or {})]
    sections += [_section(f"s{i}", *item, words) for i, item in enumerate(ordered)]
    sections += [_view(results)] if view else []
    sections += [
        f"<section><h2>Matrices of {escape(name)}</h2><div class='tables'>{tables}</div></section>"
        for name, result in ordered
        if isinstance(result, LinearSystem)
        for tables in [_tables(matrices(in_numpy(result), words or {}), words)]
    ]
    page = PAGE.format(
        policy=SCRIPTS if view else "",
        style=STYLE,
        heading=escape(title or path.stem),
        sections="".join(sections),
        footer=_footer(hashes, command),
    )
    with writing(path):
        path.write_text(page, encoding="utf-8")
    return path


def _summary(results: dict[str, Any], words: Words) -> str:
    """Return the HTML of what each result says, with its status and its remarks."""
    entries = []
    for i, (name, result) in enumerate(results.items()):
        kind = "ok" if np.all(getattr(result, "ok", True)) else "failed"
        verdict = [result.report()] if hasattr(result, "ok") else []
        verdict = text_in("\n".join([*verdict, *getattr(result, "remarks", ())]), words)
        lines = "\n".join(sentences(in_numpy(result), words))
        entries.append(
            f"<dt><a href='#s{i}'>{escape(name)}</a></dt><dd><p>{escape(lines)}</p>"
            f"<p class='{kind}'>{escape(verdict)}</p></dd>"
        )
    return f"<section class='summary'><h2>Summary</h2><dl>{''.join(entries)}</dl></section>"


def _section(mark: str, name: str, result: Any, words: Words | None) -> str:
    """Return the HTML of the section of a result."""
    if isinstance(result, Model) and result.gravity.ndim == 1:
        tables = "".join(map(_table, inputs(result, words or {})))
    elif isinstance(result, LinearSystem):
        tables = ""  # at the end of the report
    else:
        tables = _tables(tables_of(in_numpy(result)), words, name)
    pictures = "".join(_figure(caption, ax, words or {}) for caption, ax in _pictures(result))
    return (
        f"<section id='{mark}'><h2>{escape(name)}</h2><div class='content'>"
        + "".join(
            f"<div class='{kind}'>{html}</div>"
            for kind, html in (("tables", tables), ("pictures", pictures))
            if html
        )
        + "</div></section>"
    )


def _view(results: dict[str, Any]) -> str:
    """Return a motion, the modes or else a model in three dimensions, in a frame."""
    from jaxbody.views import views

    shown = [each for each in results.items() if isinstance(each[1], views.VIEWED)]
    shown.sort(key=lambda each: (isinstance(each[1], ModalResult), isinstance(each[1], Trajectory)))
    page = escape(views.view(dict(shown[-1:])).to_html(), quote=True)
    return (
        "<section><h2>In three dimensions</h2><iframe title='View in three dimensions' "
        f'sandbox="allow-scripts" srcdoc="{page}"></iframe></section>'
    )


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


def _figure(caption: str, ax: Any, words: Words) -> str:
    if ax is None:
        return f"<p class='note'>{escape(caption)}</p>"
    label_in(ax.figure, words)
    return (
        f"<figure><img src='{_image(ax)}' "
        f"alt='{escape(caption)}'><figcaption>{escape(caption)}</figcaption></figure>"
    )


def _tables(shown: Iterable[PrintedTable], words: Words | None, heading: str = "") -> str:
    """Return the HTML of tables, each broken up so that it fits on paper; a title that repeats the
    heading is left out."""
    parts = [part for table in shown for part in fitting(table, words)]
    return "".join(
        _table(replace(part, title=part.title * (part.title != heading))) for part in parts
    )


def _table(table: PrintedTable) -> str:
    caption = f"<caption>{escape(table.title)}</caption>" if table.title else ""
    cells = [[number(cell) for cell in row] for row in table.rows]
    kinds = [
        " class='text'" * (not i or not all(NUMERIC.match(row[i]) for row in cells))
        for i in range(len(table.columns))
    ]
    head = "".join(
        f"<th scope='col'{kind}>{INSIDE_UNIT.sub('&nbsp;', escape(column))}</th>"
        for column, kind in zip(table.columns, kinds, strict=True)
    )
    rows = [
        f"<tr><th scope='row' class='text'>{escape(row[0])}</th>"
        + "".join(
            f"<td{kind}>{escape(cell)}</td>" for cell, kind in zip(row[1:], kinds[1:], strict=True)
        )
        + "</tr>"
        for row in cells
    ]
    note = f"<p class='note'>{escape(table.note)}</p>" if table.note else ""
    return (
        f"<div class='table'><table>{caption}<thead><tr>{head}</tr></thead>"
        f"<tbody>{''.join(rows)}</tbody></table></div>{note}"
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
    """Yield pictures of the first natural modes, complex ones where a matrix is not symmetric."""
    natural = fitting_modes(lin)
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
    if fit.uncertainty is None:
        return
    errors, _ = fit.uncertainty.spread(np.eye(fit.u.size))
    if np.isfinite(errors).sum() > 1:
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
