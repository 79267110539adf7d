"""Steps of the Dormand-Prince method of order 8, adaptive or constant, in loops that XLA compiles to fast code.

    k_i = h f(t + c_i h, y + sum_j a_ij k_j),   y(t + h) = y + sum_i b_i k_i,   error = sum_i e_i k_i
    y(t + theta h) = y + sum_i p_i(theta) k_i,  p_i of degree 6 without a constant

Coefficients are those of diffrax (Prince, Dormand, J. Comp. Appl. Math. 7 (1981) 67). Steps form blocks: a block keeps the polynomials of
its steps, from which the samples in it are computed together at its end. Reverse mode keeps the start and the step lengths of each block,
and repeats the block; its memory grows with the number of blocks. Both modes treat step lengths as constants. In a batch every member has
its own steps; constant steps are the same for all, and functions of time alone are then computed once. Adaptive steps end at the samples of
measured accelerations and of forces interpolated linearly, because a polynomial of high degree cannot cross their kinks.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from equinox import combine, filter_custom_jvp, is_array, is_inexact_array, partition
from jax import lax

from jaxbody.core.arrays import Array, Bool, Float, Int
from jaxbody.core.errors import JaxbodyError, Status
from jaxbody.core.errors import Problem as Wrong
from jaxbody.core.jax_internals import linear_with_transpose
from jaxbody.numerics.lanes import in_lanes, vmap_last
from jaxbody.numerics.xla_workarounds import any_of_batch

TABLEAU = diffrax.Dopri8.tableau
STAGES = len(TABLEAU.c) + 1
A = np.array([np.pad(row, (0, STAGES - len(row))) for row in TABLEAU.a_lower])  # its last row is b: the last stage starts the next step
C, E = np.asarray(TABLEAU.c), np.asarray(TABLEAU.b_error)
EULER = A[1, 1]  # fraction of a trial step, which begins with f = 0: its first stage is at its start, its second an Euler step later
C_TRIAL = np.array([0.0, EULER, *C[2:]])
P = np.asarray(diffrax.Dopri8.interpolation_cls.eval_coeffs)[:, ::-1].T  # (6, stages): of theta, theta^2 ...  # pyright: ignore
BLOCK = 128  # steps, at most
MOST_KEPT = 8e9  # bytes that a derivative may reserve
WINDOW = 1024  # samples computed together, at most
LANES = 40  # members of a batch in a chunk: loops over 32 or fewer are unrolled before they can become vector instructions
NEAR = 1e-12  # distance of kinks, relative to the whole time, below which they are one
ROUNDED = 100.0  # errors by round-off, in eps of the state; smaller errors do not lengthen the next step further,
LEAST_ERROR = 1e-3  # nor do errors below this where tolerances are near round-off
SAFETY, SHRINK, GROW = 0.9, 0.2, 10.0  # safety factor, and limits of the ratio of successive step lengths
TRIAL = 1e-6  # length of the trial step, relative to the whole time; it gives the first rate and the first step


class InitialValueProblem(NamedTuple):
    """y' = rate(arguments, u, y) with u = drive(arguments, t), the part that depends on time alone.

    `rtol`, `atol`: tolerances of a step's error; `shortest`, `first`: smallest and first step length; `max_steps`: most steps; `kinks`:
    ascending times of kinks of the rate, at which steps end; `constant`: True for steps that all have the length of the first."""

    drive: Callable[[Any, Array], Any]
    rate: Callable[[Any, Any, Array], Array]
    rtol: Float[Array, ""]
    atol: Float[Array, "ny"]
    shortest: Float[Array, ""]
    first: Float[Array, ""] | None
    max_steps: int
    kinks: Float[Array, "nk"] | None = None
    constant: bool = False


class Steps(NamedTuple):
    """Steps: start after t0, length, polynomial c_0 + c_1 theta + ... + c_6 theta^6; the length is zero in rows without a step."""

    start: Float[Array, "*n"]
    h: Float[Array, "*n"]
    c: Float[Array, "*n 7 ny"]


class Begun(NamedTuple):
    """The start of a block: time tau after t0, state and its rate, the step before it, the window of samples, and the time up to which that
    is filled."""

    tau: Float[Array, ""]
    y: Float[Array, "ny"]
    f: Float[jax.Array, "ny"]
    last: Steps
    window: Int[Array, ""]
    filled: Float[Array, ""]


class Course(NamedTuple):
    """The state of step control: next step length, numbers of accepted and rejected steps, status."""

    h: Float[Array, ""]
    accepted: Int[Array, ""]
    rejected: Int[Array, ""]
    code: Int[Array, ""]


class Solution(NamedTuple):
    """Samples, NaN after an early end; last time after t0, last state, and state of step control."""

    samples: Float[Array, "nt ny"]
    tau: Float[Array, ""]
    y: Float[Array, "ny"]
    course: Course


def solve(problem: InitialValueProblem, arguments: Any, y0: Float[Array, "ny"], times: Float[Array, "nt"]) -> Solution:
    """The solution from y0 at times[0]; differentiable in forward mode only, at the least cost."""
    return _march(problem, arguments, y0, times, keep=False)[0]


@filter_custom_jvp
def solve_both_ways(given: tuple[Any, Float[Array, "ny"], Float[Array, "nt"]], *, problem: InitialValueProblem) -> Solution:
    """`solve` of given = (arguments, y0, times); differentiable in reverse mode, in forward mode, which solves twice, and in forward mode
    over either."""
    return _march(problem, *given, keep=False)[0]


@solve_both_ways.def_jvp
def _tangents(primals, tangents, *, problem):
    (given,), (changes,) = primals, tangents
    ended, kept = _march(problem, *given, keep=True)
    numbers, rest = partition((problem, given), is_array)
    tree = jax.tree.structure(given)
    moves = [change is not None for change in tree.flatten_up_to(changes)]

    def forward(known, changes):
        problem, given = combine(known[0], rest)
        leaves = jax.tree.leaves(given)

        def of_moved(moved):
            moved = iter(moved)
            ended = solve(problem, *tree.unflatten([next(moved) if m else x for x, m in zip(leaves, moves, strict=True)]))
            return ended.samples, ended.y

        return jax.jvp(of_moved, ([x for x, m in zip(leaves, moves, strict=True) if m],), (changes,))[1]

    def backward(known, cotangents):
        (numbers, kept), (of_samples, of_y) = known, cotangents
        problem, given = combine(numbers, rest)
        slopes = _backward(kept, of_samples, of_y, given, problem)
        return [x for x, m in zip(tree.flatten_up_to(slopes), moves, strict=True) if m]

    of_samples, of_y = linear_with_transpose(forward, backward, (numbers, kept), jax.tree.leaves(changes), (ended.samples, ended.y))
    return ended, Solution(of_samples, None, of_y, Course(None, None, None, None))  # pyright: ignore


def _backward(kept, of_samples: Float[jax.Array, "nt ny"], of_y: Float[Array, "ny"], given, problem: InitialValueProblem):
    """Cotangents of (arguments, y0, times) by the chain rule, block by block from the last to the first."""
    arguments, y0, times = given
    begun, lengths, n = kept
    varied, fixed = partition(arguments, is_inexact_array)
    of_windows = _windows(of_samples.at[0].set(0.0), jnp.zeros((1, len(y0)), y0.dtype))  # the first sample is y0

    def back(carry):
        n, to_varied, to_times, to_state = carry
        here, h = (jax.tree.map(lambda x: _at(x, n - 1), x) for x in (begun, lengths))

        def block(varied, times, state):
            start = here._replace(y=state[0], f=state[1], last=here.last._replace(c=state[2]))
            steps, y, f = _repeat(problem, combine(varied, fixed), times[0], start, h)
            tau = steps.start[-1] + steps.h[-1]
            values, fill = _sampled(times, start, steps, tau)
            return (y, f, _last(steps).c), jnp.where(fill[:, None], values, 0.0)

        _, pull = jax.vjp(block, varied, times, (here.y, here.f, here.last.c))
        a, b, to_state = pull((to_state, _at(of_windows, here.window)))
        return n - 1, jax.tree.map(jnp.add, to_varied, a), to_times + b, to_state

    nothing = jax.tree.map(jnp.zeros_like, (varied, times))
    _, to_varied, to_times, (to_y, to_f, to_c) = lax.while_loop(
        lambda carry: carry[0] > 0, back, (n, *nothing, (of_y, jnp.zeros_like(y0), jnp.zeros((7, len(y0)), y0.dtype)))
    )
    _, pull = jax.vjp(lambda varied, t, y: _rate(problem, combine(varied, fixed), t, y), varied, times[0], y0)
    a, b, c = pull(to_f)
    return jax.tree.map(jnp.add, to_varied, a), to_y + to_c[0] + c + of_samples[0], to_times.at[0].add(b)


def _march(problem: InitialValueProblem, arguments: Any, y0, times, keep: bool) -> tuple[Solution, Any]:
    """The solution, block after block; with `keep` also the starts and step lengths of the blocks."""
    numbers, rest = partition((problem, arguments), is_array)

    def march(numbers, y0, times):
        problem, arguments = combine(numbers, rest)
        return _march_on(problem, arguments, y0, times, keep)

    return in_lanes(march, lanes=LANES)(numbers, y0, times)


def _check_memory(max_steps: int, blocks: int, each: int) -> None:
    """Check the memory of a derivative, which is reserved for max_steps. Error: TOO_LARGE."""
    if blocks * each > MOST_KEPT:
        message = f"reserves {blocks * each / 1e9:.3g} GB for the derivative: {each} bytes for every {BLOCK} of max_steps={max_steps}"
        hint = f"Give fewer max_steps, {int(MOST_KEPT / each) * BLOCK:.1g} at most, or adjoint=diffrax.ForwardMode(), which needs none."
        raise JaxbodyError(Wrong("TOO_LARGE", "simulate.max_steps", message, max_steps, f"{MOST_KEPT / 1e9:g} GB", hint))


def _march_on(problem: InitialValueProblem, arguments: Any, y0, times, keep: bool):
    past = times - times[0]
    end = lax.stop_gradient(past[-1])
    reach = lax.stop_gradient(_windows(past)[:, -1])
    zero, none = jnp.zeros_like(past[0]), jnp.zeros((), int)
    begun = Begun(zero, y0, jnp.zeros_like(y0), Steps(zero, zero, jnp.zeros((7, len(y0)), y0.dtype).at[0].set(y0)), none, zero - 1)
    course = Course(TRIAL * end, none, none, jnp.full((), Status.OK.value))
    size = BLOCK if keep else min(max(len(times) // 8, 16), BLOCK)  # for few samples few steps are kept
    blocks = problem.max_steps // BLOCK + len(reach) + 1 if keep else 0
    of_block = (begun, jnp.zeros(BLOCK, y0.dtype))
    _check_memory(problem.max_steps, blocks, sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(of_block)))
    kept = jax.tree.map(lambda x: jnp.zeros((blocks, *x.shape), x.dtype), of_block)
    out = _windows(jnp.full((len(times), len(y0)), jnp.nan, y0.dtype))

    def running(begun, course):
        return (course.code == Status.OK.value) & (begun.tau < end)

    def block(carry):
        begun, course, out, kept, n = carry
        goal = jnp.where(running(begun, course), _at(reach, begun.window), -1.0)
        tau, y, f, course, steps = _advance(problem, arguments, times[0], begun, course, goal, end, size, n == 0)
        values, fill = _sampled(times, begun, steps, tau)
        out = _put(out, begun.window, jnp.where(fill[:, None], values, _at(out, begun.window)))
        if keep:
            kept = jax.tree.map(
                lambda all, one: lax.dynamic_update_index_in_dim(all, one, n, 0),
                kept,
                (begun, jnp.where(jnp.isfinite(steps.h[1:]), steps.h[1:], 0.0)),
            )
        through = (tau >= goal) & (begun.window < len(reach) - 1)
        begun = Begun(tau, y, f, _last(steps), begun.window + through.astype(begun.window.dtype), jnp.where(through, -1.0, tau))
        return begun, course, out, kept, n + 1

    carry = (begun, course, out, kept, none)
    begun, course, out, kept, n = lax.while_loop(lambda carry: any_of_batch(running(carry[0], carry[1])), block, carry)
    if keep:  # the trial step gave the rate at the start of the first block
        kept = kept[0]._replace(f=kept[0].f.at[0].set(_rate(problem, arguments, times[0], y0))), kept[1]
    samples = out.reshape(-1, len(y0))[: len(times)].at[0].set(y0)
    return Solution(samples, begun.tau, begun.y, course), (*kept, n)


def _advance(problem: InitialValueProblem, arguments, t0, begun: Begun, course: Course, goal, end, size: int, starting: Bool[Array, ""]):
    """Take steps until `goal`, at most one block of them; if `starting`, take a trial step first."""
    rows = jax.tree.map(lambda x: jnp.zeros((size, *x.shape), x.dtype), begun.last)._replace(h=jnp.full(size, jnp.inf, begun.y.dtype))
    steps = jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), begun.last, rows)
    ends = None if problem.kinks is None else jnp.append(problem.kinks - t0, jnp.inf)

    def stop(tau):
        """Where a step from tau must end."""
        if ends is None:
            return end
        return jnp.minimum(end, ends[jnp.searchsorted(ends, tau + NEAR * end, side="right", method="scan_unrolled")])

    def active(tau, course):
        return (course.code == Status.OK.value) & (tau < goal)

    def control(course, y, y1, k, h):
        """Whether a step's error is small enough, the next step's length, and the status."""
        error = _error(problem, *lax.stop_gradient((y, y1, k)))
        good = error <= 1
        factor = SAFETY / _eighth_root(jnp.maximum(error, jnp.minimum(ROUNDED * jnp.finfo(y.dtype).eps / problem.rtol, LEAST_ERROR)))
        longer = h * jnp.where(jnp.isfinite(error), jnp.clip(factor, SHRINK, jnp.where(good, GROW, 1.0)), SHRINK)
        if ends is not None:  # the step after one that was cut at a kink need not be as short
            longer = jnp.where(good & (h < course.h), jnp.maximum(longer, course.h), longer)
        small = jnp.where(jnp.isfinite(error), Status.DT_MIN.value, Status.NONFINITE.value)
        return good, longer, jnp.where(longer < problem.shortest, small, Status.OK.value)

    def one(carry):
        tau, y, f, course, steps, i = carry
        on = active(tau, course)
        to = lax.stop_gradient(stop(tau))
        left = to - tau
        h = lax.stop_gradient(jnp.where(course.h > 0.9999 * left, left, course.h))
        trial = i == 0
        y1, f1, k = _step(problem, arguments, t0 + tau, y, f, h, trial)
        good, longer, code = (jnp.array(True), course.h, course.code) if problem.constant else control(course, y, y1, k, h)
        made, tries = on & good & ~trial, course.accepted + course.rejected + 1
        tau1 = jnp.where(h == left, to, tau + h)
        code = jnp.where(good & (tau1 >= end), Status.OK.value, jnp.where(tries >= problem.max_steps, Status.MAX_STEPS.value, code))
        taken, refused = (x.astype(course.accepted.dtype) for x in (good, ~good))
        after = Course(longer, course.accepted + taken, course.rejected + refused, code)
        f0 = k[1] / h  # the rate at the start, for a trial step
        begin = course._replace(h=_first(problem, *lax.stop_gradient((y, f0, f1)), EULER * h, end))
        after = jax.tree.map(lambda new, old: jnp.where(trial, new, old), begin, after)
        step = Steps(tau, jnp.where(made, tau1 - tau, 0.0), _polynomial(y, k))
        steps = jax.tree.map(lambda all, new: lax.dynamic_update_index_in_dim(all, new, i, 0), steps, step)
        tau, y, f = (jnp.where(made, new, old) for new, old in ((tau1, tau), (y1, y), (f1, jnp.where(trial, f0, f))))
        return tau, y, f, jax.tree.map(lambda new, old: jnp.where(on, new, old), after, course), steps, i + 1

    def more(carry):
        return any_of_batch(active(carry[0], carry[3])) & (carry[5] <= size)

    return lax.while_loop(more, one, (begun.tau, begun.y, begun.f, course, steps, jnp.where(starting, 0, 1)))[:5]


def _repeat(problem: InitialValueProblem, arguments, t0, begun: Begun, lengths: Float[Array, "n"]):
    """The steps of a block from their lengths, and the final state and rate."""

    def one(carry, h):
        tau, y, f = carry
        y1, f1, k = _step(problem, arguments, t0 + tau, y, f, h)
        return (tau + h, y1, f1), Steps(tau, h, _polynomial(y, k))

    (_, y, f), steps = lax.scan(one, (begun.tau, begun.y, begun.f), lengths)
    return jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), begun.last, steps), y, f


def _rate(problem: InitialValueProblem, arguments, t, y):
    return problem.rate(arguments, problem.drive(arguments, t), y)


def _step(problem: InitialValueProblem, arguments, t, y, f, h, trial: Bool[Array, ""] | None = None):
    """The state and its rate after a step, and the k_i.

    A trial step has only two stages, k_1 = h f(t, y) and the rate a little later; a separate function would compile the rate twice."""

    def stage(carry, row):
        k, _, _ = carry
        a, u, i = row
        y_i = y + _sum(a, k)
        f_i = problem.rate(arguments, u, y_i)
        return (lax.dynamic_update_index_in_dim(k, h * f_i, i, 0), y_i, f_i), None

    c = C if trial is None else jnp.where(trial, C_TRIAL, C)
    driven = vmap_last(lambda t: problem.drive(arguments, t))(t + c * h)  # for all stages at once
    k = jnp.zeros((STAGES, len(y)), y.dtype).at[0].set(h * f)
    rows = jnp.asarray(A, y.dtype), jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), driven), np.arange(1, STAGES)
    if trial is None:
        (k, y, f), _ = lax.scan(stage, (k, y, f), rows)
    else:
        stages = jnp.where(trial, np.uint32(2), np.uint32(STAGES - 1))  # unsigned, as each row would check whether i is negative
        k, y, f = lax.fori_loop(np.uint32(0), stages, lambda i, carry: stage(carry, jax.tree.map(lambda x: _at(x, i), rows))[0], (k, y, f))
    return y, f, k


def _error(problem: InitialValueProblem, y, y1, k) -> Float[Array, ""]:
    """The largest ratio of a step's error to its tolerance."""
    return jnp.max(jnp.abs(_sum(E, k)) / (problem.atol + problem.rtol * jnp.maximum(jnp.abs(y), jnp.abs(y1))), initial=0.0)


def _sum(a, k: Float[Array, "n ny"]) -> Float[Array, "ny"]:
    """sum of a_i k_i, term by term: loops over ny are fast, a reduction over n is not (xla_workarounds)."""
    terms = [a[i] * k[i] for i in range(len(k)) if isinstance(a, jax.Array) or a[i] != 0]
    return sum(terms[1:], terms[0])


def _polynomial(y, k) -> Float[Array, "7 ny"]:
    return jnp.stack([y, *(_sum(p, k) for p in P)])


def _sampled(times, begun: Begun, steps: Steps, tau) -> tuple[Float[Array, "w ny"], Bool[Array, "w"]]:
    """The samples of the window from the polynomials of the steps, and which of them lie in this block."""
    past = _at(_windows(times - times[0]), begun.window)
    row = jnp.searchsorted(lax.stop_gradient(steps.start + steps.h), past)
    start, h = steps.start[row], steps.h[row]
    theta = ((past - start) / jnp.where(h > 0, h, 1.0))[:, None]
    c = steps.c[row]
    value = c[:, 6]
    for i in range(5, -1, -1):
        value = value * theta + c[:, i]
    return value, (past <= tau) & (past > begun.filled)


def _last(steps: Steps) -> Steps:
    """The last step that was made."""
    made = (steps.h > 0) & jnp.isfinite(steps.h)
    i = jnp.max(jnp.where(made, jnp.arange(len(made)), 0))
    return jax.tree.map(lambda x: x[i], steps)


def _first(problem: InitialValueProblem, y0, f0, f1, dt, end) -> Float[Array, ""]:
    """The first step's length, from the rates at the start and dt later. Source: Hairer, Norsett, Wanner, Solving Ordinary Differential
    Equations I, II.4."""
    if problem.first is not None:
        return problem.first
    scale = problem.atol + problem.rtol * jnp.abs(y0)
    d0, d1, d2 = (jnp.max(jnp.abs(x) / scale, initial=0.0) for x in (y0, f0, (f1 - f0) / dt))
    h0 = jnp.where((d0 < 1e-5) | (d1 < 1e-5), 1e-6, 0.01 * d0 / jnp.where(d1 > 0, d1, 1.0))
    most = jnp.maximum(d1, d2)
    h1 = jnp.where(most <= 1e-15, jnp.maximum(1e-6, 1e-3 * h0), _eighth_root(0.01 / jnp.where(most > 0, most, 1.0)))
    h = jnp.minimum(jnp.minimum(100 * h0, h1), end)
    return jnp.where(jnp.isfinite(h), h, problem.shortest)


def _eighth_root(x: Array) -> Array:
    return jnp.sqrt(jnp.sqrt(jnp.sqrt(x)))


def _windows(x: Float[Array, "nt *k"], more: Array | None = None) -> Float[jax.Array, "n w *k"]:
    """Rows in windows, filled with the last row or with `more`."""
    w = min(WINDOW, len(x))
    n = -(-len(x) // w)
    x = jnp.concatenate([x, jnp.broadcast_to(x[-1:] if more is None else more, (n * w - len(x), *x.shape[1:]))])
    return x.reshape(n, w, *x.shape[1:])


def _at(x: Array, i: Array) -> Array:
    """x[i]; for a single row without an index, so that a batch needs no gather."""
    return x[0] if len(x) == 1 else lax.dynamic_index_in_dim(x, i, 0, keepdims=False)


def _put(x: jax.Array, i: Int[Array, ""], row: jax.Array) -> jax.Array:
    return row[None] if len(x) == 1 else lax.dynamic_update_index_in_dim(x, row, i, 0)
