"""Imports when they are needed, and no more than is: names of a package at their first use, a module while XLA compiles, which leaves
Python to other threads, LAPACK without the package that holds it.

SciPy's optimizers take as long to import as a short fit to run; the laws of forces, of which a model has one or two, a tenth of what an
equilibrium imports.
"""

from __future__ import annotations

import functools
import importlib
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from importlib.machinery import PathFinder
from importlib.util import module_from_spec
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp

from jaxbody.compilation.compilations import LOWERED, listening

PACKAGE = "scipy.linalg"
HOLDERS = f"{PACKAGE}.cython_blas", f"{PACKAGE}.cython_lapack"


def late_names(package: str, modules: dict[str, tuple[str, ...]]) -> tuple[Callable[[str], Any], list[str]]:
    """`__getattr__` and `__all__` of a package whose names are imported from its modules at their first use; its stub says the same to
    editors and type checkers.

    Args:
        package: "jaxbody.laws"
        modules: {module: public names in it}
    """
    places = {name: module for module, names in modules.items() for name in names}

    def __getattr__(name: str) -> Any:
        if name not in places:
            raise AttributeError(f"module '{package}' has no attribute '{name}'")
        thing = getattr(importlib.import_module(f"{package}.{places[name]}"), name)
        setattr(sys.modules[package], name, thing)
        return thing

    return __getattr__, sorted(places)


@contextmanager
def while_compiling(task: Callable[[], Any]) -> Iterator[None]:
    """Inside, a thread runs the task as soon as XLA begins to compile a program; on leaving it has ended, or nothing was compiled. An error
    of the task is left to who needs its result, as is all of it where the caller computes with numbers of another precision.

    >>> with while_compiling(lambda: importlib.import_module("colorsys")):
    ...     _ = jax.jit(lambda x: 2.5 * x)(1.0)
    >>> "colorsys" in sys.modules
    True
    """
    threads: list[threading.Thread] = []
    precision = jnp.result_type(float)

    def run() -> None:
        with suppress(Exception):
            if jnp.result_type(float) == precision:  # a context of the caller's thread is none of this thread
                task()

    def heard(event: str, seconds: float, **more: Any) -> None:
        if event == LOWERED and not threads:
            threads.append(threading.Thread(target=run))  # no daemon: Python waits for it before it ends
            threads[0].start()

    with listening(heard):
        yield
    for thread in threads:
        thread.join()


@functools.cache
def find_lapack() -> None:
    """Let jaxlib look LAPACK up without the hundred modules that `scipy.linalg` imports, as it does when it lowers a call of it; a program
    that another process has lowered calls it too.

    jaxlib calls LAPACK by addresses in `scipy.linalg.cython_blas` and `cython_lapack`. When it lowers the first program that needs them it
    imports both and with them their package, of which they need nothing: 0.12 s, more than lowering an equilibrium takes.
    """
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
