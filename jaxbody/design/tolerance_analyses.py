"""Tolerances: the scatter of a design's quantities due to scatter of its parameters, to first and
second order and by sampling.

x + s xi, xi normal and independent:   first order    mean f,             variance sum (f_i s_i)^2
                                       second order   mean f + sum f_ii s_i^2/2,
                                       variance the same + sum (f_ij s_i s_j)^2/2
"""

from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import check_key, checked_dict, positive_number, whole_number
from jaxbody.core.arrays import Array, Float, Int, concrete, device_array, float_array, module_of
from jaxbody.core.compilation.compile_options import OPTIMIZED, program_with
from jaxbody.core.errors import Problems, Status
from jaxbody.core.progress_lines import working
from jaxbody.core.results import warn_if_failed
from jaxbody.core.workers.batches import (
    batch_of,
    checked_chunks,
    gathered,
    gathered_here,
)
from jaxbody.core.workers.chunk_stores import hash_of
from jaxbody.core.workers.executors import crew_of
from jaxbody.design.design_programs import (
    Evaluate,
    Flat,
    OfQuantities,
    Quantities,
    labels_of,
    split,
    value_and_forward_slopes,
)
from jaxbody.fitting.parameters.spaces import Parameter, Space
from jaxbody.fitting.parameters.transforms import Shifted
from jaxbody.model.leaf_paths import leaves_of, matching
from jaxbody.model.models import Model
from jaxbody.model.preconditions import check_precision

CHUNK = 256  # samples per batch
SHOWN = 3  # parameters printed for each quantity

Scatter = dict[str, Any]


class Tolerances(OfQuantities):
    """Result of `tolerances`, for each of m `quantities`: `nominal` values; standard deviations to
    `first` order; `mean` and standard `deviation` to second order; `sampled_mean` and
    `sampled_deviation` of all `samples` (n, m); `shares` (m, k) of the `parameters` in the variance
    to first order."""

    nominal: Float[Array, "m"]
    first: Float[Array, "m"]
    mean: Float[Array, "m"]
    deviation: Float[Array, "m"]
    samples: Float[Array, "n m"]
    shares: Float[Array, "m k"]
    status: Int[Array, ""]
    parameters: tuple[str, ...] = eqx.field(static=True)

    @property
    def sampled_mean(self) -> Float[Array, "m"]:
        return module_of(self.samples).nanmean(self.samples, 0)

    @property
    def sampled_deviation(self) -> Float[Array, "m"]:
        return module_of(self.samples).nanstd(self.samples, 0, ddof=1)

    def explain(self) -> str:
        return (
            f"{int(np.sum(~np.isfinite(self.samples).all(-1)))} of {len(self.samples)} "
            "samples are not finite"
        )

    def _tables(self) -> list[tables.PrintedTable]:
        strongest = [
            ", ".join(
                f"{self.parameters[i]} {100 * float(share[i]):.0f} %"
                for i in np.argsort(-share)[:SHOWN]
                if share[i] > 0.005
            )
            for share in np.asarray(self.shares)
        ]
        rows = zip(
            self.quantities,
            self.nominal,
            self.first,
            self.mean,
            self.deviation,
            self.sampled_mean,
            self.sampled_deviation,
            strongest,
            strict=True,
        )
        heads = (
            "quantity",
            "nominal",
            "sigma, first order",
            "mean, second",
            "sigma, second",
            "mean, sampled",
            "sigma, sampled",
            "most of it from",
        )
        return [
            tables.PrintedTable(
                "Tolerances", heads, list(rows), f"{len(self.samples)} samples; {self.report()}"
            )
        ]


def tolerances(
    model: Model,
    evaluate: Evaluate,
    scatter: Scatter,
    *,
    samples: int = 1000,
    key: Any = None,
    chunk: int | None = None,
    workers: Any = None,
    out: Any = None,
    chunks: Iterable[int] | None = None,
    progress: bool | None = None,
) -> Tolerances:
    """Compute the scatter of quantities due to independent, normal scatter of parameters.

    Args:
        model, evaluate: as in `tune`.
        scatter: {path or pattern: standard deviation}, in the parameter's unit, one number or an
            array of the parameter's shape.
        samples: number of Monte Carlo samples.
        key: random key for these samples; None takes jax.random.key(0).
        chunk: number of samples evaluated at a time, and with `workers` or `out` sent and stored at
            a time; None evaluates 256 at a time, and sends at most 256 parts.
        workers: None, a number of processes, or an executor, as in `sweep`; the numbers are
            the same.
        out: path of a Zarr store to which each chunk of samples is written when it is done, as in
            `sweep`: the same call continues an interrupted one.
        chunks: numbers of the chunks that this call computes, as in `sweep`; None: all.
        progress: None shows a line after five seconds on a terminal or in a notebook, False
            is silent.

    Ctrl-C returns the samples that are done.

    Errors: UNKNOWN_PATH, LISTED_TWICE, BAD_SCATTER, WRONG_KIND for a key, BAD_CHUNK, BAD_WORKERS,
    NOT_SENT, OTHER_WORKER, OTHER_STORE, NOT_SAVED. Warns NONFINITE if samples are not finite, LOST
    and INTERRUPTED, where they are NaN.

    >>> def sag(model):
    ...     return {"sag": model["body"].mass * 9.81 / model["suspension"].stiffness}
    >>> result = jb.tolerances(
    ...     jb.presets.quarter_car(), sag, {"suspension.stiffness": 1750.0}
    ... )  # 5 %
    >>> (
    ...     round(float(result.first[0] / result.nominal[0]), 4),
    ...     round(float(result.mean[0] / result.nominal[0]), 4),
    ... )
    (0.05, 1.0025)
    """
    check_precision("tolerances", model)
    with Problems() as problems:
        samples = whole_number(samples, "tolerances.samples", problems, least=2, code="BAD_SCATTER")
        check_key(key, "tolerances.key", problems)
        space = problems.gather(lambda: scattering(model, scatter, "tolerances.scatter"))
        chunk = (
            None
            if chunk is None
            else whole_number(chunk, "tolerances.chunk", problems, code="BAD_CHUNK")
        )
        chunks = checked_chunks(
            "tolerances", workers, out, chunks, problems, fixed=chunk is not None
        )
    key = jax.random.key(0) if key is None else key
    with working("tolerances", progress) as line:
        line(f"derivatives and {samples} samples")
        (nominal, first, mean, deviation, shares), labels = jax.block_until_ready(
            _to_second_order(space, evaluate)
        )
        deviations = np.asarray(jax.random.normal(key, (samples, space.size)))
        points: Any = dict(
            function=lambda space, xi: {"values": jax.vmap(Flat(space, evaluate))(xi)},
            tree=space,
            rows=lambda first, last: [deviations[first:last]],
            count=samples,
            width=chunk or CHUNK,
            memory=np.inf if chunk is None else None,
            owner=evaluate,
            place="tolerances",
        )

        def report(done: int, workers: int) -> None:
            line(f"{done} of {samples} samples")

        if workers is None and out is None:
            results, status = gathered_here(report, **points), np.zeros(samples, int)
        else:
            with crew_of(workers, "tolerances.workers") as crew:
                batch = batch_of(**points, where="tolerances.evaluate")
                results, status = gathered(
                    batch,
                    crew,
                    "tolerances",
                    report,
                    out,
                    chunks,
                    plan={"deviations": hash_of(deviations)},
                    inputs=["deviations"],
                    dimension="sample",
                )
    drawn = results["values"]
    code = status.max(initial=Status.OK.value)
    if not code and not np.isfinite(drawn).all():
        code = Status.NONFINITE.value
    return warn_if_failed(
        Tolerances(
            nominal=nominal,
            first=first,
            mean=mean,
            deviation=deviation,
            samples=device_array(drawn),
            shares=shares,
            status=jnp.asarray(code),
            quantities=labels,
            parameters=tuple(space.labels),
        )
    )


def robust(evaluate: Evaluate, scatter: Scatter, *, sigmas: float = 3.0) -> Evaluate:
    """Return a function of quantities for a design that allows for tolerances: tune(model,
    robust(evaluate, scatter), ...).

        "name high", "name low" = mean + k sigma, mean - k sigma,
        both to second order, k = `sigmas`;
        "name" unchanged

    evaluate, scatter: as in `tolerances`. Errors, raised when it is evaluated: UNKNOWN_PATH,
    LISTED_TWICE, BAD_SCATTER.

    >>> def sag(model):
    ...     return {"sag": model["body"].mass * 9.81 / model["suspension"].stiffness}
    >>> quantities = jb.design.robust(sag, {"suspension.stiffness": 1750.0})(
    ...     jb.presets.quarter_car()
    ... )
    >>> [round(float(quantities[name]), 4) for name in ("sag", "sag high", "sag low")]
    [0.1051, 0.1212, 0.0896]
    """

    with Problems() as problems:
        positive_number(sigmas, "robust.sigmas", problems)

    def with_scatter(model: Model) -> Quantities:
        flat = Flat(scattering(model, scatter, "robust.scatter"), evaluate)
        f, J, H = _expanded(flat)
        mean, deviation = _moments(f, J, H)
        parts = {"": f, " high": mean + sigmas * deviation, " low": mean - sigmas * deviation}
        return {
            name + end: x
            for end, values in parts.items()
            for name, x in split(values, flat.shapes).items()
        }

    return with_scatter


def scattering(model: Model, scatter: Scatter, where: str) -> Space:
    """Return the space of the parameters that scatter, as functions x + s xi of standardized
    deviations xi. Errors: UNKNOWN_PATH, LISTED_TWICE, BAD_SCATTER."""
    parameters, arrays = [], jax.tree.leaves(model)
    with Problems() as problems:
        scatter = checked_dict(scatter, where, "path: standard deviation", problems)
        for pattern, matches in matching(leaves_of(model), scatter, where, problems).items():
            given = problems.gather(
                lambda pattern=pattern: float_array(scatter[pattern], f"{where}[{pattern!r}]")
            )
            if given is None:
                continue
            for leaf in matches:
                shape, known = leaf.shape(arrays), concrete(given)
                if given.shape not in ((), shape) or (
                    known is not None and not ((known >= 0).all() and np.isfinite(known).all())
                ):
                    problems.add(
                        "BAD_SCATTER",
                        f"{where}['{leaf.path}']",
                        f"is {scatter[pattern]!r:.60}",
                        value=given,
                        limit=f"one number >= 0, or of shape {shape}",
                        hint="Give standard deviations.",
                    )
                    continue
                if leaf.path in (parameter.path for parameter in parameters):
                    problems.add("LISTED_TWICE", where, f"names {leaf.path} twice", value=pattern)
                form = Shifted(leaf.read(arrays), jnp.broadcast_to(jnp.asarray(given), shape))
                parameters.append(Parameter((("", leaf),), (1.0,), form, *form.unbounded()))
        if not parameters and not problems.collected:
            problems.add(
                "BAD_SCATTER",
                where,
                "is empty",
                limit="at least one path",
                hint="Give {path: standard deviation}.",
            )
    return Space(model, tuple(parameters))


def _expanded(flat: Flat) -> tuple[Array, Array, Array]:
    """Return f, its Jacobian and its second derivatives at zero."""
    size = flat.space.size

    def first(xi):
        f, J = value_and_forward_slopes(flat, xi)
        return jnp.concatenate([f[:, None], J], 1).ravel()

    both, slopes = value_and_forward_slopes(first, jnp.zeros(size))
    both, slopes = both.reshape(-1, 1 + size), slopes.reshape(-1, 1 + size, size)
    return both[:, 0], both[:, 1:], slopes[:, 1:]


def _moments(f, J, H) -> tuple[Array, Array]:
    """Return mean and standard deviation to second order."""
    variance = jnp.sum(J**2, 1) + jnp.sum(H**2, (1, 2)) / 2
    some = variance > 0
    return f + jnp.trace(H, axis1=1, axis2=2) / 2, jnp.where(
        some, jnp.sqrt(jnp.where(some, variance, 1.0)), 0.0
    )


@program_with(OPTIMIZED)
def _to_second_order(space: Space, evaluate: Evaluate):
    """Return the moments and shares, and the names of the quantities."""
    flat = Flat(space, evaluate)
    f, J, H = _expanded(flat)
    variance = jnp.sum(J**2, 1)
    shares = J**2 / jnp.where(variance > 0, variance, 1.0)[:, None]
    return (f, jnp.sqrt(variance), *_moments(f, J, H), shares), tuple(labels_of(flat.shapes))
