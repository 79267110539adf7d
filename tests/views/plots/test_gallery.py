"""Every picture of the gallery: no texts overlap or leave the figure, axes have units, files
are small."""

import runpy
from pathlib import Path

import matplotlib
import matplotlib.pyplot as plt
import pytest
from matplotlib.figure import Figure
from pictures import overlaps, without_unit

import jaxbody as jb

ROOT = Path(__file__).parents[3]
IMAGES = ROOT / "examples" / "images" / "gallery"
QUANTITIES = ("shake", "travel", "first frequency")  # of the user's own functions


@pytest.fixture(scope="module")
def gallery():
    backend, options = matplotlib.get_backend(), dict(matplotlib.rcParams)
    yield runpy.run_path(str(ROOT / "examples" / "gallery.py"))
    plt.switch_backend(backend)
    matplotlib.rcParams.update(options)


NAMES = sorted(path.stem for path in IMAGES.glob("*.png"))


def test_the_gallery_is_complete_and_small(gallery):
    assert sorted(gallery["PICTURES"]) == NAMES
    sizes = [path.stat().st_size for path in IMAGES.glob("*.png")]
    assert max(sizes) < 60e3 and sum(sizes) < 1e6


@pytest.mark.long
@pytest.mark.parametrize("name", NAMES)
def test_texts_stay_apart_and_axes_have_units(gallery, name):
    figure = gallery["PICTURES"][name]().figure
    try:
        assert overlaps(figure) == []
        assert without_unit(figure, QUANTITIES) == []
    finally:
        plt.close(figure)


MODELS = {
    "full car": jb.presets.full_car,
    "half car": jb.presets.half_car,
    "engine on mounts": jb.presets.engine_on_mounts,
    "the paper's plate": lambda: runpy.run_path(str(ROOT / "examples" / "plate.py"))["model"],
}


@pytest.mark.long
@pytest.mark.parametrize("name", MODELS)
def test_names_of_parts_stay_apart_at_the_default_size(name):
    figure = MODELS[name]().plot().figure
    try:
        assert overlaps(figure) == [] and without_unit(figure) == []
    finally:
        plt.close(figure)


def test_what_overlaps_or_leaves_the_figure_is_found():
    figure = Figure(figsize=(3, 2))
    ax = figure.subplots()
    ax.set(xlabel="time", ylabel="force [N]")
    for text, at in (("one", 0.5), ("other", 0.52), ("beyond", 1.2)):
        ax.text(at, 0.5, text)
    wrong = overlaps(figure)
    assert any(
        {"one", "other"} == {name.split(": ")[1] for name in pair}
        for pair in wrong
        if isinstance(pair, tuple)
    )
    assert any(name.endswith("beyond") for name in wrong if isinstance(name, str))
    assert without_unit(figure) == ["time"]
