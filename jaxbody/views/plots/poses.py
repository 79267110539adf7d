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
from jaxbody.geometry.closures import Closure, Coupling, Equation
from jaxbody.geometry.frames import Pose
from jaxbody.mechanics.free_motions import moved
from jaxbody.model.inputs.roads import Road
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.models import Model
from jaxbody.model.storage import KindTable
from jaxbody.suspension.wheels import Wheel

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
        """Return world positions (n, 3) of each end of an element or a closure."""
        return [self.points(*place) for place in zip(thing.between, thing.points, strict=True)]


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


def attaching(model: Model) -> list[KindTable]:
    """Return the tables of elements and of closures that have points in space."""
    return [
        *model.elements,
        *(table for table in model.closures if not isinstance(table.rows, Coupling | Equation)),
    ]


def named_rows(tables: Iterable[KindTable]) -> list[tuple[str, Any]]:
    """Return elements or closures with their names."""
    return [(name, table.row(name)) for table in tables for name in table.names]


def placed_closures(model: Model) -> list[tuple[str, Closure]]:
    """Return the closures that have points in space, with their names."""
    return named_rows(attaching(model)[len(model.elements) :])


def displaced_poses(model: Model, q: Any, deltas: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Return origins and orientations in the configurations q (+) Delta, where each row of `deltas`
    is a displacement Delta from q, with closures fulfilled and supports in their reference
    poses."""
    return poses_of(model, _moved(model, jnp.asarray(q), jnp.asarray(deltas, model.gravity.dtype)))


@program
def _moved(model: Model, q, deltas) -> Array:
    return jax.vmap(lambda delta: moved(Coordinates(model), q, delta))(deltas)


def poses_of(model: Model, q: Any, xi: Any = None) -> tuple[np.ndarray, np.ndarray]:
    """Return origins (n, frames, 3) and orientations (n, frames, 3, 3) for rows of q. `xi` (ns, 6):
    displacements of the supports [m, rad]; None for none."""
    xi = np.zeros((len(model.layout.supports), 6)) if xi is None else xi
    frames = _at_rest(model, jnp.asarray(q), jnp.asarray(xi, model.gravity.dtype))
    return np.asarray(frames.p), np.asarray(frames.R)


@program
def _at_rest(model: Model, q, xi) -> Pose:
    coordinates, v = Coordinates(model), jnp.zeros(model.layout.nv, q.dtype)
    supports = coordinates.supports_at(xi, jnp.zeros_like(xi))
    return jax.vmap(lambda q: coordinates.frames(q, v, supports).pose())(q)
