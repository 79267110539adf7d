"""Chunks sent to workers and received as they finish. A chunk that is lost with its worker is sent
again; one that fails three times is given up.

A chunk that fails twice, by an error or with its worker, is sent a third time when no other is
under way. Otherwise a chunk that ends every process that computes it would cause other chunks,
which are lost with these processes, to be given up too."""

from __future__ import annotations

import concurrent.futures as futures
from collections import Counter, deque
from collections.abc import Callable, Iterable, Iterator
from typing import Any

from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.core.workers.chunk_programs import ComputedChunk, FailedChunk, compute_chunk
from jaxbody.core.workers.executors import Crew

TWICE = 2  # failures after which a chunk is sent alone
MOST_ALONE = 8  # chunks that wait to be sent alone
# most chunks given up, and most broken executors replaced, before anything is computed
MOST_FIRST, MOST_RENEWALS = 4, 20


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

    Errors: OTHER_WORKER; BAD_WORKERS, also where processes end before they compute anything; LOST
    where the first chunks all fail, unless `continued`."""
    waiting, again, alone = iter(chunks), deque[int](), deque[int]()
    failures: Counter[int] = Counter()
    sent: dict[futures.Future[Any], int] = {}

    def send(chunk: int) -> bool:
        try:
            sent[crew.executor.submit(compute_chunk, *arguments(chunk))] = chunk
        except futures.BrokenExecutor:
            (alone if failures[chunk] == TWICE else again).appendleft(chunk)
            return False
        return True

    def given_up(chunk: int, why: FailedChunk) -> bool:
        failures[chunk] += 1
        if failures[chunk] <= TWICE:
            (alone if failures[chunk] == TWICE else again).append(chunk)
            return False
        lost = sum(n > TWICE for n in failures.values())
        if lost >= MOST_FIRST and not crew.seen and not continued:
            raise JaxbodyError(
                Problem(
                    "LOST",
                    where,
                    (
                        f"none of the first {lost} chunks could be computed; the last one: "
                        f"{why.message}"
                    ),
                    hint="Compute a few designs without workers=.",
                )
            )
        return True

    renewals = 0
    try:
        while True:
            broken = False
            # chunks to be sent alone do not wait until the end, as all may fail
            full = len(alone) >= (MOST_ALONE if crew.seen else 1)
            while (
                not full
                and not broken
                and crew.room(len(sent))
                and (chunk := again.popleft() if again else next(waiting, None)) is not None
            ):
                broken = not send(chunk)
            if not sent and not broken and alone:
                broken = not send(alone.popleft())
            if not sent and not broken:
                return
            finished = futures.wait(sent, return_when=futures.FIRST_COMPLETED).done if sent else ()
            broken = broken or any(map(_is_of_broken, finished))
            for future in [*sent] if broken else finished:
                chunk, answer = sent.pop(future), _answer(future)
                if isinstance(answer, ComputedChunk):
                    crew.seen.add(answer.worker)
                elif not given_up(chunk, answer):
                    continue
                yield chunk, answer
            if broken:
                renewals = 0 if crew.seen else renewals + 1
                if renewals > MOST_RENEWALS:
                    raise JaxbodyError(
                        Problem(
                            "BAD_WORKERS",
                            where,
                            f"broke {renewals} times before anything was computed",
                            hint=(
                                "Processes end as soon as they start: is there memory for them, "
                                "and can they import jaxbody?"
                            ),
                        )
                    )
                crew.renew(where)
    finally:
        for future in sent:
            future.cancel()


def _is_of_broken(future: futures.Future[Any]) -> bool:
    """Return whether the executor of a finished future is broken."""
    return not future.cancelled() and isinstance(future.exception(), futures.BrokenExecutor)


def _answer(future: futures.Future[Any]) -> ComputedChunk | FailedChunk:
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
