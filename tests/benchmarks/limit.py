"""What one core of this machine can do on the reference job: a hand-written C++ program, built with g++ when it is asked for."""

import ctypes
import subprocess
import tempfile
from collections.abc import Callable
from pathlib import Path

import numpy as np
import plate

HERE = Path(__file__).parent
FLAGS = ["-O3", "-march=native", "-fno-math-errno", "-ffp-contract=fast", "-fopenmp", "-std=c++17", "-shared", "-fPIC"]


def build() -> ctypes.CDLL:
    """Compile and load the program."""
    folder = Path(tempfile.mkdtemp())
    (folder / "all.cpp").write_text('#include "rb.cpp"\n#include "t4.cpp"\n')
    subprocess.run(["g++", *FLAGS, f"-I{HERE}", str(folder / "all.cpp"), "-o", str(folder / "limit.so")], check=True)
    return ctypes.CDLL(str(folder / "limit.so"))


def tasks() -> dict[str, Callable[[], np.ndarray]]:
    """Name -> function that does the task and returns its result. T1: 10 s, 1000 samples. T2: loss and its gradient for 5
    stiffnesses. T3: 1000 x 1 s, end states. T4: 10000 x 6 frequencies."""
    library, real = build(), ctypes.c_double
    k, k_true = plate.STIFFNESS.copy(), plate.TRUE_STIFFNESS.copy()
    k_1000, k_10000 = plate.several_stiffnesses(1000), plate.several_stiffnesses(10000)
    path, target, gradient, ends, frequencies = (np.zeros(shape) for shape in ((1000, 13), (1000, 13), 6, (1000, 13), (10000, 6)))

    def at(array: np.ndarray) -> ctypes.c_void_p:
        return array.ctypes.data_as(ctypes.c_void_p)

    def task(function: str, result: np.ndarray, *arguments) -> Callable[[], np.ndarray]:
        def run() -> np.ndarray:
            getattr(library, function)(*arguments)
            return result

        return run

    span, second, c = real(10), real(1), real(plate.DAMPING)
    library.simdense(at(k_true), c, span, 1000, 5, at(target))
    return {
        "T1 C RK4": task("sim", path, 0, at(k), c, span, 1000, 1, at(path)),
        "T1 C DOP853": task("simdense", path, at(k), c, span, 1000, 10, at(path)),
        "T2 C dual numbers": task("grad", gradient, 0, at(k), c, span, 1000, 1, at(target), at(gradient)),
        "T3 C SIMD RK4": task("batch", ends, 1, 0, at(k_1000), 1000, c, second, 100, at(ends), 1),
        "T4 C scalar": task("modes", frequencies, 0, at(k_10000), 10000, at(frequencies)),
        "T4 C SIMD": task("modes", frequencies, 1, at(k_10000), 10000, at(frequencies)),
    }
