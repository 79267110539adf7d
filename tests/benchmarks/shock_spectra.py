"""The speed of a shock spectrum against scipy.signal.lfilter, frequency by frequency: `python
tests/benchmarks/shock_spectra.py`.

200 frequencies, 5 damping ratios, absolute acceleration of El Centro at its samples. SciPy's filter
of each oscillator is the same recurrence (ramp invariant, ISO 18431-4); both compute their
coefficients, in turn in one process. Exit code 1 below the required ratio of the fastest rounds,
which other programs on the machine disturb least.
"""

import statistics
import sys
import time
from pathlib import Path

import jax
import numpy as np
from scipy.signal import lfilter

sys.path.insert(0, str(Path(__file__).parents[1]))
sys.path.insert(0, str(Path(__file__).parents[1] / "shock"))
from accelerograms import el_centro

import jaxbody as jb

REQUIRED, ROUNDS = 20.0, 60
FREQUENCIES, DAMPING = np.geomspace(0.1, 12.5, 200), (0.01, 0.02, 0.05, 0.1, 0.2)


def by_lfilter(a: np.ndarray, h: float) -> np.ndarray:
    """One call for each oscillator, with the coefficients of ISO 18431-4 for the
    absolute acceleration."""
    peaks = np.empty((len(DAMPING), len(FREQUENCIES)))
    for i, zeta in enumerate(DAMPING):
        for j, f in enumerate(FREQUENCIES):
            w = 2 * np.pi * f
            E, K = np.exp(-zeta * w * h), w * h * np.sqrt(1 - zeta**2)
            C, S = E * np.cos(K), E * np.sin(K) / K
            numerator = [1 - S, 2 * (S - C), E * E - S]
            peaks[i, j] = np.abs(lfilter(numerator, [1.0, -2 * C, E * E], a)).max()
    return peaks


def seconds(function) -> float:
    start = time.perf_counter()
    function()
    return time.perf_counter() - start


def main() -> int:
    jax.config.update("jax_enable_x64", True)
    record = el_centro()
    a, h = record["acceleration"], record.sampling.step

    def ours():
        return jb.shock.shock_spectrum(
            record, FREQUENCIES, damping=DAMPING
        ).values.block_until_ready()

    difference = np.abs(np.asarray(ours()) / by_lfilter(a, h) - 1).max()
    times = [(seconds(ours), seconds(lambda: by_lfilter(a, h))) for _ in range(ROUNDS)]
    for name, of in (("medians", statistics.median), ("fastest", min)):
        mine, scipy_ = (of(column) for column in zip(*times, strict=True))
        print(
            f"{name}: jaxbody {1e3 * mine:.2f} ms, scipy.signal.lfilter {1e3 * scipy_:.2f} ms: "
            f"ratio {scipy_ / mine:.1f}"
        )
    print(f"largest relative difference {difference:.1e}")
    return scipy_ / mine < REQUIRED


if __name__ == "__main__":
    sys.exit(main())
