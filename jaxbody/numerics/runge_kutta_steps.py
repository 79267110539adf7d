"""A step of an explicit Runge-Kutta method, its error, and the polynomial between its ends.

    k_i = h f(t + c_i h, y + sum_j a_ij k_j),   y(t + h) = y + sum_i b_i k_i,   error = sum_i e_i k_i
    y(t + theta h) = y + sum_i p_i(theta) k_i,  p_i a polynomial without a constant

The coefficients are those of a solver of diffrax; by default Dopri8 (Prince, Dormand, J. Comp. Appl. Math. 7 (1981) 67).
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

from jaxbody.core.arrays import Array, Bool, Float
from jaxbody.numerics.lanes import vmap_last

DEGREE = 6  # at most, of the polynomial between the ends of a step
ZERO = 1e-12  # coefficients of that polynomial below this are round-off


class Method:
    """The coefficients of a solver, as stages of which the last one starts the next step.

    A: (stages - 1, stages), its last row is b; C: (stages - 1,); E: (stages,); P: (degree, stages), of theta, theta^2 ...; order."""

    def __init__(self, solver: diffrax.AbstractERK):
        tableau: Any = solver.tableau
        rows = tableau.a_lower if tableau.fsal else (*tableau.a_lower, tableau.b_sol)
        stages = len(rows) + 1
        self.A = np.array([np.pad(row, (0, stages - len(row))) for row in rows])
        self.C = np.append(tableau.c, np.ones(stages - 1 - len(tableau.c)))
        self.E = np.pad(tableau.b_error, (0, stages - len(tableau.b_error)))
        P = _polynomials(solver, tableau.b_sol)
        self.P = np.pad(P, ((0, 0), (0, stages - P.shape[1])))
        self.order: Any = solver.order(diffrax.ODETerm(lambda t, y, args: y))


@functools.cache
def method_of(solver: diffrax.AbstractERK) -> Method:
    """The coefficients of a solver of diffrax, worked out once."""
    return Method(solver)


def _polynomials(solver: diffrax.AbstractERK, b: np.ndarray) -> np.ndarray:
    """P of the solver's interpolation, from its table of coefficients or else from its values at some theta."""
    interpolation: Any = solver.interpolation_cls
    if hasattr(interpolation, "eval_coeffs"):
        return np.asarray(interpolation.eval_coeffs)[:, ::-1].T
    theta = np.linspace(0.0, 1.0, DEGREE + 1)
    with jax.ensure_compile_time_eval():
        between = interpolation(t0=0.0, t1=1.0, y0=jnp.zeros(len(b)), y1=jnp.asarray(b), k=jnp.eye(len(b)))
        values = np.array([between.evaluate(jnp.asarray(x)) for x in theta])
    P = np.linalg.solve(np.vander(theta, increasing=True), values)[1:]
    P[np.abs(P) < ZERO] = 0.0
    return P[: np.flatnonzero(P.any(1))[-1] + 1]


class InitialValueProblem(NamedTuple):
    """y' = rate(u, y, arguments) with u = drive(t, arguments), the part that depends on time alone.

    `project`: project(u, y, at_y, arguments), the state next to y that fulfils conditions which a solution fulfils, with what `rate` then
    returns at y besides y'; None without such conditions. `control`: a diffrax.PIDController that states tolerances, smallest step and
    limits of step control; None for constant steps; `first`: the first or the constant step; `max_steps`: most steps; `kinks`: ascending
    times of kinks of the rate, at which steps end."""

    drive: Callable[[Array, Any], Any]
    rate: Callable[[Any, Array, Any], Array]
    method: Method
    max_steps: int
    control: Any
    first: Float[Array, ""] | None = None
    kinks: Float[Array, "nk"] | None = None
    project: Callable[[Any, Array, Any, Any], Array] | None = None


def rate(problem: InitialValueProblem, arguments, t, y):
    """y' at the time t."""
    there = problem.rate(problem.drive(t, arguments), y, arguments)
    return there if problem.project is None else there[0]


class Step(NamedTuple):
    """The state after a step and its rate, and the k_i; with a projection P also P(y1) - y1, and P(y1) - P(y1 - error), what is left of the
    error after it."""

    y: Float[Array, "ny"]
    f: Float[Array, "ny"]
    k: Float[Array, "stages ny"]
    moved: Float[Array, "ny"] | None = None
    error: Float[Array, "ny"] | None = None


def step(problem: InitialValueProblem, arguments, t, y, f, h, trial: Bool[Array, ""] | None = None) -> Step:
    """A step of length h.

    A trial step has only two stages, k_1 = h f(t, y) and the rate a little later; a separate function would compile the rate twice. For the
    same reason the projection, with the rate there, is one more stage."""
    method, project = problem.method, problem.project
    carry: Any
    stages = len(method.A) + 1

    def stage(carry, row):
        k, _, _ = carry
        a, u, i = row
        y_i = y + _sum(a, k)
        f_i = problem.rate(u, y_i, arguments)
        return (lax.dynamic_update_index_in_dim(k, h * f_i, i, 0), y_i, f_i), None

    def stage_or_projection(carry, row):
        k, y1, _, _, error, at_y = carry
        a, u, i = row

        def projected():
            both = jnp.stack([y1, y1 - _sum(method.E, k[:stages])])
            there, other = jax.vmap(lambda y: problem.project(u, y, at_y, arguments))(both)  # pyright: ignore[reportOptionalCall]
            return there, there - y1, there - other

        last = jax.checkpoint(projected) if trial is None else projected  # which would repeat the states for each tangent of forward mode
        y_i, moved, error = lax.cond(i == stages, last, lambda: (y + _sum(a, k), error, error))
        f_i, at_y = problem.rate(u, y_i, arguments)
        return (lax.dynamic_update_index_in_dim(k, h * f_i, i, 0), y_i, f_i, moved, error, at_y), None

    A, C = method.A, method.C
    if project is not None:
        A, C = np.concatenate([A, A[-1:]]), np.append(C, C[-1])
    c = C if trial is None else jnp.where(trial, np.array([0.0, A[1, 1], *C[2:]]), C)  # of a trial step, which begins with f = 0
    driven = vmap_last(lambda t: problem.drive(t, arguments))(t + c * h)  # for all stages at once
    k = jnp.zeros((len(A) + 1, len(y)), y.dtype).at[0].set(h * f)
    rows = jnp.asarray(A, y.dtype), jax.tree.map(lambda x: jnp.moveaxis(x, -1, 0), driven), np.arange(1, len(A) + 1)
    carry, one = (k, y, f), stage
    if project is not None:
        u = jax.tree.map(lambda x: x[0], rows[1])
        at_y = jax.eval_shape(lambda u, y, arguments: problem.rate(u, y, arguments)[1], u, y, arguments)
        still = jnp.zeros_like(y)
        carry, one = (*carry, still, still, jax.tree.map(lambda x: jnp.zeros(x.shape, x.dtype), at_y)), stage_or_projection
    if trial is None:
        carry, _ = lax.scan(one, carry, rows)
    else:
        last = jnp.where(trial, np.uint32(2), np.uint32(len(A)))  # unsigned, as each row would check whether i is negative
        carry = lax.fori_loop(np.uint32(0), last, lambda i, carry: one(carry, jax.tree.map(lambda x: row_at(x, i), rows))[0], carry)
    if project is None:
        k, y, f = carry
        return Step(y, f, k)
    k, y, f, moved, error, _ = carry
    return Step(y, f, k[:stages], moved, error)


def error_ratio(problem: InitialValueProblem, y, made: Step) -> Float[Array, ""]:
    """A step's error over its tolerance."""
    scale = problem.control.atol + problem.control.rtol * jnp.maximum(jnp.abs(y), jnp.abs(made.y))
    return problem.control.norm((_sum(problem.method.E, made.k) if made.error is None else made.error) / scale)


def rows_of_polynomial(problem: InitialValueProblem) -> int:
    """The number of coefficients of the polynomial of a step."""
    rows = len(problem.method.P) + 1
    return rows if problem.project is None else max(rows, 4)


def _sum(a, k: Float[Array, "n ny"]) -> Float[Array, "ny"]:
    """sum of a_i k_i, term by term: loops over ny are fast, a reduction over n is not (xla_workarounds)."""
    terms = [a[i] * k[i] for i in range(len(k)) if isinstance(a, jax.Array) or a[i] != 0]
    return sum(terms[1:], terms[0])


def polynomial(method: Method, y, made: Step) -> Float[Array, "n ny"]:
    """c_0, c_1 ... of the state c_0 + c_1 theta + ... in the step, with theta^2 (3 - 2 theta) (P(y1) - y1) where it ends projected."""
    c = [y, *(_sum(p, made.k) for p in method.P)]
    if made.moved is not None:
        c += [jnp.zeros_like(y)] * (4 - len(c))
        c[2], c[3] = c[2] + 3 * made.moved, c[3] - 2 * made.moved
    return jnp.stack(c)


def first_length(problem: InitialValueProblem, y0, f0, f1, dt, end) -> Float[Array, ""]:
    """The first step's length, from the rates at the start and dt later. Source: Hairer, Norsett, Wanner, Solving Ordinary Differential
    Equations I, II.4."""
    if problem.first is not None:
        return problem.first
    control = problem.control
    scale = control.atol + control.rtol * jnp.abs(y0)
    d0, d1, d2 = (control.norm(x / scale) for x in (y0, f0, (f1 - f0) / dt))
    h0 = jnp.where((d0 < 1e-5) | (d1 < 1e-5), 1e-6, 0.01 * d0 / jnp.where(d1 > 0, d1, 1.0))
    most = jnp.maximum(d1, d2)
    h1 = jnp.where(most <= 1e-15, jnp.maximum(1e-6, 1e-3 * h0), root(problem.method, 0.01 / jnp.where(most > 0, most, 1.0)))
    h = jnp.minimum(jnp.minimum(100 * h0, h1), end)
    return jnp.where(jnp.isfinite(h), h, control.dtmin)


def root(method: Method, x: Array) -> Array:
    """The root whose degree is the order of the method; roots of roots are faster than a power."""
    if method.order == 8:
        return jnp.sqrt(jnp.sqrt(jnp.sqrt(x)))
    return x ** (1 / method.order)


def row_at(x: Array, i: Array) -> Array:
    """x[i]; for a single row without an index, so that a batch needs no gather."""
    return x[0] if len(x) == 1 else lax.dynamic_index_in_dim(x, i, 0, keepdims=False)
