"""Workers of a batch, and the chunks sent to them: this process, a number of processes of this
machine by loky, or any executor of processes that the user gives.

A chunk that fails, by an error or with its worker, is sent again when no other is under way, and
given up after three tries. If it were sent beside others, a chunk that ends every process that
computes it would cause others, which are lost with these processes, to be given up too."""

import concurrent.futures as futures
import functools
import os
import signal
import tempfile
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor, Future
from contextlib import contextmanager
from typing import Any

import jax

from jaxbody.core.arguments import kind_of
from jaxbody.core.errors import JaxbodyError, Problem, import_extra
from jaxbody.core.workers.chunk_programs import (
    ComputedChunk,
    FailedChunk,
    compute_chunk,
    worker_name,
)

IDLE = 300  # time after which idle processes end [s]
ONE_THREAD = ("PJRT_NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")
FEWEST = 4  # chunks that are sent before any has come back
TRIES = 3  # of a chunk, the first one beside others
MOST_FIRST = 4  # chunks given up before anything is computed, after which the call ends


class ThisProcess(Executor):
    """An executor that computes in this process, during the call of `submit`."""

    def submit(self, function: Callable[..., Any], /, *args: Any, **options: Any) -> Future[Any]:
        future: Future[Any] = Future()
        try:
            future.set_result(function(*args, **options))
        except Exception as error:
            future.set_exception(error)
        return future


class Crew:
    """The workers of one call.

    `executor`: computes the chunks; `make`: makes another in place of a broken one, None for an
    executor of the user; `most`: largest number of chunks that are sent and not finished, None if
    it follows from the number of workers that have answered."""

    def __init__(
        self,
        executor: Executor,
        make: Callable[[], Executor] | None = None,
        most: int | None = None,
    ):
        self.executor, self.make, self.most = executor, make, most
        self.seen: set[str] = set()  # workers that have answered

    def room(self, sent: int) -> bool:
        """Return whether another chunk may be sent when `sent` chunks are not finished: the limit
        keeps all workers busy and needs little memory."""
        return sent < (self.most or 4 * max(FEWEST, len(self.seen)))

    def renew(self, where: str) -> None:
        """Replace a broken executor. Error: BAD_WORKERS if it is the user's."""
        if self.make is None:
            raise JaxbodyError(
                Problem(
                    "BAD_WORKERS",
                    where,
                    "is broken: one of its processes has ended",
                    self.executor,
                    hint=(
                        "Give workers= a number of processes, which are started again; "
                        "what is stored is kept."
                    ),
                )
            )
        self.end()
        self.executor = self.make()

    def end(self) -> None:
        """End the processes that were started here, at once."""
        if self.make is not None:
            executor: Any = self.executor
            executor.shutdown(wait=True, kill_workers=True)


@contextmanager
def crew_of(workers: Any, where: str) -> Iterator[Crew]:
    """Provide the workers that the user gives, during a `with` block. At Ctrl-C and errors the
    processes that were started here end at once.

    Args:
        workers: None, a number of processes, or an executor.
        where: the place in the call, for messages.

    Errors: BAD_WORKERS, MISSING_EXTRA."""
    crew = _crew(workers, where)
    try:
        yield crew
    except BaseException:
        crew.end()
        raise


def check_workers(workers: Any, where: str) -> None:
    """Check `workers` before anything is computed. Errors: BAD_WORKERS, MISSING_EXTRA."""
    if workers is None:
        return
    if isinstance(workers, int) and not isinstance(workers, bool):
        if workers >= 1:
            import_extra("loky", where)
            return
        message = f"is {workers}"
        hint = f"This machine has {os.cpu_count()} cores; None computes in this process."
    elif isinstance(workers, futures.ThreadPoolExecutor):
        message = "is an executor of threads"
        hint = (
            "Programs of one process compute one after the other, as LAPACK in two threads may "
            "never end: give a number of processes."
        )
    elif not isinstance(workers, Executor):
        message = f"is {kind_of(workers)}"
        hint = (
            "Of a Dask client, give client.get_executor(pure=False)."
            if hasattr(workers, "get_executor")
            else "Give workers=2."
        )
    else:
        try:
            workers.submit(int)
            return
        except RuntimeError as error:  # of which BrokenExecutor is one
            message = f"takes no work: {error}"
            hint = "Open it with a `with` block round the call."
    raise JaxbodyError(
        Problem(
            "BAD_WORKERS",
            where,
            message,
            workers,
            "None, a number of processes above 0, or an executor of processes",
            hint,
        )
    )


def _crew(workers: Any, where: str) -> Crew:
    if workers is None:
        return Crew(ThisProcess(), most=1)
    if isinstance(workers, int):
        make = functools.partial(_processes, workers, where)
        return Crew(make(), make, 2 * workers)
    return Crew(workers)


def _processes(number: int, where: str) -> Executor:
    """Start processes of this machine, one thread each. Later calls use the same ones, with their
    programs, until they have been idle for a while."""
    loky = import_extra("loky", where)
    # in which processes share compiled programs
    folder = jax.config.jax_compilation_cache_dir or _temporary_folder().name  # pyright: ignore[reportAttributeAccessIssue]
    environment = dict.fromkeys(ONE_THREAD, "1") | {
        "JAX_COMPILATION_CACHE_DIR": str(folder),
        "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1",
    }
    executor = loky.get_reusable_executor(
        max_workers=number,
        timeout=IDLE,
        initializer=signal.signal,  # Ctrl-C on a terminal reaches all processes; the caller decides
        initargs=(signal.SIGINT, signal.SIG_IGN),
        env=environment,
    )
    for _ in range(number):
        executor.submit(worker_name)  # imports JAX, while the caller traces
    return executor


@functools.cache
def _temporary_folder() -> tempfile.TemporaryDirectory:
    return tempfile.TemporaryDirectory(prefix="jaxbody-programs-")  # removed when this process ends


def dispatched(
    crew: Crew,
    chunks: Iterable[int],
    arguments: Callable[[int], tuple[Any, ...]],
    where: str,
    *,
    continued: bool = False,
) -> Iterator[tuple[int, ComputedChunk | FailedChunk]]:
    """Yield (chunk, its results or the reason of its failure) for each chunk, as they finish.

    Args:
        crew: the workers.
        chunks: numbers of chunks.
        arguments: chunk -> arguments of `compute_chunk`, made when it is sent.
        where: the place in the call, for messages.
        continued: whether other chunks of the batch have been computed before.

    Errors: OTHER_WORKER; BAD_WORKERS if an executor of the user breaks; LOST if the first chunks
    all fail, unless `continued`."""
    waiting, again = iter(chunks), deque[int]()
    failures: Counter[int] = Counter()
    given_up = 0
    sent: dict[Future[Any], int] = {}

    def send(chunk: int) -> None:
        try:
            future = crew.executor.submit(compute_chunk, *arguments(chunk))
        except futures.BrokenExecutor as error:
            future = Future()
            future.set_exception(error)
        sent[future] = chunk

    try:
        while True:
            # if all fail, it is seen before all are sent
            going = continued or crew.seen or not again
            while going and crew.room(len(sent)) and (chunk := next(waiting, None)) is not None:
                send(chunk)
            if not sent and again:
                send(again.popleft())
            if not sent:
                return
            finished = futures.wait(sent, return_when=futures.FIRST_COMPLETED).done
            broken = any(map(_is_of_broken, finished))
            for future in [*sent] if broken else finished:
                chunk, answer = sent.pop(future), _answer(future)
                if isinstance(answer, ComputedChunk):
                    crew.seen.add(answer.worker)
                else:
                    failures[chunk] += 1
                    if failures[chunk] < TRIES:
                        again.append(chunk)
                        continue
                    given_up += 1
                    if given_up >= MOST_FIRST and not crew.seen and not continued:
                        raise _none_computed(where, given_up, answer)
                yield chunk, answer
            if broken:
                crew.renew(where)
    finally:
        for future in sent:
            future.cancel()


def _none_computed(where: str, number: int, last: FailedChunk) -> JaxbodyError:
    return JaxbodyError(
        Problem(
            "LOST",
            where,
            f"none of the first {number} chunks could be computed; the last one: {last.message}",
            hint=(
                "Compute a few designs without workers=. Is there memory for the processes, and "
                "can they import jaxbody?"
            ),
        )
    )


def _is_of_broken(future: Future[Any]) -> bool:
    """Return whether the executor of a finished future is broken."""
    return not future.cancelled() and isinstance(future.exception(), futures.BrokenExecutor)


def _answer(future: Future[Any]) -> ComputedChunk | FailedChunk:
    """Return the results of a chunk, or the reason of its failure. Error: OTHER_WORKER if its
    worker refused it."""
    if not future.done():
        return FailedChunk("its worker was lost")
    try:
        answer = future.result()
    except Exception as error:
        return FailedChunk(f"{type(error).__name__}: {error!s:.200}")
    if isinstance(answer, FailedChunk) and answer.refused is not None:
        raise JaxbodyError(answer.refused)
    return answer
