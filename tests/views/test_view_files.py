"""Views in files: what they hold, their sizes, that nothing is asked from a network, and that a
browser plays them."""

import base64
import json
import re
import time
from itertools import combinations, pairwise

import jax.numpy as jnp
import msgspec
import numpy as np
import pytest
import zstandard
from browsers import CHROMIUM, difference, opened
from PIL import Image
from test_views import SHAKEN, L, plate

import jaxbody as jb

NAME_SPACES = {"http://www.w3.org/2000/svg"}


@pytest.fixture(scope="module")
def motion():
    return jb.simulate(plate(), jnp.linspace(0.0, 3.0, 76), motion=SHAKEN)


@pytest.fixture(scope="module")
def page(motion, tmp_path_factory):
    return jb.view(motion, trails={"corner": ("plate", [3 * L, L, 0])}, forces=True).save(
        tmp_path_factory.mktemp("page") / "plate.html"
    )


def messages_of(path):
    """(time, message) of the recording in a page, decoded here."""
    text = path.read_text()
    data = base64.b64decode(re.search(r'__VISER_EMBED_DATA__="([^"]*)"', text)[1])
    inner = zstandard.ZstdDecompressor().decompress(
        data[8:], max_output_size=int.from_bytes(data[:8], "little")
    )
    length = int.from_bytes(inner[:8], "little")
    return msgspec.msgpack.decode(inner[8 : 8 + length])


@pytest.mark.long
def test_a_page_needs_no_network_and_is_small(page):
    assert set(re.findall(r"https?://[^\"'`\s<>)]*", page.read_text())) <= NAME_SPACES
    assert page.stat().st_size < 1.2e6


@pytest.mark.long
def test_coils_in_a_page_have_the_length_of_the_springs(page, motion):
    """Decoded from the file and compared with the trajectory, at the times of the model that the
    page shows."""
    recording = messages_of(page)
    scales, clock, shown = {}, None, []
    for moment, message in recording["messages"]:
        if message["type"] == "MeshMessage":
            scales[message["name"]] = message["props"]["scale"]
        if message["type"] == "SceneNodeUpdateMessage" and message["name"] == "/time":
            clock = float(message["updates"]["text"].split()[2])
            shown.append((clock, moment))
        elif message["type"] == "SceneNodeUpdateMessage" and "scale" in message["updates"]:
            scales[message["name"]] = message["updates"]["scale"]
    times = np.asarray(motion.times)
    np.testing.assert_allclose(
        [clock for clock, _ in shown], [moment for _, moment in shown], atol=1e-6
    )  # in real time
    assert recording["durationSeconds"] == pytest.approx(3.04, abs=0.05)
    for name, elongation in motion.elongations.items():
        expected = np.asarray(elongation)[np.argmin(np.abs(times - clock))] + float(
            motion.model[name].free_length
        )
        # rounded in the file, to 1e-6 of the size of 5 m
        assert scales[f"/elements/{name}/coil"][2] == pytest.approx(expected, abs=2e-6)


def test_the_tree_of_a_page_has_the_names_of_the_model(page):
    messages = [message for _, message in messages_of(page)["messages"]]
    names = {message["name"] for message in messages if message["type"] == "MeshMessage"}
    assert {
        "/bodies/plate/solid",
        "/supports/base/board",
        "/elements/AB/damper",
        "/forces/EF/on plate",
    } <= names
    assert {
        message["props"]["text"] for message in messages if message["type"] == "LabelMessage"
    } >= {"plate", "base", "AB"}


@pytest.fixture(scope="module")
def page_of_modes(tmp_path_factory):
    modes = jb.modes(jb.linearize(plate(), plate().reference))
    folder = tmp_path_factory.mktemp("modes")
    return jb.view(modes, number=2).save(folder / "modes.html"), modes


def test_a_page_of_modes_has_all_with_their_numbers_and_frequencies(page_of_modes):
    path, modes = page_of_modes
    listed = json.loads(re.search(r"const recordings = (\[.*\])", path.read_text())[1])
    for i, (recording, frequency) in enumerate(zip(listed, modes.frequency, strict=True)):
        assert recording["title"].startswith(f"mode {i + 1}: {float(frequency):.4g} Hz")
        assert "largest displacement" in recording["notes"]
    assert [bool(recording["data"]) for recording in listed] == [True, False] + 4 * [True]
    assert path.stat().st_size < 2e6


@pytest.mark.long
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
def test_the_menu_of_a_page_changes_the_mode(page_of_modes, tmp_path):
    path, modes = page_of_modes
    with opened(path, tmp_path / "profile") as shown:
        menu = "document.querySelector('#shown select')"
        shown.wait_for(f"{menu}?.value.startsWith('mode 2:')")
        first = shown.drawn()
        shown.value(f"{menu}.selectedIndex = 4; {menu}.onchange()")
        shown.wait_for(f"{menu}?.value.startsWith('mode 5: {float(modes.frequency[4]):.4g} Hz')")
        assert difference(first, shown.drawn()) > 1e-3
        assert shown.errors == []


def test_a_name_with_a_slash_is_no_level_of_the_tree():
    spring = jb.Spring(("a/b", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=1.0)
    view = jb.view(jb.Model(bodies={"a/b": jb.Body(1.0, [1, 1, 1])}, elements={"s": spring}))
    assert "/bodies/a\u2044b/solid" in _tree(view)


def _tree(view):
    from jaxbody.views.browser_pages import _name

    return [_name(part.path) for part in view.animation.parts]


@pytest.mark.long
@pytest.mark.parametrize("car, most", [("quarter_car", 3e6), ("full_car", 8e6)])
def test_a_minute_of_a_car_is_a_small_page(car, most, tmp_path):
    """On a rough road, so that nothing repeats."""
    model = getattr(jb.presets, car)(**({"damping": 1500.0} if car == "quarter_car" else {}))
    profile = _rough()
    places = {name: float(model[name].position[0]) for name in model.layout.supports}
    motion = {
        name: jb.inputs.Road(*profile, speed=10.0, position=x + 5.0, footprint=0.2)
        for name, x in places.items()
    }
    run = jb.simulate(model, jnp.linspace(0.0, 60.0, 1501), motion=motion, rtol=1e-4)
    path = jb.view(run).save(tmp_path / "car.html")
    assert path.stat().st_size < most
    assert messages_of(path)["durationSeconds"] == pytest.approx(60.0, abs=0.1)


def _rough():
    s = np.arange(0.0, 640.0, 4.0)
    return s, 0.01 * np.random.default_rng(4).standard_normal(len(s))


@pytest.mark.long
@pytest.mark.skipif(CHROMIUM is None, reason="there is no Chromium on this machine")
def test_a_browser_plays_a_page(page, tmp_path):
    """It starts by itself, its slider and its pause work, it asks for nothing outside, and it has
    no errors."""
    with opened(page, tmp_path / "profile") as shown:
        shown.wait_for(
            "document.querySelectorAll('input').length > 1 && "
            "parseFloat(document.querySelector('input').value) > 0.2"
        )
        one = shown.drawn()
        time.sleep(0.5)
        other = shown.picture()
        assert difference(one[:500], other[:500]) > 0.002  # above the bar, something moves
        shown.click(*_place(shown, "button:has(.tabler-icon-player-pause-filled)", 0.5))
        shown.wait_for("document.querySelector('.tabler-icon-player-pause-filled') === null")
        shown.click(*_place(shown, "[class*=Slider-track]", 0.75))
        shown.wait_for(
            "Math.abs(parseFloat(document.querySelector('input').value) - 0.75 * 3.04) < 0.06"
        )
        still, same = shown.picture(), shown.picture()
        assert difference(still, same) < 1e-3 < difference(one[:500], still[:500])
        assert shown.errors == []
        assert [
            url
            for url in shown.requests
            if not url.startswith(("data:", "blob:")) and url != page.as_uri()
        ] == []


def _place(shown, selector, share):
    """Where to click on an element, this share of its width from its left edge."""
    box = json.loads(
        shown.value(
            f"JSON.stringify(document.querySelector({json.dumps(selector)}"
            ").getBoundingClientRect())"
        )
    )
    return box["x"] + share * box["width"], box["y"] + box["height"] / 2


@pytest.fixture(scope="module")
def half(tmp_path_factory):
    """A motion of the plate of half a second of playing, to be drawn quickly."""
    run = jb.simulate(plate(), jnp.linspace(0.0, 3.0, 76), motion=SHAKEN)
    return jb.view(run, speed=6.0)


@pytest.mark.long
def test_a_gif_moves(half, tmp_path):
    image = Image.open(half.save(tmp_path / "plate.gif", width=240))
    seconds = float(half.animation.seconds[-1] + half.animation.pauses[-1])
    assert image.size[0] == 240 and image.n_frames == round(20 * seconds) > 9
    frames, total = [], 0
    for i in range(image.n_frames):
        image.seek(i)
        total += image.info["duration"]
        frames.append(np.asarray(image.convert("RGB")) / 255)
    assert total == pytest.approx(1000 * seconds, abs=20)
    assert all(difference(a, b) > 0.002 for a, b in pairwise(frames))


@pytest.mark.long
def test_an_mp4_moves(half, tmp_path):
    import imageio_ffmpeg

    path = half.save(tmp_path / "plate.mp4", width=240)
    reader = imageio_ffmpeg.read_frames(str(path))
    about = next(reader)
    frames = [
        np.frombuffer(frame, np.uint8).reshape(*about["size"][::-1], 3) / 255 for frame in reader
    ]
    assert about["fps"] == 30 and len(frames) == pytest.approx(30 * 0.5, abs=2)
    assert difference(frames[0], frames[-1]) > 0.002


def test_a_picture_has_the_colors_of_what_it_shows(half, tmp_path):
    """The plate is blue in the middle; of a wide picture the width is as asked for."""
    image = np.asarray(
        Image.open(half.save(tmp_path / "plate.png", width=400)).convert("RGB"), float
    )
    assert image.shape[1] == 400
    blue = (image[..., 2] > 1.3 * image[..., 0]) & (image[..., 2] > 90)
    assert 0.02 < blue.mean() < 0.5
    assert (image[:3] > 250).mean() > 0.9


@pytest.mark.long
def test_names_in_a_picture_do_not_overprint():
    from matplotlib.text import Text

    from jaxbody.views.scenes.drawn_frames import Painter

    for name in ("full_car", "half_car", "engine_on_mounts", "stewart_table"):
        view = jb.view(getattr(jb.presets, name)())
        painter = Painter(view.animation, view.camera, None)
        painter.picture(0)
        named = [text for _, text in painter.names]
        assert {text.get_text() for text in named} >= set(view.animation.labels[0].text.split("\n"))
        boxes = []
        for text in named:
            text.get_window_extent()
            boxes.append(Text.get_window_extent(text))
        assert not any(a.overlaps(b) for a, b in combinations(boxes, 2)), name
        width, height = painter.canvas.get_width_height(physical=True)
        assert all(
            box.x0 >= 0 and box.y0 >= 0 and box.x1 <= width and box.y1 <= height for box in boxes
        ), name


@pytest.mark.long
def test_plot_draws_into_axes(half):
    import matplotlib
    from matplotlib.figure import Figure

    before = dict(matplotlib.rcParams)
    ax = Figure().subplots()
    assert half.plot(at=0.3, ax=ax) is ax and len(ax.images) == 1
    assert dict(matplotlib.rcParams) == before


def test_a_notebook_shows_it_inline(half):
    html = half._repr_html_()
    assert html.startswith("<iframe srcdoc=") and "&lt;script" in html


@pytest.mark.long
def test_show_opens_a_file_in_a_browser(half, monkeypatch):
    import urllib.parse
    import webbrowser
    from pathlib import Path

    opened = []
    monkeypatch.setattr(webbrowser, "open", opened.append)
    half.show()
    path = Path(urllib.parse.urlparse(opened[0]).path)
    assert "__VISER_EMBED_DATA__" in path.read_text()
    path.unlink()
