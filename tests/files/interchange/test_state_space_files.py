"""A state space in a MATLAB file: NumPy's response of what is in it, against jaxbody's."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.io

import jaxbody as jb

ROAD = {"road": jb.BaseMotion("road", "z", kind="acceleration")}
SEAT = {"seat": jb.Acceleration("body", axis="z"), "stroke": jb.Elongation("suspension")}


@pytest.fixture(scope="module")
def lin():
    car = jb.presets.quarter_car(damping=1500.0)
    return jb.linearize(car, jb.equilibrium(car))


@pytest.mark.long
def test_another_program_finds_the_same_response(lin, tmp_path):
    jb.files.write_state_space(lin.state_space(ROAD, SEAT), tmp_path / "plant.mat")
    plant = scipy.io.loadmat(tmp_path / "plant.mat", simplify_cells=True)
    assert [plant[name] for name in ("inputs", "input_units")] == ["road", "m/s2"]
    assert list(plant["outputs"]) == ["seat", "stroke"] and list(plant["output_units"]) == [
        "m/s2",
        "m",
    ]
    assert len(plant["states"]) == len(plant["A"])
    f = np.geomspace(0.3, 30, 40)
    response = jb.frequency_response(lin, f, ROAD, SEAT)
    A, B, C, D = plant["A"], plant["B"][:, None], plant["C"], plant["D"][:, None]
    values = np.array([C @ np.linalg.solve(2j * np.pi * x * np.eye(len(A)) - A, B) + D for x in f])[
        :, :, 0
    ]
    for i, name in enumerate(SEAT):
        # A is conditioned to 1e6
        np.testing.assert_allclose(values[:, i], response[name, "road"], rtol=1e-9)


def test_what_cannot_be_written_is_said(lin, tmp_path):
    system = lin.state_space(ROAD, SEAT)
    for given, path, code in (
        (system, "plant.txt", "UNKNOWN_FORMAT"),
        (system, "none/plant.mat", "NOT_SAVED"),
        (jax.tree.map(lambda x: jnp.stack([x, x]), system), "plant.mat", "BAD_SHAPE"),
    ):
        with pytest.raises(jb.JaxbodyError) as error:
            jb.files.write_state_space(given, tmp_path / path)
        assert error.value.code == code
