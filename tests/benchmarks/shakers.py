"""Records of a machine on a shaker, fitted by `jaxbody fit FILE` without an option: truth inside
99 % intervals, or a status that says why.

`python tests/benchmarks/shakers.py` writes `--count` text files of 2 to 60 s at 100 to 5000 Hz, in
mm, ms and g, with a base that is clean or has noise of 0.02 mm, integrates the machine by SciPy,
and fits stiffness and damping of its mount. `--write` puts the table into shakers.md.
"""

import argparse
import datetime
import sys
import tempfile
import time
import warnings
from pathlib import Path

import jax
import numpy as np

import jaxbody as jb

sys.path.insert(0, str(Path(__file__).parents[1]))

import shaken_machine

SEED = 2026
# [s], [Hz]
RUNS = [(2, 100), (10, 200), (2, 1000), (60, 100), (2, 5000), (30, 500), (10, 2000), (60, 5000)]
FREE = ["mount.stiffness", "mount.damping"]
BASE_NOISE = 2e-5  # [m]
UNITS = ("ms", "s"), ("mm", "m"), ("g", "m/s2")


def write_case(folder, number):
    """The file of one case, its stiffness and damping, and words."""
    rng = np.random.default_rng([SEED, number])
    duration, rate = RUNS[number % len(RUNS)]
    k, c = 370e3 * np.exp(0.2 * rng.normal()), 550.0 * np.exp(0.2 * rng.normal())
    phases, noisy = rng.uniform(0, 2 * np.pi, 5), bool(rng.integers(2))
    times = np.arange(round(duration * rate) + 1) / rate
    rows = shaken_machine.record(times, k, c, phases, BASE_NOISE * noisy, rng)
    units = [pair[rng.integers(2)] for pair in UNITS]
    words = f"{duration} s at {rate} Hz, {'noisy' if noisy else 'clean'} floor, {', '.join(units)}"
    return (
        shaken_machine.write_case(folder, rows, units),
        dict(zip(FREE, (k, c), strict=True)),
        words,
    )


def fitted(path):
    """What the command does with a file: its [fit], without an option."""
    study = jb.read_study(path)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always", jb.JaxbodyWarning)
        fit = jb.fit(study.model, study.experiments, progress=False, **study.fit)
    return fit, [w.message.code for w in caught if isinstance(w.message, jb.JaxbodyWarning)]


def inside(fit, truth, level=0.99):
    return all(low <= truth[path] <= high for path, (low, high) in fit.intervals(level).items())


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--count", type=int, default=100, help="(default: 100)")
    parser.add_argument(
        "--longest", type=int, default=10**6, help="largest number of samples (default: 1e6)"
    )
    parser.add_argument("--write", action="store_true", help="write shakers.md")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    rows, good, run = [], 0, 0
    for number in range(options.count):
        duration, rate = RUNS[number % len(RUNS)]
        if duration * rate > options.longest:
            continue
        with tempfile.TemporaryDirectory() as folder:
            path, truth, words = write_case(Path(folder), number)
            begun = time.time()
            fit, codes = fitted(path)
        run += 1
        held, status = inside(fit, truth), jb.Status(int(fit.status)).name
        good += held or status != "OK"
        errors = ", ".join(
            f"{(float(fit.estimates[p]) - x) / float(fit.standard_errors[p]):+.1f}"
            for p, x in truth.items()
        )
        rows.append(
            f"| {number} | {words} | {status} | {errors} | {'yes' if held else 'no'} | "
            f"{', '.join(sorted(set(codes)))} |"
        )
        print(rows[-1], f"{time.time() - begun:.0f} s", flush=True)
    lines = [
        "# Shaker records by `jaxbody fit FILE`",
        "",
        (
            f"`tests/benchmarks/shakers.py`, seed {SEED}, {datetime.date.today()}; {run} records "
            f"of up to {options.longest} samples,"
        ),
        (
            "stiffness and damping of a mount. Truth inside the 99 % intervals, or a status that "
            f"says why: {good} of {run}."
        ),
        "",
        (
            "Where the floor's own record has noise, it acts as a force that the model lacks, the "
            "larger the faster it was sampled (0.02 mm at"
        ),
        (
            "5000 Hz are 0.2 m/s): NOISY_INPUT says so. Such a record of the floor must be "
            "filtered before it drives a model."
        ),
        "",
        "| number | record | status | errors in standard errors | inside | warnings |",
        "|---|---|---|---|---|---|",
        *rows,
    ]
    if options.write:
        Path(__file__).with_suffix(".md").write_text("\n".join(lines) + "\n")
    print(lines[3])


if __name__ == "__main__":
    main()
