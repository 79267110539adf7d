"""Forces at rest: those of closures, by the multipliers lambda of their conditions, and those on
supports; rows of tables and variables of data sets for deformations and forces.

dV/dDelta - Q + J' lambda = 0,
reaction of a condition = lambda, a moment times the size of the model where it is on an angle
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Bool, Float, is_concrete, rows_or_nan
from jaxbody.core.errors import Status
from jaxbody.core.results import rows_of
from jaxbody.mechanics.free_motions import (
    constraint_force,
    free_motions,
    scale_at,
    slopes_by_supports,
)
from jaxbody.mechanics.hessians import Configuration, frame_twists, slope
from jaxbody.mechanics.load_paths import AppliedLoads, acting_at_rest, with_load_gravity
from jaxbody.model.elements.torsions import Torsion
from jaxbody.model.joints.frame_tables import gaps_at, names_of_rows, total, turning_rows
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.leaf_paths import springs_of
from jaxbody.model.models import Model, size_of

# smallest singular value of independent conditions, relative to the largest, that counts as zero
SINGULAR = 1e-7


class ClosureForces(eqx.Module):
    """The forces of all conditions: `reactions` [N, N m], NaN where they are not unique;
    `multipliers`: lambda, of least norm; `on_coordinates`: J' lambda; `on_supports`: minus the
    force and moment on each support. `slopes`: J for increments in meters; `gaps`: c [m];
    `smallest`: the smallest singular value of J that belongs to an independent condition, relative
    to the largest."""

    reactions: Float[Array, "n"]
    multipliers: Float[Array, "n"]
    on_coordinates: Float[Array, "nv"]
    on_supports: Float[Array, "ns 6"]
    slopes: Float[Array, "n nv"]
    gaps: Float[Array, "n"]
    smallest: Float[Array, ""]

    @property
    def singular(self) -> Bool[Array, ""]:
        """Whether conditions that are independent elsewhere are dependent here."""
        return self.smallest < SINGULAR

    def explain(self, model: Model, status: Status) -> str:
        """Describe a failure with the status NOT_CLOSED or SINGULAR_CLOSURE."""
        names = names_of_rows(model)
        if status == Status.NOT_CLOSED:
            i = int(np.argmax(np.abs(self.gaps)))
            return (
                f"'{names[i]}' stays {abs(float(self.gaps[i])):.3g} m apart; move a point, "
                "or leave out a closure"
            )
        left = np.linalg.svd(np.asarray(self.slopes))[0][
            :, int(np.linalg.matrix_rank(np.asarray(self.slopes), tol=1e-300)) - 1
        ]
        return (
            f"at '{names[int(np.argmax(np.abs(left)))]}'; the smallest singular value is "
            f"{float(self.smallest):.3g} of the largest"
        )

    def table(self, model: Model) -> tables.PrintedTable:
        """Return the table of reactions, a row for each closure, with a note on those that are not
        unique."""
        reactions = np.asarray(self.reactions) if is_concrete(self.reactions) else np.zeros(0)
        largest = np.nanmax(np.abs(reactions), initial=0.0)
        rows = [
            (
                name,
                ", ".join(rows),
                tables.without_dust(jnp.stack(list(rows.values()), -1), largest),
            )
            for name, rows in by_closure(model, self.reactions).items()
        ]
        shared = [
            name
            for name, x in zip(names_of_rows(model), reactions, strict=False)
            if reactions.ndim == 1 and np.isnan(x)
        ]
        note = f"shared, not unique: {', '.join(shared)}; " if shared else ""
        return tables.PrintedTable("", ("closure", "conditions", "reaction [N, N m]"), rows, note)


def by_closure(model: Model, reactions: Float[Array, "*n rows"]) -> dict[str, dict[str, Array]]:
    """Return {closure: {condition: reaction}} from the reactions of all conditions."""
    columns = iter(range(reactions.shape[-1]))
    return {
        name: {row: reactions[..., next(columns)] for row in table.rows.rows}
        for table in model.closures
        for name in table.names
    }


def closure_forces(
    coordinates: Coordinates, q: Float[Array, "nq"], r: Float[Array, "nv"]
) -> ClosureForces:
    """Return the forces of closures that balance r = dV/dDelta - Q at q."""
    model = coordinates.model
    size, scale = jax.lax.stop_gradient(size_of(model)), scale_at(model)
    free = free_motions(coordinates, q, scale)
    multipliers = free.multipliers(r * scale)
    values = jnp.linalg.svdvals(jax.lax.stop_gradient(free.J))
    count = 0 if model.independent is None else model.layout.nv - len(model.independent)
    smallest = (
        values[count - 1] / jnp.maximum(values[0], 1e-300) if count else jnp.ones((), q.dtype)
    )
    return ClosureForces(
        reactions=rows_or_nan(free.unique, multipliers * jnp.where(turning_rows(model), size, 1.0)),
        multipliers=multipliers,
        on_coordinates=constraint_force(coordinates, q, multipliers),
        on_supports=(multipliers @ slopes_by_supports(coordinates, q)).reshape(-1, 6),
        slopes=free.J,
        gaps=gaps_at(coordinates, q),
        smallest=smallest,
    )


Row = tuple[Any, ...]


def residual_and_reactions(
    at: Configuration, applied: AppliedLoads, factor: Float[Array, ""] | float = 1.0
) -> tuple[Float[Array, "nv"], Float[Array, "ns 6"]]:
    """Return dV/dDelta - lambda Q, and force and moment about its origin on each support, -dV/dXi
    plus the loads on all that it carries by joints, in world axes. `at` has columns for the
    base."""
    nv, forces = at.model.layout.nv, -slope(with_load_gravity(at, applied, factor))
    if acting := acting_at_rest(at.model, at.frames, applied, factor):
        on_frames = jnp.concatenate(total(at.model, acting), -1)
        forces = forces + jnp.sum(frame_twists(at) * on_frames[:, None], (0, 2))
    return -forces[:nv], forces[nv:].reshape(-1, 6)


def element_rows(
    model: Model, deformations: dict[str, Array], forces: dict[str, Array]
) -> tuple[tuple[str, ...], list[Row]]:
    """Return the headings and rows of a table of elements; rotations and moments have columns of
    their own if an element has them."""
    e, f = (_without_dust(numbers) for numbers in (deformations, forces))
    rows = [
        (name, *along_and_about(model, name, e[name]), *along_and_about(model, name, f[name]))
        for name in deformations
    ]
    if any(row[2] is not None for row in rows):
        return ("element", "deformation [m]", "rotation [rad]", "force [N]", "moment [N m]"), rows
    return ("element", "elongation [m]", "force [N]"), [
        (name, e, force) for name, e, _, force, _ in rows
    ]


def labeled_elements(
    model: Any,
    index: tuple[str, ...],
    words: tuple[str, str],
    deformations: dict[str, Array],
    forces: dict[str, Array],
) -> tuple[dict[str, Any], dict[str, Any], dict[str, Any]]:
    """Return variables of a dataset: deformations and forces of the springs, side by side, then
    those of each other element, and the coordinate of the springs. `index`: the dimensions before
    that of elements; `words`: the names of the deformation of springs and of others."""
    springs = springs_of(model)
    kinds = ((words[0], deformations, "m"), ("force", forces, "N"))
    of_springs = {
        word: ((*index, "spring"), rows_of([values[name] for name in springs], -1), unit)
        for word, values, unit in kinds
        if springs
    }
    of_others = {
        f"{name}_{word}": ((*index, "component"), values[name], units)
        for name in deformations
        if name not in springs
        for word, values, units in ((words[1], deformations, "m, rad"), ("force", forces, "N, N m"))
    }
    return of_springs, of_others, {"spring": springs} if springs else {}


def along_and_about(model: Model, name: str, numbers: Any) -> tuple[Any, Any]:
    """Return the components of an element's deformation or force along its axes, and those about
    them; None for those that it does not have."""
    element = model[name]
    if element.size == 1:
        return (None, numbers) if isinstance(element, Torsion) else (numbers, None)
    return numbers[..., :3], numbers[..., 3:]


def _without_dust(numbers: dict[str, Any]) -> dict[str, Any]:
    """Return the numbers, with those set to zero that are rounding errors relative to the
    largest."""
    every = jax.tree.leaves(numbers)
    largest = (
        max((np.abs(x).max(initial=0.0) for x in every), default=0.0) if is_concrete(every) else 0.0
    )
    return jax.tree.map(lambda x: tables.without_dust(x, largest), numbers)


def support_rows(reactions: dict[str, tuple[Array, Array]]) -> tuple[tuple[str, ...], list[Row]]:
    """Return the headings and rows of a table of supports."""
    return ("support", "force on it [N]", "moment [N m]"), [
        (name, *both) for name, both in _without_dust(reactions).items()
    ]
