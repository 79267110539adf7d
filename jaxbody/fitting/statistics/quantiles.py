"""Quantiles of Student's t, and levels of confidence."""

from __future__ import annotations

from typing import Any

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem


def quantile(level: float, freedom: Any, *, sides: int = 2) -> np.ndarray:
    """Quantile of Student's t for a confidence level with `freedom` degrees of freedom."""
    from scipy.special import stdtrit  # as scipy.stats, which takes 0.4 s to import, does

    return np.asarray(stdtrit(freedom, 1 - (1 - level) / sides))


def check_level(level: float, where: str) -> None:
    """Check that a confidence level is between 0 and 1. Error: BAD_LEVEL."""
    if not 0 < level < 1:
        raise JaxbodyError(
            Problem(
                "BAD_LEVEL", where, f"is {level}", level, "between 0 and 1", "Give 0.95 for 95 %."
            )
        )
