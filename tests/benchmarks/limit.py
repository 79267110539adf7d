"""The speed of a hand-written C++ program for a job on one core, built with g++ from the tables of
the job when it is needed."""

import ctypes
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
from job import TIMES, Job

HERE = Path(__file__).parent
FLAGS = [
    "-O3",
    "-march=native",
    "-fno-math-errno",
    "-ffp-contract=fast",
    "-std=c++17",
    "-shared",
    "-fPIC",
]


def constants(job: Job) -> str:
    """The tables of a job in C."""

    def table(name: str, values, kind: str = "double") -> str:
        shape = "".join(f"[{n}]" for n in np.shape(values))
        numbers = repr(np.asarray(values).tolist()).replace("[", "{").replace("]", "}")
        return f"constexpr {kind} {name}{shape}={numbers};\n"

    return "".join(
        [
            table("NB", len(job.mass), "int"),
            table("NS", len(job.stiffness), "int"),
            table("NEWTON", job.newton, "int"),
            table("FROM", job.ties[:, 0], "int"),
            table("TO", job.ties[:, 1], "int"),
            table("PA", job.a),
            table("PB", job.b),
            table("L0", job.free_length),
            table("MASS", job.mass),
            table("INERTIA", job.inertia),
            table("P0", job.position),
            table("OB", job.base),
            table("OMEGA", 2 * np.pi * job.frequency),
            table("SHAKE", job.shake),
            table("TURN", job.turn),
            table("DAMPING", job.damping),
        ]
    )


def build(job: Job) -> ctypes.CDLL:
    """Compile and load the program."""
    folder = Path(tempfile.mkdtemp())
    (folder / "model.h").write_text("#pragma once\n" + constants(job))
    (folder / "all.cpp").write_text('#include "rb.cpp"\n#include "t4.cpp"\n')
    subprocess.run(
        [
            "g++",
            *FLAGS,
            f"-I{HERE}",
            f"-I{folder}",
            str(folder / "all.cpp"),
            "-o",
            str(folder / "limit.so"),
        ],
        check=True,
    )
    return ctypes.CDLL(str(folder / "limit.so"))


def tasks(job: Job) -> dict[str, Callable[[], np.ndarray]]:
    """Name -> function that does the task and returns its result: T1 positions and quaternions at
    TIMES, T2 the gradient, T3 positions and quaternions after 1 s, T4 frequencies."""
    library, real = build(job), ctypes.c_double
    n, ns, nv = 13 * len(job.mass), len(job.stiffness), 6 * len(job.mass)
    saves, k, k_true = len(TIMES) - 1, job.stiffness.copy(), job.true_stiffness.copy()
    k_1000, k_10000 = job.several_stiffnesses(1000), job.several_stiffnesses(10000)
    path, target, gradient, ends, frequencies = (
        np.zeros(s) for s in ((saves, n), (saves, n), 1 + ns, (1000, n), (10000, nv))
    )

    def at(array: np.ndarray) -> ctypes.c_void_p:
        return array.ctypes.data_as(ctypes.c_void_p)

    def task(finish: Callable, function: str, *arguments) -> Callable[[], np.ndarray]:
        def run() -> np.ndarray:
            getattr(library, function)(*arguments)
            return finish()

        return run

    span, second = real(TIMES[-1]), real(1)
    library.simdense(at(k_true), span, saves, job.saves_per_long_step // 2, at(target))
    path_found = lambda: np.vstack([job.places(job.start), job.places(path)])  # noqa: E731
    result = lambda: np.sort(frequencies)  # noqa: E731
    return {
        "T1 C RK4": task(path_found, "sim", at(k), span, saves, job.steps, at(path)),
        "T1 C DOP853": task(
            path_found, "simdense", at(k), span, saves, job.saves_per_long_step, at(path)
        ),
        "T2 C dual numbers": task(
            lambda: gradient[1:], "grad", at(k), span, saves, job.steps, at(target), at(gradient)
        ),
        "T3 C SIMD RK4": task(
            lambda: job.places(ends),
            "batch",
            at(k_1000),
            1000,
            second,
            job.steps_per_second,
            at(ends),
        ),
        "T4 C scalar": task(result, "modes", 0, at(k_10000), 10000, at(frequencies)),
        "T4 C SIMD": task(result, "modes", 1, at(k_10000), 10000, at(frequencies)),
    }
