"""The list of workarounds for XLA is complete, and rows are selected and summed as by NumPy."""

import re
from pathlib import Path

import jax.numpy as jnp
import numpy as np
import pytest

from jaxbody.numerics import xla_workarounds
from jaxbody.numerics.xla_workarounds import FEW_RUNS, sums

PACKAGE = Path(xla_workarounds.__file__).parents[1]
HERE = "numerics/xla_workarounds.py"
OTHERS = {"core/jax_internals.py"}  # what leans on the inside of JAX


def listed():
    """{file: names} of the docstring."""
    places = {}
    for line in xla_workarounds.__doc__.split("\n\n")[2].splitlines():
        if not line.startswith(" "):
            names = places.setdefault(HERE if line == "In this file" else line, [])
        elif not line.startswith("     "):  # a row, not the rest of one
            names += re.split(r"  | \[", line.strip())[0].split(", ")
    return places


def test_what_is_listed_is_there():
    for file, names in listed().items():
        text = (PACKAGE / file).read_text()
        for name in names:
            assert (
                re.search(rf"(^|def |class ){re.escape(name)}\b", text, re.M) or f" {name} " in text
            ), f"{file} has no {name}"


def test_what_is_there_is_listed():
    files = {str(file.relative_to(PACKAGE)): file.read_text() for file in PACKAGE.rglob("*.py")}
    assert {
        file for file, text in files.items() if re.search("XLA|LAPACK|LLVM", text)
    } - OTHERS <= set(listed())


@pytest.mark.parametrize(
    "groups",
    [[[0, 1, 2], [], [4, 3]], [[4], [2], [3]], [[2 * i, 0] for i in range(FEW_RUNS)]],
    ids=["few runs", "one row each", "many"],
)
def test_rows_are_summed_by_groups(rng, groups):
    x = rng.normal(size=(2 * FEW_RUNS, 3))
    exact = [sum((x[i] for i in rows), np.zeros(3)) for rows in groups]
    np.testing.assert_allclose(sums(jnp.asarray(x), groups), exact, rtol=0, atol=1e-15)
