"""Tolerances that the precision of numbers allows."""

import numpy as np

# largest last step of Newton's method, in roundings: the error that remains is of the order of
# its square
NEWTON = 1024


def reachable(tolerance: float, dtype: np.dtype, roundings: int = 32) -> float:
    """Return the larger of the tolerance and this number of roundings of 1: 32 are 7e-15 in
    float64, 4e-6 in float32."""
    return max(tolerance, roundings * float(np.finfo(dtype).eps))


def in_float64(dtype: np.dtype) -> str:
    """Return the advice, for a message, to compute in float64 if `dtype` is float32; ""
    otherwise."""
    return (
        'compute in float64: jax.config.update("jax_enable_x64", True) before building the model'
        if dtype == np.float32
        else ""
    )
