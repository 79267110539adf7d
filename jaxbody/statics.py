"""Equilibrium: the configuration of least potential energy near the start, its stability, and its derivatives by the implicit
function theorem.

    dV/dDelta = 0,    dq/dp = -K^-1 d2V/dDelta dp

The search is Newton's method made to descend: K + lambda I with lambda raised until it is positive definite and the energy falls, so it does
not stop at maxima. It works on nondimensional increments, rotations times the length `size_of(model)`. Loads, which may have no
potential, are then raised step by step (load_paths).
"""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxbody import tables
from jaxbody.checks import check_attached, check_precision, check_state
from jaxbody.derivatives import expansion, placed, stiffness
from jaxbody.errors import Status, is_concrete
from jaxbody.kinematics import Coordinates
from jaxbody.lane_marks import any_of_batch
from jaxbody.lanes import LANES, in_lanes
from jaxbody.laws import has_range
from jaxbody.linear_solves import is_definite, solve_if_definite
from jaxbody.load_paths import Path, Raised, follow, residual, tangent, under, with_gravity
from jaxbody.loads import Load, loads_of
from jaxbody.mechanics import beyond_laws, each_element, potential
from jaxbody.models import Layout, Model, State
from jaxbody.naming import by_name
from jaxbody.options import jit_as_it_is
from jaxbody.results import Result, warn_if_failed

TOLERANCE = 1e-10  # Newton decrement, relative to size and largest stiffness; the error left is its square
SINGULAR = 1e-10  # eigenvalues of the nondimensional K, relative to the largest, that count as zero
RUNAWAY = 20  # sizes of the model from the start, beyond which a search is falling
LEAST_SHIFT = 1e-11  # keeps a free motion from making the system singular


class Equilibrium(Result):
    """A configuration of rest: `state`, `residual` dV/dDelta - Q [N, N m], `energy` V [J], `stable`, `negative` (how many eigenvalues
    of K are), `steps`, `elongations` by name; `status` NOT_CONVERGED, UNSTABLE, SINGULAR_K, TABLE_RANGE, NO_EQUILIBRIUM or LIMIT_POINT where it is not
    good. Under loads, `load_factor` is how much of them is borne, and `path` how K changed on the way."""

    state: State
    residual: Float[Array, "nv"]
    energy: Float[Array, ""]
    negative: Int[Array, ""]
    stable: Bool[Array, ""]
    status: Int[Array, ""]
    steps: Int[Array, ""]
    deformations: tuple[Array, ...]
    model: Model
    loads: tuple[Load, ...]
    load_factor: Float[Array, ""]
    path: Path | None

    @property
    def elongations(self) -> dict[str, Array]:
        """Of each spring the elongation [m], tension positive; of a bushing its six deformations."""
        return by_name(tuple(table.names for table in self.model.elements), self.deformations)

    @property
    def layout(self) -> Layout:
        return self.model.layout

    def explain(self) -> str:
        status = Status(int(self.status))
        if status == Status.SINGULAR_K:
            return "; ".join(zero_modes(self.model, self.state))
        if status == Status.UNSTABLE:
            return f"{int(self.negative)} negative eigenvalue(s) of K; start from a state moved along that mode to descend"
        if status == Status.TABLE_RANGE:
            return "; ".join(
                f"'{name}'" for name, out in zip(self.model.element_names, _beyond(self.model, self.state), strict=True) if out
            )
        if status in (Status.NO_EQUILIBRIUM, Status.LIMIT_POINT):
            return self._how_much()
        if status == Status.NOT_CONVERGED:
            worst = int(np.argmax(np.abs(np.asarray(self.residual)))) if np.isfinite(np.asarray(self.residual)).all() else 0
            unit = "N m" if self.layout.turns[worst] else "N"
            return (
                f"after {int(self.steps)} steps the largest residual is {float(np.abs(self.residual[worst])):.3g} {unit} "
                f"in '{self.layout.motions[worst][0]}' ({self.layout.motions[worst][1]}); start nearer, or give more max_steps"
            )
        return ""

    def _how_much(self) -> str:
        """How much of the loads, or of the weights, is borne."""
        if self.path is not None:
            smallest = np.asarray(self.path.smallest)
            last = smallest[np.isfinite(smallest)][-1]
            borne = f"load factor {float(self.load_factor):.4g} of 1, where the state is; the smallest eigenvalue of K, relative to the largest without loads, went "
            return borne + f"from {smallest[0]:.3g} to {last:.3g} (plots.load_path draws it)"
        weightless = with_gravity(self.model, -self.model.gravity)
        start = equilibrium_of(weightless, None, (), 200)
        if int(start.status) not in (Status.OK, Status.SINGULAR_K):
            return "nor is there one without the weights"
        found = under_loads(weightless, start, Raised((), jnp.zeros(0), self.model.gravity))
        return f"{100 * float(found.load_factor):.4g} % of the weights is borne"

    def to_xarray(self) -> Any:
        """An xarray.Dataset: q by part, residual by coordinate, elongation by spring, energy, status."""
        from jaxbody.exports import equilibrium_dataset

        return equilibrium_dataset(self)

    def _tables(self) -> list[tables.Table]:
        q, layout = tables.without_dust(self.state.q), self.layout
        rows = [
            (name, kind.__name__.lower(), q[..., layout.q_slices[name]]) for name, kind in zip(layout.bodies, layout.kinds, strict=True)
        ]
        note = self.report() if is_concrete(self.status) else ""
        note += ", a local one" if note == "ok" else ""
        elements = [(name, tables.without_dust(e)) for name, e in self.elongations.items()]
        largest = np.abs(self.residual).max() if is_concrete(self.residual) and self.residual.size else None
        return [
            tables.Table("Equilibrium", ("body", "joint", "q [m, rad, -]"), rows),
            tables.Table("", ("element", "elongation [m]"), elements, f"largest residual {tables.number(largest)} N or N m; {note}"),
        ]


def equilibrium(model: Model, *, start: State | None = None, loads: dict[str, Load] | None = None, max_steps: int = 200) -> Equilibrium:
    """The stable configuration of rest that descent from `start` (without it, the reference pose) leads to, supports at their reference poses.

    dV/dDelta = 0 with positive definite K = d2V/dDelta2. `loads` {name: load}, as at time 0, are then raised from nothing along the stable
    branch: dV/dDelta = Q. Differentiable with respect to the model in forward and reverse mode, to
    any order; the derivative of a search that failed, or through a singular K, is NaN. Errors: UNATTACHED, BAD_SHAPE, UNKNOWN_BODY of a load; warns by status.
    Source: (63) of the paper.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, gravity=[0, -9.81, 0], joints={"mass": Guide("world", axis=[0, 1, 0])},
    ...               elements={"s": Spring(("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=981.0, free_length=1.0)})
    >>> round(float(equilibrium(model).elongations["s"]), 12)
    0.02
    """
    check_precision("equilibrium", model)
    check_attached(model)
    if start is not None:
        check_state(model, start, "start")
    result = equilibrium_of(model, None if start is None else start.q, loads_of(loads, model.layout.bodies), max_steps)
    warn_if_failed(result)
    return result


@jit_as_it_is
def equilibrium_of(model: Model, start: Float[Array, "nq"] | None, loads: tuple[Load, ...], max_steps: int) -> Equilibrium:
    """The jitted core of `equilibrium`."""
    coordinates = Coordinates(model)
    frozen = jax.lax.stop_gradient(coordinates)
    start = frozen.reference.q if start is None else jax.lax.stop_gradient(start)
    size = size_of(frozen.model)
    q, signs_of_K, converged, steps = descend(frozen, start, scale_of(frozen.model, size), size, max_steps)
    moved = jnp.max(jnp.abs(q - start) * jnp.where(model.layout.angular, size, 1.0), initial=0.0)
    runaway = ~converged & (moved > RUNAWAY * size)
    status = jnp.select([runaway, ~converged], [Status.NO_EQUILIBRIUM.value, Status.NOT_CONVERGED.value], Status.OK.value)
    eq = judged_at(coordinates, q, signs_of_K, status, steps, unloaded(q.dtype), None, jnp.ones((), q.dtype))
    return eq if not loads else under_loads(model, eq, Raised(loads, jnp.ones(len(loads), q.dtype), jnp.zeros(3, q.dtype)))


@jit_as_it_is
def under_loads(model: Model, start: Equilibrium, raised: Raised) -> Equilibrium:
    """The equilibrium that the path of the loads from an unloaded one leads to."""
    coordinates = Coordinates(model)
    frozen, still = jax.lax.stop_gradient((coordinates, raised))
    size = size_of(frozen.model)
    scale = scale_of(frozen.model, size)
    q, K, factor, path, ahead = follow(frozen, jax.lax.stop_gradient(start.state.q), still, scale, size)
    borne = jnp.where(factor >= 1, Status.OK.value, jnp.where(ahead, Status.LIMIT_POINT.value, Status.NO_EQUILIBRIUM.value))
    fit = jnp.isin(start.status, jnp.array([Status.OK.value, Status.SINGULAR_K.value, Status.TABLE_RANGE.value]))
    return judged_at(coordinates, q, signs((K + K.T) / 2), jnp.where(fit, borne, start.status), start.steps, raised, path, factor)


def judged_at(coordinates: Coordinates, q, signs_of_K, status, steps, raised: Raised, path: Path | None, factor) -> Equilibrium:
    """What stands at q, where the nondimensional K has these signs: its stability, its derivative, what the springs do."""
    negative, singular = signs_of_K
    failed = status != Status.OK
    q = _implicit((coordinates, raised), q, ~failed & ~singular)
    model, at = coordinates.model, placed(coordinates, q, base=False)
    zero, frames = jnp.zeros(model.layout.nv, q.dtype), at.frames
    beyond = jnp.any(beyond_laws(model, frames)) if has_range(model.elements) else jnp.array(False)
    status = jnp.select(
        [failed, negative > 0, singular, beyond], [status, Status.UNSTABLE.value, Status.SINGULAR_K.value, Status.TABLE_RANGE.value], Status.OK.value
    )  # fmt: skip
    return Equilibrium(
        State(q, zero), residual(at, raised, factor), potential(under(at, raised, factor).model, frames), negative,
        ~failed & (negative == 0), status, steps, tuple(each_element(model, frames, lambda s, *F: s.deformation(*(f.pose() for f in F)))), model,
        raised.loads, factor, path,
    )  # fmt: skip


def signs(K: Float[Array, "nv nv"]) -> tuple[Int[Array, ""], Bool[Array, ""]]:
    """How many eigenvalues of K are negative, and whether one is zero; eigenvalues are asked for only where elimination finds K not definite."""

    def by_eigenvalues():
        values = jnp.linalg.eigvalsh(K)
        tolerance = SINGULAR * jnp.max(jnp.abs(values), initial=0.0)
        return jnp.sum(values < -tolerance), jnp.any(jnp.abs(values) <= tolerance)

    largest = jnp.sqrt(jnp.sum(K * K))  # or more
    definite = is_definite(K - SINGULAR * largest * np.eye(len(K), dtype=K.dtype))
    return jax.lax.cond(any_of_batch(~definite), by_eigenvalues, lambda: (jnp.zeros((), int), jnp.array(False)))


def unloaded(dtype) -> Raised:
    """Nothing to raise."""
    return Raised((), jnp.zeros(0, dtype), jnp.zeros(3, dtype))


def apart(model: Model, one: Float[Array, "nq"], other: Float[Array, "nq"]) -> Float[Array, ""]:
    """The farthest that a body is between two configurations [m], turns times the size of the model."""
    both = jax.vmap(Coordinates(model).at_rest)(jnp.stack([one, other]))
    moved, turned = (jnp.sqrt(jnp.sum((x[0] - x[1]) ** 2, axes)) for x, axes in ((both.p, -1), (both.R, (-2, -1))))
    return jnp.max(jnp.maximum(moved, size_of(model) * turned))


@jit_as_it_is
def _beyond(model: Model, state: State) -> Bool[Array, "ne"]:
    return beyond_laws(model, Coordinates(model).at_rest(state.q, state.v))


def size_of(model: Model) -> Float[Array, ""]:
    """A length of the model: the farthest that an element is attached, or a centre of mass lies, from a body's origin; else the longest
    distance from the world's origin; else 1 m."""
    on_bodies, anywhere = [jnp.zeros((1, 3), model.gravity.dtype), model.bodies.rows.com], [model.bodies.rows.position]
    for table in model.elements:
        for end, points in enumerate(table.rows.points):
            on_body = np.array([link[end] in model.layout.bodies for link in table.links])
            on_bodies.append(jnp.where(on_body[:, None], points, 0.0))
            anywhere.append(points)
    near, far = (jnp.max(jnp.linalg.norm(jnp.concatenate(points), axis=-1)) for points in (on_bodies, anywhere))
    return jnp.where(near > 0, near, jnp.where(far > 0, far, 1.0))


def scale_of(model: Model, size: Float[Array, ""]) -> Float[Array, "nv"]:
    """Delta per nondimensional increment: 1 for translations, 1/size for rotations (both in meters then)."""
    return jnp.where(model.layout.turns, 1 / size, 1.0)


def descend(coordinates: Coordinates, q, scale, size, max_steps):
    """(q, signs of K, converged, steps) by Newton's method with a shift that makes every step go down."""
    numbers, rest = eqx.partition(coordinates, eqx.is_array)
    lanes = 2 * LANES if len(scale) <= 6 else LANES  # more share the calls of a loop, fewer keep all of K near the processor
    return in_lanes(lambda numbers, *given: _descend(eqx.combine(numbers, rest), *given), lanes=lanes)(numbers, q, scale, size, max_steps)


def _descend(coordinates, q, scale, size, max_steps):

    def step(carry):
        """Judge the configuration tried, keep the better one, try the next."""
        best, tried, shift, expected, tiny, _, n = carry
        value, slope, K = expansion(placed(coordinates, tried, base=False))
        # below `tiny` the energy's rounding hides its fall
        falls = (expected > 0) & (best[1] - value >= 1e-4 * expected)
        accept = jnp.isfinite(value) & (falls | tiny | (n == 0))
        best = jax.tree.map(lambda a, b: jnp.where(accept, a, b), (tried, value, slope * scale, K * scale * scale[:, None]), best)
        shift = jnp.where(accept, jnp.where(shift > 1e-3, shift / 10, 0.0), jnp.maximum(4 * shift, 0.1))
        _, _, slope, K = best
        unit = jnp.max(jnp.abs(K), initial=0.0)
        unit = jnp.where(unit > 0, unit, 1.0)
        y, definite = solve_if_definite(K + (shift + LEAST_SHIFT) * unit * np.eye(len(scale), dtype=K.dtype), -slope)
        longest = jnp.max(jnp.abs(y), initial=0.0)
        y = jnp.where(definite, y * jnp.where(longest > size / 2, size / 2 / longest, 1.0), 0.0)  # else no step, and a larger shift next
        expected = -jnp.sum(y * slope) - 0.5 * jnp.sum(y * jnp.sum(K * y, -1))
        at_rest = jnp.max(jnp.abs(slope), initial=0.0) <= 1e-14 * unit * size  # on a saddle too, where no step is worth anything
        near = accept & (jnp.sqrt(jnp.abs(jnp.sum(slope * y)) / unit) <= TOLERANCE * size)
        done = definite & (near | at_rest)
        tried = coordinates.retract(best[0], scale * y)
        return best, tried, shift, expected, definite & (longest < 1e-6 * size), done, n + 1

    n = len(scale)
    zero = jnp.zeros((), q.dtype)
    start = ((q, zero, jnp.zeros(n, q.dtype), jnp.zeros((n, n), q.dtype)), q, zero, zero, jnp.array(False), jnp.array(n == 0), jnp.array(0))

    def active(carry):
        return ~carry[5] & (carry[6] < max_steps)

    def masked(carry):
        return jax.tree.map(lambda new, old: jnp.where(active(carry), new, old), step(carry), carry)

    best, tried, _, _, _, done, steps = jax.lax.while_loop(lambda carry: any_of_batch(active(carry)), masked, start)
    return jnp.where(done, tried, best[0]), signs(best[3]), done, steps


@jax.custom_jvp
def _implicit(given: tuple[Coordinates, Raised], q: Float[Array, "nq"], valid: Bool[Array, ""]) -> Float[Array, "nq"]:
    """q, with the derivative that an equilibrium has; NaN where there is none."""
    return q


@_implicit.defjvp
def _implicit_jvp(primals, tangents):
    (coordinates, raised), _, valid = primals
    q = _implicit(*primals)

    def unbalanced(given):
        return residual(placed(given[0], q, base=False), given[1])

    _, change = jax.jvp(unbalanced, (primals[0],), (tangents[0],))
    K = tangent(placed(coordinates, q, base=False), raised)
    delta = -jnp.linalg.solve(jnp.where(valid, K, jnp.nan), change)
    return q, coordinates.rate(q, delta)


@jit_as_it_is
def _stiffness(model: Model, q: Float[Array, "nq"]) -> Float[Array, "nv nv"]:
    return stiffness(placed(Coordinates(model), q, base=False))


def zero_modes(model: Model, state: State) -> list[str]:
    """The motions that K does not resist at a state, in words: "'plate' free to turn about z"; those of single coordinates first."""
    layout = model.layout
    scale = np.asarray(scale_of(model, size_of(model)))
    K = np.asarray(_stiffness(model, state.q))
    values, vectors = np.linalg.eigh(K * scale * scale[:, None])
    null = vectors[:, np.abs(values) <= SINGULAR * max(np.abs(values).max(initial=0.0), 1e-300)]
    words, left = [], null
    for i, (body, motion) in enumerate(layout.motions):
        unit = np.eye(layout.nv)[i]
        if np.linalg.norm(unit - null @ (null.T @ unit)) < 1e-5:
            words.append(f"'{body}' free to {motion}")
            left = left - np.outer(unit, unit @ left)
    u, s, _ = np.linalg.svd(left, full_matrices=False)
    for vector in u.T[s > 1e-3]:
        largest = [int(i) for i in np.argsort(-np.abs(vector)) if abs(vector[i]) > 0.1][:4]
        parts = [f"{np.sign(vector[largest[0]]) * vector[i]:+.2f} ('{layout.motions[i][0]}' {layout.motions[i][1]})" for i in largest]
        words.append("free to move together: " + " ".join(parts))
    return words
