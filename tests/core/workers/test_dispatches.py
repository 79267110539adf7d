"""Chunks sent, lost and sent again: every rule with executors that do as they are told,
without processes."""

import concurrent.futures as futures
from concurrent.futures import BrokenExecutor, Executor, Future

import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.errors import Problem
from jaxbody.core.workers.chunk_programs import ComputedChunk, FailedChunk
from jaxbody.core.workers.executors import Crew, dispatched


class Scripted(Executor):
    """Computes when asked whether anything is done; `fate(chunk, others under way)` says how: a
    result, or an exception to raise."""

    def __init__(self, fate, log):
        self.fate, self.log, self.sent, self.broken = fate, log, {}, False

    def submit(self, function, /, *args, **options):
        if self.broken:
            raise BrokenExecutor("broken")
        future = Future()
        self.sent[future] = args[0]
        self.log.append(args[0])
        return future

    def shutdown(self, wait=True, *, kill_workers=False, **options):
        pass

    def step(self):
        """Finish the oldest one, if there is one."""
        if not self.sent:
            return
        future = next(iter(self.sent))
        chunk = self.sent.pop(future)
        fate = self.fate(chunk, list(self.sent.values()))
        if isinstance(fate, BrokenExecutor):
            self.broken = True
            for each in [future, *self.sent]:
                each.set_exception(fate)
            self.sent.clear()
        elif isinstance(fate, Exception):
            future.set_exception(fate)
        else:
            future.set_result(fate)


def done(worker="a"):
    return ComputedChunk({"x": np.zeros(1)}, worker)


@pytest.fixture
def run(monkeypatch):
    """run(fate, chunks) -> {chunk: answer}, chunks in the order sent, number of executors."""

    def run(fate, chunks=range(20), most=4, renewable=True):
        made, log = [], []

        def make():
            made.append(Scripted(fate, log))
            return made[-1]

        real = futures.wait

        def wait(sent, return_when):
            made[-1].step()
            return real(sent, return_when=return_when)

        monkeypatch.setattr(futures, "wait", wait)
        crew = Crew(make(), make if renewable else None, most)
        return dict(dispatched(crew, chunks, lambda chunk: (chunk,), "sweep.workers")), log, made

    return run


def test_each_chunk_is_sent_once_and_few_at_a_time(run):
    most = []
    answers, log, _ = run(lambda chunk, others: most.append(len(others) + 1) or done())
    assert sorted(answers) == log == list(range(20)) and max(most) == 4


def test_more_are_sent_when_more_workers_answer(run):
    most = []

    def fate(chunk, others):
        most.append(len(others) + 1)
        return done(f"worker {chunk % 30}")

    run(fate, range(300), most=None)
    assert most[0] == 16 and max(most) == 120


def test_a_chunk_whose_worker_is_lost_runs_again_and_its_neighbors_with_it(run):
    once = []

    def fate(chunk, others):
        if chunk == 5 and not once:
            once.append(chunk)
            return BrokenExecutor("a process ended")
        return done()

    answers, log, made = run(fate)
    assert (
        all(isinstance(answer, ComputedChunk) for answer in answers.values()) and len(answers) == 20
    )
    assert len(made) == 2 and log[:20] == [*range(20)] and sorted(log[20:]) == [5, 6, 7, 8]


def test_a_chunk_that_ends_every_process_is_given_up_alone_and_no_other(run):
    company = []

    def fate(chunk, others):
        if chunk == 7:
            company.append(others)
            return BrokenExecutor("a process ended")
        return done()

    answers, _, made = run(fate)
    assert sorted(answers) == list(range(20)) and [
        i for i, answer in answers.items() if isinstance(answer, FailedChunk)
    ] == [7]
    assert len(company) == 3 and company[0] and company[1] == company[2] == [] and len(made) == 4
    assert answers[7].message == "BrokenExecutor: a process ended"


@pytest.mark.parametrize(
    "error",
    [
        MemoryError("too large"),
        futures.CancelledError(),
        FailedChunk("ValueError: x"),
        TimeoutError(),
    ],
)
def test_an_error_costs_its_own_chunk_only(run, error):
    answers, log, made = run(lambda chunk, others: error if chunk == 3 else done())
    assert [i for i, answer in answers.items() if isinstance(answer, FailedChunk)] == [3] and len(
        answers
    ) == 20
    assert log.count(3) == 3 and log[-1] == 3 and len(log) == 22 and len(made) == 1


def test_where_the_first_chunks_all_fail_the_call_fails(run):
    with pytest.raises(
        jb.JaxbodyError,
        match="none of the first 4 chunks could be computed; the last one: KeyError: 'x'",
    ) as error:
        run(lambda chunk, others: KeyError("x"), range(10**9))
    assert error.value.code == "LOST"


def test_processes_that_never_start_end_the_call(run):
    class NeverStarts(Scripted):
        def submit(self, function, /, *args, **options):
            raise BrokenExecutor("broken")

    crew = Crew(NeverStarts(None, []), lambda: NeverStarts(None, []), 2)
    with pytest.raises(jb.JaxbodyError, match=r"first 4 chunks .*BrokenExecutor: broken") as error:
        list(dispatched(crew, range(9), lambda chunk: (chunk,), "sweep.workers"))
    assert error.value.code == "LOST"


def test_an_executor_that_cannot_be_made_again_is_reported(run):
    with pytest.raises(jb.JaxbodyError, match="is broken: one of its processes has ended") as error:
        run(lambda chunk, others: BrokenExecutor("gone") if chunk == 2 else done(), renewable=False)
    assert error.value.code == "BAD_WORKERS"


def test_a_worker_that_refuses_ends_the_call_by_name(run):
    refused = FailedChunk("", Problem("OTHER_WORKER", "worker node7:12", "has jax 0.7.0"))
    with pytest.raises(jb.JaxbodyError, match=r"worker node7:12: has jax 0\.7\.0") as error:
        run(lambda chunk, others: refused if chunk == 2 else done())
    assert error.value.code == "OTHER_WORKER"


def test_what_is_under_way_is_cancelled_when_the_caller_stops():
    executor = Scripted(None, [])
    chunks = dispatched(Crew(executor, most=4), range(9), lambda chunk: (chunk,), "sweep.workers")
    future = executor.submit(None, -1)
    future.set_result(None)

    def interrupted(sent, return_when):
        raise KeyboardInterrupt

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(futures, "wait", interrupted)
        with pytest.raises(KeyboardInterrupt):
            next(chunks)
    assert sum(each.cancelled() for each in executor.sent) == 4
