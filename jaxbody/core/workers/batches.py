"""A batch of independent rows in chunks: the size of a chunk, the workers that compute it, and its
results, in memory or in a store."""

import dataclasses
import os
import weakref
from collections.abc import Callable, Iterable, Iterator, Sequence
from pathlib import Path
from typing import Any

import equinox as eqx
import jax
import numpy as np

from jaxbody.core.arrays import device_array
from jaxbody.core.compilation.compile_options import OPTIMIZED
from jaxbody.core.errors import Problems, Status, warn
from jaxbody.core.workers.chunk_programs import (
    ChunkProgram,
    ComputedChunk,
    Types,
    exported,
    filled,
    kept,
    types_of,
)
from jaxbody.core.workers.chunk_stores import ChunkStore, hash_of, nothing
from jaxbody.core.workers.executors import Crew, check_workers, dispatched

MOST = 256  # chunks in a batch: sending and writing one takes milliseconds
LARGEST = 2**26  # results of a chunk [bytes]

Report = Callable[[int, int], None]  # rows that are done, workers


@dataclasses.dataclass(frozen=True)
class ChunkedBatch:
    """A batch: `count` rows and the program that computes them, in chunks of `size` rows."""

    program: ChunkProgram
    shared: list[np.ndarray]
    rows: Callable[[int, int], list[np.ndarray]]  # arrays of the rows (first, last)
    count: int
    size: int
    function: Callable[..., Any] | None = None  # as in `compute_chunk`
    types: Types | None = None  # of its results; by default those of the program

    @property
    def chunks(self) -> int:
        return -(-self.count // self.size)

    @property
    def results(self) -> Types:
        return self.program.results if self.types is None else self.types

    def ends(self, chunk: int) -> tuple[int, int]:
        return chunk * self.size, min((chunk + 1) * self.size, self.count)

    def arguments(self, chunk: int) -> tuple[Any, ...]:
        return self.program, self.shared, self.rows(*self.ends(chunk)), self.function


def arrays_apart(
    function: Callable[..., Any], tree: Any
) -> tuple[Callable[..., Any], list[Any], Any]:
    """Return function(tree, *rows) as a function of two lists of arrays, (shared, rows).

    Also returns `shared`, the arrays of the tree, and the rest of the tree, which is part of the
    program."""
    numbers, rest = eqx.partition(tree, lambda x: isinstance(x, jax.Array | np.ndarray))
    shared, structure = jax.tree.flatten(numbers)

    def apart(shared, rows):
        return function(eqx.combine(jax.tree.unflatten(structure, shared), rest), *rows)

    return apart, shared, (structure, tuple(jax.tree.leaves(rest)))


# {function that programs compute: {key: program}}, as long as the function exists
programs: weakref.WeakKeyDictionary[Any, dict[Any, Any]] = weakref.WeakKeyDictionary()


def kept_by(owner: Any, key: Any, make: Callable[[], Any]) -> Any:
    """Return the result of `make`, which is called once for each key as long as the owner
    exists."""
    return kept(programs.setdefault(owner, {}), key, make)


def computed_here(
    function: Callable[..., Any],
    tree: Any,
    rows: Callable[[int, int], list[np.ndarray]],
    count: int,
    *,
    width: int,
    owner: Any,
    place: Any = (),
    memory: float | None = None,
) -> Iterator[dict[str, np.ndarray]]:
    """Yield the results of function(tree, *rows), `width` rows at a time in order, computed in this
    process.

    Arguments are those of `batch_of`. The program is the one that workers run, so that the numbers
    are the same; it is not serialized, so that it may contain callbacks."""
    apart, shared, rest = arrays_apart(function, tree)
    one, width = rows(0, 1), min(width, count)

    shapes = tuple((x.shape, x.dtype) for x in [*shared, *one])
    program, width = kept_by(
        owner,
        ("here", place, rest, shapes, width, memory, jax.config.read("jax_enable_x64")),
        lambda: _fitting(apart, shared, one, width, memory),
    )
    for first in range(0, count, width):
        last = min(first + width, count)
        results = program(shared, [device_array(filled(x, 0, width)) for x in rows(first, last)])
        yield {name: np.asarray(x)[: last - first] for name, x in results.items()}


def _fitting(
    function: Callable[..., Any],
    shared: list[Any],
    one: list[Any],
    width: int,
    memory: float | None,
) -> tuple[Any, int]:
    """Return function(shared, rows) compiled for `width` rows like `one`, or for as many as need no
    more temporary memory than `memory` [bytes], and their number."""

    def compiled(width: int) -> Any:
        given = [jax.ShapeDtypeStruct((width, *x.shape[1:]), x.dtype) for x in one]
        return jax.jit(function, compiler_options=dict(OPTIMIZED)).lower(shared, given).compile()

    program = compiled(width)
    taken = getattr(program.memory_analysis(), "temp_size_in_bytes", 0)
    if memory is not None and taken > memory and width > 1:
        width = max(1, int(width * memory / taken))
        program = compiled(width)
    return program, width


def gathered_here(report: Report, **batch: Any) -> dict[str, np.ndarray]:
    """Return all results of `computed_here`, with a report after each part."""
    parts, done = [], 0
    for part in computed_here(**batch):
        parts.append(part)
        done += len(next(iter(part.values())))
        report(done, 1)
    return {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}


def checked_chunks(
    where: str, workers: Any, out: Any, chunks: Any, problems: Problems, *, fixed: bool
) -> list[int] | None:
    """Check the options of a batch, and return the numbers of the chunks to compute, None for all.

    Args:
        where: the place in the call, for messages.
        workers: None, a number of processes, or an executor.
        out: path of a store, or None.
        chunks: numbers of chunks, or None.
        problems: collects the problems: BAD_WORKERS, MISSING_EXTRA, WRONG_KIND, BAD_CHUNK.
        fixed: whether chunks have the same size in all calls.
    """
    problems.gather(lambda: check_workers(workers, f"{where}.workers"))
    if out is not None and not isinstance(out, str | os.PathLike):
        problems.add(
            "WRONG_KIND",
            f"{where}.out",
            f"is {out!r:.60}",
            value=out,
            limit="a path",
            hint='Give out="results.zarr".',
        )
    if chunks is None:
        return None
    if out is None or not fixed:
        hint = "Give out=, where the chunks meet" + (
            ", and chunk=, the size to which the numbers refer." if not fixed else "."
        )
        message = "are given without out=" + (" or chunk=" if not fixed else "")
        problems.add("BAD_CHUNK", f"{where}.chunks", message, value=chunks, hint=hint)
    try:
        numbers = [int(i) for i in chunks]
    except (TypeError, ValueError):
        numbers = [-1]
    if min(numbers, default=0) < 0:
        problems.add(
            "BAD_CHUNK",
            f"{where}.chunks",
            f"are {chunks!r:.60}",
            value=chunks,
            limit="whole numbers from 0, such as range(0, n, 8)",
        )
    return numbers


def batch_of(
    function: Callable[..., Any],
    tree: Any,
    rows: Callable[[int, int], list[np.ndarray]],
    count: int,
    *,
    width: int,
    where: str,
    owner: Any,
    place: Any = (),
    memory: float | None = None,
) -> ChunkedBatch:
    """Return a batch by function(tree, *rows); its program and the size of its chunks are kept for
    later calls with other numbers.

    Args:
        function: returns {name: array of `width` rows} for a tree and arrays of `width` rows.
        tree: the part of the arguments that all rows share.
        rows: (first, last) -> arrays of these rows.
        count: number of rows.
        width: number of rows that are computed at a time.
        where: the place in the call, for messages.
        owner, place: the function from which `function` is made, and other values on which it
            depends.
        memory: temporary memory that these rows may take [bytes]; where they need more, fewer are
            computed at a time. A chunk then has a part of the batch, so that there are at most MOST
            chunks unless their results are larger than LARGEST. By default a chunk has `width`
            rows.

    Error: NOT_SENT."""
    apart, arrays, rest = arrays_apart(function, tree)
    shared, width = [np.asarray(x) for x in arrays], min(width, count)

    shapes = tuple((x.shape, x.dtype) for x in [*shared, *rows(0, 1)])
    place = "batch", place, rest, shapes, count, width, memory, jax.config.read("jax_enable_x64")

    def sized() -> ChunkedBatch:
        """Return the batch to be kept, without references to its rows."""
        one, size = rows(0, 1), width
        program = exported(apart, shared, one, width, where)
        if memory is not None:
            if memory < np.inf:
                size = _fitting(apart, shared, one, width, memory)[1]
            if size < width:
                program = exported(apart, shared, one, size, where)
            bytes_of_row = sum(
                np.dtype(dtype).itemsize * int(np.prod(shape))
                for shape, dtype in program.results.values()
            )
            size *= max(1, int(min(count / MOST, LARGEST / bytes_of_row) / size))
        return ChunkedBatch(program, [], lambda first, last: [], count, size)

    return dataclasses.replace(kept_by(owner, place, sized), shared=shared, rows=rows)


def computed(
    batch: ChunkedBatch,
    crew: Crew,
    chunks: Iterable[int],
    where: str,
    report: Report,
    *,
    continued: bool = False,
) -> Iterator[tuple[int, ComputedChunk | None]]:
    """Yield (chunk, its results or None if it is lost) as chunks finish; `continued` as in
    `dispatched`. Warns LOST at the end, with the rows."""
    lost: list[tuple[int, str]] = []
    done = 0
    for chunk, answer in dispatched(crew, chunks, batch.arguments, where, continued=continued):
        if not isinstance(answer, ComputedChunk):
            lost.append((chunk, answer.message))
        yield chunk, answer if isinstance(answer, ComputedChunk) else None
        first, last = batch.ends(chunk)
        done += last - first
        report(done, len(crew.seen))
    if lost:
        rows = ", ".join("{} to {}".format(*batch.ends(chunk)) for chunk, _ in sorted(lost)[:8]) + (
            ", ..." if len(lost) > 8 else ""
        )
        warn(
            "LOST",
            f"{where}: {len(lost)} of {batch.chunks} chunks failed three times, rows "
            f"{rows}; {lost[0][1]}",
        )


def store_of(
    batch: ChunkedBatch,
    out: Any,
    plan: dict[str, Any],
    inputs: Sequence[str],
    dimension: str,
) -> ChunkStore:
    """Return the store on disk for the results of a batch and for its rows, the inputs.

    Args:
        batch: the batch.
        out: path of the store.
        plan: {word: text or number} that identifies the rows.
        inputs: names of the arrays of the rows.
        dimension: name of the dimension over the rows, such as "design".

    Errors: those of `ChunkStore`."""
    program = batch.program
    plan = plan | {
        "model": hash_of(*batch.shared),
        "width": program.width,
        **dict(program.versions),
        "x64": program.x64,
        "program": program.name[:16],
    }
    given = types_of(dict(zip(inputs, batch.rows(0, 1), strict=True)))
    return ChunkStore(
        Path(out),
        plan,
        given,
        batch.results,
        dimension=dimension,
        count=batch.count,
        size=batch.size,
    )


def gathered(
    batch: ChunkedBatch,
    crew: Crew,
    where: str,
    report: Report,
    out: Any = None,
    chunks: Iterable[int] | None = None,
    **of_store: Any,
) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Return all results in memory, NaN (zero for integers) where there are none, and the status of
    each row.

    Args:
        batch: the batch.
        crew: the workers.
        where: the place in the call, for messages.
        report: is called with the numbers of finished rows and of workers.
        out: path of a store for the results; None: none.
        chunks: numbers of the chunks to compute, in a store; None: all.
        of_store: other arguments of `store_of`.

    Ctrl-C returns the finished part. Warns INTERRUPTED, LOST."""
    if out is not None:
        store = store_of(batch, out, **of_store)
        stored(batch, store, chunks, crew, where, report)
        return store.read(batch.results)
    results = {
        name: np.full((batch.count, *shape), nothing(dtype), dtype)
        for name, (shape, dtype) in batch.results.items()
    }
    status = np.full(batch.count, Status.INTERRUPTED.value)
    try:
        for chunk, answer in computed(batch, crew, range(batch.chunks), where, report):
            rows = slice(*batch.ends(chunk))
            status[rows] = Status.LOST.value if answer is None else Status.OK.value
            for name, part in ({} if answer is None else answer.results).items():
                results[name][rows] = part
    except KeyboardInterrupt:
        warn(
            "INTERRUPTED",
            f"{where}: {int((status == Status.INTERRUPTED).sum())} of {batch.count} "
            "rows were not computed",
        )
    return results, status


def stored(
    batch: ChunkedBatch,
    store: ChunkStore,
    chunks: Iterable[int] | None,
    crew: Crew,
    where: str,
    report: Report,
) -> None:
    """Compute those of the `chunks` that the store lacks, and write each with its rows when it is
    finished.

    Chunks that were lost before are tried once more, after the others. Ctrl-C ends the computation.
    Warns INTERRUPTED, LOST. Errors: those of `dispatched`, NOT_SAVED."""
    # rows that are sent and not written yet, kept because it may be expensive to make them again
    made: dict[tuple[int, int], list[np.ndarray]] = {}

    def rows(first: int, last: int) -> list[np.ndarray]:
        if (first, last) not in made:
            made[first, last] = given_rows(first, last)
        return made[first, last]

    given_rows, batch = batch.rows, dataclasses.replace(batch, rows=rows)
    complete, lost = store.complete(), store.lost()
    missing = [
        i
        for i in (range(batch.chunks) if chunks is None else chunks)
        if i < batch.chunks and i not in complete
    ]
    try:
        for chunk, answer in computed(
            batch,
            crew,
            sorted(missing, key=lost.__contains__),
            where,
            report,
            continued=bool(complete),
        ):
            given = dict(zip(store.inputs, rows(*batch.ends(chunk)), strict=True))
            del made[batch.ends(chunk)]
            store.write(
                chunk, given | ({} if answer is None else answer.results), lost=answer is None
            )
    except KeyboardInterrupt:
        warn(
            "INTERRUPTED",
            f"{where}: {store.path} has {len(store.complete())} of {batch.chunks} chunks; "
            "the same call continues",
        )
