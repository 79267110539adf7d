"""Blocks of Runge-Kutta steps, adaptive or constant, in loops that XLA compiles to fast code, and
their derivatives in both modes.

A block keeps the polynomials of its steps, from which the samples in it are computed together at
its end. Reverse mode keeps the start and the step lengths of each block, and repeats the block; its
memory grows with the number of blocks. Both modes treat step lengths as constants. In a batch every
member has its own steps; constant steps are the same for all, and functions of time alone are then
computed once. Adaptive steps end at the kinks of motions and loads, because a polynomial of high
degree cannot cross them. Where a problem has a projection P, steps end at P(y1), and the error is
what remains of it after the projection.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from equinox import combine, filter_custom_jvp, is_array, is_inexact_array, partition
from jax import lax

from jaxbody.core.arrays import Array, Bool, Float, Int
from jaxbody.core.errors import JaxbodyError, Status
from jaxbody.core.errors import Problem as Wrong
from jaxbody.core.jax_internals import (
    Zero,
    chosen,
    instantiate_zeros,
    merged,
    new_operation,
    shaped,
)
from jaxbody.numerics import elementary_functions
from jaxbody.numerics.lanes import in_lanes
from jaxbody.numerics.runge_kutta_steps import (
    NOT_LOOKING,
    TRIAL,
    Ahead,
    Course,
    InitialValueProblem,
    after_jump,
    change_ratio,
    controlled,
    defects,
    error_ratio,
    first_length,
    look_along,
    polynomial,
    rate,
    row_at,
    rows_of_polynomial,
    step,
)
from jaxbody.numerics.xla_workarounds import any_of_batch, carried

BLOCK = 128  # most steps in a block
MOST_KEPT = 8e9  # bytes that a derivative may reserve
WINDOW = 1024  # samples computed together, at most
# members of a batch in a chunk: loops over 32 or fewer are unrolled before they can become
# vector instructions
LANES = 40
NEAR = 1e-12  # distance of kinks, relative to the whole time, below which they count as one


class Steps(NamedTuple):
    """Steps, one in each row: time from t0 to the start [s], length [s], coefficients of the
    polynomial c_0 + c_1 theta + ...; the length is zero in rows without a step."""

    start: Float[Array, "*n"]
    h: Float[Array, "*n"]
    c: Float[Array, "*n m ny"]


class Begun(NamedTuple):
    """The start of a block: time tau after t0 [s], state and its rate, the step before it, index of
    the window of samples, and the time up to which that window is filled."""

    tau: Float[Array, ""]
    y: Float[Array, "ny"]
    f: Float[jax.Array, "ny"]
    last: Steps
    window: Int[Array, ""]
    filled: Float[Array, ""]


class Solution(NamedTuple):
    """A solution: the samples, NaN after an early end; the last time, counted from t0 [s]; the last
    state; and the state of step control."""

    samples: Float[Array, "nt ny"]
    tau: Float[Array, ""]
    y: Float[Array, "ny"]
    course: Course


def solve(
    problem: InitialValueProblem, arguments: Any, y0: Float[Array, "ny"], times: Float[Array, "nt"]
) -> Solution:
    """Return the solution from y0 at times[0]; differentiable in forward mode only, at the least
    cost."""
    return _march(problem, arguments, y0, times, keep=False)[0]


@filter_custom_jvp
def solve_both_ways(
    given: tuple[Any, Float[Array, "ny"], Float[Array, "nt"]], *, problem: InitialValueProblem
) -> Solution:
    """Return the solution, as `solve` does, for given = (arguments, y0, times); differentiable in
    reverse mode, in forward mode, which solves twice, and in forward mode over either."""
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
            ended = solve(problem, *tree.unflatten(merged(moves, moved, leaves)))
            return ended.samples, ended.y

        return jax.jvp(of_moved, (chosen(leaves, moves),), (changes,))[1]

    def backward(known, cotangents):
        (numbers, kept), (of_samples, of_y) = known, cotangents
        problem, given = combine(numbers, rest)
        slopes = _backward(kept, of_samples, of_y, given, problem)
        return chosen(tree.flatten_up_to(slopes), moves)

    of_samples, of_y = linear_with_transpose(
        forward, backward, (numbers, kept), jax.tree.leaves(changes), (ended.samples, ended.y)
    )
    return ended, Solution(of_samples, None, of_y, Course(*[None] * len(Course._fields)))  # pyright: ignore


def _backward(
    kept,
    of_samples: Float[jax.Array, "nt ny"],
    of_y: Float[Array, "ny"],
    given,
    problem: InitialValueProblem,
):
    """Return the cotangents of (arguments, y0, times) by the chain rule, block by block from the
    last to the first."""
    arguments, y0, times = given
    begun, lengths, n = kept
    varied, fixed = partition(arguments, is_inexact_array)
    # the first sample is y0, and belongs to no block
    of_windows = _windows(of_samples.at[0].set(0.0), jnp.zeros((1, len(y0)), y0.dtype))

    def back(carry):
        n, to_varied, to_times, to_state = carry
        here, h = (jax.tree.map(lambda x: row_at(x, n - 1), x) for x in (begun, lengths))

        def block(varied, times, state):
            start = here._replace(y=state[0], f=state[1], last=here.last._replace(c=state[2]))
            steps, y, f = _repeat(problem, combine(varied, fixed), times[0], start, h)
            tau = steps.start[-1] + steps.h[-1]
            values, fill = _sampled(times, start, steps, tau)
            return (y, f, _last(steps).c), jnp.where(fill[:, None], values, 0.0)

        _, pull = jax.vjp(block, varied, times, (here.y, here.f, here.last.c))
        a, b, to_state = pull((to_state, row_at(of_windows, here.window)))
        return n - 1, jax.tree.map(jnp.add, to_varied, a), to_times + b, to_state

    nothing = jax.tree.map(jnp.zeros_like, (varied, times))
    _, to_varied, to_times, (to_y, to_f, to_c) = lax.while_loop(
        lambda carry: carry[0] > 0,
        back,
        (
            n,
            *nothing,
            (of_y, jnp.zeros_like(y0), jnp.zeros((rows_of_polynomial(problem), len(y0)), y0.dtype)),
        ),
    )
    _, pull = jax.vjp(
        lambda varied, t, y: rate(problem, combine(varied, fixed), t, y), varied, times[0], y0
    )
    a, b, c = pull(to_f)
    return (
        jax.tree.map(jnp.add, to_varied, a),
        to_y + to_c[0] + c + of_samples[0],
        to_times.at[0].add(b),
    )


def _march(
    problem: InitialValueProblem, arguments: Any, y0, times, keep: bool
) -> tuple[Solution, Any]:
    """Return the solution, block after block; with `keep` also the starts and step lengths of the
    blocks."""
    numbers, rest = partition((problem, arguments), is_array)

    def march(numbers, y0, times):
        problem, arguments = combine(numbers, rest)
        return _march_on(problem, arguments, y0, times, keep)

    return in_lanes(march, lanes=LANES)(numbers, y0, times)


def _check_memory(max_steps: int, blocks: int, each: int) -> None:
    """Check the memory of a derivative, which is reserved for max_steps. Error: TOO_LARGE."""
    if blocks * each > MOST_KEPT:
        raise JaxbodyError(
            Wrong(
                "TOO_LARGE",
                "simulate.max_steps",
                (
                    f"reserves {blocks * each / 1e9:.3g} GB for the derivative: {each} bytes for "
                    f"every {BLOCK} of max_steps={max_steps}"
                ),
                max_steps,
                f"{MOST_KEPT / 1e9:g} GB",
                (
                    f"Give fewer max_steps, {int(MOST_KEPT / each) * BLOCK:.1g} at most, or "
                    "adjoint=diffrax.ForwardMode(), which needs none."
                ),
            )
        )


def _march_on(problem: InitialValueProblem, arguments: Any, y0, times, keep: bool):
    past = times - times[0]
    end = lax.stop_gradient(past[-1])
    reach = lax.stop_gradient(_windows(past)[:, -1])
    zero, none = jnp.zeros_like(past[0]), jnp.zeros((), int)
    begun = Begun(
        zero,
        y0,
        jnp.zeros_like(y0),
        Steps(
            zero, zero, jnp.zeros((rows_of_polynomial(problem), len(y0)), y0.dtype).at[0].set(y0)
        ),
        none,
        zero - 1,
    )
    course = Course(TRIAL * end, zero, zero + jnp.inf, none, none, jnp.full((), Status.OK.value))
    # for few samples few steps are kept
    size = BLOCK if keep else min(max(len(times) // 8, 16), BLOCK)
    # full blocks, one that ends each window, and the last ones
    blocks = problem.max_steps // BLOCK + len(reach) + 2 if keep else 0
    of_block = (begun, jnp.zeros(BLOCK, y0.dtype))
    _check_memory(
        problem.max_steps, blocks, sum(x.size * x.dtype.itemsize for x in jax.tree.leaves(of_block))
    )
    kept = jax.tree.map(lambda x: jnp.zeros((blocks, *x.shape), x.dtype), of_block)
    out = _windows(jnp.full((len(times), len(y0)), jnp.nan, y0.dtype))
    moving = (begun.y, begun.f, begun.last.c, out)
    y, f, c, out = carried(
        moving, [x for x in jax.tree.leaves((arguments, times)) if is_inexact_array(x)]
    )
    begun = begun._replace(y=y, f=f, last=begun.last._replace(c=c))
    ahead = Ahead(none + NOT_LOOKING, zero, zero, lax.stop_gradient(c))

    def running(begun, course):
        """Return whether samples before the end of the block are still to be computed; one step may
        cover several windows of samples."""
        return begun.filled < jnp.where(course.code == Status.OK.value, end, begun.tau)

    def block(carry):
        begun, course, ahead, out, kept, n = carry
        on = running(begun, course)
        goal = jnp.where(on, row_at(reach, begun.window), -1.0)
        tau, y, f, course, ahead, steps = _advance(
            problem, arguments, times, begun, course, ahead, goal, size, n == 0
        )
        values, fill = _sampled(times, begun, steps, tau)
        out = _put(out, begun.window, jnp.where(fill[:, None], values, row_at(out, begun.window)))
        if keep:  # members that check a step while others take one may need more blocks
            short = running(begun._replace(tau=tau), course) & (n + 1 >= blocks)
            course = course._replace(code=jnp.where(short, Status.MAX_STEPS.value, course.code))
            kept = jax.tree.map(
                lambda all, one: lax.dynamic_update_index_in_dim(all, one, n, 0),
                kept,
                (begun, jnp.where(jnp.isfinite(steps.h[1:]), steps.h[1:], 0.0)),
            )
        through = on & (tau >= goal) & (begun.window < len(reach) - 1)
        begun = Begun(
            tau,
            y,
            f,
            _last(steps),
            begun.window + through.astype(begun.window.dtype),
            jnp.where(through, -1.0, tau),
        )
        return begun, course, ahead, out, kept, n + 1

    carry = (begun, course, ahead, out, kept, none)
    begun, course, _, out, kept, n = lax.while_loop(
        lambda carry: any_of_batch(running(carry[0], carry[1])), block, carry
    )
    if keep:  # the trial step gave the rate at the start of the first block
        kept = (
            kept[0]._replace(f=kept[0].f.at[0].set(rate(problem, arguments, times[0], y0))),
            kept[1],
        )
    samples = out.reshape(-1, len(y0))[: len(times)].at[0].set(y0)
    return Solution(samples, begun.tau, begun.y, course), (*kept, n)


def _advance(
    problem: InitialValueProblem,
    arguments,
    times,
    begun: Begun,
    course: Course,
    ahead: Ahead,
    goal,
    size: int,
    starting: Bool[Array, ""],
):
    """Take steps until `goal`, at most one block of them; if `starting`, take a trial step
    first."""
    t0, past = times[0], lax.stop_gradient(times - times[0])
    end = past[-1]
    rows = jax.tree.map(lambda x: jnp.zeros((size, *x.shape), x.dtype), begun.last)._replace(
        h=jnp.full(size, jnp.inf, begun.y.dtype)
    )
    steps = jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), begun.last, rows)
    ends = None if problem.kinks is None else jnp.append(problem.kinks - t0, jnp.inf)

    def stop(tau):
        """Return the time at which a step from tau must end."""
        to = end
        if ends is not None:
            after = tau + NEAR * end
            kink = ends[jnp.searchsorted(ends, after, side="right", method="scan_unrolled")]
            to = jnp.minimum(to, kink)
        if problem.jumps is not None:
            to = jnp.minimum(to, problem.jumps.next(t0 + tau, arguments) - t0)
        return to

    def active(tau, course):
        return (course.code == Status.OK.value) & (tau < goal)

    def one(carry):
        tau, y, f, course, ahead, steps, i = carry
        on = active(tau, course)
        to = lax.stop_gradient(stop(tau))
        left = to - tau
        h = jnp.where(
            ahead.at == NOT_LOOKING, jnp.where(course.h > 0.9999 * left, left, course.h), ahead.h
        )
        h = lax.stop_gradient(h)
        trial = i == 0
        look = None if problem.control is None else look_along(problem, ahead, tau, past)
        new = step(problem, arguments, t0 + tau, y, f, h, trial, look)
        tau1 = jnp.where(h == left, to, tau + h)
        c = polynomial(problem.method, y, new)
        if look is None:
            good, after, next_ahead = (
                jnp.array(True),
                course._replace(accepted=course.accepted + 1),
                ahead,
            )
        else:
            of_step, cut = lax.stop_gradient((y, new)), (tau1 == to) & (to < end)
            ratios = (
                error_ratio(problem, *of_step),
                change_ratio(problem, *of_step),
                defects(problem, *of_step, look, ahead.c),
            )
            this = ahead._replace(h=h, c=jnp.where(look.on, ahead.c, lax.stop_gradient(c)))
            good, after, next_ahead = controlled(
                problem, course, look, this, tau1, past, cut, *ratios
            )
        made = on & good & ~trial
        tries = after.accepted + after.rejected
        code = jnp.where(
            good & (tau1 >= end),
            Status.OK.value,
            jnp.where(tries >= problem.max_steps, Status.MAX_STEPS.value, after.code),
        )
        f0 = new.k[1] / h  # the rate at the start, for a trial step
        first, method = problem.first, problem.method
        if first is None:
            first = first_length(
                problem.control,
                method.order,
                *lax.stop_gradient((y, f0, new.f)),
                method.A[1, 1] * h,
                end,
            )
        begin = course._replace(h=first)
        after = jax.tree.map(
            lambda new, old: jnp.where(trial, new, old), begin, after._replace(code=code)
        )
        made_step = Steps(tau, jnp.where(made, tau1 - tau, 0.0), c)
        steps = jax.tree.map(
            lambda all, new: lax.dynamic_update_index_in_dim(all, new, i, 0), steps, made_step
        )
        y1, f1 = after_jump(problem, arguments, t0 + tau1, new.y, new.f)
        tau, y, f = (
            jnp.where(made, new, old)
            for new, old in ((tau1, tau), (y1, y), (f1, jnp.where(trial, f0, f)))
        )
        course, ahead = jax.tree.map(
            lambda new, old: jnp.where(on, new, old), (after, next_ahead), (course, ahead)
        )
        ahead = ahead._replace(at=jnp.where(trial, NOT_LOOKING, ahead.at))
        return tau, y, f, course, ahead, steps, i + any_of_batch(made | trial).astype(i.dtype)

    def more(carry):
        return any_of_batch(active(carry[0], carry[3])) & (carry[6] <= size)

    return lax.while_loop(
        more, one, (begun.tau, begun.y, begun.f, course, ahead, steps, jnp.where(starting, 0, 1))
    )[:6]


def _repeat(problem: InitialValueProblem, arguments, t0, begun: Begun, lengths: Float[Array, "n"]):
    """Return the steps of a block from their lengths, and the final state and rate."""

    def one(carry, h):
        tau, y, f = carry
        made = step(problem, arguments, t0 + tau, y, f, h)
        after = after_jump(problem, arguments, t0 + tau + h, made.y, made.f)
        y1, f1 = (jnp.where(h > 0, *x) for x in zip(after, (made.y, made.f), strict=True))
        return (tau + h, y1, f1), Steps(tau, h, polynomial(problem.method, y, made))

    (_, y, f), steps = lax.scan(one, (begun.tau, begun.y, begun.f), lengths)
    return (
        jax.tree.map(lambda first, rest: jnp.concatenate([first[None], rest]), begun.last, steps),
        y,
        f,
    )


def _sampled(
    times, begun: Begun, steps: Steps, tau
) -> tuple[Float[Array, "w ny"], Bool[Array, "w"]]:
    """Return the samples of the window from the polynomials of the steps, and which of them lie in
    this block."""
    past = row_at(_windows(times - times[0]), begun.window)
    row = jnp.searchsorted(lax.stop_gradient(steps.start + steps.h), past)
    start, h = steps.start[row], steps.h[row]
    theta = ((past - start) / jnp.where(h > 0, h, 1.0))[:, None]
    return elementary_functions.polynomial(jnp.moveaxis(steps.c[row], 1, 0), theta), (
        past <= tau
    ) & (past > begun.filled)


def _last(steps: Steps) -> Steps:
    """Return the last step that was made."""
    made = (steps.h > 0) & jnp.isfinite(steps.h)
    i = jnp.max(jnp.where(made, jnp.arange(len(made)), 0))
    return jax.tree.map(lambda x: x[i], steps)


def _windows(x: Float[Array, "nt *k"], more: Array | None = None) -> Float[jax.Array, "n w *k"]:
    """Return the rows divided into windows of equal length; the last window is filled up with the
    last row, or with `more`."""
    w = min(WINDOW, len(x))
    n = -(-len(x) // w)
    x = jnp.concatenate(
        [x, jnp.broadcast_to(x[-1:] if more is None else more, (n * w - len(x), *x.shape[1:]))]
    )
    return x.reshape(n, w, *x.shape[1:])


def _put(x: jax.Array, i: Int[Array, ""], row: jax.Array) -> jax.Array:
    return row[None] if len(x) == 1 else lax.dynamic_update_index_in_dim(x, row, i, 0)


# A linear function with its own transpose. `jax.linear_transpose` accepts no loop of unknown
# length; `jax.custom_vjp` allows no forward mode; `jax.custom_derivatives.linear_call` has no
# derivative with respect to known arrays.


def linear_with_transpose(
    forward: Callable[[Any, Any], Any],
    transpose: Callable[[Any, Any], Any],
    known: Any,
    moved: Any,
    like: Any,
) -> Any:
    """Return forward(known, moved), linear in the arrays `moved`, with its own transpose.

    Args:
        forward: a function of (known, moved).
        transpose: its transpose, a function of (known, cotangents).
        known: arrays in which it need not be linear.
        moved: arrays in which it is linear.
        like: arrays of the shapes and types of the results.

    Neither function may have arrays in its closure. Only the one that is needed is traced; both can
    be differentiated again."""
    given, tree = jax.tree.flatten((known, moved))
    n, known_tree = len(jax.tree.leaves(known)), jax.tree.structure(known)

    def along(*x):
        return jax.tree.leaves(forward(*jax.tree.unflatten(tree, x)))

    def back(*x):
        return jax.tree.leaves(
            transpose(
                jax.tree.unflatten(known_tree, x[:n]),
                jax.tree.unflatten(jax.tree.structure(like), x[n:]),
            )
        )

    shapes = tuple((x.shape, x.dtype) for x in jax.tree.leaves(like))
    out = _linear_p.bind(*given, along=along, back=back, n=n, shapes=shapes)
    return jax.tree.unflatten(jax.tree.structure(like), out)


def _linear_jvp(primals, tangents, *, along, **params):
    moved = [not isinstance(t, Zero) for t in tangents]

    def of_moved(*x):
        return along(*merged(moved, x, primals))

    if any(moved[: params["n"]]):
        return jax.jvp(of_moved, chosen(primals, moved), chosen(tangents, moved))
    given = [instantiate_zeros(t) for t in tangents[params["n"] :]]
    return _linear_p.bind(*primals, along=along, **params), _linear_p.bind(
        *primals[: params["n"]], *given, along=along, **params
    )


def _linear_transpose(cotangents, *args, back, n, **_):
    out = iter(back(*args[:n], *(instantiate_zeros(c) for c in cotangents)))
    return [None] * n + [next(out) for _ in args[n:]]


def _linear_batch(args, axes, *, along, back, n, shapes):
    size = next(x.shape[axis] for x, axis in zip(args, axes, strict=True) if axis is not None)

    def back_over(*x):
        out = jax.vmap(back, in_axes=(*axes[:n], *(0 for _ in shapes)), axis_size=size)(*x)
        return [
            jnp.sum(c, 0) if axis is None else jnp.moveaxis(c, 0, axis)
            for c, axis in zip(out, axes[n:], strict=True)
        ]

    along_over = jax.vmap(along, in_axes=tuple(axes), axis_size=size)
    shapes = tuple(((size, *shape), dtype) for shape, dtype in shapes)
    return _linear_p.bind(*args, along=along_over, back=back_over, n=n, shapes=shapes), [0] * len(
        shapes
    )


_linear_p = new_operation(
    "linear_with_transpose",
    lambda *args, along, **_: along(*args),
    typed=lambda *_, shapes, **__: [shaped(*x) for x in shapes],
    several=True,
    batch=_linear_batch,
    jvp=_linear_jvp,
    transpose=_linear_transpose,
)
