"""Acceleration records as spectra take them: equally spaced samples, from a Record or a pair
(times, accelerations)."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.core.arrays import concrete
from jaxbody.core.errors import Problems
from jaxbody.records.records import Record
from jaxbody.records.samplings import even_samples

WANTED = "a Record with one acceleration, or (times, accelerations) [s, m/s2]"


def checked_samples(
    record: Any, unit: str, where: str, problems: Problems
) -> tuple[Any, Any] | None:
    """The values of a record with one channel in this unit ("" for any), or of (times, values), and
    the step between them [s]; None if there are none, with a problem added. Errors: WRONG_KIND,
    WRONG_DIMENSION, GAPS, NOT_UNIFORM, BAD_SHAPE, NON_FINITE."""
    known = len(problems.collected)
    if isinstance(record, Record):
        columns = {
            name: x
            for name, x in record.channels.items()
            if x.ndim == 1 and unit in ("", record.units[name])
        }
        if len(columns) != 1:
            listed = ", ".join(f"'{name}' [{of}]" for name, of in record.units.items())
            message, hint = (
                (
                    f"has {len(columns)} channels of one "
                    f"column{f' in {unit}' if unit else ''}: {listed}"
                ),
                "Choose one:",
            )
            hint += " (record.times, record['...'])."
            problems.add(
                "WRONG_DIMENSION", where, message, value=record.units, limit="one", hint=hint
            )
            return None
        record = record.times, next(iter(columns.values()))
    if not isinstance(record, tuple) or len(record) != 2:
        limit = WANTED if unit else "a Record with one channel, or (times, values)"
        problems.add(
            "WRONG_KIND", where, f"is a {type(record).__name__}", value=record, limit=limit
        )
        return None
    gaps = concrete(record[1]) if hasattr(record[1], "dtype") else None
    if gaps is not None and gaps.dtype.kind == "f" and (count := int(np.isnan(gaps).sum())):
        hint = 'Read the record with fill="spline", or take a part without gaps.'
        problems.add(
            "GAPS", where, f"lacks {count} samples", value=count, limit="no gaps", hint=hint
        )
        return None
    values, step = even_samples(*record, (f"{where} times", where), problems)
    return None if values is None or len(problems.collected) > known else (values, step)
