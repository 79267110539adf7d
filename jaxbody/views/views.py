"""jb.view: a model, a motion, modes or a tuned design in three dimensions, in a notebook, a
browser, one HTML file, or pictures."""

import sys
import tempfile
import webbrowser
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np

from jaxbody.core.arguments import checked_dict, kind_of, positive_number, whole_number
from jaxbody.core.arrays import checked, concrete, vector
from jaxbody.core.errors import Problems, unknown
from jaxbody.core.source_files import extension_of, writing
from jaxbody.core.tables import Printed, PrintedTable, counted
from jaxbody.design.tuning_results import Tuning
from jaxbody.mechanics.equilibria import Equilibrium
from jaxbody.model.models import Model
from jaxbody.model.states import State
from jaxbody.motion.trajectories import Trajectory
from jaxbody.suspension.alignment_curves import SuspensionCurves
from jaxbody.vibration.linearizations import LinearSystem
from jaxbody.vibration.natural_modes import ModalResult
from jaxbody.views.browser_pages import page_of
from jaxbody.views.scenes.animations import Animation, Camera, camera_for
from jaxbody.views.scenes.drawn_frames import Painter, save_gif, save_mp4, save_png
from jaxbody.views.scenes.poses import PoseSequence, along, over_travel, still, vibrating
from jaxbody.views.scenes.scenes import animation_of, side_by_side, with_ground
from jaxbody.views.scenes.shapes import Shape, shape_of

FORMATS = (".html", ".png", ".gif", ".mp4")
HEIGHT = 480  # height of a view in a notebook [pixels]
RATE, MOST = 25, 1500  # frames per second of playing, and largest number of frames
# durations between which a motion plays in real time; playing time of a shorter motion [s]
SHORTEST, LONGEST, USUAL = 2.0, 60.0, 5.0
MOST_MODES = 24  # largest number of modes in the menu of an HTML file
VIEWED = (Model, Equilibrium, Trajectory, SuspensionCurves, ModalResult)


class View(Printed):
    """A view in three dimensions, as returned by `jb.view`: `show()` opens it in a browser,
    `save(path)` writes .html, .png, .gif or .mp4, `plot()` draws it into axes; in a notebook it is
    shown inline. `animation` has all drawn parts with their poses.

    >>> jb.view(jb.presets.quarter_car()).animation.part("bodies", "wheel", "solid").color
    '#e0803a'
    """

    def __init__(
        self,
        animation: Animation,
        camera: Camera,
        names: bool,
        speed: float | None,
        menu: tuple[Callable[[int], Animation], int, int] | None = None,
    ):
        """`menu`: the animation of a mode by its number, the number that is shown first, and the
        largest one."""
        self.animation, self.camera, self.names = animation, camera, names
        self.speed, self.menu = speed, menu

    def to_html(self) -> str:
        """Return the text of one HTML file that needs no network. Error: MISSING_EXTRA."""
        if self.menu is None:
            return page_of([self.animation], self.camera, names=self.names)
        drawn, number, last = self.menu
        animations = [drawn(k) for k in range(1, last + 1)]
        return page_of(animations, self.camera, number - 1, names=self.names)

    def save(self, path: Any, *, at: float = 0.0, width: int | None = None) -> Path:
        """Write a file and return its path: .html plays in any browser offline, .gif and .mp4 are
        animations, .png is one frame.

        Args:
            path: path of the file, which replaces a file of the same name.
            at: time of playing at which a .png is taken [s].
            width: width of pictures in pixels; None takes 720, or less for a tall scene.

        Errors: UNKNOWN_FORMAT, NOT_SAVED, BAD_NUMBER; MISSING_EXTRA for .html and .mp4 without `pip
        install 'jaxbody[view]'`."""
        path = Path(path)
        with Problems() as problems:
            extension = problems.gather(lambda: extension_of(path, *FORMATS))
            width = (
                width
                if width is None
                else whole_number(width, "View.save width", problems, least=100)
            )
        if extension == ".html":
            text = self.to_html()
            with writing(path):
                path.write_text(text, encoding="utf-8")
            return path
        painter = Painter(self.animation, self.camera, width, names=self.names)
        if extension == ".png":
            save_png(path, painter, self._frame(at))
        else:
            (save_gif if extension == ".gif" else save_mp4)(path, painter)
        return path

    def plot(self, *, at: float = 0.0, ax: Any = None) -> Any:
        """Draw the picture at a time of playing [s] into axes of matplotlib and return the axes;
        None makes a new figure."""
        if ax is None:
            import matplotlib.pyplot as plt

            ax = plt.figure(figsize=(7.2, 4.8)).add_axes((0, 0, 1, 1))
        ax.imshow(
            Painter(self.animation, self.camera, None, names=self.names).picture(self._frame(at)),
            interpolation="antialiased",
        )
        ax.set_axis_off()
        return ax

    def show(self) -> None:
        """Show the view inline in a notebook; from a script, write it to a temporary HTML file and
        open that in a browser. Error: MISSING_EXTRA."""
        ipython: Any = sys.modules.get("IPython")
        if ipython is not None and hasattr(ipython.get_ipython(), "kernel"):
            ipython.display.display(self)
            return
        with tempfile.NamedTemporaryFile(
            "w", suffix=".html", prefix="jaxbody-", delete=False, encoding="utf-8"
        ) as file:
            file.write(self.to_html())
        webbrowser.open(Path(file.name).as_uri())

    def _repr_html_(self) -> str:
        page = escape(self.to_html(), quote=True)
        return (
            f'<iframe srcdoc="{page}" style="width: 100%; height: {HEIGHT}px; border: 1px '
            'solid #dfe4ea"></iframe>'
        )

    def _frame(self, at: float) -> int:
        return int(np.argmin(np.abs(self.animation.seconds - at)))

    def _tables(self) -> list[PrintedTable]:
        groups: dict[str, dict[str, None]] = {}
        for part in self.animation.parts:
            groups.setdefault(part.path[0], {}).update(dict.fromkeys(part.path[1:2]))
        rows = [
            (name, ", ".join([*group][:8]) + (", ..." if len(group) > 8 else ""))
            for name, group in groups.items()
            if group
        ]
        seconds = float(self.animation.seconds[-1])
        pace = " in real time" if self.speed == 1 else ""
        played = (
            f"{counted(len(self.animation.seconds), 'frame')}, {seconds:.3g} s{pace}"
            if self.animation.moves
            else "one frame"
        )
        return [PrintedTable("View", ("", ""), rows, "; ".join([played, *self.animation.notes]))]


def view(
    what: Any,
    *,
    shapes: Mapping[str, Any] | None = None,
    at: Any = None,
    number: int | Sequence[int] = 1,
    amplitude: float | None = None,
    phase: float = 0.0,
    forces: bool = False,
    trails: Mapping[str, Any] | Sequence[str] = (),
    magnify: float = 1.0,
    speed: float | None = None,
    names: bool = True,
    direction: Any = None,
) -> View:
    """Show a model or a result in three dimensions: bodies, springs that stretch, dampers, joints,
    supports and roads that move.

    No options are needed: a body is drawn as the hull of its attached points and of its inertia, a
    spring as a coil of its length, a tyre with its radius; gravity points down. Only poses are
    computed, and forces if these are drawn.

    Args:
        what: a model, an equilibrium, a trajectory, modes (natural or complex), the curves of a
            suspension, which moves over its travel, a tuning (the model before and after), or
            {name: any of these}, side by side.
        shapes: {body or support: a mesh of trimesh, or several}, in its axes [m], in place of the
            default ones, such as trimesh.creation.box([1.2, 0.4, 0.1]) or trimesh.load_mesh(path)
            with the color of its faces; they do not affect mass and inertia.
        at: the state in which a model is drawn, about which modes vibrate, or from which
            displacements are magnified: a State, an equilibrium or a linearization; None takes the
            reference pose, or the first sample of a trajectory.
        number: number of the mode, from 1, with a menu of the others in an HTML file; several are
            drawn side by side.
        amplitude: largest displacement of a drawn mode [m]; None takes an eighth of the model's
            size, or less where the ends of an element would part.
        phase: phase of a mode in the first frame [rad].
        forces: whether arrows show the forces of elements on bodies along a trajectory, all to one
            scale.
        trails: points whose paths are drawn: names of bodies for their origins, or {name: (body,
            point in its axes [m])}.
        magnify: factor by which the displacements of a trajectory are drawn larger.
        speed: seconds of a motion per second of playing; None takes 1, but plays a motion shorter
            than 2 s in about 5 s and a long one in at most 60 s.
        names: whether names are written.
        direction: direction from the model to the camera, in world axes; None chooses it.

    Errors: WRONG_KIND, NO_DATA, UNKNOWN_NAME, UNKNOWN_MODE, NOT_POSITIVE, BAD_SHAPE, NON_FINITE,
    ZERO_AXIS. `view(...).save("x.html")` and `.show()` need `pip install 'jaxbody[view]'`.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     gravity=[0, -9.81, 0],
    ...     elements={
    ...         "s": jb.Spring(
    ...             ("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=50.0, free_length=0.9
    ...         )
    ...     },
    ... )
    >>> coil = jb.view(model).animation.part("elements", "s", "coil")
    >>> float(coil.scale[0, 2])  # its length [m]
    1.0
    """
    with Problems() as problems:
        given = _named(what, problems)
        models = [
            thing.model if not isinstance(thing, Model) else thing for thing in given.values()
        ]
        own_shapes = _shapes(shapes, models, problems)
        marks = _trails(trails, models, problems)
        state = at.state if isinstance(at, Equilibrium | LinearSystem) else at
        if not isinstance(state, State | None):
            problems.add(
                "WRONG_KIND",
                "view.at",
                f"is {kind_of(at)}",
                value=at,
                limit="a State, an equilibrium or a linearization",
            )
        seen_from = (
            None if direction is None else concrete(vector(direction, "view.direction", problems))
        )
        if seen_from is not None and not np.any(seen_from):
            problems.add(
                "ZERO_AXIS",
                "view.direction",
                "has length zero",
                value=seen_from,
                limit="> 0",
                hint="Give such as [1, -2, 1].",
            )
        for name, value in (("amplitude", amplitude), ("magnify", magnify), ("speed", speed)):
            if value is not None:
                positive_number(value, f"view.{name}", problems)
        turn: Any = checked(phase, ((),), "view.phase", problems)
        numbers = [
            whole_number(x, "view.number", problems)
            for x in np.atleast_1d(np.asarray(number)).tolist()
        ]
    pace = _speed(given, speed)

    def drawn(numbers: Sequence[int]) -> Animation:
        sequences: dict[str, PoseSequence] = {}
        for name, thing in given.items():
            if isinstance(thing, Trajectory):
                duration = (
                    float(thing.times[-1] - thing.times[0]) / (pace or 1.0)
                    if thing.times.ndim == 1
                    else 1.0
                )
                most = int(np.clip(round(duration * RATE), 2, MOST))
                sequences[name] = along(thing, most, forces, magnify, state)
            elif isinstance(thing, ModalResult):
                for k in numbers:
                    label = f"{name}, mode {k}".removeprefix(", ") if len(numbers) > 1 else name
                    sequences[label] = vibrating(thing, k, state, amplitude, float(turn))
            elif isinstance(thing, SuspensionCurves):
                sequences[name] = over_travel(thing)
            elif isinstance(thing, Equilibrium):
                sequences[name] = still(thing.model, thing.state)
            else:
                sequences[name] = still(thing, state)
        largest = max(
            (
                float(np.linalg.norm(f, axis=-1).max())
                for s in sequences.values()
                for f in s.forces.values()
            ),
            default=0.0,
        )
        animations = {
            name: animation_of(
                sequence,
                speed=pace or 1.0,
                shapes=own_shapes,
                trails=marks,
                longest_force=largest or 1.0,
            )
            for name, sequence in sequences.items()
        }
        return with_ground(
            next(iter(animations.values())) if len(animations) == 1 else side_by_side(animations)
        )

    animation = drawn(numbers)
    modes = [thing.frequency.shape[0] for thing in given.values() if isinstance(thing, ModalResult)]
    menu = None
    if modes and len(numbers) == 1:
        last = max(min(*modes, MOST_MODES), numbers[0])
        menu = (lambda k: drawn((k,))), numbers[0], last
    if pace not in (None, 1.0):
        animation = replace(
            animation, notes=(*animation.notes, f"{pace:g} times the speed of the motion")
        )
    return View(animation, camera_for(animation, seen_from), names, pace, menu)


def _named(what: Any, problems: Problems) -> dict[str, Any]:
    """Return {name: viewed model or result}; a single one has the name "", and a tuning becomes two
    models, before and after."""
    if isinstance(what, Tuning):
        return {"before": what.space.model, "after": what.model}
    given = (
        checked_dict(what, "view", "name: result", problems)
        if isinstance(what, Mapping)
        else {"": what}
    )
    if not given:
        problems.add(
            "NO_DATA",
            "view",
            "is empty",
            limit="at least one",
            hint='Give {"before": ..., "after": ...}.',
        )
    for name, thing in given.items():
        if not isinstance(thing, VIEWED):
            problems.add(
                "WRONG_KIND",
                f"view['{name}']" if name else "view",
                f"is {kind_of(thing)}",
                value=thing,
                hint=(
                    "Give a model, an equilibrium, a trajectory, modes, curves of a suspension or "
                    "a tuning, or several of them in a dict."
                ),
            )
        elif (thing if isinstance(thing, Model) else thing.model).gravity.ndim > 1:
            problems.add(
                "BAD_SHAPE",
                "view",
                "is a batch",
                value=thing,
                limit="one model",
                hint="View one of the batch.",
            )
    problems.raise_if_any()
    return given


def _shapes(shapes: Any, models: list[Model], problems: Problems) -> dict[str, tuple[Shape, ...]]:
    known = tuple(
        dict.fromkeys(
            name for model in models for name in (*model.layout.bodies, *model.layout.supports)
        )
    )
    result = {}
    for name, shape in checked_dict(
        shapes, "view.shapes", "body: trimesh.creation.box(...)", problems
    ).items():
        several = [shape_of(x) for x in (shape if isinstance(shape, list | tuple) else (shape,))]
        if name not in known:
            problems.collected.append(unknown(name, "view.shapes", known))
        if None in several:
            problems.add(
                "WRONG_KIND",
                f"view.shapes['{name}']",
                f"is {kind_of(shape)}",
                value=shape,
                limit="a mesh, or several",
                hint="Give such as trimesh.creation.box([1.2, 0.4, 0.1]).",
            )
        result[name] = tuple(several)
    return result


def _trails(
    trails: Any, models: list[Model], problems: Problems
) -> list[tuple[str, str, np.ndarray]]:
    """Return (name, frame, point in its axes [m]) of each trail."""
    known = tuple(
        name
        for name in models[0].layout.frames
        if all(name in model.layout.frames for model in models)
    )
    given = (
        dict(trails)
        if isinstance(trails, Mapping)
        else {name: name for name in ([trails] if isinstance(trails, str) else trails)}
    )
    result = []
    for name, place in given.items():
        frame, point = (
            (str(place[0]), place[1])
            if isinstance(place, tuple | list) and len(place) == 2
            else (str(place), (0, 0, 0))
        )
        if frame not in known:
            problems.collected.append(unknown(frame, "view.trails", known[1:]))
            continue
        result.append(
            (str(name), frame, concrete(vector(point, f"view.trails['{name}']", problems)))
        )
    return result


def _speed(given: dict[str, Any], speed: float | None) -> float | None:
    """Return the seconds of motion per second of playing; None if nothing moves in time."""
    durations = [
        float(x.times[-1] - x.times[0])
        for x in given.values()
        if isinstance(x, Trajectory) and x.times.ndim == 1
    ]
    if not durations:
        return None
    if speed is not None:
        return float(speed)
    longest = max(durations) or 1.0
    if SHORTEST <= longest <= LONGEST:
        return 1.0
    wanted = longest / (USUAL if longest < SHORTEST else LONGEST)
    steps = np.array([1, 2, 5, 10]) * 10.0 ** np.floor(np.log10(wanted) + 1e-9)
    return float(
        steps[steps <= wanted * (1 + 1e-9)].max()
        if longest < SHORTEST
        else steps[steps >= wanted * (1 - 1e-9)].min()
    )
