"""Equilibrium: the configuration of least potential energy near the start, its stability, and its
derivatives by the implicit function theorem.

    dV/dDelta = 0,    dq/dp = -K^-1 d2V/dDelta dp

With closures c = 0 the condition is dV/dDelta + J' lambda = 0, J = dc/dDelta, and stability
concerns the motions that the closures leave free (free_motions).

The search is by descent; with force elements, which have no energy, by Newton's method on the
balance of forces (force_balances). Loads, which may have no potential, are then raised step by
step (load_paths); where that cannot start, because K is singular without them, the search descends
the potential of dead loads and weights.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import whole_number
from jaxbody.core.arrays import Array, Bool, Float, Int, is_concrete, tangent_or_nan
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems, Status
from jaxbody.core.results import AXES, Labeled, Result, dataset, finished
from jaxbody.geometry.frames import Frame
from jaxbody.lagrange import potential
from jaxbody.mechanics.equilibrium_solvers import (
    LOADABLE,
    SearchResult,
    along_path,
    eigenvalue_signs,
    search_by_descent,
    search_under_loads,
)
from jaxbody.mechanics.failure_causes import (
    nonfinite_downhill,
    nonfinite_forces,
    resisting_stiffness,
    zero_modes,
)
from jaxbody.mechanics.force_balances import (
    change_of_balance,
    holding_forces,
    instability,
    search_for_balance,
)
from jaxbody.mechanics.forces_at_rest import (
    ClosureForces,
    by_closure,
    closure_forces,
    element_rows,
    labeled_elements,
    residual_and_reactions,
    support_rows,
)
from jaxbody.mechanics.free_motions import constraint_force, implied_change, multipliers_at
from jaxbody.mechanics.hessians import configuration_at
from jaxbody.mechanics.load_paths import (
    AppliedLoads,
    Path,
    in_full,
    residual,
    tangent,
    with_gravity,
    with_load_gravity,
)
from jaxbody.model.element_states import relaxed, rest_states
from jaxbody.model.inputs.loads import Load, loads_of
from jaxbody.model.joints.frame_tables import (
    each_element,
    gaps_at,
    names_of_rows,
    outside_law_range,
    redundant_rows,
)
from jaxbody.model.joints.kinematics import Coordinates, body_poses
from jaxbody.model.laws.tabulated_laws import has_range
from jaxbody.model.layouts import Layout
from jaxbody.model.leaf_paths import of_elements
from jaxbody.model.models import Model, drawn_apart, size_of
from jaxbody.model.preconditions import check_attached, check_memory, check_precision, check_state
from jaxbody.model.states import State
from jaxbody.numerics.precisions import in_float64
from jaxbody.numerics.small_systems import solve

NOT_AT_REST = (  # no linearization about such a state
    Status.NOT_CONVERGED,
    Status.NO_EQUILIBRIUM,
    Status.LIMIT_POINT,
    Status.STALE,
    Status.NOT_CLOSED,
    Status.SINGULAR_CLOSURE,
    Status.NONFINITE_FORCE,
)
# a body is far from its drawn pose above this displacement [sizes of the model] or rotation [rad]
FAR, TURNED = 0.3, np.deg2rad(30)
DESCENDED = (
    "by descent of the potential of the loads, which cannot be raised step by step because K is "
    "singular without them"
)


class Equilibrium(Labeled, Result):
    """An equilibrium: `state`, `residual` dV/dDelta + J' lambda - Q [N, N m], `energy` V [J],
    `stable`, `negative` (number of negative eigenvalues of K), `steps`, and by name `elongations`,
    `forces` of the elements and `reactions` of the supports.

    For a model with closures, `closure_reactions` are the forces of closures, `redundant` the
    conditions that others imply.

    With force elements stability follows from the poles of small motions: `negative` is the number
    of growing ones, `growing` those of oscillations (flutter) and real ones (divergence).

    `status` is OK, or NOT_CONVERGED, UNSTABLE, SINGULAR_K, TABLE_RANGE, NO_EQUILIBRIUM,
    LIMIT_POINT, NOT_CLOSED, SINGULAR_CLOSURE or NONFINITE_FORCE. Under loads, `load_factor` is the
    fraction of them that is carried, `path` the eigenvalues of K along the load path; `descended`:
    K is singular without the loads, so that the search descended their potential."""

    index = "coordinate"
    state: State
    residual: Float[Array, "nv"]
    energy: Float[Array, ""]
    negative: Int[Array, ""]
    stable: Bool[Array, ""]
    status: Int[Array, ""]
    steps: Int[Array, ""]
    deformations: tuple[Array, ...]
    element_forces: tuple[Array, ...]
    on_supports: Float[Array, "ns 6"]
    model: Model
    loads: tuple[Load, ...]
    load_factor: Float[Array, ""]
    path: Path | None
    descended: Bool[Array, ""]
    beyond: Bool[Array, "ne"]  # True for elements beyond the points of their tables
    # of each body: displacement of its center of mass from where it is drawn [m], and its rotation
    # from there [rad]
    from_drawn: Float[Array, "nb 2"]
    closed: ClosureForces | None = None  # None without closures
    growing: Int[Array, "2"] | None = None  # None without force elements

    @property
    def elongations(self) -> dict[str, Array]:
        """{element: elongation [m], tension positive}; for a bushing its six deformations."""
        return self._of_elements(self.deformations)

    @property
    def forces(self) -> dict[str, Array]:
        """{element: tension [N], or moment [N m] of a Torsion}; for a bushing the six forces and
        moments that oppose its deformation."""
        return self._of_elements(self.element_forces)

    @property
    def reactions(self) -> dict[str, tuple[Float[Array, "*batch 3"], Float[Array, "*batch 3"]]]:
        """{support: (force [N], moment about its origin [N m])}, in world axes, exerted by its
        elements and by all that it carries by joints, with weights and, as far as they are
        carried, loads."""
        return {
            name: (self.on_supports[..., i, :3], self.on_supports[..., i, 3:])
            for i, name in enumerate(self.layout.supports)
        }

    @property
    def closure_reactions(self) -> dict[str, dict[str, Float[Array, "*batch"]]]:
        """{closure: {condition: force [N], or moment [N m] of a "turn"}}, exerted by its second
        frame on its first along the condition, so that positive forces resist an increase of c; NaN
        where closures share a force, so that it is not unique."""
        return by_closure(self.model, self.closed.reactions) if self.closed else {}

    @property
    def redundant(self) -> tuple[str, ...]:
        """Conditions of closures that follow from the others, such as those out of the plane of a
        planar linkage."""
        return redundant_rows(self.model, self.closed.slopes) if self.closed else ()

    @property
    def far(self) -> list[str]:
        """A text on the body that is farthest from where it is drawn, if it is far relative to the
        size of the model; empty otherwise."""
        limits = np.array([FAR * float(size_of(self.model)), TURNED])
        name, (way, turn) = max(
            zip(self.layout.bodies, np.asarray(self.from_drawn), strict=True),
            key=lambda each: np.max(each[1] / limits),
        )
        if int(self.status) in NOT_AT_REST or not (np.array([way, turn]) > limits).any():
            return []
        return [
            f"the equilibrium is far from the drawn pose: '{name}' is {way:.3g} m and "
            f"{np.rad2deg(turn):.3g} degrees from it"
        ]

    @property
    def remarks(self) -> list[str]:
        """Texts on geometry that looks wrong but has no status: mounts drawn apart, a body far from
        where it is drawn."""
        return (
            []
            if self.status.ndim or not is_concrete(self)
            else [*drawn_apart(self.model), *self.far]
        )

    def _of_elements(self, rows: tuple[Array, ...]) -> dict[str, Array]:
        return of_elements(self.model, rows, axis=self.energy.ndim)

    @property
    def layout(self) -> Layout:
        return self.model.layout

    def explain(self) -> str:
        status = Status(int(self.status))
        if status == Status.SINGULAR_K:
            return "; ".join(zero_modes(self.model, self.state))
        if status == Status.NONFINITE_FORCE or self.growing is not None:
            return "; ".join(nonfinite_forces(self.model, self.state)) or self._known()
        if status == Status.NO_EQUILIBRIUM and self.path is None and not self.descended:
            return self._how_much()
        known = np.isfinite(self.state.q).all()  # NaN of a search inside jit
        if known and status == Status.NOT_CONVERGED:
            size = float(size_of(self.model))
            bad = nonfinite_downhill(self.model, self.state.q, self.residual, size)
            if bad:
                return (
                    f"energy, force or stiffness of element '{bad[0]}' is not finite after "
                    f"{int(self.steps)} steps or at a point slightly downhill; its law is not "
                    "defined there"
                )
        return self._known()

    def _known(self) -> str:
        """Describe a failure from the numbers of the result alone."""
        status = Status(int(self.status))
        match status:
            case Status.SINGULAR_K | Status.NONFINITE_FORCE:
                return "report() names it"
            case Status.UNSTABLE if self.growing is not None:
                return instability(self.growing)
            case Status.NO_EQUILIBRIUM if self.growing is not None:
                removed = f"{float(self.load_factor):.4g} of the imbalance of the start"
                return f"Newton's method removed {removed}; start nearer"
            case Status.NOT_CLOSED | Status.SINGULAR_CLOSURE if self.closed:
                return self.closed.explain(self.model, status)
            case Status.UNSTABLE:
                return (
                    f"{int(self.negative)} negative eigenvalue(s) of K; start from a state moved "
                    "along that mode to descend"
                )
            case Status.TABLE_RANGE:
                names = np.array(self.model.element_names)[np.asarray(self.beyond)]
                return "; ".join(f"'{name}'" for name in names)
            case Status.NOT_CONVERGED:
                residual = np.abs(np.asarray(self.residual))
                worst = int(np.argmax(residual)) if np.isfinite(residual).all() else 0
                unit = "N m" if self.layout.turns[worst] else "N"
                owner, motion = self.layout.motions[worst]
                remedy = in_float64(self.state.q.dtype) or "start nearer, or give more max_steps"
                return (
                    f"after {int(self.steps)} steps the largest residual is "
                    f"{residual[worst]:.3g} {unit} in '{owner}' ({motion}); {remedy}"
                )
            case Status.NO_EQUILIBRIUM | Status.LIMIT_POINT if self.descended:
                return (
                    "none was found by raising the loads, as K is singular without them, or by "
                    "descent of their potential from the start; moments and loads that turn with "
                    "their body have no potential"
                )
            case Status.NO_EQUILIBRIUM | Status.LIMIT_POINT if self.path is not None:
                smallest = np.asarray(self.path.smallest)
                last = smallest[np.isfinite(smallest)][-1]
                return (
                    "none was found by raising the loads beyond load factor "
                    f"{float(self.load_factor):.4g} of 1, which this state carries; the smallest "
                    "eigenvalue of K, relative to the largest without loads, went from "
                    f"{smallest[0]:.3g} to {last:.3g} (plots.plot_load_path draws it)"
                )
            case Status.NO_EQUILIBRIUM | Status.LIMIT_POINT:
                return "none was found by descent; report() says how much of the weights is carried"
        return ""

    def _how_much(self) -> str:
        """Describe which fraction of the weights is carried."""
        weightless = with_gravity(self.model, -self.model.gravity)
        start = equilibrium_of(weightless, None, 200, None)
        if int(start.status) not in LOADABLE:
            return "none was found by descent, with the weights or without them"
        weights = AppliedLoads((), np.zeros(0), self.model.gravity)
        share = 100 * float(along_path(weightless, start, weights, False)[0].factor)
        return f"none was found by descent; {share:.4g} % of the weights is carried"

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: q by part, residual by coordinate, elongation and force by
        spring, reactions by support, energy, status."""
        layout = self.layout
        of_springs, of_others, springs = labeled_elements(
            self.model, (), ("elongation", "deformation"), self.elongations, self.forces
        )
        variables = {
            "q": (("part",), self.state.q, ""),
            **(
                {"z": (("state",), self.state.z, ", ".join(dict.fromkeys(layout.z_units)))}
                if layout.nz
                else {}
            ),
            "residual": (("coordinate",), self.residual, "N or N m"),
            "energy": ((), self.energy, "J"),
            "stable": ((), self.stable, ""),
            "status": ((), self.status, ""),
            **of_springs,
            **of_others,
        }
        coordinates = {
            "part": [f"{block.owner} {i}" for block in layout.joints for i in range(block.nq)],
            "coordinate": list(layout.coordinates),
            **({"state": list(layout.states)} if layout.nz else {}),
            **springs,
        }
        if self.closed:
            variables["closure_reaction"] = (("condition",), self.closed.reactions, "N or N m")
            coordinates["condition"] = list(names_of_rows(self.model))
        if layout.supports:
            variables["reaction_force"] = (("support", "axis"), self.on_supports[..., :3], "N")
            variables["reaction_moment"] = (("support", "axis"), self.on_supports[..., 3:], "N m")
            coordinates |= {"support": list(layout.supports), "axis": AXES}
        return dataset(variables, coordinates, "equilibrium")

    def _tables(self) -> list[tables.PrintedTable]:
        q, layout = tables.without_dust(self.state.q), self.layout
        values = layout.values_by_coordinate(q) if is_concrete(q) else q
        rows = [
            (name, values[..., i], unit)
            for i, (name, unit) in enumerate(
                zip(layout.coordinates, layout.coordinate_units, strict=True)
            )
        ]
        states = [
            (f"{name} [{unit}]" if unit else name, tables.without_dust(self.state.z[..., i]))
            for i, (name, unit) in enumerate(zip(layout.states, layout.z_units, strict=True))
        ]
        note = self.message(Equilibrium._known) if is_concrete(self.status) else ""
        note += "; there may be others" if note == "ok" else ""
        if is_concrete(self.descended) and np.any(self.descended):
            note += f"; {DESCENDED}"
        largest = (
            np.abs(self.residual).max()
            if is_concrete(self.residual) and self.residual.size
            else None
        )
        further = [
            tables.PrintedTable("", *element_rows(self.model, self.elongations, self.forces)),
            tables.PrintedTable("", ("state", "at rest"), states),
            tables.PrintedTable("", *support_rows(self.reactions)),
            *([self.closed.table(self.model)] if self.closed else []),
        ]
        shown = [
            tables.PrintedTable("Equilibrium", ("coordinate", "at rest", "unit"), rows),
            *(table for table in further if table.rows),
        ]
        note = "\n".join([note, *self.remarks])
        shown[
            -1
        ].note = f"{shown[-1].note}largest residual {tables.number(largest)} N or N m; {note}"
        return shown


def equilibrium(
    model: Model,
    *,
    start: State | None = None,
    loads: dict[str, Load] | None = None,
    max_steps: int = 200,
) -> Equilibrium:
    """Find the stable equilibrium by descent from `start`, with the supports at their reference
    poses.

        dV/dDelta = Q,   K = d2V/dDelta2 - dQ/dDelta positive definite

    Args:
        start: the state to start from; by default the reference pose. Massless
            coordinates of elements with memory are relaxed; hysteretic states do not change:
            they are those of `start`, by default 0, and stability is counted with them
            fixed. A body that is held by hysteresis alone can rest anywhere and stays where
            it is drawn.
        loads: {name: load}, evaluated at time 0 and raised from zero along the stable branch; by
            default none. With force elements they are raised while the imbalance of the start is
            removed, by Newton's method; the rates of their states are zero at rest. Where K is
            singular without loads (an unstressed string pushed sideways) the search descends V
            minus the work of dead forces instead, and the result is `descended`.
        max_steps: largest number of steps of the search.

    With closures the search starts from the nearest configuration that fulfills them and stays
    on them,

        dV/dDelta + J' lambda = Q,   c = 0,
        K + d2(lambda c)/dDelta2 positive definite where J Delta = 0

    Differentiable with respect to the model in forward and reverse mode, to any order; the
    derivative of a search that failed, or through a singular K, is NaN. Errors: UNATTACHED,
    BAD_SHAPE, UNKNOWN_BODY for a load; warns if the status is not OK. Source: (63) of the paper.

    >>> spring = jb.Spring(
    ...     ("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=981.0, free_length=1.0
    ... )
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     elements={"s": spring},
    ...     gravity=[0, -9.81, 0],
    ... )
    >>> round(float(jb.equilibrium(model).elongations["s"]), 12)
    0.02
    """
    check_precision("equilibrium", model)
    check_memory("equilibrium", model)
    check_attached(model)
    with Problems() as problems:
        if start is not None:
            problems.gather(lambda: check_state(model, start, "start"))
        acting = problems.gather(lambda: loads_of(loads, model.layout.bodies))
        max_steps = whole_number(max_steps, "equilibrium.max_steps", problems, least=0)
    q, z = (None, None) if start is None else (start.q, start.z)
    if model.forces:
        applied = in_full(acting or (), model.gravity.dtype)
        search = search_for_balance(model, q, z, applied, max_steps)
        return finished(_equilibrium_at(model, search, applied, z), at_rest, of_position)
    result = equilibrium_of(model, q, max_steps, z)
    if acting:
        applied = in_full(acting, model.gravity.dtype)
        result = _equilibrium_at(
            model, search_under_loads(model, result, q, applied, max_steps), applied, result.state.z
        )
    return finished(result, at_rest, of_position)


def at_rest(status: Int[Array, "*n"]) -> Bool[Array, "*n"]:
    """Return whether a search ended at an equilibrium, for each status."""
    return ~jnp.isin(status, jnp.array(NOT_AT_REST))


def of_position(eq: Equilibrium) -> tuple[Any, ...]:
    """Return the parts of an equilibrium, other than the residual, that depend on the configuration
    at which the search ended."""
    return (
        eq.state,
        eq.energy,
        eq.deformations,
        eq.element_forces,
        eq.on_supports,
        eq.from_drawn,
        *((eq.closed.reactions,) if eq.closed else ()),
    )


@program
def equilibrium_of(
    model: Model,
    start: Float[Array, "nq"] | None,
    max_steps: int,
    z: Float[Array, "nz"] | None = None,
) -> Equilibrium:
    """Return the equilibrium without loads, the jitted core of `equilibrium`; `z`: hysteretic
    states."""
    coordinates = Coordinates(relaxed(model, z))
    return equilibrium_at(
        coordinates,
        search_by_descent(coordinates, start, max_steps),
        in_full((), model.gravity.dtype),
        model,
    )


@program
def _equilibrium_at(
    model: Model, search: SearchResult, applied: AppliedLoads, z: Float[Array, "nz"] | None
) -> Equilibrium:
    return equilibrium_at(Coordinates(relaxed(model, z)), search, applied, model)


def equilibrium_at(
    coordinates: Coordinates, search: SearchResult, applied: AppliedLoads, given: Model
) -> Equilibrium:
    """Return the equilibrium where a search ended: its stability, its derivative, deformations and
    forces. `given`: the model as the user gave it; in the model of the coordinates elements with
    memory are relaxed."""
    failed, singular = search.status != Status.OK, search.singular
    q, z = _implicit((coordinates, applied), search.q, search.z, ~failed & ~singular)
    coordinates = coordinates if z is None else holding_forces(coordinates, z)
    model, at = coordinates.model, configuration_at(coordinates, q)
    zero, frames = jnp.zeros(model.layout.nv, q.dtype), at.frames
    elements = each_element(
        model, frames, lambda s, *F: (s.deformation(*(f.pose() for f in F)), s.force(*F))
    )
    outside = (
        outside_law_range(model, frames)
        if has_range(model.elements)
        else jnp.zeros(len(model.element_names), bool)
    )
    state = State(q, zero, rest_states(model, frames.pose()) if model.layout.nz else None)
    # K is computed with the states of hysteretic elements fixed; in a motion they vary
    if any("hysteretic" in block.roles for block in model.layout.blocks):
        singular &= eigenvalue_signs(resisting_stiffness(given, jax.lax.stop_gradient(state)))[1]
    status = jnp.select(
        [failed, search.negative > 0, singular, jnp.any(outside)],
        [search.status, Status.UNSTABLE.value, Status.SINGULAR_K.value, Status.TABLE_RANGE.value],
        Status.OK.value,
    )
    unbalanced, reactions = residual_and_reactions(at, applied, search.factor)
    forces = closure_forces(coordinates, q, unbalanced) if model.closures else None
    if forces is not None:
        unbalanced, reactions = unbalanced + forces.on_coordinates, reactions - forces.on_supports
        status = jnp.where(~failed & forces.singular, Status.SINGULAR_CLOSURE.value, status)
    return Equilibrium(
        state=state,
        residual=unbalanced,
        negative=search.negative,
        status=status,
        steps=search.steps,
        energy=potential(with_load_gravity(at, applied).model, frames),
        stable=~failed & (search.negative == 0),
        model=given,
        deformations=tuple(e for e, _ in elements),
        element_forces=tuple(force for _, force in elements),
        on_supports=reactions,
        loads=applied.loads,
        load_factor=search.factor,
        path=search.path,
        descended=jnp.asarray(search.descended),
        beyond=outside,
        from_drawn=_from_drawn(model, frames),
        closed=forces,
        growing=search.growing,
    )


def _from_drawn(model: Model, frames: Frame) -> Float[Array, "nb 2"]:
    """Return the distance of the center of mass of each body from where it is drawn [m], and 2
    asin(|R - R_drawn|/sqrt 8) [rad], without derivatives."""
    bodies, now, drawn = jax.lax.stop_gradient(
        (model.bodies.rows, frames[model.layout.first_body :].pose(), body_poses(model))
    )
    p, R = (now.p - drawn.p) + jnp.sum((now.R - drawn.R) * bodies.com[:, None], -1), now.R - drawn.R
    turn = 2 * jnp.arcsin(jnp.minimum(jnp.sqrt(jnp.sum(R**2, (1, 2)) / 8), 1.0))
    return jnp.stack([jnp.sqrt(jnp.sum(p**2, -1)), turn], -1)


@jax.custom_jvp
def _implicit(
    dependencies: tuple[Coordinates, AppliedLoads],
    q: Float[Array, "nq"],
    z: Float[Array, "nf"] | None,
    valid: Bool[Array, ""],
) -> tuple[Float[Array, "nq"], Float[Array, "nf"] | None]:
    """Return q and the states z of force elements, with the derivatives of an equilibrium by the
    implicit function theorem, NaN where it is not valid."""
    return q, z


@_implicit.defjvp
def _implicit_jvp(primals, tangents):
    (coordinates, applied), _, _, valid = primals
    q, z = _implicit(*primals)
    if z is not None:
        delta, dz = change_of_balance(lambda given: given, primals[0], tangents[0], q, z)
        q_dot = coordinates.rate(q, tangent_or_nan(valid, delta))
        return (q, z), (q_dot, tangent_or_nan(valid, dz))
    K = tangent(configuration_at(coordinates, q, base=False), applied)
    K = jnp.where(valid, K, jnp.eye(len(K), dtype=K.dtype))
    delta = change_of_equilibrium(lambda given: given, primals[0], tangents[0], q, K)
    return (q, None), (coordinates.rate(q, tangent_or_nan(valid, delta)), None)


def change_of_equilibrium(
    given: Callable[[Any], tuple[Coordinates, AppliedLoads]],
    x: Any,
    x_dot: Any,
    q: Float[Array, "nq"],
    K: Float[Array, "nv nv"],
) -> Float[Array, "nv"]:
    """Return Delta of an equilibrium at q for a change x_dot of x, where given(x) are the
    coordinates and the applied loads, and K the stiffness at q."""

    def change(function):
        return jax.jvp(lambda x: function(*given(x)), (x,), (x_dot,))[1]

    def unbalanced(coordinates, applied):
        return residual(configuration_at(coordinates, q, base=False), applied)

    coordinates, applied = given(x)
    if not coordinates.model.closures:
        return -solve(K, change(unbalanced))
    r = unbalanced(coordinates, applied)
    multipliers = multipliers_at(coordinates, q, r)
    of_both = change(
        lambda coordinates, applied: (
            unbalanced(coordinates, applied) + constraint_force(coordinates, q, multipliers),
            gaps_at(coordinates, q),
        )
    )
    return implied_change(coordinates, q, r, K, of_both)
