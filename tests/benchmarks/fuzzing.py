"""Model files, data sheets and records with characters, words and values changed: each is read, or
ends in a clear error, soon.

    python tests/benchmarks/fuzzing.py [--files N] [--seed S]

N changed files of each kind, made from ready models: TOML and JSON, data sheets of mounts, hard
points, records; not MJCF, each of which MuJoCo compiles in a process of its own. A file that raises
anything but a JaxbodyError, a message of more than twelve lines, or a file that takes more than
SECONDS of the processor ends the run with exit code 1. The table goes to fuzzing.md.
"""

import argparse
import datetime
import resource
import sys
import tempfile
import time
import warnings
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).parents[1]))
from mutated_files import changed_text, changed_value

import jaxbody as jb

SECONDS, MEMORY = 2.0, 200e6  # limits for a file
MOUNTS = """name, a, b, x [mm], y [mm], z [mm], kx [N/mm], ky [N/mm], kz [N/mm]
front left, engine, frame, 300, 250, -100, 120, 110, 350
front right, engine, frame, 300, -250, -100, 120, 110, 350
rear, engine, frame, -400, 0, -50, 200, 180, 500
"""
POINTS = """name, x [mm], y [mm], z [mm]
lower front, -120, 380, 180
lower rear, 180, 390, 185
lower outer, 0, 720, 170
"""
BODIES = {"engine": jb.Body(180.0, [9, 12, 7]), "frame": jb.Support()}


def sources(folder: Path) -> dict:
    """{kind: (paths of good files, how they are read)}."""
    models = {
        make.__name__: make()
        for make in (
            jb.presets.quarter_car,
            jb.presets.engine_on_mounts,
            jb.presets.double_pendulum,
        )
    }
    toml = [folder / f"{name}.toml" for name in models]
    for model, path in zip(models.values(), toml, strict=True):
        jb.write_model(model, path)
    times = 0.01 * np.arange(60)
    record = folder / "run.csv"
    record.write_text(
        "t [s],a [m/s2]\n"
        + "".join(f"{t:.3f},{x:.6f}\n" for t, x in zip(times, np.sin(20 * times), strict=True))
    )
    mounts, points = folder / "mounts.csv", folder / "points.csv"
    mounts.write_text(MOUNTS)
    points.write_text(POINTS)
    return {
        "model files, TOML": (toml, jb.read_model, changed_text),
        "model files, JSON": (toml, jb.read_model, changed_value),
        "data sheets of mounts": (
            [mounts],
            lambda path: jb.files.read_mounts(path, BODIES),
            changed_text,
        ),
        "hard points": ([points], jb.files.read_hard_points, changed_text),
        "records": (
            [record],
            lambda path: jb.read_record(path, time="t", channels={"a": "a"}),
            changed_text,
        ),
    }


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--files", type=int, default=20_000)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    rng, rows, bad = np.random.default_rng(options.seed), [], 0
    warnings.simplefilter("ignore")
    with tempfile.TemporaryDirectory() as name:
        for kind, (paths, read, change) in sources(Path(name)).items():
            for path in paths:
                read(path)
            before, good, slowest = _memory(), 0, 0.0
            for _ in range(options.files):
                changed = change(rng, paths[rng.integers(len(paths))])
                start = time.process_time()
                try:
                    read(changed)
                    good += 1
                except jb.JaxbodyError as error:
                    bad += not error.code or len(str(error).splitlines()) > 12
                except Exception as error:  # what must not happen
                    bad += 1
                    print(f"{kind}: {type(error).__name__}: {error}\n{changed.read_text()}\n")
                slowest = max(slowest, time.process_time() - start)
            grown = _memory() - before
            bad += (slowest > SECONDS) + (grown > MEMORY)
            rows.append(
                f"| {kind} | {options.files} | {good} | {options.files - good} | "
                f"{1e3 * slowest:.0f} | {grown / 1e6:.0f} |"
            )
            print(rows[-1], flush=True)
    text = [
        "# Changed files\n",
        (
            f"`python tests/benchmarks/fuzzing.py --files {options.files} --seed {options.seed}`, "
            f"{datetime.date.today()},"
        ),
        f"jaxbody {jb.__version__}.",
        (
            f"Not read, and without a clear error: {bad}. Limits: {SECONDS:g} s a file, "
            f"{MEMORY / 1e6:g} MB.\n"
        ),
        "| kind | files | read | clear errors | slowest [ms] | memory [MB] |",
        "|---|---|---|---|---|---|",
        *rows,
    ]
    Path(__file__).with_suffix(".md").write_text("\n".join(text) + "\n")
    return bad > 0


def _memory() -> float:
    """The largest memory in use so far [bytes]."""
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss


if __name__ == "__main__":
    sys.exit(main())
