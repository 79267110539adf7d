"""Repairs of records on request, each with a note: repeated rows, uneven times, empty channels,
short gaps."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.core.arrays import time_text
from jaxbody.core.errors import JaxbodyError, Problem, Problems
from jaxbody.core.tables import counted
from jaxbody.records.sampling_checks import EQUAL, counts_of, runs, sampling_of

FILLS = ("linear", "spline")
MISMATCH = 1e-3  # largest relative difference between a stated rate and that of the times


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
            f"dropped {counted(int(same.sum()), 'row')} equal to the one before, "
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
            f"inserted {counted(len(places), 'row')} that "
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
                    f"filled {counted(len(at), 'sample')} of '{key}'"
                    + (f"[{k}]" if x.ndim == 2 else "")
                    + f" by {fill}"
                )
        out[key] = (rows.reshape(len(new), *x.shape[1:]), unit)
    return new, out
