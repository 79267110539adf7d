"""Driven positions: the configurations of a model with closures in which some readings have
prescribed values.

    c(q) = 0,   r_i(q) - r_i(q_0) = x_i

q_0 is the assembled reference. A reading r is a sensor with one number, or a coordinate, "rack.q".
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, Int
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, unknown
from jaxbody.geometry.frames import Instant
from jaxbody.mechanics.constraints import near, solve
from jaxbody.model.joints.closure_tables import gaps
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.models import Model
from jaxbody.model.sizes import size_of
from jaxbody.sensors.kinematic_sensors import Position
from jaxbody.sensors.sensors import Sensor, check_sensors
from jaxbody.suspension.wheels import Wheel

REACHED = 1e-9  # of the size of the model


class Drive(eqx.Module):
    """A driven reading of a name: a sensor, or the place of a coordinate in q."""

    name: str = eqx.field(static=True)
    coordinate: int | None = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    sensor: Sensor | None = None

    def reading(self, model: Model, q: Float[Array, "nq"], frames: Instant) -> Float[Array, ""]:
        return q[self.coordinate] if self.sensor is None else self.sensor.reading(model, frames)


def drives_of(model: Model, given: dict[str, Any], where: str) -> tuple[Drive, ...]:
    """The drives of {name: sensor, "body.q", or a wheel for the rise of its center}. Errors:
    UNKNOWN_NAME, BAD_SHAPE, WRONG_KIND."""
    given = {
        name: Position(by.on, by.center, axis="z") if isinstance(by, Wheel) else by
        for name, by in given.items()
    }
    check_sensors(
        {name: drive for name, drive in given.items() if not isinstance(drive, str)}, model, where
    )
    found = []
    with Problems() as problems:
        for name, drive in given.items():
            place = f"{where}['{name}']"
            if isinstance(drive, str):
                found.append(
                    problems.gather(
                        lambda drive=drive, name=name, place=place: _coordinate(
                            model, name, drive, place
                        )
                    )
                )
            elif drive.shape != ():
                hint = 'Give it an axis: jb.Position("upright", [0, 0, 0], axis="z").'
                problems.add(
                    "BAD_SHAPE",
                    place,
                    f"reads {drive.shape[0]} numbers",
                    value=drive.shape,
                    limit="one number",
                    hint=hint,
                )
            else:
                found.append(Drive(name, None, drive.unit, drive))
    return tuple(found)


def _coordinate(model: Model, name: str, path: str, where: str) -> Drive:
    places = model.layout.coordinate_places
    if path not in places:
        problem = unknown(path, where, tuple(places))
        raise JaxbodyError(
            Problem(
                problem.code,
                where,
                problem.message,
                path,
                "a coordinate of a joint, or a sensor",
                problem.hint,
            )
        )
    at, _ = places[path]
    return Drive(name, at, model.layout.q_units[at])


def conditions(
    model: Model, driven: tuple[tuple[Drive, ...], Array], q: Float[Array, "nq"]
) -> Float[Array, "n"]:
    """c(q), then r_i(q) - r_i(q_0) - x_i in meters, angles times the size of the model."""
    drives, targets = driven
    coordinates = Coordinates(model)
    frames = coordinates.at_rest(q).at_time(jnp.zeros((), q.dtype))
    read = jnp.stack([drive.reading(model, q, frames) for drive in drives])
    scale = jnp.where(np.array([drive.unit == "m" for drive in drives]), 1.0, size_of(model))
    return jnp.concatenate([gaps(model, coordinates, frames, q), (read - targets) * scale])


def readings(model: Model, drives: tuple[Drive, ...], q: Float[Array, "nq"]) -> Float[Array, "nd"]:
    """r_i(q)."""
    frames = Coordinates(model).at_rest(q).at_time(jnp.zeros((), q.dtype))
    return jnp.stack([drive.reading(model, q, frames) for drive in drives])


def positions(
    model: Model,
    drives: tuple[Drive, ...],
    targets: Float[Array, "n nd"],
    start: Float[Array, "nq"],
):
    """(q, status) for each row of targets, one after the other, each from the last one
    reached; beyond reach NOT_CLOSED, and the q of the last one reached. They have no
    derivatives: see `position`."""

    def following(last: Array, target: Array) -> tuple[Array, tuple[Array, Int[Array, ""]]]:
        q, far = solve(conditions, model, (drives, target), last)
        reached = far <= REACHED
        q = jnp.where(reached, q, last)
        return q, (q, jnp.where(reached, Status.OK, Status.NOT_CLOSED))

    return jax.lax.scan(following, start, targets)[1]


def position(
    model: Model, drives: tuple[Drive, ...], target: Float[Array, "nd"], q: Float[Array, "nq"]
) -> Float[Array, "nq"]:
    """The configuration of these readings as a function of the model and of them, next to one that
    has them."""
    return near(conditions, model, (drives, target), q)
