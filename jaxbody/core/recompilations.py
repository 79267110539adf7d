"""Compilations that cost too much: again and again, as one thing in the arguments changes, and which that is; or for over a minute."""

from __future__ import annotations

import functools
import inspect
import re
from collections.abc import Callable
from typing import Any

import jax
from jax import monitoring

from jaxbody.core.compilations import PHASES, program
from jaxbody.core.errors import warn

LONG = 60.0  # s to compile
MANY = 6  # compilations in a row for one reason
SHOWN = 4
REMEDIES = {
    "shape": "arrays of one shape, or calls of one jitted function that holds the loop, are compiled once",
    "type": "numbers of one type are compiled once",
    "value": "one value for all calls is compiled once",
    "function": "make it once, outside of the loop, or write a class with arrays in place of what it closes over",
}


class Compiled:
    """For what arguments a function was compiled, one after the other."""

    def __init__(self, function: Callable[..., Any]):
        self.name, self.program = f"{function.__module__}.{function.__qualname__}", function.__name__
        self.parameters = tuple(inspect.signature(function).parameters)
        self.last: dict[str, Any] = {}
        self.reason: tuple[str, tuple[str, ...]] | None = None
        self.seen: list[str] = []
        self.warned = False
        self.begun = False

    def begin(self) -> None:
        """It is about to be compiled."""
        self.begun = True
        _under_way()[self.program] = 0.0

    def end(self, args: tuple[Any, ...]) -> None:
        """It was compiled for these; warns SLOW_COMPILATION, and RECOMPILED once, where only one thing changed each time."""
        self.begun = False
        seconds = _under_way().pop(self.program, 0.0)
        if seconds > LONG:
            remedy = "new numbers in the same shapes compile nothing, JAX keeps programs for later runs where JAX_COMPILATION_CACHE_DIR names a directory, and a Python loop in a law or a motion compiles faster as jax.lax.fori_loop"
            warn(
                "SLOW_COMPILATION",
                f"{self.name} took {seconds:.0f} s to compile; {remedy}; jb.compile_times shows which function takes how long",
            )
        self._compare(args)

    def _compare(self, args: tuple[Any, ...]) -> None:
        now = _described(self.parameters, args)
        reason = _difference(self.last, now)
        if reason is None or reason != self.reason:
            self.seen = [] if reason is None else [_shown(self.last[reason[1][0]])]
        if reason is not None:
            self.seen.append(_shown(now[reason[1][0]]))
        self.last, self.reason = now, reason
        if len(self.seen) < MANY or self.warned or reason is None:
            return
        self.warned = True
        kind, where = reason
        what = "a Python function made anew in" if kind == "function" else f"the {kind} of"
        values = "" if kind == "function" else f": {', '.join(self.seen[:SHOWN])}, ..."
        places = ", ".join(where[:SHOWN]) + (", ..." if len(where) > SHOWN else "")
        warn("RECOMPILED", f"{self.name} was compiled {len(self.seen)} times in a row for {what} {places}{values}; {REMEDIES[kind]}")


@functools.cache
def _under_way() -> dict[str, float]:
    """By function that is being compiled the seconds that JAX has spent on it, as JAX itself says from the first call on."""
    spent: dict[str, float] = {}

    def heard(event: str, seconds: float, **more: Any) -> None:
        if event in PHASES and program(more) in spent:
            spent[program(more)] += seconds

    monitoring.register_event_duration_secs_listener(heard)
    return spent


def _described(parameters: tuple[str, ...], args: tuple[Any, ...]) -> dict[str, Any]:
    """By place: (shape, type) of arrays, other leaves as they are, and of every argument its structure."""
    places: dict[str, Any] = {}
    for name, arg in zip(parameters, args, strict=True):
        leaves, structure = jax.tree_util.tree_flatten_with_path(arg)
        places |= {name + jax.tree_util.keystr(path): (x.shape, x.dtype) if hasattr(x, "dtype") else x for path, x in leaves}
        places[f"the structure of {name}"] = structure
    return places


def _difference(before: dict[str, Any], now: dict[str, Any]) -> tuple[str, tuple[str, ...]] | None:
    """What kind of thing alone changed, and where; None where it is not one kind alone, or a program of its own."""
    if before.keys() != now.keys():
        return None
    changed = [place for place in now if before[place] != now[place]]
    kinds = {_kind(before[place], now[place]) for place in changed}
    return None if len(kinds) != 1 or None in kinds else (kinds.pop() or "", tuple(changed))


def _kind(before: Any, now: Any) -> str | None:
    if isinstance(before, tuple) and isinstance(now, tuple):
        return "type" if before[0] == now[0] else "shape" if before[1] == now[1] else None
    if isinstance(before, jax.tree_util.PyTreeDef) or (callable(before) and callable(now)):
        return "function" if _without_addresses(before) == _without_addresses(now) else None
    return "value" if isinstance(before, int | float) and isinstance(now, int | float) else None


def _without_addresses(thing: Any) -> str:
    return re.sub(r"0x[0-9a-f]+", "", str(thing))


def _shown(described: Any) -> str:
    return f"{described[0]} {described[1]}" if isinstance(described, tuple) else f"{described!r:.40}"
