"""Preload: the free lengths that make a given pose the equilibrium, and heights that follow
from them.

    dV/dDelta(q; l) = 0,   least |l - l_0|,   by Gauss-Newton steps  l <- l - A^+ dV/dDelta,
    A = d2V/dDelta dl

With more springs than equations the change has least norm (pseudo-inverse); forces that no free
length can balance are the residual. Coordinates that may move are additional unknowns. With
closures the pose is the nearest one that fulfills them, P dV/dDelta = 0 takes the place of
dV/dDelta = 0, with the projector P onto the motions that closures leave free (free_motions), and
the other coordinates follow those that may move.
"""

from fnmatch import fnmatchcase

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import check_kind
from jaxbody.core.arrays import Array, Float, Int, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, unknown
from jaxbody.core.results import Result, finished
from jaxbody.mechanics.constraints import CLOSED, closed_on, how_open
from jaxbody.mechanics.free_motions import free_motions
from jaxbody.mechanics.hessians import configuration_at, slope
from jaxbody.model.element_states import relaxed, rest_states
from jaxbody.model.joints.frame_tables import drawn
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.leaf_paths import Leaf, leaves_of, matching, write
from jaxbody.model.models import Model, scale_of, size_of
from jaxbody.model.preconditions import check_potential, check_precision, check_state
from jaxbody.model.states import State
from jaxbody.numerics.precisions import reachable

ITERATIONS = 50
RANK = 1e-10  # singular values of A, relative to the largest, that count as zero
# residual, relative to the largest force that the springs and weights exert on a coordinate
BALANCED = 1e-9


class Preload(Result):
    """Free lengths that balance a pose: `free_lengths` {path: m} (`free_angle` [rad] of torsion
    springs), their `changes`, the `model` with them.

    `state` is the pose, `moved` {coordinate: change [m, rad]} of its coordinates that may move,
    `residual` the unbalanced forces [N, N m]. `status` is UNBALANCED where these are not zero,
    NEGATIVE_LENGTH where a length would have to be negative, NOT_CLOSED where closures stay open;
    `gap` is the largest gap, relative to the size of the model. With closures the residual is along
    the motions that they leave free."""

    status: Int[Array, ""]
    values: Float[Array, "n"]
    change: Float[Array, "n"]
    moves: Float[Array, "m"]
    residual: Float[Array, "nv"]
    gap: Float[Array, ""]
    state: State
    model: Model
    paths: tuple[str, ...] = eqx.field(static=True)
    moving: tuple[str, ...] = eqx.field(static=True)

    @property
    def free_lengths(self) -> dict[str, Array]:
        return {path: self.values[i, ...] for i, path in enumerate(self.paths)}

    @property
    def changes(self) -> dict[str, Array]:
        return {path: self.change[i, ...] for i, path in enumerate(self.paths)}

    @property
    def moved(self) -> dict[str, Array]:
        return {name: self.moves[i, ...] for i, name in enumerate(self.moving)}

    def explain(self) -> str:
        if int(self.status) == Status.NEGATIVE_LENGTH:
            return ", ".join(
                f"{path} = {float(v):.6g} m" for path, v in self.free_lengths.items() if v < 0
            )
        if int(self.status) == Status.NOT_CLOSED:
            return f"closures stay open by {float(self.gap):.3g} of the size of the model"
        layout, residual = self.model.layout, np.asarray(self.residual)
        worst = [
            i
            for i in np.argsort(-np.abs(residual))
            if abs(residual[i]) > 1e-6 * np.abs(residual).max()
        ][:4]
        forces = [
            f"{-residual[i]:.4g} {'N m' if layout.turns[i] else 'N'} on {layout.coordinates[i]}"
            for i in worst
        ]
        heights = [layout.coordinates[i] for i in worst if layout.coordinates[i] not in self.moving]
        remedy = f", or let it move: moving={heights!r}" if heights else ""
        return (
            f"none of these free lengths balances {', '.join(forces)}; free a length that acts on "
            f"it{remedy}, or remove that load"
        )

    def _tables(self) -> list[tables.PrintedTable]:
        rows = [
            (path, value, change)
            for path, value, change in zip(self.paths, self.values, self.change, strict=True)
        ]
        rows += [(name, "", change) for name, change in self.moved.items()]
        return [
            tables.PrintedTable(
                "Preload",
                ("", "free length [m, rad]", "change"),
                rows,
                self.report() if is_concrete(self.status) else "",
            )
        ]


def preload(
    model: Model, pose: State | None = None, *, free=("*.free_length",), moving=()
) -> Preload:
    """Find the free lengths that make a pose an equilibrium with the least change.

    Args:
        pose: the pose that becomes an equilibrium; by default the reference pose.
        free: paths or patterns of the `free_length` (or `free_angle` of torsion springs) that may
            change; by default all free lengths.
        moving: names or patterns of `model.layout.coordinates` that may change too, such as the
            height of a wheel on a given tyre; by default none.

    With closures the pose is the nearest that fulfills them; where some coordinates may move, the
    others follow with the least movement.

    Use `preload(...).model`, whose equilibrium is at `preload(...).state`; `equilibrium` shows
    whether it is stable. Differentiable. Errors: UNKNOWN_PATH, UNKNOWN_NAME for a coordinate,
    NOT_A_LENGTH, BAD_SHAPE for the pose; warns UNBALANCED, NEGATIVE_LENGTH, NOT_CLOSED.

    >>> spring = jb.Spring(
    ...     ("car", [0, 0, 0]), ("world", [0, 0, -0.5]), stiffness=2e4, free_length=0.5
    ... )
    >>> model = jb.Model(
    ...     bodies={"car": jb.Body(mass=400.0, inertia=[1, 1, 1])},
    ...     joints={"car": jb.Guide("world", axis=[0, 0, 1])},
    ...     elements={"spring": spring},
    ...     gravity=[0, 0, -10.0],
    ... )
    >>> round(float(jb.preload(model).free_lengths["spring.free_length"]), 9)
    0.7
    """
    check_precision("preload", model)
    check_potential("preload", model)
    state = model.reference if pose is None else pose
    check_state(model, state, "pose")
    with Problems() as problems:
        check_kind(free, (str, list, tuple), "preload.free", "paths or patterns", problems)
        check_kind(
            moving,
            (str, list, tuple),
            "preload.moving",
            "names or patterns of coordinates",
            problems,
        )
    matched = matching(leaves_of(model), [free] if isinstance(free, str) else free, "free")
    leaves = tuple(dict.fromkeys(leaf for group in matched.values() for leaf in group))
    wrong = [leaf.path for leaf in leaves if leaf.kind.unit not in ("m", "rad") or leaf.rank]
    if wrong:
        raise JaxbodyError(
            *(
                Problem(
                    "NOT_A_LENGTH",
                    "free",
                    f"{path} is not a free length",
                    path,
                    "free_length, free_angle",
                )
                for path in wrong
            )
        )
    rows: list[int] = []
    for pattern in [moving] if isinstance(moving, str) else moving:
        matching_rows = [
            i for i, name in enumerate(model.layout.coordinates) if fnmatchcase(name, str(pattern))
        ]
        if not matching_rows:
            raise JaxbodyError(unknown(pattern, "preload.moving", model.layout.coordinates))
        rows += matching_rows
    return finished(
        _preload(model, state, leaves, tuple(dict.fromkeys(rows))),
        _balanced,
        lambda made: (made.values, made.change, made.moves, made.state, made.model),
    )


def _balanced(status):
    return jnp.isin(status, jnp.array((Status.OK, Status.NEGATIVE_LENGTH)))


@program
def _preload(
    model: Model, state: State, leaves: tuple[Leaf, ...], rows: tuple[int, ...]
) -> Preload:
    arrays, layout, n = jax.tree.leaves(model), model.layout, len(leaves)
    start = jnp.stack(
        [*(leaf.read(arrays) for leaf in leaves), *jnp.zeros(len(rows), state.q.dtype)]
    )
    frozen = jax.lax.stop_gradient(model)
    scale = scale_of(frozen, size_of(frozen))
    held = np.isin(np.arange(layout.nv), rows)
    pose = _closed(Coordinates(model), state.q, None)

    def changed(u):
        """Return the coordinates of the changed model, their values, and the change of those that
        may move, with rotations scaled by the size of the model."""
        coordinates = Coordinates(write(model, dict(zip(leaves, u[:n], strict=True))))
        delta = jnp.zeros(layout.nv, u.dtype).at[np.array(rows, int)].set(u[n:]) * scale
        q = coordinates.retract(pose, delta)
        return coordinates, _closed(coordinates, q, held) if rows else q, delta

    def unbalanced(u):
        coordinates, q, _ = changed(u)
        coordinates = eqx.tree_at(
            lambda of: of.model, coordinates, relaxed(coordinates.model, state.z)
        )
        r = slope(configuration_at(coordinates, q, base=False)) * scale
        return free_motions(coordinates, q, scale).projector @ r if model.closures else r

    def step(u, _):
        A = jax.jacfwd(unbalanced)(u)
        return u - jnp.linalg.pinv(A, rtol=reachable(RANK, A.dtype)) @ unbalanced(u), None

    u, _ = jax.lax.scan(step, start, None, length=ITERATIONS)
    residual = unbalanced(u)
    weights = jnp.sum(model.bodies.rows.mass) * jnp.linalg.norm(model.gravity)
    largest = jnp.maximum(
        jnp.maximum(weights, jnp.max(jnp.abs(unbalanced(start)), initial=0.0)), 1e-300
    )
    signed = np.array([leaf.kind.domain == "any" for leaf in leaves], bool)
    status = jnp.select(
        [
            ~(
                jnp.max(jnp.abs(residual), initial=0.0)
                <= reachable(BALANCED, residual.dtype, 256) * largest
            ),
            jnp.any((u[:n] < 0) & ~signed),
        ],
        [Status.UNBALANCED.value, Status.NEGATIVE_LENGTH.value],
        Status.OK.value,
    )
    coordinates, q, delta = changed(u)
    gap = how_open(coordinates, q) if model.closures else jnp.zeros((), q.dtype)
    z = rest_states(coordinates.model, coordinates.at_rest(q).pose(), state.z)
    return Preload(
        status=jnp.where(gap <= CLOSED, status, Status.NOT_CLOSED.value),
        values=u[:n],
        change=(u - start)[:n],
        moves=delta[np.array(rows, int)],
        residual=residual / scale,
        gap=gap,
        state=State(q, jnp.zeros(layout.nv, q.dtype), z),
        model=coordinates.model,
        paths=tuple(leaf.path for leaf in leaves),
        moving=tuple(layout.coordinates[i] for i in rows),
    )


def _closed(
    coordinates: Coordinates, q: Float[Array, "nq"], held: np.ndarray | None
) -> Float[Array, "nq"]:
    """Return the configuration next to q that fulfills the closures; q for a model without
    closures."""
    return (
        closed_on(coordinates, drawn(coordinates), coordinates.supports.at_rest(), q, held)
        if coordinates.model.closures
        else q
    )
