"""Reports: what they contain, by structure and numbers; that a browser opens them without a request
or an error."""

import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest
from report_pages import Page, check_golden, numbers

import jaxbody as jb
from jaxbody.views.plots.plots_of_results import picture_of

CHROMIUM = next(
    filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None
)


@pytest.fixture(scope="module")
def engine(tmp_path_factory):
    """A report of an engine on its mounts, and its results."""
    model = jb.presets.engine_on_mounts()
    rest = jb.equilibrium(model)
    lin = jb.linearize(model, rest)
    inputs, outputs = (
        {"frame": jb.BaseMotion("frame", "z")},
        {"engine": jb.Position("engine", axis="z")},
    )
    results = {
        "Engine": model,
        "Equilibrium": rest,
        "Small motions": lin,
        "Modes": jb.modes(lin),
        "Energies": jb.mode_energies(lin),
        "Response": jb.frequency_response(lin, np.geomspace(1, 50, 100), inputs, outputs),
    }
    path = tmp_path_factory.mktemp("report") / "engine.html"
    assert (
        jb.report(
            results, path, title="Engine on mounts", files=[__file__], command="make engine.html"
        )
        == path
    )
    return path, results


@pytest.mark.long
def test_a_report_holds_the_numbers_that_are_printed(engine):
    path, results = engine
    page = Page(path)
    assert page.headings == ["Engine on mounts", *results]
    modes = next(table for table in numbers(page) if table[0][:2] == ["mode", "frequency [Hz]"])
    # six printed digits
    np.testing.assert_allclose([row[1] for row in modes[1:]], results["Modes"].frequency, rtol=1e-5)
    check_golden("engine", page)


@pytest.mark.long
def test_it_says_how_it_was_made(engine):
    import hashlib

    text = engine[0].read_text()
    assert (
        hashlib.sha256(Path(__file__).read_bytes()).hexdigest() in text
        and "make engine.html" in text
    )
    assert "jaxlib" in text and "UTC" in text


@pytest.mark.long
def test_it_refers_to_nothing_outside(engine):
    links = Page(engine[0]).links
    assert links and all(link.startswith(("data:", "#")) for link in links)
    assert "<script" not in engine[0].read_text() and engine[0].stat().st_size < 1.5e6


def test_the_same_report_again_is_the_same_but_for_the_time(engine, tmp_path):
    import matplotlib.pyplot as plt

    results, open_before = engine[1], plt.get_fignums()
    texts = [
        jb.report({"Engine": results["Engine"]}, tmp_path / f"{name}.html", title="E").read_text()
        for name in "ab"
    ]
    assert texts[0].partition("<footer>")[0] == texts[1].partition("<footer>")[0]
    assert plt.get_fignums() == open_before


@pytest.mark.nan
def test_names_are_text_and_failures_are_shown(tmp_path):
    ends = ("<script>alert(1)</script>", [0, 0, 0]), ("world", [0, 0, 1])
    spring = jb.Spring(*ends, stiffness=10.0, free_length=0.5)
    model = jb.Model(
        bodies={ends[0][0]: jb.Body(1.0, [1, 1, 1])},
        elements={"a&b": spring},
        gravity=[0, 0, -9.81],
    )
    with pytest.warns(jb.JaxbodyWarning, match="SINGULAR_K"):
        modes = jb.modes(jb.linearize(model, model.reference))
    path = jb.report({"<b>": model, "Modes": modes}, tmp_path / "names.html")
    page = Page(path)
    assert page.headings == ["names", "<b>", "Modes"] and "<script" not in path.read_text()
    assert any("SINGULAR_K" in note for note in page.notes)


def test_what_cannot_be_reported_is_named(tmp_path, engine):
    with pytest.raises(jb.JaxbodyError) as error:
        jb.report({"a": 3.0, "b": engine[1]["Modes"]}, tmp_path / "a.pdf")
    assert [problem.code for problem in error.value.problems] == ["WRONG_KIND", "UNKNOWN_FORMAT"]
    for given, path, code in (
        ({}, "a.html", "NO_DATA"),
        ({"m": engine[1]["Modes"]}, "no/a.html", "NOT_SAVED"),
    ):
        with pytest.raises(jb.JaxbodyError, match=code):
            jb.report(given, tmp_path / path)
    with pytest.raises(jb.JaxbodyError, match="NO_FILE"):
        jb.report({"m": engine[1]["Modes"]}, tmp_path / "a.html", files=[tmp_path / "none.csv"])


@pytest.mark.long
def test_a_result_is_drawn_as_by_its_plot_and_a_batch_has_a_note(engine, tmp_path):
    """With the caption of the one table of pictures."""
    import jax

    model, modes = engine[1]["Engine"], engine[1]["Modes"]
    cases = jb.load_cases(model, {"bump": jb.LoadCase(acceleration=[0, 0, 2])})
    batch = jax.tree.map(lambda x: np.stack([x, x]), modes)
    page = Page(jb.report({"Cases": cases, "Modes": modes, "Two": batch}, tmp_path / "drawn.html"))
    assert page.pictures == [picture_of(type(result)).caption for result in (cases, modes)]
    assert page.headings[1:] == ["Cases", "Modes", "Two"] and any(
        "Not drawn" in note and "batch of 2" in note for note in page.notes
    )


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")  # residuals that are no noise
def test_a_fit_to_many_records_draws_those_with_the_largest_misfits(tmp_path):
    """Ten masses on springs of 100 N/m and one damper each read; the model has one stiffness
    for all, so that the fourth, which is softer, and the eighth, whose record is another
    motion, fit worst."""
    times = np.linspace(0, 2, 41)
    frequencies = np.array([1.0, 1.0, 1.0, 1.06, 1.0, 1.0, 1.0, 1.5, 1.0, 1.0])
    rng = np.random.default_rng(3)
    names = [f"m{i}" for i in range(10)]
    model = jb.Model(
        bodies={name: jb.Body(1.0, [1, 1, 1]) for name in names},
        joints={name: jb.Guide("world", axis=[1, 0, 0]) for name in names},
        elements={
            f"s{name}": jb.Spring(
                (name, [0, 0, 0]), ("world", [-1, 0, 0]), stiffness=35.0, free_length=1.0
            )
            for name in names
        },
    )
    sensors = {f"x{name}": jb.Position(name, axis="x") for name in names}
    data = {
        f"x{name}": 0.1 * np.cos(2 * np.pi * f * times) + rng.normal(0, 1e-4, 41)
        for name, f in zip(names, frequencies, strict=True)
    }
    data["xm0"][5:9] = np.nan
    start = jb.State(np.full(10, 0.1), np.zeros(10))
    run = jb.Experiment(times, sensors=sensors, measured=data, initial=start, noise=1e-4)
    fit = jb.fit(model, {"run": run}, free="sm0.stiffness = *.stiffness")
    page = Page(jb.report({"Fit": fit}, tmp_path / "fit.html"))
    assert len(page.pictures) == 6
    assert [picture.partition(":")[0] for picture in page.pictures[:2]] == ["run, xm7", "run, xm3"]
    assert any(
        "6 of 10 records are drawn" in note and "plot_fit(fit, run=..., sensor=...)" in note
        for note in page.notes
    )
    few = jb.Experiment(
        times,
        sensors={"xm0": sensors["xm0"]},
        measured={"xm0": data["xm0"]},
        initial=start,
        noise=1e-4,
    )
    page = Page(
        jb.report({"Fit": jb.fit(model, {"run": few}, free="sm0.stiffness")}, tmp_path / "few.html")
    )
    assert len(page.pictures) == 1 and not any("are drawn" in note for note in page.notes)


@pytest.mark.long
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
@pytest.mark.parametrize("width", [400, 1400])
def test_a_browser_shows_it_without_a_request_or_an_error(width, engine, tmp_path):
    """Its policy forbids every request, which the browser would report on the console."""
    picture = tmp_path / "page.png"
    command = [
        str(CHROMIUM),
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        "--hide-scrollbars",
        "--enable-logging=stderr",
    ]
    command += [
        f"--user-data-dir={tmp_path / 'profile'}",
        f"--window-size={width},1200",
        f"--screenshot={picture}",
    ]
    done = subprocess.run(
        [*command, engine[0].as_uri()], capture_output=True, text=True, timeout=120
    )
    assert "CONSOLE" not in done.stderr
    import matplotlib.image

    image = matplotlib.image.imread(picture)
    assert image.shape[:2] == (1200, width) and image[..., :3].std() > 0.05  # not blank
    blank = tmp_path / "asks.html"
    blank.write_text(
        engine[0]
        .read_text()
        .replace("</main>", "<img src='https://example.org/a.png' alt=''></main>")
    )
    assert (
        "CONSOLE"
        in subprocess.run(
            [*command, blank.as_uri()], capture_output=True, text=True, timeout=120
        ).stderr
    )
