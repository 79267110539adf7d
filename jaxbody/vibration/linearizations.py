"""Small motions about a state: mass, damping and stiffness matrices with their blocks that couple
to the base, as second derivatives.

    M Delta'' + C Delta' + K Delta = K~ Xi + C~ Xi' + M~ Xi''

M | -M~ | M_bb   Hessian of T in (v, Xi')
C | -C~ | C_bb   Hessian of R in (v, Xi')
K | -K~ | K_bb   Hessian of V in (Delta, Xi)      (41), (42), (49), (66) of the paper
"""

from __future__ import annotations

import dataclasses
from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxbody.lagrange as lagrange
from jaxbody.core import tables
from jaxbody.core.arguments import check_one_of, kind_of
from jaxbody.core.arrays import Array, Float, Inexact, Int, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status
from jaxbody.core.results import Labeled, Result, dataset, warn_if_failed
from jaxbody.mechanics.constraints import how_open
from jaxbody.mechanics.equilibria import NOT_AT_REST, Equilibrium
from jaxbody.mechanics.failure_causes import zero_modes
from jaxbody.mechanics.free_motions import DependentMotions, closure_stiffness, dependent_motions
from jaxbody.mechanics.hessians import configuration_at, gravity_stiffness, split_stiffness
from jaxbody.mechanics.internal_coordinates import following, slow_matrices, whole_matrices
from jaxbody.mechanics.load_paths import generalized_force, in_full, stiffness_of_loads
from jaxbody.model.element_states import apart, settled
from jaxbody.model.inputs.loads import Load
from jaxbody.model.joints.frame_tables import completed
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.leaf_paths import by_name
from jaxbody.model.models import Model, scale_of, scaled, size_of
from jaxbody.model.preconditions import (
    check_memory,
    check_precision,
    check_small_motions,
    check_state,
)
from jaxbody.model.states import State
from jaxbody.numerics.lanes import in_lanes
from jaxbody.vibration.mode_names import Basis, basis_of
from jaxbody.vibration.state_spaces import StateSpace, state_space

UNITS = {
    "M": "kg, kg m, kg m2",
    "C": "N s/m, N s, N m s",
    "G": "N s/m, N s, N m s",
    "K": "N/m, N, N m",
}
NEARLY_CLOSED = 1e-6  # largest error of closures, relative to the size of the model
SINGULAR_CLOSURES = 1e-7  # smallest singular value of J_d, relative to the largest
HEADINGS = UNITS | dict.fromkeys(("C", "G"), "N s/m, ...")


class LinearSystem(Labeled, Result):
    """The equations of small motions about `state`, M Delta'' + D Delta' + K Delta = 0, with D = C
    about a state at rest; modes, poles, responses and state spaces are computed from it.
    `coordinates`: names of the rows; `basis`: velocities of the bodies per unit of each."""

    index = "coordinate"
    M: Float[Array, "nv nv"]
    C: Float[Array, "nv nv"]
    K: Float[Array, "nv nv"]
    status: Int[Array, ""]
    state: State
    model: Model
    basis: Basis
    # for a model with closures, otherwise None
    dependent: DependentMotions | None = eqx.field(default=None, kw_only=True)
    printed: ClassVar[tuple[str, ...]] = ("M", "C", "K")  # the matrices that are printed
    exported: ClassVar[tuple[str, ...]] = ()  # the matrices in a dataset

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The names of the rows of M, C, K: those of Delta, then the coordinates of elements, those
        with mass first."""
        layout = self.model.layout
        return tuple(layout.coordinates[i] for i in self.independent) + layout.inner[: self.inner]

    @property
    def independent(self) -> tuple[int, ...]:
        """The indices of the system's own coordinates among those of the model: all of them, or
        with closures the independent ones."""
        return self.model.independent or ()

    @property
    def nv(self) -> int:
        """The number of coordinates with inertia."""
        return len(self.independent) + len(self.model.layout.inertial)

    def expanded(self, shapes: Inexact[Array, "nf n"]) -> Inexact[Array, "nv n"]:
        """Return shapes (columns) in all coordinates of the model, from those in the coordinates of
        the system."""
        if self.dependent is None:
            return shapes
        N, nf = self.dependent.N.astype(shapes.dtype), len(self.independent)
        return jnp.concatenate([N @ shapes[:nf], shapes[nf:]]) if len(shapes) > nf else N @ shapes

    @property
    def inner(self) -> int:
        """The number of rows of coordinates of elements."""
        return self.M.shape[-1] - len(self.independent)

    @property
    def massless(self) -> int:
        """The number of rows of massless coordinates, the last ones."""
        return self.M.shape[-1] - self.nv

    @property
    def base_coordinates(self) -> tuple[str, ...]:
        """The names of the components of Xi."""
        return self.model.layout.base_coordinates

    @property
    def D(self) -> Float[Array, "nv nv"]:
        """The matrix of Delta': C, and about a spin C + G."""
        return self.C

    @property
    def scale(self) -> Float[Array, "nv"]:
        """The change of each coordinate that displaces by about one meter: 1 for a translation,
        1/size of the model for an angle."""
        size, layout = size_of(self.model), self.model.layout
        scale = scale_of(self.model, size)[..., np.array(self.independent, int)]
        if not self.inner:
            return scale
        turns = layout.follows_angles[layout.inner_places[: self.inner]]
        return jnp.concatenate([scale, jnp.where(turns, 1 / size, 1.0)])

    def kept_status(self, own: Array, failures: tuple[Status, ...] = ()) -> Int[Array, ""]:
        """Return the status of a result: that of the system if the state is not at rest or in
        steady motion, or if it is one of `failures`; otherwise the result's `own`."""
        return jnp.where(
            jnp.isin(self.status, jnp.array((*NOT_AT_REST, Status.NOT_STEADY, *failures))),
            self.status,
            own,
        )

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: the matrices and their blocks that couple to the base, by named
        coordinates."""
        own, base = list(self.coordinates), list(self.base_coordinates)
        blocks = {"tilde": ("coordinate", "base"), "bb": ("base", "base_2")}
        axes = {
            name: blocks.get(name.partition("_")[2], ("coordinate", "coordinate_2"))
            for name in self.exported
        }
        variables: dict[str, Any] = {
            name: (dims, getattr(self, name), UNITS[name[0]])
            for name, dims in axes.items()
            if base or "base" not in dims
        }
        coordinates = {"coordinate": own, "coordinate_2": own} | (
            {"base": base, "base_2": base} if base else {}
        )
        return dataset(
            variables | {"status": ((), self.status, "")}, coordinates, type(self).__name__
        )

    def _tables(self) -> list[tables.PrintedTable]:
        shown = [
            tables.of_matrix(f"{name} [{HEADINGS[name]}]", getattr(self, name), self.coordinates)
            for name in self.printed
        ]
        shown[-1].note = self.note()
        return shown

    @abstractmethod
    def note(self) -> str:
        """Return the text that is printed below the matrices."""


class Linearization(LinearSystem):
    """The matrices of small motions about `state`, rows and columns as in `coordinates`
    and `base_coordinates`.

    Coordinates y of elements with memory have rows after those of Delta: first those with mass,
    then massless ones, with M = 0; `condensed` and `instantaneous` are the systems without the
    massless ones. Hysteretic states have no rows: to first order hysteretic elements are springs,
    and their losses are of higher order.

    The chart: Delta of a free body is the displacement of its O and a rotation vector, in world
    axes; for other joints, their coordinates, in axes of the parent. Away from equilibrium K
    depends on the chart; its parts (elastic, geometric, ...) do everywhere."""

    M_tilde: Float[Array, "nv nxi"]
    C_tilde: Float[Array, "nv nxi"]
    K_tilde: Float[Array, "nv nxi"]
    M_bb: Float[Array, "nxi nxi"]
    C_bb: Float[Array, "nxi nxi"]
    K_bb: Float[Array, "nxi nxi"]
    loads: tuple[Load, ...]
    # rows of Xi of M, C and K where these are not symmetric; None: the transposed blocks
    base_rows: tuple[Float[Array, "nxi nv"], ...] | None = None
    # whether massless coordinates follow slow motions statically, and so have no rows
    slow: bool = eqx.field(static=True, default=False)
    exported = tuple(
        f"{name}{block}" for name in ("M", "C", "K") for block in ("", "_tilde", "_bb")
    )

    @property
    def whole(self) -> tuple[Float[Array, "n n"], Float[Array, "n n"], Float[Array, "n n"]]:
        """K, C and M of (Delta, Xi)."""
        blocks = (
            (self.K, self.K_tilde, self.K_bb),
            (self.C, self.C_tilde, self.C_bb),
            (self.M, self.M_tilde, self.M_bb),
        )
        rows = tuple(-A_tilde.T for _, A_tilde, _ in blocks)
        rows = self.base_rows[::-1] if self.base_rows else rows
        return tuple(  # pyright: ignore[reportReturnType]  of three
            jnp.block([[A, -A_tilde], [row, A_bb]])
            for (A, A_tilde, A_bb), row in zip(blocks, rows, strict=True)
        )

    @property
    def without_potential(self) -> bool:
        """Whether forces act that need not have a potential, so that K may not be symmetric."""
        return without_potential(self.model, self.loads)

    def reduced(self, H: Float[Array, "*m nv nv"]) -> Float[Array, "*m nf nf"]:
        """Return N' H N, which is the matrix H of the model's coordinates in those of the
        system."""
        return (
            H
            if self.dependent is None
            else jnp.swapaxes(self.dependent.N, -1, -2) @ H @ self.dependent.N
        )

    @property
    def held(self) -> Model:
        """The model as the matrices describe it: its laws with memory are relaxed if `slow`,
        otherwise they have coordinates of their own."""
        return (settled if self.slow else apart)(self.model, self.state.z)

    @property
    def condensed(self) -> Linearization:
        """The system without rows of massless coordinates y, which follow slow motions statically,
        K_yy y + K_yx x = 0: the matrices T' H T for M, C and K."""
        return _condensed(self) if self.massless else self

    @property
    def instantaneous(self) -> Linearization:
        """The system without rows of massless coordinates, which are held: for motions much faster
        than any relaxation."""
        if not self.massless:
            return self
        nv = self.nv
        own: dict[str, Any] = {name: getattr(self, name)[..., :nv, :nv] for name in ("M", "C", "K")}
        tilde = {f"{name}_tilde": getattr(self, f"{name}_tilde")[..., :nv, :] for name in own}
        if self.base_rows:
            own["base_rows"] = tuple(rows[..., :nv] for rows in self.base_rows)
        return dataclasses.replace(self, **own, **tilde)

    @property
    def quasistatic(self) -> tuple[Float[Array, "nf nf"], Float[Array, "nf nf"]]:
        """M and K without rows of coordinates of elements, which all follow slow motions
        statically."""
        return (
            slow_matrices(self.M, self.K, len(self.independent)) if self.inner else (self.M, self.K)
        )

    @property
    def _zero(self) -> Float[Array, "nf nf"]:
        return jnp.zeros_like(self.K[..., : len(self.independent), : len(self.independent)])

    @property
    def K_elastic(self) -> Float[Array, "nv nv"]:
        """The elastic part of K, the sum of V''(e) de de over the elements; their coordinates that
        have rows of their own are held fixed."""
        return sum(self.K_elastic_by_element.values(), self._zero)

    @property
    def K_geometric(self) -> Float[Array, "nv nv"]:
        """The geometric part of K, the sum of V'(e) d2e over the elements: the stiffness due to
        their tension."""
        return sum(self.K_geometric_by_element.values(), self._zero)

    @property
    def K_gravity(self) -> Float[Array, "nv nv"]:
        """Hessian of the potential energy of the weights; (40) of the paper."""
        return self.reduced(gravity_stiffness(self.model, self.state))

    @property
    def K_loads(self) -> Float[Array, "nv nv"]:
        """The part of K due to the loads of the equilibrium and to force elements, -dQ/dDelta; not
        symmetric where they have no potential."""
        return -self.reduced(_load_stiffness(self))

    @property
    def K_closures(self) -> Float[Array, "nv nv"]:
        """Hessian of lambda c: the stiffness due to the forces of closures; zero
        without closures."""
        return _closure_stiffness(self) if self.dependent else self._zero

    @property
    def K_elastic_by_element(self) -> dict[str, Float[Array, "nv nv"]]:
        return self._by_element(split_stiffness(self.held, self.state)[0])

    @property
    def K_geometric_by_element(self) -> dict[str, Float[Array, "nv nv"]]:
        return self._by_element(split_stiffness(self.held, self.state)[1])

    def _by_element(self, matrices: Any) -> dict[str, Float[Array, "nv nv"]]:
        """Return {element: its matrix in the coordinates of the system}."""
        names = tuple(table.names for table in self.model.elements)
        return by_name(names, [self.reduced(H) for H in matrices])

    def note(self):
        return (
            "chart: displacement of O and rotation vector, in world axes (joints: their "
            "coordinates, axes of the parent)"
        )

    def explain(self) -> str:
        match Status(int(self.status)):
            case Status.OK:
                return ""
            case Status.SINGULAR_K:
                return "; ".join(zero_modes(self.model, self.state))
            case Status.STALE:
                return "compute the equilibrium of the changed model again"
            case Status.SINGULAR_CLOSURE:
                names = ", ".join(f"'{name}'" for name in self.coordinates)
                return f"{names} do not determine the other coordinates"
        return "the state is not an equilibrium"

    def state_space(self, inputs: dict[str, Any], outputs: dict[str, Any]) -> StateSpace:
        """Compute A, B, C, D from named inputs to named outputs, {name: port}, in the form of
        python-control.

        States: Delta and Delta' minus terms in u, so that no derivative of an input is needed; also
        the displacement of a base motion given as velocity, and displacement and velocity of one
        given as acceleration. An output that depends on derivatives of u, such as the acceleration
        of a damped body if the input is the displacement of its base, has no state space: the
        status is IMPROPER, with NaN in D; use kind="acceleration".
        Errors: WRONG_KIND, UNKNOWN_NAME, BAD_COMPONENT.

        >>> spring = jb.Spring(
        ...     ("mass", [0, 0, 0]), ("base", [0, 1, 0]), stiffness=50.0, free_length=1.0
        ... )
        >>> model = jb.Model(
        ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
        ...     supports={"base": jb.Support()},
        ...     elements={"s": spring},
        ... )
        >>> lin = jb.linearize(model, jb.equilibrium(model))
        >>> s = lin.state_space(
        ...     {"base": jb.BaseMotion("base", "y")}, {"mass": jb.Position("mass", axis="y")}
        ... )
        >>> s.A.tolist(), s.B.tolist()
        ([[0.0, 1.0], [-25.0, 0.0]], [[0.0], [25.0]])
        """
        return state_space(self, inputs, outputs)


def check_system(
    lin: Any,
    where: str,
    kind: type[LinearSystem] = Linearization,
    *,
    allow_float32: bool | None = True,
) -> None:
    """Check that an argument is a linear system of this kind, not one about a spin, and that
    float32 is not used where it would lose half the digits."""
    if not isinstance(lin, kind):
        raise JaxbodyError(
            Problem(
                "WRONG_KIND",
                f"{where}.lin",
                f"is {kind_of(lin)}",
                lin,
                "a Linearization",
                "Use complex_modes."
                if isinstance(lin, LinearSystem)
                else "Give linearize(model, equilibrium(model)): all else is computed from it.",
            )
        )
    check_precision(where, lin.model, allow_float32=allow_float32)


def linearize(
    model: Model, at: Equilibrium | State, *, method: str = "structured"
) -> Linearization:
    """Compute M, C, K and the blocks for the motion of the supports, at an equilibrium or any other
    state, with the supports in their reference poses.

    For a model with closures, rows and columns are those of independent coordinates, chosen in its
    reference pose; the others follow, Delta = N Delta_i + S Xi, and every matrix is T' H T, T =
    [[N, S], [0, 1]]; for K, H is the Hessian of V + lambda c.

    Loads of the equilibrium are included: K = d2V/dDelta2 - dQ/dDelta. The status of a failed
    equilibrium is kept; it is STALE, with a warning, if numbers of the model have changed so that
    the state is no longer an equilibrium. With method="definition" the matrices are jax.hessian of
    T, R and V + lambda c, as `lagrange.py` states them: the same, more slowly. Errors: BAD_SHAPE,
    NON_FINITE for a state, OTHER_MODEL, NOTHING_MOVES, BAD_METHOD.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     elements={
    ...         "s": jb.Spring(
    ...             ("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=50.0, free_length=1.0
    ...         )
    ...     },
    ... )
    >>> lin = jb.linearize(model, jb.equilibrium(model))
    >>> float(lin.K[0, 0]), float(lin.M[0, 0])
    (50.0, 2.0)
    """
    check_small_motions("linearize", model)
    check_memory("linearize", model)
    with Problems() as problems:
        check_one_of(
            method, ("structured", "definition"), "BAD_METHOD", "linearize.method", problems
        )
    linearized = _by_definition if method == "definition" else _linearize
    if isinstance(at, Equilibrium):
        if at.layout != model.layout:
            raise JaxbodyError(
                Problem(
                    "OTHER_MODEL",
                    "linearize.at",
                    "is of a model with other bodies, supports or joints",
                    at.layout,
                    "an equilibrium of this model",
                    "Give the equilibrium of this model, or a state.",
                )
            )
        result = linearized(model, at.state, at.status, at.loads)
        if is_concrete(result.status) and np.any(np.asarray(result.status) == Status.STALE):
            warn_if_failed(result)
        return result
    check_state(model, at, "state")
    return linearized(model, at, None, ())


@program
def _by_definition(
    model: Model, state: State, status: Int[Array, ""] | None, loads: tuple[Load, ...]
) -> Linearization:
    state = completed(model, state)
    coordinates, r = Coordinates(apart(model, state.z)), lagrange.unbalanced(model, state, loads)
    moves = (
        dependent_motions(coordinates, state.q, r, model.independent or ())
        if model.closures
        else None
    )
    whole, ny = (
        lagrange.matrices(
            model, state, loads, moves.multipliers if moves else jnp.zeros(0, r.dtype)
        ),
        len(model.layout.inner),
    )
    basis = basis_of(configuration_at(coordinates, state.q, state.v))
    if moves:
        whole = [moves.of(H, ny) for H in whole]
    blocks = _blocks(whole, len(model.independent or ()) + ny, rows=without_potential(model, loads))
    return _system(model, state, status, loads, blocks, r, basis, moves)


@program
def _linearize(
    model: Model, state: State, status: Int[Array, ""] | None, loads: tuple[Load, ...]
) -> Linearization:
    state, nv, ny = completed(model, state), model.layout.nv, len(model.layout.inner)
    coordinates = Coordinates(apart(model, state.z))
    numbers, rest = eqx.partition(coordinates.model, eqx.is_array)

    def matrices(numbers, q, v) -> Any:
        at = configuration_at(Coordinates(eqx.combine(numbers, rest)), q, v)
        whole, slope = whole_matrices(at)
        whole = whole if model.closures else _blocks(whole, nv + ny, rows=False)
        return whole, slope[:nv], basis_of(at)

    hessians: Any
    hessians, slope, basis = (matrices if model.closures else in_lanes(matrices, reversible=True))(
        numbers, state.q, state.v
    )
    r = slope
    if without_potential(model, loads):
        at = configuration_at(coordinates, state.q, base=False)
        r = r - generalized_force(at, in_full(loads, r.dtype))
        parts: Any = lagrange.force_matrices(model, state, loads)
        if model.closures:
            hessians = [H + part for H, part in zip(hessians, parts, strict=True)]
        else:
            parts = _blocks(parts, nv + ny, rows=True)
            rows = tuple(-hessians[f"{name}_tilde"].T for name in "MCK")
            hessians = jax.tree.map(jnp.add, hessians | {"base_rows": rows}, parts)
    if not model.closures:
        return _system(model, state, status, loads, hessians, r, basis, None)
    M, C, K = hessians
    moves = dependent_motions(coordinates, state.q, r, model.independent or ())
    x = np.r_[:nv, nv + ny : len(K)]  # the rows of (Delta, Xi)
    bent = closure_stiffness(coordinates, state.q, moves.multipliers)
    K = jnp.asarray(K).at[np.ix_(x, x)].add(bent)
    whole = [moves.of(H, ny) for H in (M, C, K)]
    blocks = _blocks(whole, len(moves.N.T) + ny, rows=without_potential(model, loads))
    return _system(model, state, status, loads, blocks, r, basis, moves)


def without_potential(model: Model, loads: tuple[Load, ...]) -> bool:
    """Return whether forces act that need not have a potential."""
    return bool(loads or model.forces)


def _blocks(whole: Any, n: int, *, rows: bool) -> dict[str, Any]:
    """Return the blocks of M, C and K of n coordinates and Xi, by their names in a Linearization: M
    of the coordinates, M_tilde between these and Xi, M_bb of Xi, and so on; with `rows`, the rows
    of Xi too."""
    blocks: dict[str, Any] = {}
    if rows:
        blocks["base_rows"] = tuple(H[n:, :n] for H in whole)
    for name, H in zip("MCK", whole, strict=True):
        blocks |= {name: H[:n, :n], f"{name}_tilde": -H[:n, n:], f"{name}_bb": H[n:, n:]}
    return blocks


def _system(
    model: Model,
    state: State,
    status: Any,
    loads: tuple[Load, ...],
    blocks: dict[str, Any],
    r: Float[Array, "nv"],
    basis: Basis,
    moves: Any,
) -> Linearization:
    """Return the linearization with these blocks. `status` is that of the equilibrium, None for
    another state; it becomes STALE where r = dV/dDelta - Q is not zero."""
    own = np.array(model.independent, int)
    size = size_of(model)
    scale = scale_of(model, size)[own]
    if status is None:
        status = jnp.array(Status.OK.value)
    else:
        K = blocks["K"][: len(own), : len(own)]
        largest = jnp.max(jnp.abs(scaled(K, scale)), initial=0.0) * size
        stale = (
            jnp.max(jnp.abs((r if moves is None else moves.N.T @ r) * scale), initial=0.0)
            > jnp.finfo(r.dtype).eps ** 0.5 * largest
        )
        status = jnp.where(
            stale & ~jnp.isin(status, jnp.array(NOT_AT_REST)), Status.STALE.value, status
        )
    if moves is not None:
        fails = [
            how_open(Coordinates(model), state.q) > NEARLY_CLOSED,
            moves.smallest < SINGULAR_CLOSURES,
        ]
        status = jnp.select(fails, [Status.NOT_CLOSED.value, Status.SINGULAR_CLOSURE.value], status)
    return Linearization(
        **blocks,  # pyright: ignore[reportArgumentType]
        status=status,
        state=state,
        model=model,
        basis=basis,
        loads=loads,
        dependent=moves,
    )


@program
def _closure_stiffness(lin: Linearization) -> Float[Array, "nf nf"]:
    nv, moves = lin.model.layout.nv, lin.dependent
    return lin.reduced(
        closure_stiffness(Coordinates(lin.held), lin.state.q, moves.multipliers)[:nv, :nv]  # pyright: ignore[reportOptionalMemberAccess]
    )


@program
def _condensed(lin: Linearization) -> Linearization:
    nv, ny = lin.nv, lin.massless
    K, C, M = lin.whole
    left, right = following(K.T, nv, ny), following(K, nv, ny)
    blocks = _blocks([left.T @ H @ right for H in (M, C, K)], nv, rows=lin.without_potential)
    return dataclasses.replace(lin, **blocks, slow=True)


@program
def _load_stiffness(lin: Linearization) -> Float[Array, "nv nv"]:
    at = configuration_at(Coordinates(lin.held), lin.state.q, base=False)
    return stiffness_of_loads(at, in_full(lin.loads, lin.K.dtype))
