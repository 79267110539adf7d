"""What jaxbody takes from the inside of JAX, which no version promises: one function for each use, with a test and a way back."""

from __future__ import annotations

import jax
from jax.extend.core import ClosedJaxpr, jaxpr_as_fun
from jax.interpreters import partial_eval


def without_high_operations(jaxpr: ClosedJaxpr) -> ClosedJaxpr:
    """The same program in operations that batches and compilers know. Since version 0.12 a program may hold "high" ones, such as
    searchsorted, each of which JAX replaces by others just before it compiles."""
    if not getattr(jaxpr, "is_high", False):
        return jaxpr
    if hasattr(partial_eval, "lower_jaxpr2"):
        return partial_eval.lower_jaxpr2(jaxpr)
    return jax.jit(jaxpr_as_fun(jaxpr)).trace(*jaxpr.in_avals).lojax.jaxpr  # pyright: ignore  # the same by another door
