"""The quantities of a design and their exact derivatives as one compiled program, for one u or
a batch."""

from __future__ import annotations

import dataclasses
import sys
from collections.abc import Callable
from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, device_array, indices, module_of
from jaxbody.core.compilation.compile_options import OPTIMIZED, program_with
from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.core.jax_internals import REST_HAS_DERIVATIVES, jaxpr_as_fun, only_what_is_needed
from jaxbody.core.workers.batches import batch_of, computed
from jaxbody.core.workers.executors import crew_of
from jaxbody.design.searches import Rows, Search, end_at, searched
from jaxbody.fitting.parameters.spaces import Space
from jaxbody.model.sizes import is_costly

MOST_FORWARD = 30  # free numbers up to which forward mode is faster

Quantities = dict[str, Array]
Evaluate = Callable[..., Any]
Shapes = tuple[tuple[str, tuple[int, ...]], ...]  # names and shapes of quantities
NamedLimits = dict[str, tuple[float, float]]


class Program:
    """All quantities and their derivatives at a batch of u.

    Args:
        space: the free parameters.
        evaluate: model -> quantities.
        minimize, limits: the objective and the limits of other quantities, by name.
        width: number of u in a batch.
        reverse: derivatives by reverse mode; None decides by the number of parameters.
        key: random key for stochastic objectives, otherwise None.
        progress: True prints every evaluation to stderr.
        line: shows a progress line.
    """

    def __init__(
        self,
        space: Space,
        evaluate: Evaluate,
        minimize: str,
        limits: NamedLimits,
        *,
        width: int,
        reverse: bool | None = None,
        key: Any = None,
        progress: bool | None = False,
        line: Callable[[str], None] = lambda words: None,
    ):
        self.space, self.evaluate, self.minimize, self.limits = space, evaluate, minimize, limits
        self.width, self.reverse, self.key, self.progress, self.line = (
            width,
            reverse,
            key,
            progress,
            line,
        )
        self.count = 0
        self.shapes: Shapes = ()
        self.origin = np.zeros(0)

    def __call__(self, U: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Values (b, m) and Jacobians (b, m, n), in batches of the compiled width."""
        self.count += 1
        filled = np.concatenate([U, np.repeat(U[-1:], -len(U) % self.width, 0)]).reshape(
            -1, self.width, U.shape[1]
        )
        parts = []
        for batch in filled:
            u = device_array(batch if self.width > 1 else batch[0])
            values, slopes, self.shapes = values_and_slopes(
                self.space, self.evaluate, self.reverse, u, self.key
            )
            parts.append(
                (
                    np.asarray(values).reshape(self.width, -1),
                    np.asarray(slopes).reshape(self.width, *slopes.shape[-2:]),
                )
            )
        values, slopes = (np.concatenate(part)[: len(U)] for part in zip(*parts, strict=True))
        message = f"evaluation {self.count}{self._least(values)}"
        self.line(message)
        if self.progress:
            print(message, file=sys.stderr, flush=True)
        return values, slopes

    def _least(self, values: np.ndarray) -> str:
        """The least objective of all starts, as text."""
        known = {self.minimize, *self.limits} <= set(dict(self.shapes))
        finite = [f for f in values[:, self.rows.objective] if np.isfinite(f)] if known else []
        of = f", the least of {len(values)}" if len(values) > 1 else ""
        return f", {self.minimize} {min(finite):.6g}{of}" if finite else ""

    @property
    def rows(self) -> Rows:
        ends = np.cumsum([0] + [int(np.prod(shape)) for _, shape in self.shapes])
        rows_of = {
            name: np.arange(i, j)
            for (name, _), i, j in zip(self.shapes, ends[:-1], ends[1:], strict=True)
        }
        rows = [rows_of[name] for name in self.limits]
        lower, upper = (
            np.concatenate(
                [
                    np.zeros(0),
                    *(
                        np.full(len(r), limit[k])
                        for r, limit in zip(rows, self.limits.values(), strict=True)
                    ),
                ]
            )
            for k in (0, 1)
        )
        return Rows(
            int(rows_of[self.minimize][0]),
            np.concatenate([np.zeros(0, int), *rows]).astype(int),
            lower,
            upper,
        )

    def labels(self) -> list[str]:
        """The name of every value."""
        return labels_of(self.shapes)

    def quantities(self, values: np.ndarray) -> Quantities:
        return split(values, self.shapes)


def search_by_workers(
    program: Program, searches: list[Search], workers: Any, **options: Any
) -> None:
    """Run searches in chunks of the width of the program; those of a lost chunk end without
    finite values.

    options: method, iterations and tolerance, as in `run`."""
    evaluate, reverse, where = program.evaluate, program.reverse, "tune.workers"

    def both(space, u):
        values, slopes, _ = values_and_slopes(space, evaluate, reverse, u, None)
        return {"values": values, "slopes": slopes}

    given = [
        np.stack([getattr(search, name) for search in searches])
        for name in ("start", "low", "high")
    ]
    starts, by = np.asarray(device_array(given[0])), partial(searched, of=program.rows, **options)
    most = 0

    def report(done: int, workers: int) -> None:
        program.line(f"{done} of {len(searches)} starts")

    with crew_of(workers, where) as crew:
        kept: Any = dict(owner=evaluate, place=("tune", reverse))
        batch = batch_of(
            both,
            program.space,
            lambda i, j: [starts[i:j]],
            len(searches),
            width=program.width,
            where=where,
            crew=crew,
            **kept,
        )
        batch = dataclasses.replace(batch, rows=lambda i, j: [x[i:j] for x in given], function=by)
        for chunk, answer in computed(batch, crew, range(batch.chunks), where, report):
            first, last = batch.ends(chunk)
            for i in range(first, last):
                if answer is None:
                    m = sum(int(np.prod(shape)) for _, shape in program.shapes)
                    searches[i].keep(
                        given[0][i], np.full(m, np.nan), np.full((m, given[0].shape[1]), np.nan)
                    )
                else:
                    end_at(searches[i], answer.results, i - first)
            most = max(most, 0 if answer is None else int(answer.results["count"][0]))
    program.count += most


class Flat:
    """All quantities as one vector, a function of u, and their names and shapes, once it has
    been evaluated."""

    def __init__(self, space: Space, evaluate: Evaluate, *more: Any):
        self.space, self.evaluate, self.more = space, evaluate, more
        self.shapes: Shapes = ()

    def __call__(self, u: Float[Array, "n"]) -> Float[Array, "m"]:
        quantities = evaluated(self.evaluate, self.space.designed(u)[0], *self.more)
        self.shapes = tuple((name, x.shape) for name, x in quantities.items())
        return jnp.concatenate([x.ravel() for x in quantities.values()])


def split(values: Float[Array, "*b m"], shapes: Shapes) -> Quantities:
    """The quantities in one vector or in a batch of them."""
    ends = np.cumsum([int(np.prod(shape)) for _, shape in shapes])[:-1]
    parts = module_of(values).split(values, ends, axis=-1)
    return {
        name: part.reshape((*values.shape[:-1], *shape))
        for (name, shape), part in zip(shapes, parts, strict=True)
    }


def variables_over(axis: str, named: dict[str, Any]) -> dict[str, tuple[tuple[str, ...], Any, str]]:
    """Variables of a dataset, the first axis of each with this name."""
    return {
        name: ((axis, *(f"{name}_{i}" for i in range(np.ndim(x) - 1))), x, "")
        for name, x in named.items()
    }


def labels_of(shapes: Shapes) -> list[str]:
    """The name of each number of quantities: "frequency[0]"."""
    return [name + index for name, shape in shapes for index in indices(shape)]


def _runs_long(
    space: Space, evaluate: Evaluate, reverse: bool | None, u: Float[Array, "*b n"], key: Any
) -> bool:
    """True for batches, because workers optimize theirs and have to find the same numbers."""
    return u.ndim > 1 or is_costly(space.model)


@program_with(OPTIMIZED)
def values_and_slopes(
    space: Space, evaluate: Evaluate, reverse: bool | None, u: Float[Array, "*b n"], key: Any
):
    """Values, derivatives and shapes of all quantities; the choice of the objective and the limits
    needs no new compilation.

    Args:
        space, evaluate, reverse, key: as in `Program`.
        u: one vector of free parameters (n,) or a batch (b, n).
    """
    flat = Flat(space, evaluate, *(() if key is None else (key,)))

    def both(u):
        if not (u.size > MOST_FORWARD if reverse is None else reverse):
            return value_and_forward_slopes(flat, u)
        values, pull = jax.vjp(needed(flat, u), u)
        return values, jax.vmap(lambda y: pull(y)[0])(jnp.eye(values.size))

    values, slopes = both(u) if u.ndim == 1 else jax.vmap(both)(u)
    return values, slopes, flat.shapes


def value_and_forward_slopes(
    function: Callable[[Array], Array], u: Float[Array, "n"]
) -> tuple[Float[Array, "m"], Float[Array, "m n"]]:
    """The value and the Jacobian by one linearization, or direction by direction if the function
    has loops of unknown length, such as simulations."""
    function = needed(function, u)
    if u.size == 1:
        values, slopes = jax.jvp(function, (u,), (jnp.ones_like(u),))
        return values, slopes[:, None]
    try:
        values, tangent = jax.linearize(function, u)
    except ValueError:

        def both(u):
            values = function(u)
            return values, values

        slopes, values = jax.jacfwd(both, has_aux=True)(u)
        return values, slopes
    # one after the other, so that data stay in the cache
    return values, jax.lax.map(tangent, jnp.eye(u.size)).T


def needed(function: Callable[[Array], Array], u: Float[Array, "n"]) -> Callable[[Array], Array]:
    """The function without computations that its result does not need, because differentiating
    these would take as long as compiling the rest."""
    if not REST_HAS_DERIVATIVES:
        return function
    kept = only_what_is_needed(jax.make_jaxpr(function)(u))
    return lambda u: jaxpr_as_fun(kept)(u)[0]


def evaluated(evaluate: Evaluate, *given: Any) -> Quantities:
    """The quantities {name: array} that `evaluate` returns while JAX traces it.
    Error: BAD_OBJECTIVE."""
    hint = (
        "Return {name: number or array} or one number, computed with JAX: no float(), NumPy "
        "functions or `if` on numbers of the model."
    )
    if not callable(evaluate):
        raise JaxbodyError(
            Problem(
                "BAD_OBJECTIVE",
                "evaluate",
                f"is {evaluate!r:.60}",
                evaluate,
                "a function of the model",
                hint,
            )
        )
    try:
        result = evaluate(*given)
    except (jax.errors.ConcretizationTypeError, jax.errors.TracerArrayConversionError) as error:
        message = (
            "converts a traced JAX number to a Python or NumPy number: "
            f"{str(error).splitlines()[0]}"
        )
        raise JaxbodyError(Problem("BAD_OBJECTIVE", "evaluate", message, hint=hint)) from error
    named = result if isinstance(result, dict) else {"objective": result}
    try:
        quantities: Quantities = {str(name): jnp.asarray(x, float) for name, x in named.items()}
    except (TypeError, ValueError):
        quantities = {}
    if not quantities:
        raise JaxbodyError(
            Problem("BAD_OBJECTIVE", "evaluate", f"returns {result!r:.80}", result, "numbers", hint)
        ) from None
    return quantities


def check_names(program: Program) -> None:
    """Check that the objective and the limited quantities exist and that the objective is
    a scalar."""
    shapes = dict(program.shapes)
    with Problems() as problems:
        for where, names in (
            ("tune.minimize", (program.minimize,)),
            ("tune.limits", program.limits),
        ):
            problems.collected += [
                unknown(name, where, tuple(shapes)) for name in names if name not in shapes
            ]
        shape = shapes.get(program.minimize, ())
        if shape:
            hint = "Minimize one number; limit the others."
            problems.add(
                "BAD_OBJECTIVE",
                f"evaluate[{program.minimize!r}]",
                f"has shape {shape}",
                value=shape,
                limit="one number",
                hint=hint,
            )


def limits_of(limits: dict[str, Any]) -> NamedLimits:
    """{name: (lower, upper)}."""
    parsed = {}
    with Problems() as problems:
        if not isinstance(limits, dict):
            problems.add(
                "BAD_LIMITS",
                "tune.limits",
                f"is {limits!r:.60}",
                value=limits,
                limit="{name: (lower, upper)}",
            )
            problems.raise_if_any()
        for name, given in limits.items():
            where = f"tune.limits[{name!r}]"
            try:
                lower, upper = (
                    (given, given)
                    if np.ndim(given) == 0 and not isinstance(given, tuple)
                    else given
                )
                ends = (
                    -np.inf if lower is None else float(lower),
                    np.inf if upper is None else float(upper),
                )
            except (TypeError, ValueError):
                problems.add(
                    "BAD_LIMITS",
                    where,
                    f"is {given!r:.60}",
                    value=given,
                    limit="(lower, upper), a number, or None for either",
                )
                continue
            if np.isnan(ends).any() or ends == (-np.inf, np.inf):
                problems.add(
                    "BAD_LIMITS",
                    where,
                    f"is {given!r:.60}",
                    value=given,
                    limit="a number at one end or both",
                )
            elif not ends[0] <= ends[1]:
                problems.add(
                    "BAD_LIMITS",
                    where,
                    f"has lower {ends[0]:g} > upper {ends[1]:g}",
                    value=given,
                    limit="lower <= upper",
                )
            parsed[name] = ends
    return parsed


def check_start(program: Program, U: np.ndarray) -> None:
    """Evaluate all starts, the first of which is the model itself. Error: NONFINITE_START if none
    is finite, with details of the first."""
    values, _ = program(U)
    check_names(program)
    program.origin = values[0]
    rows = program.rows.requested
    if np.isfinite(values[:, rows]).all(-1).any():
        return
    labels = program.labels()
    bad = [
        f"{labels[i]} = {values[0, i]}"
        for i in dict.fromkeys(rows)
        if not np.isfinite(values[0, i])
    ]
    message = f"returns {', '.join(bad)} at the start" + (
        f", and no finite values at any of {len(U)} starts" if len(U) > 1 else ""
    )
    hint = "Check evaluate(model): an equilibrium may not exist, or a mode may be unstable."
    raise JaxbodyError(
        Problem("NONFINITE_START", "tune.evaluate", message, values[0], "finite", hint)
    )


def check_slopes(program: Program, search: Search) -> None:
    """Report derivatives that are not finite at any start. Error: NONFINITE_START."""
    labels, names = program.labels(), program.space.labels
    bad = [
        f"'{labels[i]}' by '{name}'"
        for i in dict.fromkeys(program.rows.requested)
        for name, x in zip(names, search.slopes[i], strict=True)
        if not np.isfinite(x)
    ]
    message = f"has derivatives that are not finite at the start: of {', '.join(bad[:4])}" + (
        ", ..." if len(bad) > 4 else ""
    )
    hint = (
        "Look for square roots and norms of zero, or simulate(adjoint=...); smooth quantities "
        "are in jb.objectives."
    )
    raise JaxbodyError(
        Problem("NONFINITE_START", "tune.evaluate", message, search.slopes, "finite", hint)
    )
