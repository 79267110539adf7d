"""Plots of fits: the history of the cost, correlations of the estimates, autocorrelations of the
residuals, likelihood profiles, posteriors, optima; choices of measurements."""

from itertools import pairwise
from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem, check_known
from jaxbody.fitting.coverages import Coverage
from jaxbody.fitting.experiments.measurements import records_of
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.multistarts import CLOSE, Multistart
from jaxbody.fitting.parameters.transforms import Elementwise
from jaxbody.fitting.planning.choices import Choice
from jaxbody.fitting.posteriors import Posterior
from jaxbody.fitting.profiles import Profile
from jaxbody.fitting.residuals import residual_and_jacobian
from jaxbody.fitting.statistics.autocorrelations import FEWEST, most_lags, products
from jaxbody.fitting.statistics.noises import ResidualSeries
from jaxbody.fitting.validations import Validation
from jaxbody.views.plots.canvases import axes_below, axes_or_new, heat_map, legend, tidy, with_unit
from jaxbody.views.scenes.colors import COLORS, GRAY, INK, LIGHT

COMPLEX = ("real", "imaginary")
PAIRS, SHOWN = 5, 500  # most numbers whose pairs are drawn; draws of each chain that are shown
INNER = (5e-4, 1 - 5e-4)  # quantiles of draws between which a histogram is drawn
LEAST_SHARE = 0.005  # of a continuous design, below which a candidate is not drawn
MOST_CANDIDATES = 30  # largest number of candidates that are drawn but not chosen


def plot_history(fit: Fit, *, ax: Any = None) -> Any:
    """Draw the cost of a fit at every evaluation, on a logarithmic scale; crosses mark trials that
    could not be simulated.

    A dotted line marks each new estimate of the noise, which changes the weights in the cost:
    compare costs only between two such lines.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ...     elements={
    ...         "spring": jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    ...     },
    ... )
    >>> times, noise = jnp.linspace(0, 1, 21), 0.05 * jax.random.normal(jax.random.key(0), (21,))
    >>> track = jb.Experiment(
    ...     times,
    ...     sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
    ...     measured={"x": jnp.cos(2 * jnp.pi * times) + noise},
    ... )
    >>> fitted = jb.fit(model, {"track": track}, free=["spring.stiffness"])
    >>> jb.plots.plot_history(fitted).get_yscale()
    'log'
    """
    ax = axes_or_new(ax, 6.0, 3.0)
    cost, estimated = (
        np.asarray(fit.history, float).ravel(),
        [i for i in fit.rounds if i < len(fit.history)],
    )
    good = np.isfinite(cost)
    for start, stop in pairwise([0, *estimated, len(cost)]):
        at = np.flatnonzero(good[start:stop]) + start
        ax.plot(at, cost[at], ".-", color=COLORS[0], lw=1.2, ms=4)
    for k, start in enumerate(estimated):
        ax.axvline(
            start - 0.5,
            color=GRAY,
            lw=0.9,
            ls=":",
            label="noise estimated again" if k == 0 else None,
        )
    if not good.all():
        failed, style = (
            np.flatnonzero(~good),
            {"color": COLORS[2], "ms": 6, "transform": ax.get_xaxis_transform()},
        )
        ax.plot(failed, np.full(len(failed), 0.96), "x", label="could not be simulated", **style)
    if (cost[good] > 0).any():
        ax.set_yscale("log")
    ax.set(xlabel="evaluation", ylabel="cost [-]")
    ax.xaxis.get_major_locator().set_params(integer=True)
    legend(ax, len(ax.get_legend_handles_labels()[1]))
    return ax


def plot_correlations(fit: Fit, *, ax: Any = None) -> Any:
    """Draw the correlations of the estimates as a heat map, without parameters that the data do not
    determine.

    Near 1 or -1 the data determine a combination of the two parameters better than each of them.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ...     elements={
    ...         "spring": jb.Spring(
    ...             ("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0, damping=1.0
    ...         )
    ...     },
    ... )
    >>> times, noise = jnp.linspace(0, 1, 41), 0.02 * jax.random.normal(jax.random.key(0), (41,))
    >>> decay = (
    ...     jnp.exp(-0.5 * times) * (jnp.cos(5.454 * times) + 0.0917 * jnp.sin(5.454 * times))
    ...     + noise
    ... )
    >>> track = jb.Experiment(
    ...     times, sensors={"x": jb.Position("mass", axis=[1, 0, 0])}, measured={"x": decay}
    ... )
    >>> ax = jb.plots.plot_correlations(
    ...     jb.fit(model, {"track": track}, free=["spring.stiffness", "spring.damping"])
    ... )
    >>> [text.get_text() for text in ax.get_yticklabels()]
    ['spring.stiffness', 'spring.damping']
    """
    names, C = fit.task.space.names, fit.covariance
    known = np.flatnonzero(
        (np.diag(C) > 0) & np.isfinite(fit._assessed().spread(np.eye(len(C)))[0])
    )
    rho = fit.correlations[np.ix_(known, known)]
    labels = [names[i] for i in known]
    return heat_map(
        ax,
        (2.2 + 0.55 * len(known), 1.6 + 0.45 * len(known)),
        np.where(np.eye(len(rho), dtype=bool), np.nan, rho),
        labels,
        labels,
        (-1.0, 1.0),
        "correlations of the estimates [-]",
        digits=2,
        slant=True,
    )


def plot_autocorrelation(
    fit: Fit, *, run: str | None = None, sensor: str | None = None, ax: Any = None
) -> Any:
    """Draw the autocorrelation of the residuals of one sensor, with the band that contains 95 % of
    the values for white noise.

    The lag is in samples, or in spectral lines for a frequency response. Errors: UNKNOWN_NAME;
    NO_DATA if the record has too few samples or, like modes, is not a sequence.

    Args:
        fit: the fit.
        run: name of the run; None takes the first one.
        sensor: name of the sensor; None takes the first one.
        ax: axes to draw into; None makes a new figure.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ...     elements={
    ...         "spring": jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    ...     },
    ... )
    >>> times, noise = jnp.linspace(0, 1, 21), 0.05 * jax.random.normal(jax.random.key(0), (21,))
    >>> track = jb.Experiment(
    ...     times,
    ...     sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
    ...     measured={"x": jnp.cos(2 * jnp.pi * times) + noise},
    ... )
    >>> fitted = jb.fit(model, {"track": track}, free=["spring.stiffness"])
    >>> jb.plots.plot_autocorrelation(fitted).get_xlabel()
    'lag [samples]'
    """
    run, sensor, part = chosen(fit, run, sensor, "plot_autocorrelation")
    r, _ = linearized(fit)
    records = [
        x
        for x in records_about(fit, run, sensor, part)
        if x.series and r[x.rows].any() and most_lags(len(x.rows))
    ]
    if not records:
        raise JaxbodyError(
            Problem(
                "NO_DATA",
                "plot_autocorrelation.sensor",
                f"'{sensor}' has no autocorrelation",
                sensor,
                hint=f"Choose a sensor with a sequence of {FEWEST} samples or more.",
            )
        )
    ax = axes_or_new(ax, 5.5, 3.0)
    for i, record in enumerate(records):
        color = COLORS[i % len(COLORS)]
        values = r[record.rows]
        rho = products(values, most_lags(len(values))) / (values @ values)
        at = np.arange(1, len(rho)) + (i - (len(records) - 1) / 2) * 0.6 / max(len(records), 2)
        name = (
            record.name
            if not np.iscomplexobj(fit.experiments[run].measured[sensor])
            else f"{run}.{sensor} {COMPLEX[i]}"
        )
        ax.vlines(at, 0, rho[1:], color=color, lw=2, label=name)
        ax.plot(at, rho[1:], "o", color=color, ms=3)
    far = 1.96 / np.sqrt(min(len(record.rows) for record in records))
    ax.axhspan(-far, far, color=LIGHT, alpha=0.6, lw=0, zorder=0)
    ax.axhline(0.0, color=INK, lw=0.8)
    lag = "samples" if fit.experiments[run].axis(sensor)[0] == "time" else "lines"
    ax.set(
        xlabel=f"lag [{lag}]",
        ylabel="autocorrelation of residuals [-]",
        ylim=(min(-0.25, ax.get_ylim()[0]), 1.0),
    )
    ax.xaxis.get_major_locator().set_params(integer=True)
    legend(ax, len(records))
    return ax


def plot_multistart(result: Multistart, *, ax: Any = None) -> Any:
    """Draw the cost of each optimum above the least cost, and below it the number of starts that
    reached the optimum; the best optimum is the first.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ...     elements={
    ...         "spring": jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    ...     },
    ... )
    >>> times, noise = jnp.linspace(0, 1, 21), 0.05 * jax.random.normal(jax.random.key(0), (21,))
    >>> track = jb.Experiment(
    ...     times,
    ...     sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
    ...     measured={"x": jnp.cos(2 * jnp.pi * times) + noise},
    ... )
    >>> ax = jb.plots.plot_multistart(
    ...     jb.fitting.multistart(
    ...         model, {"track": track}, free="spring.stiffness", starts=3, spread=0.1
    ...     )
    ... )
    >>> ax.figure.axes[-1].get_xlabel()
    'optimum'
    """
    ax = axes_or_new(ax, 5.0, 3.6)
    count, more = np.arange(1, 1 + len(result.cost)), np.asarray(result.cost) - result.cost[0]
    (below,) = axes_below(ax, 0.6)
    ax.plot(count, more, "o", ms=6, color=COLORS[0])
    if more.max(initial=0.0) > 100 * CLOSE:
        ax.set_yscale("symlog", linthresh=CLOSE)
    ax.axhspan(
        0, CLOSE, color=LIGHT, alpha=0.6, lw=0, zorder=0, label="explains the data about as well"
    )
    below.bar(count, np.asarray(result.hits), color=COLORS[0], width=0.6)
    ax.set_ylabel("cost above the least [-]")
    below.set(xlabel="optimum", ylabel="starts", xlim=(0.4, len(count) + 0.6))
    for axis in (below.xaxis, below.yaxis):
        axis.get_major_locator().set_params(integer=True, min_n_ticks=1)
    legend(ax, 1)
    return ax


def plot_profile_likelihood(
    profile: Profile, *, draws: Posterior | None = None, ax: Any = None
) -> Any:
    """Draw tau, the signed square root of the normalized increase of the cost in a likelihood
    profile, over the parameter, with the confidence interval, in which tau is between the dashed
    lines; with `draws`, a posterior, also a histogram of its draws.

    The curve is a straight line if the likelihood is that of a normal distribution.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ...     elements={
    ...         "spring": jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    ...     },
    ... )
    >>> times, noise = jnp.linspace(0, 1, 21), 0.05 * jax.random.normal(jax.random.key(0), (21,))
    >>> track = jb.Experiment(
    ...     times,
    ...     sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
    ...     measured={"x": jnp.cos(2 * jnp.pi * times) + noise},
    ... )
    >>> fitted = jb.fit(model, {"track": track}, free=["spring.stiffness"])
    >>> jb.plots.plot_profile_likelihood(
    ...     jb.fitting.profile_likelihood(fitted, "spring.stiffness")
    ... ).get_xlabel()
    'spring.stiffness [N/m]'
    """
    ax = axes_or_new(ax, 4.6, 3.2)
    ax.plot(profile.values, profile.tau, "o-", color=COLORS[0], ms=3.5, lw=1.4)
    for sign in (-1, 1):
        ax.axhline(sign * profile.limit, color=GRAY, lw=0.9, ls="--")
    low, high = (x if np.isfinite(x) else None for x in profile.interval)
    if low is not None and high is not None:
        ax.axvspan(low, high, color=LIGHT, alpha=0.5, lw=0, zorder=0)
    ax.axvline(profile.estimate, color=INK, lw=0.8)
    if draws is not None:
        numbers = draws.numbers()
        check_known(profile.path, "plot_profile_likelihood.draws", numbers)
        behind = ax.twinx()
        _histogram(behind, numbers[profile.path][0])
        behind.set(yticks=[], ylim=(0, 1.6 * behind.get_ylim()[1]))
        behind.spines[["top", "right"]].set_visible(False)
        ax.set_zorder(behind.get_zorder() + 1)
        ax.patch.set_visible(False)
    ax.set(
        xlabel=with_unit(profile.path, profile.unit),
        ylabel=r"$\tau$ [standard errors]",
        title=(
            f"{100 * profile.level:g} % interval {profile.interval[0]:.5g} to "
            f"{profile.interval[1]:.5g}"
        ),
    )
    ax.title.set_fontsize(9)
    ax.xaxis.get_major_locator().set_params(nbins=5)  # few ticks, as the numbers are long
    return ax


def plot_posterior(posterior: Posterior, *, ax: Any = None) -> Any:
    """Draw histograms of the draws of each parameter, with the normal approximation of the fit and
    the prior, and for up to five numbers the draws of each pair.

    >>> spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     elements={"spring": spring},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ... )
    >>> tests = {
    ...     f"test {i}": jb.MeasuredModes(frequency=[f], noise={"frequency": 0.02})
    ...     for i, f in enumerate([0.99, 1.02, 1.0])
    ... }
    >>> fitted = jb.fit(model, tests, free=["spring.stiffness"])
    >>> drawn = jb.posterior(fitted, draws=2000)
    >>> len(jb.plots.plot_posterior(drawn).child_axes)  # its panels
    1
    """
    numbers, curves = posterior.numbers(), _curves(posterior)
    names, pairs = list(numbers), len(numbers) <= PAIRS
    columns = len(names) if pairs else min(len(names), 4)
    rows = columns if pairs else -(-len(names) // columns)
    ax = axes_or_new(ax, 1.2 + 2.2 * columns, 0.9 + 2.0 * rows)
    ax.set_axis_off()
    for i, name in enumerate(names):
        x, unit = numbers[name]
        row, column = (i, i) if pairs else divmod(i, columns)
        panel = _panel(ax, row, column, rows, columns)
        _histogram(panel, x)
        for label, color, (at, density) in curves.get(name, []):
            panel.plot(at, density, color=color, lw=1.2, label=label)
        panel.set(yticks=[], xlim=np.quantile(x, INNER), xlabel=with_unit(name, unit))
        if i == 0:
            panel.legend(fontsize=7, frameon=False, loc="upper left", bbox_to_anchor=(0, 1.25))
        for j in range(i) if pairs else ():
            pair = _panel(ax, i, j, rows, columns)
            pair.plot(
                numbers[names[j]][0][:, :SHOWN].ravel(), x[:, :SHOWN].ravel(), ",", color=COLORS[0]
            )
            pair.set(ylabel=with_unit(name, unit), xlabel=with_unit(names[j], numbers[names[j]][1]))
    return ax


def _panel(ax: Any, row: int, column: int, rows: int, columns: int) -> Any:
    width, height = 1 / columns, 1 / rows
    panel = ax.inset_axes(
        (
            (column + 0.16) * width,
            1 - (row + 0.78) * height,
            0.72 * width,
            0.66 * height,
        )
    )
    tidy(panel)
    panel.tick_params(labelsize=7)
    panel.xaxis.label.set_fontsize(8)
    panel.yaxis.label.set_fontsize(8)
    panel.locator_params(nbins=3)
    return panel


def _histogram(ax: Any, x: np.ndarray) -> None:
    ax.hist(x.ravel(), bins=40, density=True, color=LIGHT, zorder=0)


def _curves(posterior: Posterior) -> dict[str, list[tuple[str, str, tuple[Any, Any]]]]:
    """Return {number: curves (label, color, (x, density))} of the normal approximation of the fit
    and of the prior, of numbers that depend on one u each."""
    density, numbers, curves = posterior.density, posterior.numbers(), {}
    estimates = np.asarray(posterior.fit.u)
    errors, _ = posterior.fit._assessed().spread(np.eye(len(estimates)))
    for (parameter, own), prior in zip(density.unknowns.parts, density.priors, strict=True):
        if not isinstance(parameter.form, Elementwise):
            continue
        for k, label in enumerate(parameter.form.labels()):
            i, name, size = own.start + k, parameter.path + label, parameter.form.size
            lines = curves.setdefault(name, [])
            if i < len(estimates) and np.isfinite(errors[i]):
                t = np.linspace(-4, 4, 101)
                x, slope = np.array(
                    [
                        [part[k] for part in parameter.form.numbers(np.full(size, u))]
                        for u in estimates[i] + errors[i] * t
                    ]
                ).T
                normal = np.exp(-0.5 * t**2) / np.sqrt(2 * np.pi) / (errors[i] * np.abs(slope))
                lines.append(("fit", COLORS[0], (x, normal)))
            if prior.mean is not None:
                low, high = np.quantile(numbers[name][0], INNER)
                x = np.linspace(low, high, 101)
                lines.append(("prior", GRAY, (x, prior.density(x, k))))
    return curves


def plot_interval_coverage(result: Coverage, *, ax: Any = None) -> Any:
    """Draw for each parameter the share of replicates whose confidence intervals contain the true
    value [%], and the confidence level with a band of two standard errors of the share."""
    count = len(result.parameters)
    ax = axes_or_new(ax, 6.0, 1.4 + 0.32 * count)
    at, level, error = (
        np.arange(count)[::-1],
        100 * result.level,
        200 * float(result.standard_error[0]),
    )
    ax.axvspan(level - error, min(level + error, 100.0), color=LIGHT, alpha=0.6, lw=0, zorder=0)
    ax.axvline(level, color=GRAY, lw=0.9, ls="--")
    ax.plot(100 * result.contained, at, "o", ms=6, color=COLORS[0])
    ax.set_yticks(at, result.parameters)
    title = f"{int(result.ok.sum())} replicates; pale: {level:g} % and two standard errors"
    ax.set(
        xlabel="intervals that contain the true value [%]", ylim=(-0.6, count - 0.4), title=title
    )
    ax.title.set_fontsize(9)
    return ax


def plot_choice(choice: Choice, *, ax: Any = None) -> Any:
    """Draw the shares of the continuous design: of the chosen candidates, and of the 30 others at
    most that have a share. The title states the efficiency of the choice.

    >>> x = jnp.linspace(-1, 1, 21)
    >>> line = {f"{at:.1f}": jnp.array([1.0, at]) for at in x}  # y = a + b x
    >>> [text.get_text() for text in jb.choose(line, n=2).plot().get_yticklabels()[:2]]
    ['-1.0', '1.0']
    """
    shares, order = np.asarray(choice.shares), np.argsort(-choice.shares, kind="stable")
    taken = np.isin(choice.candidates, choice.names)
    others = order[~taken[order] & (shares[order] > LEAST_SHARE)][:MOST_CANDIDATES]
    bars = {"chosen": order[taken[order]], "not chosen": others}
    count = len(taken.nonzero()[0]) + len(others)
    ax, y = axes_or_new(ax, 7.0, 1.2 + 0.22 * max(count, 3)), 0
    for (label, which), color in zip(bars.items(), (COLORS[1], COLORS[0]), strict=True):
        at = y + np.arange(len(which))
        ax.barh(at, shares[which], height=0.65, color=color, lw=0, label=label)
        y += len(which)
    named = [choice.candidates[i] for which in bars.values() for i in which]
    ax.set_yticks(range(count), named, fontsize=8)
    ax.set(
        xlabel="share of the continuous design [-]",
        ylim=(count - 0.5, -0.5),
        title=(
            f"{len(choice.names)} of {len(taken)} by {choice.criterion}: at least "
            f"{100 * choice.efficiency:.3g} % of the best"
        ),
    )
    ax.title.set_fontsize(9)
    legend(ax, 2)
    return ax


def chosen(
    fit: Fit | Validation, run: str | None, sensor: str | None, where: str
) -> tuple[str, str, int | None]:
    """Return the names of run and sensor, and the number of a part of the sensor or None for the
    whole sensor; "plate moment" names the second part of the ForcePlate "plate".

    Args:
        fit: the fit or validation.
        run, sensor: names; None takes the first ones.
        where: name of the calling function, for messages.

    Error: UNKNOWN_NAME."""
    run = run or next(iter(fit.experiments))
    check_known(run, f"{where}.run", fit.experiments)
    given = fit.experiments[run]
    names: dict[str, tuple[str, int | None]] = {name: (name, None) for name in given.channels}
    names |= {
        f"{name} {part}": (name, i)
        for name, channel in given.channels.items()
        for i, part in enumerate(channel.parts)
    }
    sensor = sensor or next(iter(names))
    check_known(sensor, f"{where}.sensor", names)
    return run, *names[sensor]


def records_about(
    fit: Fit | Validation, run: str, sensor: str, part: int | None = None
) -> list[ResidualSeries]:
    """Return the residual series of each component of a sensor, or of one part of it."""
    return [
        x
        for x in records_of(fit.experiments)
        if x.run == run
        and x.name.split("[")[0] == f"{run}.{sensor}"
        and (part is None or x.group.endswith(f" {part}"))
    ]


def linearized(fit: Fit) -> tuple[np.ndarray, np.ndarray]:
    """Return the residuals divided by the noise, and their Jacobian with respect to the
    parameters."""
    _, J, runs = residual_and_jacobian(fit.task, fit.u)
    return fit.task.linearized(runs, np.asarray(J))
