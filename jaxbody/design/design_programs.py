"""The quantities of a design and their exact derivatives as one compiled program."""

import math
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, device_array, indices, module_of
from jaxbody.core.compilation.compile_options import OPTIMIZED, program_with
from jaxbody.core.errors import JaxbodyError, Problem, Problems, check_known, unknown
from jaxbody.core.jax_internals import REST_HAS_DERIVATIVES, jaxpr_as_fun, only_what_is_needed
from jaxbody.core.results import Result
from jaxbody.core.workers.batches import batch_of, computed
from jaxbody.core.workers.executors import crew_of
from jaxbody.design.searches import DesignVector, Rows, Search, run_in_worker
from jaxbody.fitting.parameters.spaces import Space

MOST_FORWARD = 30  # free numbers up to which forward mode is faster

Quantities = dict[str, Array]
Evaluate = Callable[..., Any]
Shapes = tuple[tuple[str, tuple[int, ...]], ...]  # names and shapes of quantities
NamedLimits = dict[str, tuple[float, float]]


class OfQuantities(Result):
    """The base class of results that have one row for each of the named `quantities`."""

    quantities: tuple[str, ...] = eqx.field(static=True, kw_only=True)

    def row(self, quantity: str) -> int:
        check_known(quantity, type(self).__name__.lower(), self.quantities)
        return self.quantities.index(quantity)


@dataclass(eq=False)
class Program:
    """All quantities and their derivatives at u, the vector of the free parameters, as one compiled
    program.

    Args:
        space: the free parameters.
        evaluate: model -> quantities.
        minimize, limits: the objective and the limits of other quantities, by name.
        reverse: derivatives by reverse mode; None decides by the number of parameters.
        key: random key for stochastic objectives, otherwise None.
        progress: True prints every evaluation to stderr.
        line: function that shows a progress line.
    """

    space: Space
    evaluate: Evaluate
    minimize: str
    limits: NamedLimits
    reverse: bool | None = None
    key: Any = None
    progress: bool | None = False
    line: Callable[[str], None] = lambda words: None
    count: int = 0  # number of evaluations
    place: str = ""  # prefix of progress lines, with the number of the start
    shapes: Shapes = ()

    def __call__(self, u: DesignVector) -> tuple[np.ndarray, np.ndarray]:
        """Return the values (m,) of all quantities at u and their Jacobian (m, n)."""
        self.count += 1
        values, slopes, self.shapes = values_and_slopes(
            self.space, self.evaluate, self.reverse, device_array(u), self.key
        )
        values, slopes = np.asarray(values), np.asarray(slopes)
        objective = np.ravel(self.quantities(values).get(self.minimize, np.nan))[0]
        known = f", {self.minimize} {objective:.6g}" if np.isfinite(objective) else ""
        message = f"{self.place}evaluation {self.count}{known}"
        self.line(message)
        if self.progress:
            print(message, file=sys.stderr, flush=True)
        return values, slopes

    @property
    def rows(self) -> Rows:
        owners = np.repeat(
            [name for name, _ in self.shapes], [math.prod(x) for _, x in self.shapes]
        )
        limited = [
            (row, *ends)
            for name, ends in self.limits.items()
            for row in np.flatnonzero(owners == name)
        ]
        rows, lower, upper = np.reshape(limited, (-1, 3)).T
        return Rows(int(np.argmax(owners == self.minimize)), rows.astype(int), lower, upper)

    def quantities(self, values: np.ndarray) -> Quantities:
        return split(values, self.shapes)


def search_by_workers(
    program: Program, searches: list[Search], workers: Any, **options: Any
) -> list[Search]:
    """Return the searches after workers have run them; a search whose worker is lost ends without
    finite values.

    options: method, iterations and tolerance, as in `run`."""
    evaluate, reverse, where = program.evaluate, program.reverse, "tune.workers"
    starts = np.asarray(device_array(np.stack([search.start for search in searches])))

    def both(space, u):
        values, slopes, _ = values_and_slopes(space, evaluate, reverse, u[0], None)
        return {"values": values[None], "slopes": slopes[None]}

    def report(done: int, workers: int) -> None:
        program.line(f"{done} of {len(searches)} starts")

    ended = list(searches)
    with crew_of(workers, where) as crew:
        batch = batch_of(
            both,
            program.space,
            lambda i, j: [starts[i:j]],
            len(searches),
            width=1,
            where=where,
            owner=evaluate,
            place=("tune", reverse),
        )
        sent: Any = dict(
            rows=lambda i, j: searches[i:j], function=partial(run_in_worker, **options)
        )
        batch = replace(batch, **sent)
        for i, answer in computed(batch, crew, range(len(searches)), where, report):
            if answer is None:
                m = len(labels_of(program.shapes))
                nothing = np.full(m, np.nan), np.full((m, starts.shape[1]), np.nan)
                searches[i].keep(searches[i].start, *nothing)
            else:
                ended[i] = answer.results["search"]  # pyright: ignore
                program.count += ended[i].evaluations
    return ended


class Flat:
    """All quantities as one vector, a function of u; their names and shapes are known after the
    first evaluation."""

    def __init__(self, space: Space, evaluate: Evaluate, *more: Any):
        self.space, self.evaluate, self.more = space, evaluate, more
        self.shapes: Shapes = ()

    def __call__(self, u: Float[Array, "n"]) -> Float[Array, "m"]:
        quantities = evaluated(self.evaluate, *self.space.arguments(u), *self.more)
        self.shapes = tuple((name, x.shape) for name, x in quantities.items())
        return jnp.concatenate([x.ravel() for x in quantities.values()])


def split(values: Float[Array, "*b m"], shapes: Shapes) -> Quantities:
    """Return the quantities {name: array} that are concatenated in a vector, or in a batch of
    vectors."""
    ends = np.cumsum([math.prod(shape) for _, shape in shapes])[:-1]
    parts = module_of(values).split(values, ends, axis=-1)
    return {
        name: part.reshape((*values.shape[:-1], *shape))
        for (name, shape), part in zip(shapes, parts, strict=True)
    }


def variables_over(axes: tuple[str, ...], named: dict[str, Any]) -> dict[str, Any]:
    """Return `named` arrays as variables of a dataset whose first dimensions are `axes`."""
    return {
        name: ((*axes, *(f"{name}_{i}" for i in range(np.ndim(x) - len(axes)))), x, "")
        for name, x in named.items()
    }


def labels_of(shapes: Shapes) -> list[str]:
    """Return a label for each number of the quantities, such as "frequency[0]"."""
    return [name + index for name, shape in shapes for index in indices(shape)]


@program_with(OPTIMIZED)
def values_and_slopes(
    space: Space, evaluate: Evaluate, reverse: bool | None, u: Float[Array, "n"], key: Any
):
    """Return values, derivatives and shapes of all quantities. Another objective or other limits
    need no new compilation.

    Args:
        space, evaluate, reverse, key: as in `Program`.
        u: the free parameters.
    """
    flat = Flat(space, evaluate, *(() if key is None else (key,)))
    if u.size > MOST_FORWARD if reverse is None else reverse:
        values, pull = jax.vjp(needed(flat, u), u)
        slopes = jax.vmap(lambda y: pull(y)[0])(jnp.eye(values.size))
    else:
        values, slopes = value_and_forward_slopes(flat, u)
    return values, slopes, flat.shapes


def value_and_forward_slopes(
    function: Callable[[Array], Array], u: Float[Array, "n"]
) -> tuple[Float[Array, "m"], Float[Array, "m n"]]:
    """Return the value of a function at u and its Jacobian, by one linearization, or direction by
    direction if the function has loops of unknown length, such as simulations."""
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
    """Return the function without operations that its result does not need, because differentiating
    these would take as long as compiling the rest."""
    if not REST_HAS_DERIVATIVES:
        return function
    kept = only_what_is_needed(jax.make_jaxpr(function)(u))
    return lambda u: jaxpr_as_fun(kept)(u)[0]


def evaluated(evaluate: Evaluate, *given: Any) -> Quantities:
    """Return the quantities {name: array} that `evaluate` returns while JAX traces it. Error:
    BAD_OBJECTIVE."""
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
        raise JaxbodyError(
            Problem(
                "BAD_OBJECTIVE",
                "evaluate",
                (
                    "converts a traced JAX number to a Python or NumPy number: "
                    f"{str(error).splitlines()[0]}"
                ),
                hint=hint,
            )
        ) from error
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
            problems.add(
                "BAD_OBJECTIVE",
                f"evaluate[{program.minimize!r}]",
                f"has shape {shape}",
                value=shape,
                limit="one number",
                hint="Minimize one number; limit the others.",
            )


def limits_of(limits: dict[str, Any]) -> NamedLimits:
    """Return the limits {name: (lower, upper)} with infinite ends in place of None. Error:
    BAD_LIMITS."""
    if not isinstance(limits, dict):
        raise JaxbodyError(
            Problem(
                "BAD_LIMITS",
                "tune.limits",
                f"is {limits!r:.60}",
                limits,
                "{name: (lower, upper)}",
            )
        )
    parsed = {}
    with Problems() as problems:
        for name, given in limits.items():
            message, allowed = f"is {given!r:.60}", ""
            try:
                lower, upper = (
                    (given, given)
                    if np.ndim(given) == 0 and not isinstance(given, tuple)
                    else given
                )
                parsed[name] = ends = (
                    -np.inf if lower is None else float(lower),
                    np.inf if upper is None else float(upper),
                )
            except (TypeError, ValueError):
                allowed = "(lower, upper), a number, or None for either"
            else:
                if np.isnan(ends).any() or ends == (-np.inf, np.inf):
                    allowed = "a number at one end or both"
                elif ends[0] > ends[1]:
                    message = f"has lower {ends[0]:g} > upper {ends[1]:g}"
                    allowed = "lower <= upper"
            if allowed:
                where = f"tune.limits[{name!r}]"
                problems.add("BAD_LIMITS", where, message, value=given, limit=allowed)
    return parsed


def not_finite(program: Program, searches: Sequence[Search]) -> JaxbodyError:
    """Return the error for the case that no search could begin: values that are not finite at the
    first start, or derivatives that are not finite where values are. Code: NONFINITE_START."""
    labels, rows, first = labels_of(program.shapes), program.rows, searches[0]
    if any(rows.finite(search.values) for search in searches):
        given = first.slopes
        bad = [
            f"'{labels[i]}' by '{name}'"
            for i in rows.requested
            for name, x in zip(program.space.labels, first.slopes[i], strict=True)
            if not np.isfinite(x)
        ]
        message = (
            "has derivatives that are not finite at the start: of "
            f"{', '.join(bad[:4])}{', ...' if len(bad) > 4 else ''}"
        )
        hint = (
            "Look for square roots and norms of zero, or simulate(adjoint=...); smooth quantities "
            "are in jb.objectives."
        )
    else:
        given = first.values
        bad = [f"{labels[i]} = {given[i]}" for i in rows.requested if not np.isfinite(given[i])]
        message = f"returns {', '.join(bad)} at the start"
        if len(searches) > 1:
            message += f", and no finite values at any of {len(searches)} starts"
        hint = "Check evaluate(model): an equilibrium may not exist, or a mode may be unstable."
    return JaxbodyError(Problem("NONFINITE_START", "tune.evaluate", message, given, "finite", hint))
