"""Responses and modes from 16 channels of 1e5 samples, beside scipy.signal's transforms of the same
segments: `python tests/benchmarks/modal_records.py`.

A chain of 15 masses driven at its end; medians of rounds in which both take turns, after a check
that the modes are those of the chain. MB: the largest allocation of NumPy during one call.
"""

import sys
import time
import tracemalloc
import warnings
from pathlib import Path

import numpy as np
from scipy.signal import spectrogram

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from chains import free_poles

import jaxbody as jb

ROUNDS, SAMPLES, RATE, MASSES = 15, 100_000, 256.0, 15
SEGMENT = 16.0


def chain():
    """Return M, C, K of masses of 1 kg in a row on springs of 1e5 N/m, 1 % damped in each mode."""
    links = 2 * np.eye(MASSES) - np.eye(MASSES, k=1) - np.eye(MASSES, k=-1)
    links[-1, -1] = 1
    square, shapes = np.linalg.eigh(1e5 * links)
    return np.eye(MASSES), shapes * 0.02 * np.sqrt(square) @ shapes.T, 1e5 * links


def simulated_record(M, C, K):
    """Return a record of a random force on the last mass and all accelerations, noise 2 %."""
    rng = np.random.default_rng(0)
    f = np.fft.rfftfreq(SAMPLES, 1 / RATE)
    s = 2j * np.pi * f
    X = (rng.normal(size=(f.size, 2)) @ [1, 1j]) * (f < 120)
    end = np.zeros(MASSES)
    end[-1] = 1.0
    H = [one**2 * np.linalg.solve(M * one**2 + C * one + K, end) for one in s]
    y = np.fft.irfft(np.array(H) * X[:, None], axis=0)
    y = y + 0.02 * y.std(0) * rng.normal(size=y.shape)
    channels = {f"a{i}": (one, "m/s2") for i, one in enumerate(y.T)}
    return jb.Record(None, {"f": (np.fft.irfft(X), "N")} | channels, rate=RATE)


def timed(call):
    start = time.perf_counter()
    call()
    return time.perf_counter() - start


def megabytes(call):
    tracemalloc.start()
    call()
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    return peak / 1e6


def main():
    warnings.simplefilter("ignore", jb.JaxbodyWarning)  # outputs far from the force have nodes
    M, C, K = chain()
    record = simulated_record(M, C, K)
    outputs = [f"a{i}" for i in range(MASSES)]
    together = np.stack([record[name] for name in ["f", *outputs]])
    n = round(SEGMENT * RATE)

    def bare():
        return spectrogram(together, RATE, "hann", n, n // 2, detrend="constant", mode="complex")[2]

    def responses():
        return jb.modal.estimate_responses(record, inputs=["f"], outputs=outputs, segment=SEGMENT)

    def modes():
        return jb.modal.identify_modes(estimated, band=(2, 110))

    estimated = responses()
    found = modes().identification
    true = free_poles(M, C, K)
    assert len(found.poles) == len(true) and np.allclose(found.poles.imag, true.imag, rtol=1e-4)
    calls = {"bare transforms": bare, "responses": responses, "modes": modes}
    spent = {name: [] for name in calls}
    for _ in range(ROUNDS):
        for name, call in calls.items():
            spent[name].append(timed(call))
    base = np.median(spent["bare transforms"])
    for name, call in calls.items():
        each = np.median(spent[name])
        print(f"{name:16s} {each:7.3f} s, {each / base:5.2f} of bare, {megabytes(call):6.0f} MB")


if __name__ == "__main__":
    main()
