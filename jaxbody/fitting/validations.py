"""Validation: predictions of a fitted model compared with runs that were not used for the fit,
channel by channel.

    NRMSE = rms(predicted - measured)/std(measured),    fit = 1 - NRMSE

A fit of 100 % has no residual; 0 % is as good as the mean of the record, and below 0 % the mean
is better.
"""

import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array
from jaxbody.core.errors import Status
from jaxbody.core.results import Result, warn_if_failed
from jaxbody.fitting.experiments.measurements import (
    Measurement,
    check_measurements,
    records_of,
)
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.parameters.spaces import Space
from jaxbody.fitting.residuals import Levels, Task, residual_and_jacobian, residuals_of_means
from jaxbody.fitting.statistics.autocorrelations import Whiteness, whiteness
from jaxbody.fitting.statistics.uncertainties import (
    LESS,
    errors_of,
    information_of,
    unknown_and_largest,
)

WHITE = 0.01  # p-value above which residuals are reported as white


class Validation(Result):
    """Result of `validate`: residuals of a fitted model for each component of each channel.

    By component, such as "run.channel[0]": `nrmse`; `rms` of the residuals in the unit of the
    channel; `excess`, the ratio of this rms to the noise estimated by the fit; and `whiteness`, a
    test for white noise, None for short records and for measurements that are not time series.
    `experiments` contains the runs, `predicted` and `residuals` are {run: {channel: array}}.
    `further` says which record would help the fit most if it were fitted too.
    `status` is NONFINITE if a run cannot be simulated with the fitted model; `failed` gives the
    reasons."""

    experiments: dict[str, Measurement]
    nrmse: dict[str, float]
    rms: dict[str, float]
    excess: dict[str, float]
    whiteness: dict[str, Whiteness | None]
    units: dict[str, str]
    predicted: dict[str, dict[str, Array]]
    residuals: dict[str, dict[str, Array]]
    failed: dict[str, str]
    further: str
    status: np.ndarray

    def explain(self) -> str:
        return "; ".join(f"{run}: {why}" for run, why in self.failed.items())

    def _tables(self) -> list[tables.PrintedTable]:
        rows = []
        for name, nrmse in self.nrmse.items():
            test = self.whiteness[name]
            white = (
                "" if test is None else f"{test.r1:.2f}" + (" (white)" if test.p >= WHITE else "")
            )
            rows.append(
                (
                    name,
                    f"{100 * nrmse:.3g} %",
                    f"{100 * (1 - nrmse):.2f} %",
                    self.rms[name],
                    self.units[name],
                    self.excess[name],
                    white,
                )
            )
        heads = (
            "channel",
            "NRMSE",
            "fit",
            "rms residual",
            "unit",
            "over noise of the fit",
            "lag-one correlation",
        )
        note = (
            "NRMSE: rms of the residual over the standard deviation of the measured "
            f"record; {self.report()}{f'; {self.further}' if self.further else ''}"
        )
        return [tables.PrintedTable("Validation", heads, rows, note)]


def validate(fit: Fit, experiments: dict[str, Measurement]) -> Validation:
    """Compare predictions of the fitted model with runs that were not used for the fit.

    Initial states, biases of sensors and other parameters of an experiment are those given with it,
    not fitted.

    Errors: NO_DATA, WRONG_KIND, and those of `fit` for experiments that do not match the model.
    Warns NONFINITE.

    >>> spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     elements={"spring": spring},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ... )
    >>> def run(times, noise):
    ...     x = jnp.cos(2 * jnp.pi * times) + noise * jnp.cos(300 * times**2)
    ...     return jb.Experiment(
    ...         times, sensors={"x": jb.Position("mass", axis=[1, 0, 0])}, measured={"x": x}
    ...     )
    >>> result = jb.fit(
    ...     model, {"one": run(jnp.linspace(0, 1, 21), 0.02)}, free=["spring.stiffness"]
    ... )
    >>> validation = jb.validate(result, {"two": run(jnp.linspace(0, 2, 41), 0.02)})
    >>> print(f"{100 * validation.nrmse['two.x']:.1f} %")
    2.3 %
    """
    check_measurements(experiments, "validate.experiments").raise_if_any()
    for name, experiment in experiments.items():
        experiment.check(fit.model, name)
    noise: Levels = {
        run: {
            name: jnp.ones((channel.units,) if channel.units > 1 else ())
            for name, channel in e.channels.items()
        }
        for run, e in experiments.items()
    }
    space, own = fit.task.space.of_model(experiments)
    task = Task(space, noise, fit.task.integration)
    _, J, runs = residual_and_jacobian(task, jnp.asarray(np.asarray(fit.u)[own]))
    means = {run: ({}, r) for run, r in residuals_of_means(experiments).items()}
    r, signal = np.asarray(task.losses(runs)), np.asarray(task.losses(means))
    fit_noise = {name: level for levels in fit.noise.values() for name, level in levels.items()}
    nrmse, rms, excess, tests, units, information = {}, {}, {}, {}, {}, {}
    for record in records_of(task.experiments):
        residual, name, unit = r[record.rows], *record.group.rsplit(" ", 1)
        spread, size = np.sqrt(np.mean(signal[record.rows] ** 2)), np.sqrt(np.mean(residual**2))
        with np.errstate(divide="ignore", invalid="ignore"):
            nrmse[record.name], rms[record.name] = float(size / spread), float(size)
        level = np.ravel(fit_noise[name])[int(unit)] if name in fit_noise else np.nan
        excess[record.name] = float(size / level)
        noise_of_record = level if np.isfinite(level) else size
        information[record.name] = information_of(np.asarray(J)[record.rows], noise_of_record)
        tests[record.name] = (
            whiteness(residual) if record.series and np.isfinite(residual).all() else None
        )
        units[record.name] = (
            experiments[record.run].channels[name].unit.split(",")[int(unit)].strip()
        )
    failed = {
        run: e.explain(fit.model, fit.task.integration)
        for run, e in experiments.items()
        if not all(np.isfinite(x).all() for x in runs[run][1].values())
    }
    predicted, residuals = ({run: both[k] for run, both in runs.items()} for k in (0, 1))
    return warn_if_failed(
        Validation(
            experiments=dict(experiments),
            nrmse=nrmse,
            rms=rms,
            excess=excess,
            whiteness=tests,
            units=units,
            predicted=predicted,
            residuals=residuals,
            failed=failed,
            further="" if failed or fit.uncertainty is None else _further(fit, space, information),
            status=np.asarray(Status.NONFINITE if failed else Status.OK),
        )
    )


def _further(fit: Fit, space: Space, information: dict[str, np.ndarray]) -> str:
    """Return which record would help the fit most if it were fitted too, "" if none would.

    Args:
        fit: the fit.
        space: the parameters of the model.
        information: {record: what it says of these parameters}.
    """
    known = fit.information
    total = known + sum(information.values())
    before = errors_of(known, total)
    after = {name: errors_of(known + M, total) for name, M in information.items()}
    best = min(after, key=lambda name: unknown_and_largest(after[name]))
    unknown, error = unknown_and_largest(before)
    still, least = unknown_and_largest(after[best])
    if still < unknown:
        words = [p for p, a, b in zip(space.names, before, after[best], strict=True) if a > b == b]
        return f"fitted too, {best} would determine {', '.join(words)}"
    if not least < LESS * error:
        return ""
    return (
        f"fitted too, {best} would help most: the largest relative standard error would fall from "
        f"{tables.percent(error)} to {tables.percent(least)}"
    )
