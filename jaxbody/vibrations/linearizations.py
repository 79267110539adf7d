"""Small motions about a state: mass, damping and stiffness matrices with their blocks that couple to the base, as second derivatives.

M | -M~ | M_bb   Hessian of T in (v, Xi')         M Delta'' + C Delta' + K Delta = K~ Xi + C~ Xi' + M~ Xi''
C | -C~ | C_bb   Hessian of R in (v, Xi')
K | -K~ | K_bb   Hessian of V in (Delta, Xi)      (41), (42), (49), (66) of the paper
"""

from __future__ import annotations

from abc import abstractmethod
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.compilation.compile_options import jit_unoptimized
from jaxbody.core import tables
from jaxbody.core.arguments import checked_dict, kind_of
from jaxbody.core.arrays import Array, Float, Int, is_concrete, shaped, stack
from jaxbody.core.datasets import Labeled, dataset
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, unknown
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.geometry.frames import Frame
from jaxbody.inputs.loads import Load
from jaxbody.mechanics.element_derivatives import element_derivatives
from jaxbody.mechanics.element_states import completed
from jaxbody.mechanics.energies import each_element, gravity_energy, potential
from jaxbody.mechanics.hessians import configuration_at, damping, expansion, mass
from jaxbody.mechanics.inner_rows import following, inner_rows, inserted
from jaxbody.mechanics.kinematics import Coordinates
from jaxbody.models.leaf_paths import by_name
from jaxbody.models.memories import apart, holding, settled
from jaxbody.models.models import Model
from jaxbody.models.preconditions import check_memory, check_precision, check_state
from jaxbody.models.sizes import scale_of, scaled, size_of
from jaxbody.models.states import State
from jaxbody.numerics.lanes import in_lanes
from jaxbody.statics.equilibria import NOT_AT_REST, Equilibrium
from jaxbody.statics.load_paths import generalized_force, stiffness_of_loads
from jaxbody.statics.null_motions import zero_modes
from jaxbody.vibrations.mode_names import Basis, basis_at
from jaxbody.vibrations.state_spaces import StateSpace, state_space

UNITS = {"M": "kg, kg m, kg m2", "C": "N s/m, N s, N m s", "G": "N s/m, N s, N m s", "K": "N/m, N, N m"}
HEADINGS = UNITS | dict.fromkeys(("C", "G"), "N s/m, ...")


class LinearSystem(Labeled, Result):
    """M Delta'' + D Delta' + K Delta = 0 of small motions about `state`, with D = C for a rest: what modes, poles, responses and state
    spaces read. `coordinates` names the rows, `basis` says which motion of which body each is."""

    index = "coordinate"
    M: Float[Array, "nv nv"]
    C: Float[Array, "nv nv"]
    K: Float[Array, "nv nv"]
    status: Int[Array, ""]
    state: State
    model: Model
    printed: ClassVar[tuple[str, ...]] = ("M", "C", "K")  # the matrices that are printed
    exported: ClassVar[tuple[str, ...]] = ()  # those of a dataset

    @property
    def coordinates(self) -> tuple[str, ...]:
        """The names of the rows of M, C, K: those of Delta, then of massless coordinates of elements that have rows of their own."""
        layout = self.model.layout
        return layout.coordinates + layout.inner[: self.inner]

    @property
    def inner(self) -> int:
        """The number of massless coordinates that have rows."""
        return self.M.shape[-1] - self.model.layout.nv

    @property
    def base_coordinates(self) -> tuple[str, ...]:
        """The names of the components of Xi."""
        return self.model.layout.base_coordinates

    @property
    def D(self) -> Float[Array, "nv nv"]:
        """The matrix of Delta': C, and about a spin C + G."""
        return self.C

    @property
    def basis(self) -> Basis:
        """The motions of the bodies per unit of each coordinate."""
        return basis_at(self.model, self.state.q)

    @property
    def scale(self) -> Float[Array, "nv"]:
        """The change of each coordinate of one meter."""
        size = size_of(self.model)
        scale, layout = scale_of(self.model, size), self.model.layout
        if not self.inner:
            return scale
        return jnp.concatenate([scale, jnp.where(layout.follows_angles[layout.massless], 1 / size, 1.0)])

    def kept_status(self, own: Array, failures: tuple[Status, ...] = ()) -> Int[Array, ""]:
        """The status of a result: that of the system where it is about no rest or steady motion, or one of `failures`; else its `own`."""
        return jnp.where(jnp.isin(self.status, jnp.array((*NOT_AT_REST, Status.NOT_STEADY, *failures))), self.status, own)

    def to_xarray(self) -> Any:
        """An xarray.Dataset: the matrices and their blocks that couple to the base, by named coordinates."""
        own, base = list(self.coordinates), list(self.base_coordinates)
        blocks = {"tilde": ("coordinate", "base"), "bb": ("base", "base_2")}
        axes = {name: blocks.get(name.partition("_")[2], ("coordinate", "coordinate_2")) for name in self.exported}
        variables: dict[str, Any] = {
            name: (dims, getattr(self, name), UNITS[name[0]]) for name, dims in axes.items() if base or "base" not in dims
        }
        coordinates = {"coordinate": own, "coordinate_2": own} | ({"base": base, "base_2": base} if base else {})
        return dataset(variables | {"status": ((), self.status, "")}, coordinates, type(self).__name__)

    def _tables(self) -> list[tables.PrintedTable]:
        shown = [tables.of_matrix(f"{name} [{HEADINGS[name]}]", getattr(self, name), self.coordinates) for name in self.printed]
        shown[-1].note = self.note()
        return shown

    @abstractmethod
    def note(self) -> str:
        """What is printed below the matrices."""


class Linearization(LinearSystem):
    """The matrices of small motions about `state`, rows and columns as in `coordinates` and `base_coordinates`.

    Massless coordinates y of elements with memory have rows after those of Delta, with M = 0; `condensed` and `instantaneous` are without
    them. Hysteretic states have none: to first order they are springs, and their losses are of higher order.

    The chart: Delta of a free body is the displacement of its O and a rotation vector, in world axes; for other joints, their coordinates,
        in axes of the parent. Away from equilibrium K depends on the chart; its split depends on it everywhere."""

    M_tilde: Float[Array, "nv nxi"]
    C_tilde: Float[Array, "nv nxi"]
    K_tilde: Float[Array, "nv nxi"]
    M_bb: Float[Array, "nxi nxi"]
    C_bb: Float[Array, "nxi nxi"]
    K_bb: Float[Array, "nxi nxi"]
    loads: tuple[Load, ...]
    slow: bool = eqx.field(static=True, default=False)  # whether massless coordinates follow, and so have no rows
    exported = tuple(f"{name}{block}" for name in ("M", "C", "K") for block in ("", "_tilde", "_bb"))

    @property
    def whole(self) -> tuple[Float[Array, "n n"], Float[Array, "n n"], Float[Array, "n n"]]:
        """K, C and M of (Delta, Xi)."""
        blocks = ((self.K, self.K_tilde, self.K_bb), (self.C, self.C_tilde, self.C_bb), (self.M, self.M_tilde, self.M_bb))
        return tuple(jnp.block([[A, -A_tilde], [-A_tilde.T, A_bb]]) for A, A_tilde, A_bb in blocks)  # pyright: ignore[reportReturnType]  of three

    @property
    def held(self) -> Model:
        """The model with its laws with memory as the rows have them."""
        return (settled if self.slow else apart)(self.model, self.state.z)

    @property
    def condensed(self) -> Linearization:
        """The system without rows of massless coordinates, which follow slow motions: T' H T of M, C and K, K_yy y + K_yx x = 0."""
        return _condensed(self) if self.inner else self

    @property
    def instantaneous(self) -> Linearization:
        """The system without rows of massless coordinates, which are held: for motions much faster than any relaxation."""
        return _instantaneous(self) if self.inner else self

    @property
    def K_elastic(self) -> Float[Array, "nv nv"]:
        """sum of V''(e) de de over the elements; of massless coordinates without their rows, those that `slow` says."""
        return sum(self.K_elastic_by_element.values(), jnp.zeros_like(self.K[..., : self.model.layout.nv, : self.model.layout.nv]))

    @property
    def K_geometric(self) -> Float[Array, "nv nv"]:
        """sum of V'(e) d2e over the elements: the stiffness due to tension."""
        return sum(self.K_geometric_by_element.values(), jnp.zeros_like(self.K[..., : self.model.layout.nv, : self.model.layout.nv]))

    @property
    def K_gravity(self) -> Float[Array, "nv nv"]:
        """Hessian of the potential energy of the weights; (40) of the paper."""
        return _gravity_stiffness(self.model, self.state)

    @property
    def K_loads(self) -> Float[Array, "nv nv"]:
        """-dQ/dDelta of the loads of the equilibrium; not symmetric where they have no potential."""
        return -_load_stiffness(self.model, self.state, self.loads)

    @property
    def K_elastic_by_element(self) -> dict[str, Float[Array, "nv nv"]]:
        return by_name(_names(self.model), _split(self)[0])

    @property
    def K_geometric_by_element(self) -> dict[str, Float[Array, "nv nv"]]:
        return by_name(_names(self.model), _split(self)[1])

    def note(self):
        return "chart: displacement of O and rotation vector, in world axes (joints: their coordinates, axes of the parent)"

    def explain(self) -> str:
        if int(self.status) == Status.SINGULAR_K:
            return "; ".join(zero_modes(self.model, self.state))
        if int(self.status) == Status.STALE:
            return "compute the equilibrium of the changed model again"
        return "the state is not an equilibrium" if int(self.status) else ""

    def state_space(self, inputs: dict[str, Any], outputs: dict[str, Any]) -> StateSpace:
        """A, B, C, D from named inputs to named outputs, {name: port}, as python-control takes them.

        States: Delta and Delta' minus terms in u, so that no derivative of an input is needed; also the displacement of a base motion given
        as velocity, and displacement and velocity of one given as acceleration. An output that depends on derivatives of u, such as the
        acceleration of a damped body if the input is the displacement of its base, has no state space: the status is IMPROPER, with NaN in
        D; use kind="acceleration".
        Errors: WRONG_KIND, UNKNOWN_NAME, BAD_COMPONENT.

        >>> spring = Spring(("mass", [0, 0, 0]), ("base", [0, 1, 0]), stiffness=50.0, free_length=1.0)
        >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, joints={"mass": Guide("world", axis=[0, 1, 0])},
        ...               supports={"base": Support()}, elements={"s": spring})
        >>> lin = linearize(model, equilibrium(model))
        >>> s = lin.state_space({"base": BaseMotion("base", "y")}, {"mass": Position("mass", axis="y")})
        >>> s.A.tolist(), s.B.tolist()
        ([[0.0, 1.0], [-25.0, 0.0]], [[0.0], [25.0]])
        """
        return state_space(self, inputs, outputs)


def check_system(lin: Any, where: str, kind: type[LinearSystem] = Linearization, *, allow_float32: bool | None = True) -> None:
    """Refuse what is no linear system of this kind, such as one about a spin, and float32 where it would lose half the digits."""
    if not isinstance(lin, kind):
        spins = isinstance(lin, LinearSystem)
        hint = "Use complex_modes." if spins else "Give linearize(model, equilibrium(model)): all else is computed from it."
        raise JaxbodyError(Problem("WRONG_KIND", f"{where}.lin", f"is {kind_of(lin)}", lin, "a Linearization", hint))
    check_precision(where, lin.model, allow_float32=allow_float32)


def linearize(model: Model, at: Equilibrium | State) -> Linearization:
    """M, C, K and their blocks that couple to the supports, at an equilibrium or any state, with the supports at their reference poses.

    Loads of the equilibrium are included: K = d2V/dDelta2 - dQ/dDelta. The status of a failed equilibrium is kept; it is STALE, with a
    warning, if numbers of the model have changed so that the state is no longer an equilibrium. Errors: BAD_SHAPE, NON_FINITE for a state,
    OTHER_MODEL.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, joints={"mass": Guide("world", axis=[0, 1, 0])},
    ...               elements={"s": Spring(("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=50.0, free_length=1.0)})
    >>> lin = linearize(model, equilibrium(model))
    >>> float(lin.K[0, 0]), float(lin.M[0, 0])
    (50.0, 2.0)
    """
    check_precision("linearize", model)
    check_memory("linearize", model)
    if isinstance(at, Equilibrium):
        if at.layout != model.layout:
            hint = "Give the equilibrium of this model, or a state."
            message = "is of a model with other bodies, supports or joints"
            raise JaxbodyError(Problem("OTHER_MODEL", "linearize.at", message, at.layout, "an equilibrium of this model", hint))
        result = _linearize(model, at.state, at.status, at.loads)
        if is_concrete(result.status) and np.any(np.asarray(result.status) == Status.STALE):
            warn_if_failed(result)
        return result
    check_state(model, at, "state")
    return _linearize(model, at, None, ())


def excitation(model: Model, at: Equilibrium | State, displaced: dict[str, Any]) -> Float[Array, "nv"]:
    """The exact generalized force of a finite displacement Xi of supports, {name: (xi, phi)}, with the bodies held fixed:

        F^e = -(dV/dDelta(0, Xi) - dV/dDelta(0, 0)),     K~ Xi to first order; (54), (57) of the paper

    Massless coordinates of elements with memory are held, as for a quick displacement. Error: MEMORY for hysteretic elements, whose force
    depends on the path.

    Errors: UNKNOWN_NAME for a support, BAD_SHAPE.

    >>> spring = Spring(("mass", [0, 0, 0]), ("base", [0, 1, 0]), stiffness=50.0, free_length=1.0)
    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, joints={"mass": Guide("world", axis=[0, 1, 0])},
    ...               supports={"base": Support()}, elements={"s": spring})
    >>> force = excitation(model, model.reference, {"base": [0, 0.1, 0, 0, 0, 0]})
    >>> round(float(force[0]), 9)
    5.0
    """
    check_precision("excitation", model)
    state = at.state if isinstance(at, Equilibrium) else at
    check_state(model, state, "state")
    if len(model.layout.inner) < model.layout.nz:
        hint = "Simulate the displacement with a jb.Motion."
        message = "has hysteretic elements, whose force depends on the path of the displacement"
        raise JaxbodyError(Problem("MEMORY", "excitation.model", message, limit="elements without hysteresis", hint=hint))
    with Problems() as problems:
        given = checked_dict(displaced, "excitation.displaced", "support: 6 numbers", problems)
        problems.collected += [unknown(name, "excitation", model.layout.supports) for name in given if name not in model.layout.supports]
        known = [name for name in model.layout.supports if name in given]
        xi = {name: shaped(given[name], (6,), f"excitation[{name!r}]", problems) for name in known}
    return _excitation(model, state, stack([xi.get(name, np.zeros(6)) for name in model.layout.supports]))


def _frames(model: Model, state: State, delta, v, xi, xi_dot) -> Frame:
    coordinates = Coordinates(model)
    return coordinates.frames(coordinates.retract(state.q, delta), v, coordinates.supports_at(xi.reshape(-1, 6), xi_dot.reshape(-1, 6)))


@jit_unoptimized
def _linearize(model: Model, state: State, status: Int[Array, ""] | None, loads: tuple[Load, ...]) -> Linearization:
    """`status`: status of the equilibrium; None for other states."""
    nv, ny = model.layout.nv, len(model.layout.inner)
    state = completed(model, state)
    n, (numbers, rest) = nv + ny, eqx.partition(apart(model, state.z), eqx.is_array)

    def matrices(numbers, q, v):
        at = configuration_at(Coordinates(eqx.combine(numbers, rest)), q, v)
        _, slope, stiffness = expansion(at)
        whole = mass(at), damping(at), stiffness
        if ny:
            inner, zero = inner_rows(at), jnp.zeros((ny, len(stiffness)), q.dtype)
            rows = (zero, jnp.zeros((ny, ny), q.dtype)), (inner.C_yx, inner.C_yy), (inner.K_yx, inner.K_yy)
            whole = tuple(inserted(H, *row, nv) for H, row in zip(whole, rows, strict=True))
        return [(H[:n, :n], -H[:n, n:], H[n:, n:]) for H in whole], slope[:nv]

    ((M, M_tilde, M_bb), (C, C_tilde, C_bb), (K, K_tilde, K_bb)), slope = in_lanes(matrices, reversible=True)(numbers, state.q, state.v)
    K = K - _padded(_load_stiffness(model, state, loads), ny)
    if status is None:
        status = jnp.array(Status.OK.value)
    else:
        size = size_of(model)
        scale = scale_of(model, size)
        unbalanced = slope - generalized_force(model, state.q, loads, jnp.ones(len(loads), state.q.dtype), jnp.zeros_like(slope))
        largest = jnp.max(jnp.abs(scaled(K[:nv, :nv], scale)), initial=0.0) * size
        stale = jnp.max(jnp.abs(unbalanced * scale), initial=0.0) > jnp.finfo(unbalanced.dtype).eps ** 0.5 * largest
        status = jnp.where(stale & ~jnp.isin(status, jnp.array(NOT_AT_REST)), Status.STALE.value, status)
    return Linearization(M, C, K, status, state, model, M_tilde, C_tilde, K_tilde, M_bb, C_bb, K_bb, loads)


def _padded(K: Float[Array, "nv nv"], ny: int) -> Float[Array, "n n"]:
    return jnp.pad(K, (0, ny)) if ny else K


@jit_unoptimized
def _condensed(lin: Linearization) -> Linearization:
    nv, ny = lin.model.layout.nv, lin.inner
    K, C, M = lin.whole
    T = following(K, nv, ny)
    blocks = [(H[:nv, :nv], -H[:nv, nv:], H[nv:, nv:]) for H in (T.T @ H @ T for H in (M, C, K))]
    (M, C, K), tilde, bb = zip(*blocks, strict=True)
    return Linearization(M, C, K, lin.status, lin.state, lin.model, *tilde, *bb, lin.loads, slow=True)  # pyright: ignore[reportCallIssue]


def _instantaneous(lin: Linearization) -> Linearization:
    nv = lin.model.layout.nv
    M, C, K = (H[..., :nv, :nv] for H in (lin.M, lin.C, lin.K))
    M_x, C_x, K_x = (H[..., :nv, :] for H in (lin.M_tilde, lin.C_tilde, lin.K_tilde))
    return Linearization(M, C, K, lin.status, lin.state, lin.model, M_x, C_x, K_x, lin.M_bb, lin.C_bb, lin.K_bb, lin.loads)


@jit_unoptimized
def _excitation(model: Model, state: State, xi: Float[Array, "ns 6"]) -> Float[Array, "nv"]:
    zero, model = jnp.zeros(model.layout.nv, xi.dtype), holding(model, completed(model, state).z)

    def slope(xi):
        return jax.grad(lambda d: potential(model, _frames(model, state, d, zero, xi, jnp.zeros_like(xi))))(zero)

    return slope(jnp.zeros_like(xi)) - slope(xi)


def _load_stiffness(model: Model, state: State, loads: tuple[Load, ...]) -> Float[Array, "nv nv"]:
    return stiffness_of_loads(model, state.q, loads, jnp.ones(len(loads), state.q.dtype))


def _names(model: Model) -> tuple[tuple[str, ...], ...]:
    return tuple(table.names for table in model.elements)


@jit_unoptimized
def _gravity_stiffness(model: Model, state: State) -> Float[Array, "nv nv"]:
    zero, rest = jnp.zeros(model.layout.nv, state.q.dtype), jnp.zeros(model.layout.nxi, state.q.dtype)
    return jax.hessian(lambda d: gravity_energy(model, _frames(model, state, d, zero, rest, rest)))(zero)


@jit_unoptimized
def _split(lin: Linearization):
    """Elastic and geometric stiffness of every element, table by table: V'' de de, and the rest of the Hessian, V' d2e."""
    model, state = lin.held, lin.state
    zero, rest = jnp.zeros(model.layout.nv, state.q.dtype), jnp.zeros(model.layout.nxi, state.q.dtype)

    def potentials(d):
        frames = _frames(model, state, d, zero, rest, rest)
        return each_element(model, frames, lambda s, *F: s.potential(*(f.pose() for f in F)))

    n = len(zero)
    elastic = [x.elastic()[:, :n, :n] for x in element_derivatives(configuration_at(Coordinates(model), state.q))]
    return elastic, [k - e for k, e in zip(jax.hessian(potentials)(zero), elastic, strict=True)]
