"""The precision of numbers: tolerances that it can reach, and constants that JAX keeps in the precision of their first use."""

from __future__ import annotations

import gc

import jax
import numpy as np

NEWTON = 1024  # roundings that the last step of Newton's method may be: what is left after it is the square

_last: bool | None = None  # whether the last computation was in float64


def reachable(tolerance: float, dtype: np.dtype, roundings: int = 32) -> float:
    """The tolerance, or so many roundings of 1 where these are more: 32 are 7e-15 in float64, 4e-6 in float32."""
    return max(tolerance, roundings * float(np.finfo(dtype).eps))


def in_float64(dtype: np.dtype) -> str:
    """What to do where float32 may be too coarse; nothing in float64."""
    return 'compute in float64: jax.config.update("jax_enable_x64", True) before building the model' if dtype == np.float32 else ""


def begin(x64: bool) -> None:
    """Say in which precision what follows is computed.

    JAX keeps one array for each constant of NumPy, of the precision in which it was first used, and takes it for the other precision too
    (0.8 to 0.12): programs of both then mix. After a switch its caches are emptied, so that programs are compiled again."""
    global _last
    if _last not in (None, x64):
        jax.clear_caches()
        gc.collect()
    _last = x64
