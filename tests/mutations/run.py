"""Plant one bug at a time in a copy of the package, and see that the tests named for it fail.

    python tests/mutations/run.py [names of bugs or tables ...] [--jobs 2] [--check] [--write]

Each bug is in a table of `tests/mutations/bugs`: the file, its old text, which occurs once, the new
text, what is wrong, and the tests that fail with it, which are those of CI. Without names all are
run. `--check` only looks whether each old text occurs once and each new file is Python; `--write`
writes into `results.md` what came of these. The checkout is only read: the tests import a copy of
the package.
"""

from __future__ import annotations

import argparse
import ast
import datetime
import os
import platform
import shutil
import subprocess
import sys
import tempfile
import time
import tomllib
import xml.etree.ElementTree as ET
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
PACKAGE = ROOT / "jaxbody"
RESULTS = HERE / "results.md"
LONGEST = 900  # seconds for the tests of one bug
IMPORTED = """
import pathlib, sys
import jaxbody
assert pathlib.Path(jaxbody.__file__).is_relative_to(sys.argv[1]), jaxbody.__file__
import pytest
sys.exit(pytest.main(sys.argv[2:]))
"""


@dataclass(frozen=True)
class Bug:
    """A planted bug; `file` is in the package, `tests` are files or node ids in tests/."""

    group: str
    name: str
    file: str
    old: str
    new: str
    wrong: str
    tests: tuple[str, ...]

    def planted(self) -> str:
        """The text of the file with the bug. Error: ValueError where the old text does not
        occur once."""
        text = (PACKAGE / self.file).read_text()
        if (times := text.count(self.old)) != 1:
            raise ValueError(f"{self.name}: the old text occurs {times} times in {self.file}")
        return text.replace(self.old, self.new)


def bugs() -> list[Bug]:
    """All of them, by group and in the order of their tables."""
    found = []
    for path in sorted((HERE / "bugs").glob("*.toml")):
        for name, row in tomllib.loads(path.read_text()).items():
            found.append(Bug(path.stem, name, **row | {"tests": tuple(row["tests"])}))
    return found


def check(chosen: list[Bug]) -> list[str]:
    """What is wrong with the tables."""
    problems = []
    for bug in chosen:
        try:
            ast.parse(bug.planted())
        except (ValueError, SyntaxError) as error:
            problems.append(f"{bug.name}: {error}")
        if bug.old == bug.new or not bug.tests:
            problems.append(f"{bug.name}: changes nothing, or names no test")
        for test in bug.tests:
            path, _, function = test.partition("::")
            file, name = ROOT / "tests" / path, function.partition("[")[0]
            if not file.exists() or (name and f"def {name}(" not in file.read_text()):
                problems.append(f"{bug.name}: there is no tests/{test}")
    names = [bug.name for bug in chosen]
    return problems + [
        f"{name}: named twice" for name in sorted({name for name in names if names.count(name) > 1})
    ]


def run(bug: Bug, programs: str) -> tuple[str, str, float]:
    """What became of it ("killed", "SURVIVED" or why nothing is known), the test that failed, and
    the seconds that took."""
    begin = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="jaxbody-bug-") as folder:
        copy, report = Path(folder) / "jaxbody", Path(folder) / "report.xml"
        shutil.copytree(PACKAGE, copy)
        (copy / bug.file).write_text(bug.planted())
        for compiled in (copy / bug.file).parent.glob(f"__pycache__/{Path(bug.file).stem}.*"):
            compiled.unlink()  # it may have the size and the second of the new file
        names = [str(ROOT / "tests" / test) for test in bug.tests]
        options = [
            "-n",
            "0",
            "-x",
            "-p",
            "no:cacheprovider",
            "--tb=no",
            f"--junitxml={report}",
            f"--rootdir={ROOT}",
        ]
        variables = {
            "PYTHONPATH": folder,
            "JAX_COMPILATION_CACHE_DIR": programs,
            "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0",
        }
        variables |= {"JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES": "-1", "PYTEST_ADDOPTS": ""}
        command = [
            sys.executable,
            "-c",
            IMPORTED,
            folder,
            f"--config-file={ROOT / 'pyproject.toml'}",
            *options,
            *names,
        ]
        try:
            done = subprocess.run(
                command,
                cwd=folder,
                env=os.environ | variables,
                capture_output=True,
                text=True,
                timeout=LONGEST,
            )
        except subprocess.TimeoutExpired:
            return "NO END", "", time.monotonic() - begin
        failed = [
            case
            for case in (ET.parse(report).iter("testcase") if report.exists() else ())
            for outcome in (*case.iter("failure"), *case.iter("error"))
            if outcome.get("message") != "collection failure"
        ]
        seconds = time.monotonic() - begin
        if done.returncode == 0:
            return "SURVIVED", "", seconds
        if done.returncode == 1 and failed:
            where = failed[0].get("classname", "").rpartition("tests.")[2].replace(".", "/")
            return "killed", f"{where}.py::{failed[0].get('name')}", seconds
        return "NOT RUN", (done.stdout + done.stderr)[-2000:], seconds


def main() -> int:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("names", nargs="*", help="of bugs or of their tables")
    parser.add_argument("--jobs", type=int, default=1, help="bugs at a time")
    parser.add_argument("--check", action="store_true", help="only check the tables")
    parser.add_argument("--write", action="store_true", help="write results.md")
    asked = parser.parse_args()
    chosen = [bug for bug in bugs() if not asked.names or {bug.name, bug.group} & set(asked.names)]
    if unknown := set(asked.names) - {name for bug in chosen for name in (bug.name, bug.group)}:
        parser.error(f"there is no {', '.join(sorted(unknown))}")
    problems = check(chosen)
    if problems or asked.check:
        print(*problems, f"{len(chosen)} bugs, {len(problems)} problems", sep="\n")
        return int(bool(problems))
    rows, counts = {}, {"killed": 0}
    with (
        tempfile.TemporaryDirectory(prefix="jaxbody-programs-") as programs,
        ThreadPoolExecutor(asked.jobs) as pool,
    ):
        for bug, (outcome, test, seconds) in zip(
            chosen, pool.map(lambda bug: run(bug, programs), chosen), strict=True
        ):
            counts[outcome] = counts.get(outcome, 0) + 1
            rows[bug.name] = test if outcome == "killed" else outcome
            print(
                f"{bug.group:10} {bug.name:40} {outcome:8} {seconds:5.0f} s  {test or bug.wrong}",
                flush=True,
            )
    print(f"{len(rows)} bugs: " + ", ".join(f"{n} {outcome}" for outcome, n in counts.items()))
    if asked.write:
        RESULTS.write_text(page(written() | rows))
    return int(counts["killed"] < len(rows))


def written() -> dict[str, str]:
    """{bug: the test that killed it} of the page as it is."""
    cells = (
        [line.split(" | ") for line in RESULTS.read_text().splitlines()] if RESULTS.exists() else []
    )
    return {row[0].removeprefix("| "): row[-1].removesuffix(" |") for row in cells if len(row) == 4}


def page(found: dict[str, str]) -> str:
    """The results of all bugs of the tables that were run."""
    known = [bug for bug in bugs() if bug.name in found]
    killed = sum("::" in found[bug.name] for bug in known)
    versions = ", ".join(
        f"{name} {metadata.version(name)}"
        for name in ("jax", "diffrax", "equinox", "numpy", "scipy")
    )
    lines = [
        "# Planted bugs",
        "",
        (
            f"By `tests/mutations/run.py --write`, {datetime.date.today()}, Python "
            f"{platform.python_version()}, {versions}:"
        ),
        (
            f"{len(known)} bugs, {killed} killed. Each is planted alone in a copy of the package; "
            "the test is the first that fails of"
        ),
        "those that its table names, which CI runs with every commit.",
        "",
        "| bug | in | what is wrong | killed by |",
        "|---|---|---|---|",
    ]
    lines += [
        f"| {bug.name} | {bug.file} | {bug.wrong.replace('|', '&#124;')} | {found[bug.name]} |"
        for bug in known
    ]
    return "\n".join(lines) + "\n"


if __name__ == "__main__":
    sys.exit(main())
