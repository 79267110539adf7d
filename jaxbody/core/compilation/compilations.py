"""Compilations and their times as reported by JAX."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from typing import Any

from jax import monitoring

from jaxbody.core import tables

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
