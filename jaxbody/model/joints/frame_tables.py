"""Elements and closures of a model in tables of frames: any function of each element, the wrenches
that act on the frames, and the states of elements; the conditions c of closures, the names of
these, and the poses in which closures are drawn."""

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float
from jaxbody.geometry.closures import Coupling, as_slide
from jaxbody.geometry.frames import Frame, Instant, Pose
from jaxbody.geometry.vectors import cross, rotate
from jaxbody.model.element_states import end_rows, relaxed, rest_states
from jaxbody.model.forces.controllers import Controller, followed_at_once, is_sampled
from jaxbody.model.forces.force_elements import ForceElement
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.laws.law_states import Held, Relaxed, memories
from jaxbody.model.layouts import Layout
from jaxbody.model.models import Model, size_of
from jaxbody.model.states import State
from jaxbody.model.storage import KindTable
from jaxbody.numerics.small_systems import independent_rows
from jaxbody.numerics.xla_workarounds import sums

Xi = Float[Array, "ns 6"] | None


def frames_of(model: Model, state: State, xi: Xi = None, xi_dot: Xi = None) -> Frame:
    """Return the table of frames in a state, with the supports displaced by Xi."""
    coordinates, zero = (
        Coordinates(model),
        jnp.zeros((len(model.layout.supports), 6), state.q.dtype),
    )
    xi, xi_dot = (zero if x is None else jnp.reshape(x, zero.shape) for x in (xi, xi_dot))
    return coordinates.frames(state.q, state.v, coordinates.supports_at(xi, xi_dot))


def outside_law_range(model: Model, frames: Frame) -> Bool[Array, "ne"]:
    """Return whether each element, in the order of their names, is outside the range of its law."""
    beyond = (
        of_table(model, frames, table, lambda s, *F: s.beyond(*s.rates(*F)))
        for table in model.attached
    )
    return jnp.concatenate([jnp.zeros(0, bool), *beyond])


def each_element(model: Model, frames: Frame, function) -> list:
    """Return function(element, A, B, ...) of all elements and their frames, table by table."""
    return [of_table(model, frames, table, function) for table in model.elements]


def inertial_tables(model: Model) -> list[KindTable]:
    """Return the tables of elements that have a kinetic energy."""
    return [table for table in model.elements if table.rows.has_inertia()]


def of_table(model: Model, frames: Frame, table: KindTable, function) -> Any:
    """Return function(element, A, B, ...) of the elements of one table."""
    return jax.vmap(function)(table.rows, *(frames[rows] for rows in end_rows(model, table)))


Acting = list[tuple[tuple[str, ...], Any]]  # (names of frames, forces and moments on these)


def ends_at(model: Model, now: Instant, force: ForceElement) -> tuple[Instant, ...]:
    """Return the frames of one force element."""
    return tuple(now.frame(model.layout.frame(name)) for name in force.between)


def exerted_by_loads(model: Model, now: Instant, loads: tuple[ForceElement, ...]) -> Acting:
    """Return the forces and moments of loads, [(name of the frame, wrench)]."""
    parts = []
    for load in loads:
        seen = load.seen(model, now, ends_at(model, now, load), rates=False)
        for name, wrench in zip(load.between, load.forces(seen), strict=True):
            parts.append(((name,), tuple(x[None] for x in wrench)))
    return parts


def exerted(model: Model, now: Instant, loads: tuple[ForceElement, ...] = ()) -> Acting:
    """Return the forces and moments of loads and of the force elements of a model that holds its
    states."""
    parts = exerted_by_loads(model, now, loads)
    for table, by_end in zip(
        model.forces, each_force(model, now, lambda x, now: x.forces(now)), strict=True
    ):
        parts += zip(zip(*table.links, strict=True), by_end, strict=True)
    return parts


def total(model: Model, acting: Acting) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Return the total force and moment on each frame."""
    none = jnp.zeros((len(model.layout.frames), 3), model.gravity.dtype)
    return summed_on_frames(model, (), (), acting) if acting else (none, none)


def power(model: Model, acting: Acting, frames: Frame) -> Float[Array, ""]:
    """Return P = sum of F . v + M . w."""
    F, M = total(model, acting)
    return jnp.sum(F * frames.v) + jnp.sum(M * frames.w)


def each_force(model: Model, now: Instant, function, *, rates: bool = False) -> list:
    """Return function(force element, what it sees) of the force elements, table by table."""
    given, none = commands(model, now, rates=rates), jnp.zeros((), now.p.dtype)

    def of(force, command, *frames):
        return function(force, force.seen(model, now, frames, command, rates=rates))

    return [
        jax.vmap(of)(
            table.rows,
            jnp.stack([given.get(name, none) for name in table.names]),
            *(now[rows] for rows in end_rows(model, table)),
        )
        for table in model.forces
    ]


def commands(model: Model, now: Instant, *, rates: bool = True) -> dict[str, Float[Array, ""]]:
    """Return the commands of all controllers, {drive: command}; without `rates` only those that
    forces follow at once."""
    at_once, given = followed_at_once(model), {}
    for table in model.forces:
        for name in table.names if isinstance(table.rows, Controller) else ():
            controller = table.row(name)
            if rates or at_once & set(controller.drives):
                u = controller.command(controller.seen(model, now, (), rates=rates))
                given |= zip(controller.drives, jnp.atleast_1d(u), strict=True)
    return given


def states_after_samples(model: Model, now: Instant) -> Float[Array, "nf"]:
    """Return the states of force elements after the samples that controllers take at an instant, of
    a model that holds its states."""
    parts = [jnp.zeros(0, now.p.dtype)]
    for table in model.forces:
        if is_sampled(table):
            for name in table.names:
                controller = table.row(name)
                seen = controller.seen(model, now, (), rates=True)
                z = controller.sampled(seen, *controller.instants(now.t))
                parts.append(jnp.append(z, controller.z[len(z) :]))
        elif table.rows.z is not None:
            parts.append(table.rows.z.ravel())
    return jnp.concatenate(parts)


def reads_accelerations(model: Model) -> bool:
    """Return whether a force element of the model reads accelerations."""
    return any(
        sensor.needs_accelerations(model)
        for table in model.forces
        for sensor in (table.rows.reads or {}).values()
    )


def wrenches(
    model: Model, frames: Frame, others: Any = ()
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Return force and moment about its origin on each frame, in world axes: those of elements with
    a potential and of gravity, and `others`, as `exerted` returns them."""
    bodies, layout = model.bodies.rows, model.layout
    weight = bodies.mass[:, None] * model.gravity[None]
    moment = cross(rotate(frames.R[layout.first_body :], bodies.com), weight)
    acting = [(layout.bodies, (weight, moment))]
    acting += others
    by_table = each_element(model, frames, lambda s, *F: s.wrenches(*F))
    return summed_on_frames(model, model.elements, by_table, acting)


def summed_on_frames(
    model: Model, tables: Any, by_table: Any, others: Any = ()
) -> tuple[Float[Array, "n 3"], Float[Array, "n 3"]]:
    """Return the total force and moment on each frame, from a wrench on each end of the elements of
    some tables and from `others`, (names of frames, wrenches)."""
    parts = [
        (end, wrench)
        for table, wrenches in zip(tables, by_table, strict=True)
        for end, wrench in zip(zip(*table.links, strict=True), wrenches, strict=True)
    ]
    parts += others
    names = [name for on, _ in parts for name in on]
    acting = [[i for i, name in enumerate(names) if name == frame] for frame in model.layout.frames]
    forces, moments = (
        jnp.concatenate(x) for x in zip(*(wrench for _, wrench in parts), strict=True)
    )
    return sums(forces, acting), sums(moments, acting)


def at_rest(frames: Frame) -> Instant:
    """Return frames as an instant of rest, at time 0."""
    still = jnp.zeros_like(frames.p)
    return replace(frames.at_time(jnp.zeros((), still.dtype)), a=still, alpha=still)


def state_rates(model: Model, now: Instant) -> Float[Array, "nz"]:
    """Return z' of a model that holds its states, at an instant."""
    of_memory = _of_memory(
        model, now, Held, lambda element, *ends: element.state_rates(*element.rates(*ends))
    )
    return jnp.concatenate([*of_memory, force_rates(model, now)])


def force_rates(model: Model, now: Instant) -> Float[Array, "nf"]:
    """Return z' of the force elements alone."""
    rates = each_force(
        model, now, lambda x, now: jnp.concatenate([x.rates(now), *now.filter_rates]), rates=True
    )
    return jnp.concatenate([jnp.zeros(0, now.p.dtype), *(part.reshape(-1) for part in rates)])


def state_scales(model: Model, reference: Frame, size: Float[Array, ""]) -> Float[Array, "nz"]:
    """Return the scale of each state: its change per unit of the deformation in the reference pose,
    times the size of the model, or 1 rad for an angle; the scale of the deformation if the state
    does not follow it; 1 for states of force elements."""

    def scales(element, *ends):
        e = element.deformation(*(end.pose() for end in ends))
        follows = jnp.abs(element.sensitivities(e))
        return jnp.where(follows > 0, follows, 1.0)

    layout, of_memory = model.layout, _of_memory(relaxed(model), reference, Relaxed, scales)
    own = layout.first_order
    angular = layout.follows_angles | np.isin(np.arange(layout.nz), own)
    return jnp.concatenate([*of_memory, jnp.ones(len(own), size.dtype)]) * jnp.where(
        angular, 1.0, size
    )


def completed(model: Model, state: State, frames: Frame | None = None) -> State:
    """Return the state with z at rest in these frames if it has no z; by default the supports are
    in their reference poses."""
    if not model.layout.nz or state.z.shape[-1]:
        return state
    frames = Coordinates(model).at_rest(state.q) if frames is None else frames
    return State(state.q, state.v, rest_states(model, frames.pose()))


def _of_memory(model: Model, frames: Frame, kind: type, function) -> list[Float[Array, "_"]]:
    """Return function(element, A, B, ...) of the elements with memory, in the order of z."""
    tables = [table for table in model.elements if memories(table.rows, kind)]
    return [of_table(model, frames, table, function).reshape(-1) for table in tables]


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
