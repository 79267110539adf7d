"""Poses of all frames of a model in successive configurations: of a trajectory, of vibrating modes,
of a suspension over its travel, or of one state; elements and closures by name."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.spatial.transform import Rotation

from jaxbody.core.arrays import Array, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.core.tables import without_dust
from jaxbody.geometry.closures import Closure, Coupling, Equation
from jaxbody.geometry.frames import Pose
from jaxbody.mechanics.free_motions import moved
from jaxbody.model.elements.bushings import FramePair
from jaxbody.model.elements.contacts import Tyre
from jaxbody.model.elements.elements import LineElement
from jaxbody.model.forces.drives import CommandedForce, drive_tables
from jaxbody.model.inputs.roads import Road
from jaxbody.model.joints.frame_tables import each_element
from jaxbody.model.joints.kinematics import Coordinates, frames_at_time
from jaxbody.model.layouts import Layout
from jaxbody.model.leaf_paths import of_elements
from jaxbody.model.models import Model
from jaxbody.model.preconditions import check_state
from jaxbody.model.states import State
from jaxbody.model.storage import KindTable
from jaxbody.motion.trajectories import Trajectory
from jaxbody.suspension.alignment_curves import SuspensionCurves
from jaxbody.suspension.wheels import Wheel
from jaxbody.vibration.natural_modes import ModalResult

ROWS = 40  # configurations that one program computes at once, as many as a drawn mode has
SWING = 1 / 8  # largest displacement of a drawn mode, relative to the size of the model


@dataclass(frozen=True)
class PoseSequence:
    """Poses of all frames of a model, in the order of its layout: world, supports, bodies."""

    model: Model
    times: np.ndarray  # (n,) [s]
    p: np.ndarray  # (n, frames, 3), origins
    R: np.ndarray  # (n, frames, 3, 3), orientations
    title: str = ""
    clock: tuple[str, ...] = ("",)  # text at each time
    notes: tuple[str, ...] = ()  # how a drawn motion is scaled
    # {element: forces (n, ends, 3) on each of its ends, world axes [N]}
    forces: dict[str, np.ndarray] = field(default_factory=dict)
    roads: dict[str, Road] = field(default_factory=dict)  # {support: road under it}
    wheel: Wheel | None = None  # wheel of a suspension, drawn in addition to those of tyres

    def pose(self, name: str) -> tuple[np.ndarray, np.ndarray]:
        """Return positions (n, 3) and orientations (n, 3, 3) of a frame."""
        row = self.model.layout.frame(name)
        return self.p[:, row], self.R[:, row]

    def points(self, name: str, point: Any) -> np.ndarray:
        """Return world positions (n, 3) of a point given in the axes of a frame."""
        p, R = self.pose(name)
        return p + R @ np.asarray(point, float)

    def ends(self, thing: Any) -> list[np.ndarray]:
        """Return world positions (n, 3) of each end of an element or a closure; origins for a force
        without points."""
        places = thing.points or [np.zeros(3)] * len(thing.between)
        return [self.points(*place) for place in zip(thing.between, places, strict=True)]


def mode_title(modes: Any, number: int) -> str:
    """Return number, frequency, damping ratio and kinetic energies of a mode, in two lines."""
    frequency = float(np.asarray(modes.frequency)[number - 1])
    ratio = float(without_dust(modes.damping_ratio, 1.0)[number - 1])
    damping = f", damping ratio {ratio:.2g}" if ratio > 0 else ""
    return f"mode {number}: {frequency:.4g} Hz{damping}\nkinetic energy: {modes.names[number - 1]}"


def attaching(model: Model) -> list[KindTable]:
    """Return the tables of elements, forces, and closures that have points in space."""
    return [
        *model.elements,
        *model.forces,
        *(table for table in model.closures if not isinstance(table.rows, Coupling | Equation)),
    ]


def drawn_elements(model: Model) -> list[tuple[str, Any]]:
    """Return the elements and forces that have ends, with their names."""
    return named_rows((*model.attached, *(table for table in model.forces if table.links[0])))


def named_rows(tables: Iterable[KindTable]) -> list[tuple[str, Any]]:
    """Return elements or closures with their names."""
    return [(name, table.row(name)) for table in tables for name in table.names]


def placed_closures(model: Model) -> list[tuple[str, Closure]]:
    """Return the closures that have points in space, with their names."""
    return named_rows(attaching(model)[len(model.elements) + len(model.forces) :])


def displaced_poses(
    model: Model, q: Any, deltas: np.ndarray, xi: Any = 0.0
) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and orientations in the configurations q (+) Delta, where each row of `deltas`
    is a displacement Delta from q, with closures fulfilled; `xi` as in `poses_of`."""
    rows = jnp.asarray(_padded(deltas), model.gravity.dtype)
    q = np.asarray(_moved(model, jnp.asarray(q), rows))[: len(deltas)]
    return poses_of(model, q, xi)


@program
def _moved(model: Model, q, deltas) -> Array:
    return jax.vmap(lambda delta: moved(Coordinates(model), q, delta))(deltas)


def poses_of(model: Model, q: Any, xi: Any = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Return origins (n, frames, 3) and orientations (n, frames, 3, 3) for rows of q. `xi` (ns, 6),
    or (n, ns, 6): displacements of the supports [m, rad]."""
    xi = np.broadcast_to(xi, (len(q), len(model.layout.supports), 6))
    rows = jnp.asarray(_padded(xi), model.gravity.dtype)
    frames = _at_rest(model, jnp.asarray(_padded(np.asarray(q))), rows)
    return np.asarray(frames.p)[: len(q)], np.asarray(frames.R)[: len(q)]


def _padded(rows: np.ndarray) -> np.ndarray:
    """Return rows repeated to a multiple of ROWS, so that one program serves many lengths."""
    return np.resize(rows, (-(-len(rows) // ROWS) * ROWS, *rows.shape[1:]))


@program
def _at_rest(model: Model, q, xi) -> Pose:
    coordinates, v = Coordinates(model), jnp.zeros(model.layout.nv, q.dtype)

    def poses(q, xi):
        return coordinates.frames(q, v, coordinates.supports_at(xi, jnp.zeros_like(xi))).pose()

    return jax.vmap(poses)(q, xi)


def coordinate_changes(layout: Layout, q: Any, start: Any) -> np.ndarray:
    """Return the changes Delta (n, nv) from the coordinates `start` (nq,) to q (n, nq): q = start
    (+) Delta, with rotation vectors for quaternions."""
    q, rest, columns = np.asarray(q), np.asarray(start), []
    for block in layout.joints:
        own, start = q[:, layout.q_slices[block.owner]], rest[layout.q_slices[block.owner]]
        if block.quaternion:
            columns += [own[:, :-4] - start[:-4], turns(own[:, -4:], start[-4:])]
        else:
            columns.append(own - start)
    return np.concatenate(columns, 1)


def turns(R: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return rotation vectors of R (n, 3, 3), or of quaternions (n, 4), relative to an orientation
    (quaternion w, x, y, z), in world axes, unwrapped through full turns."""
    good = np.isfinite(R).reshape(len(R), -1).all(1)
    out = np.full((len(R), 3), np.nan)
    if good.any():
        known, rest = R[good], Rotation.from_quat(start, scalar_first=True)
        turned = (
            Rotation.from_matrix(known)
            if R.ndim == 3
            else Rotation.from_quat(known, scalar_first=True)
        )
        out[good] = (turned * rest.inv()).as_rotvec()
    for i in range(1, len(out)):
        angle = np.linalg.norm(out[i])
        if np.isfinite(angle) and angle > 0:
            out[i] *= (
                1
                + 2 * np.pi * np.round((out[i - 1] @ out[i] / angle - angle) / (2 * np.pi)) / angle
            )
    return out


CYCLE = 40  # frames in one period of a mode
SECONDS = 2.0  # playing time of one period of a mode
BUSHING = 0.032  # radius of a bushing, relative to the size of the model
# largest drawn relative displacement of the ends of a bushing, over its radius, and of those of a
# spring or a tyre, over its length
TOGETHER, STRETCHED = 0.8, 0.5
TRAVEL = 4.0  # seconds in which the curves of a suspension are played


def still(model: Model, state: State | None = None) -> PoseSequence:
    """Return the poses of one state of a model; None takes the reference pose."""
    state = model.reference if state is None else state
    check_state(model, state, "state")
    return PoseSequence(model, np.zeros(1), *poses_of(model, state.q[None]))


def along(
    trajectory: Trajectory,
    most: int,
    forces: bool = False,
    magnify: float = 1.0,
    about: State | None = None,
) -> PoseSequence:
    """Return the poses at those samples of a motion that are nearest to equally spaced times,
    without samples after a failure.

    Args:
        trajectory: the motion.
        most: largest number of samples.
        forces: whether the forces of elements on bodies are computed too.
        magnify: factor of all displacements from `about`; those of supports are from their
            reference poses.
        about: a state; None takes the first sample.

    Errors: BAD_SHAPE for a batch, NONFINITE if nothing is finite."""
    if trajectory.times.ndim > 1 or not is_concrete(trajectory.state.q):
        raise JaxbodyError(
            Problem(
                "BAD_SHAPE",
                "view",
                "is a batch of trajectories",
                trajectory.times.shape,
                "one trajectory",
                "View one sample of the batch: jax.tree.map(lambda x: x[0], trajectory).",
            )
        )
    known = np.flatnonzero(np.isfinite(np.asarray(trajectory.state.q)).all(-1))
    if not len(known):
        raise JaxbodyError(
            Problem(
                "NONFINITE",
                "view",
                f"has no finite state: {trajectory.report()}",
                hint="Simulate it again.",
            )
        )
    times = np.asarray(trajectory.times, float)
    rows = known[nearest(times[known], most)]
    part = eqx.tree_at(
        lambda x: (x.times, x.state),
        trajectory,
        (trajectory.times[rows], jax.tree.map(lambda x: x[rows], trajectory.state)),
    )
    frames, model = part.at_samples(_frames), trajectory.model
    poses, notes = (np.asarray(frames.p), np.asarray(frames.R)), ()
    if magnify != 1:
        q, xi = (part.state.q[0] if about is None else about.q), _displacements(model, *poses)
        deltas = magnify * coordinate_changes(model.layout, part.state.q, q)
        poses = displaced_poses(model, q, deltas, magnify * xi)
        notes = (f"displacements magnified {magnify:g} times",)
    exerted: dict[str, Any] = (
        of_elements(model, part.at_samples(_end_forces), axis=1) if forces else {}
    )
    roads = {
        name: motion
        for name, motion in zip(model.layout.supports, trajectory.motions, strict=False)
        if isinstance(motion, Road)
    }
    chosen = times[rows]
    step = np.diff(chosen).min(initial=1.0)
    clock = tuple(
        f"t = {t:.{int(np.clip(np.ceil(-np.log10(step) - 1e-9), 0, 6))}f} s" for t in chosen
    )
    return PoseSequence(
        model,
        chosen,
        *poses,
        clock=clock,
        notes=notes,
        forces={name: np.asarray(force) for name, force in exerted.items()},
        roads=roads,
    )


def _displacements(model: Model, p: np.ndarray, R: np.ndarray) -> np.ndarray:
    """Return the displacements Xi (n, ns, 6) of the supports from their reference poses."""
    rows = [
        np.concatenate(
            [
                p[:, 1 + i] - np.asarray(model[name].position),
                turns(R[:, 1 + i], np.asarray(model[name].orientation)),
            ],
            axis=1,
        )
        for i, name in enumerate(model.layout.supports)
    ]
    return np.stack(rows, 1) if rows else np.zeros((len(p), 0, 6))


def vibrating(
    modes: ModalResult, number: int, state: State | None, amplitude: float | None, phase: float
) -> PoseSequence:
    """Return one period of a mode about a state, Delta = s Re(phi exp(i (2 pi f t + phase))),
    played in two seconds whatever its frequency.

    Args:
        modes: natural or complex modes.
        number: number of the mode, from 1.
        state: the state about which it vibrates; None takes the reference pose.
        amplitude: the largest displacement of an attached point or center of mass [m]; None takes
            an eighth of the model's size, or less where the ends of an element would part.
        phase: phase of the first frame [rad].

    Errors: UNKNOWN_MODE, NONFINITE."""
    model, count = modes.model, modes.frequency.shape[0]
    if not 1 <= number <= count:
        raise JaxbodyError(
            Problem(
                "UNKNOWN_MODE",
                "view.number",
                f"is {number}; there are modes 1 to {count}",
                number,
                f"1 to {count}",
            )
        )
    q = (model.reference if state is None else state).q
    shape: Any = np.asarray(modes.shapes)[: model.layout.nv, number - 1]
    if not np.isfinite(shape).all():
        raise JaxbodyError(
            Problem(
                "NONFINITE",
                "view.number",
                f"mode {number} has no finite shape",
                number,
                hint=(
                    "It is one of several with the same frequency: their shapes are not unique "
                    "while they are differentiated."
                ),
            )
        )
    rest = still(model, State(q, jnp.zeros(model.layout.nv, q.dtype)))
    size = size_of_sequence(rest)
    extremes = np.stack([shape.real, shape.imag])
    trial = 1e-6 * size / max(np.abs(shape).max(), np.finfo(float).tiny)
    trials = PoseSequence(model, np.zeros(2), *displaced_poses(model, q, trial * extremes))
    largest = (
        np.linalg.norm(np.linalg.norm(marks(trials) - marks(rest), axis=-1), axis=0).max() / trial
    )
    # if all points are at origins of bodies, the rotation limits the amplitude
    largest = max(largest, np.abs(shape[model.layout.turns]).max(initial=0.0) * size * SWING)
    share, held = SWING, ""
    for name, element in named_rows((*model.attached, *drive_tables(model))):
        reach, stretch = _reach(element, rest, size), _stretch(element, rest, trials) / trial
        if amplitude is None and stretch * share * size > reach * largest:
            share, held = reach * largest / (stretch * size), f", limited by {name}"
    share = share if amplitude is None else float(amplitude) / size
    factor = share * size / largest
    steps = np.arange(CYCLE) / CYCLE
    turn = np.exp(1j * (2 * np.pi * steps + phase))
    p, R = displaced_poses(model, q, factor * np.real(shape * turn[:, None]))
    clock = tuple(f"phase {round(360 * step + np.rad2deg(phase)) % 360} degrees" for step in steps)
    note = f"largest displacement {size * share:.3g} m, {share:.2g} of the model's size" + held
    title = mode_title(modes, number)
    return PoseSequence(model, SECONDS * steps, p, R, title, clock, notes=(note,))


def _reach(element: Any, rest: PoseSequence, size: float) -> float:
    """Return how far the ends of an element can move relative to each other [m] before its drawing
    comes apart: most of the radius of a bushing, half of the length of a spring or a tyre."""
    if isinstance(element, FramePair):
        return TOGETHER * BUSHING * size
    ends = rest.ends(element)
    length = (
        np.linalg.norm(ends[1] - ends[0])
        if isinstance(element, LineElement | Tyre | CommandedForce)
        else 0.0
    )
    return STRETCHED * float(length) or np.inf


def _stretch(element: Any, rest: PoseSequence, trials: PoseSequence) -> float:
    """Return the largest relative displacement of the first two ends of an element [m]."""
    (a, b, *_), (at, to, *_) = rest.ends(element), trials.ends(element)
    return float(np.linalg.norm((to - at) - (b - a)))


def over_travel(curves: SuspensionCurves) -> PoseSequence:
    """Return the configurations of a suspension in the order of its curves, in equal steps of time,
    without positions that it cannot reach.

    Error: NONFINITE if it can reach none of them."""
    rows = np.flatnonzero(np.asarray(curves.ok))
    if not len(rows):
        raise JaxbodyError(
            Problem(
                "NONFINITE",
                "view",
                f"has no configuration: {curves.report()}",
                hint="Give values within reach.",
            )
        )
    clock = tuple(
        ", ".join(
            f"{drive.name} {_shown(float(curves.over[drive.name][i]), drive.unit)}"
            for drive in curves.drives
        )
        for i in rows
    )
    times = np.linspace(0.0, TRAVEL, len(rows)) if len(rows) > 1 else np.zeros(1)
    poses = poses_of(curves.model, curves.q[rows])
    return PoseSequence(curves.model, times, *poses, clock=clock, wheel=curves.wheel)


def _shown(value: float, unit: str) -> str:
    return f"{np.rad2deg(value):.1f} deg" if unit == "rad" else f"{1e3 * value:.1f} mm"


def nearest(times: np.ndarray, most: int) -> np.ndarray:
    """Return the indices of the samples nearest to equally spaced times, at most `most`."""
    wanted = np.linspace(times[0], times[-1], min(most, len(times)))
    after = np.clip(np.searchsorted(times, wanted), 1, max(len(times) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(times) - 1)
    return np.unique(np.where(wanted - times[before] <= times[after] - wanted, before, after))


def places_of(table: KindTable) -> list[tuple[str, np.ndarray]]:
    """Return (frame, point) of each end of elements or closures."""
    return [
        (link[end], point)
        for end, points in enumerate(table.rows.points)
        for link, point in zip(table.links, np.asarray(points, float), strict=True)
    ]


def size_of_sequence(sequence: PoseSequence) -> float:
    """Return the longest side of the box around the attached points and centers of mass in the
    first frame [m]; 1 m for a single point."""
    return float(np.ptp(marks(sequence)[0], axis=0).max()) or 1.0


def marks(sequence: PoseSequence) -> np.ndarray:
    """Return world positions (n, marks, 3) of centers of mass, origins of bodies, and the ends of
    elements and closures."""
    model = sequence.model
    places = [
        (name, point) for name in model.layout.bodies for point in (model[name].com, np.zeros(3))
    ]
    places += [place for table in attaching(model) for place in places_of(table)]
    return np.stack([sequence.points(name, point) for name, point in places], 1)


def _frames(model, motions, t, state) -> Pose:
    return frames_at_time(model, motions, t, state).pose()


def _end_forces(model, motions, t, state):
    def forces(element, *frames):
        return jnp.stack([force for force, _ in element.wrenches(*frames)])

    return tuple(each_element(model, frames_at_time(model, motions, t, state), forces))
