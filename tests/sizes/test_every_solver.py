"""Every solver that the pages name simulates and fits outside and inside a jit, in a vmap and in a
grad, and ends no process."""

import inspect
import re
from pathlib import Path

import diffrax
import pytest
from size_jobs import OUTSIDE_AND_INSIDE, SOLVERS, failures, jobs

import jaxbody as jb

PACKAGE = Path(jb.__file__).parent
ROOT = Path(__file__).parents[2]
PAGES = [
    ROOT / "README.md",
    *(ROOT / "examples").rglob("*.md"),
    *(ROOT / "examples").rglob("*.py"),
    *PACKAGE.rglob("*.py"),
]


def test_all_that_pages_and_docstrings_name_are_here():
    """With "diffrax." before a name that means something else, too."""
    public = {
        name
        for name, x in vars(diffrax).items()
        if inspect.isclass(x) and issubclass(x, diffrax.AbstractSolver)
    }
    concrete = {name for name in public if not name.startswith("Abstract")}
    words = "|".join(
        f"diffrax.{name}" if name in ("Euler", "Midpoint", "SEA") else name for name in concrete
    )
    named = {
        word.removeprefix("diffrax.")
        for page in PAGES
        for word in re.findall(rf"\b(?:{words})\b", page.read_text())
    }
    assert {"Dopri8", "Kvaerno5"} <= named <= set(SOLVERS)


@pytest.mark.long
@pytest.mark.parametrize("solver", SOLVERS)
def test_a_solver(solver):
    names = [
        *jobs(f"chain of 2 by {solver}", "simulate", OUTSIDE_AND_INSIDE),
        f"chain of 2 by {solver}: fit",
    ]
    names += [f"1 on bushings by {solver}: simulate", f"full_car by {solver}: simulate"]
    assert failures(names) == []


@pytest.mark.long
def test_a_fit_and_an_implicit_solver_in_all_ways():
    assert failures([*jobs("chain of 2", "fit"), *jobs("chain of 2 by Kvaerno5", "simulate")]) == []
