"""Searches for an equilibrium: by descent of the potential energy, or along the path of loads that
are raised from zero.

Descent is Newton's method with a shift lambda that makes K + lambda I positive definite, so that
every step lowers the potential energy. Increments are nondimensional, with rotations times a
length. A model with closures is first moved to the nearest configuration that fulfills them, and
stays on them in all steps.
"""

import dataclasses
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float, Int, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Status
from jaxbody.mechanics.constraints import closed
from jaxbody.mechanics.free_motions import is_closed, moved, on_closures
from jaxbody.mechanics.hessians import configuration_at, expansion
from jaxbody.mechanics.load_paths import (
    AppliedLoads,
    Path,
    dead_forces,
    follow_load_path,
    with_load_gravity,
)
from jaxbody.model.element_states import relaxed
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.models import Model, scale_of, scaled, size_of
from jaxbody.numerics.lanes import LANES, in_lanes
from jaxbody.numerics.precisions import NEWTON, reachable
from jaxbody.numerics.small_systems import is_definite, solve_if_definite
from jaxbody.numerics.symmetric_eigenvalues import number_below

# Newton decrement, relative to size and largest stiffness; the remaining error is its square
TOLERANCE = 1e-10
SINGULAR = 1e-12  # eigenvalues of the nondimensional K, relative to its norm, that count as zero
LEAST_SHIFT = 2e-14  # keeps a free motion from making the system singular
TINY = 1e-6  # step, relative to the size, whose decrease of energy may be less than rounding


def descend(
    coordinates: Coordinates, q, scale, size, max_steps, applied: AppliedLoads | None = None
):
    """Return (q, signs of the eigenvalues of K, converged, steps) by Newton's method with a shift
    that makes every step descend, under dead forces."""
    numbers, rest = eqx.partition((coordinates, applied), eqx.is_array)
    if coordinates.model.closures:
        return _descend(coordinates, applied, q, scale, size, max_steps)
    # more lanes share the overhead of a loop; with fewer lanes all of K stays in the cache
    lanes = 2 * LANES if len(scale) <= 6 else LANES
    return in_lanes(
        lambda numbers, *given: _descend(*eqx.combine(numbers, rest), *given), lanes=lanes
    )(numbers, q, scale, size, max_steps)


def _descend(coordinates, applied, q, scale, size, max_steps):
    tolerance, least = reachable(TOLERANCE, q.dtype, NEWTON), reachable(LEAST_SHIFT, q.dtype, 8)
    tiny_step, least_slope = reachable(TINY, q.dtype, 8 * NEWTON), reachable(1e-14, q.dtype)

    def expand(q):
        """Return V, its scaled slope and its scaled stiffness on the closures; V is NaN where the
        closures stay open."""
        at = configuration_at(coordinates, q, base=False)
        value, slope, K = (
            expansion(at)
            if applied is None
            else expansion(with_load_gravity(at, applied), dead_forces(at, applied))
        )
        slope, K = on_closures(coordinates, q, slope * scale, scaled(K, scale), scale)
        return (
            jnp.where(is_closed(coordinates, q), value, jnp.nan)
            if coordinates.model.closures
            else value,
            slope,
            K,
        )

    def step(carry):
        """Evaluate the trial configuration, accept it if it is better, and propose the next one."""
        best, trial, shift, expected, tiny, _, n = carry
        value, slope, K = expand(trial)
        # in a tiny step the decrease of energy may be less than rounding
        falls = (expected > 0) & (best[1] - value >= 1e-4 * expected)
        accept = jnp.isfinite(value) & (falls | tiny | (n == 0))
        best = jax.tree.map(lambda a, b: jnp.where(accept, a, b), (trial, value, slope, K), best)
        shift = jnp.where(
            accept, jnp.where(shift > 1e-3, shift / 10, 0.0), jnp.maximum(4 * shift, 0.1)
        )
        _, _, slope, K = best
        unit = jnp.max(jnp.abs(K), initial=0.0)
        unit = jnp.where(unit > 0, unit, 1.0)
        y, definite = solve_if_definite(
            K + (shift + least) * unit * np.eye(len(scale), dtype=K.dtype), -slope
        )
        longest = jnp.max(jnp.abs(y), initial=0.0)
        y = jnp.where(
            definite, y * jnp.where(longest > size / 2, size / 2 / longest, 1.0), 0.0
        )  # otherwise no step, and a larger shift next
        expected = -jnp.sum(y * slope) - 0.5 * jnp.sum(y * jnp.sum(K * y[None], -1))
        # also at a saddle point, from which Newton steps are zero
        at_rest = jnp.max(jnp.abs(slope), initial=0.0) <= least_slope * unit * size
        near = accept & (jnp.sqrt(jnp.abs(jnp.sum(slope * y)) / unit) <= tolerance * size)
        done = definite & (near | at_rest) & jnp.isfinite(best[1])
        trial = moved(coordinates, best[0], scale * y)
        return best, trial, shift, expected, definite & (longest < tiny_step * size), done, n + 1

    n = len(scale)
    zero = jnp.zeros((), q.dtype)
    start = (
        (q, jnp.full_like(zero, jnp.nan), jnp.zeros(n, q.dtype), jnp.zeros((n, n), q.dtype)),
        q,
        zero,
        zero,
        jnp.array(False),
        jnp.array(n == 0),
        jnp.array(0),
    )

    def active(carry):
        return ~carry[5] & (carry[6] < max_steps)

    best, trial, _, _, _, done, steps = jax.lax.while_loop(active, step, start)
    return jnp.where(done, trial, best[0]), eigenvalue_signs(best[3]), done, steps


def eigenvalue_signs(
    K: Float[Array, "nv nv"], singular: float = SINGULAR
) -> tuple[Int[Array, ""], Bool[Array, ""]]:
    """Return the number of negative eigenvalues of K, and whether one is zero, below `singular`
    relative to its norm. They are counted only where elimination shows that K is not definite."""
    none = jnp.zeros((), int), jnp.array(False)
    if not len(K):  # nothing can move
        return none
    zero = reachable(singular, K.dtype) * jnp.sqrt(jnp.sum(K * K)) + jnp.finfo(K.dtype).tiny

    def counted():
        below = number_below(K, zero * np.array([-1.0, 1.0], K.dtype))
        return below[0], below[1] > below[0]

    definite = is_definite(K - zero * np.eye(len(K), dtype=K.dtype))
    return jax.lax.cond(~definite, counted, lambda: none)


# distance from the start, in sizes of the model, beyond which the energy is assumed to have no
# minimum, as of a model that falls
RUNAWAY = 20
AT_REST = (Status.OK, Status.TABLE_RANGE)  # stable and isolated: a motion may start there
LOADABLE = (*AT_REST, Status.SINGULAR_K)  # loads may be raised from there
# least ratio of the smallest to the largest eigenvalue of K at the start of a path; with cubic
# springs alone a search ends at a ratio of 1e-9
SOFTEST = 1e-7
# error of K, relative to its norm, at the end of a path, where it is K of the last iterate
ITERATED = 1e-10


class SearchResult(eqx.Module):
    """The end of a search: the configuration, the number of negative eigenvalues of K, whether one
    is zero, and the status before stability is considered."""

    q: Float[Array, "nq"]
    negative: Int[Array, ""]
    singular: Bool[Array, ""]
    status: Int[Array, ""]
    steps: Int[Array, ""]
    factor: Float[Array, ""]
    path: Path | None = None
    descended: Any = False
    # with force elements: their states, and the number of growing oscillations and of real poles
    z: Float[Array, "nf"] | None = None
    growing: Int[Array, "2"] | None = None


def search_by_descent(
    coordinates: Coordinates,
    start: Float[Array, "nq"] | None,
    max_steps,
    applied: AppliedLoads | None = None,
) -> SearchResult:
    """Search by descent from `start`, by default the reference pose."""
    frozen, applied = jax.lax.stop_gradient((coordinates, applied))
    start = frozen.reference.q if start is None else jax.lax.stop_gradient(start)
    size = size_of(frozen.model)
    if frozen.model.closures:
        start = closed(frozen, start)
    q, (negative, singular), converged, steps = descend(
        frozen, start, scale_of(frozen.model, size), size, max_steps, applied
    )
    moved = jnp.max(
        jnp.abs(q - start) * jnp.where(frozen.model.layout.angular, size, 1.0), initial=0.0
    )
    runaway = ~converged & (moved > RUNAWAY * size)
    status = jnp.select(
        [runaway, ~converged],
        [Status.NO_EQUILIBRIUM.value, Status.NOT_CONVERGED.value],
        Status.OK.value,
    )
    if frozen.model.closures:
        status = jnp.where(is_closed(frozen, start), status, Status.NOT_CLOSED.value)
    return SearchResult(q, negative, singular, status, steps, jnp.ones((), q.dtype))


def search_under_loads(
    model: Model, unloaded: Any, start, applied: AppliedLoads, max_steps: int, *, many: bool = False
) -> SearchResult:
    """Search under loads, along their path or by descent; `many`: for each row of the weights and
    of the changes of gravity.

    The path and the descent are two programs, because few models need the descent. Inside a user's
    program both are part of it, and the descent takes no steps where the path has a valid
    result."""
    search, settled = along_path(model, unloaded, applied, many)
    if is_concrete(settled) and np.asarray(settled).all():
        return search
    return _by_descent(model, start, applied, max_steps, many, search, settled, unloaded.state.z)


@program
def along_path(
    model: Model, unloaded: Any, applied: AppliedLoads, many: bool
) -> tuple[SearchResult, Bool[Array, "*n"]]:
    """Search along the load path from the unloaded equilibrium, and return the result with whether
    it is valid: it is not if K is singular at the start, unless the path reached its end or a limit
    point."""
    frozen, loads, q0 = jax.lax.stop_gradient(
        (Coordinates(relaxed(model, unloaded.state.z)), applied, unloaded.state.q)
    )
    size = size_of(frozen.model)
    usable = jnp.isin(unloaded.status, jnp.array(LOADABLE))

    def one(applied, _):
        q, K, factor, path, ahead = follow_load_path(
            frozen, q0, applied, scale_of(frozen.model, size), size
        )
        status = jnp.where(
            factor >= 1,
            Status.OK.value,
            jnp.where(ahead, Status.LIMIT_POINT.value, Status.NO_EQUILIBRIUM.value),
        )
        negative, singular = eigenvalue_signs((K + K.T) / 2, ITERATED)
        search = SearchResult(
            q, negative, singular, status, unloaded.steps, factor, path, jnp.array(False)
        )
        return search, usable & (
            (factor >= 1)
            | (ahead & (factor > 0))
            | (path.smallest[0] > reachable(SOFTEST, q0.dtype))
        )

    starts = jnp.zeros(len(applied.gravity))
    return loads.each(one, starts) if many else one(loads, starts)


@program
def _by_descent(
    model: Model,
    start,
    applied: AppliedLoads,
    max_steps: int,
    many: bool,
    search: SearchResult,
    settled: Bool[Array, "*n"],
    z,
) -> SearchResult:
    """Search by descent of the potential of model and loads where the result of the path is not
    valid."""
    coordinates = Coordinates(relaxed(model, z))

    def one(applied, others):
        on_path, settled = others
        descent = search_by_descent(coordinates, start, jnp.where(settled, 0, max_steps), applied)
        dead = jnp.isfinite(
            dead_forces(configuration_at(coordinates, descent.q, base=False), applied).V
        )
        status = jnp.where(dead, descent.status, Status.NO_EQUILIBRIUM.value)
        ok = status == Status.OK
        descent = dataclasses.replace(
            descent,
            status=status,
            factor=jnp.where(ok, descent.factor, 0.0),
            path=on_path.path,
            descended=jnp.array(True),
        )
        return jax.tree.map(
            lambda a, b: jnp.where(settled | (~ok & (on_path.factor > 0)), a, b), on_path, descent
        )

    frozen, ends = jax.lax.stop_gradient(applied), (search, settled)
    return frozen.each(one, ends) if many else one(frozen, ends)
