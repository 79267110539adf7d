"""The best n of many candidates for measurements: greedy, then by exchange, with the bound of the
continuous design, which no choice can pass.

    minimize phi(M0 + sum of M_i over the chosen),    M_i = J_i'J_i
"""

from collections.abc import Callable, Iterable
from fnmatch import fnmatchcase
from functools import partial
from typing import Any

import equinox as eqx
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import check_key, check_one_of, whole_number
from jaxbody.core.arrays import Float
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, unknown
from jaxbody.core.results import Result
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.planning import criteria
from jaxbody.fitting.planning.candidates import candidates_of
from jaxbody.fitting.planning.continuous_designs import continuous_design
from jaxbody.fitting.planning.further_measurements import further_measurements
from jaxbody.fitting.statistics.uncertainties import RANK, errors_of, in_words, scaled_eigenvalues

# information of each parameter without any measurement, relative to that of all candidates, so that
# the first choices can be compared
LEAST = 1e-10
STARTS = 8  # random choices to begin exchanges with, beside the greedy one


class Choice(Result):
    """Result of `choose`: the `names` of the chosen candidates.

    `shares` (N,): shares of all `candidates` in the continuous design, of sum n; `value`: the
    criterion of the choice; `bound`: a number below which no choice gets; `efficiency`: at least
    this part of the best choice, by the determinant to the power 1/p for D and by the ratio of the
    criteria for others. `information` (p, p) of the `parameters` with everything chosen and
    existing; `before` and `after` (p,): standard errors of u, which are relative errors of positive
    parameters; `silent`: candidates that measure nothing.

    >>> import inspect
    >>> inspect.signature(jb.choose).return_annotation.__name__
    'Choice'
    """

    names: tuple[str, ...] = eqx.field(static=True)
    candidates: tuple[str, ...] = eqx.field(static=True)
    parameters: tuple[str, ...] = eqx.field(static=True)
    criterion: str = eqx.field(static=True)
    silent: tuple[str, ...] = eqx.field(static=True)
    shares: Float[np.ndarray, "N"]
    value: float
    bound: float
    efficiency: float
    information: Float[np.ndarray, "p p"]
    before: Float[np.ndarray, "p"]
    after: Float[np.ndarray, "p"]
    status: np.ndarray

    def _tables(self) -> list[tables.PrintedTable]:
        share = dict(zip(self.candidates, self.shares, strict=True))
        notes = [
            f"{self.criterion}: at least {100 * self.efficiency:.4g} % of the best "
            f"{len(self.names)} of {len(self.candidates)}"
        ]
        if self.silent:
            notes.append(f"{', '.join(self.silent)} measure nothing of these parameters")
        errors = zip(self.parameters, self.before, self.after, strict=True)
        return [
            tables.PrintedTable(
                "Choice",
                ("measurement", "share of the continuous design"),
                [(name, f"{share[name]:.3f}") for name in self.names],
            ),
            tables.PrintedTable(
                "",
                ("parameter", "standard error before", "after"),
                [
                    (name, float(a) if np.isfinite(a) else "not determined", float(b))
                    for name, a, b in errors
                ],
                "\n".join(notes),
            ),
        ]


def choose(
    candidates: Fit | dict[str, Any],
    *,
    n: int,
    criterion: str = "D",
    existing: Any = None,
    each: str = "sensor",
    draws: int = 0,
    repeated: bool = False,
    parameters: Iterable[str] | None = None,
    key: Any = None,
) -> Choice:
    """Choose the n candidates that tell most about the parameters.

    Args:
        candidates: the result of `expected_fit`, whose sensors or runs are the candidates; or
            {name: plan} of measurements of the model of the `existing` fit; or {name: J}, Jacobians
            (rows, p) over the noise, one row each if vectors, with leading axis for averages.
        n: the number of candidates to choose.
        criterion: "D", "A", "E" or "largest interval" (`fitting.criterion`), of all parameters or
            of some: "largest interval of spring.stiffness, *.damping".
        existing: a fit, or a posterior, whose information is there already; for Jacobians the
            Jacobian of the measurements that are.
        each: "sensor": a sensor, direction or place, in all runs where it is; "run": a whole run,
            such as a speed, an excitation or a load case.
        draws: number of draws of the parameters over which the criterion is averaged, from the
            covariance of the `existing` fit or from the posterior; 0 for the estimates alone.
        repeated: True if a candidate may be chosen more than once.
        parameters: names of the parameters of Jacobians; by default their numbers.
        key: random key of the draws; None takes jax.random.key(0).

    Greedy choices are exchanged for others as long as the criterion falls, from several starts.
    The bound is that of the continuous design, by the equivalence theorem: the `efficiency` holds
    without a proof that the best choice was found.

    Errors: BAD_NUMBER for n beyond the candidates, UNDETERMINED for parameters that no candidate
    determines, with a measurement that would, BAD_OPTION, WRONG_KIND, BAD_SHAPE, NON_FINITE,
    UNKNOWN_NAME, NO_NOISE.

    >>> x = jnp.linspace(-1, 1, 21)
    >>> line = {f"{at:.1f}": jnp.array([1.0, at]) for at in x}  # y = a + b x
    >>> jb.choose(line, n=2).names
    ('-1.0', '1.0')
    """
    with Problems() as problems:
        check_one_of(each, ("sensor", "run"), "BAD_OPTION", "choose.each", problems)
        draws = whole_number(draws, "choose.draws", problems, least=0)
        n = whole_number(n, "choose.n", problems)
        check_key(key, "choose.key", problems)
    names, M, base, labels = candidates_of(candidates, existing, each, draws, parameters, key)
    with Problems() as problems:
        kind, of = _parts_of(criterion, labels, problems)
        if n > len(names) and not repeated:
            problems.add(
                "BAD_NUMBER",
                "choose.n",
                f"is {n} of {len(names)} candidates",
                value=n,
                limit=f"<= {len(names)}",
                hint="Give more candidates, or repeated=True if one may be measured again.",
            )
    total = base + M.sum(1)
    diagonal = np.einsum("sii->si", total).mean(0)
    floor = LEAST * np.diag(np.where(diagonal > 0, diagonal, diagonal.max()))
    fit = candidates if existing is None else existing
    _check_determined(total[0], of, labels, "no candidate determines", partial(_remedy, fit))
    silent = np.abs(M).sum((0, 2, 3)) <= RANK**2 * np.abs(total).sum()
    shares, bound = continuous_design(M, base + floor, kind, of, n, repeated=repeated)
    rng = np.random.default_rng(0)
    starts = [rng.choice(len(names), n, repeated).tolist() for _ in range(STARTS)]
    starts += [[]] if repeated else [[], np.argsort(-shares, kind="stable")[:n].tolist()]
    chosen = _best(M, base + floor, kind, of, n, starts, repeated)
    final = base + M[:, chosen].sum(1)
    _check_determined(final[0], of, labels, f"n = {n} do not determine", lambda: "Give a larger n.")
    value = float(criteria.criterion(final + floor, kind, of).mean())
    part = np.exp((bound - value) / len(of)) if kind == "D" else bound / value
    return Choice(
        names=tuple(names[i] for i in sorted(chosen)),
        candidates=tuple(names),
        parameters=tuple(labels),
        criterion=criterion,
        silent=tuple(name for name, quiet in zip(names, silent, strict=True) if quiet),
        shares=shares,
        value=value,
        bound=bound,
        efficiency=float(np.clip(part, 0.0, 1.0)),
        information=final[0],
        before=errors_of(base[0], total[0]),
        after=errors_of(final[0], total[0]),
        status=np.asarray(Status.OK),
    )


def _best(
    M: np.ndarray,
    base: np.ndarray,
    kind: str,
    of: np.ndarray,
    n: int,
    starts: list[list[int]],
    repeated: bool,
) -> list[int]:
    """Return the best n candidates that are reached from the starts."""

    def value(criterion: Any, M: np.ndarray) -> Any:
        return criterion(M, kind, of).mean(-1)

    found = []
    for chosen in starts:
        for criterion in (criteria.smooth, criteria.criterion):
            chosen = _exchanged(chosen, M, base, n, partial(value, criterion), repeated)
        found.append(chosen)
    exact = partial(value, criteria.criterion)
    return min(found, key=lambda chosen: float(exact(base + M[:, chosen].sum(1))))


def _exchanged(
    chosen: list[int],
    M: np.ndarray,
    base: np.ndarray,
    n: int,
    value: Callable[[np.ndarray], Any],
    repeated: bool,
) -> list[int]:
    """Return n candidates: `chosen`, filled up one by one with the best, then exchanged one by one
    for better ones until none is better."""
    each = np.moveaxis(M, 0, 1)  # (N, draws, p, p)

    def best(others: list[int]) -> tuple[int, float]:
        values = value(base + M[:, others].sum(1) + each)
        if not repeated:
            values[others] = np.inf
        return int(np.argmin(values)), float(values.min())

    chosen = list(chosen)
    while len(chosen) < n:
        chosen.append(best(chosen)[0])
    least, tried = float(value(base + M[:, chosen].sum(1))), 0
    while tried < n:
        one, phi = best(chosen[1:])
        better = phi < least - 1e-12 * abs(least)
        chosen, tried = [*chosen[1:], one if better else chosen[0]], 0 if better else tried + 1
        least = phi if better else least
    return chosen


def _parts_of(text: Any, labels: list[str], problems: Problems) -> tuple[str, np.ndarray]:
    """Return the kind of a criterion and the indices of the parameters that it names."""
    kind, _, named = str(text).partition(" of ")
    check_one_of(kind, criteria.KINDS, "BAD_OPTION", "choose.criterion", problems)
    if not named:
        return kind, np.arange(len(labels))
    of: set[int] = set()
    for pattern in map(str.strip, named.split(",")):
        found = [i for i, x in enumerate(labels) if x == pattern or fnmatchcase(x, pattern)]
        if not found:
            problems.collected.append(unknown(pattern, "choose.criterion", tuple(labels)))
        of.update(found)
    return kind, np.array(sorted(of), int)


def _check_determined(
    M: np.ndarray, of: np.ndarray, labels: list[str], what: str, hint: Callable[[], str]
) -> None:
    """Check that M determines the parameters `of`. Error: UNDETERMINED, with the combinations that
    are not determined, in words."""
    S, V, _, known = scaled_eigenvalues(M, M)
    null = V[:, ~known]
    if np.abs(null[of]).max(initial=0.0) > RANK or not S.max(initial=0.0):
        silent = [label for label, x in zip(labels, np.diag(M), strict=True) if not x]
        words = in_words(null, labels, silent)
        raise JaxbodyError(
            Problem("UNDETERMINED", "choose", f"{what}: {'; '.join(words)}", hint=hint())
        )


def _remedy(fit: Any) -> str:
    """Return what would determine more than the candidates do."""
    if isinstance(fit, Fit):
        further = further_measurements(fit, most=1)
        if np.isinf(further.after).sum() < np.isinf(further.before).sum():
            return f"Measure the {further.measurements[0]}, or add a prior."
    return "Add a prior, or another kind of measurement."
