"""An animation in a browser: one HTML file that plays offline, made with viser."""

import contextlib
import io
import json
from collections.abc import Sequence
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from jaxbody.core.errors import import_extra
from jaxbody.views.scenes.animations import ANGLE, Animation, Camera, DrawnPart
from jaxbody.views.scenes.colors import INK, rgb

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
    viser = import_extra("viser", "view")
    with _silent():
        server = viser.ViserServer(host="127.0.0.1", port=0, verbose=False)
    try:
        stage = Stage(server, animation, camera, names)
        recording = server.get_scene_serializer()
        for i, pause in enumerate(animation.pauses):
            stage.show(i)
            recording.insert_sleep(float(pause))
        with _silent():
            return recording.as_html()
    finally:
        with _silent():
            server.stop()


def _silent() -> Any:
    """Return a context manager that suppresses the messages that the server prints."""
    return contextlib.redirect_stdout(io.StringIO())


class Stage:
    """The parts of an animation as objects in the scene of a viser server. `show(i)` moves them to
    frame i and sends only the changes to the browser."""

    def __init__(self, server: Any, animation: Animation, camera: Camera, names: bool):
        scene, self.animation = server.scene, animation
        step = 2.0 ** np.floor(np.log2(STEP * animation.size))
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
        self.places = {part.path: _places(part, step) for part in animation.parts} | {
            label.path: {"position": _rounded(label.p, 64 * step)} for label in animation.labels
        }
        self.shown = {
            path: {name: values[0] for name, values in places.items()}
            for path, places in self.places.items()
        }
        self.handles: dict[tuple[str, ...], Any] = {
            part.path: scene.add_mesh_simple(
                _name(part.path),
                part.mesh.vertices,
                part.mesh.faces,
                color=rgb(part.color),
                flat_shading=part.edged,
                opacity=None if part.opacity == 1 else part.opacity,
                cast_shadow=not part.below,
                receive_shadow=not part.below,
                **{name: tuple(value) for name, value in self.shown[part.path].items()},
            )
            for part in animation.parts
        }
        for label in animation.labels if names else ():
            self.handles[label.path] = scene.add_label(
                _name(label.path),
                label.text,
                position=tuple(self.shown[label.path]["position"]),
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
