"""LAPACK, which jaxlib takes from SciPy, without the hundred modules that `scipy.linalg` imports.

jaxlib calls LAPACK by addresses in `scipy.linalg.cython_blas` and `cython_lapack`. When it lowers the first program that needs them it
imports both and with them their package, of which they need nothing: 0.12 s, more than lowering an equilibrium takes.
"""

from __future__ import annotations

import functools
import sys
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from pathlib import Path

import jax
import jax.numpy as jnp

PACKAGE = "scipy.linalg"
HOLDERS = f"{PACKAGE}.cython_blas", f"{PACKAGE}.cython_lapack"


@functools.cache
def find_lapack() -> None:
    """Let jaxlib look LAPACK up, as it does when it lowers a call of it; a program that another process has lowered calls it too."""
    alone = PACKAGE not in sys.modules and _load_alone()
    try:
        from jaxlib.lapack import prepare_lapack_call

        prepare_lapack_call("potrf_ffi", jnp.dtype(float))
    except (ImportError, AttributeError, TypeError):
        jax.jit(jnp.linalg.cholesky).lower(jax.ShapeDtypeStruct((2, 2), jnp.result_type(float)))
    for name in HOLDERS if alone else ():  # as if it had not been: a later import of the package finds its own parts
        sys.modules.pop(name, None)


def _load_alone() -> bool:
    """Whether the modules that hold the addresses could be loaded without their package."""
    import scipy

    folder = [str(Path(scipy.__file__).parent / "linalg")]
    try:
        for name in HOLDERS:
            spec = PathFinder.find_spec(name, folder)
            module = module_from_spec(spec)  # pyright: ignore[reportArgumentType]  # None: an AttributeError, as below
            spec.loader.exec_module(module)  # pyright: ignore[reportOptionalMemberAccess]
            sys.modules[name] = module
    except (ImportError, AttributeError):
        return False
    return True
