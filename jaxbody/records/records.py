"""Measured records: times and channels in SI units, checked and unchanged; repairs on
request only."""

from __future__ import annotations

from functools import partial
from typing import Any

import numpy as np

from jaxbody.core import tables, units
from jaxbody.core.arrays import float_array, time_array, time_text
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.core.results import Labeled, dataset
from jaxbody.records.sampling_checks import (
    EQUAL,
    Sampling,
    check_sampling,
    check_values,
    counts_of,
    runs,
    sampling_of,
)

FILLS = ("linear", "spline")
MISMATCH = 1e-3  # largest relative difference between a stated rate and that of the times


class Record(Labeled, tables.Printed):
    """A measured record in SI units; it prints as a table.

    `times` [s] (n,); `channels` {name: (n,) or (n, k)}, NaN where a sample is missing; `units`
    {name: SI unit}; `stated` {name: given unit}; `sampling` (step, jitter, missing); `notes` on
    repairs. `record["acc"]` is a channel, `record.part(0, 2)` the part from 0 to 2 s.

    Args:
        times: in `time_unit`; None: from `rate`, the first sample at 0
        channels: {name: (values, unit)}
        time_unit: unit of the times
        rate: sampling rate [Hz]; if times are given too, they are moved to whole steps of it, by
            half a step at most; their own rate may differ by 0.1 % at most
        highest: the highest frequency of interest [Hz], compared with the rate; None: no comparison
        irregular: accept jitter above 5 % of a step and more than 5 % of missing samples
        drop_duplicates: leave out rows that repeat the previous one
        fill: "linear" or "spline", to fill gaps of up to `max_gap` samples, in a channel or of
            whole rows; None: gaps remain
        max_gap: longest gap that is filled [samples]
        drop: "all_nan" to leave out channels without a sample
        name: name of the record, in messages

    Repairs are made on request only, and are listed in the notes.

    Errors, reported together: NO_DATA, NAN_TIME, UNSORTED_TIME, DUPLICATE_TIME, RATE_MISMATCH,
    JITTER, GAPS, NO_TIME, NO_UNIT, UNKNOWN_UNIT, WRONG_DIMENSION, BAD_SHAPE, NON_FINITE,
    ALL_NAN, BAD_OPTION. Warns MISSING, DEAD, SATURATED, UNIT (g for m/s2, degrees for radians),
    TIME_UNIT, LOW_RATE.

    >>> acc = ([0.1, 0.2, 0.0, -0.1], "g")
    >>> jb.Record([0, 10, 20, 30], {"acc": acc}, time_unit="ms")["acc"].round(3).tolist()
    [0.981, 1.961, 0.0, -0.981]
    """

    index = "time"
    times: np.ndarray
    channels: dict[str, np.ndarray]
    units: dict[str, str]
    stated: dict[str, str]
    sampling: Sampling
    notes: tuple[str, ...]

    def __init__(
        self,
        times: Any,
        channels: dict[str, tuple[Any, str]],
        *,
        time_unit: str = "s",
        rate: float | None = None,
        highest: float | None = None,
        irregular: bool = False,
        drop_duplicates: bool = False,
        fill: str | None = None,
        max_gap: int = 3,
        drop: str | None = None,
        name: str = "Record",
    ):
        notes = []
        with Problems() as problems:
            _check_options(rate, fill, max_gap, drop, problems)
            given = _channels(channels, name, problems)
            t = _times(times, time_unit, rate, given, name, problems)
        for key, (x, _) in given.items():
            if len(x) != len(t):
                problems.add(
                    "BAD_SHAPE",
                    f"{name}['{key}']",
                    f"has {len(x)} samples",
                    value=x.shape,
                    limit=f"{len(t)}, as many as times",
                    hint=(
                        "It looks transposed: give values.T."
                        if x.shape[-1] == len(t)
                        else "One row per time."
                    ),
                )
        problems.raise_if_any()
        if drop_duplicates:
            t, given = without_duplicates(t, given, name, notes)
        if rate is not None and len(t) > 1 and (np.diff(t) > 0).all():
            t = at_rate(t, rate, f"{name}.times", problems, notes)
        check_sampling(
            t,
            problems,
            f"{name}.times",
            irregular=irregular,
            highest=highest,
            dropped=drop_duplicates,
        )
        for key, (x, unit) in given.items():
            check_values(x, unit, t, problems, f"{name}['{key}']", may_lack=drop is not None)
        problems.raise_if_any()
        if drop is not None:
            given = without_empty(given, notes, name)
        if fill is not None:
            t, given = filled(t, given, fill, max_gap, notes)
        self.times, self.sampling = t, sampling_of(t)
        self.channels = {key: x * unit.factor for key, (x, unit) in given.items()}
        self.units = {key: unit.si for key, (_, unit) in given.items()}
        self.stated = {key: unit.text for key, (_, unit) in given.items()}
        self.notes = tuple(notes)

    def __getitem__(self, name: str) -> np.ndarray:
        if name not in self.channels:
            raise JaxbodyError(
                Problem(
                    "UNKNOWN_CHANNEL",
                    "Record",
                    f"has no channel '{name}'",
                    name,
                    hint=f"It has: {', '.join(self.channels)}.",
                )
            )
        return self.channels[name]

    def _span(self) -> str:
        return " to ".join(time_text(t, self.times) for t in self.times[[0, -1]]) + " s"

    def part(self, start: float, stop: float) -> Record:
        """Return the samples from start to stop [s], both included. Error: NO_DATA for fewer than
        two."""
        inside = (self.times >= start) & (self.times <= stop)
        if inside.sum() < 2:
            raise JaxbodyError(
                Problem(
                    "NO_DATA",
                    "Record.part",
                    f"has {inside.sum()} samples from {time_text(start, self.times)} to "
                    f"{time_text(stop, self.times)} s",
                    (start, stop),
                    self._span(),
                    "Give a longer part.",
                )
            )
        return self.changed(
            self.times[inside],
            {name: x[inside] for name, x in self.channels.items()},
            self.units,
        )

    def changed(
        self, times: np.ndarray, channels: dict[str, Any], units: dict[str, str], note: str = ""
    ) -> Record:
        """Return a record with these times and channels in SI units, with a note added."""
        new = object.__new__(Record)
        new.times, new.sampling = times, sampling_of(times)
        new.channels, new.units = channels, units
        new.stated = {name: self.stated.get(name, unit) for name, unit in units.items()}
        new.notes = (*self.notes, note) if note else self.notes
        return new

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset of the channels over time."""
        variables = {
            name: (("time", *(f"{name}_component",) * (x.ndim - 1)), x, self.units[name])
            for name, x in self.channels.items()
        }
        return dataset(variables, {"time": ("time", self.times, {"units": "s"})}, "record")

    def _tables(self) -> list[tables.PrintedTable]:
        s, rows = self.sampling, []
        for name, x in self.channels.items():
            for k, column in enumerate(x.reshape(len(x), -1).T):
                gone = int(np.isnan(column).sum())
                rows.append(
                    (
                        name + (f"[{k}]" if x.ndim == 2 else ""),
                        self.units[name],
                        self.stated[name],
                        len(x) - gone,
                        gone,
                        np.nanmin(column),
                        np.nanmax(column),
                    )
                )
        jitter = tables.percent(s.jitter / s.step)
        note = (
            f"{len(self.times)} times, {self._span()}: {s.rate:.6g} Hz, "
            f"{f'jitter {jitter}, ' if jitter else ''}{s.missing} missing"
        )
        heads = ("channel", "unit", "stated in", "samples", "gaps", "least", "largest")
        return [tables.PrintedTable("Record", heads, rows, "\n".join([note, *self.notes]))]


def _check_options(rate: Any, fill: Any, max_gap: Any, drop: Any, problems: Problems) -> None:
    for option, value, good, limit in (
        (
            "rate",
            rate,
            rate is None or (isinstance(rate, int | float) and 0 < rate < np.inf),
            "Hz, > 0",
        ),
        ("fill", fill, fill is None or fill in FILLS, " or ".join(FILLS)),
        ("max_gap", max_gap, isinstance(max_gap, int) and max_gap > 0, "a number of samples, > 0"),
        ("drop", drop, drop in (None, "all_nan"), '"all_nan"'),
    ):
        if not good:
            problems.add(
                "BAD_OPTION",
                f"Record.{option}",
                f"is {value!r:.40}",
                value=value,
                limit=limit,
                hint="Give such a value, or leave it out.",
            )


def _channels(
    channels: Any, name: str, problems: Problems
) -> dict[str, tuple[np.ndarray, units.Unit]]:
    if not isinstance(channels, dict) or not channels:
        problems.add(
            "NO_DATA",
            f"{name}.channels",
            "is empty or not a dict",
            value=channels,
            limit="at least one channel",
            hint='Give channels={"acc": (values, "m/s2")}.',
        )
        return {}
    read = {
        key: problems.gather(partial(_channel, pair, f"{name}['{key}']"))
        for key, pair in channels.items()
    }
    return {key: pair for key, pair in read.items() if pair is not None}


def _channel(pair: Any, where: str) -> tuple[np.ndarray, units.Unit]:
    """Return the values and the unit of a channel. Errors: NO_UNIT, NO_DATA, BAD_SHAPE, those of
    values and units."""
    if not isinstance(pair, tuple) or len(pair) != 2 or not isinstance(pair[1], str):
        raise JaxbodyError(
            Problem(
                "NO_UNIT",
                where,
                "has no unit",
                limit='(values, "m/s2")',
                hint='State it, or "1" for numbers without a unit.',
            )
        )
    x, unit = np.asarray(float_array(pair[0], where)), units.parse(pair[1], where)
    if x.ndim not in (1, 2) or x.size == 0:
        raise JaxbodyError(
            Problem(
                "NO_DATA" if x.size == 0 else "BAD_SHAPE",
                where,
                f"has shape {x.shape}",
                x.shape,
                "(n,) or (n, k)",
                "One row per time.",
            )
        )
    return x, unit


def _times(
    times: Any, time_unit: str, rate: Any, given: dict[str, Any], name: str, problems: Problems
) -> np.ndarray:
    where = f"{name}.times"
    if times is None:
        if rate is None:
            problems.add(
                "NO_TIME", where, "are missing", limit="times or rate=", hint="Give one of them."
            )
        return np.arange(len(next(iter(given.values()))[0]) if given else 0) / (rate or 1.0)
    read = problems.gather(
        lambda: (np.asarray(time_array(times, where)), units.parse(time_unit, where))
    )
    if read is None:
        return np.zeros(0)
    t, unit = read
    if unit.dimension != units.TIME:
        problems.add(
            "WRONG_DIMENSION",
            where,
            f"is in '{time_unit}'",
            value=time_unit,
            limit="s ms us min h",
            hint="Give a unit of time.",
        )
    if t.ndim != 1:
        problems.add(
            "BAD_SHAPE",
            where,
            f"has shape {t.shape}",
            value=t.shape,
            limit="(n,)",
            hint="Give one time per row.",
        )
    return t * unit.factor


def without_duplicates(
    t: np.ndarray, given: dict[str, Any], name: str, notes: list[str]
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return times and channels without rows that equal the previous one in time and values.
    Repeated times with different values remain, and are an error of `check_sampling`."""
    same = np.diff(t) == 0
    for x, _ in given.values():
        rows = x.reshape(len(x), -1)
        same &= ((rows[1:] == rows[:-1]) | (np.isnan(rows[1:]) & np.isnan(rows[:-1]))).all(1)
    keep = np.concatenate([[True], ~same])
    if same.any():
        notes.append(
            f"dropped {tables.counted(int(same.sum()), 'row')} equal to the one before, "
            f"the first at {time_text(t[1:][same][0], t, 9)} s"
        )
    return t[keep], {key: (x[keep], unit) for key, (x, unit) in given.items()}


def at_rate(
    t: np.ndarray, rate: float, where: str, problems: Problems, notes: list[str]
) -> np.ndarray:
    """Return increasing times, each moved to the nearest t_0 + k/rate. Error: RATE_MISMATCH if the
    rate differs from that of the times, or if the number of steps between neighboring times is not
    that of `counts_of`."""
    steps = np.round((t - t[0]) * rate)
    own = sampling_of(t).rate
    wrong = np.flatnonzero(np.diff(steps) != counts_of(t))
    if abs(rate / own - 1) > MISMATCH or len(wrong):
        message, limit = f"has {own:.6g} Hz, not the stated {rate:.6g} Hz", "0.1 %"
        if abs(rate / own - 1) <= MISMATCH:
            message, limit = (
                (
                    f"leaves the steps of the stated {rate:.6g} Hz at "
                    f"{time_text(t[wrong[0] + 1], t)} s"
                ),
                "half a step",
            )
        problems.add(
            "RATE_MISMATCH",
            where,
            message,
            value=own,
            limit=limit,
            hint="Leave out rate= to use the times, or leave out the times to use the rate.",
        )
        return t
    even = t[0] + steps / rate
    if (moved := np.abs(even - t).max()) > EQUAL / rate:
        notes.append(f"moved times by up to {moved:.2g} s, to whole steps of {rate:.6g} Hz")
    return even


def without_empty(given: dict[str, Any], notes: list[str], name: str) -> dict[str, Any]:
    """Return the channels that have samples. Error: NO_DATA if no channel has any."""
    empty = [key for key, (x, _) in given.items() if np.isnan(x.reshape(len(x), -1)).all(0).any()]
    if len(empty) == len(given):
        raise JaxbodyError(
            Problem(
                "NO_DATA",
                name,
                "has no channel with samples",
                empty,
                "at least one",
                "Was an instrument connected?",
            )
        )
    notes += [f"dropped channel '{key}', which has no sample" for key in empty]
    return {key: pair for key, pair in given.items() if key not in empty}


def filled(
    t: np.ndarray, given: dict[str, Any], fill: str, max_gap: int, notes: list[str]
) -> tuple[np.ndarray, dict[str, Any]]:
    """Return times and channels with gaps of up to `max_gap` samples filled, of whole rows or of
    one channel; longer gaps remain."""
    from scipy.interpolate import CubicSpline

    counts = counts_of(t).astype(int)
    fits = (counts > 1) & (counts <= max_gap + 1)
    added = [
        t[i] + (t[i + 1] - t[i]) * np.arange(1, counts[i]) / counts[i] for i in np.flatnonzero(fits)
    ]
    places = np.repeat(np.flatnonzero(fits) + 1, counts[fits] - 1)
    new = np.insert(t, places, np.concatenate(added)) if added else t
    if added:
        notes.append(
            f"inserted {tables.counted(len(places), 'row')} that "
            f"{'was' if len(places) == 1 else 'were'} missing"
        )
    out = {}
    for key, (x, unit) in given.items():
        rows = np.insert(x.reshape(len(x), -1), places, np.nan, axis=0)
        for k, column in enumerate(rows.T):
            gone = np.isnan(column)
            short = [
                np.arange(i, j)
                for i, j in runs(gone)
                if j - i <= max_gap and i > 0 and j < len(column)
            ]
            if short and (~gone).sum() >= 4:
                at = np.concatenate(short)
                known = new[~gone], column[~gone]
                rows[at, k] = (
                    CubicSpline(*known)(new[at]) if fill == "spline" else np.interp(new[at], *known)
                )
                notes.append(
                    f"filled {tables.counted(len(at), 'sample')} of '{key}'"
                    + (f"[{k}]" if x.ndim == 2 else "")
                    + f" by {fill}"
                )
        out[key] = (rows.reshape(len(new), *x.shape[1:]), unit)
    return new, out
