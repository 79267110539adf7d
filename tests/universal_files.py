"""Functions of universal files for tests."""

import numpy as np


def uff_set(**fields):
    """A set 58 with all that the package wants to have."""
    exponents = {f"{axis}_{of}_unit_exp": 0 for axis in ("abscissa", "ordinate", "orddenom", "z_axis") for of in ("len", "force", "temp")}
    labels = {f"{axis}_axis_units_lab": "NONE" for axis in ("abscissa", "ordinate", "orddenom", "z_axis")}
    kinds = {f"{axis}_spec_data_type": 0 for axis in ("ordinate", "orddenom", "z_axis")}
    where = {"rsp_node": 4, "rsp_ent_name": "NONE", "ref_node": 0, "ref_dir": 0, "ref_ent_name": "NONE", "ver_num": 0, "load_case_id": 0}
    even = {
        "abscissa_spacing": 1,
        "abscissa_min": 0.0,
        "abscissa_inc": 1 / 200,
        "abscissa_spec_data_type": 17,
        "z_axis_value": 0.0,
        "x": np.arange(50) / 200,
    }
    common = {"type": 58, "binary": 0, "func_type": 1, "ord_data_type": 4, "num_pts": 50, **{f"id{i}": "NONE" for i in range(1, 6)}}
    return {**common, **exponents, **labels, **kinds, **where, **even, **fields}
