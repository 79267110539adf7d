"""Causes of failed motions and equilibria, with the names of parts: numbers that are not finite,
elements turned too far, springs of zero length; motions that a stiffness or mass matrix does not
resist."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float, time_text
from jaxbody.core.compilation.compile_options import program
from jaxbody.mechanics.closed_loops import ClosedLoops, dynamics_of, seen_by_forces
from jaxbody.mechanics.equilibrium_solvers import SINGULAR
from jaxbody.mechanics.free_motions import on_closures
from jaxbody.mechanics.hessians import configuration_at, slope, stiffness
from jaxbody.model.element_states import holding, relaxed, resisting
from jaxbody.model.elements.second_derivatives import second_order
from jaxbody.model.inputs.loads import Load
from jaxbody.model.joints.frame_tables import (
    at_rest,
    each_element,
    each_force,
    exerted_by_loads,
    names_of_rows,
    rank,
)
from jaxbody.model.joints.kinematics import Coordinates, Motions, frames_at_time
from jaxbody.model.layouts import Layout
from jaxbody.model.models import Model, scale_of, scaled, size_of
from jaxbody.model.states import State
from jaxbody.model.storage import KindTable
from jaxbody.numerics.eigenproblems import MASSLESS
from jaxbody.numerics.precisions import reachable

# times after a state at which it is checked, relative to the time since the first sample or, if
# that is shorter, to a second
AHEAD = (0.0, 1e-12, 1e-9, 1e-6, 1e-3)
# distances at which a search is checked along the negative gradient, relative to the model's size
DOWNHILL = (0.0, 1e-9, 1e-6, 1e-3)
# distance within which a force counts as at its jump: a length relative to the free length; for
# angles the cosine of half the angle (179 degrees)
NEAR = 1e-2
BEND = 0.5  # relative difference allowed between the chord of two samples and the tangent at either


def nonfinite_ahead(
    model: Model, motions: Motions, loads: tuple[Load, ...], times: Array, t: Array, state: State
) -> str:
    """Name the motion, element, load or body that first gives a number that is not finite, at this
    state or just after it; return "" if there is none."""
    for ahead in np.maximum(np.abs(t - times[0]), 1.0) * np.array(AHEAD, state.q.dtype):
        numbers = jax.tree.map(np.asarray, _numbers(model, motions, loads, t, state, ahead))
        for what, (good, *e) in _named(model, loads, "the force of element", *numbers):
            if not good:
                at = ", at e = {:.6g}, e' = {:.6g}".format(*e) if e and e[0].ndim == 0 else ""
                return f"{what} at t = {time_text(t + ahead, times)} s{at}"
    bad = [
        name
        for name in model.layout.bodies
        if not np.isfinite(np.asarray(state.q[model.layout.q_slices[name]])).all()
    ]
    return f"the coordinates of body '{bad[0]}'" if bad else ""


@program
def _numbers(model: Model, motions: Motions, loads: tuple[Load, ...], t, state: State, ahead):
    """Return which numbers are finite at the time `ahead` [s] after a state: of the motions, of the
    elements with their e and e_dot, of the loads."""
    dynamics = dynamics_of(holding(model, state.z), motions, loads)
    model, coordinates = dynamics.model, dynamics.coordinates
    change, moment = dynamics.acceleration(t, state.q, state.v), t + ahead
    v = state.v + ahead * jnp.where(jnp.isfinite(change), change, 0.0)
    moved = State(coordinates.retract(state.q, ahead * state.v), v, state.z)
    now = frames_at_time(model, motions, moment, moved)

    def numbers(element, *frames):
        e, rate = element.rates(*frames)
        return jnp.isfinite(element.force(*frames)).all(), e, rate

    wrenches = [
        jnp.concatenate([x[0] for x in wrench]) for _, wrench in exerted_by_loads(model, now, loads)
    ]
    own = _finite_at(model, seen_by_forces(model, motions, loads, moment, moved))
    return (
        [(jnp.isfinite(motion(moment)).all(),) for motion in motions],
        _rows(model.elements, each_element(model, now, numbers))
        | {name: (one,) for name, one in own.items()},
        [(jnp.isfinite(wrench).all(),) for wrench in wrenches],
    )


def changing_most(
    model: Model, motions: Motions, loads: tuple[Load, ...], times: Array, t: Array, state: State
) -> str:
    """Name the support, element or load whose force changes most just after this state, with the
    change [N]; for a support it is the inertia force of all bodies at the change of its
    acceleration."""
    ahead = AHEAD[3] * max(float(t - times[0]), 1e-3 * float(times[-1] - times[0]))
    changes = jax.tree.map(
        np.asarray, _changes(model, motions, loads, t, state, jnp.asarray(ahead, state.q.dtype))
    )
    most, change = max(
        _named(model, loads, "the force of", *changes),
        key=lambda each: np.nan_to_num(each[1]),
        default=("", 0.0),
    )
    return f"{most} changes most there, by {change:.3g} N in {ahead:.2g} s" if change > 0 else ""


@program
def _changes(model: Model, motions: Motions, loads: tuple[Load, ...], t, state: State, ahead):
    """Return the change of the forces during the time `ahead` [s] after a state: of the motions, of
    the elements, of the loads."""
    dynamics = dynamics_of(holding(model, state.z), motions, loads)
    model, coordinates = dynamics.model, dynamics.coordinates
    moved = State(
        coordinates.retract(state.q, ahead * state.v),
        state.v + ahead * dynamics.acceleration(t, state.q, state.v),
        state.z,
    )

    def forces(t, state):
        now = frames_at_time(model, motions, t, state)
        accelerations = [
            jnp.sum(model.bodies.rows.mass)
            * jax.jvp(jax.jacfwd(motion), (t,), (jnp.ones_like(t),))[1][:3]
            for motion in motions
        ]
        wrenches = [force for _, (force, _) in exerted_by_loads(model, now, loads)]
        return (
            accelerations,
            _rows(
                model.elements,
                each_element(model, now, lambda element, *frames: element.force(*frames)),
            ),
            wrenches,
        )

    return jax.tree.map(
        lambda new, old: jnp.max(jnp.abs(new - old)), forces(t + ahead, moved), forces(t, state)
    )


def _named(
    model: Model, loads: tuple[Load, ...], word: str, of_motions, of_elements, of_loads
) -> list[tuple[str, Any]]:
    """Return pairs (name in messages, value) of motions, elements and loads; `word` comes before
    the name of an element."""
    names = [
        *(f"the motion of '{name}'" for name in model.layout.supports),
        *(f"{word} '{name}'" for name in of_elements),
        *(f"a load, {type(load).__name__}, on '{load.on}'" for load in loads),
    ]
    return list(zip(names, [*of_motions, *of_elements.values(), *of_loads], strict=True))


def _rows(tables: tuple[KindTable, ...], values: list[Any]) -> dict[str, Any]:
    """Return {name of an element: its values} from the values of each table of elements."""
    return {
        name: jax.tree.map(lambda x, i=i: x[i], value)
        for table, value in zip(tables, values, strict=True)
        for i, name in enumerate(table.names)
    }


def nonfinite_forces(model: Model, state: State) -> list[str]:
    """Return the names of the force elements whose force or rates are not finite in a state of
    rest."""
    good = _finite_forces(model, State(state.q, jnp.zeros_like(state.v), state.z))
    return [f"of '{name}'" for name, one in good.items() if not one]


@program
def _finite_forces(model: Model, state: State) -> dict[str, Bool[Array, ""]]:
    held = holding(model, state.z)
    return _finite_at(held, at_rest(Coordinates(held).at_rest(state.q)))


def _finite_at(model: Model, now: Any) -> dict[str, Bool[Array, ""]]:
    """Return whether forces and rates are finite, for each force element of a model that holds its
    states."""

    def finite(force, seen):
        parts = jax.tree.leaves((force.forces(seen), force.rates(seen)))
        return jnp.stack([jnp.isfinite(part).all() for part in parts]).all()

    return _rows(model.forces, each_force(model, now, finite, rates=True))


def singular_closure(model: Model, motions: Motions, t: Array, state: State) -> str:
    """Name the condition that follows from the others at this state although it does not elsewhere,
    with the smallest singular value."""
    left, values, _ = np.linalg.svd(np.asarray(ClosedLoops(model, motions).slopes(t, state)))
    independent = rank(model)
    condition = names_of_rows(model)[int(np.argmax(np.abs(left[:, independent - 1])))]
    return (
        f"at '{condition}': the smallest singular value is "
        f"{values[independent - 1] / values[0]:.3g} of the largest"
    )


def nonfinite_downhill(
    model: Model, q: Float[Array, "nq"], slope: Float[Array, "nv"], size: float
) -> list[str]:
    """Return the elements whose energy, force or stiffness is not finite at q or, if all are finite
    there, at a point slightly downhill."""
    down = np.where(np.isfinite(slope), -np.asarray(slope), 0.0)
    down = down * size / max(np.abs(down).max(initial=0.0), np.finfo(down.dtype).tiny)
    for far in DOWNHILL:
        good = _finite(model, q, far * down)
        if bad := [name for name, one in good.items() if not one]:
            return bad
    return []


@program
def _finite(
    model: Model, q: Float[Array, "nq"], delta: Float[Array, "nv"]
) -> dict[str, Bool[Array, ""]]:
    coordinates = Coordinates(model := relaxed(model))
    frames = coordinates.at_rest(coordinates.retract(q, delta))

    def finite(element, *frames):
        parts = (element.potential(*(f.pose() for f in frames)), second_order(element, *frames))
        return jnp.stack([jnp.isfinite(part).all() for part in jax.tree.leaves(parts)]).all()

    return _rows(model.elements, each_element(model, frames, finite))


def force_jump_at(model: Model, motions: Motions, t: Array, state: State) -> str:
    """Name the elements at a jump of their force, which are springs of zero length and elements
    turned by half a turn; return "" if there are none."""
    sample = jax.tree.map(lambda x: np.asarray(x)[None], (t, state))
    near = [np.linalg.norm(x[0], axis=-1) < NEAR for x, _ in _away(model, motions, *sample)]
    return "; ".join(
        message
        for _, message in _messages(model, [["" if x else None for x in rows] for rows in near])
    )


def force_jumps_along(
    model: Model, motions: Motions, times: Array, states: State
) -> list[Float[np.ndarray, "_"]]:
    """Return, for each table, the time of the first jump of the force of each element between these
    samples, or NaN; an empty list if no force can jump."""
    if not any(table.rows.jump for table in model.elements):
        return []
    away = jax.tree.map(np.asarray, _away(model, motions, times, states))
    return [_zero_crossings(np.asarray(times), *rows) for rows in away]


def force_jump_messages(
    model: Model, times_of_jumps: list[Float[np.ndarray, "_"]], times: Array
) -> list[tuple[str, str]]:
    """Return (code, message) of the elements whose force jumps, from the times of
    `force_jumps_along`."""
    return _messages(
        model,
        [
            [f" at t = {time_text(t, times)} s" if np.isfinite(t) else None for t in rows]
            for rows in times_of_jumps
        ],
    )


@program
def _away(
    model: Model, motions: Motions, times: Float[Array, "nt"], states: State
) -> list[tuple[Array, Array]]:
    """Return the vector `away_from_jump` of all elements, and its rate, at these times, table by
    table."""

    def away(element, *frames):
        return jax.jvp(
            element.away_from_jump,
            tuple(f.pose() for f in frames),
            tuple(f.rates() for f in frames),
        )

    def at(t, state):
        return each_element(holding(model, state.z), frames_at_time(model, motions, t, state), away)

    return jax.vmap(at)(times, states)


def _messages(model: Model, moments: list[Any]) -> list[tuple[str, str]]:
    """Return (code, message) for each table with elements at a jump of their force; `moments` has
    the time as text for these elements, None for others."""
    messages = []
    for table, rows in zip(model.elements, moments, strict=False):
        jumping = [
            (name, moment)
            for name, moment in zip(table.names, rows, strict=True)
            if moment is not None
        ]
        if jumping:
            code, what, remedy = table.rows.jump
            listed = ", ".join(f"'{name}' {what}{moment}" for name, moment in jumping)
            messages.append((code, f"{listed}; {remedy}"))
    return messages


def _zero_crossings(
    times: np.ndarray, x: Float[np.ndarray, "nt n m"], rate: Float[np.ndarray, "nt n m"]
) -> Float[np.ndarray, "n"]:
    """Return the time when each of n vectors first passes zero between two samples so close that
    its path is nearly straight, else NaN.

    On the cubic through both samples with both rates: x0 + u v0 + u^2 (3 d - 2 v0 - v1) + u^3
    (v0 + v1 - 2 d), 0 <= u <= 1.
    """
    h = np.diff(times)[:, None, None]
    x0, d, v0, v1 = x[:-1], np.diff(x, axis=0), h * rate[:-1], h * rate[1:]
    square, cube = 3 * d - 2 * v0 - v1, v0 + v1 - 2 * d

    def of(a, b):
        return np.sum(a * b, -1, keepdims=True)

    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        u = -of(x0, d) / of(d, d)
        for _ in range(3):
            position, speed = (
                x0 + u * (v0 + u * (square + u * cube)),
                v0 + u * (2 * square + 3 * u * cube),
            )
            u = u - of(position, speed) / of(speed, speed)
        position = x0 + u * (v0 + u * (square + u * cube))
        straight = np.maximum(of(v0 - d, v0 - d), of(v1 - d, v1 - d)) <= BEND**2 * of(d, d)
        passes = (straight & (of(position, position) < NEAR**2) & (np.abs(u - 0.5) <= 0.5 + 1e-6))[
            ..., 0
        ]
    first = np.argmax(passes, 0)
    t = times[first] + np.take_along_axis(u[..., 0], first[None], 0)[0] * np.diff(times)[first]
    return np.where(passes.any(0), t, np.nan)


@program
def resisting_stiffness(model: Model, state: State) -> Float[Array, "nv nv"]:
    """Return the scaled K with the tangents of hysteresis, along the closures if there are any."""
    coordinates = Coordinates(resisting(model, state.z))
    at, scale = configuration_at(coordinates, state.q, base=False), scale_of(model, size_of(model))
    return on_closures(
        coordinates, state.q, slope(at) * scale, scaled(stiffness(at), scale), scale
    )[1]


def zero_modes(model: Model, state: State) -> list[str]:
    """Return the motions that K does not resist at a state, as text: "'plate' free to turn about
    z". Motions of single coordinates come first."""
    K = np.asarray(resisting_stiffness(model, state))
    return describe_null_motions(model.layout.motions, K, reachable(SINGULAR, K.dtype), "free to")


def massless_motions(
    layout: Layout, M: Any, independent: tuple[int, ...] | None = None
) -> list[str]:
    """Return the motions that a mass matrix does not resist, as text; `independent`: the
    coordinates of the matrix, by default all."""
    M = np.asarray(M)
    size = np.sqrt(np.where(np.diagonal(M) > 0, np.diagonal(M), 1.0))
    motions = (
        layout.motions if independent is None else tuple(layout.motions[i] for i in independent)
    )
    motions += tuple(
        (owner, f"move {state}")
        for owner, _, state in (
            name.partition(", ") for name in layout.inner[: len(M) - len(motions)]
        )
    )
    return describe_null_motions(motions, M / size / size[:, None], MASSLESS, "has no inertia to")


def describe_null_motions(
    motions: tuple[tuple[str, str], ...], matrix: np.ndarray, tolerance: float, what: str
) -> list[str]:
    """Return texts on the motions whose eigenvalues are zero relative to the largest, each with
    `what` between body and motion. Motions of single coordinates come first."""
    values, vectors = np.linalg.eigh(matrix)
    null = vectors[:, np.abs(values) <= tolerance * max(np.abs(values).max(initial=0.0), 1e-300)]
    texts, rest = [], null
    for i, (body, motion) in enumerate(motions):
        unit = np.eye(len(motions))[i]
        if np.linalg.norm(unit - null @ (null.T @ unit)) < 1e-5:
            texts.append(f"'{body}' {what} {motion}")
            rest = rest - np.outer(unit, unit @ rest)
    u, s, _ = np.linalg.svd(rest, full_matrices=False)
    for vector in u.T[s > 1e-3]:
        largest = [int(i) for i in np.argsort(-np.abs(vector)) if abs(vector[i]) > 0.1][:4]
        parts = [
            f"{np.sign(vector[largest[0]]) * vector[i]:+.2f} ('{motions[i][0]}' {motions[i][1]})"
            for i in largest
        ]
        texts.append(f"{what} move together: " + " ".join(parts))
    return texts
