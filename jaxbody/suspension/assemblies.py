"""Assembly: the configuration nearest to the drawn one in which all closures are fulfilled."""

from __future__ import annotations

from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, Int
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem, Status, unknown
from jaxbody.core.results import Result, finished
from jaxbody.mechanics.constraints import CLOSED, closure_gaps, solve, values_and_slopes
from jaxbody.model.joints.closure_tables import names_of_rows, redundant_rows
from jaxbody.model.joints.kinematics import Chart
from jaxbody.model.models import Model, drawn_reference
from jaxbody.model.preconditions import check_precision, check_state
from jaxbody.model.sizes import scale_of, size_of
from jaxbody.model.states import State
from jaxbody.numerics.small_systems import independent_rows


class Assembly(Result):
    """An assembled configuration: `state` at rest, `gaps` of the conditions [m] before and after,
    `slopes` of the conditions by increments in meters, `freedoms` that remain, `redundant`
    conditions, which others imply. `status`: NOT_CLOSED. See `assemble`."""

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
        """The condition that is furthest from being fulfilled."""
        after = np.abs(np.asarray(self.gaps[1]))
        i = int(np.argmax(after))
        return (
            f"'{names_of_rows(self.model)[i]}' stays {after[i]:.3g} m apart; move a point, "
            "or leave out a closure"
        )

    def _tables(self) -> list[tables.PrintedTable]:
        columns = ("closure", "before [m]", "after [m]")
        rows, start = [], 0
        for table in self.model.closures:
            width = len(table.rows.rows)
            for name in table.names:
                part = np.abs(np.asarray(self.gaps[:, start : start + width]))
                rows.append((name, *tables.without_dust(part.max(1), 1.0)))
                start += width
        repeated = f"implied by the others: {', '.join(self.redundant)}" if self.redundant else ""
        note = "; ".join(
            filter(
                None, (f"{tables.counted(self.freedoms, 'freedom')} left", repeated, self.failure)
            )
        )
        return [tables.PrintedTable("Assembly", columns, rows, note)]


def assemble(model: Model, *, start: State | None = None, hold: Sequence[str] = ()) -> Assembly:
    """The state at rest, near a start, in which all closures of a model are fulfilled, by the least
    movement of its coordinates.

        c(q) = 0,   q <- q (+) -J^+ c(q),   J = dc/dDelta

    The state is an exact function of the model's numbers and of the start: it has derivatives in
    both modes, up to the fourth.

    Args:
        model: a model with closures; its drawn poses may be rough
        start: the state from which it is assembled; None: the drawn one
        hold: names of bodies whose coordinates do not move

    Errors: UNKNOWN_NAME, NO_CLOSURE, BAD_SHAPE; warns NOT_CLOSED where no such configuration is
    found: which closure, by how much.

    A point of a pendulum of 1 m, hung between two rods of 1 m in a plane, drawn 1 cm too low:

    >>> bar = Body(mass=1.0, inertia=[1, 1, 1], position=[0.5, 0, -0.81])
    >>> plane = Composite(
    ...     "world", ["move", "move"], directions=[[1, 0, 0], [0, 0, 1]], points=[[0, 0, 0]] * 2
    ... )
    >>> rods = {
    ...     name: jb.closures.Rod(("world", [x, 0, 0]), ("bar", [0, 0, 0]), length=1.0)
    ...     for name, x in (("left", 0.0), ("right", 1.2))
    ... }
    >>> done = assemble(Model(bodies={"bar": bar}, joints={"bar": plane}, closures=rods))
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
    names = model.layout.bodies
    if wrong := [unknown(name, "assemble.hold", names) for name in hold if name not in names]:
        raise JaxbodyError(*wrong)
    if start is not None:
        check_state(model, start, "assemble.start")
    assembly = _assembled(model, drawn_reference(model) if start is None else start, tuple(hold))
    return finished(assembly, _closed, lambda assembly: assembly.state)


def _closed(status):
    return status == Status.OK


def _held(model: Model, names: tuple[str, ...]) -> np.ndarray:
    held = np.zeros(model.layout.nv, bool)
    for name in names:
        held[model.layout.v_slices[name]] = True
    return held


@program
def _assembled(model: Model, start: State, hold: tuple[str, ...]) -> Assembly:
    before = closure_gaps(model, None, start.q)
    q, far = solve(closure_gaps, model, None, start.q, _held(model, hold))
    after, slopes = values_and_slopes(Chart(model), lambda q: closure_gaps(model, None, q), q)
    size = size_of(model)
    status = jnp.where(far <= CLOSED, Status.OK, Status.NOT_CLOSED)
    scaled = slopes * scale_of(model, size)[None]
    state = State(q, jnp.zeros_like(start.v))
    return Assembly(
        model=model, state=state, gaps=jnp.stack([before, after]), slopes=scaled, status=status
    )
