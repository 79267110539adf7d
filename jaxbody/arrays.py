"""Numbers from users: once made float arrays, never touched again."""

from __future__ import annotations

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.errors import JaxbodyError, Problem


def float_array(value: Any, where: str = "value") -> np.ndarray | jax.Array:
    """A float64 NumPy array of a number, list, array or data frame; an array that JAX traces stays one.

    NumPy, not JAX: building a model then touches no device and does not depend on the x64 switch.
    """
    if isinstance(value, jax.core.Tracer):
        return value if jnp.issubdtype(value.dtype, jnp.floating) else value.astype(float)
    array = np.asarray(value)
    if array.dtype.kind == "c":
        raise JaxbodyError(Problem("COMPLEX", where, f"is complex ({array.ravel()[:1]})", value, "real numbers", "Give real numbers."))
    if array.dtype.kind not in "fiub":
        raise JaxbodyError(Problem("NOT_A_NUMBER", where, f"is {value!r:.80}, which is no array of numbers", value, "numbers"))
    return array.astype(np.float64)


def device_array(value: np.ndarray | jax.Array) -> jax.Array:
    """The JAX array, float64 or, where x64 is off, float32."""
    return jnp.asarray(value, dtype=float)


def stack(rows: list[Any]) -> jax.Array:
    """Rows of equal shape as one JAX array."""
    if any(isinstance(row, jax.Array) for row in rows):
        return jnp.stack([device_array(row) for row in rows])
    return device_array(np.stack(rows))


def concrete(value: Any) -> np.ndarray | None:
    """The value in NumPy where it may be looked at, else None (while it is being traced)."""
    return None if isinstance(value, jax.core.Tracer) else np.asarray(value)
