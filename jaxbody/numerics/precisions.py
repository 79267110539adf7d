"""Precision of numbers: tolerances that it can reach, and constants that JAX keeps in the precision of their first use."""

from __future__ import annotations

import gc

import jax
import numpy as np

NEWTON = 1024  # largest last step of Newton's method, in roundings: the error that remains is of the order of its square

_last: bool | None = None  # whether the last computation was in float64


def reachable(tolerance: float, dtype: np.dtype, roundings: int = 32) -> float:
    """The larger of the tolerance and this number of roundings of 1: 32 are 7e-15 in float64, 4e-6 in float32."""
    return max(tolerance, roundings * float(np.finfo(dtype).eps))


def in_float64(dtype: np.dtype) -> str:
    """Advice where float32 may be too coarse; "" in float64."""
    return 'compute in float64: jax.config.update("jax_enable_x64", True) before building the model' if dtype == np.float32 else ""


def begin(x64: bool) -> None:
    """Announce the precision of the computations that follow.

    JAX keeps one array for each NumPy constant, in the precision of its first use, and also uses it in the other precision (0.8 to 0.12),
    so that precisions are mixed. After a switch its caches are therefore emptied, and programs are compiled again."""
    global _last
    if _last not in (None, x64):
        jax.clear_caches()
        gc.collect()
    _last = x64
