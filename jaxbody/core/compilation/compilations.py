"""Compilations and their times as reported by JAX; warnings about functions that are compiled
repeatedly or for over a minute."""

from __future__ import annotations

import functools
import inspect
import re
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import jax
from jax import monitoring

from jaxbody.core import tables
from jaxbody.core.errors import warn

LONG = 60.0  # time to compile from which a warning is given [s]
MANY = 6  # compilations in a row for one reason from which a warning is given
SHOWN = 4  # values in a warning
REMEDIES = {
    "shape": (
        "arrays of one shape, or calls of one function in jb.jit that holds the "
        "loop, are compiled once"
    ),
    "type": "numbers of one type are compiled once",
    "value": "one value for all calls is compiled once",
    "function": (
        "make it once, outside of the loop, or write a class that holds its arrays as fields"
    ),
}

PHASES = {  # phases of a compilation, in the order in which JAX runs them
    "/jax/core/compile/jaxpr_trace_duration": 0,
    "/jax/core/compile/jaxpr_to_mlir_module_duration": 1,
    "/jax/core/compile/backend_compile_duration": 2,
}
HIT = "/jax/compilation_cache/cache_hits"
LEFT = "/jaxbody/lanes/left_to_vmap"
MOST_ROWS = 10  # printed; all others are summed in one row


@dataclass
class CompileTimes:
    """Compilations and their times.

    `programs` {function: (seconds of tracing, of lowering, of compiling, number of compilations)};
    `count` and `seconds`: totals; `cached`: number of programs from JAX's persistent cache;
    `left_to_vmap` {function of jaxbody: reason why its batch was not rewritten for lanes}, where
    results are the same but slower.

    >>> CompileTimes().count
    0
    """

    # {function: (begin, end) of each trace [s]} of functions that are not compiled yet
    traced: dict[str, list[tuple[float, float]]] = field(default_factory=dict, repr=False)
    programs: dict[str, tuple[float, float, float, int]] = field(default_factory=dict)
    cached: int = 0
    left_to_vmap: dict[str, str] = field(default_factory=dict)
    # spans of time that are counted in `programs`, none of which lies in another
    counted: list[tuple[float, float]] = field(default_factory=list, repr=False)

    def __enter__(self) -> CompileTimes:
        _listen()
        _listeners.append(self.heard)
        return self

    def __exit__(self, *raised: object) -> None:
        _listeners.remove(self.heard)

    @property
    def count(self) -> int:
        return sum(n for *_, n in self.programs.values())

    @property
    def seconds(self) -> float:
        return sum(sum(times) for *times, _ in self.programs.values())

    def heard(self, event: str, seconds: float = 0.0, **data: str) -> None:
        """Record an event of compilation that JAX reports, and its duration in seconds.

        Only traces that become programs are counted. The trace of an inner function is part
        of that of the outer function; a program that is compiled and run during a trace is
        not part of it."""
        phase, name, now = PHASES.get(event), program(data), time.perf_counter()
        self.cached += event == HIT
        if event == LEFT:
            self.left_to_vmap[data["function"]] = data["why"]
        elif phase == 0:
            self.traced.setdefault(name, []).append((now - seconds, now))
        elif phase is not None:
            trace, lowered, compiled, n = self.programs.get(name, (0.0, 0.0, 0.0, 0))
            trace += sum(self.count_once(*span) for span in self.traced.pop(name, []))
            spent = self.count_once(now - seconds, now)
            self.programs[name] = (
                (trace, lowered + spent, compiled, n)
                if phase == 1
                else (trace, lowered, compiled + spent, n + 1)
            )

    def count_once(self, begin: float, end: float) -> float:
        """Return the seconds of this span that were not counted before, and count them."""
        overlaps = (max(min(end, until) - max(begin, since), 0.0) for since, until in self.counted)
        spent = end - begin - sum(overlaps)
        outside = [span for span in self.counted if not begin <= span[0] <= span[1] <= end]
        self.counted = [*outside, (begin, end)]
        return max(spent, 0.0)

    def __repr__(self) -> str:
        rows: list[tuple[Any, ...]] = sorted(
            ((name, *times) for name, times in self.programs.items()),
            key=lambda row: -sum(row[1:4]),
        )
        if rest := rows[MOST_ROWS:]:
            sums = map(sum, list(zip(*rest, strict=True))[1:])
            rows[MOST_ROWS:] = [(f"{len(rest)} others", *sums)]
        cached = f", {self.cached} from the cache" if self.cached else ""
        heads = ("function", "traced [s]", "lowered [s]", "compiled [s]", "count")
        end = f"{tables.counted(self.count, 'compilation')}, {self.seconds:.3g} s{cached}"
        printed = [tables.PrintedTable("Compilations", heads, rows, end)]
        if self.left_to_vmap:
            left = list(self.left_to_vmap.items())
            printed.append(
                tables.PrintedTable("Left to jax.vmap, slower", ("function", "why"), left)
            )
        return tables.text(*printed)


def program(data: dict[str, str]) -> str:
    """Return the name of the function that is traced, lowered or compiled, from the data of an
    event."""
    return data.get("fun_name", "?").removeprefix("jit(").removesuffix(")")


def note_left_to_vmap(function: str, why: str) -> None:
    """Report to `compile_times` that the batch of a function was left to jax.vmap, and why."""
    monitoring.record_event(LEFT, function=function, why=why)


def compile_times() -> CompileTimes:
    """Record all compilations by JAX inside a `with` block, of jaxbody's functions and all others;
    the record prints as a table.

    A second run with new values should compile nothing; where it does, a shape, a type or a Python
    function has changed.

    >>> with jb.compile_times() as times:
    ...     _ = jax.jit(lambda x: x + 1.5)(jnp.ones(3))
    >>> times.count > 0
    True
    >>> print(times)  # doctest: +SKIP
    """
    return CompileTimes()


_listeners: list[Callable[..., None]] = []  # are called as listener(event, seconds, **data)


@functools.cache
def _listen() -> None:
    """Pass the events of JAX on to all `_listeners`, from the first call on.

    Older versions of JAX cannot remove a listener, so that a single one is registered for all
    uses."""

    def heard(*event: Any, **data: Any) -> None:
        for listener in [*_listeners]:
            listener(*event, **data)

    monitoring.register_event_listener(heard)
    monitoring.register_event_duration_secs_listener(heard)


class Compilations:
    """The successive compilations of a function, and what changed in its arguments between them."""

    def __init__(self, function: Callable[..., Any]):
        self.name = f"{function.__module__}.{function.__qualname__}"
        self.program = function.__name__
        self.parameters = tuple(inspect.signature(function).parameters)
        self.last: dict[str, Any] = {}
        self.reason: tuple[str, tuple[str, ...]] | None = None
        self.seen: list[str] = []
        self.warned = False

    @contextmanager
    def watched(self, args: tuple[Any, ...]) -> Iterator[None]:
        """Observe whether a call with these arguments, the `with` block, compiles the function.

        Warns SLOW_COMPILATION if it takes more than a minute; warns RECOMPILED, once, if the
        function is compiled again and again because one thing changes."""
        with CompileTimes() as times:
            yield
        seconds = sum(times.programs.get(self.program, ())[:3])
        if seconds > LONG:
            remedy = (
                "new numbers in the same shapes compile nothing, JAX keeps programs for later "
                "runs where JAX_COMPILATION_CACHE_DIR names a directory, a Python loop in a law "
                "or a motion compiles faster as jax.lax.fori_loop, and jb.jit compiles your "
                "functions more quickly"
            )
            warn(
                "SLOW_COMPILATION",
                f"{self.name} took {seconds:.0f} s to compile; {remedy}; jb.compile_times shows "
                "which function takes how long",
            )
        if seconds:
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
        what = "a new Python function in" if kind == "function" else f"the {kind} of"
        values = "" if kind == "function" else f": {', '.join(self.seen[:SHOWN])}, ..."
        places = ", ".join(where[:SHOWN]) + (", ..." if len(where) > SHOWN else "")
        warn(
            "RECOMPILED",
            f"{self.name} was compiled {len(self.seen)} times in a row for {what} "
            f"{places}{values}; {REMEDIES[kind]}",
        )


def _described(parameters: tuple[str, ...], args: tuple[Any, ...]) -> dict[str, Any]:
    """Describe arguments: return {path of a leaf: (shape, type) of an array, or any other leaf
    itself}, and the tree structure of each argument under "the structure of <parameter>"."""
    places: dict[str, Any] = {}
    for name, arg in zip(parameters, args, strict=False):
        leaves, structure = jax.tree_util.tree_flatten_with_path(arg)
        places |= {
            name + jax.tree_util.keystr(path): (x.shape, x.dtype) if hasattr(x, "dtype") else x
            for path, x in leaves
        }
        places[f"the structure of {name}"] = structure
    return places


def _difference(before: dict[str, Any], now: dict[str, Any]) -> tuple[str, tuple[str, ...]] | None:
    """Return the kind of change between two descriptions of arguments, and its places.

    None if changes are of several kinds, or if the new arguments need another program in
    any case."""
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
    return (
        f"{described[0]} {described[1]}" if isinstance(described, tuple) else f"{described!r:.40}"
    )
