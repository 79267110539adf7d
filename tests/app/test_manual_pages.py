"""Pages of the manual: their code runs and prints what they show; their model file and commands
work; names that they mention exist."""

import re
import shlex
from pathlib import Path

import manual_pages
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.app import commands

PAGES = sorted(
    path
    for path in manual_pages.DOCS.rglob("*.md")
    if not path.is_relative_to(manual_pages.DOCS / "generated")
)
GUIDE = (
    *("models", "statics", "vibration", "shock", "suspensions", "identification", "uncertainty"),
    *("optimization", "batches_and_speed"),
)
RUNNING = [path for path in PAGES if manual_pages.blocks(path)]


def label(path):
    return path.relative_to(manual_pages.DOCS).with_suffix("").as_posix()


@pytest.mark.long
@pytest.mark.parametrize("page", RUNNING, ids=label)
def test_a_page_prints_what_it_shows(page):
    blocks = manual_pages.blocks(page)
    for block, text in zip(blocks, manual_pages.printed(blocks, page.name), strict=True):
        manual_pages.assert_same(block.shown, text)


@pytest.mark.parametrize("page", PAGES, ids=label)
def test_code_fits_the_page(page):
    cells = re.findall(r"^```(?:python|\{code-cell\})\n(.*?)^```", page.read_text(), re.M | re.S)
    assert [line for cell in cells for line in cell.splitlines() if len(line) > 80] == []


@pytest.mark.parametrize("page", GUIDE)
def test_a_page_of_the_guide_shows_a_picture_of_its_result(page):
    found = [block.picture for block in manual_pages.blocks(manual_pages.DOCS / f"guide/{page}.md")]
    assert any(picture and picture.exists() for picture in found)


def test_the_guide_and_every_kind_of_extension_run():
    names = {label(page) for page in RUNNING}
    assert {f"guide/{name}" for name in GUIDE} <= names
    assert {
        f"extending/{name}" for name in ("law", "element", "force", "joint", "sensor", "motion")
    } <= names


def test_a_page_that_shows_something_else_is_found():
    same = "Modes\n 1  0.33998  Hz\n12 evaluations"
    manual_pages.assert_same(same, same.replace("0.33998", "0.339981").replace("12", "13"))
    for other in (same.replace("0.33998", "0.3412"), same.replace("Hz", "rad/s"), same + "\nok"):
        with pytest.raises(AssertionError):
            manual_pages.assert_same(same, other)


@pytest.mark.parametrize("page", PAGES, ids=label)
def test_names_of_the_package_that_a_page_mentions_exist(page):
    for name in re.findall(
        r"\bjb\.([A-Za-z_][A-Za-z_0-9]*(?:\.[A-Za-z_][A-Za-z_0-9]*)?)", page.read_text()
    ):
        found = jb
        for part in name.split("."):
            found = getattr(found, part)


def fenced(page, kind):
    text = (manual_pages.DOCS / "guide" / page).read_text()
    bodies = re.findall(rf"^```{re.escape(kind)}\n(.*?)^```", text, re.M | re.S)
    # without options of the directive
    return [re.sub(r"^:.*\n", "", body, flags=re.M) for body in bodies]


def test_all_commands_are_in_the_table(capsys):
    text = (manual_pages.DOCS / "guide" / "commands.md").read_text()
    assert commands.main([]) == 0
    helped = re.findall(r"^    ([a-z-]+)(?: .*)?$", capsys.readouterr().out, re.M)
    assert len(helped) > 10 and re.findall(r"^\| ([a-z-]+) \|", text, re.M) == ["command", *helped]


@pytest.mark.long
@pytest.mark.parametrize("page", ["engine_mount", "units_in_files"])
def test_the_files_and_commands_of_a_page_run(page, tmp_path, monkeypatch, capsys):
    """Blocks with a caption are files; each line of a block of commands runs, and prints."""
    monkeypatch.chdir(tmp_path)
    text = (manual_pages.DOCS / f"guide/{page}.md").read_text()
    for _, name, body in re.findall(
        r"^```{code-block} (\w+)\n:caption: (\S+)\n(.*?)^```", text, re.M | re.S
    ):
        (tmp_path / name).write_text(body)
    lines = "".join(re.findall(r"^```{code-block} sh\n(.*?)^```", text, re.M | re.S)).splitlines()
    assert len(lines) >= 4
    for line in lines:
        assert commands.main(shlex.split(line)[1:]) == 0 and capsys.readouterr().out, line


@pytest.mark.long
def test_the_model_file_and_its_commands(tmp_path, monkeypatch, capsys):
    """The same model in Python has the same numbers; every command runs, and the fit finds the mass
    with which the record was made."""
    monkeypatch.chdir(tmp_path)
    (study_text,) = fenced("files.md", "{code-block} toml")
    assert "ready/engine.toml" in (manual_pages.DOCS / "guide/files.md").read_text()
    model_text = (Path(jb.__file__).parent / "app/ready/engine.toml").read_text()
    (tmp_path / "engine.toml").write_text(model_text)
    ends = {
        side: (("engine", [-0.1, y, -0.1]), ("frame", [-0.1, y, 0]))
        for side, y in (("left", 0.25), ("right", -0.25))
    }
    bushings = {
        side: jb.Bushing(*points, stiffness=[2e5, 2e5, 4e5], damping=[600, 600, 1200])
        for side, points in ends.items()
    }
    spring = jb.laws.Linear(2.5e5) + jb.laws.BumpStop(gap=0.015, stiffness=2e6)
    damper = jb.laws.TwoSided(bump=900.0, rebound=2100.0)
    strut = jb.SpringDamper(
        ("engine", [0.3, 0, -0.1]),
        ("frame", [0.3, 0, -0.4]),
        spring=spring,
        damper=damper,
        free_length=0.4,
    )
    body, frame = jb.Body(180.0, [8, 12, 10], position=[0, 0, 0.6]), jb.Support([0, 0, 0.5])
    elements = {**bushings, "strut": strut}
    model = jb.Model(
        bodies={"engine": body}, supports={"frame": frame}, elements=elements, gravity=[0, 0, -9.81]
    )
    read = jb.read_model("engine.toml")
    assert all(
        np.allclose(x, jb.parameter_paths(model)[path], rtol=1e-15, atol=0)
        for path, x in jb.parameter_paths(read).items()
    )
    new, plain, study = (block.splitlines() for block in fenced("commands.md", "sh"))
    assert (
        [line.split()[1] for line in new] == ["new", "check", "modes"]
        and len(plain) == 4
        and len(study) == 3
    )
    for line in plain:
        assert commands.main(shlex.split(line)[1:]) == 0 and capsys.readouterr().out
    assert (tmp_path / "modes.csv").exists() and (tmp_path / "response.png").exists()
    times = np.arange(100) / 200
    base = np.stack([0 * times, 0 * times, 1e-3 * np.sin(2 * np.pi * 6 * times) ** 2], 1)
    heavier = jb.replace(read, {"engine.mass": 200.0})
    run = jb.simulate(
        heavier,
        times,
        motion={"frame": jb.Sampled(times, translation=base)},
        loads=jb.read_study("engine.toml").loads,
        initial="rest",
    )
    noise = np.random.default_rng(0).normal(0, 0.05, 100)
    lift = (
        np.asarray(jb.measure(run, {"lift": jb.Acceleration("engine", axis="z")})["lift"]) + noise
    )
    rows = [
        ",".join(map(repr, row))
        for row in np.stack([times, lift / 9.80665, 1e3 * base[:, 2]], 1).tolist()
    ]
    (tmp_path / "test.csv").write_text("\n".join(["t [s],a [g],base [mm]", *rows]))
    (tmp_path / "engine.toml").write_text(model_text + study_text)
    for line in study:
        assert commands.main(shlex.split(line)[1:]) == 0 and capsys.readouterr().out
    # noise of 0.05 in accelerations of about 1 m/s2
    assert abs(float(jb.read_model("engine.toml")["engine"].mass) - 200) < 2
    assert (tmp_path / "design.csv").exists() and (tmp_path / "engine.html").exists()
