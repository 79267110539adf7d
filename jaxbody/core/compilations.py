"""What was compiled and how long it took: function, times and counts, as JAX itself reports them."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field

from jax import monitoring

from jaxbody.core import tables

PHASES = {
    "/jax/core/compile/jaxpr_trace_duration": 0,
    "/jax/core/compile/jaxpr_to_mlir_module_duration": 1,
    "/jax/core/compile/backend_compile_duration": 2,
}
HIT = "/jax/compilation_cache/cache_hits"
LEFT = "/jaxbody/lanes/left_to_vmap"
MOST_ROWS = 10  # that print; the rest in one


@dataclass
class CompileTimes:
    """`programs`: by function (seconds of tracing, of lowering, of compiling, how often it was compiled); `count` and `seconds` of all;
    `cached`, how many came from JAX's persistent cache; `left_to_vmap`, by function of jaxbody why a batch of it was not rewritten for lanes:
    its results are the same, it runs slower.

    >>> CompileTimes().count
    0
    """

    traced: dict[str, float] = field(default_factory=dict)
    programs: dict[str, tuple[float, float, float, int]] = field(default_factory=dict)
    cached: int = 0
    left_to_vmap: dict[str, str] = field(default_factory=dict)

    @property
    def count(self) -> int:
        return sum(n for *_, n in self.programs.values())

    @property
    def seconds(self) -> float:
        return sum(sum(times) for *times, _ in self.programs.values())

    def heard(self, event: str, seconds: float, **more: str) -> None:
        """Keep what JAX tells. Traces of functions inside others are parts of theirs, so only those that become programs count."""
        phase, name = PHASES.get(event), program(more)
        if phase == 0:
            self.traced[name] = self.traced.get(name, 0.0) + seconds
        elif phase is not None:
            trace, lowered, compiled, n = self.programs.get(name, (0.0, 0.0, 0.0, 0))
            trace += self.traced.pop(name, 0.0)
            self.programs[name] = (trace, lowered + seconds, compiled, n) if phase == 1 else (trace, lowered, compiled + seconds, n + 1)

    def __repr__(self) -> str:
        rows = sorted(((name, *times) for name, times in self.programs.items()), key=lambda row: -sum(row[1:4]))
        rest = rows[MOST_ROWS:]
        shown = rows[:MOST_ROWS]
        if rest:
            shown.append((f"{len(rest)} others", *(sum(column) for column in list(zip(*rest, strict=True))[1:])))
        end = f"{tables.counted(self.count, 'compilation')}, {self.seconds:.3g} s" + (
            f", {self.cached} from the cache" if self.cached else ""
        )
        found = [tables.Table("Compilations", ("function", "traced [s]", "lowered [s]", "compiled [s]", "count"), shown, end)]
        if self.left_to_vmap:
            found.append(tables.Table("Left to jax.vmap, slower", ("function", "why"), list(self.left_to_vmap.items())))
        return tables.text(*found)


def program(more: dict[str, str]) -> str:
    """The function that is traced, lowered or compiled, of what JAX says with an event."""
    return more.get("fun_name", "?").removeprefix("jit(").removesuffix(")")


def note_left_to_vmap(function: str, why: str) -> None:
    """For whoever listens."""
    monitoring.record_event(LEFT, function=function, why=why)


@contextmanager
def compile_times() -> Iterator[CompileTimes]:
    """Note what JAX compiles meanwhile, jaxbody's functions and all others, and print it as a table.

    A second run with new values must add nothing; where it does, a shape, a type or a Python function has changed.

    >>> with compile_times() as times:
    ...     _ = jax.jit(lambda x: x + 1.5)(jnp.ones(3))
    >>> times.count > 0
    True
    >>> print(times)  # doctest: +SKIP
    """
    found, listening = CompileTimes(), True

    def seconds(event: str, duration: float, **more) -> None:
        if listening:
            found.heard(event, duration, **more)

    def event(name: str, **more) -> None:
        found.cached += listening and name == HIT
        if listening and name == LEFT:
            found.left_to_vmap[more["function"]] = more["why"]

    monitoring.register_event_duration_secs_listener(seconds)
    monitoring.register_event_listener(event)
    try:
        yield found
    finally:
        listening = False
        if hasattr(monitoring, "unregister_event_listener"):  # older versions of JAX keep them, silent
            monitoring.unregister_event_duration_listener(seconds)
            monitoring.unregister_event_listener(event)
