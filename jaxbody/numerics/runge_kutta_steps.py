"""A step of an explicit Runge-Kutta method, its error, the polynomial between its ends, and the
control of steps.

    k_i = h f(t + c_i h, y + sum_j a_ij k_j),   y(t + h) = y + sum_i b_i k_i,
    error = sum_i e_i k_i
    y(t + theta h) = y + sum_i p_i(theta) k_i,  p_i a polynomial without a constant
    defect at theta = h f(t + theta h, y(t + theta h)) - sum_i p_i'(theta) k_i

The error depends on the rates at the stages of a step only; a short pulse of force between them
shows in the defect. A look is a check of a step between its ends: it evaluates the defect at some
points. The coefficients are those of a solver of diffrax; by default Dopri8 (Prince, Dormand, J.
Comp. Appl. Math. 7 (1981) 67).
"""

from __future__ import annotations

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
from jax import lax

from jaxbody.core.arrays import Array, Bool, Float, Int
from jaxbody.core.errors import Status
from jaxbody.numerics import elementary_functions
from jaxbody.numerics.lanes import vmap_last
from jaxbody.numerics.xla_workarounds import any_of_batch

DEGREE = 6  # highest of the polynomial between the ends of a step
# length of the trial step, relative to the whole time; it gives the first rate and the first step
TRIAL = 1e-6
# error due to round-off, in eps of the state: smaller errors do not lengthen the next step further;
# over the tolerance it counts as LEAST_ERROR at most
ROUNDED = 100.0
LEAST_ERROR = 1e-3
# error over its tolerance below which a step is quiet: such a step, or one in which the state
# hardly changes, gives no information about the next step, which is therefore checked between its
# ends before it is accepted
QUIET = 0.02
# largest length of the next step, over that of a quiet step that ended at a kink, for which it
# needs no such check: steps from sample to sample of a record are equally long
LONGER = 1.01
# a step this many times longer than the shortest that an error has required is checked between its
# ends too: a pulse that occurred once may occur again
SHARP = 100.0
NOT_LOOKING, EVENLY = -2, -1  # values of `Ahead.at` other than indices of samples
DEFECT = 1e3  # largest defect that is allowed, over the tolerance of the error
ZERO = 1e-12  # coefficients of the polynomial below this are round-off


class Method:
    """The coefficients of a solver, as stages of which the last one starts the next step.

    A: (stages - 1, stages), its last row is b; C: (stages - 1,); E: (stages,); P: (degree, stages),
    of theta, theta^2 ...; order."""

    def __init__(self, solver: diffrax.AbstractERK):
        tableau: Any = solver.tableau
        rows = tableau.a_lower if tableau.fsal else (*tableau.a_lower, tableau.b_sol)
        stages = len(rows) + 1
        self.A = np.array([np.pad(row, (0, stages - len(row))) for row in rows])
        self.C = np.append(tableau.c, np.ones(stages - 1 - len(tableau.c)))
        self.E = np.pad(tableau.b_error, (0, stages - len(tableau.b_error)))
        P = _polynomials(solver, tableau.b_sol)
        self.P = np.pad(P, ((0, 0), (0, stages - P.shape[1])))
        # the other stage at the end of the step, if there is one
        self.end = next((i for i in range(stages - 2, 0, -1) if self.C[i - 1] == 1), None)
        self.order: Any = solver.order(diffrax.ODETerm(lambda t, y, args: y))


method_of = functools.cache(Method)  # computed once for each solver of diffrax


def _polynomials(solver: diffrax.AbstractERK, b: np.ndarray) -> np.ndarray:
    """Return P of the solver's interpolation, from its table of coefficients or else from its
    values at some theta."""
    interpolation: Any = solver.interpolation_cls
    if hasattr(interpolation, "eval_coeffs"):
        return np.asarray(interpolation.eval_coeffs)[:, ::-1].T
    theta = np.linspace(0.0, 1.0, DEGREE + 1)
    with jax.ensure_compile_time_eval():
        between = interpolation(
            t0=0.0, t1=1.0, y0=jnp.zeros(len(b)), y1=jnp.asarray(b), k=jnp.eye(len(b))
        )
        values = np.array([between.evaluate(jnp.asarray(x)) for x in theta])
    P = np.linalg.solve(np.vander(theta, increasing=True), values)[1:]
    P[np.abs(P) < ZERO] = 0.0
    return P[: np.flatnonzero(P.any(1))[-1] + 1]


class InitialValueProblem(NamedTuple):
    """The problem y' = rate(u, y, arguments), with u = drive(t, arguments), the part that depends
    on time alone, and a method to solve it.

    `project`: a function (u, y, at_y, arguments) -> the state nearest to y that fulfills the
    constraints; `rate` then returns (y', at_y), with at_y the values at y that the projection
    needs; None without constraints. `control`: a diffrax.PIDController with tolerances, smallest
    step and limits of step control; None for constant steps; `first`: the first or the constant
    step; `max_steps`: the largest number of steps; `kinks`: ascending times of kinks of the rate,
    at which steps end; `jumps`: instants at which the state jumps, None without."""

    drive: Callable[[Array, Any], Any]
    rate: Callable[[Any, Array, Any], Array]
    method: Method
    max_steps: int
    control: Any
    first: Float[Array, ""] | None = None
    kinks: Float[Array, "nk"] | None = None
    project: Callable[[Any, Array, Any, Any], Array] | None = None
    jumps: Jumps | None = None


class Jumps(NamedTuple):
    """Instants at which the state jumps; steps end there. `after`: a function (t, y, arguments) ->
    the state after time t, y itself if t is no such instant; `next`: (t, arguments) -> the next
    one after t."""

    after: Callable[[Array, Array, Any], Array]
    next: Callable[[Array, Any], Array]


def after_jump(problem: InitialValueProblem, arguments, t, y, f):
    """Return the state after time t and its rate, from those before it."""
    if problem.jumps is None:
        return y, f
    y = problem.jumps.after(t, y, arguments)
    return y, rate(problem, arguments, t, y)


def rate(problem: InitialValueProblem, arguments, t, y):
    """Return y' at the time t."""
    there = problem.rate(problem.drive(t, arguments), y, arguments)
    return there if problem.project is None else there[0]


class Step(NamedTuple):
    """The state after a step and its rate, and the k_i; with a projection P also P(y1) - y1, and
    P(y1) - P(y1 - error), the error that remains after it. `seen`: h times the rates at the points
    between the ends where a step is checked."""

    y: Float[Array, "ny"]
    f: Float[Array, "ny"]
    k: Float[Array, "stages ny"]
    moved: Float[Array, "ny"] | None = None
    error: Float[Array, "ny"] | None = None
    seen: Any = None


class Look(NamedTuple):
    """A look: a check of a step between its ends. `theta`: the points at which its defect is
    evaluated; `y`: the states there; `on`: True for a look, False for an ordinary step."""

    on: Bool[Array, ""]
    theta: Float[Array, "n"]
    y: Float[Array, "n ny"]


def step(
    problem: InitialValueProblem,
    arguments,
    t,
    y,
    f,
    h,
    trial: Bool[Array, ""] | None = None,
    look: Look | None = None,
) -> Step:
    """Make a step of length h, or evaluate the rates for a look (see Look) at the step made before.

    Args:
        problem: the problem.
        arguments: its arguments.
        t: time at the start [s].
        y: state there.
        f: rate there.
        h: length [s].
        trial: whether it is a trial step, of two stages only: k_1 = h f(t, y) and the rate a little
            later; None: steps of a constant or known length, without a trial.
        look: the points of a look, if one is due in place of a step; None: never.

    A separate function for a trial step would compile the rate twice. For the same reason the
    projection, with the rate there, is one more stage, and a look is a step whose stages are at its
    points."""
    method, project = problem.method, problem.project
    carry: Any
    stages = len(method.A) + 1

    def place(stage, i):
        """Return the state at which stage i evaluates the rate: `stage`, or, during a look, that at
        its point i, without derivatives."""
        return (
            stage
            if look is None
            else stage + lax.stop_gradient(jnp.where(look.on, row_at(look.y, i - 1) - stage, 0.0))
        )

    def stage(carry, row):
        k, _, _ = carry
        a, u, i = row
        y_i = place(y + _sum(a, k), i)
        f_i = problem.rate(u, y_i, arguments)
        return (lax.dynamic_update_index_in_dim(k, h * f_i, i, 0), y_i, f_i), None

    def stage_or_projection(carry, row):
        k, y1, _, _, error, at_y = carry
        a, u, i = row

        def projected():
            both = jnp.stack([y1, y1 - _sum(method.E, k[:stages])])
            there, other = jax.vmap(lambda y: problem.project(u, y, at_y, arguments))(both)  # pyright: ignore[reportOptionalCall]
            return there, there - y1, there - other

        # for reverse mode; in forward mode it would repeat the states for each tangent
        last = jax.checkpoint(projected) if trial is None else projected
        y_i, moved, error = lax.cond(i == stages, last, lambda: (y + _sum(a, k), error, error))
        y_i = place(y_i, i)
        f_i, at_y = problem.rate(u, y_i, arguments)
        return (
            lax.dynamic_update_index_in_dim(k, h * f_i, i, 0),
            y_i,
            f_i,
            moved,
            error,
            at_y,
        ), None

    A, C = method.A, method.C.astype(y.dtype)
    if project is not None:
        A, C = np.concatenate([A, A[-1:]]), np.append(C, C[-1])
    # those of a trial step, which begins with f = 0
    c = C if trial is None else jnp.where(trial, np.array([0.0, A[1, 1], *C[2:]]), C)
    c = c if look is None else jnp.where(look.on, look.theta, c)
    driven = vmap_last(lambda t: problem.drive(t, arguments))(t + c * h)  # for all stages at once
    k = jnp.zeros((len(A) + 1, len(y)), y.dtype).at[0].set(h * f)
    rows = (
        jnp.asarray(A, y.dtype),
        jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), driven),
        np.arange(1, len(A) + 1),
    )
    carry, one = (k, y, f), stage
    if project is not None:
        u = jax.tree.map(lambda x: x[0], rows[1])
        at_y = jax.eval_shape(
            lambda u, y, arguments: problem.rate(u, y, arguments)[1], u, y, arguments
        )
        zeros = jnp.zeros_like(y)
        carry, one = (
            (*carry, zeros, zeros, jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), at_y)),
            stage_or_projection,
        )
    if trial is None:
        carry, _ = lax.scan(one, carry, rows)
    else:
        # unsigned, so that reading a row needs no check whether i is negative
        last = jnp.where(trial, np.uint32(2), np.uint32(len(A)))
        carry = lax.fori_loop(
            np.uint32(0),
            last,
            lambda i, carry: one(carry, jax.tree.map(lambda x: row_at(x, i), rows))[0],
            carry,
        )
    k, y, f, *projected = carry
    moved, error = projected[:2] if project is not None else (None, None)
    return Step(y, f, k[:stages], moved, error, k[1:])


def error_ratio(problem: InitialValueProblem, y, made: Step) -> Float[Array, ""]:
    """Return a step's error over its tolerance, or, if that is larger, the difference between its
    last two stages over tolerance/sqrt(rtol), half the digits. Both stages are at the end of the
    step; the polynomial depends on the last one, the error estimate does not."""
    method, error = (
        problem.method,
        jnp.abs(_sum(problem.method.E, made.k) if made.error is None else made.error),
    )
    if method.end is not None:
        error = jnp.maximum(
            error, jnp.sqrt(problem.control.rtol) * jnp.abs(made.k[-1] - made.k[method.end])
        )
    return problem.control.norm(error / _tolerance(problem, y, made.y))


def change_ratio(problem: InitialValueProblem, y, made: Step) -> Float[Array, ""]:
    """Return a step's change of the state over tolerance/sqrt(rtol), half the digits."""
    return problem.control.norm(
        jnp.sqrt(problem.control.rtol) * (made.y - y) / _tolerance(problem, y, made.y)
    )


def defects(
    problem: InitialValueProblem, y, made: Step, look: Look, c: Float[Array, "m ny"]
) -> Float[Array, "n"]:
    """Return the defects of a step from y with the polynomial c at the points of a look, over
    their allowed values; zero without a look."""

    def seen():
        scale = DEFECT * _tolerance(problem, y, made.y)
        slopes = (
            sum(d * c[d] * theta ** (d - 1) for d in range(1, len(c))) for theta in look.theta
        )
        return jnp.stack(
            [
                problem.control.norm((hf - slope) / scale)
                for hf, slope in zip(made.seen, slopes, strict=True)
            ]
        )

    return lax.cond(any_of_batch(look.on), seen, lambda: jnp.zeros_like(look.theta))


def _tolerance(problem: InitialValueProblem, y0, y1) -> Float[Array, "ny"]:
    return problem.control.atol + problem.control.rtol * jnp.maximum(jnp.abs(y0), jnp.abs(y1))


def rows_of_polynomial(problem: InitialValueProblem) -> int:
    """Return the number of coefficients of the polynomial of a step."""
    rows = len(problem.method.P) + 1
    return rows if problem.project is None else max(rows, 4)


def _sum(a, k: Float[Array, "n ny"]) -> Float[Array, "ny"]:
    """Return the sum of a_i k_i, term by term: loops over ny are fast, a reduction over n is not
    (xla_workarounds)."""
    terms = [a[i] * k[i] for i in range(len(k)) if isinstance(a, jax.Array) or a[i] != 0]
    return sum(terms[1:], terms[0])


def polynomial(method: Method, y, made: Step) -> Float[Array, "n ny"]:
    """Return c_0, c_1 ... of the state c_0 + c_1 theta + ... in the step.

    If the step ends with a projection P, theta^2 (3 - 2 theta) (P(y1) - y1) is added."""
    c = [y, *(_sum(p, made.k) for p in method.P)]
    if made.moved is not None:
        c += [jnp.zeros_like(y)] * (4 - len(c))
        c[2], c[3] = c[2] + 3 * made.moved, c[3] - 2 * made.moved
    return jnp.stack(c)


def first_length(control: Any, order: int, y0, f0, f1, dt, end) -> Float[Array, ""]:
    """Return the first step's length [s], from the rates f0 at the start and f1 dt later.

    Each component of y0 counts as at least atol/rtol, the size at which the absolute and relative
    tolerances are equal: a start that is zero up to rounding gives no information about the step.
    Source: Hairer, Norsett, Wanner, Solving Ordinary Differential Equations I, II.4."""
    scale = control.atol + control.rtol * jnp.abs(y0)
    d0, d1, d2 = (
        control.norm(x / scale)
        for x in (jnp.maximum(jnp.abs(y0), control.atol / control.rtol), f0, (f1 - f0) / dt)
    )
    h0 = jnp.where(d1 < 1e-5, 1e-6, 0.01 * d0 / jnp.where(d1 > 0, d1, 1.0))
    most = jnp.maximum(d1, d2)
    h1 = jnp.where(
        most <= 1e-15,
        jnp.maximum(1e-6, 1e-3 * h0),
        root(order, 0.01 / jnp.where(most > 0, most, 1.0)),
    )
    h = jnp.minimum(jnp.minimum(100 * h0, h1), end)
    return jnp.where(jnp.isfinite(h), h, TRIAL * end)


def root(order: int, x: Array) -> Array:
    """Return x^(1/order) for the order of a method; for order 8 by three square roots, which are
    faster than a power."""
    if order == 8:
        return jnp.sqrt(jnp.sqrt(jnp.sqrt(x)))
    return x ** (1 / order)


def row_at(x: Array, i: Array) -> Array:
    """Return x[i]; for a single row without an index, so that a batch needs no gather."""
    return x[0] if len(x) == 1 else lax.dynamic_index_in_dim(x, i, 0, keepdims=False)


# Control of the steps


class Course(NamedTuple):
    """The state of step control: length of the next step, longest step that is accepted without a
    check between its ends, shortest step that an error has required, numbers of accepted and
    rejected steps, status."""

    h: Float[Array, ""]
    unseen: Float[Array, ""]
    shortest: Float[Array, ""]
    accepted: Int[Array, ""]
    rejected: Int[Array, ""]
    code: Int[Array, ""]


class Ahead(NamedTuple):
    """A step with a small error, which is checked at points between its ends before it is accepted.

    `at`: the points of the next check, either EVENLY spaced or the user's samples from the one with
    this index; `seen`: theta up to which the samples have been checked; `h`: length; `c`:
    coefficients of the polynomial of the step."""

    at: Int[Array, ""]
    seen: Float[Array, ""]
    h: Float[Array, ""]
    c: Float[Array, "m ny"]


def look_along(problem: InitialValueProblem, ahead: Ahead, tau, past: Float[Array, "nt"]) -> Look:
    """Return the points between the ends of a step at which it is checked next."""
    ahead, tau = lax.stop_gradient((ahead, tau))
    on = ahead.at != NOT_LOOKING
    # a look has as many points as a step has rates
    n = len(problem.method.A) + (problem.project is not None)

    def points():
        at_samples = jnp.minimum(
            (past[jnp.minimum(ahead.at + np.arange(n), len(past) - 1)] - tau) / ahead.h, 1.0
        )
        theta = jnp.where(ahead.at == EVENLY, np.arange(1, n + 1) / (n + 1), at_samples)
        return theta, jax.vmap(lambda theta: elementary_functions.polynomial(ahead.c, theta))(theta)

    theta, y = lax.cond(
        any_of_batch(on),
        points,
        lambda: (jnp.zeros(n, past.dtype), jnp.zeros((n, ahead.c.shape[1]), ahead.c.dtype)),
    )
    return Look(on, theta, y)


def controlled(
    problem: InitialValueProblem,
    course: Course,
    look: Look,
    ahead: Ahead,
    tau1,
    past,
    cut,
    error,
    change,
    defects,
):
    """Return whether a step is accepted, the state of step control after it, and the points of the
    next look (see Look) if it is not accepted yet.

    The error determines the length of the next step. A step needs looks if it follows a step whose
    error gave no information about it, or if it is much longer than the shortest of the run. It is
    accepted if its defect was small in all looks, and otherwise shortened to the part where it was
    small."""
    rules, h = problem.control, ahead.h
    good = error <= 1
    least = jnp.minimum(ROUNDED * jnp.finfo(h.dtype).eps / rules.rtol, LEAST_ERROR)
    factor = rules.safety / root(problem.method.order, jnp.maximum(error, least))
    factor = jnp.clip(factor, rules.factormin, jnp.where(good, rules.factormax, 1.0))
    longer = h * jnp.where(jnp.isfinite(error), factor, rules.factormin)
    # after a step that was cut at a kink
    longer = jnp.where(good & cut, jnp.maximum(longer, course.h), longer)
    needs_look = good & (h > course.unseen)
    quiet = (error < QUIET) | (change < 1)
    after = jnp.where(quiet, jnp.where(cut, LONGER * h, 0.0), SHARP * course.shortest)
    unseen = jnp.where(good, after, course.unseen)
    longer, unseen = (
        jnp.where(needs_look, course.h, longer),
        jnp.where(needs_look, course.unseen, unseen),
    )
    stepped = (
        good & ~needs_look,
        longer,
        unseen,
        jnp.where(needs_look, EVENLY, NOT_LOOKING),
        jnp.zeros_like(h),
        ~good,
        jnp.isfinite(error),
    )

    bad = jnp.min(jnp.where(defects <= 1, jnp.inf, look.theta))
    seen, clear = jnp.max(jnp.where(look.theta < bad, look.theta, ahead.seen)), bad > 1
    shorter = h * jnp.where(seen > 0, seen, bad / 2)
    first = jnp.searchsorted(past, tau1 - h, side="right", method="scan_unrolled").astype(
        ahead.at.dtype
    )
    sample = jnp.where(ahead.at == EVENLY, first, ahead.at + len(look.theta))
    done = clear & (row_at(past, jnp.minimum(sample, len(past) - 1)) >= tau1)
    at = jnp.where(clear & ~done, sample, NOT_LOOKING)
    seen = jnp.where(ahead.at == EVENLY, 0.0, seen)
    unseen = jnp.where(done, h, jnp.where(clear, course.unseen, 0.0))
    looked = (
        jnp.array(False),
        jnp.where(clear, course.h, shorter),
        unseen,
        at,
        seen,
        ~clear,
        jnp.array(True),
    )

    good, longer, unseen, at, seen, refused, finite = (
        jnp.where(look.on, a, b) for a, b in zip(looked, stepped, strict=True)
    )
    small = jnp.where(finite, Status.DT_MIN.value, Status.NONFINITE.value)
    accepted, rejected = (
        count + one.astype(count.dtype)
        for count, one in ((course.accepted, good), (course.rejected, refused))
    )
    code = jnp.where(refused & (longer < rules.dtmin), small, Status.OK.value)
    shortest = jnp.where(refused, jnp.minimum(course.shortest, longer), course.shortest)
    return (
        good,
        Course(longer, unseen, shortest, accepted, rejected, code),
        ahead._replace(at=at, seen=seen),
    )
