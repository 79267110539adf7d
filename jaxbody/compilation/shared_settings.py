"""Settings of the process that are changed as long as any thread needs it: Python's search for garbage, JAX's cache of compiled code."""

from __future__ import annotations

import gc
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import jax
from jax.experimental.compilation_cache import compilation_cache

MANY = 50_000  # new objects after which Python looks for garbage while programs are traced; by default 700, to see the same objects again


def shared(change: Callable[[], Any], restore: Callable[[Any], None]) -> Callable[[], Any]:
    """A context manager in which a setting is changed, until the last thread leaves; `change` returns what `restore` brings back."""
    lock, before = threading.Lock(), []  # for each thread inside, what the setting was before the first one

    @contextmanager
    def changed() -> Iterator[None]:
        with lock:
            before.append(before[0] if before else change())
        try:
            yield
        finally:
            with lock:
                setting = before.pop()
                if not before:
                    restore(setting)

    return changed


def _look_less_often() -> tuple[int, int, int]:
    after, *older = thresholds = gc.get_threshold()
    if 0 < after < MANY:
        gc.set_threshold(MANY, *older)
    return thresholds


def _without_cache() -> bool:
    enabled = jax.config.jax_enable_compilation_cache  # pyright: ignore[reportAttributeAccessIssue]
    _enable_cache(False)
    return enabled


def _enable_cache(enabled: bool) -> None:
    jax.config.update("jax_enable_compilation_cache", enabled)
    compilation_cache.reset_cache()  # JAX looks for its folder once only


little_garbage = shared(_look_less_often, lambda thresholds: gc.set_threshold(*thresholds))  # an eighth of the time to trace and compile
without_cache = shared(_without_cache, _enable_cache)
