"""Elements with memory: their states, and models whose laws with memory are evaluated in given
states, table by table.

The states of one table are contiguous in z, in the order of its rows. Coordinates of elements are
relaxed where they are in equilibrium at the present deformation of the element.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.geometry.fields import resolved, words_along
from jaxbody.geometry.frames import Pose
from jaxbody.model.forces.controllers import is_sampled
from jaxbody.model.forces.drives import Actuator
from jaxbody.model.laws.law_states import Apart, Held, Relaxed, memories, with_states
from jaxbody.model.laws.memory_laws import Memory
from jaxbody.model.layouts import CoordinateBlock
from jaxbody.model.storage import KindTable, with_attributes

Z = Float[Array, "nz"]


def blocks_of(tables: tuple[KindTable, ...]) -> tuple[CoordinateBlock, ...]:
    """Return the blocks of the elements with memory, in the order of their tables."""
    blocks = []
    for table in tables:
        if memories(table.rows):
            states = tuple(zip(*_states_of(table.rows), strict=True))
            blocks += [
                CoordinateBlock(name, type(table.rows), (), (), (), False, *states)
                for name in table.names
            ]
    return tuple(blocks)


def blocks_of_forces(tables: tuple[KindTable, ...]) -> tuple[CoordinateBlock, ...]:
    """Return the blocks of the force elements with states, in the order of their tables."""
    blocks = []
    for table in tables:
        if states := table.rows.all_states():
            names, units = zip(*states, strict=True)
            roles, none = ("first order",) * len(states), ("",) * len(states)
            blocks += [
                CoordinateBlock(
                    name, type(table.rows), (), (), (), False, names, units, roles, none
                )
                for name in table.names
            ]
    return tuple(blocks)


def _states_of(rows: Any) -> list[tuple[str, str, str, str]]:
    """Return description, unit and role of each state of an element, and the unit of the
    deformation that it follows. Equal descriptions are numbered; if several fields hold laws, each
    description begins with the name of its field."""
    states = []
    for keys, law in jax.tree_util.tree_leaves_with_path(rows, is_leaf=with_states):
        if isinstance(law, Memory):
            words, field = words_along(rows, keys), keys[0].name
            states += [
                (field, one, resolved(unit, law, words), role, words.get("argument", ""))
                for one, unit, role in zip(law.states, law.state_units, law.roles, strict=True)
            ]
    fields = {field for field, *_ in states}
    labels = [f"{field} {one}" if len(fields) > 1 else one for field, one, *_ in states]
    texts = [
        f"{label} {labels[:i].count(label) + 1}" if labels.count(label) > 1 else label
        for i, label in enumerate(labels)
    ]
    return [(text, *kind) for text, (_, _, *kind) in zip(texts, states, strict=True)]


def _bound(model: Any, make: Callable[..., Any], *states: Z) -> Any:
    """Return the model with each law with memory replaced by make(law, its columns of the
    states)."""
    if not model.layout.nz:
        return model
    tables, start = [], 0
    for table in model.elements:
        if width := sum(len(law.states) for law in memories(table.rows)):
            _check_given(model, states[0])
            n = len(table.names)
            columns = [z[start : start + n * width].reshape(n, width) for z in states]
            table, start = _with_states(table, make, columns), start + n * width
        tables.append(table)
    held = eqx.tree_at(lambda model: model.elements, model, tuple(tables)) if tables else model
    if all(table.rows.z is not None for table in model.forces if table.rows.all_states()):
        return held
    _check_given(model, states[0])
    return with_force_states(held, states[0][start:])


def with_force_states(model: Any, z: Float[Array, "nf"]) -> Any:
    """Return the model with the states z of its force elements."""
    tables, start = [], 0
    for table in model.forces:
        n, width = len(table.names), len(table.rows.all_states())
        own, start = z[start : start + n * width].reshape(n, width), start + n * width
        tables.append(_with_force_states(table, own) if width else table)
    return eqx.tree_at(lambda model: model.forces, model, tuple(tables))


def force_states(model: Any) -> Float[Array, "nf"]:
    """Return the states of the force elements of a model that holds them."""
    parts = [table.rows.z.reshape(-1) for table in model.forces if table.rows.z is not None]
    return jnp.concatenate([jnp.zeros(0, model.gravity.dtype), *parts])


def _with_force_states(table: KindTable, z: Float[Array, "n width"]) -> KindTable:
    ranks = jax.tree.unflatten(jax.tree.structure(table.rows), table.ranks)
    ranks = tuple(jax.tree.leaves(with_attributes(ranks, {"z": 1})))
    return KindTable(table.names, table.links, ranks, with_attributes(table.rows, {"z": z}))


def with_commands(model: Any, u: dict[str, Array]) -> Any:
    """Return the model with these commands added to those of its drives."""
    if not u:
        return model

    def commanded(table: KindTable) -> KindTable:
        if not set(u) & set(table.names):
            return table
        more = jnp.stack([jnp.asarray(u.get(name, 0.0), model.gravity.dtype) for name in table])
        return eqx.tree_at(lambda t: t.rows.command, table, table.rows.command + more)

    return eqx.tree_at(lambda model: model.forces, model, tuple(map(commanded, model.forces)))


def between_samples(model: Any) -> Any:
    """Return the model in which states of sampled controllers change at their samples only."""

    def held(table: Any) -> Any:
        if not is_sampled(table):
            return table
        return with_attributes(table, {"rows": with_attributes(table.rows, {"held": True})})

    return with_attributes(model, {"forces": tuple(map(held, model.forces))})


def _check_given(model: Any, z: Z) -> None:
    if len(z) != model.layout.nz:
        raise JaxbodyError(
            Problem(
                "MEMORY",
                "state.z",
                (
                    f"is missing or has {len(z)} numbers; the model has elements with "
                    f"{model.layout.nz} states"
                ),
                len(z),
                f"{model.layout.nz}",
                "Give states with z, such as those of equilibrium(model) or model.reference.",
            )
        )


def _with_states(
    table: KindTable, make: Callable[..., Any], columns: list[Float[Array, "n width"]]
) -> KindTable:
    def replaced(rows, parts):
        """Return the rows with each law with memory replaced; `parts` yields the states of one law
        after another."""
        return jax.tree.map(
            lambda x: make(x, *next(parts)) if isinstance(x, Memory) else x,
            rows,
            is_leaf=with_states,
        )

    laws = memories(table.rows)
    ends = [sum(len(law.states) for law in laws[: i + 1]) for i in range(len(laws))]
    rows = replaced(
        table.rows,
        (
            tuple(z[:, end - len(law.states) : end] for z in columns)
            for law, end in zip(laws, ends, strict=True)
        ),
    )
    ranks = jax.tree.unflatten(jax.tree.structure(table.rows), table.ranks)
    return KindTable(
        table.names,
        table.links,
        tuple(jax.tree.leaves(replaced(ranks, iter([(1,) * len(columns)] * len(laws))))),
        rows,
    )


def holding(model: Any, z: Z) -> Any:
    """Return the model with the states z, for a motion in which they change by their rates."""
    return _bound(model, Held, z)


def apart(model: Any, z: Z, z_dot: Z | None = None) -> Any:
    """Return the model for small motions about a state of rest with the element states z. The
    coordinates of elements are unknowns of the system, like those of joints; the massless ones have
    the rates z_dot, by default 0."""
    return _bound(model, Apart, z, jnp.zeros_like(z) if z_dot is None else z_dot)


def settled(model: Any, z: Z) -> Any:
    """Return the model for slow small motions about a state of rest with the element states z:
    massless coordinates are relaxed, hysteretic states change linearly with the deformation (by
    their tangents), and coordinates with mass are unknowns of the system."""
    return _bound(
        model,
        lambda law, z: Relaxed(law, z) if law.has_rows and not law.inertial else Apart(law, z),
        z,
    )


def relaxed(model: Any, z: Z | None = None) -> Any:
    """Return the model at rest: coordinates of elements are relaxed; other states are z, by default
    0; limits of rates, which are zero at rest, are left out, as beyond them a rate has no slope."""
    if z is None or not z.shape[-1]:
        z = jnp.zeros(model.layout.nz, model.gravity.dtype)
    tables = enumerate(model.forces)
    limited = [i for i, t in tables if isinstance(t.rows, Actuator) and t.rows.rate is not None]
    if limited:
        model = eqx.tree_at(
            lambda model: [model.forces[i].rows.rate for i in limited],
            model,
            replace_fn=lambda rate: jnp.full_like(rate, jnp.inf),
        )
    return _bound(model, Relaxed, z)


def resisting(model: Any, z: Z) -> Any:
    """Return the model for small static displacements from a state of rest with the element states
    z: coordinates of elements are relaxed, and hysteretic states change linearly with the
    deformation (by their tangents)."""
    return _bound(model, lambda law, z: Relaxed(law, z) if law.has_rows else Apart(law, z), z)


def end_rows(model: Any, table: KindTable) -> list[np.ndarray]:
    """Return the rows in the table of frames of the elements or closures of a table, one array for
    each end."""
    return [
        np.array([model.layout.frame(name) for name in end])
        for end in zip(*table.links, strict=True)
    ]


def rest_states(model: Any, poses: Pose, z: Z | None = None) -> Z:
    """Return z at rest in the given poses of all frames: coordinates relaxed, other states as in z,
    by default 0."""
    if not model.layout.nz:
        return jnp.zeros(0, poses.p.dtype)
    parts = []
    for table in relaxed(model, z).elements:
        if memories(table.rows, Relaxed):
            at = [Pose(poses.p[rows], poses.R[rows]) for rows in end_rows(model, table)]
            parts.append(
                jax.vmap(lambda element, *at: element.rest_states(element.deformation(*at)))(
                    table.rows, *at
                ).reshape(-1)
            )
    return jnp.concatenate([*parts, force_states(relaxed(model, z))])
