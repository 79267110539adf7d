"""Reports: what they contain, by structure and numbers; that a browser opens them without a request
or an error."""

import dataclasses
import re
import shutil
import subprocess
import time
from pathlib import Path

import equinox as eqx
import numpy as np
import pytest
from browsers import opened
from report_pages import Page, cell, check_golden, numbers

import jaxbody as jb
from jaxbody.app.reports import STYLE
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
        "Energies": jb.vibration.mode_energies(lin),
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
    assert page.headings == [
        "Engine on mounts",
        "Summary",
        *results,
        "Matrices of Small motions",
    ]
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
    assert (
        page.headings == ["names", "Summary", "<b>", "Modes"] and "<script" not in path.read_text()
    )
    assert any("SINGULAR_K" in note for note in page.notes)
    assert any(line.startswith("SINGULAR_K") for line in page.summary)


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
    for units, code in (("miles", "UNKNOWN_NAME"), ({"length": "furlong"}, "UNKNOWN_UNIT")):
        with pytest.raises(jb.JaxbodyError, match=code):
            jb.report({"m": engine[1]["Modes"]}, tmp_path / "a.html", units=units)
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
    assert page.headings[2:] == ["Cases", "Modes", "Two"] and any(
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


@pytest.fixture(scope="module")
def tapped():
    """The fit of a mass on a spring to its natural frequency, which determines neither alone."""
    car = jb.presets.quarter_car(damping=1500.0)
    tap = jb.MeasuredModes(number=[0], noise={"frequency": 0.01})
    return jb.expected_fit(car, {"tap": tap}, free=["body.mass", "suspension.stiffness"])


def test_a_report_of_a_fit_says_what_to_measure_next(tapped, tmp_path):
    """The numbers of further_measurements, and with it both are determined."""
    page = Page(jb.report({"Fit": tapped}, tmp_path / "fit.html"))
    table = next(table for table in page.tables if table[0][-1] == "not determined")
    further = jb.fitting.further_measurements(tapped)
    names = ("none", *further.measurements)
    assert [row[0] for row in table[1:]] == list(names) and len(names) > 2
    assert table[1][1:] == ["", "body.mass, suspension.stiffness"] and table[2][2] == "none"
    assert float(table[2][1].split(",")[0]) == pytest.approx(further.after[0].max(), rel=1e-2)


@pytest.mark.nan
def test_a_report_of_a_fit_says_why_it_does_not_know_what_to_measure_next(tmp_path):
    """A thrown body has no equilibrium and so no responses; a simulation that needs more steps than
    it may take predicts nothing."""
    model, times = jb.Model(bodies={"ball": jb.Body(2.0, [1, 1, 1])}), np.linspace(0, 1, 21)
    push = jb.Force("ball", force=jb.signals.Sine(amplitude=[0, 0, 9.0], frequency=1.0))
    sensors = {"a": jb.Acceleration("ball", axis="z")}
    run = jb.Experiment(times, sensors=sensors, noise=0.1, loads={"push": push})
    fit = jb.expected_fit(model, {"run": run}, free=["ball.mass"])
    assert jb.fitting.further_measurements(fit).measurements == ("position of ball along z in run",)
    few = dataclasses.replace(fit.task.integration, max_steps=1)
    fit = eqx.tree_at(lambda x: x.task.integration, fit, few)
    page = Page(jb.report({"Fit": fit}, tmp_path / "fit.html"))
    assert any(
        note.startswith("not known: plans['run']: has no finite prediction") for note in page.notes
    )


@pytest.fixture(scope="module")
def cars(tmp_path_factory):
    """Reports of two cars, {name: path}: a quarter in mm and deg, one with seven degrees of freedom
    in SI units."""
    folder, paths = tmp_path_factory.mktemp("cars"), {}
    models = {"quarter": jb.presets.quarter_car(damping=1500.0), "full": jb.presets.full_car()}
    for name, model in models.items():
        rest = jb.equilibrium(model)
        lin = jb.linearize(model, rest)
        response = jb.frequency_response(
            lin,
            np.geomspace(0.5, 50, 100),
            {"road": jb.BaseMotion(model.layout.supports[0], "z")},
            {"body": jb.Position(model.layout.bodies[0], axis="z")},
        )
        results = {
            "Equilibrium": rest,
            "Small motions": lin,
            "Modes": jb.modes(lin),
            "Energies": jb.vibration.mode_energies(lin),
            "Response": response,
            "Cases": jb.load_cases(model, {"bump": jb.LoadCase(acceleration=[0, 0, 0.2])}),
            "Model": model,
        }
        units = "mm" if name == "quarter" else None
        paths[name] = jb.report(results, folder / f"{name}.html", units=units)
    return paths


@pytest.mark.long
def test_the_inputs_of_a_quarter_car_are_complete_in_mm(cars):
    """The numbers are the arguments of the preset and those of its docstring's source."""
    page = Page(cars["quarter"])
    assert page.headings[2] == "Model"  # inputs come first
    for body, mass, height in (("body", 375, 700), ("wheel", 75, 300)):
        assert cell(page, body, "mass [kg]") == mass
        assert cell(page, body, "position z [mm]") == height
        assert [cell(page, body, f"com {axis} [mm]") for axis in "xyz"] == [0, 0, 0]
        assert cell(page, body, "joint") == "guide on world" and cell(page, body, "axis z") == 1
    assert cell(page, "road", "position z [mm]") == 0
    for spring, ends, stiffness, damping, length in (
        ("suspension", "body, wheel", 35, 1.5, 400 + 375 * 9.81 / 35),
        ("tyre", "wheel, road", 193, 0, 300 + 450 * 9.81 / 193),
    ):
        assert cell(page, spring, "from, to") == ends
        assert cell(page, spring, "stiffness [N/mm]") == stiffness
        assert cell(page, spring, "damping [N\xa0s/mm]") == damping
        assert cell(page, spring, "free length [mm]") == pytest.approx(length, rel=1e-5)
        assert [cell(page, spring, f"to {axis} [mm]") for axis in "xyz"] == [0, 0, 0]
    assert any("0 mm/s2, 0 mm/s2, -9810 mm/s2" in note for note in page.notes)


@pytest.mark.long
def test_the_inputs_of_a_car_are_complete(cars):
    page = Page(cars["full"])
    inertia = [cell(page, "car", f"inertia {axes} [kg\xa0m2]") for axes in ("xx", "yy", "zz")]
    assert inertia == [450, 1500, 1700] and cell(page, "car", "mass [kg]") == 1100
    wheels = {"fl": (1.2, 0.75), "fr": (1.2, -0.75), "rl": (-1.4, 0.75), "rr": (-1.4, -0.75)}
    for name, (x, y) in wheels.items():
        front = name[0] == "f"
        assert cell(page, name, "mass [kg]") == (40 if front else 35)
        assert cell(page, f"road {name}", "position x [m]") == x
        assert cell(page, f"spring {name}", "from, to") == f"car, {name}"
        ends = [cell(page, f"spring {name}", f"from {axis} [m]") for axis in "xyz"]
        assert ends == [x, y, 0]
        assert cell(page, f"spring {name}", "stiffness [N/m]") == (22000 if front else 24000)
        assert cell(page, f"spring {name}", "damping [N\xa0s/m]") == (1500 if front else 1600)
        share = (1.4 if front else 1.2) / 2.6 / 2 * 1100 * 9.81
        sunk = 0.25 + share / (22000 if front else 24000)
        assert cell(page, f"spring {name}", "free length [m]") == pytest.approx(sunk, rel=1e-5)
    assert cell(page, "bar front", "spring") == "Linear(12000 N/m)"
    assert cell(page, "bar rear", "from, to, on") == "rl, rr, car"


@pytest.mark.long
def test_the_inputs_of_an_engine_are_complete(engine):
    page = Page(engine[0])
    inertia = [
        cell(page, "engine", f"inertia {axes} [kg\xa0m2]")
        for axes in ("xx", "xy", "xz", "yy", "yz", "zz")
    ]
    assert inertia == [8.493, -1.187, -0.368, 3.505, 1.476, 7.147]
    for head, expected in (
        ("from {} [m]", (-0.0135, 0.389, 0.203)),
        ("to {} [m]", (-0.0135, 0.389, 0.203)),
        ("stiffness {} [N/m]", (91000, 200000, 949900)),
        ("damping {} [N\xa0s/m]", (910, 2000, 198)),
    ):
        assert [cell(page, "mount 1", head.format(axis)) for axis in "xyz"] == [*expected]


@pytest.mark.long
def test_the_summary_says_what_was_analyzed_and_found(cars, engine):
    """Frequencies by the sources of the presets, the force by the weights."""
    quarter, full, of_engine = (Page(path) for path in (*cars.values(), engine[0]))
    for page, expected in (
        (quarter, "2 bodies (body, wheel); 1 support (road); 2 elements (suspension, tyre)."),
        (quarter, "450 kg in all; 2 degrees of freedom."),
        (quarter, "Largest displacement from the drawn pose: 0 mm (body)."),
        # 0.2 x 9.80665 (375/35000 + 450/193000) m
        (quarter, "Largest displacement: 25.59 mm (body, bump)."),
        (full, "1250 kg in all; 7 degrees of freedom."),
        (full, "Largest force on a support: 3298 N (road fl)."),
        (of_engine, "6 modes: 7.503 Hz (engine along x 99 %) to 26.45 Hz (engine about x 79 %)."),
    ):
        assert expected in page.summary, page.summary
    assert any(line.startswith("Largest magnitude of body per road: ") for line in full.summary)
    assert any("mode 6 in mount 1 (92 %)" in line for line in of_engine.summary)
    assert full.summary.count("ok") == 6


@pytest.mark.long
def test_matrices_have_named_columns_and_the_units_of_the_report(cars, engine):
    """K of the quarter car is [[k, -k], [-k, k + tyre]]; that of the engine is of its mounts."""
    page = Page(cars["quarter"])
    names = ["body along its guide", "wheel along its guide"]
    table = next(table for table in numbers(page) if table[0] == ["", *names] and table[1][1] == 35)
    assert table[1:] == [[names[0], 35, -35], [names[1], -35, 228]]
    table = next(table for table in numbers(Page(engine[0])) if 318000 in table[1])
    assert table[0] == [
        "",
        *(f"engine {turn} {axis}" for turn in ("along", "about") for axis in "xyz"),
    ]


def test_a_table_with_springs_and_bushings_keeps_the_numbers_of_both(tmp_path):
    model = jb.Model(
        bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis="z")},
        elements={
            "spring": jb.Spring(
                ("mass", [0, 0, 0]), ("world", [0, 0, -1]), stiffness=600.0, free_length=1.0
            ),
            "bushing": jb.Bushing(
                ("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=[500.0, 500.0, 400.0]
            ),
        },
        gravity=[0, 0, -10.0],
    )
    page = Page(jb.report({"Rest": jb.equilibrium(model)}, tmp_path / "both.html", units="mm"))
    assert (
        cell(page, "spring", "deformation [mm]") == -20 and cell(page, "spring", "force [N]") == -12
    )
    assert cell(page, "bushing", "deformation z [mm]") == 20
    assert cell(page, "bushing", "force z [N]") == 8


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_colors_of_texts_have_the_contrast_of_wcag_aa(scheme):
    """4.5 between text and background, by its formula of relative luminance."""

    def luminance(color):
        parts = np.array([int(color[i : i + 2], 16) for i in (0, 2, 4)]) / 255
        linear = np.where(parts <= 0.04045, parts / 12.92, ((parts + 0.055) / 1.055) ** 2.4)
        return linear @ [0.2126, 0.7152, 0.0722]

    light, dark = (
        dict(re.findall(r"--(\w+): #(\w{6})", part)) for part in STYLE.split("@media screen")
    )
    colors = light | (dark if scheme == "dark" else {})
    assert set(dark) == set(light)
    for text in ("text", "faint", "link", "good", "bad"):
        for background in ("page", "card"):
            low, high = sorted(luminance(colors[name]) for name in (text, background))
            assert (high + 0.05) / (low + 0.05) >= 4.5, (text, background)


# boxes of texts that overlap, that are wider than their table's own scrolled box, or off the page
HIDDEN = """(() => {
  const boxes = [...document.querySelectorAll("h1, h2, dt, dd p, caption, th, td, p.note, figcaption, footer p")]
    .filter(x => x.innerText.trim()).map(x => [x, x.getBoundingClientRect()]);
  const wrong = boxes.filter(([x, a]) => x.scrollWidth > Math.ceil(a.width) + 1
    || (!x.closest(".table") && (a.right > innerWidth || a.left < 0))).map(([x]) => x.innerText);
  boxes.forEach(([x, a], i) => boxes.slice(i + 1).forEach(([y, b]) => {
    if (Math.min(a.right, b.right) - Math.max(a.left, b.left) > 1
        && Math.min(a.bottom, b.bottom) - Math.max(a.top, b.top) > 1
        && !x.closest(".table") === !y.closest(".table")) wrong.push(x.innerText + " | " + y.innerText);
  }));
  return JSON.stringify(wrong);
})()"""  # noqa: E501


@pytest.mark.long
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
@pytest.mark.parametrize("width", [600, 1000, 1400])
def test_nothing_is_wider_than_the_page_or_hides_another_text(width, engine, cars, tmp_path):
    for path in (engine[0], *cars.values()):
        with opened(path, tmp_path / path.stem, size=(width, 900)) as page:
            page.wait_for("document.readyState == 'complete'")
            assert page.value("document.documentElement.scrollWidth") <= width
            assert page.value(HIDDEN) == "[]"
            wide = page.value(
                "[...document.querySelectorAll('.table')].filter(x => x.scrollWidth > "
                "x.clientWidth + 1).length"
            )
            assert wide == 0 or width == 600
            assert page.requests == [path.as_uri()] or all(
                url.startswith(("file:", "data:")) for url in page.requests
            )
            assert not page.errors


@pytest.mark.long
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
def test_no_table_is_wider_than_paper(engine, cars, tmp_path):
    """Printed on A4, 178 mm between the margins of 16 mm, at 96 pixels an inch."""
    for path in (engine[0], *cars.values()):
        with opened(path, tmp_path / path.stem, size=(round(178 / 25.4 * 96), 900)) as page:
            page.wait_for("document.readyState == 'complete'")
            page.call("Emulation.setEmulatedMedia", media="print")
            over = page.value(
                "[...document.querySelectorAll('table')].filter(x => x.offsetWidth > "
                "document.body.clientWidth + 1).length"
            )
            assert over == 0


@pytest.mark.long
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
def test_a_view_in_three_dimensions_is_inside_on_request_and_asks_for_nothing(tmp_path):
    pytest.importorskip("viser")
    model = jb.presets.quarter_car()
    path = jb.report({"Car": model}, tmp_path / "view.html", view=True)
    text = path.read_text()
    assert 'sandbox="allow-scripts"' in text and "default-src 'none'" in text
    assert Page(path).headings[-1] == "In three dimensions"
    with opened(path, tmp_path / "profile", size=(900, 600)) as page:
        page.wait_for("document.readyState == 'complete'")
        page.value("document.querySelector('iframe').scrollIntoView()")
        page.value(
            "document.querySelectorAll('main > section:not(:last-child)').forEach(x => x.remove())"
        )
        end = time.monotonic() + 60
        while np.mean(np.diff(page.picture()[..., ::2])[..., 0] > 0.2) < 0.002:  # the blue body
            assert time.monotonic() < end, "nothing was drawn"
            time.sleep(0.5)
        assert all(url.startswith(("file:", "data:", "blob:", "about:")) for url in page.requests)


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
