"""Printed tables: a blank line between them, all rows up to a stated limit, SI units."""

import contextlib
import io

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core import tables


@pytest.fixture(scope="module")
def mass():
    spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=1000.0, free_length=1.0)
    joints = {"mass": jb.Guide("world", axis=[0, 0, 1])}
    return jb.Model(
        bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        joints=joints,
        elements={"s": spring},
        gravity=[0, 0, -9.81],
    )


def printed(*results):
    out = io.StringIO()
    with contextlib.redirect_stdout(out):
        for result in results:
            print(result)
    return out.getvalue()


def test_results_printed_together_have_a_blank_line_between_and_none_before(mass):
    eq = jb.equilibrium(mass)
    lin = jb.linearize(mass, eq)
    lines = [line.strip() for line in ["", *printed(mass, eq, lin).splitlines()]]
    assert lines[1].startswith("Model")
    for title in (
        "Model",
        "Equilibrium",
        "M [kg, kg m, kg m2]",
        "C [N s/m, ...]",
        "K [N/m, N, N m]",
    ):
        (at,) = [i for i, line in enumerate(lines) if line.startswith(title)]
        assert lines[at - 1] == "" and lines[at + 1] != ""
    assert repr(eq) == str(eq).strip()


@pytest.mark.long
def test_a_table_shows_sixty_load_cases_whole_and_in_meters(mass):
    """u = f / k of each, to a thousandth of a millimeter."""
    force = np.arange(1.0, 61.0)
    cases = {
        f"pull {f:g}": jb.LoadCase(loads={"pull": jb.Force("mass", force=[0, 0, f])}) for f in force
    }
    shown = printed(jb.load_cases(mass, cases))
    assert "more" not in shown and "[m]" in shown and "[rad]" in shown and "mm" not in shown
    for name, f in zip(cases, force, strict=True):
        (row,) = [line for line in shown.splitlines() if line.strip().startswith(f"{name} ")]
        assert f"{f / 1000:.6f}" in row.split()


def test_rows_left_out_are_counted_and_the_note_says_where_they_are():
    table = tables.PrintedTable("Long", ("number",), [(i,) for i in range(tables.MOST_ROWS + 7)])
    for shown in (tables.text(table), tables.html(table)):
        assert (
            f"... 7 more of {tables.MOST_ROWS + 7} rows; the result's attributes have all of them"
            in shown
        )


@pytest.mark.long
def test_no_table_states_thousandths_of_units(mass):
    backbones = jb.vibration.backbone_curves(jb.linearize(mass, jb.equilibrium(mass)))
    assert jnp.isfinite(backbones.frequency).all()
    assert not {"mm", "mrad"} & set(printed(backbones).split())
