"""The interface between measurements and fits: records in time, frequency responses, modes and
curves are all residuals by channel; checks of measured numbers. A measurement without data is a
plan of the channels whose noise it states."""

from abc import abstractmethod
from collections.abc import Mapping
from typing import Any, ClassVar

import equinox as eqx
import numpy as np

from jaxbody.core.arrays import Array, as_numpy, concrete, device_array, indices
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status
from jaxbody.core.tables import PlotMethod
from jaxbody.fitting.statistics.noises import ResidualSeries
from jaxbody.mechanics.equilibria import equilibrium
from jaxbody.model.models import Model
from jaxbody.sensors.sensors import Channel
from jaxbody.vibration.linearizations import Linearization, linearize


class Measurement(eqx.Module):
    """Base class of measurements. `measured`: numbers by channel; `noise`: their standard
    deviations, where stated; `linear`: True if predictions follow from small motions about the
    equilibrium, which are computed once for all such measurements."""

    linear: ClassVar[bool] = False
    plot = PlotMethod()
    measured: eqx.AbstractVar[dict[str, Array]]
    noise: eqx.AbstractVar[dict[str, Array] | None]

    @property
    @abstractmethod
    def channels(self) -> Mapping[str, Channel]: ...

    @property
    def names(self) -> tuple[str, ...]:
        """The names of what is measured, or planned."""
        return tuple(self.measured or self.noise or ())

    @abstractmethod
    def readings(self, model: Any, integration: Any, lin: Any) -> dict[str, Array]:
        """Return the predictions {channel: array like `measured`}, NaN where the model predicts no
        value. `lin`: linearization of the model, for measurements with `linear`."""

    def residual(self, name: str, reading: Array) -> Array:
        """Return reading minus measured value of a channel, zero for missing samples."""
        return self.channels[name].residual(reading, self.measured[name])

    def named(self) -> dict[str, Any]:
        """Return the parts that have names in paths."""
        return {}

    def absent(self) -> dict[str, str]:
        """Return {path: hint} of optional parts that are not given."""
        return {}

    def on(self, before: Any, after: Any) -> Any:
        """Return the measurement for the suspension `after`, whose hard points have moved from
        those of the suspension `before`."""
        return self

    def scale_of(self, path: str, unit: str) -> Any:
        """Return the scale s of a parameter of this measurement in its transform x0 + s u; None if
        its initial size is to be used as the scale."""

    def moved_rows(self, path: str, channel: str) -> Array | None:
        """Return which rows of a channel depend on each part of a leaf of this measurement,
        booleans (rows, parts) with at most two consecutive parts for each row; None if all rows
        depend on all parts."""

    def check(self, model: Any, where: str) -> None:
        """Check that the measurement matches the model."""

    def explain(self, model: Any, integration: Any) -> str:
        """Return the reason why readings are not finite."""
        if self.linear:
            return f"{Status(int(small_motions(model).status)).name} at the equilibrium"
        return "the model has no finite prediction there"

    @abstractmethod
    def axis(self, channel: str) -> tuple[str, Array | np.ndarray, str]:
        """Return the independent variable of a channel: name, values, unit."""

    @abstractmethod
    def place(self, row: int) -> tuple[str, float]:
        """Return the time, frequency or mode of a row of `measured`, as text and as a number."""

    def present(self, name: str) -> Array:
        """Return which components of the residuals of a channel have samples."""
        return ~self.channels[name].missing(as_numpy(self.measured[name]))


def small_motions(model: Model) -> Linearization:
    """Linearize the model about the equilibrium that a search from the reference pose reaches."""
    return linearize(model, equilibrium(model))


class ByFrequency(Measurement):
    """Base class of measurements with one row for each frequency [Hz]."""

    frequencies: eqx.AbstractVar[Array]

    def axis(self, channel):
        return "frequency", self.frequencies, "Hz"

    def place(self, row):
        return f"{float(self.frequencies[row]):.6g} Hz", float(self.frequencies[row])


class NumberChannel(Channel):
    """A channel with one number in each row, such as one curve; `series` as in `Channel`."""

    shape: ClassVar[tuple[int, ...]] = ()  # pyright: ignore[reportIncompatibleVariableOverride]
    unit: str = eqx.field(static=True, default="")  # pyright: ignore[reportIncompatibleVariableOverride]
    series: bool = eqx.field(static=True, default=True)  # pyright: ignore[reportIncompatibleVariableOverride]


def check_measurements(
    experiments: Mapping[str, Measurement], where: str, *, plans: bool = False
) -> Problems:
    """Return the problems of measurements by name, to which the caller may add others; `plans` may
    have no data. Error: WRONG_KIND if `experiments` is not a dict."""
    problems = Problems()
    if not isinstance(experiments, dict):
        kind = type(experiments).__name__
        raise JaxbodyError(
            Problem(
                "WRONG_KIND",
                where,
                f"is one {kind} without a name"
                if isinstance(experiments, Measurement)
                else f"is a {kind}",
                experiments,
                "a dict of experiments by name",
                'Write {"run": experiment}: paths and tables contain the name.',
            )
        )
    if not experiments:
        problems.add("NO_DATA", where, "is empty", limit="at least one Experiment")
    for name, experiment in experiments.items():
        if not isinstance(experiment, Measurement):
            problems.add(
                "WRONG_KIND",
                f"experiments[{name!r}]",
                f"is a {type(experiment).__name__}",
                value=experiment,
                limit="Experiment",
            )
        elif not (experiment.measured or plans):
            problems.add(
                "NO_DATA",
                f"experiments[{name!r}]",
                "is a plan, without measured data",
                hint="Give measured=, a record or arrays; `measure` of a simulated motion makes "
                "some. `expected_fit` takes plans.",
            )
    return problems


def check_rows(
    array: Any,
    shape: tuple[int, ...],
    where: str,
    problems: Problems,
    *,
    missing: str,
    limit: str = "",
    hint: str = "",
    remedy: str = "Leave it out.",
) -> None:
    """Check measured numbers, one for each row; errors are added to `problems`.

    Args:
        array: the numbers.
        shape: required shape of `array`.
        where: name of the argument, for messages.
        problems: collects BAD_SHAPE, NON_FINITE, ALL_NAN.
        missing: meaning of a NaN, for messages.
        limit, hint: texts for a wrong shape; by default the shape, and no hint.
        remedy: hint if all numbers are missing.
    """
    known = concrete(array)
    if np.shape(array) != shape:
        problems.add(
            "BAD_SHAPE",
            where,
            f"has shape {np.shape(array)}",
            value=np.shape(array),
            limit=limit or str(shape),
            hint=hint,
        )
    elif known is not None and np.isinf(known).any():
        problems.add(
            "NON_FINITE", where, "has infinite values", limit=f"finite, or NaN for {missing}"
        )
    elif known is not None and np.isnan(known).all():
        problems.add("ALL_NAN", where, "has only NaN", hint=remedy)


def noise_of(
    given: dict[Any, Any], measured: dict[Any, Any], where: str, problems: Problems
) -> dict[Any, Any]:
    """Return the standard deviations of measured quantities, each one number or one for each
    measured number; errors are added to `problems`."""
    levels = {}
    for name, level in given.items():
        place, deviation = (
            f"{where}[{name!r}]",
            level if concrete(level) is None else np.asarray(level, float),
        )
        shapes = ((), np.shape(measured[name]) if name in measured else ())
        if name not in measured:
            problems.add(
                "UNKNOWN_NAME",
                place,
                "is not measured",
                value=name,
                limit=", ".join(map(str, measured)),
            )
        elif np.shape(deviation) not in shapes:
            problems.add(
                "BAD_SHAPE",
                place,
                f"has shape {np.shape(deviation)}",
                value=deviation,
                limit=" or ".join(map(str, dict.fromkeys(shapes))),
            )
        elif (
            isinstance(deviation, np.ndarray)
            and not (np.isfinite(deviation) & (deviation > 0)).all()
        ):
            problems.add(
                "BAD_NOISE",
                place,
                "is not positive",
                value=deviation,
                limit="> 0",
                hint="Leave out noise= to estimate it.",
            )
        else:
            levels[name] = device_array(deviation)
    return levels


def records_of(experiments: dict[str, Measurement]) -> list[ResidualSeries]:
    """Return the records of the residuals of all measurements, in the order of the residuals. All
    runs share one noise level for each unit of a channel."""
    records, first = [], 0
    for run, experiment in sorted(experiments.items()):
        for name, channel in sorted(experiment.channels.items()):
            present = experiment.present(name)
            labels, present = indices(present.shape[1:]), present.reshape(len(present), -1)
            units = np.broadcast_to(
                channel.spread(np.arange(channel.units)), (1, present.shape[1])
            )[0]
            for i, (label, unit) in enumerate(zip(labels, units, strict=True)):
                times = np.flatnonzero(present[:, i])
                records.append(
                    ResidualSeries(
                        name=f"{run}.{name}{label}",
                        group=f"{name} {unit}",
                        run=run,
                        rows=first + times * present.shape[1] + i,
                        times=times,
                        series=channel.series,
                        known=not channel.series and name in (experiment.noise or {}),
                    )
                )
            first += present.size
    return records
