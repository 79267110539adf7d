"""The information of each candidate for a measurement, and of what is known before.

M_i = J_i'J_i,    J_i the rows of the Jacobian of the residuals that belong to the candidate
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import float_array
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.fitting.experiments.measurements import Measurement, records_of
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.fitters import check_runs
from jaxbody.fitting.parameters.spaces import Space
from jaxbody.fitting.planning.expected_fits import check_derivatives, planned
from jaxbody.fitting.posteriors import Posterior
from jaxbody.fitting.residuals import residual_and_jacobian


class Candidates(NamedTuple):
    """Names (N), information M (draws, N, p, p), information before `base` (draws, p, p), and the
    names of the p parameters."""

    names: list[str]
    M: np.ndarray
    base: np.ndarray
    labels: list[str]


def candidates_of(
    given: Any, existing: Any, each: str, draws: int, parameters: Any, key: Any
) -> Candidates:
    """Return the candidates of `choose`, whose arguments these are."""
    kinds = {isinstance(x, Measurement) for x in given.values()} if isinstance(given, dict) else ()
    if kinds == {False} and not isinstance(existing, Fit | Posterior):
        return _of_jacobians(given, existing, parameters)
    if kinds == {True} and isinstance(existing, Fit | Posterior):
        fit = existing if isinstance(existing, Fit) else existing.fit
        check_runs(fit.model, given, "choose.candidates", plans=True)
        space, own = fit.task.space.of_model(given)
        sampled = existing.drawn(draws)[:, own] if isinstance(existing, Posterior) else None
        known = existing.information
        return _of_plans(space, np.asarray(fit.u)[own], fit, known, each, draws, key, sampled)
    if isinstance(given, Fit) and existing is None:
        space = given.task.space
        nothing = np.zeros((space.size, space.size))
        return _of_plans(space, np.asarray(given.u), given, nothing, each, draws, key, None)
    raise JaxbodyError(
        Problem(
            "WRONG_KIND",
            "choose.candidates",
            f"are {given!r:.60}",
            given,
            "expected_fit(...), or {name: plan} with existing=, or {name: Jacobian}",
        )
    )


def _of_jacobians(given: dict[str, Any], existing: Any, parameters: Any) -> Candidates:
    with Problems() as problems:
        J = {f"choose.candidates['{name}']": x for name, x in given.items()}
        J |= {} if existing is None else {"choose.existing": existing}
        J = {where: np.asarray(float_array(x, where)) for where, x in J.items()}
        count = {x.shape[-1:] for x in J.values()}
        for where, x in J.items():
            if not 1 <= x.ndim <= 3 or len(count) > 1:
                problems.add(
                    "BAD_SHAPE",
                    where,
                    f"has shape {x.shape}",
                    value=x.shape,
                    limit="(p,), (rows, p) or (draws, rows, p), with the same p for all",
                )
            elif not np.isfinite(x).all():
                problems.add("NON_FINITE", where, "is not finite", limit="finite")
    M = [np.swapaxes(x, -1, -2) @ x for x in map(np.atleast_2d, J.values())]
    M = np.array(np.broadcast_arrays(*(x.reshape(-1, *x.shape[-2:]) for x in M)))
    base = M[-1] if existing is not None else np.zeros_like(M[0])
    labels = list(map(str, parameters or range(M.shape[-1])))
    return Candidates(list(given), np.moveaxis(M[: len(given)], 0, 1), base, labels)


def _of_plans(
    space: Space,
    u: np.ndarray,
    fit: Fit,
    known: np.ndarray,
    each: str,
    draws: int,
    key: Any,
    sampled: np.ndarray | None,
) -> Candidates:
    """Return the sensors or the runs of plans, linearized at u or at draws: those `sampled` from a
    posterior, or else from a normal distribution with what is known before."""
    integration = fit.task.integration

    def informed(u: np.ndarray) -> tuple[dict[str, np.ndarray], np.ndarray]:
        """Return the information of each candidate, and that of the priors."""
        task = planned(space, jnp.asarray(u), integration)
        J = np.asarray(residual_and_jacobian(task, jnp.asarray(u))[1])
        check_derivatives(task, J)
        M: dict[str, Any] = {}
        for record in records_of(task.space.runs):
            name = record.run if each == "run" else record.channel
            M[name] = M.get(name, 0) + J[record.rows].T @ J[record.rows]
        priors = J[len(J) - space.prior_rows :]
        return M, priors.T @ priors

    M, of_priors = informed(u)
    base, information = known + of_priors, [M]
    if draws and sampled is None:
        if np.linalg.matrix_rank(base, hermitian=True) < len(base):
            raise JaxbodyError(
                Problem(
                    "UNDETERMINED",
                    "choose.draws",
                    "need all parameters to be known before, by priors or by a fit",
                    hint="Give priors, or leave out draws=.",
                )
            )
        seed = np.asarray(jax.random.key_data(jax.random.key(0) if key is None else key)).ravel()
        sampled = np.random.default_rng(seed).multivariate_normal(u, np.linalg.inv(base), draws)
    if draws and sampled is not None:
        information = [informed(point)[0] for point in sampled]
    return Candidates(
        list(M),
        np.array([list(x.values()) for x in information]),
        np.broadcast_to(base, (len(information), *base.shape)),
        space.names,
    )
