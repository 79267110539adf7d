"""The speed of jaxbody compared with a hand-written C++ program and other programs, on two jobs:
`python tests/benchmarks/run.py`.

Prints one table for each job (plate.py, three.py): medians, ratios to C of medians measured in turn
in one process, and errors; then the time to a first result in a new process and the compile time.
Needs g++. Includes MuJoCo, Exudyn and SciPy if they are installed.

    --rounds N           how often each function is timed (default 13; slow functions 3 times)
    --job NAME           only this job: plate or three
    --only TEXT          only tasks whose name begins with TEXT, such as "T4"
    --no-peers           C only
    --write              put the tables into the manual's page of speed, between its two marks

All tasks call the public functions on a Model, inside a jitted function of the stiffnesses.
"""

import argparse
import datetime
import importlib.metadata
import json
import os
import platform
import statistics
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

import measured
from measured import LIMITS, MEASURED_AGAINST

JOBS = {"plate": "a plate on 5 springs", "three": "three bodies on 14 springs"}
TARGETS = {"T1": 1.8, "T2": 3, "T3": 3, "T4": 1.5}  # ratios to C
STARTS = {"motion": 1.5, "frequencies": 1.5}  # seconds to a first result
STARTS |= {
    f"{what} in {jit}": seconds
    for jit in ("jit", "jb.jit")
    for what, seconds in (("motion", 1.5), ("gradient", 4.0))
}
IMPORTS = "imports"
COMPILATION = 1.2  # ratio of times for twenty times the springs
WORDS = {
    "T1": "10 s of motion",
    "T2": "its gradient",
    "T3": "1000 x 1 s",
    "T4": "10000 x frequencies",
}
PAGE = Path(__file__).parents[2] / "examples" / "docs" / "measured" / "speed.md"
MARKS = (
    "<!-- benchmarks: written by tests/benchmarks/run.py --write -->",
    "<!-- end of benchmarks -->",
)


def child(*arguments: str) -> dict:
    """What this program prints when it is run with these arguments."""
    done = subprocess.run(
        [sys.executable, __file__, *arguments], stdout=subprocess.PIPE, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def show(result: dict) -> None:
    for name, ms in result["times"].items():
        ratio, target = ms / result["times"][MEASURED_AGAINST[name[:2]]], TARGETS.get(name, "")
        first = f"{result['first'][name]:13.2f}" if name in result["first"] else ""
        print(
            f"  {name:22s} {ms:9.3f} {ratio:11.2f} {target:>7} {result['errors'][name]:9.1e} "
            f"{LIMITS[name[:2]]:8.0e} {first}"
        )
    for word in result["skipped"]:
        print(f"  skipped: {word}")


def main(chosen: argparse.Namespace) -> None:
    print(machine() + "\n")
    results: dict[str, dict] = {}
    for job in [chosen.job] if chosen.job else JOBS:
        print(
            f"{JOBS[job]}\n{'task':24s} {'ms':>9s} {'ratio to C':>11s} {'target':>7s} "
            f"{'error':>9s} {'allowed':>8s} {'first call s':>13s}"
        )
        arguments = [
            "--measure",
            "--job",
            job,
            "--rounds",
            str(chosen.rounds),
            "--only",
            chosen.only,
        ]
        results[job] = child(*arguments, *["--no-peers"] * chosen.no_peers)
        show(results[job])
    if chosen.only:
        return
    starts = {job: starts_of(job) for job in results}
    if chosen.write and len(results) == len(JOBS):
        write(results, starts)


def starts_of(job: str, rounds: int = 3) -> dict[str, float]:
    """First results of fresh processes and compile times, printed; medians of rounds in turn, and
    of the imports before them."""
    print(
        f"\n{JOBS[job]}: first result in a fresh process, seconds after the imports of "
        "jax and diffrax (T5)"
    )
    spent: dict[str, list[float]] = {}
    for _ in range(rounds):
        for what in STARTS:
            result = child("--start", what, "--job", job)
            spent.setdefault(what, []).append(result["seconds"])
            spent.setdefault(IMPORTS, []).append(result["imports"])
    starts = {what: statistics.median(seconds) for what, seconds in spent.items()}
    for what, seconds in starts.items():
        print(
            f"  {what:22s} {seconds:9.2f}   "
            + (f"target {STARTS[what]}" if what != IMPORTS else "before them")
        )
    print("tracing and compiling, seconds")
    compiling = child("--compilation", "--job", job)
    for name in ("T1", "T4", "slope"):
        few, many = compiling[f"{name} 1"], compiling[f"{name} 20"]
        print(
            f"  {name:8s} {few:6.2f}   20 times the springs {many:6.2f}   ratio "
            f"{many / few:5.2f}   target {COMPILATION}"
        )
    return starts


def markdown(results: dict[str, dict], starts: dict[str, dict[str, float]]) -> str:
    """The tables that the manual shows."""
    shown = (
        f"{machine()}; {datetime.date.today().isoformat()}. Median times in milliseconds; in "
        "parentheses the ratio to C and the error."
    )
    lines = [shown, ""]
    for job, result in results.items():
        peers = [
            peer
            for peer in dict.fromkeys(n[3:] for n in result["times"])
            if peer[:2] not in ("", "C ")
        ]
        rows: dict[str, Callable[[str], str]] = {
            "C": lambda task: MEASURED_AGAINST[task],
            "jaxbody": str,
        }
        rows |= {peer: lambda task, peer=peer: f"{task} {peer}" for peer in peers}
        lines += [
            f"| {JOBS[job]} | " + " | ".join(WORDS.values()) + " |",
            "|---|" + "---|" * len(WORDS),
        ]
        for label, name_of in rows.items():
            cells = []
            for task in WORDS:
                name = name_of(task)
                if name not in result["times"]:
                    cells.append("-")
                    continue
                ms = result["times"][name]
                ratio = ms / result["times"][MEASURED_AGAINST[task]]
                cells.append(f"{ms:.3g} ({ratio:.2g}; {result['errors'][name]:.0e})")
            lines.append(f"| {label} | " + " | ".join(cells) + " |")
        first = starts[job]
        ours = f"{first['motion in jb.jit']:.1f} and {first['gradient in jb.jit']:.1f} s"
        lines += [
            "",
            (
                "First result of a new process, after the imports of jax and diffrax "
                f"({first[IMPORTS]:.1f} s): motion {first['motion']:.1f} s, frequencies "
                f"{first['frequencies']:.1f} s; inside `jax.jit` motion "
                f"{first['motion in jit']:.1f} s, "
                f"gradient {first['gradient in jit']:.1f} s, inside `jb.jit` {ours}."
            ),
            "",
        ]
    return "\n".join(lines).rstrip()


def write(results, starts) -> None:
    """Between the marks of the page."""
    text = PAGE.read_text()
    before, _, rest = text.partition(MARKS[0])
    _, _, after = rest.partition(MARKS[1])
    PAGE.write_text(f"{before}{MARKS[0]}\n{markdown(results, starts)}\n{MARKS[1]}{after}")


def machine() -> str:
    names = [
        line.split(":")[1].strip()
        for line in Path("/proc/cpuinfo").read_text().splitlines()
        if line.startswith("model name")
    ]
    versions = []
    for name in ("jax", "jaxlib", "diffrax", "equinox", "numpy", "mujoco", "exudyn", "scipy"):
        try:
            versions.append(f"{name} {importlib.metadata.version(name)}")
        except importlib.metadata.PackageNotFoundError:
            continue
    return (
        f"{names[0] if names else platform.processor()}, {os.cpu_count()} cores; Python "
        f"{platform.python_version()}, {' '.join(versions)}"
    )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--rounds", type=int, default=13)
    parser.add_argument("--job", choices=JOBS)
    parser.add_argument("--only", default="")
    for name in ("no-peers", "write"):
        parser.add_argument(f"--{name}", action="store_true")
    for name in ("measure", "compilation"):
        parser.add_argument(f"--{name}", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--start", choices=STARTS, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.measure:
        print(
            json.dumps(
                measured.measure(
                    measured.job_of(chosen.job), chosen.rounds, chosen.only, not chosen.no_peers
                )
            )
        )
    elif chosen.start:
        print(json.dumps(measured.start(measured.job_of(chosen.job), chosen.start)))
    elif chosen.compilation:
        print(json.dumps(measured.compilation(measured.job_of(chosen.job))))
    else:
        main(chosen)
