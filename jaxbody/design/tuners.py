"""Design optimization: choose the free parameters of a model to minimize one quantity within limits
on others, by exact gradients.

    minimize f(x),   lower <= c(x) <= upper,   x between bounds,
    f and c any JAX functions of the model

One function of the model returns all quantities; they and their exact derivatives are one compiled
program.
"""

import inspect
from collections.abc import Iterable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import optax

from jaxbody.core.arguments import check_key, checked_dict, positive_number, whole_number
from jaxbody.core.arrays import device_array, float_array, is_concrete
from jaxbody.core.compilation.compile_options import OPTIMIZED, program_with
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.core.progress_lines import working
from jaxbody.core.results import warn_if_failed
from jaxbody.core.workers.executors import check_workers
from jaxbody.design.design_programs import (
    Evaluate,
    Program,
    check_names,
    evaluated,
    limits_of,
    not_finite,
    search_by_workers,
)
from jaxbody.design.searches import MET, METHODS, Search, one_thread, run
from jaxbody.design.tuning_results import Tuning, tuning_of
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.fitting.parameters.spaces import Space, drawn, model_of, space_of
from jaxbody.model.leaf_paths import matching
from jaxbody.model.models import Model
from jaxbody.model.preconditions import check_precision
from jaxbody.suspension.suspensions import Suspension

# largest number of catalogue parameters for which all combinations of neighbors are tried
MOST_NEIGHBORS = 6


def tune(
    model: Model | Suspension,
    evaluate: Evaluate,
    *,
    free: str | Iterable[str],
    minimize: str = "objective",
    limits: dict[str, Any] | None = None,
    bounds: dict[str, tuple[Any, Any]] | None = None,
    catalogues: dict[str, Iterable[float]] | None = None,
    plans: dict[str, Measurement] | None = None,
    starts: int = 1,
    key: Any = None,
    method: Any = "slsqp",
    max_iterations: int = 200,
    tolerance: float = 1e-10,
    reverse: bool | None = None,
    workers: Any = None,
    progress: bool | None = None,
) -> Tuning:
    """Find the design with the smallest objective within limits, by exact gradients.

    Args:
        model: the initial design; a `Suspension` has its hard points as parameters by their names,
            free=["lower outer"], in meters.
        evaluate: model, or suspension -> {name: number or array} by JAX functions, or one number,
            then called "objective".
        free: paths or patterns of independent parameters; "spring fl.stiffness = spring
            fr.stiffness" ties parameters, "left.a = right.a * [1, -1, 1]" with factors.
        minimize: name of the objective.
        limits: {name: (lower, upper)}, either may be None, or {name: number} for equality; for an
            array they apply to each element.
        bounds: {path or pattern: (lower, upper)}, in the units of the parameter, never violated.
        catalogues: {path or pattern: available values}; all neighbors of the optimum are tried,
            with the other parameters tuned again.
        plans: {name: planned measurement}, whose numbers have paths too ("run1.base.frequency",
            "run1.acc.point", "hammer.frequencies"); `evaluate` then takes model and plans, for a
            criterion of their `fitting.information`. By default none.
        starts: number of initial designs: the model, and others drawn between the bounds; they
            are searched one after the other.
        key: random key for the drawn designs and for stochastic objectives; None
            takes jax.random.key(0).
        method: "slsqp" or "trust-constr" (SciPy), restarted while they improve, or an optax
            optimizer for large or stochastic objectives without limits, where `evaluate` may take a
            key as its second argument.
        max_iterations: largest number of iterations from each start; the number of steps
            with optax.
        tolerance: tolerance of the objective, relative to its value at the start.
        reverse: True takes derivatives by reverse mode; None uses forward mode for up to thirty
            free numbers.
        workers: None, a number of processes, or an executor, as in `sweep`, for several starts with
            a method of SciPy; the numbers are the same.
        progress: None shows progress after five seconds, False is silent, True prints every
            evaluation to stderr.

    Stiffness, damping and mass vary by factors, orientations by rotations. If limits are violated,
    the violation is minimized first. A step to a design with values that are not finite is
    rejected. Where derivatives do not exist, as with equal natural frequencies, those of a nearby
    point are used; smooth quantities (`objectives`) avoid this.

    Errors: UNKNOWN_PATH, UNKNOWN_NAME, WRONG_KIND for a key, LISTED_TWICE, NOTHING_FREE,
    TIED_APART, BAD_TIE, START_ON_BOUND, START_OUTSIDE, BAD_BOUNDS, BAD_LIMITS, NO_BOUNDS,
    BAD_CATALOGUE, BAD_METHOD, BAD_OBJECTIVE, NONFINITE_START, MISSING_EXTRA, TRACED, FLOAT32,
    BAD_WORKERS, NOT_SENT, OTHER_WORKER. Warns INFEASIBLE, with the violated limits, NOT_CONVERGED,
    and LOST.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> def sag(model):
    ...     return {
    ...         "sag": model["body"].mass * 9.81 / model["suspension"].stiffness,
    ...         "stiffness": model["suspension"].stiffness,
    ...     }
    >>> design = jb.tune(
    ...     car,
    ...     sag,
    ...     free=["suspension.stiffness"],
    ...     minimize="stiffness",
    ...     limits={"sag": (None, 0.1)},
    ... )
    >>> round(float(design.values["suspension.stiffness"]), 1), design.active
    (36787.5, ('sag <= 0.1',))
    """
    check_precision("tune", model_of(model), allow_float32=None)
    if not is_concrete(model):
        raise JaxbodyError(
            Problem(
                "TRACED",
                "tune.model",
                "is being traced",
                hint="Tune outside of jit, vmap and grad.",
            )
        )
    with Problems() as problems:
        catalogues = checked_dict(catalogues, "tune.catalogues", "path: [values]", problems)
        whole_number(starts, "tune.starts", problems, code="BAD_STARTS")
        max_iterations = whole_number(max_iterations, "tune.max_iterations", problems)
        positive_number(tolerance, "tune.tolerance", problems)
        check_key(key, "tune.key", problems)
        problems.gather(lambda: check_workers(workers, "tune.workers"))
        if workers is not None and not isinstance(method, str):
            problems.add(
                "BAD_WORKERS",
                "tune.workers",
                "are for methods of SciPy",
                value=workers,
                hint="Leave it out.",
            )
        limited = problems.gather(lambda: limits_of(limits or {}))
        space = problems.gather(
            lambda: space_of(model, free, "tune", runs=plans, bounds=bounds, between=True)
        )
    low, high = space.bounds
    catalogs = _catalogs(space, catalogues, low, high)
    _check_options(method, limited, catalogs)
    U = drawn(space, low, high, starts, key, "tune.bounds")
    if key is None and not isinstance(method, str):
        key = jax.random.key(0)
    stochastic = not isinstance(method, str) and len(inspect.signature(evaluate).parameters) > (
        2 if plans else 1
    )
    program = Program(
        space,
        evaluate,
        minimize,
        limited,
        reverse=reverse,
        key=key if stochastic else None,
        progress=progress,
    )
    with working("tune", progress) as program.line:
        program.line("first evaluation, compiling")
        before, _ = program(U[0])
        check_names(program)
        searches = [Search(u, low, high, program.rows) for u in U]
        options = dict(method=method, iterations=max_iterations, tolerance=tolerance)
        with one_thread():
            if isinstance(method, str):
                searches = _run_all(program, searches, workers, **options)
            else:
                _run_optax(program, searches, method, max_iterations, key)
            if catalogs:
                searches = _neighbors(program.space, _best(searches), catalogs)
                searches = _run_all(program, searches, workers, **options)
    best = _best(searches)
    if not best.finite:
        raise not_finite(program, searches)
    return warn_if_failed(tuning_of(program, searches, best, before, max_iterations))


def _catalogs(
    space: Space, catalogues: dict[str, Any], low: np.ndarray, high: np.ndarray
) -> dict[int, np.ndarray]:
    """Return the available values {index of the parameter: its u}, and narrow the bounds `low` and
    `high` to them. Error: BAD_CATALOGUE."""
    catalogs = {}
    with Problems() as problems:
        owner = {
            leaf: i for i, parameter in enumerate(space.parameters) for _, leaf in parameter.places
        }
        for pattern, leaves in matching(list(owner), catalogues, "tune.catalogues").items():
            values = problems.gather(
                lambda path=pattern: _values(catalogues[path], f"tune.catalogues['{path}']")
            )
            if values is None:
                continue
            for i in dict.fromkeys(owner[leaf] for leaf in leaves):
                parameter, at = space.parts[i]
                where = f"tune.catalogues['{parameter.path}']"
                form: Any = parameter.form
                if (
                    form.start.ndim
                    or values.ndim != 1
                    or not values.size
                    or not np.isfinite(values).all()
                    or (values <= 0).any()
                ):
                    problems.add(
                        "BAD_CATALOGUE",
                        where,
                        f"is {values.tolist()}",
                        value=values,
                        limit="positive numbers, for one number",
                    )
                    continue
                catalog = np.array([form.inverse(x)[0] for x in values])
                inside = (catalog >= low[at] - 1e-12) & (catalog <= high[at] + 1e-12)
                if inside.any():
                    catalogs[i] = available = catalog[inside]
                    low[at], high[at] = min(available.min(), 0.0), max(available.max(), 0.0)
                else:
                    problems.add(
                        "BAD_CATALOGUE",
                        where,
                        "has no value within the bounds",
                        value=values,
                        hint="Widen the bounds.",
                    )
    return catalogs


def _values(given: Any, where: str) -> np.ndarray:
    """Return available values, sorted."""
    values = float_array(list(given) if isinstance(given, Iterable) else given, where)
    return np.sort(values) if values.ndim == 1 else values  # pyright: ignore


def _check_options(method: Any, limits: dict[str, Any], catalogs: dict[int, Any]) -> None:
    with Problems() as problems:
        if isinstance(method, optax.GradientTransformation):
            if limits or catalogs:
                problems.add(
                    "BAD_METHOD",
                    "tune.method",
                    "is an optax optimizer, which has no limits or catalogues",
                    value=method,
                    limit=" ".join(METHODS),
                )
        elif method not in METHODS:
            problems.add(
                "BAD_METHOD",
                "tune.method",
                f"is {method!r:.60}",
                value=method,
                limit=" ".join(METHODS) + " or an optax optimizer",
            )


def _neighbors(space: Space, best: Search, catalogs: dict[int, np.ndarray]) -> list[Search]:
    """Return searches from all combinations of neighboring values in the catalogues. If there are
    more than MOST_NEIGHBORS parameters, both values are tried only for those where they are at
    about the same distance."""
    places = [space.parts[i][1].start for i in catalogs]
    pairs = [
        _neighbors_of(catalog, best.u[at])
        for at, catalog in zip(places, catalogs.values(), strict=True)
    ]
    clear = [
        abs(np.diff(np.abs(pair - best.u[at])).sum()) if len(pair) > 1 else np.inf
        for at, pair in zip(places, pairs, strict=True)
    ]
    trial = np.argsort(clear)[:MOST_NEIGHBORS]
    choices = [pair if i in trial else pair[:1] for i, pair in enumerate(pairs)]
    searches = []
    for chosen in np.stack([x.ravel() for x in np.meshgrid(*choices, indexing="ij")], -1):
        u, low, high = best.u.copy(), best.low.copy(), best.high.copy()
        for x in (u, low, high):
            x[places] = chosen
        searches.append(Search(u, low, high, best.rows))
    return searches


def _neighbors_of(catalog: np.ndarray, u) -> np.ndarray:
    """Return the catalogue values next to u, one below and one above, the nearer one first."""
    above = int(np.searchsorted(catalog, u))
    pair = catalog[max(above - 1, 0) : above + 1]
    return pair[np.argsort(np.abs(pair - u), kind="stable")]


def _run_all(
    program: Program, searches: list[Search], workers: Any, **options: Any
) -> list[Search]:
    """Run searches, one after the other or by workers, and return them."""
    if workers is not None and len(searches) > 1:
        return search_by_workers(program, searches, workers, **options)
    for number, search in enumerate(searches, 1):
        program.place = f"start {number} of {len(searches)}, " if len(searches) > 1 else ""
        run(search, program, **options)
    return searches


def _run_optax(
    program: Program,
    searches: list[Search],
    method: optax.GradientTransformation,
    steps: int,
    key: Any,
) -> None:
    """Run an optax optimizer from all starts in one program; u is clipped to the bounds after each
    step."""
    ends, history = _descend(
        program.space,
        program.evaluate,
        program.minimize,
        method,
        steps,
        program.key is not None,
        device_array(np.stack([search.start for search in searches])),
        device_array(searches[0].low),
        device_array(searches[0].high),
        key,
    )
    program.count += steps
    for search, u, objectives in zip(searches, np.asarray(ends), np.asarray(history), strict=True):
        search.keep(u, *program(u))
        search.iterations = steps
        search.finite = bool(np.isfinite(search.objective))
        search.history = [(float(f), 0.0) for f in objectives]
        search.size = abs(float(objectives[0])) or 1.0


@program_with(OPTIMIZED)
def _descend(
    space: Space,
    evaluate: Evaluate,
    minimize: str,
    method,
    steps: int,
    stochastic: bool,
    U,
    low,
    high,
    key,
):
    optimizer = optax.with_extra_args_support(method)

    def one(u, key):
        def value(u, key):
            return evaluated(evaluate, *space.arguments(u), *((key,) if stochastic else ()))[
                minimize
            ]

        def step(carry, key):
            u, state = carry
            f, g = jax.value_and_grad(value)(u, key)
            g = jnp.where(jnp.isfinite(g), g, 0.0)
            change, state = optimizer.update(
                g, state, u, value=f, grad=g, value_fn=lambda u: value(u, key)
            )
            trial = jnp.clip(u + change, low, high)
            return (jnp.where(jnp.isfinite(trial), trial, u), state), f

        (u, _), history = jax.lax.scan(step, (u, optimizer.init(u)), jax.random.split(key, steps))
        return u, history

    return jax.vmap(one)(U, jax.random.split(key, len(U)))


def _best(searches: list[Search]) -> Search:
    """Return the feasible search with the lowest objective, otherwise the one with the smallest
    violation."""

    def rank(search: Search):
        if not search.finite:
            return 2, 0.0
        violation = search.own_violation
        return (0, search.objective) if violation <= 10 * MET else (1, violation)

    return min(searches, key=rank)
