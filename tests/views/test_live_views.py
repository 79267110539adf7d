"""A view that is served: its controls as the browser uses them, through viser's handles, and in
a browser."""

import time

import jax.numpy as jnp
import numpy as np
import pytest
from browsers import CHROMIUM, difference, opened
from test_views import SHAKEN, plate

import jaxbody as jb

pytest.importorskip("viser")


class Address:
    """A page by its address, where `opened` expects the path of a file."""

    def __init__(self, url):
        self.url = url

    def as_uri(self):
        return self.url


@pytest.fixture(scope="module")
def modes():
    return jb.modes(jb.linearize(plate(), plate().reference))


@pytest.fixture
def live(modes):
    live = jb.view(modes, number=2, phase=jnp.pi / 2).serve(browser=False)
    live.controls["play"].value = False
    yield live
    live.stop()


def places(live):
    """Where the plate is in each frame, and where the browser's plate is."""
    path = next(path for path in live.stage.handles if path[:2] == ("bodies", "plate"))
    return (
        np.asarray(live.animation.part(*path).p),
        np.asarray(live.stage.handles[path].position),
        np.asarray(live.stage.handles[path].wxyz),
    )


@pytest.mark.long
def test_the_sliders_change_mode_amplitude_and_phase(live, modes):
    """What the browser is sent is what a view made with these numbers draws."""
    controls = live.controls
    assert list(controls) == ["play", "speed", "mode", "amplitude", "phase"]
    assert (controls["mode"].value, controls["mode"].max) == (2, 6) and controls[
        "phase"
    ].value == pytest.approx(90.0)
    for name, value, argument in (
        ("mode", 1, {"number": 1}),
        ("amplitude", 0.2, {"amplitude": 0.2}),
        ("phase", 0.0, {"phase": 0.0}),
    ):
        controls[name].value = value
        now = {
            "number": controls["mode"].value,
            "amplitude": controls["amplitude"].value,
            "phase": np.deg2rad(controls["phase"].value),
        }
        expected = jb.view(modes, **now | argument).animation
        path = next(path for path in live.stage.handles if path[:2] == ("bodies", "plate"))
        np.testing.assert_allclose(live.animation.part(*path).p, expected.part(*path).p, atol=1e-12)
        # rounded for the page
        np.testing.assert_allclose(places(live)[1], expected.part(*path).p[0], atol=1e-5)
    assert "mode 1:" in live.title.content


@pytest.mark.long
def test_a_view_that_does_not_play_shows_the_phase_of_the_slider(live):
    live.controls["mode"].value = 1
    at_rest = plate().reference
    live.controls["phase"].value = 90.0
    path = next(path for path in live.stage.handles if path[:2] == ("bodies", "plate"))
    np.testing.assert_allclose(places(live)[1], live.animation.part(*path).p[0], atol=1e-5)
    rest = jb.view(plate(), at=at_rest).animation.part(*path).p[0]
    # a quarter of a period from the extreme position
    np.testing.assert_allclose(places(live)[1], rest, atol=1e-5)
    assert live.frame == 0


@pytest.mark.long
def test_it_plays_until_it_is_stopped(live):
    live.controls["speed"].value = 3.0
    live.controls["play"].value = True
    end = time.monotonic() + 20.0
    while live.frame < 3:
        assert time.monotonic() < end
        time.sleep(0.02)
    live.stop()
    live.wait()
    frame = live.frame
    time.sleep(0.3)
    assert live.frame == frame


@pytest.mark.long
def test_a_motion_has_a_slider_of_time():
    motion = jb.simulate(plate(), jnp.linspace(0.0, 3.0, 76), motion=SHAKEN)
    view = jb.view(motion)
    live = view.serve(browser=False)
    try:
        assert list(live.controls) == ["play", "speed", "time"]
        live.controls["play"].value = False
        live.controls["time"].value = 1.5
        assert abs(live.animation.seconds[live.frame] - 1.5) < 0.03
        path = next(path for path in live.stage.handles if path[:2] == ("bodies", "plate"))
        np.testing.assert_allclose(
            live.stage.handles[path].position, view.animation.part(*path).p[live.frame], atol=1e-5
        )
        assert repr(live).startswith("View at http://127.0.0.1:")
    finally:
        live.stop()


@pytest.mark.long
def test_several_modes_side_by_side_keep_their_numbers(modes):
    live = jb.view(modes, number=[1, 2]).serve(browser=False)
    try:
        assert list(live.controls) == ["play", "speed", "amplitude", "phase"]
        live.controls["amplitude"].value = 0.1
        assert {path[0] for path in live.stage.handles} >= {"mode 1", "mode 2"}
    finally:
        live.stop()


@pytest.mark.skipif(CHROMIUM is None, reason="needs Chromium")
@pytest.mark.long
def test_a_browser_shows_what_the_sliders_say(live, tmp_path):
    with opened(Address(live.url), tmp_path) as page:
        first = page.drawn()
        assert page.value("document.body.innerText.includes('phase [degrees]')")
        live.controls["amplitude"].value = 0.5
        live.controls["phase"].value = 0.0
        end = time.monotonic() + 60
        while difference(first, page.picture()) < 0.005:
            assert time.monotonic() < end, "the picture did not change"
            time.sleep(0.5)
        assert not page.errors
