"""Quasi-static load cases, such as those of engine mounts: accelerations in g, torques and forces,
all cases in one batch."""

from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import check_kind, checked_dict
from jaxbody.core.arrays import Array, Bool, Float, Int, device_array, stack, vector
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems, Status
from jaxbody.core.results import AXES, Labeled, Result, dataset, finished, without_derivatives
from jaxbody.core.units import GRAVITY
from jaxbody.geometry import rotations
from jaxbody.geometry.vectors import product
from jaxbody.mechanics.equilibria import (
    DESCENDED,
    Equilibrium,
    at_rest,
    equilibrium_at,
    equilibrium_of,
    of_position,
)
from jaxbody.mechanics.equilibrium_solvers import LOADABLE, SearchResult, search_under_loads
from jaxbody.mechanics.forces_at_rest import along_and_about, labeled_elements
from jaxbody.mechanics.hessians import configuration_at
from jaxbody.mechanics.load_paths import AppliedLoads, alike, residual, summed
from jaxbody.model.element_states import relaxed
from jaxbody.model.inputs.loads import Load, loads_by_name, loads_of
from jaxbody.model.joints.frame_tables import exerted_by_loads
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.leaf_paths import of_elements
from jaxbody.model.models import Model, scale_of, size_of
from jaxbody.model.preconditions import (
    check_attached,
    check_memory,
    check_potential,
    check_precision,
    check_state,
)
from jaxbody.model.states import State

MAX_STEPS = 200  # most steps of a search
NEGLIGIBLE = 1e-9  # generalized force, relative to the applied loads, that is round-off
BY_JOINTS = (
    "carried by the joints alone, so that no body moves and no spring is loaded; if a case is "
    "meant to tilt a body, put the point O, about which that body turns, and its center of mass "
    "(com) at their true heights"
)


class LoadCase(eqx.Module):
    """One case: a steady `acceleration` a of the whole rig in g = 9.80665 m/s2, in world axes, with
    the inertia force -m a on every body (braking, along -x, pushes bodies forward, +x; cornering to
    the left, +y, pushes them to the right), and `loads` {name: load}, evaluated at time 0.

    >>> jb.LoadCase(acceleration=[0, 0, 3]).acceleration.tolist()
    [0.0, 0.0, 3.0]
    """

    acceleration: Float[Array, "3"]
    loads: dict[str, Load]

    def __init__(self, *, acceleration=(0, 0, 0), loads: dict[str, Load] | None = None):
        with Problems() as problems:
            self.acceleration = vector(acceleration, "LoadCase.acceleration", problems)
            self.loads = loads_by_name(loads, "LoadCase.loads", problems)


class LoadCases(Labeled, Result):
    """Results of load cases, relative to the equilibrium without them, `unloaded`.

    For each body: `displacements` of its origin [m] and `rotations` (vectors [rad]), in world axes,
    (cases, 3). For each element: `strokes`, the changes of its deformation [m], and `forces`, the
    total [N] (six for a bushing), (cases, ...). `state`; and for each case `status`, `load_factor`
    and `descended` (as in an Equilibrium) and `by_joints`, True where joints alone carry the load,
    so that nothing moves."""

    index = "case"
    status: Int[Array, "nc"]
    load_factor: Float[Array, "nc"]
    state: State
    unloaded: Equilibrium
    displacement_rows: Float[Array, "nc nb 3"]
    rotation_rows: Float[Array, "nc nb 3"]
    stroke_rows: tuple[Array, ...]
    force_rows: tuple[Array, ...]
    descended: Bool[Array, "nc"]
    by_joints: Bool[Array, "nc"]
    names: tuple[str, ...] = eqx.field(static=True)

    @property
    def displacements(self) -> dict[str, Float[Array, "nc 3"]]:
        return {
            name: self.displacement_rows[..., i, :]
            for i, name in enumerate(self.unloaded.layout.bodies)
        }

    @property
    def rotations(self) -> dict[str, Float[Array, "nc 3"]]:
        return {
            name: self.rotation_rows[..., i, :]
            for i, name in enumerate(self.unloaded.layout.bodies)
        }

    @property
    def strokes(self) -> dict[str, Float[Array, "nc *m"]]:
        return self._of_elements(self.stroke_rows)

    @property
    def forces(self) -> dict[str, Float[Array, "nc *m"]]:
        return self._of_elements(self.force_rows)

    def _of_elements(self, rows: tuple[Array, ...]) -> dict[str, Array]:
        return of_elements(self.unloaded.model, rows, axis=1)

    def report(self) -> str:
        codes, factors, *marks = without_derivatives(
            (self.status, self.load_factor, self.descended, self.by_joints)
        )
        failed = [
            f"'{name}' {Status(int(code)).name} at load factor {float(factor):.4g}"
            for name, code, factor in zip(self.names, codes, factors, strict=True)
            if code
        ]
        notes = []
        for each, words in zip(marks, (DESCENDED, BY_JOINTS), strict=True):
            marked = [
                repr(name) for name, yes in zip(self.names, np.asarray(each), strict=True) if yes
            ]
            notes += [f"{', '.join(marked)} {words}"] if marked else []
        return "; ".join([*(failed or ["ok"]), *notes])

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset by `case`: displacement and rotation by `body`, stroke and force
        by element."""
        model = self.unloaded.model
        of_springs, of_others, springs = labeled_elements(
            model, ("case",), ("stroke", "stroke"), self.strokes, self.forces
        )
        return dataset(
            {
                "displacement": (("case", "body", "axis"), self.displacement_rows, "m"),
                "rotation": (("case", "body", "axis"), self.rotation_rows, "rad"),
                "status": (("case",), self.status, ""),
                "load_factor": (("case",), self.load_factor, ""),
                **of_springs,
                **of_others,
            },
            {
                "case": list(self.names),
                "body": list(model.layout.bodies),
                "axis": AXES,
                **springs,
            },
            "load cases",
        )

    @tables.summarized("Load cases", 3, displacement_rows="displacements [m]")
    def _tables(self) -> list[tables.PrintedTable]:
        rows = []
        for i, case in enumerate(self.names):
            for j, name in enumerate(self.unloaded.layout.bodies):
                moves = (self.displacement_rows[i, j], self.rotation_rows[i, j])
                rows.append((case, name, *(_rounded(x, 6) for x in moves), "", ""))
            for name, stroke in self.strokes.items():
                (s, turn), (f, moment) = (
                    along_and_about(self.unloaded.model, name, x[i])
                    for x in (stroke, self.forces[name])
                )
                turning = (_rounded(turn, 6), _rounded(moment, 1)) if np.any(moment) else ("", "")
                rows.append((case, name, _rounded(s, 6), turning[0], _rounded(f, 1), turning[1]))
        columns = (
            "case",
            "part",
            "displacement or stroke [m]",
            "rotation [rad]",
            "force [N]",
            "moment [N m]",
        )
        return [tables.PrintedTable("Load cases", columns, rows, self.report())]


def _rounded(values: Any, digits: int) -> Any:
    return "" if values is None else np.round(np.asarray(values, float), digits) + 0.0


def load_cases(
    model: Model, cases: dict[str, LoadCase], *, at: Equilibrium | State | None = None
) -> LoadCases:
    """Compute the equilibrium of every load case, in one batch: displacement and rotation of every
    body relative to the equilibrium without the case, stroke and force of every element.

        dV/dDelta = Q - m a, with loads raised from zero along the stable branch of each case

    `at`: the state or equilibrium from which the search for the equilibrium without loads starts;
    by default the reference pose. A case that cannot be carried in full ends at the largest load
    factor that can be carried, with status NO_EQUILIBRIUM or LIMIT_POINT; the report names cases
    that are carried by joints alone. Differentiable. Errors: NO_CASE, UNKNOWN_BODY, UNATTACHED,
    WRONG_KIND.

    >>> mount = jb.Spring(
    ...     ("engine", [0, 0, 0]), ("world", [0, 0, -1]), stiffness=8e5, free_length=1.0
    ... )
    >>> model = jb.Model(
    ...     bodies={"engine": jb.Body(mass=150.0, inertia=[8, 4, 7])},
    ...     joints={"engine": jb.Guide("world", axis=[0, 0, 1])},
    ...     elements={"mount": mount},
    ...     gravity=[0, 0, -9.81],
    ... )
    >>> pull = jb.Force("engine", force=[0, 0, 800.0])
    >>> cases = jb.load_cases(
    ...     model,
    ...     {
    ...         "bump": jb.LoadCase(acceleration=[0, 0, 3]),
    ...         "pull": jb.LoadCase(loads={"chain": pull}),
    ...     },
    ... )
    >>> [round(float(z), 6) for z in cases.displacements["engine"][:, 2]]
    [-0.005516, 0.001]
    """
    check_precision("load_cases", model)
    check_potential("load_cases", model)
    check_memory("load_cases", model)
    check_attached(model)
    with Problems() as problems:
        cases = checked_dict(cases, "load_cases.cases", "name: jb.LoadCase(...)", problems)
        if not cases and not problems.collected:
            problems.add(
                "NO_CASE",
                "load_cases",
                "has no case",
                value=cases,
                limit="at least one",
                hint="Give {name: jb.LoadCase(...)}.",
            )
        for name, case in cases.items():
            check_kind(
                case,
                LoadCase,
                f"cases[{name!r}]",
                "jb.LoadCase(acceleration=..., loads=...)",
                problems,
            )
        start = at.state if isinstance(at, Equilibrium) else at
        if start is not None:
            problems.gather(lambda: check_state(model, start, "at"))
        each = [
            problems.gather(
                lambda name=name, case=case: loads_of(
                    case.loads, model.layout.bodies, f"cases[{name!r}].loads"
                )
            )
            for name, case in cases.items()
            if isinstance(case, LoadCase)
        ]
    loads = tuple(load for group in each for load in group)
    owner = np.repeat(np.arange(len(each)), [len(group) for group in each])
    weights = (np.arange(len(each))[:, None] == owner).astype(float)
    changes = stack([-GRAVITY * case.acceleration for case in cases.values()])
    q, z = (None, None) if start is None else (start.q, start.z)
    unloaded = equilibrium_of(model, q, MAX_STEPS, z)
    groups, members = alike(loads)
    applied = AppliedLoads(
        groups, tuple(device_array(weights[:, group]) for group in members), changes
    )
    searches = search_under_loads(model, unloaded, q, applied, MAX_STEPS, many=True)
    result = finished(
        _load_cases(model, unloaded, searches, applied, tuple(cases)),
        at_rest,
        lambda x: (x.state, x.displacement_rows, x.rotation_rows, x.stroke_rows, x.force_rows),
    )
    return eqx.tree_at(
        lambda result: result.unloaded, result, finished(unloaded, at_rest, of_position)
    )


@program
def _load_cases(
    model: Model,
    unloaded: Equilibrium,
    searches: SearchResult,
    applied: AppliedLoads,
    names: tuple[str, ...],
) -> LoadCases:
    coordinates = Coordinates(relaxed(model, unloaded.state.z))
    rest = configuration_at(coordinates, unloaded.state.q, base=False)
    scale = scale_of(model, size_of(model))

    def largest_of(load, weight):
        """Return the largest component of the force of a load at rest, or of its moment over the
        size of the model."""
        now = rest.frames.at_time(jnp.zeros((), scale.dtype), unloaded.state)
        ((_, (force, moment)),) = exerted_by_loads(model, now, (load,))
        return weight * jnp.maximum(
            jnp.max(jnp.abs(force)), jnp.max(jnp.abs(moment)) / size_of(model)
        )

    def one(applied, search):
        eq = equilibrium_at(coordinates, search, applied, model)
        largest = jnp.max(
            jnp.abs(residual(rest, applied) - residual(rest, applied, 0.0)) * scale, initial=0.0
        )
        total = jnp.sum(model.bodies.rows.mass) * jnp.max(jnp.abs(applied.gravity))
        for load, weight in zip(applied.loads, applied.weights, strict=True):
            total = total + summed(largest_of, load, weight)
        pose = coordinates.at_rest(eq.state.q)[model.layout.first_body :].pose()
        return eq, pose, (largest <= NEGLIGIBLE * total) & (total > 0)

    eq, pose, by_joints = applied.each(one, searches)
    rest_poses = rest.frames[model.layout.first_body :]
    return LoadCases(
        status=jnp.where(
            jnp.isin(unloaded.status, jnp.array(LOADABLE)), eq.status, unloaded.status
        ),
        load_factor=eq.load_factor,
        state=eq.state,
        unloaded=unloaded,
        displacement_rows=pose.p - rest_poses.p[None],
        rotation_rows=rotations.log(product(pose.R, jnp.swapaxes(rest_poses.R, -1, -2)[None])),
        stroke_rows=tuple(
            e - e0[None] for e, e0 in zip(eq.deformations, unloaded.deformations, strict=True)
        ),
        force_rows=eq.element_forces,
        descended=eq.descended,
        by_joints=by_joints,
        names=names,
    )
