"""Chunks sent to workers and received as they finish; what is lost with a worker is sent again,
what fails three times is given up.

A chunk that fails twice, by an error or with its worker, is sent a third time when no other is
under way: a chunk that ends any process that computes it takes its neighbors with it, and they must
not be blamed for that.
"""

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
# chunks given up, and executors made again, before anything is computed
MOST_FIRST, MOST_RENEWALS = 4, 20


def dispatched(
    crew: Crew,
    chunks: Iterable[int],
    arguments: Callable[[int], tuple[Any, ...]],
    where: str,
    *,
    continued: bool = False,
) -> Iterator[tuple[int, ComputedChunk | FailedChunk]]:
    """(chunk, its results or why it has none) for each chunk, in the order in which they finish.

    Args:
        crew: the workers.
        chunks: numbers of chunks.
        arguments: chunk -> arguments of `compute_chunk`, made when it is sent.
        where: the place in the call, for messages.
        continued: whether other chunks of the batch have been computed before.

    Errors: OTHER_WORKER; BAD_WORKERS, also where processes end before they compute anything; LOST
    where the first chunks all fail, unless `continued`.
    """
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

    def failed(chunk: int, why: FailedChunk) -> Iterator[tuple[int, FailedChunk]]:
        failures[chunk] += 1
        if failures[chunk] > TWICE:
            if (
                not crew.seen
                and not continued
                and (given_up := sum(n > TWICE for n in failures.values())) >= MOST_FIRST
            ):
                raise JaxbodyError(
                    Problem(
                        "LOST",
                        where,
                        (
                            f"none of the first {given_up} chunks could be computed; the "
                            f"last one: {why.message}"
                        ),
                        hint="Compute a few designs without workers=.",
                    )
                )
            yield chunk, why
        else:
            (alone if failures[chunk] == TWICE else again).append(chunk)

    renewals = 0
    try:
        while True:
            broken = False
            # they are not left until the end, as all may fail
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
            for future in (
                futures.wait(sent, return_when=futures.FIRST_COMPLETED).done if sent else ()
            ):
                chunk = sent.pop(future)
                answer = _answer(future)
                broken = broken or isinstance(answer, futures.BrokenExecutor)
                if isinstance(answer, ComputedChunk):
                    crew.seen.add(answer.worker)
                    yield chunk, answer
                else:
                    yield from failed(chunk, _failure(answer))
            if broken:
                for future, chunk in [*sent.items()]:
                    sent.pop(future)
                    answer = _answer(future) if future.done() else "its worker was lost"
                    yield from (
                        [(chunk, answer)]
                        if isinstance(answer, ComputedChunk)
                        else failed(chunk, _failure(answer))
                    )
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


def _answer(future: futures.Future[Any]) -> Any:
    try:
        return future.result()
    except Exception as error:
        return error


def _failure(answer: Any) -> FailedChunk:
    """Why a chunk failed. Error: OTHER_WORKER, where its worker refused it."""
    if isinstance(answer, FailedChunk):
        if answer.refused is not None:
            raise JaxbodyError(answer.refused)
        return answer
    return FailedChunk(
        f"{type(answer).__name__}: {answer!s:.200}"
        if isinstance(answer, BaseException)
        else str(answer)
    )
