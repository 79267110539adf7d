"""What is viewed, as poses of all frames of a model at successive times: of a trajectory, modes, curves of a suspension, or one state."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.compilation.compile_options import jit_unoptimized
from jaxbody.core.arrays import is_concrete
from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.core.tables import without_dust
from jaxbody.geometry.frames import Pose
from jaxbody.inputs.roads import Road
from jaxbody.mechanics.energies import each_element
from jaxbody.mechanics.kinematics import Coordinates, frames_at_time
from jaxbody.mechanisms.alignment_curves import SuspensionCurves
from jaxbody.models.leaf_paths import by_name
from jaxbody.models.models import Model
from jaxbody.models.states import State
from jaxbody.simulations.trajectories import Trajectory
from jaxbody.vibrations.natural_modes import ModalResult

CYCLE = 40  # frames of a period of a mode
SECONDS = 2.0  # of a period of a mode as it is played
SWING = 1 / 8  # largest displacement of a drawn mode, relative to the size of the model


@dataclass(frozen=True)
class PoseSequence:
    """Poses of all frames of a model, in the order of its layout: world, supports, bodies."""

    model: Model
    times: np.ndarray  # (n,) [s]
    p: np.ndarray  # (n, frames, 3), origins
    R: np.ndarray  # (n, frames, 3, 3), orientations
    title: str = ""
    clock: tuple[str, ...] = ("",)  # what is written at each time
    forces: dict[str, np.ndarray] = field(default_factory=dict)  # {element: (n, ends, 3)} that it exerts on each end, world axes [N]
    roads: dict[str, Road] = field(default_factory=dict)  # {support: road under it}

    def row(self, name: str) -> int:
        return self.model.layout.frame(name)

    def points(self, name: str, point: Any) -> np.ndarray:
        """World positions (n, 3) of a point of a frame."""
        return self.p[:, self.row(name)] + self.R[:, self.row(name)] @ np.asarray(point, float)


def still(model: Model, state: State | None = None, title: str = "") -> PoseSequence:
    """One state of a model; None takes the reference pose."""
    state = model.reference if state is None else state
    p, R = _poses(model, state.q, np.zeros((1, model.layout.nv)))
    return PoseSequence(model, np.zeros(1), p, R, title)


def along(trajectory: Trajectory, most: int, forces: bool = False, title: str = "") -> PoseSequence:
    """The samples of a motion nearest to `most` equal steps of time; those after a failure are left out.

    Errors: BAD_SHAPE for a batch, NONFINITE where nothing is finite."""
    if trajectory.times.ndim > 1 or not is_concrete(trajectory.state.q):
        hint = "View one sample of the batch: jax.tree.map(lambda x: x[0], trajectory)."
        raise JaxbodyError(Problem("BAD_SHAPE", "view", "is a batch of trajectories", trajectory.times.shape, "one trajectory", hint))
    finite = np.isfinite(np.asarray(trajectory.state.q)).all(-1)
    if not finite.any():
        raise JaxbodyError(Problem("NONFINITE", "view", f"has no finite state: {trajectory.report()}", hint="Simulate it again."))
    known = np.flatnonzero(finite)
    times = np.asarray(trajectory.times, float)
    rows = known[nearest(times[known], most)]
    part = eqx.tree_at(
        lambda x: (x.times, x.state), trajectory, (trajectory.times[rows], jax.tree.map(lambda x: x[rows], trajectory.state))
    )
    frames, model = part.at_samples(_frames), trajectory.model
    exerted: dict[str, Any] = by_name(tuple(t.names for t in model.elements), part.at_samples(_end_forces), axis=1) if forces else {}
    roads = {name: motion for name, motion in zip(model.layout.supports, trajectory.motions, strict=False) if isinstance(motion, Road)}
    forces_by_name = {name: np.asarray(force) for name, force in exerted.items()}
    chosen = times[rows]
    step = np.diff(chosen).min(initial=1.0)
    clock = tuple(f"t = {t:.{int(np.clip(np.ceil(-np.log10(step) - 1e-9), 0, 6))}f} s" for t in chosen)
    return PoseSequence(model, chosen, np.asarray(frames.p), np.asarray(frames.R), title, clock, forces_by_name, roads)


def vibrating(modes: ModalResult, number: int, state: State | None, amplitude: float | None, phase: float) -> PoseSequence:
    """One period of a mode about a state, Delta = s Re(phi exp(i (2 pi f t + phase))), in two seconds whatever its frequency.

    Args:
        modes: natural or complex modes.
        number: number of the mode, from 1.
        state: the state about which it vibrates; None takes the reference pose.
        amplitude: the largest displacement of an attached point or center of mass [m]; None takes an eighth of the model's size.
        phase: phase of the first frame [rad].

    Error: UNKNOWN_MODE."""
    model, count = modes.model, modes.frequency.shape[0]
    if not 1 <= number <= count:
        limit = f"1 to {count}"
        raise JaxbodyError(Problem("UNKNOWN_MODE", "view.number", f"is {number}; there are modes {limit}", number, limit))
    q = (model.reference if state is None else state).q
    shape: Any = np.asarray(modes.shapes)[: model.layout.nv, number - 1]
    if not np.isfinite(shape).all():
        hint = "It is one of several with the same frequency: their shapes are not unique while they are differentiated."
        raise JaxbodyError(Problem("NONFINITE", "view.number", f"mode {number} has no finite shape", number, hint=hint))
    rest = still(model, State(q, jnp.zeros(model.layout.nv, q.dtype)))
    size = size_of_sequence(rest)
    extremes = np.stack([shape.real, shape.imag])
    trial = 1e-6 * size / max(np.abs(shape).max(), np.finfo(float).tiny)
    moved = PoseSequence(model, np.zeros(2), *_poses(model, q, trial * extremes))
    largest = np.linalg.norm(np.linalg.norm(_marks(moved) - _marks(rest), axis=-1), axis=0).max() / trial
    largest = max(largest, np.abs(shape[model.layout.turns]).max(initial=0.0) * size * SWING)  # where nothing is attached off O
    factor = (SWING * size if amplitude is None else float(amplitude)) / largest
    steps = np.arange(CYCLE) / CYCLE
    turn = np.exp(1j * (2 * np.pi * steps + phase))
    p, R = _poses(model, q, factor * np.real(shape * turn[:, None]))
    frequency = float(np.asarray(modes.frequency)[number - 1])
    ratio = float(without_dust(modes.damping_ratio, 1.0)[number - 1])
    title = f"mode {number}, {frequency:.4g} Hz\n" + (f"damping ratio {ratio:.2g}\n" if ratio > 0 else "") + modes.names[number - 1]
    clock = tuple(f"phase {round(360 * step + np.rad2deg(phase)) % 360} degrees" for step in steps)
    return PoseSequence(model, SECONDS * steps, p, R, title, clock)


def through(curves: SuspensionCurves) -> PoseSequence:
    """The configurations of curves over travel and steering that are within reach, there and back in the time of two periods of a mode.
    Error: NONFINITE where none is."""
    there = np.flatnonzero(np.asarray(curves.ok))
    if not len(there):
        raise JaxbodyError(Problem("NONFINITE", "view", f"has no configuration: {curves.report()}", hint="Give values within reach."))
    rows = np.r_[there, there[-2:0:-1]]
    frames = _configured(curves.model, curves.q[rows])
    values = [(drive.name, np.asarray(curves.over[drive.name])[rows], drive.unit) for drive in curves.drives]
    clock = tuple(", ".join(f"{name} {x[i]:.3f} {unit}" for name, x, unit in values) for i in range(len(rows)))
    return PoseSequence(curves.model, 2 * SECONDS * np.arange(len(rows)) / len(rows), np.asarray(frames.p), np.asarray(frames.R), "", clock)


def nearest(times: np.ndarray, most: int) -> np.ndarray:
    """The indices of samples nearest to equal steps of time, at most so many."""
    wanted = np.linspace(times[0], times[-1], min(most, len(times)))
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    return np.unique(np.where(wanted - times[before] <= times[after] - wanted, before, after))


def marks_of(model: Model) -> list[tuple[str, np.ndarray]]:
    """(frame, point): centers of mass and origins of bodies, ends of elements."""
    places = [(name, point) for name in model.layout.bodies for point in (np.asarray(model[name].com), np.zeros(3))]
    for table in model.elements:
        for end, points in enumerate(table.rows.points):
            places += [(link[end], point) for link, point in zip(table.links, np.asarray(points), strict=True)]
    return places


def size_of_sequence(sequence: PoseSequence) -> float:
    """The longest side of the box around the attached points and centers of mass in the first frame; 1 m for a point."""
    marks = _marks(sequence)[0]
    return float(np.ptp(marks, axis=0).max()) or 1.0


def _marks(sequence: PoseSequence) -> np.ndarray:
    """World positions (n, marks, 3)."""
    return np.stack([sequence.points(name, point) for name, point in marks_of(sequence.model)], 1)


def _poses(model: Model, q: Any, deltas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Poses at q (+) Delta for rows of Delta, with supports in their reference poses."""
    frames = _displaced(model, jnp.asarray(q), jnp.asarray(deltas, model.gravity.dtype))
    return np.asarray(frames.p), np.asarray(frames.R)


@jit_unoptimized
def _displaced(model: Model, q, deltas) -> Pose:
    coordinates = Coordinates(model)
    return jax.vmap(lambda delta: coordinates.at_rest(coordinates.retract(q, delta)).pose())(deltas)


@jit_unoptimized
def _configured(model: Model, q) -> Pose:
    coordinates = Coordinates(model)
    return jax.vmap(lambda q: coordinates.at_rest(q).pose())(q)


def _frames(model, motions, t, state) -> Pose:
    return frames_at_time(model, motions, t, state).pose()


def _end_forces(model, motions, t, state):
    def forces(element, *frames):
        return jnp.stack([force for force, _ in element.wrenches(*frames)])

    return tuple(each_element(model, frames_at_time(model, motions, t, state), forces))
