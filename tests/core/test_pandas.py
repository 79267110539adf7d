"""Results as tables of pandas: the numbers of the results, with units, for every class that has
labeled arrays."""

import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.results import Labeled

pytest.importorskip("pandas")
CAR = jb.presets.quarter_car(damping=1500.0)
TIMES = jnp.linspace(0.0, 1.0, 11)
ROAD = {"road": jb.Harmonic(frequency=1.5, translation=[0, 0, 0.01])}


@pytest.fixture(scope="module")
def lin():
    return jb.linearize(CAR, jb.equilibrium(CAR))


@pytest.mark.long
def test_a_motion_is_a_table_over_time():
    run = jb.simulate(CAR, TIMES, motion=ROAD, initial="rest")
    frame = run.to_pandas()
    assert frame.index.name == "time" and frame.attrs["units"]["time"] == "s"
    np.testing.assert_array_equal(frame.index, run.times)
    np.testing.assert_array_equal(frame["position[body, z]"], run.poses["body"].p[:, 2])
    np.testing.assert_array_equal(frame["force[suspension]"], run.forces["suspension"])
    assert (
        frame.attrs["units"]["force[suspension]"] == "N"
        and frame.attrs["units"]["quaternion[body, w]"] == ""
    )
    assert set(frame.attrs["units"]) == {"time", *frame.columns}


@pytest.mark.long
def test_a_batch_has_the_sample_in_its_index():
    cars = jax.tree.map(
        lambda *x: jnp.stack(x), *(jb.replace(CAR, {"body.mass": mass}) for mass in (300.0, 400.0))
    )
    lins = jax.vmap(lambda model: jb.modes(jb.linearize(model, model.reference)))(cars)
    frame = lins.to_pandas()
    assert frame.index.names == ["sample", "mode"] and frame.shape[0] == 4
    np.testing.assert_array_equal(frame["frequency"].loc[1], lins.frequency[1])


@pytest.mark.long
def test_responses_have_the_units_of_output_and_input(lin):
    inputs, outputs = (
        {"road": jb.BaseMotion("road", "z")},
        {"seat": jb.Acceleration("body", axis="z"), "load": jb.sensors.LoadCell("tyre")},
    )
    response = jb.frequency_response(lin, np.geomspace(0.1, 10, 5), inputs, outputs)
    frame = response.to_pandas()
    np.testing.assert_array_equal(frame["response[load, road]"], response["load", "road"])
    assert (
        frame.attrs["units"]["response[load, road]"] == response.unit("load", "road")
        and frame.attrs["units"]["frequency"] == "Hz"
    )
    ride = jb.random_response(
        lin,
        jb.vibration.Band(0.1, 10.0),
        inputs,
        outputs,
        {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)},
    )
    frame = ride.to_pandas()
    np.testing.assert_array_equal(frame["psd[seat]"], ride.psd[0])
    assert frame.attrs["units"]["psd[seat]"] == "(m/s2)^2/Hz"
    by_output = ride.to_pandas("output")
    assert by_output.loc["load", "rms"] == float(ride["load"]) and "psd[0.1]" in by_output


@pytest.mark.long
def test_modes_energies_matrices_and_cases_are_tables(lin):
    modes, energies = jb.modes(lin), jb.vibration.mode_energies(lin)
    frame = modes.to_pandas()
    np.testing.assert_array_equal(frame["frequency"], modes.frequency)
    np.testing.assert_array_equal(frame.filter(like="shape"), modes.shapes.T)
    assert list(frame.index) == [1, 2] and frame.attrs["units"]["frequency"] == "Hz"
    assert energies.to_pandas().filter(like="kinetic").shape == (
        2,
        energies.kinetic_shares.size // 2,
    )
    matrices = lin.to_pandas()
    np.testing.assert_array_equal(matrices.filter(like="K[").iloc[:, :2], lin.K)
    cases = jb.load_cases(CAR, {"bump": jb.LoadCase(acceleration=[0, 0, 3])}).to_pandas()
    assert cases.index.name == "case" and cases.attrs["units"]["displacement[body, z]"] == "m"
    rest = jb.equilibrium(CAR)
    assert rest.to_pandas("spring").loc["tyre", "elongation"] == float(rest.elongations["tyre"])


def test_a_record_is_a_table_over_time():
    record = jb.Record(
        [0.0, 0.1, 0.2], {"acc": (np.arange(9.0).reshape(3, 3), "g"), "x": ([1.0, 2.0, 4.0], "mm")}
    )
    frame = record.to_pandas()
    assert frame["x"].tolist() == record["x"].tolist() and frame.attrs["units"] == {
        "time": "s", "x": "m", **{f"acc[{i}]": "m/s2" for i in range(3)},
    }  # fmt: skip
    np.testing.assert_array_equal(frame.filter(like="acc"), record["acc"])
    assert record.to_xarray()["x"].attrs["units"] == "m"


def test_an_unknown_dimension_is_named(lin):
    with pytest.raises(jb.JaxbodyError, match=r"Modes.to_pandas: 'time' is unknown. .*mode"):
        jb.modes(lin).to_pandas("time")


def test_every_class_with_labeled_arrays_has_its_dimension():
    def below(kind):
        return {x for sub in kind.__subclasses__() for x in {sub, *below(sub)}}

    for home in [jb, *(getattr(jb, family) for family in jb._MODULES)]:
        [getattr(home, name) for name in dir(home)]
    classes = {
        kind
        for kind in below(Labeled)
        if kind.__module__.startswith("jaxbody.") and not inspect.isabstract(kind)
    }
    assert len(classes) >= 15 and all(isinstance(kind.index, str) for kind in classes)
