"""Functions of users before they are compiled: whether JAX can trace them, and what shape they return."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

from jaxbody.core.errors import Problems

USE_JNP = "Write it with jax.numpy: jnp.sin for np.sin and math.sin, jnp.where for if."


def is_own(part: Any) -> bool:
    """True of a module whose class is the user's, and of one that holds a bare function."""
    return not type(part).__module__.startswith("jaxbody.") or type(part).__name__ == "Function"


def check_returned(call: Callable[[Any, Any], Any], module: Any, shape: tuple[int, ...], where: str, problems: Problems) -> None:
    """call(module, number) must be one that JAX can trace, and return an array of this shape; nothing is computed or compiled.

    Errors: NOT_TRACEABLE, FUNCTION_FAILED, BAD_SHAPE."""
    returns = "one number" if shape == () else f"{shape[0]} numbers in one array"
    try:
        out = jax.eval_shape(call, module, jax.ShapeDtypeStruct((), jnp.result_type(float)))
    except jax.errors.JAXTypeError:
        told = "cannot be traced by JAX: it gives its argument to numpy or math, or asks for its value"
        problems.add("NOT_TRACEABLE", where, told, limit="functions of jax.numpy", hint=USE_JNP)
    except Exception as error:  # whatever a function of the user's may raise
        text = (str(error).splitlines() or [""])[0]
        hint = f"Call it by itself with jnp.array(0.1); it must return {returns}."
        problems.add("FUNCTION_FAILED", where, f"raises {type(error).__name__}: {text:.200}", limit=returns, hint=hint)
    else:
        found = getattr(out, "shape", None)
        if found != shape:
            told = f"returns a {type(out).__name__}" if found is None else f"returns shape {found}"
            hint = f"Return jnp.array([...]), {returns}." if shape else "Return one number, of shape ()."
            problems.add("BAD_SHAPE", where, told, value=found, limit=str(shape), hint=hint)
