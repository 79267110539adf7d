"""Descent: Newton's method in which every step lowers the potential energy; lambda makes K + lambda
I positive definite.

It works on nondimensional increments, rotations times a length.
"""

from __future__ import annotations

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Bool, Float, Int
from jaxbody.mechanics.free_motions import is_closed, moved, on_closures
from jaxbody.mechanics.hessians import configuration_at, expansion
from jaxbody.mechanics.load_paths import AppliedLoads, dead_forces, with_load_gravity
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.sizes import scaled
from jaxbody.numerics.lanes import LANES, in_lanes
from jaxbody.numerics.precisions import NEWTON, reachable
from jaxbody.numerics.small_systems import is_definite, solve_if_definite
from jaxbody.numerics.symmetric_eigenvalues import number_below
from jaxbody.numerics.xla_workarounds import any_of_batch

# Newton decrement, relative to size and largest stiffness; the remaining error is its square
TOLERANCE = 1e-10
SINGULAR = 1e-12  # eigenvalues of the nondimensional K, relative to its norm, that count as zero
LEAST_SHIFT = 2e-14  # keeps a free motion from making the system singular
TINY = 1e-6  # step, relative to the size, whose decrease of energy may be less than rounding


def descend(
    coordinates: Coordinates, q, scale, size, max_steps, applied: AppliedLoads | None = None
):
    """(q, signs of K, converged, steps) by Newton's method with a shift that makes every step
    descend, under dead forces."""
    numbers, rest = eqx.partition((coordinates, applied), eqx.is_array)
    if coordinates.model.closures:
        return _descend(coordinates, applied, q, scale, size, max_steps)
    # more share the overhead of a loop, with fewer all of K stays in the cache
    lanes = 2 * LANES if len(scale) <= 6 else LANES
    return in_lanes(
        lambda numbers, *given: _descend(*eqx.combine(numbers, rest), *given), lanes=lanes
    )(numbers, q, scale, size, max_steps)


def _descend(coordinates, applied, q, scale, size, max_steps):
    tolerance, least = reachable(TOLERANCE, q.dtype, NEWTON), reachable(LEAST_SHIFT, q.dtype, 8)
    tiny_step, least_slope = reachable(TINY, q.dtype, 8 * NEWTON), reachable(1e-14, q.dtype)

    def expand(q):
        """V, and its scaled slope and stiffness, on the closures; no energy where these
        stay open."""
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
        """Evaluate the trial configuration, keep it if it is better, propose the next."""
        best, trial, shift, expected, tiny, _, n = carry
        value, slope, K = expand(trial)
        # below `tiny` rounding of the energy hides its decrease
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
        # also on a saddle, which no Newton step leaves
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

    def masked(carry):
        return jax.tree.map(lambda new, old: jnp.where(active(carry), new, old), step(carry), carry)

    best, trial, _, _, _, done, steps = jax.lax.while_loop(
        lambda carry: any_of_batch(active(carry)), masked, start
    )
    return jnp.where(done, trial, best[0]), eigenvalue_signs(best[3]), done, steps


def eigenvalue_signs(
    K: Float[Array, "nv nv"], singular: float = SINGULAR
) -> tuple[Int[Array, ""], Bool[Array, ""]]:
    """The number of negative eigenvalues of K, and whether one is zero, below `singular` of its
    norm; they are counted only where elimination shows that K is not definite."""
    none = jnp.zeros((), int), jnp.array(False)
    if not len(K):  # nothing can move
        return none
    zero = reachable(singular, K.dtype) * jnp.sqrt(jnp.sum(K * K)) + jnp.finfo(K.dtype).tiny

    def counted():
        negative, not_positive = number_below(K, zero * np.array([-1.0, 1.0], K.dtype))
        return negative, not_positive > negative

    definite = is_definite(K - zero * np.eye(len(K), dtype=K.dtype))
    return jax.lax.cond(any_of_batch(~definite), counted, lambda: none)
