"""The bank of planted bugs fits the package as it is, and its script tells apart what a bug
comes to."""

import runpy
import subprocess
import sys
from pathlib import Path

import pytest

SCRIPT = Path(__file__).with_name("run.py")


def test_every_bug_can_be_planted():
    done = subprocess.run(
        [sys.executable, str(SCRIPT), "--check"], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.long
@pytest.mark.parametrize(
    "old, new, outcome",
    [
        (
            "        return 0.5 * self.stiffness * e**2",
            "        return 0.7 * self.stiffness * e**2",
            "killed",
        ),
        (
            "        return 0.5 * self.stiffness * e**2",
            "        return self.stiffness * e**2 / 2",
            "SURVIVED",
        ),
        ("class Spring(LineElement):", "class Spring(NoElement):", "NOT RUN"),
    ],
)
def test_a_bug_is_killed_by_a_test_that_fails_and_not_by_one_that_cannot_run(
    old, new, outcome, tmp_path
):
    """Nor by a change without effect."""
    script = runpy.run_path(str(SCRIPT))
    test = "model/elements/test_elements.py::test_the_wrenches_are_those_of_the_definition"
    found = script["run"](
        script["Bug"]("elements", "one", "model/elements/springs.py", old, new, "", (test,)),
        str(tmp_path),
    )
    assert found[0] == outcome, found
