"""Throughput by several processes: sweeps, tolerances and several starts by one process, by two and
by Dask, and the driver's bookkeeping.

`python tests/benchmarks/workers.py` needs jaxbody[cluster,xarray] and two free cores. Each call is
made `--repeats` times after a first one in which all programs are compiled, in turn with the same
call by one process, and the medians are printed: of time, and of processor time, which other
programs on the same cores do not change much. `--chunks 100000` tries the bookkeeping alone: so
many chunks that compute nothing, sent, received and written; `--designs 10000000` a sweep of so
many designs that compute little, by this process into a store.
"""

import argparse
import contextlib
import os
import resource
import tempfile
import time
import warnings
from collections.abc import Callable, Iterator
from concurrent.futures import Executor, Future
from pathlib import Path
from typing import Any

import jax
import numpy as np
import plate
import psutil

import jaxbody as jb
from jaxbody.core.workers.chunk_programs import ComputedChunk
from jaxbody.core.workers.chunk_stores import ChunkStore
from jaxbody.core.workers.executors import Crew, dispatched

TIMES = np.linspace(0.0, 1.0, 3)


def jobs():
    """{name: workers -> numbers to compare}."""
    job = plate.JOB
    model, motion = job.model(), job.motion()
    name = model.element_names[0]

    def frequencies(model):
        return {"frequency": jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency}

    def moved(model):
        return {"q": jb.simulate(model, TIMES, motion=motion, rtol=1e-6).state.q[-1]}

    k = float(model[name].stiffness)
    over, scatter = (
        {f"{name}.stiffness": np.linspace(0.8 * k, 1.2 * k, 200_000)},
        {"*.stiffness": 0.02 * k},
    )
    sensors = {"corner": jb.Position("body 0", [1.0, 0.5, 0.0])}
    times = np.linspace(0.0, 3.0, 61)
    measured = jb.measure(
        jb.simulate(model, times, motion=motion), sensors, noise=1e-4, key=jax.random.key(0)
    )
    runs = {
        "run": jb.Experiment(times, motion=motion, sensors=sensors, measured=measured, noise=1e-4)
    }
    guess = jb.replace(model, {"*.stiffness": 1.2 * k})
    return {
        "frequencies of 2e5 designs": lambda workers: (
            jb.sweep(model, frequencies, over, workers=workers)["frequency"].values
        ),
        "motions of 1 s of 2e5 designs": lambda workers: (
            jb.sweep(model, moved, over, workers=workers)["q"].values
        ),
        "tolerances, 1e5 samples": lambda workers: (
            jb.tolerances(model, frequencies, scatter, samples=100_000, workers=workers).samples
        ),
        "multistart of 32": lambda workers: (
            jb.fitting.multistart(
                guess, runs, free=[f"{name}.stiffness"], starts=32, workers=workers
            ).cost
        ),
    }


def processor_seconds() -> tuple[float, float]:
    """Processor time so far of this process, and of all those that it has started and that
    still run."""
    children = psutil.Process().children(recursive=True)
    return time.process_time(), sum(sum(child.cpu_times()[:2]) for child in children)


@contextlib.contextmanager
def dask() -> Iterator[Executor]:
    from distributed import Client, LocalCluster

    with (
        LocalCluster(n_workers=2, threads_per_worker=1, dashboard_address=None) as cluster,
        Client(cluster) as client,
        client.get_executor(pure=False, retries=2) as executor,
    ):
        yield executor


def in_turn(
    job: Callable[[Any], Any], several: Any, repeats: int
) -> tuple[np.ndarray, np.ndarray, str]:
    """Medians of [time, processor time of the caller, that of workers] by one process and by
    several, and how alike their numbers are. The first call of each, which compiles, does
    not count."""
    measured = []
    for _ in range(repeats + 1):  # in turn, so that both meet the same machine
        results = []
        for workers in (None, several):
            before, begin = processor_seconds(), time.perf_counter()
            results.append(np.asarray(job(workers)))
            seconds, after = time.perf_counter() - begin, processor_seconds()
            measured.append((seconds, after[0] - before[0], after[1] - before[1]))
        alone, result = results
        assert result.shape == alone.shape
    same = "to the bit" if (result == alone).all() else f"to {np.abs(result / alone - 1).max():.1g}"
    return np.median(measured[2::2], axis=0), np.median(measured[3::2], axis=0), same


def compare(names: list[str], repeats: int) -> None:
    for variable in ("PJRT_NPROC", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        # one thread for Dask's workers, and for this process when JAX starts
        os.environ[variable] = "1"
    print(
        "| job | who | time [s] | of processor: caller [s] | workers [s] | times as fast | times "
        "the processor | same numbers |"
    )
    print("|---" * 8 + "|")
    # a cluster keeps cores busy even when it has no work
    ways = {"two by loky": lambda: contextlib.nullcontext(2), "two by Dask": dask}
    chosen = {
        name: job
        for name, job in jobs().items()
        if not names or any(word in name for word in names)
    }
    for way, crew in ways.items():
        with crew() as several:
            for name, job in chosen.items():
                (alone, caller, _), (seconds, own, others), same = in_turn(job, several, repeats)
                print(f"| {name} | one process | {alone:.2f} | {caller:.2f} | | | | |")
                cells = (
                    f"{seconds:.2f} | {own:.2f} | {others:.2f} | {alone / seconds:.2f} | "
                    f"{(own + others) / caller:.2f}"
                )
                print(f"| {name} | {way} | {cells} | {same} |", flush=True)


class AtOnce(Executor):
    """A worker that needs no time."""

    def submit(self, function, /, *args, **options):
        future: Future = Future()
        future.set_result(ComputedChunk({"x": args[0]}, f"worker {len(args[0])}"))
        return future


def peak() -> float:
    """Largest memory of this process so far [MB]."""
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def bookkeeping(chunks: int) -> None:
    """Chunks of one design, a number for each: what the driver does for them."""
    rows = np.zeros(1)
    print(
        (
            "| | time a chunk [ms] | of the processor [ms] | files a chunk | on disk [bytes] | "
            "memory [bytes] | found again in [s] |\n"
        )
        + 7 * "|---"
        + "|"
    )
    for stored in (False, True):
        with tempfile.TemporaryDirectory() as folder:
            path = Path(folder, "s.zarr")
            store = ChunkStore(path, {}, {}, {"x": ((), "float64")}, count=chunks, size=1)
            store.write(0, {"x": rows})  # what is needed once is not counted
            begin, cpu, memory = time.perf_counter(), time.process_time(), peak()
            for chunk, answer in dispatched(
                Crew(AtOnce()), range(chunks), lambda chunk: (rows,), "benchmark"
            ):
                if stored:
                    store.write(chunk, answer.results)
            seconds, cpu, memory = (
                time.perf_counter() - begin,
                time.process_time() - cpu,
                peak() - memory,
            )
            begin = time.perf_counter()
            found = len(store.complete())
            again = time.perf_counter() - begin
            assert found == (chunks if stored else 1)
            files = [file.stat() for file in path.rglob("*") if file.is_file()]
            each = (
                1e3 * seconds / chunks,
                1e3 * cpu / chunks,
                len(files) / chunks,
                512 * sum(x.st_blocks for x in files) / chunks,
            )
            cells = [f"{x:.3g}" for x in (*each, 2**20 * memory / chunks, again)]
            print(
                f"| {chunks} chunks {'written, too' if stored else 'sent and received'} | "
                f"{' | '.join(cells)} |",
                flush=True,
            )


def large(designs: int) -> None:
    """A sweep of samples whose results are written and not kept."""
    car = jb.presets.quarter_car()

    def sag(model):
        return {"sag": model["body"].mass * 9.81 / model["suspension"].stiffness}

    over = {"suspension.stiffness": (2e4, 6e4), "body.mass": (300.0, 450.0)}
    for count in (designs // 100, designs):
        with tempfile.TemporaryDirectory() as folder:
            before, begin = peak(), time.perf_counter()
            result = jb.sweep(
                car, sag, over, samples=count, out=Path(folder, "s.zarr"), chunk=min(count, 65536)
            )
            assert int(np.count_nonzero(result["status"][-1000:])) == 0
            size = sum(file.stat().st_size for file in Path(folder).rglob("*") if file.is_file())
            print(
                f"{count} designs: {time.perf_counter() - begin:.1f} s, largest memory "
                f"{before:.0f} MB before and {peak():.0f} MB after, {size / 2**20:.0f} MB on disk",
                flush=True,
            )


if __name__ == "__main__":
    warnings.simplefilter("ignore", jb.JaxbodyWarning)  # of residuals that are correlated
    jax.config.update("jax_enable_x64", True)
    parser = argparse.ArgumentParser()
    parser.add_argument("--chunks", type=int)
    parser.add_argument("--designs", type=int)
    parser.add_argument("--repeats", type=int, default=9)
    parser.add_argument("jobs", nargs="*", help="words of the jobs to run; all without")
    args = parser.parse_args()
    if args.chunks:
        bookkeeping(args.chunks)
    elif args.designs:
        large(args.designs)
    else:
        compare(args.jobs, args.repeats)
