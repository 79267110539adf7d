"""Equilibrium where force elements act, which have no energy to descend: Newton's method on the
balance of forces, while loads are raised and the imbalance of the start is removed.

    g = [dV/dDelta - Q(Delta, z) - s Q_l; f(Delta, z)],   g = (1 - s) g of the start,
    s from 0 to 1

f are the rates of the states z of force elements at rest. A state that has no influence, or whose
rate at rest is zero whatever the states are, keeps its value. An equilibrium is stable if no pole
of its small motions grows; it flutters where a pair of poles grows, and diverges where a real one
does; of sampled controllers stability is not counted.
"""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float, Int, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Status
from jaxbody.lagrange import force_matrices
from jaxbody.mechanics.constraints import closed
from jaxbody.mechanics.equilibrium_solvers import SINGULAR, SearchResult, search_by_descent
from jaxbody.mechanics.free_motions import (
    closure_stiffness,
    constraint_force,
    curvature,
    dependent_motions,
    free_motions,
    is_closed,
    moved,
)
from jaxbody.mechanics.hessians import configuration_at, expansion, slope
from jaxbody.mechanics.internal_coordinates import whole_matrices
from jaxbody.mechanics.load_paths import (
    CONVERGED,
    FARTHEST,
    ITERATIONS,
    LEAST,
    MOST,
    SHIFT,
    AppliedLoads,
    generalized_force,
    with_load_gravity,
)
from jaxbody.model.element_states import (
    apart,
    force_states,
    relaxed,
    rest_states,
    with_force_states,
)
from jaxbody.model.forces.controllers import sampled_names
from jaxbody.model.joints.frame_tables import at_rest, force_rates, gaps_at
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.models import Model, scale_of, scaled, size_of
from jaxbody.model.states import State
from jaxbody.numerics.eigenproblems import first_order, rows_of_one_size
from jaxbody.numerics.precisions import NEWTON, reachable

GROWS = 1e-9  # relative to the largest pole: larger real parts are not rounding


def holding_forces(coordinates: Coordinates, z: Float[Array, "nf"]) -> Coordinates:
    """Return the coordinates of the model with these states of its force elements."""
    return eqx.tree_at(lambda c: c.model, coordinates, with_force_states(coordinates.model, z))


def balance(
    coordinates: Coordinates, applied: AppliedLoads, q, z, factor: Float[Array, ""] | float = 1.0
) -> tuple[Float[Array, "m"], Float[Array, "m m"]]:
    """Return g at q with the states z, and dg/d(Delta, z)."""
    nv, at = coordinates.model.layout.nv, configuration_at(coordinates, q, base=False)
    _, gradient, K = expansion(with_load_gravity(at, applied, factor))

    def without_potential(x):
        held = holding_forces(coordinates, z + x[nv:])
        here = configuration_at(held, q, base=False)
        Q = generalized_force(here, applied, factor, x[:nv])
        frames = held.at_rest(held.retract(q, x[:nv]))
        g = jnp.concatenate([-Q, force_rates(held.model, at_rest(frames))])
        return g, g

    J, g = jax.jacfwd(without_potential, has_aux=True)(jnp.zeros(nv + len(z), q.dtype))
    return g.at[:nv].add(gradient), J.at[:nv, :nv].add(K)


def on_closures(
    coordinates: Coordinates,
    q: Float[Array, "nq"],
    g: Float[Array, "m"],
    J: Float[Array, "m m"],
    scale: Float[Array, "nv"],
    right: Float[Array, "m"],
) -> tuple[Float[Array, "m"], Float[Array, "m m"]]:
    """Return `right` and the slopes J of g in scaled increments, along the closures; the rows of
    states that keep their values are those of the identity."""
    n = len(scale)
    units = jnp.concatenate([scale, jnp.ones(len(g) - n, g.dtype)])
    held, g = g[:n] * scale, jnp.asarray(right).at[:n].multiply(scale)
    J = jnp.asarray(J).at[:n].multiply(scale[:, None]) * units[None]
    if coordinates.model.closures:
        free = free_motions(coordinates, q, scale)
        bent = scaled(curvature(coordinates, q, free.multipliers(held)), scale)
        P = free.projector
        H = free.stiffness(J[:n, :n] + bent)
        J = jnp.block([[H, P.T @ J[:n, n:]], [J[n:, :n] @ P, J[n:, n:]]])
        g = g.at[:n].set(P.T @ g[:n])
    kept = _kept(J, n)
    return jnp.where(kept, 0.0, g), jnp.where(kept[:, None], jnp.eye(len(J), dtype=J.dtype), J)


def _kept(J: Float[Array, "m m"], n: int) -> Bool[Array, "m"]:
    """Return which rows are those of states without influence or with no rate at rest."""
    none = jnp.all(J == 0, 0) | jnp.all(J == 0, 1)
    return none & (jnp.arange(len(J)) >= n)


def by_newton(
    coordinates: Coordinates, applied: AppliedLoads, q, z, max_steps: Any
) -> tuple[Array, Array, Array, Array, Array]:
    """Return q, z, s and the number of iterations at the end of the path from q and z, and whether
    g is finite at its start."""
    model, dtype = coordinates.model, q.dtype
    size, n, converged = size_of(model), model.layout.nv, reachable(CONVERGED, dtype, NEWTON)
    scale = scale_of(model, size)

    def iterate(carry):
        at, (q, z), first, s, target, length, iteration, paths, steps = carry
        g, J = balance(coordinates, applied, q, z, target)
        first = jnp.where(steps == 0, g, first)
        g = g - (1 - target) * first
        r, J = on_closures(coordinates, q, g, J, scale, g)
        unit = jnp.max(jnp.abs(J[:n, :n]), initial=0.0)
        shift = reachable(SHIFT, dtype, 8) * jnp.where(unit > 0, unit, 1.0)
        moving = jnp.diag((np.arange(len(J)) < n).astype(dtype))
        step = -jnp.linalg.solve(J + shift * moving, r)
        longest = jnp.max(jnp.abs(step[:n]), initial=0.0)
        after = moved(coordinates, q, scale * step[:n]), z + step[n:]
        settled = jnp.max(jnp.abs(step[n:]), initial=0.0) <= 1e-8 * jnp.max(
            jnp.abs(after[1]), initial=1e-6
        )
        good = (longest <= converged * size) & settled
        ended = good | (iteration >= ITERATIONS) | ~(longest <= FARTHEST * size)
        at = jax.tree.map(lambda new, old: jnp.where(good, new, old), after, at)
        s = jnp.where(good, target, s)
        length = jnp.where(ended, jnp.where(good, 2 * length, length / 4), length)
        return (
            at,
            jax.tree.map(lambda a, b: jnp.where(ended, a, b), at, after),
            first,
            s,
            jnp.where(ended, jnp.minimum(1.0, s + length), target),
            length,
            jnp.where(ended, 0, iteration + 1),
            paths + ended.astype(paths.dtype),
            steps + 1,
        )

    def unfinished(carry):
        _, _, _, s, _, length, _, paths, steps = carry
        return (s < 1) & (length > LEAST) & (paths < MOST) & (steps < max_steps)

    # the first iteration, at s = 0, computes g of the start and stays there
    none, zero = jnp.array(0), jnp.zeros((), dtype)
    first = jnp.zeros(n + len(z), dtype)
    begin = (q, z), (q, z), first, zero, zero, zero + 0.5, none, none, none
    (q, z), _, first, s, *_, steps = jax.lax.while_loop(unfinished, iterate, begin)
    return q, z, s, steps, jnp.isfinite(first).all()


def growing_poles(
    coordinates: Coordinates, given: Model, q: Float[Array, "nq"], applied: AppliedLoads
) -> tuple[Int[Array, "2"], Bool[Array, ""]]:
    """Return the number of poles that grow, oscillating and real ones, of small motions about an
    equilibrium, and whether K is singular. `given`: the model as the user gave it."""
    model, layout = given, given.layout
    rest = rest_states(coordinates.model, coordinates.at_rest(q).pose())
    state = State(q, jnp.zeros(layout.nv, q.dtype), rest)
    held = eqx.tree_at(lambda c: c.model, coordinates, apart(model, state.z))
    matrices, _ = whole_matrices(configuration_at(held, state.q))
    parts = force_matrices(model, state, applied.loads)
    M, C, K = (H + part for H, part in zip(matrices, parts, strict=True))
    nv, ny, own = layout.nv, len(layout.inner), np.arange(layout.nv)
    if model.closures:
        own = np.array(model.independent or (), int)
        r = balance(coordinates, applied, q, force_states(coordinates.model))[0][:nv]
        moves = dependent_motions(held, state.q, r, tuple(own.tolist()))
        x = np.r_[:nv, nv + ny : len(K)]
        K = jnp.asarray(K).at[np.ix_(x, x)].add(closure_stiffness(held, state.q, moves.multipliers))
        M, C, K = (moves.of(H, ny) for H in (M, C, K))
    n, m = len(own) + len(layout.inertial), len(own) + ny
    unit = jnp.concatenate([scale_of(model, size_of(model))[own], jnp.ones(ny, K.dtype)])
    M, C, K = (scaled(H[:m, :m], unit) for H in (M, C, K))
    finite = jnp.isfinite(jnp.stack([M, C, K])).all()
    M, C, K = (jnp.where(finite, H, jnp.eye(m, dtype=H.dtype)) for H in (M, C, K))
    s = jnp.linalg.eigvals(first_order(M, C, K, n)[0])
    grows = jnp.real(s) > reachable(GROWS, K.dtype, 256) * jnp.max(jnp.abs(s), initial=0.0)
    oscillates = jnp.abs(jnp.imag(s)) > reachable(GROWS, K.dtype, 256) * jnp.abs(s)
    kept = jnp.concatenate([jnp.zeros(n, bool), _kept(K, n)[n:]])
    rows = jnp.where(kept[:, None], jnp.eye(m, dtype=K.dtype), K)
    values = jnp.linalg.svdvals(rows_of_one_size(rows))
    singular = values[-1] <= reachable(SINGULAR, K.dtype) * values[0]
    return jnp.stack([jnp.sum(grows & oscillates), jnp.sum(grows & ~oscillates)]), singular


def instability(growing: Int[Array, "2"]) -> str:
    """Describe an unstable equilibrium by its numbers of growing poles."""
    kinds = ("flutter: growing oscillations", "divergence: growth without oscillation")
    numbers = np.asarray(growing) // np.array([2, 1])
    return "; ".join(f"{word} ({n})" for word, n in zip(kinds, numbers, strict=True) if n)


def change_of_balance(
    given: Callable[[Any], tuple[Coordinates, AppliedLoads]],
    x: Any,
    x_dot: Any,
    q: Float[Array, "nq"],
    z: Float[Array, "nf"],
) -> tuple[Float[Array, "nv"], Float[Array, "nf"]]:
    """Return the changes of Delta and of z of an equilibrium for a change x_dot of x, where
    given(x) are the coordinates and the applied loads."""
    coordinates, applied = given(x)
    scale = scale_of(coordinates.model, size_of(coordinates.model))
    g, J = balance(coordinates, applied, q, z)
    n, across = len(scale), jnp.zeros(len(scale), q.dtype)

    def change(function):
        return jax.jvp(lambda x: function(*given(x)), (x,), (x_dot,))[1]

    right = change(lambda c, applied: balance(c, applied, q, z)[0])
    if coordinates.model.closures:
        free = free_motions(coordinates, q, scale)
        multipliers = free.multipliers(g[:n] * scale)
        force, gap = change(lambda c, _: (constraint_force(c, q, multipliers), gaps_at(c, q)))
        across = -scale * (free.inverse @ gap)
        bent = curvature(coordinates, q, multipliers) @ across
        right = (right + J[:, :n] @ across).at[:n].add(force + bent)
    right, J = on_closures(coordinates, q, g, J, scale, right)
    step = -jnp.linalg.solve(J, right)
    return across + scale * step[:n], step[n:]


def from_start(
    coordinates: Coordinates,
    start: Float[Array, "nq"] | None,
    applied: AppliedLoads,
    given: Model,
    max_steps: Any,
    *,
    stability: bool = True,
) -> SearchResult:
    """Search from `start`, by default the reference pose. `stability`: whether to count growing
    poles."""
    frozen, applied, given = jax.lax.stop_gradient((coordinates, applied, given))
    start = frozen.reference.q if start is None else jax.lax.stop_gradient(start)
    start = closed(frozen, start) if frozen.model.closures else start
    q, z, s, steps, finite = by_newton(
        frozen, applied, start, force_states(frozen.model), max_steps
    )
    growing, singular = jnp.zeros(2, int), jnp.array(False)
    if stability and frozen.model.layout.nv and not sampled_names(given):
        growing, singular = growing_poles(holding_forces(frozen, z), given, q, applied)
    elements = jnp.isfinite(slope(configuration_at(frozen, start, base=False))).all()
    status = jnp.select(
        [~is_closed(frozen, start), ~finite & elements, s < 1],
        [
            Status.NOT_CLOSED.value,
            Status.NONFINITE_FORCE.value,
            Status.NO_EQUILIBRIUM.value,
        ],
        Status.OK.value,
    )
    return SearchResult(q, jnp.sum(growing), singular, status, steps, s, z=z, growing=growing)


def search_for_balance(
    model: Model, start: Float[Array, "nq"] | None, z: Any, applied: AppliedLoads, max_steps: Any
) -> SearchResult:
    """Search from `start`; if the path from there does not reach its end, or a motion grows there,
    also from where the potential energy is least without force elements.

    These are two programs, because few models need the second."""
    first = _from_start(model, start, z, applied, max_steps)
    settled = (first.status == Status.OK) & (first.negative == 0)
    if is_concrete(settled) and settled:
        return first
    return _from_descent(model, start, z, applied, max_steps, first, settled)


@program
def _from_start(model: Model, start, z, applied: AppliedLoads, max_steps: Any) -> SearchResult:
    return from_start(Coordinates(relaxed(model, z)), start, applied, model, max_steps)


@program
def _from_descent(
    model: Model, start, z, applied, max_steps: Any, first: SearchResult, settled: Bool[Array, ""]
) -> SearchResult:
    coordinates = Coordinates(relaxed(model, z))
    descent = search_by_descent(coordinates, start, jnp.where(settled, 0, max_steps))
    steps = jnp.where(settled | (descent.status != Status.OK), 0, max_steps)
    second = from_start(coordinates, descent.q, applied, model, steps)
    stable = (second.status == Status.OK) & (second.negative == 0)
    better = ~settled & (stable | ((first.status != Status.OK) & (second.status == Status.OK)))
    return jax.tree.map(lambda a, b: jnp.where(better, a, b), second, first)
