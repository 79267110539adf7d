"""The folder of the measured and reference data: JAXBODY_DATA, or ../shared/data next to
the checkout."""

import os
from pathlib import Path

import numpy as np
import pytest

BESIDE = Path(__file__).parents[2] / "shared" / "data"


def data(*parts):
    """The path of a file of data; where it is not to be had, the test is skipped and says so."""
    folder = Path(os.environ.get("JAXBODY_DATA", BESIDE))
    path = folder.joinpath(*parts)
    if not path.exists():
        pytest.skip(
            f"no {'/'.join(parts)} in {folder}; set JAXBODY_DATA to the folder of reference data"
        )
    return path


def columns(*parts, header=0):
    """The numbers in a file of data, one array a column."""
    return np.loadtxt(data(*parts), skiprows=header, unpack=True)
