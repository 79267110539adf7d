"""An animation in a browser, with viser: as one HTML file that plays offline, or served live, with
sliders that change mode, amplitude and phase while the model vibrates, or the time of a motion."""

import contextlib
import io
import json
import threading
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from jaxbody.core.errors import import_extra
from jaxbody.views.scenes.animations import ANGLE, Animation, Camera, DrawnPart
from jaxbody.views.scenes.colors import INK, rgb
from jaxbody.views.scenes.poses import SWING
from jaxbody.views.scenes.shapes import Mesh

# rounding step of positions, relative to the size of the model; rounding makes the file smaller
STEP = 2.0**-21
STEP_OF_TURN = 2.0**-20  # rounding step of the components of quaternions
MARK = '__VISER_EMBED_DATA__="'  # what precedes the recording in viser's page
TRAIL = 2.5  # width of the line of a trail [pixels]


# script and style that are added to the head of viser's page: the recording that was chosen in the
# menu replaces the first, and the number of seconds of playing is hidden, as the scene has a clock
HEAD = """<style>.mantine-NumberInput-root {{display: none}}
#shown {{position: fixed; left: 12px; top: 10px; z-index: 2; font: 13px/1.4 sans-serif;
color: {ink}; white-space: pre-line; pointer-events: none; max-width: calc(100% - 24px)}}
#shown select {{display: block; font: inherit; max-width: 100%; margin-bottom: 4px;
pointer-events: auto}}</style>
<script>const recordings = {recordings},
  named = recordings.findIndex(x => "jaxbody " + x.title === window.name),
  chosen = named < 0 ? {first} : named;
window.__VISER_EMBED_DATA__ = recordings[chosen].data || window.__VISER_EMBED_DATA__;
addEventListener("DOMContentLoaded", () => {{
  const shown = document.createElement("div"), menu = document.createElement("select");
  shown.id = "shown";
  recordings.forEach(x => menu.add(new Option(x.title)));
  menu.selectedIndex = chosen;
  menu.onchange = () => {{ window.name = "jaxbody " + menu.value; location.reload(); }};
  shown.append(recordings.length > 1 ? menu : recordings[0].title + "\\n");
  shown.append(recordings[chosen].notes);
  document.body.append(shown);
}});</script></head>"""


def page_of(
    animations: Sequence[Animation], camera: Camera, first: int = 0, *, names: bool = True
) -> str:
    """Return the HTML text of an animation that plays by itself, with its title and notes, controls
    for time and speed and a tree of its parts. Several have a menu of their titles, at first
    `first`. Error: MISSING_EXTRA."""
    pages = [_page(animation, camera, names) for animation in animations]
    recordings = [
        {
            "title": animation.title.replace("\n", "; "),
            "notes": "\n".join(animation.notes),
            "data": page.split(MARK)[1].split('"')[0] if i != first else "",
        }
        for i, (animation, page) in enumerate(zip(animations, pages, strict=True))
    ]
    text = json.dumps(recordings).replace("<", "\\u003c")
    return pages[first].replace("</head>", HEAD.format(ink=INK, recordings=text, first=first), 1)


def _page(animation: Animation, camera: Camera, names: bool) -> str:
    """Return viser's page of one animation."""
    server = server_at(0)
    try:
        stage = Stage(server, animation, camera, names)
        recording = server.get_scene_serializer()
        for i, pause in enumerate(animation.pauses):
            stage.show(i)
            recording.insert_sleep(float(pause))
        with silent():
            return recording.as_html()
    finally:
        with silent():
            server.stop()


def server_at(port: int) -> Any:
    """Start a viser server that is reachable from this machine only; port 0 takes a free port.
    Error: MISSING_EXTRA."""
    viser = import_extra("viser", "view")
    with silent():
        return viser.ViserServer(host="127.0.0.1", port=port, verbose=False)


def silent() -> Any:
    """Return a context manager that suppresses the messages that the server prints."""
    return contextlib.redirect_stdout(io.StringIO())


class Stage:
    """The parts of an animation as objects in the scene of a viser server. `show(i)` moves them to
    frame i and sends only the changes to the browser."""

    def __init__(self, server: Any, animation: Animation, camera: Camera, names: bool):
        scene = self.scene = server.scene
        self.step = 2.0 ** np.floor(np.log2(STEP * animation.size))
        scene.set_up_direction(tuple(animation.up))
        server.initial_camera.position, server.initial_camera.look_at = (
            tuple(camera.position),
            tuple(camera.target),
        )
        server.initial_camera.fov = float(ANGLE)
        server.initial_camera.near, server.initial_camera.far = (
            1e-3 * animation.size,
            1e3 * animation.size,
        )
        self.handles: dict[tuple[str, ...], Any] = {}
        self.meshes: dict[tuple[str, ...], Mesh] = {}
        self.shown: dict[tuple[str, ...], dict[str, np.ndarray]] = {}
        self.take(animation)
        for label in animation.labels if names else ():
            at = self.places[label.path]["position"][0]
            self.shown[label.path] = {"position": at}
            self.handles[label.path] = scene.add_label(
                _name(label.path),
                label.text,
                position=tuple(at),
                font_screen_scale=0.9,
                anchor="bottom-center" if label.kind == "title" else "bottom-left",
                # there are many of these; the user switches them on in the tree of the scene
                visible=label.kind != "element",
            )
        for trail in animation.trails:
            segments = np.stack([trail.points[:-1], trail.points[1:]], 1)
            scene.add_line_segments(
                _name(trail.path),
                segments,
                rgb(trail.color),
                thickness=TRAIL,
                thickness_units="screen",
            )
        corner = tuple(_corner(animation, camera))
        self.clock = (
            scene.add_label("/time", "", position=corner, anchor="top-left")
            if animation.moves
            else None
        )

    def take(self, animation: Animation) -> None:
        """Replace the parts by those of another animation of the same model; parts with the same
        mesh stay, and the next `show` moves them."""
        self.animation = animation
        self.places = {part.path: _places(part, self.step) for part in animation.parts} | {
            label.path: {"position": _rounded(label.p, 64 * self.step)}
            for label in animation.labels
        }
        for path in [path for path in self.handles if path not in self.places]:
            self.handles.pop(path).remove()
        for part in animation.parts:
            same = part.path in self.handles and np.array_equal(
                self.meshes[part.path].vertices, part.mesh.vertices
            )
            if not same:
                self.handles[part.path] = self.scene.add_mesh_simple(
                    _name(part.path),
                    part.mesh.vertices,
                    part.mesh.faces,
                    color=rgb(part.color),
                    flat_shading=part.edged,
                    opacity=None if part.opacity == 1 else part.opacity,
                    cast_shadow=not part.below,
                    receive_shadow=not part.below,
                    **{name: tuple(values[0]) for name, values in self.places[part.path].items()},
                )
                self.meshes[part.path] = part.mesh
                self.shown[part.path] = {
                    name: values[0] for name, values in self.places[part.path].items()
                }

    def show(self, i: int) -> None:
        for path, handle in self.handles.items():
            for name, values in self.places[path].items():
                now = values[min(i, len(values) - 1)]
                if not np.array_equal(now, self.shown[path][name]):
                    self.shown[path][name] = now
                    setattr(handle, name, tuple(now.tolist()))
        if self.clock is not None:
            self.clock.text = self.animation.clock[i]


def _places(part: DrawnPart, step: float) -> dict[str, np.ndarray]:
    """Return {property of a handle: its values in all frames}, rounded; the signs of quaternions
    are chosen so that they vary continuously."""
    q = Rotation.from_matrix(part.R).as_quat()[:, [3, 0, 1, 2]]
    sign = np.where(np.sum(q[1:] * q[:-1], -1) < 0, -1.0, 1.0)
    q[1:] *= np.cumprod(sign)[:, None]
    return {
        "position": _rounded(part.p, step),
        "wxyz": _rounded(q, STEP_OF_TURN),
        "scale": _rounded(part.scale, step),
    }


def _rounded(x: np.ndarray, step: float) -> np.ndarray:
    return np.round(x / step) * step + 0.0


def _corner(animation: Animation, camera: Camera) -> np.ndarray:
    """Return the point at the lower left of the visible scene, in world axes, where the time is
    written."""
    inside = (animation.outline() - camera.target) @ camera.axes
    return camera.target + camera.axes @ np.array([inside[:, 0].min(), inside[:, 1].min(), 0.0])


def _name(path: tuple[str, ...]) -> str:
    """Return the name in the tree of the scene, with slashes in names of the model replaced, as a
    slash separates levels of the tree."""
    return "/" + "/".join(step.replace("/", "\u2044") for step in path)


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
