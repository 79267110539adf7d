"""Programs as data: the same bits as the function itself, on one device and on two, and workers
that would compute something else."""

import dataclasses
import os
import subprocess
import sys
import threading
import time
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.compilation.compile_options import OPTIMIZED
from jaxbody.core.workers import chunk_programs
from jaxbody.core.workers.chunk_programs import compute_chunk, exported

ROWS = [np.linspace(0.1, 7.0, 23), np.arange(69.0).reshape(23, 3)]
SHARED = [np.array(0.3), np.arange(9.0).reshape(3, 3)]


def function(shared, rows):
    a, matrix = shared
    x, v = rows
    return {
        "wave": jnp.sin(a * x) / jnp.sqrt(x),
        "turned": jnp.tanh(v @ matrix),
        "whole": (x > 3).astype(int),
    }


@pytest.fixture(scope="module")
def program():
    return exported(function, SHARED, ROWS, 8, "test")


def test_a_chunk_has_the_bits_of_the_function_itself(program):
    """23 rows are computed in three parts of 8, the last one filled up; each is what jit makes of
    these rows."""
    answer = compute_chunk(program, SHARED, ROWS)
    for first in (0, 8, 16):
        rows = [x[np.minimum(np.arange(first, first + 8), 22)] for x in ROWS]
        direct = jax.jit(function, compiler_options=dict(OPTIMIZED))(SHARED, rows)
        for name, x in direct.items():
            assert (answer.results[name][first : first + 8] == np.asarray(x)[: 23 - first]).all(), (
                name
            )
    assert {name: (x.shape, str(x.dtype)) for name, x in answer.results.items()} == {
        "wave": ((23,), "float64"),
        "turned": ((23, 3), "float64"),
        "whole": ((23,), "int64"),
    }


NAME = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
sys.path.insert(0, {folder!r})
from core.workers.test_chunk_programs import ROWS, SHARED, exported, function

def elsewhere():
    return exported(function, SHARED, ROWS, 8, "test")

print(elsewhere().name)
"""
PACKAGE = Path(jb.__file__).parents[1]


def output_of(script, **environment):
    """What a script prints in a process of its own."""
    paths = {"PYTHONPATH": str(PACKAGE)}
    done = subprocess.run(
        [sys.executable, "-c", script],
        capture_output=True,
        text=True,
        timeout=300,
        env=os.environ | paths | environment,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.long
def test_its_name_is_the_same_in_another_process_and_from_another_line(program):
    assert output_of(NAME.format(folder=str(Path(__file__).parents[2]))) == [program.name]
    other = exported(lambda shared, rows: {"wave": jnp.cos(rows[0])}, SHARED, ROWS, 8, "test")
    assert other.name != program.name != exported(function, SHARED, ROWS, 7, "test").name


def test_what_a_function_closes_over_is_part_of_its_name():
    """Long arrays to the last number, which printed programs may leave out."""
    long = [np.zeros(100_000), np.r_[np.zeros(99_999), 1e-300]]

    def name_with(c):
        return exported(
            lambda shared, rows: {"y": rows[0] * jnp.sum(c)}, [], ROWS[:1], 4, "test"
        ).name

    assert (
        len(
            {
                name_with(c)
                for c in (1.0, np.float64(2.0), np.arange(4.0), *long, *map(jnp.asarray, long))
            }
        )
        >= 5
    )


def test_a_program_with_a_callback_cannot_be_sent():
    def printing(shared, rows):
        jax.debug.print("x {}", rows[0])
        return {"x": rows[0]}

    with pytest.raises(jb.JaxbodyError, match="cannot be sent to workers") as error:
        exported(printing, SHARED, ROWS, 8, "sweep.evaluate")
    assert error.value.code == "NOT_SENT" and "jax.debug.print" in error.value.hint


def test_a_worker_of_another_version_is_refused_by_name(program, monkeypatch):
    other = tuple(
        (name, "0.0.1" if name == "jaxlib" else version) for name, version in program.versions
    )
    monkeypatch.setattr(chunk_programs, "versions", lambda: other)
    answer = compute_chunk(program, SHARED, ROWS)
    assert (
        answer.refused.code == "OTHER_WORKER"
        and answer.refused.where == f"worker {chunk_programs.worker_name()}"
    )
    assert (
        answer.refused.message == "has jaxlib 0.0.1"
        and answer.refused.limit == f"jaxlib {dict(program.versions)['jaxlib']}, as the caller"
    )


def test_a_worker_of_another_precision_is_refused(program, monkeypatch):
    monkeypatch.setattr(chunk_programs, "precision", lambda x64: jax.enable_x64(False))
    answer = compute_chunk(program, SHARED, ROWS)
    assert (
        answer.refused.code == "OTHER_WORKER"
        and answer.refused.message == "computes in float32"
        and "float64" in answer.refused.limit
    )


def test_float32_is_float32_in_every_process(program):
    """The switch is set for the chunk alone."""
    with jax.enable_x64(False):
        single = exported(
            lambda shared, rows: {"y": jnp.sin(rows[0])},
            [],
            [ROWS[0].astype(np.float32)],
            8,
            "test",
        )
    answer = compute_chunk(single, [], [ROWS[0].astype(np.float32)])
    assert answer.results["y"].dtype == np.float32 and jnp.result_type(float) == np.float64
    np.testing.assert_allclose(answer.results["y"], np.sin(ROWS[0]), rtol=1e-6, atol=1e-7)


def test_a_worker_keeps_few_programs(monkeypatch):
    monkeypatch.setattr(chunk_programs, "KEPT", 2)
    for c in range(4):
        compute_chunk(
            exported(lambda shared, rows, c=c: {"y": rows[0] + c}, [], ROWS[:1], 4, "test"),
            [],
            ROWS[:1],
        )
    assert len(chunk_programs._loaded) == 2


DEVICES = """
import jax
import numpy as np
jax.config.update("jax_enable_x64", True)
import jaxbody as jb
from jaxbody.core.compilation.compile_options import OPTIMIZED
from jaxbody.core.workers import chunk_programs
car = jb.presets.quarter_car(damping=1500.0)
times = np.linspace(0.0, 0.2, 3)
motion = {"road": jb.Harmonic(frequency=2.0, translation=[0, 0, 0.01])}
def moved(model):
    return {"height": jb.simulate(model, times, motion=motion).state.q[-1]}
result = jb.sweep(car, moved, {"body.mass": np.linspace(300.0, 400.0, 21)}, chunk=4)
print(jax.local_device_count(), *(loaded.width for loaded in chunk_programs._loaded.values()))
print(result["height"].values.tobytes().hex())
"""


@pytest.mark.long
def test_two_devices_compute_the_bits_of_one():
    """Each computes four models of its own at a time, eight in all; one device is the way of a
    sweep without workers."""
    one, two = (
        output_of(DEVICES, XLA_FLAGS=f"--xla_force_host_platform_device_count={n}") for n in (1, 2)
    )
    assert (one[0], two[0]) == ("1", "2 8")
    assert one[1] == two[1] and len(one[1]) == 21 * 2 * 16


def test_threads_of_one_process_compute_one_after_the_other(monkeypatch):
    """As those of a worker of Dask with several threads, by programs with LAPACK: two at a time
    might wait for each other for ever."""
    inside, most, lock = [], [], threading.Lock()

    def watched(program):
        loaded = dataclasses.replace(program.loaded())

        def call(*arguments):
            with lock:
                inside.append(program.name)
                most.append(len(inside))
            time.sleep(0.005)
            results = loaded.call(*arguments)
            with lock:
                inside.remove(program.name)
            return results

        monkeypatch.setitem(
            chunk_programs._loaded, program.name, dataclasses.replace(loaded, call=call)
        )

    def solved(shared, rows, c):
        return {"y": jnp.linalg.cholesky(rows[0] + c)[:, -1, -1]}

    matrices = [np.ones((24, 3, 3)) + 3 * np.eye(3)]
    programs = [exported(partial(solved, c=c), [], matrices, 8, "test") for c in (0.0, 1.0)]
    assert all(b"lapack" in program.data for program in programs)
    alone = [compute_chunk(program, [], matrices).results["y"] for program in programs]
    for program in programs:
        watched(program)
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda i: compute_chunk(programs[i % 2], [], matrices), range(12)))
    assert len(most) == 36 and max(most) == 1
    assert all((answer.results["y"] == alone[i % 2]).all() for i, answer in enumerate(answers))


LAPACK = """
import jax
import jax.numpy as jnp
import numpy as np
jax.config.update("jax_enable_x64", True)
from jaxbody.core.workers.chunk_programs import exported
rows = [np.ones((8, 3, 3)) + 3 * np.eye(3)]
for f in (jnp.linalg.cholesky, jnp.sin):
    print(exported(lambda shared, rows: {"y": f(rows[0])}, [], rows, 4, "test").loaded().width)
"""


@pytest.mark.long
def test_programs_with_lapack_keep_to_one_device():
    """Two at a time in one process may wait for each other for ever, with jaxlib 0.10."""
    assert output_of(LAPACK, XLA_FLAGS="--xla_force_host_platform_device_count=2") == ["4", "8"]
