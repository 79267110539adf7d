"""Assembly, the configuration nearest to the drawn one in which all closures are fulfilled; and
driven positions, in which some readings have prescribed values too.

    c(q) = 0,   r_i(q) - r_i(q_0) = x_i

q_0 is the assembled reference. A reading r is a sensor with one number, or a coordinate, "rack.q".
In a calculation with equilibrium, the coordinates that closures and driven readings leave free are
in static equilibrium under elements, weights and loads.

    C(q) = 0: closures and readings,   dV/dDelta - Q + C_q' mu = 0

mu are the forces of closures and drives. The equations are solved by Newton steps in (q, mu), with
those of the forces divided by a stiffness k, so that all are in meters. A few more steps, in which
the last inverse is kept, are differentiated directly (mechanics/constraints.py).
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Bool, Float, Int
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import (
    JaxbodyError,
    Problem,
    Problems,
    Status,
    check_all_known,
    unknown,
)
from jaxbody.core.results import Result, finished
from jaxbody.geometry.frames import Instant
from jaxbody.mechanics.constraints import (
    CLOSED,
    LARGEST_STEP,
    ORDERS,
    PRECISE,
    RANK,
    STEPS,
    closure_gaps,
    near,
    solve,
    values_and_slopes,
)
from jaxbody.mechanics.dynamics import generalized
from jaxbody.model.element_states import relaxed
from jaxbody.model.inputs.loads import Load
from jaxbody.model.joints.frame_tables import (
    each_element,
    exerted,
    gaps,
    names_of_rows,
    redundant_rows,
    wrenches,
)
from jaxbody.model.joints.kinematics import Chart, Coordinates, jacobian
from jaxbody.model.models import Model, drawn_reference, scale_of, size_of
from jaxbody.model.preconditions import check_precision, check_state
from jaxbody.model.states import State
from jaxbody.numerics.small_systems import independent_rows
from jaxbody.sensors.kinematic_sensors import Position
from jaxbody.sensors.sensors import Sensor, check_sensors
from jaxbody.suspension.wheels import Wheel


class Assembly(Result):
    """An assembled configuration: `state` at rest, `gaps` of the conditions [m] before and after,
    `slopes`, their derivatives with respect to increments in meters, the number of `freedoms` that
    remain, `redundant` conditions, which follow from others. `status`: NOT_CLOSED. See `assemble`.
    """

    model: Model
    state: State
    gaps: Float[Array, "2 n"]
    slopes: Float[Array, "n nv"]
    status: Int[Array, ""]

    @property
    def freedoms(self) -> int:
        """The number of speeds that the closures leave free."""
        return self.model.layout.nv - len(independent_rows(np.asarray(self.slopes)))

    @property
    def redundant(self) -> tuple[str, ...]:
        """Conditions that follow from the others, such as those out of the plane of a
        planar linkage."""
        return redundant_rows(self.model, self.slopes)

    def explain(self) -> str:
        """Return which condition is furthest from being fulfilled, and its distance."""
        after = np.abs(np.asarray(self.gaps[1]))
        i = int(np.argmax(after))
        return (
            f"'{names_of_rows(self.model)[i]}' stays {after[i]:.3g} m apart; move a point, "
            "or leave out a closure"
        )

    def _tables(self) -> list[tables.PrintedTable]:
        columns = ("closure", "before [m]", "after [m]")
        names = [name for table in self.model.closures for name in table.names]
        ends = np.cumsum(
            [len(table.rows.rows) for table in self.model.closures for _ in table.names]
        )
        parts = np.split(np.abs(np.asarray(self.gaps)), ends[:-1], axis=1)
        rows = [
            (name, *tables.without_dust(part.max(1), 1.0))
            for name, part in zip(names, parts, strict=True)
        ]
        repeated = f"implied by the others: {', '.join(self.redundant)}" if self.redundant else ""
        note = "; ".join(
            filter(
                None, (f"{tables.counted(self.freedoms, 'freedom')} left", repeated, self.failure)
            )
        )
        return [tables.PrintedTable("Assembly", columns, rows, note)]


def assemble(model: Model, *, start: State | None = None, hold: Sequence[str] = ()) -> Assembly:
    """Find the state at rest, near a start, in which all closures of a model are fulfilled, by the
    least movement of its coordinates.

        c(q) = 0,   q <- q (+) -J^+ c(q),   J = dc/dDelta

    The state is an exact function of the model's numbers and of the start: it has derivatives in
    forward and reverse mode, up to the fourth order.

    Args:
        model: a model with closures; its drawn poses may be rough
        start: the state from which it is assembled; None: the drawn one
        hold: names of bodies whose coordinates do not move

    Errors: UNKNOWN_NAME, NO_CLOSURE, BAD_SHAPE; warns NOT_CLOSED, with the closure and its gap, if
    there is no such configuration.

    A point of a pendulum of 1 m, hung between two rods of 1 m in a plane, drawn 1 cm too low:

    >>> bar = jb.Body(mass=1.0, inertia=[1, 1, 1], position=[0.5, 0, -0.81])
    >>> plane = jb.joints.Composite(
    ...     "world", ["move", "move"], directions=[[1, 0, 0], [0, 0, 1]], points=[[0, 0, 0]] * 2
    ... )
    >>> rods = {
    ...     name: jb.closures.Rod(("world", [x, 0, 0]), ("bar", [0, 0, 0]), length=1.0)
    ...     for name, x in (("left", 0.0), ("right", 1.2))
    ... }
    >>> done = jb.suspension.assemble(
    ...     jb.Model(bodies={"bar": bar}, joints={"bar": plane}, closures=rods)
    ... )
    >>> x, z = (done.state.q + jnp.array([0.5, -0.81])).tolist()
    >>> done.freedoms, round(x, 9), round(z, 9)
    (0, 0.6, -0.8)
    """
    check_precision("assemble", model)
    if not model.closures:
        raise JaxbodyError(
            Problem(
                "NO_CLOSURE",
                "assemble.model",
                "has no closures",
                limit="one or more",
                hint="Give Model(closures={...}).",
            )
        )
    check_all_known(hold, "assemble.hold", model.layout.bodies)
    if start is not None:
        check_state(model, start, "assemble.start")
    assembly = _assembled(model, drawn_reference(model) if start is None else start, tuple(hold))
    return finished(assembly, _closed, lambda assembly: assembly.state)


def _closed(status):
    return status == Status.OK


@program
def _assembled(model: Model, start: State, hold: tuple[str, ...]) -> Assembly:
    before, held = closure_gaps(model, None, start.q), np.zeros(model.layout.nv, bool)
    for name in hold:
        held[model.layout.v_slices[name]] = True
    q, far = solve(closure_gaps, model, None, start.q, held)
    after, slopes = values_and_slopes(Chart(model), lambda q: closure_gaps(model, None, q), q)
    return Assembly(
        model=model,
        state=State(q, jnp.zeros_like(start.v)),
        gaps=jnp.stack([before, after]),
        slopes=slopes * scale_of(model, size_of(model))[None],
        status=jnp.where(far <= CLOSED, Status.OK, Status.NOT_CLOSED),
    )


REACHED = 1e-9  # largest residual of a reached position, relative to the size of the model


class Drive(eqx.Module):
    """A driven reading, a quantity whose values are prescribed: the reading of `sensor`, or, if
    that is None, the number in q with the index `coordinate`."""

    name: str = eqx.field(static=True)
    coordinate: int | None = eqx.field(static=True)
    unit: str = eqx.field(static=True)
    sensor: Sensor | None = None

    def reading(self, model: Model, q: Float[Array, "nq"], frames: Instant) -> Float[Array, ""]:
        return q[self.coordinate] if self.sensor is None else self.sensor.reading(model, frames)


def drives_of(model: Model, given: dict[str, Any], where: str) -> tuple[Drive, ...]:
    """Return the drives from {name: a sensor, "body.q" for a coordinate, or a wheel for the rise of
    its center}. Errors: UNKNOWN_NAME, BAD_SHAPE, WRONG_KIND."""
    given = {
        name: Position(by.on, by.center, axis="z") if isinstance(by, Wheel) else by
        for name, by in given.items()
    }
    check_sensors(
        {name: drive for name, drive in given.items() if not isinstance(drive, str)}, model, where
    )
    drives, places = [], model.layout.coordinate_places
    with Problems() as problems:
        for name, drive in given.items():
            place = f"{where}['{name}']"
            if isinstance(drive, str) and drive in places:
                at, _ = places[drive]
                drives.append(Drive(name, at, model.layout.q_units[at]))
            elif isinstance(drive, str):
                problem = unknown(drive, place, tuple(places))
                limit = "a coordinate of a joint, or a sensor"
                problems.collected.append(replace(problem, limit=limit))
            elif drive.shape != ():
                problems.add(
                    "BAD_SHAPE",
                    place,
                    f"reads {drive.shape[0]} numbers",
                    value=drive.shape,
                    limit="one number",
                    hint='Give it an axis: jb.Position("upright", [0, 0, 0], axis="z").',
                )
            else:
                drives.append(Drive(name, None, drive.unit, drive))
    return tuple(drives)


def conditions(
    model: Model, driven: tuple[tuple[Drive, ...], Array], q: Float[Array, "nq"]
) -> Float[Array, "n"]:
    """Return c(q), then r_i(q) - r_i(q_0) - x_i in meters; angles are multiplied by the size of the
    model."""
    drives, targets = driven
    coordinates = Coordinates(model)
    frames = coordinates.at_rest(q).at_time(jnp.zeros((), q.dtype))
    read = jnp.stack([drive.reading(model, q, frames) for drive in drives])
    scale = jnp.where(np.array([drive.unit == "m" for drive in drives]), 1.0, size_of(model))
    return jnp.concatenate([gaps(model, coordinates, frames, q), (read - targets) * scale])


def readings(model: Model, drives: tuple[Drive, ...], q: Float[Array, "nq"]) -> Float[Array, "nd"]:
    """Return the driven readings r_i(q)."""
    frames = Coordinates(model).at_rest(q).at_time(jnp.zeros((), q.dtype))
    return jnp.stack([drive.reading(model, q, frames) for drive in drives])


def positions(
    model: Model,
    drives: tuple[Drive, ...],
    targets: Float[Array, "n nd"],
    start: Float[Array, "nq"],
):
    """Return (q, status) for each row of targets, one after the other, each from the last one
    reached. A row beyond reach is NOT_CLOSED, with the q of the last one reached. The results have
    no derivatives: see `position`."""

    def following(last: Array, target: Array) -> tuple[Array, tuple[Array, Int[Array, ""]]]:
        q, far = solve(conditions, model, (drives, target), last)
        reached = far <= REACHED
        q = jnp.where(reached, q, last)
        return q, (q, jnp.where(reached, Status.OK, Status.NOT_CLOSED))

    return jax.lax.scan(following, start, targets)[1]


def position(
    model: Model, drives: tuple[Drive, ...], target: Float[Array, "nd"], q: Float[Array, "nq"]
) -> Float[Array, "nq"]:
    """Return the configuration with the target readings, as a differentiable function of the model
    and the target; `q` is a configuration that has them."""
    return near(conditions, model, (drives, target), q)


NEGATIVE = 1e-9  # eigenvalues below minus this fraction of the largest are negative


class Resting(NamedTuple):
    """An iterate of the search: q, the multipliers divided by the stiffness k, mu [m], and the
    inverse of the Jacobian of the equations."""

    q: Float[Array, "nq"]
    mu: Float[Array, "n"]
    inverse: Float[Array, "m m"]


class RestingSystem(NamedTuple):
    """The equations of static equilibrium of a model under loads, with driven readings
    (`drives`); forces are divided by a stiffness k, so that all residuals are in meters."""

    model: Model
    loads: tuple[Load, ...]
    drives: tuple[Drive, ...]
    k: Float[Array, ""]

    @property
    def scale(self) -> Float[Array, "nv"]:
        return scale_of(self.model, size_of(self.model))

    def moved(self, at: Resting, step: Float[Array, "m"]) -> Resting:
        """Return (q, mu) after a step, whose increments are in meters."""
        n = self.model.layout.nv
        return at._replace(
            q=Coordinates(self.model).retract(at.q, self.scale * step[:n]), mu=at.mu + step[n:]
        )

    def equations(self, target: Float[Array, "nd"], at: Resting) -> Float[Array, "m"]:
        """Return the residuals ((dV/dDelta - Q)/k + C_q' mu, C), with derivatives with respect to
        increments in meters."""
        model = relaxed(self.model)
        coordinates, zero = Coordinates(model), jnp.zeros(model.layout.nv, at.q.dtype)
        frames, axes = coordinates.frames_and_axes(at.q, zero, coordinates.supports.at_rest())
        now = frames.at_time(jnp.zeros((), at.q.dtype), State(at.q, zero))
        acting = exerted(model, now, self.loads)
        F, M = (x[model.layout.first_body :] for x in wrenches(model, now, acting))

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
        """Return the residuals and their Jacobian [H C_q'; C_q 0]."""

        slopes, values = jax.jacfwd(
            with_value(lambda step: self.equations(target, self.moved(at, step))), has_aux=True
        )(jnp.zeros(len(at.inverse), at.q.dtype))
        return values, slopes


def with_value(function):
    """Return the function x -> (y, y) for y = function(x), so that a derivative with auxiliary data
    traces `function` once."""
    return lambda x: ((y := function(x)), y)


def resting_positions(
    model: Model,
    loads: tuple[Load, ...],
    drives: tuple[Drive, ...],
    targets: Float[Array, "n nd"],
    start: Float[Array, "nq"],
) -> tuple[Resting, Int[Array, "n"], Float[Array, ""]]:
    """Return (positions, statuses, k) for each row of targets, each from the last one reached:
    NOT_CLOSED where no equilibrium is found, UNSTABLE where the energy has no minimum. The results
    have no derivatives: see `resting_position`."""
    rest = RestingSystem(model, loads, drives, _stiffness(model))
    size, nv = size_of(model), model.layout.nv
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
        values = jnp.linalg.eigvalsh((A + A.T) / 2)
        rank = jnp.sum(jnp.linalg.svdvals(A[nv:]) > RANK)
        # at a minimum as many are negative as there are independent conditions
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
    """Return q as a differentiable function of the model, the loads and the target; `at` is a
    position that has these readings."""
    at = jax.lax.stop_gradient(at)
    step: Any = lambda at, _: (rest.moved(at, -at.inverse @ rest.equations(target, at)), None)  # noqa: E731
    return jax.lax.scan(step, at, length=ORDERS)[0].q


def _stiffness(model: Model) -> Float[Array, ""]:
    """Return the largest second derivative of V(e) of the elements in the reference pose."""
    coordinates = Coordinates(relaxed(model))

    def stiffest(element, *frames):
        return jnp.max(jnp.abs(element.tangent(element.deformation(*(f.pose() for f in frames)))))

    of_tables = each_element(
        coordinates.model, coordinates.at_rest(coordinates.reference.q), stiffest
    )
    return jnp.max(jnp.concatenate([jnp.ravel(k) for k in of_tables]))
