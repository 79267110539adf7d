"""Driven positions: the configurations of a model with closures in which some readings have
prescribed values, with the rest as drawn or in equilibrium.

    c(q) = 0,   r_i(q) - r_i(q_0) = x_i

q_0 is the assembled reference. A reading r is a sensor with one number, or a coordinate, "rack.q".


In equilibrium, what closures and driven readings leave free is at rest under
its elements, weights and loads.

    C(q) = 0: closures and readings,   dV/dDelta - Q + C_q' mu = 0

mu are the forces of closures and drives. Newton steps in (q, mu), whose equations of the forces are
divided by a stiffness k, so that all are in meters; a few more with the last inverse, held fixed,
are differentiated as they are (mechanics/constraints.py).
"""

from __future__ import annotations

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float, Int
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, unknown
from jaxbody.geometry.frames import Instant
from jaxbody.mechanics.constraints import LARGEST_STEP, ORDERS, PRECISE, RANK, STEPS, near, solve
from jaxbody.mechanics.dynamics import generalized
from jaxbody.model.element_states import relaxed
from jaxbody.model.inputs.loads import Load
from jaxbody.model.joints.closure_tables import gaps
from jaxbody.model.joints.element_tables import each_element, wrenches
from jaxbody.model.joints.kinematics import Coordinates, jacobian
from jaxbody.model.models import Model
from jaxbody.model.sizes import scale_of, size_of
from jaxbody.model.states import State
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


NEGATIVE = 1e-9  # an eigenvalue below minus this part of the largest counts


class Resting(NamedTuple):
    """q, the multipliers mu over the stiffness k [m], and the inverse of the slopes of
    the equations."""

    q: Float[Array, "nq"]
    mu: Float[Array, "n"]
    inverse: Float[Array, "m m"]


class RestingSystem(NamedTuple):
    """What is at rest: a model with driven readings and loads; k, the stiffness by which forces
    are divided."""

    model: Model
    loads: tuple[Load, ...]
    drives: tuple[Drive, ...]
    k: Float[Array, ""]

    @property
    def scale(self) -> Float[Array, "nv"]:
        return scale_of(self.model, size_of(self.model))

    def moved(self, at: Resting, step: Float[Array, "m"]) -> Resting:
        """(q, mu) after a step, the increments in meters."""
        n = self.model.layout.nv
        return at._replace(
            q=Coordinates(self.model).retract(at.q, self.scale * step[:n]), mu=at.mu + step[n:]
        )

    def equations(self, target: Float[Array, "nd"], at: Resting) -> Float[Array, "m"]:
        """((dV/dDelta - Q)/k + C_q' mu, C), increments in meters."""
        model = relaxed(self.model)
        coordinates, zero = Coordinates(model), jnp.zeros(model.layout.nv, at.q.dtype)
        frames, axes = coordinates.frames_and_axes(at.q, zero, coordinates.supports.at_rest())
        now = frames.at_time(jnp.zeros((), at.q.dtype), State(at.q, zero))
        F, M = (x[model.layout.first_body :] for x in wrenches(model, now, self.loads))

        def displaced(x):
            return conditions(
                self.model, (self.drives, target), coordinates.retract(at.q, self.scale * x)
            )

        C, pull = jax.vjp(displaced, zero)
        unbalanced = -self.scale * generalized(*jacobian(model.layout, frames, *axes), F, M)
        return jnp.concatenate([unbalanced / self.k + pull(at.mu)[0], C])

    def with_slopes(
        self, target: Float[Array, "nd"], at: Resting
    ) -> tuple[Float[Array, "m"], Float[Array, "m m"]]:
        """The equations and their slopes [H C_q'; C_q 0]."""

        def values(step):
            found = self.equations(target, self.moved(at, step))
            return found, found

        slopes, found = jax.jacfwd(values, has_aux=True)(jnp.zeros(len(at.inverse), at.q.dtype))
        return found, slopes


def resting_positions(
    model: Model,
    loads: tuple[Load, ...],
    drives: tuple[Drive, ...],
    targets: Float[Array, "n nd"],
    start: Float[Array, "nq"],
) -> tuple[Resting, Int[Array, "n"], Float[Array, ""]]:
    """(positions, statuses, k) for each row of targets, each from the last one reached: NOT_CLOSED
    where none is found, UNSTABLE where it is no minimum of the energy. They have no derivatives:
    see `resting_position`."""
    rest, size, nv = (
        RestingSystem(model, loads, drives, _stiffness(model)),
        size_of(model),
        model.layout.nv,
    )
    n = len(conditions(model, (drives, targets[0]), start))
    zero = jnp.zeros((nv + n, nv + n), start.dtype)

    def following(last: Resting, target: Array) -> tuple[Resting, tuple[Resting, Int[Array, ""]]]:
        def going_on(carry) -> Bool[Array, ""]:
            i, _, _, far = carry
            return (i < STEPS) & (far > PRECISE * size)

        def newton(carry):
            i, at, _, _ = carry
            F, A = rest.with_slopes(target, at)
            inverse = jnp.linalg.pinv(A, rtol=RANK)
            step, far = -inverse @ F, jnp.max(jnp.abs(F))
            largest = jnp.max(jnp.abs(step[:nv])) / size
            shorter = jnp.where(largest > LARGEST_STEP, LARGEST_STEP / largest, 1.0)
            return i + 1, rest.moved(at, step * shorter)._replace(inverse=inverse), A, far

        _, at, A, far = jax.lax.while_loop(
            going_on, newton, (jnp.array(0), last, zero, jnp.array(jnp.inf, start.dtype))
        )
        reached = far <= REACHED * size
        at = jax.tree.map(lambda new, old: jnp.where(reached, new, old), at, last)
        values, rank = (
            jnp.linalg.eigvalsh((A + A.T) / 2),
            jnp.sum(jnp.linalg.svdvals(A[nv:]) > RANK),
        )
        # as many as there are independent conditions, at a minimum
        negative = jnp.sum(values < -NEGATIVE * jnp.max(jnp.abs(values)))
        stable = jnp.where(negative > rank, Status.UNSTABLE, Status.OK)
        return at, (at, jnp.where(reached, stable, Status.NOT_CLOSED))

    places, status = jax.lax.scan(
        following, Resting(start, jnp.zeros(n, start.dtype), zero), targets
    )[1]
    return places, status, rest.k


def resting_position(
    rest: RestingSystem, target: Float[Array, "nd"], at: Resting
) -> Float[Array, "nq"]:
    """q as a function of the model, the loads and the readings, next to a position that
    has them."""
    at = jax.lax.stop_gradient(at)
    step: Any = lambda at, _: (rest.moved(at, -at.inverse @ rest.equations(target, at)), None)  # noqa: E731
    return jax.lax.scan(step, at, length=ORDERS)[0].q


def _stiffness(model: Model) -> Float[Array, ""]:
    """The largest second derivative of V(e) of the elements in the reference pose."""
    coordinates = Coordinates(relaxed(model))

    def stiffest(element, *frames):
        return jnp.max(jnp.abs(element.tangent(element.deformation(*(f.pose() for f in frames)))))

    of_tables = each_element(
        coordinates.model, coordinates.at_rest(coordinates.reference.q), stiffest
    )
    return jnp.max(jnp.concatenate([jnp.ravel(k) for k in of_tables]))
