"""Workarounds for slow code of XLA on a CPU: small functions, and a list of all workarounds in the
package with the gain of each.

Gains are times, or where no unit is given ratios to the time of a C program, for tasks T1 (a
motion), T2 (its gradient), T3 (1000 motions) and T4 (10000 equilibria with modes) of one body on
five springs or, where stated, of three bodies, with jaxlib 0.10.2 unless another version is stated;
tests/benchmarks/README.md describes the measurements. Brackets hold the plain form: to find whether
a workaround is still needed, replace it by the plain form, run tests/benchmarks/run.py, and keep
the plain form where nothing is lost.

In this file
    plain_sum, sum_p [reduce_sum]     large sums are library calls, which keep a loop from being
                                      compiled whole: T3 18 to 11
    any_of_batch [jnp.any]            members of a batch share their counts of steps and sweeps: T4
                                      2.1 to 1.75
    sums [zeros.at[rows].add]         gather and scatter break a loop: T4 of three bodies 4.6 to
                                      3.6, T1 of them 0.75 to 0.55
    carried [the carry itself]        tracing residuals and Jacobian of a fit: operations staged
                                      19900 to 13900
geometry/vectors.py
    dot, rotate, product [@]          a matrix product in a loop is not fused: see the table below
numerics/elementary_functions.py
    sincos [jnp.sin, jnp.cos]         the C library computes one number after another: T1 1.75 to
                                      1.57, T3 28 to 18
numerics/small_systems.py
    solve_if_definite [cho_solve]     calls of LAPACK keep a loop from being compiled whole: T4 167
                                      to 119 ms, with the next
    is_definite [cholesky]            the same
    solve [jnp.linalg.solve]          the same
numerics/symmetric_eigenvalues.py
    number_below [eigvalsh]           the same
    eigenvalues [jnp.linalg.eigvalsh] LAPACK solves one matrix after another: T4 1.3 to 1.0, of
                                      three bodies 2.6 to 1.9
numerics/lanes.py
    in_lanes [jax.vmap]               members last, as vectors of three leave registers empty: K of
                                      10000 designs 27 to 3.4 ms
    LANES = 32 [64]                   fusions beyond a cost are split between threads: T3 15 to 10
numerics/eigenproblems.py
    SWEPT = 128 [32]                  short loops take longer to call than to run: eigenvalues of T4
                                      63 to 40 ms
numerics/step_blocks.py
    LANES = 40 [32]                   loops over 32 or fewer are unrolled before they become vector
                                      instructions
numerics/runge_kutta_steps.py
    _sum [jnp.tensordot]              a sum over stages is not a vector instruction: with drives of
                                      all stages at once T3 49 to 31
model/elements/second_derivatives.py
    Block [6 x 6 matrices]            sums of parts instead of matrices: jaxlib 0.12, T4 41 to 25 ms
    whole [jnp.block]                 joined parts are copied one number after another: 53 to 25 ms
mechanics/equilibrium_solvers.py
    2 * LANES [LANES]                 for up to six coordinates calls of fusions take longer than
                                      memory: equilibria of T4 72 to 48 ms
vibration/damped_modes.py
    _complex_modes                    LAPACK may run forever on NaN
vibration/control/regulators.py
    poles_of                          the same
vibration/dynamic_matrices.py
    _eliminated [lu_solve]            LAPACK solves one frequency after another
model/inputs/motions.py
    Harmonic [a sine for each row]    one sine and cosine where frequencies are equal: T3 31 to 28
core/compilation/compile_options.py
    OPTIMIZED                         compiling a motion 1.3 to 0.7 s; jaxlib 0.12 has no such
                                      option
    QUICK                             first frequencies 3.9 to 2.4 s
core/workers/chunk_programs.py
    one_at_a_time                     two programs with LAPACK in one process may wait for each
                                      other forever, jaxlib 0.10
core/workers/executors.py
    processes                         the same, for executors of threads

A workaround replaced by the plain form, over today's form, jaxlib 0.12, 2026-11-29, one body;
differences below a tenth are scatter:

                   T1    T2    T3    T4                         T1    T2    T3    T4
    reduce_sum     1     1     1     1.7    @ for sums          2.1   2     2.8   1.9
    eigvalsh       1.3   1.3   1     2      zeros.at.add        4     2.5   2.6   2.1
    LANES = 32     1     1     1.1   1      jnp.sin, jnp.cos    1.4   1.1   1     1

In the plain form since then: x[rows], x.at[rows].set, lax.rsqrt, jnp.max, and numbers that several
fusions compute again. Together this changed T1 to T4 by the ratios 1.1, 1.26, 1.23 and 1.1, and for
three bodies by 1.1, 1.05, 1 and 1.23.
"""

import functools
from collections.abc import Callable

import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxbody.core.arrays import Array, Bool, Float
from jaxbody.core.jax_internals import new_operation, shaped, with_tangent

FEW_RUNS = 64  # most slices in a sum; compiling more would cost more than running a gather

# Operations of batches in lanes

# True for all members of a batch if it is True for any; a loop with this as its condition needs no
# masks on its carried values.
_any_p = new_operation(
    "any_of_batch",
    lambda x: x,
    batch=lambda args, axes: (_any_p.bind(jnp.any(args[0], axes[0])), None),
    typed=lambda x: x,
)
any_of_batch: Callable[[Bool[Array, "*n"]], Bool[Array, "*n"]] = _any_p.bind


# A reducer that XLA does not recognize: it passes large reductions to a library, whose calls keep a
# loop from being compiled whole. It must still be a sum, as XLA merges sums of sums.
def plain_sum(x: Array, axes: tuple) -> Array:
    """Return the sum over axes, compiled without a call to an external library."""
    return lax.reduce(x, np.zeros((), x.dtype), lambda a, b: -(-a - b), axes)


def _spread_back(cotangent, x, axes):
    return [
        lax.broadcast_in_dim(
            cotangent, x.aval.shape, [i for i in range(x.aval.ndim) if i not in axes]
        )
    ]


def _batched_sum(args, batched, axes):
    return sum_p.bind(jnp.moveaxis(args[0], batched[0], -1), axes=axes), args[0].ndim - 1 - len(
        axes
    )


def _summed(x, axes):
    return shaped(tuple(n for i, n in enumerate(x.shape) if i not in axes), x.dtype)


sum_p = new_operation(
    "sum_in_lanes", plain_sum, typed=_summed, batch=_batched_sum, transpose=_spread_back
)


# Loops and rows


# A function of (carry, known) that returns the carry with which a loop starts, with a derivative as
# soon as the arrays `known`, which the loop uses, have one. JAX would otherwise trace the
# derivative of the loop's body once more, and again for each loop around it, to find that the carry
# has a derivative.
carried = with_tangent(lambda change, carry, known: change)


def sums(x: Float[Array, "m k"], groups: list[list[int]]) -> Float[Array, "n k"]:
    """Return the sum of the rows of each group: over slices where groups are a few runs of
    consecutive rows, else by a padded gather."""
    if all(len(rows) == 1 for rows in groups):
        return x[np.concatenate(groups)]
    # of consecutive rows
    runs = [
        np.split(rows, np.flatnonzero(np.diff(rows) != 1) + 1) if len(rows) else []
        for rows in groups
    ]
    if sum(map(len, runs)) <= FEW_RUNS:
        return lax.concatenate([_sum_of_runs(x, group) for group in runs], 0)
    most = max(len(rows) for rows in groups)
    padded = np.array([rows + [len(x)] * (most - len(rows)) for rows in groups])
    return jnp.sum(jnp.concatenate([x, jnp.zeros((1, x.shape[1]), x.dtype)])[padded], 1)


def _sum_of_runs(x: Float[Array, "m k"], runs: list[np.ndarray]) -> Float[Array, "1 k"]:
    parts = [
        _slice(x, rows) if len(rows) == 1 else jnp.sum(_slice(x, rows), 0, keepdims=True)
        for rows in runs
    ]
    return functools.reduce(lax.add, parts) if parts else jnp.zeros((1, x.shape[1]), x.dtype)


def _slice(x: Array, run: np.ndarray) -> Array:
    """Return the rows of a run, staged in a fifth of the time that JAX takes to interpret
    an index."""
    return lax.slice_in_dim(x, int(run[0]), int(run[-1]) + 1)
