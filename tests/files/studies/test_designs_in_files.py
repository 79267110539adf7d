"""Designs in files: each kind of quantity as in Python, units of limits and bounds, problems with
their lines."""

import re
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.files.model_files import toml_of, values_of
from jaxbody.files.studies.design_builders import QUANTITIES

DESIGN = """
[sensors]
seat = {type = "Acceleration", on = "body", axis = "z"}
travel = {type = "Elongation", on = "suspension"}
load = {type = "LoadCell", on = "tyre"}

[designs.ride]
free = ["suspension.stiffness", "suspension.damping"]
minimize = "comfort"
limits = {travel = ["-inf", "5 cm"], load = ["0 kN", "1.2 kN"], k = "30 N/mm", first = ["60 1/min", "2 Hz"], zeta = [0.2, 0.4]}
bounds = {"*.stiffness" = ["10 N/mm", "0.4 kN/mm"]}
catalogues = {"suspension.damping" = "1, 2, 3 N s/mm"}
starts = 2
roads.road = {class = "C", speed = "72 km/h"}
band = "0.2, 50 Hz"

[designs.ride.quantities]
comfort = {type = "comfort", weights = {seat = "Wk"}}
travel = {type = "stroke", sensor = "travel"}
load = {type = "rms", sensor = "load"}
k = {type = "value", path = "suspension.stiffness"}
first = {type = "frequency", mode = 1}
zeta = {type = "damping_ratio", mode = 1}
sag = {type = "deflection", on = "suspension"}
coupled = {type = "coupling_of_modes"}
idle = {type = "band_intrusion", band = "8, 10 Hz"}
"""  # noqa: E501


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "car.toml"
    path.write_text(toml_of(values_of(jb.presets.quarter_car(damping=1500.0))) + DESIGN)
    return path


@pytest.mark.long
def test_a_design_is_what_tune_takes(file):
    study = jb.read_study(file)
    design = dict(study.designs["ride"])
    car, found = study.model, design.pop("evaluate")(study.model)
    lin = jb.linearize(car, jb.equilibrium(car))
    outputs = {
        "seat": jb.Acceleration("body", axis="z"),
        "travel": jb.Elongation("suspension"),
        "load": jb.sensors.LoadCell("tyre"),
    }
    spectra = {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)}
    ride = jb.random_response(
        lin, jb.vibration.Band(0.2, 50.0), {"road": jb.BaseMotion("road", "z")}, outputs, spectra
    )
    frequencies = jb.modes(lin).frequency
    expected = {
        "comfort": jb.objectives.comfort(ride, {"seat": "Wk"}),
        "travel": 3 * ride["travel"],
        "load": ride["load"],
        "k": car["suspension"].stiffness,
        "first": frequencies[0],
        "zeta": jb.complex_modes(lin).damping_ratio[0],
        "sag": jb.equilibrium(car).elongations["suspension"],
        "coupled": jb.objectives.coupling_of_modes(lin),
        "idle": jnp.sum(jnp.maximum(0.0, 1 - (frequencies - 9.0) ** 2) ** 2),
    }
    assert len(expected) == len(QUANTITIES) and found.keys() == expected.keys()
    for name, value in expected.items():
        # sums over different outputs
        np.testing.assert_allclose(found[name], value, rtol=1e-9, atol=1e-12, err_msg=name)
    assert design.pop("limits") == {
        "travel": (-np.inf, 0.05),
        "load": (0.0, 1200.0),
        "k": 3e4,
        "first": (1.0, 2.0),
        "zeta": (0.2, 0.4),
    }
    assert design.pop("bounds") == {"*.stiffness": (1e4, 4e5)} and design.pop("catalogues") == {
        "suspension.damping": [1e3, 2e3, 3e3]
    }
    assert design == {
        "free": ["suspension.stiffness", "suspension.damping"],
        "minimize": "comfort",
        "starts": 2,
    }


@pytest.mark.parametrize(
    "old, new, message",
    [
        (
            'minimize = "comfort"',
            'minimize = "comfrt"',
            "designs.ride.minimize: 'comfrt' is unknown. Did you mean 'comfort'?",
        ),
        (
            "limits = {travel",
            "limits = {travl",
            "designs.ride.limits.travl: 'travl' is unknown. Did you mean 'travel'?",
        ),
        (
            '"5 cm"',
            '"5 N"',
            "designs.ride.limits.travel: is '5 N', in N (allowed: a unit such as m)",
        ),
        ('"30 N/mm"', '"30 N"', "designs.ride.limits.k: is '30 N', in N"),
        ('"10 N/mm"', '"10 mm"', "designs.ride.bounds.'*.stiffness': is '10 mm'"),
        (
            '{"*.stiffness"',
            '{"*.stifness"',
            "designs.ride.bounds.'*.stifness': '*.stifness' matches nothing",
        ),
        (
            "roads.road",
            "roads.rood",
            "designs.ride.roads.rood: 'rood' is unknown. Did you mean 'road'?",
        ),
        (
            'roads.road = {class = "C", speed = "72 km/h"}',
            "",
            "designs.ride.quantities.comfort: is a quantity of a ride",
        ),
        ('class = "C"', 'class = "K"', "designs.ride.roads.road.class: 'K' is unknown"),
        (
            'seat = "Wk"',
            'seet = "Wk"',
            "designs.ride.quantities.comfort.weights.seet: 'seet' is unknown",
        ),
        (
            'sensor = "load"',
            'sensor = "lode"',
            "designs.ride.quantities.load.sensor: sensor 'lode' is unknown. Did you mean 'load'?",
        ),
        ('"frequency", mode = 1', '"frequency"', "designs.ride.quantities.first: has no 'mode'"),
        (
            '"frequency", mode = 1',
            '"frequency", mode = 3',
            "designs.ride.quantities.first.mode: is 3 (allowed: 1 to 2)",
        ),
        (
            '"frequency"',
            '"os:system"',
            "designs.ride.quantities.first.type: names the module 'os' (allowed: [])",
        ),
        ("starts = 2", "key = -1", "designs.ride.key: is -1 (allowed: 0 to 4294967295)"),
        (
            '"frequency"',
            '"frequence"',
            "designs.ride.quantities.first.type: 'frequence' is unknown",
        ),
        (
            'path = "suspension.stiffness"',
            'path = "suspension.stif"',
            "designs.ride.quantities.k.path: 'suspension.stif' matches nothing",
        ),
    ],
)
def test_problems_of_designs_are_reported_with_their_line(old, new, message, file):
    text = file.read_text()
    line = 1 + next(i for i, row in enumerate(text.splitlines()) if old in row)
    file.write_text(text.replace(old, new, 1))
    with pytest.raises(jb.JaxbodyError) as error:
        jb.read_study(file)
    assert message in str(error.value)
    assert new == "" or f"car.toml:{line} {message}" in str(error.value)


OWN = """
import subprocess

import jaxbody as jb


def steel(model, density, *, factor=2.0):
    return factor * density * model["suspension"].stiffness


def second(model):
    return jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[1]


NUMBER = 3.0
run = subprocess.run
"""
OF_OWN = """
[designs.light]
free = ["suspension.stiffness", "tyre.stiffness"]
minimize = "steel"
limits = {second = ["11 Hz", inf], first = ["66 1/min", inf]}
bounds = {"*.stiffness" = ["10 N/mm", "0.4 kN/mm"]}
starts = 3
key = 5
[designs.light.quantities]
steel = {type = "my_costs:steel", unit = "kg", density = 2e-3}
second = {type = "my_costs:second", unit = "1/min"}
first = {type = "frequency", mode = 1}
"""


@pytest.fixture
def own(tmp_path, monkeypatch):
    (tmp_path / "my_costs.py").write_text(OWN)
    monkeypatch.syspath_prepend(tmp_path)
    path = tmp_path / "own.toml"
    path.write_text(toml_of(values_of(jb.presets.quarter_car(damping=1500.0))) + OF_OWN)
    yield path
    sys.modules.pop("my_costs", None)


@pytest.mark.long
def test_functions_of_allowed_modules_are_quantities(own, capsys, monkeypatch):
    from jaxbody.app import commands

    study = jb.read_study(own, allow=["my_costs"])
    design = study.designs["light"]
    assert design["limits"] == {"second": (11.0, np.inf), "first": (1.1, np.inf)}
    assert design["starts"] == 3 and jnp.array_equal(
        jax.random.key_data(design["key"]), jax.random.key_data(jax.random.key(5))
    )

    def quantities(model):
        frequency = jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency
        return {
            "steel": 4e-3 * model["suspension"].stiffness,
            "second": frequency[1],
            "first": frequency[0],
        }

    options = {name: value for name, value in design.items() if name != "evaluate"}
    expected = jb.tune(study.model, quantities, **options)
    found = jb.tune(study.model, **design)
    np.testing.assert_allclose(
        found.values["suspension.stiffness"], expected.values["suspension.stiffness"], rtol=1e-6
    )
    assert found.active == expected.active == ("first >= 1.1", "tyre.stiffness <= 400000")
    monkeypatch.chdir(own.parent)
    assert (
        commands.main(["tune", "own.toml", "--allow", "my_costs"]) == 0
        and str(found) in capsys.readouterr().out
    )
    assert (
        commands.main(["tune", "own.toml"]) == 2 and "allow=['my_costs']" in capsys.readouterr().err
    )


@pytest.mark.parametrize(
    "old, new, message",
    [
        (
            "my_costs:steel",
            "my_costs:stell",
            "steel.type: names 'my_costs:stell', and the module has no 'stell'",
        ),
        (
            "my_costs:steel",
            "my_costs:NUMBER",
            "steel.type: names 'my_costs:NUMBER', which is no function of that module",
        ),
        (
            "my_costs:steel",
            "my_costs:run",
            "steel.type: names 'my_costs:run', which is no function of that module",
        ),
        (
            "my_costs:steel",
            "my_costs:jb.Body",
            "steel.type: names 'my_costs:jb.Body', and the module has no 'jb.Body'",
        ),
        (
            "my_costs:steel",
            "subprocess:run",
            "steel.type: names the module 'subprocess' (allowed: ['my_costs'])",
        ),
        (
            "density = 2e-3",
            "densty = 2e-3",
            "steel.densty: 'densty' is unknown. Did you mean 'density'?",
        ),
        (", density = 2e-3", "", "steel: has no 'density'"),
        ('unit = "kg"', 'unit = "EUR"', "steel.unit: unit 'EUR' is unknown"),
        ('"1/min"}', '"mm"}', "limits.second: is '11 Hz', in 1/s (allowed: a unit such as m)"),
    ],
)
def test_problems_of_own_quantities_are_reported_with_their_line(old, new, message, own):
    text = own.read_text()
    assert old in text
    own.write_text(text.replace(old, new, 1))
    with pytest.raises(jb.JaxbodyError) as error:
        jb.read_study(own, allow=["my_costs"])
    where = "designs.light." + ("" if message.startswith("limits") else "quantities.")
    assert re.search(rf"own.toml:\d+ {re.escape(where + message)}", str(error.value)), str(
        error.value
    )


def test_no_module_is_imported_that_is_not_allowed(own):
    with pytest.raises(jb.JaxbodyError, match="NOT_ALLOWED"):
        jb.read_study(own)
    assert "my_costs" not in sys.modules
