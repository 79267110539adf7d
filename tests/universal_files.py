"""Functions of universal files for tests."""

import numpy as np


def uff_set(**fields):
    """A set 58 with all that the package wants to have."""
    exponents = {
        f"{axis}_{of}_unit_exp": 0
        for axis in ("abscissa", "ordinate", "orddenom", "z_axis")
        for of in ("len", "force", "temp")
    }
    labels = {
        f"{axis}_axis_units_lab": "NONE" for axis in ("abscissa", "ordinate", "orddenom", "z_axis")
    }
    kinds = {f"{axis}_spec_data_type": 0 for axis in ("ordinate", "orddenom", "z_axis")}
    where = {
        "rsp_node": 4,
        "rsp_ent_name": "NONE",
        "ref_node": 0,
        "ref_dir": 0,
        "ref_ent_name": "NONE",
        "ver_num": 0,
        "load_case_id": 0,
    }
    even = {
        "abscissa_spacing": 1,
        "abscissa_min": 0.0,
        "abscissa_inc": 1 / 200,
        "abscissa_spec_data_type": 17,
        "z_axis_value": 0.0,
        "x": np.arange(50) / 200,
    }
    common = {
        "type": 58,
        "binary": 0,
        "func_type": 1,
        "ord_data_type": 4,
        "num_pts": 50,
        **{f"id{i}": "NONE" for i in range(1, 6)},
    }
    return {**common, **exponents, **labels, **kinds, **where, **even, **fields}


def uff_text(
    rows,
    *,
    of=1,
    data_type=2,
    points,
    even=1,
    start=0.0,
    step=0.01,
    axis=17,
    axis_unit="s",
    unit="m/s2",
    below="NONE",
    name="run",
):
    """A set 58 at node 1 along Z as a program writes it, with all numbers of `rows`, whatever the
    heading says of their number."""
    axes = ((axis, axis_unit), (12, unit), (0 if below == "NONE" else 13, below), (0, "NONE"))
    lines = [
        "    -1", "    58", name, "NONE", "01-Jan-20 00:00:00", "NONE", "NONE",
        f"{of:5d}{0:10d}{0:5d}{0:10d} {'NONE':10s}{1:10d}{3:4d} {'NONE':10s}{1:10d}{3:4d}",
        f"{data_type:10d}{points:10d}{even:10d}{start:13.5E}{step:13.5E}{0:13.5E}",
        *(f"{kind:10d}{0:5d}{0:5d}{0:5d} {'axis':20s} {label:20s}" for kind, label in axes),
        *("".join(f"{x:13.5E}" for x in row) for row in rows), "    -1",
    ]  # fmt: skip
    return "\n".join(lines) + "\n"
