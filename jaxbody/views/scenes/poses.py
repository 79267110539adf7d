"""Poses of all frames of a model in successive configurations, for plots and views; elements and
closures by name."""

from collections.abc import Iterable
from dataclasses import dataclass, field
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.core.tables import without_dust
from jaxbody.geometry.closures import Closure, Coupling, Equation
from jaxbody.geometry.frames import Pose
from jaxbody.mechanics.free_motions import moved
from jaxbody.model.inputs.roads import Road
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.layouts import Layout
from jaxbody.model.models import Model
from jaxbody.model.storage import KindTable
from jaxbody.suspension.wheels import Wheel

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
    amplitude: float = 0.0  # largest displacement of a mode [m]
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


def check_number(modes: Any, number: int, where: str) -> None:
    """Check that the number of a mode is between 1 and the number of modes. Error: UNKNOWN_MODE."""
    count = modes.frequency.shape[0]
    if not 1 <= number <= count:
        raise JaxbodyError(
            Problem(
                "UNKNOWN_MODE",
                where,
                f"is {number}; there are modes 1 to {count}",
                number,
                f"1 to {count}",
            )
        )


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
            columns += [own[:, :-4] - start[:-4], turns(_matrices(own[:, -4:]), start[-4:])]
        else:
            columns.append(own - start)
    return np.concatenate(columns, 1)


def _matrices(quaternions: np.ndarray) -> np.ndarray:
    from scipy.spatial.transform import Rotation

    out, good = np.full((len(quaternions), 3, 3), np.nan), np.isfinite(quaternions).all(1)
    out[good] = Rotation.from_quat(quaternions[good][:, [1, 2, 3, 0]]).as_matrix()
    return out


def turns(R: np.ndarray, start: np.ndarray) -> np.ndarray:
    """Return rotation vectors of R (n, 3, 3) relative to an orientation (quaternion w, x, y, z), in
    world axes, unwrapped through full turns."""
    from scipy.spatial.transform import Rotation

    good = np.isfinite(R).all((1, 2))
    out = np.full((len(R), 3), np.nan)
    if good.any():
        out[good] = (
            Rotation.from_matrix(R[good]) * Rotation.from_quat(start[[1, 2, 3, 0]]).inv()
        ).as_rotvec()
    for i in range(1, len(out)):
        angle = np.linalg.norm(out[i])
        if np.isfinite(angle) and angle > 0:
            out[i] *= (
                1
                + 2 * np.pi * np.round((out[i - 1] @ out[i] / angle - angle) / (2 * np.pi)) / angle
            )
    return out
