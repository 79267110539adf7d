"""The closures of a model in tables of frames and coordinates: their conditions c, the names of
these, and the poses in which closures are drawn."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry.closures import Coupling, as_slide
from jaxbody.geometry.frames import Frame, Pose
from jaxbody.model.element_states import end_rows
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.layouts import Layout
from jaxbody.model.models import Model, size_of
from jaxbody.model.storage import KindTable
from jaxbody.numerics.small_systems import independent_rows

Tables = tuple[Any, ...]  # each with a row for each frame or coordinate


def names_of_rows(model: Model) -> tuple[str, ...]:
    """Return the name of each condition: ("upper ball x", ...)."""
    return tuple(
        f"{name} {row}"
        for table in model.closures
        for name in table.names
        for row in table.rows.rows
    )


def redundant_rows(model: Model, slopes: Float[Array, "n nv"]) -> tuple[str, ...]:
    """Return the names of the conditions that follow from the others, such as those out of the
    plane of a planar linkage; `slopes` are dc/dDelta in meters."""
    independent = independent_rows(np.asarray(slopes))
    return tuple(name for i, name in enumerate(names_of_rows(model)) if i not in independent)


def rank(model: Model) -> int:
    """Return the number of independent conditions, or its upper bound for a model built while
    traced."""
    nv = model.layout.nv
    return (
        min(nv, len(names_of_rows(model)))
        if model.independent is None
        else nv - len(model.independent)
    )


def turning_rows(model: Model) -> np.ndarray:
    """Return an array (n,), True for conditions on angles."""
    return np.array(
        [turns for table in model.closures for _ in table.names for turns in _turning(table)], bool
    )


def _turning(table: KindTable) -> np.ndarray:
    return np.array([row.startswith("turn") for row in table.rows.rows])


def gaps(
    model: Model, coordinates: Coordinates, frames: Frame, q: Float[Array, "nq"]
) -> Float[Array, "n"]:
    """Return c of all closures in meters; angles and sines of angles are multiplied by the size of
    the model."""
    return gaps_from(model, drawn(coordinates), frames, q)


def gaps_at(coordinates: Coordinates, q: Float[Array, "nq"]) -> Float[Array, "n"]:
    """Return c(q), with the supports in the poses of the coordinates."""
    return gaps(coordinates.model, coordinates, coordinates.at_rest(q), q)


def gaps_displaced(
    coordinates: Coordinates, q: Float[Array, "nq"], xi: Float[Array, "ns 6"]
) -> Float[Array, "n"]:
    """Return c at q on supports displaced by Xi."""
    supports = coordinates.supports_at(xi, jnp.zeros_like(xi))
    frames = coordinates.frames(q, jnp.zeros(coordinates.model.layout.nv, q.dtype), supports)
    return gaps(coordinates.model, coordinates, frames, q)


def gaps_from(
    model: Model, rests: list[Pose], frames: Frame, q: Float[Array, "nq"]
) -> Float[Array, "n"]:
    """Return c of all closures, for given relative poses as drawn (`rests`, from `drawn`)."""
    values = each_closure(
        model,
        rests,
        lambda closure, rest, poses: closure.gap(*poses, rest),
        (frames.pose(),),
        (slides(model.layout, q),),
    )
    return jnp.concatenate([jnp.zeros(0, frames.p.dtype), *values])


def drawn(coordinates: Coordinates) -> list[Pose]:
    """Return, for each table of closures, the poses of their second frames relative to their first
    ones when bodies and supports are as drawn: in the poses that the user gave. The present poses
    of supports have no effect."""
    model = coordinates.model
    coordinates = Coordinates(model)
    poses = coordinates.in_world
    return [
        A.inverse() @ B
        for A, B in (_ends(poses, end_rows(model, table)) for table in model.closures)
    ]


def each_closure(
    model: Model,
    rests: list[Pose],
    function: Callable[..., Any],
    of_frames: Tables,
    of_coordinates: Tables,
) -> list[Any]:
    """Return for each table of closures an array with the results of function(closure, pose as
    drawn, (row for A, row for B), ...), in which conditions on angles are scaled to meters. There
    is a pair of rows for each of the tables `of_frames` or, for couplings, `of_coordinates`."""
    size, results = jax.lax.stop_gradient(size_of(model)), []  # only a scale: c is zero
    for table, rest in zip(model.closures, rests, strict=True):
        unit = jnp.where(_turning(table), size, 1.0)[None]

        def in_meters(values: Array, unit=unit) -> Array:
            return (values * unit.reshape(*unit.shape, *[1] * (values.ndim - 2))).reshape(
                -1, *values.shape[2:]
            )

        places, tables = (
            (_couplings(model.layout, table), of_coordinates)
            if isinstance(table.rows, Coupling)
            else (end_rows(model, table), of_frames)
        )
        results.append(
            jax.tree.map(
                in_meters, jax.vmap(function)(table.rows, rest, *(_ends(x, places) for x in tables))
            )
        )
    return results


def _couplings(layout: Layout, table: KindTable) -> list[np.ndarray]:
    """Return the rows of both coordinates of each coupling, in tables of coordinates."""
    paths = list(layout.coordinate_places)
    return [np.full(len(table), paths.index(path)) for path in (table.rows.of, table.rows.by)]


def _ends(values: Any, places: list[np.ndarray]) -> tuple[Any, Any]:
    """Return the rows of a table at both ends of each closure."""
    A, B = places
    return jax.tree.map(lambda x: x[A], values), jax.tree.map(lambda x: x[B], values)


def slides(layout: Layout, q: Float[Array, "nq"]) -> Pose:
    """Return the coordinates to which couplings can refer, in the order of `coordinate_places`, as
    poses with p = (q, 0, 0) and R = 1."""
    return as_slide(q[np.array([i for i, _ in layout.coordinate_places.values()], int)])


def moving_slides(layout: Layout, q: Float[Array, "nq"], v: Float[Array, "nv"]) -> Frame:
    """Return the coordinates to which couplings can refer as frames: `slides` with their speeds."""
    speeds = as_slide(v[np.array([j for _, j in layout.coordinate_places.values()], int)]).p
    poses = slides(layout, q)
    return Frame(poses.p, poses.R, speeds, jnp.zeros_like(speeds))
