"""A view that is served live: sliders in the browser change mode, amplitude and phase while the
model vibrates, or the time of a motion."""

import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np

from jaxbody.views.browser_pages import Stage, server_at, silent
from jaxbody.views.scenes.animations import Animation
from jaxbody.views.scenes.cameras import Camera
from jaxbody.views.scenes.poses import SWING

STILL = 0.1  # time between checks of the controls while nothing plays [s]
SPEEDS = (0.1, 3.0)


class Vibration(NamedTuple):
    """The modes that a live view draws: `drawn(numbers, amplitude, phase)` returns their animation;
    `numbers` of the modes, `amplitude` [m] and `phase` [rad] are the initial values, `most` is the
    largest number of a mode."""

    drawn: Callable[[Sequence[int], float | None, float], Animation]
    numbers: tuple[int, ...]
    most: int
    amplitude: float | None
    phase: float


class LiveView:
    """A view in a browser, drawn by this process. `url`: its address; `controls` {name: the handle
    of viser}, such as `controls["phase"].value` in degrees; `animation`: the animation that is
    drawn now; `stop()` ends it, `wait()` waits until Ctrl+C."""

    def __init__(
        self,
        animation: Animation,
        camera: Camera,
        names: bool,
        vibration: Vibration | None,
        port: int,
    ):
        self.animation, self.vibration, self.frame = animation, vibration, 0
        self.server, self.lock, self.ended = server_at(port), threading.RLock(), threading.Event()
        self.stage = Stage(self.server, animation, camera, names)
        self.stage.show(0)
        gui = self.server.gui
        self.title = gui.add_markdown(_lines(animation.caption))
        self.controls: dict[str, Any] = {}
        if animation.moves:
            self.controls["play"] = gui.add_checkbox("play", True)
            self.controls["speed"] = gui.add_slider("speed", *SPEEDS, 0.1, 1.0)
        if vibration is not None:
            self._add_vibration(gui, vibration)
        elif animation.moves:
            last = float(animation.seconds[-1])
            self.controls["time"] = gui.add_slider("time [s]", 0.0, last, last / 1000, 0.0)
            self.controls["time"].on_update(self._at_time)
        if animation.moves:
            threading.Thread(target=self._play, daemon=True).start()

    def _add_vibration(self, gui: Any, vibration: Vibration) -> None:
        amplitude, phase = self.animation.amplitude, np.rad2deg(vibration.phase) % 360
        most = 2 * max(amplitude, SWING * self.animation.size)
        if len(vibration.numbers) == 1 and vibration.most > 1:
            self.controls["mode"] = gui.add_slider(
                "mode", 1, vibration.most, 1, vibration.numbers[0]
            )
        self.controls["amplitude"] = gui.add_slider(
            "amplitude [m]", 0.0, most, most / 200, amplitude
        )
        self.controls["phase"] = gui.add_slider("phase [degrees]", 0.0, 360.0, 1.0, phase)
        for name in self.controls.keys() & {"mode", "amplitude", "phase"}:
            self.controls[name].on_update(self._vibrate)

    def _vibrate(self, _: Any) -> None:
        """Draw the modes with the values of the sliders; while it does not play, draw the first
        frame, which has the phase of the slider."""
        assert self.vibration is not None
        with self.lock:
            number = self.controls.get("mode")
            numbers = self.vibration.numbers if number is None else (int(number.value),)
            phase = np.deg2rad(self.controls["phase"].value)
            self.animation = self.vibration.drawn(
                numbers, self.controls["amplitude"].value, float(phase)
            )
            self.stage.take(self.animation)
            self.title.content = _lines(self.animation.caption)
            self.show(self.frame if self.controls["play"].value else 0)

    def _at_time(self, _: Any) -> None:
        with self.lock:
            if not self.controls["play"].value:
                self.show(
                    int(np.argmin(np.abs(self.animation.seconds - self.controls["time"].value)))
                )

    def show(self, frame: int) -> None:
        """Show a frame of the animation."""
        with self.lock, self.server.atomic():
            self.frame = frame
            self.stage.show(frame)

    def _play(self) -> None:
        while not self.ended.wait(self._pause()):
            with self.lock:
                if self.controls["play"].value and not self.ended.is_set():
                    self.show((self.frame + 1) % len(self.animation.seconds))
                    if "time" in self.controls:
                        self.controls["time"].value = float(self.animation.seconds[self.frame])

    def _pause(self) -> float:
        playing = self.controls["play"].value
        return (
            float(self.animation.pauses[self.frame]) / max(self.controls["speed"].value, SPEEDS[0])
            if playing
            else STILL
        )

    @property
    def url(self) -> str:
        return f"http://127.0.0.1:{self.server.get_port()}"

    def stop(self) -> None:
        """End the server; the page in the browser stays as it is."""
        self.ended.set()
        with self.lock, silent():
            self.server.stop()

    def wait(self) -> None:
        """Wait until the view is stopped, or until Ctrl+C."""
        try:
            self.ended.wait()
        except KeyboardInterrupt:
            self.stop()

    def __repr__(self) -> str:
        return f"View at {self.url}; stop() ends it"


def _lines(title: str) -> str:
    """Return text whose line breaks are kept in Markdown."""
    return title.replace("\n", "  \n")
