"""Imports when they are needed: names of a package at their first use, a module while XLA compiles, which leaves Python to other threads.

SciPy's optimizers take as long to import as a short fit to run; the laws of forces, of which a model has one or two, a tenth of what an
equilibrium imports.
"""

from __future__ import annotations

import importlib
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext, suppress
from typing import Any

import jax.numpy as jnp

from jaxbody.compilation.compilations import LOWERED, listening


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


def imported_while_compiling(module: str) -> AbstractContextManager[None]:
    """Inside, a thread imports the module as soon as XLA begins to compile a program."""
    return nullcontext() if module in sys.modules else while_compiling(lambda: importlib.import_module(module))
