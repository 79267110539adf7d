"""Controllers, drives and their sensors in model files: units, round trips, what is wrong and
where, the schema, updates."""

import json
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from file_schemas import schema
from loops_in_files import LOOPS, loops

import jaxbody as jb
from jaxbody.app.file_updates import update
from jaxbody.files.documents import read_document, set_value
from jaxbody.model.leaf_paths import leaves_of


class Damped(jb.control.ControlLaw):
    """A law of one's own, with a state."""

    gain: jax.Array = jb.field("N s/m", "positive")
    time: jax.Array = jb.field("s", "positive")
    states, state_units = ("filtered speed",), ("m/s",)

    def command(self, now):
        return -self.gain * now.z[0]

    def rates(self, now):
        return (now.readings["speed"] - now.z) / self.time


def written(folder, text=LOOPS):
    (path := folder / "loops.toml").write_text(text)
    return path


def test_numbers_of_loops_in_files_have_units(tmp_path):
    read, model = jb.read_study(written(tmp_path)), loops()
    assert jax.tree.structure(read.model) == jax.tree.structure(model)
    for leaf, other in zip(jax.tree.leaves(read.model), jax.tree.leaves(model), strict=True):
        # rounding of the conversions of units
        np.testing.assert_allclose(leaf, other, rtol=1e-15, atol=1e-18)
    assert read.sensors == {
        "asked": jb.sensors.DriveCommand("actuator"),
        "force": jb.sensors.DriveForce("damper"),
    }
    assert "controllers: ride, sky" in str(read)


SPEED = {"speed": jb.Velocity("wheel", axis="z")}
# JAX sorts readings by their names; gains are in the order of the controller
BOTH = {"z": jb.Position("body", axis="z"), "a": jb.Velocity("body", axis="z", bias=0.1)}
LAWS = {
    "state feedback": (BOTH, jb.control.state_feedback([[3.0, 4.0], [5.0, 6.0]], rest=[0.1, 0.2])),
    "with states": (
        BOTH,
        jb.control.LinearFeedback([[-1.0]], [[2.0, 3.0]], [[4.0], [5.0]]),
    ),
    "on-off": (SPEED, jb.control.on_off_skyhook()),
    "own": (SPEED, Damped(jnp.array(40.0), jnp.array(0.01))),
}


@pytest.mark.parametrize("name", LAWS)
@pytest.mark.parametrize("suffix", ["toml", "json"])
def test_controllers_are_the_same_again(name, suffix, tmp_path):
    reads, law = LAWS[name]
    drives = ["one", "two"][: 2 if reads is BOTH else 1]
    timing = {"every": 0.01, "delay": 0.004} if name == "state feedback" else {}
    reads = reads | {"a": jb.Velocity("body", axis="z", delay=0.02)} if timing else reads
    ends = ("body", [0, 0.1, 0]), ("wheel", [0, 0.1, 0])
    model = jb.Model(
        **loops().parts()
        | {"elements": {name: jb.Actuator(*ends, command=3.0) for name in drives}}
        | {"controllers": {"law": jb.Controller(reads, drives, law, pade=2, **timing)}}
    )
    jb.write_model(model, path := tmp_path / f"loops.{suffix}", allow=[__name__])
    assert eqx.tree_equal(jb.read_model(path, allow=[__name__]), model)
    if name == "own":
        with pytest.raises(jb.JaxbodyError, match=r"controllers\.law\.law: is a Damped.*NOT_ALLO"):
            jb.write_model(model, path)
        with pytest.raises(jb.JaxbodyError, match=r"law.*names the module.*NOT_ALLOWED"):
            jb.read_model(path)
        path.write_text(path.read_text().replace("40.0", "-40.0"))
        with pytest.raises(jb.JaxbodyError, match=r"law\.gain: is -40 N s/m .*> 0.*NOT_POSITIVE"):
            jb.read_model(path, allow=[__name__])


def test_a_file_with_loops_is_the_same_again(tmp_path):
    model = jb.read_model(written(tmp_path))
    for suffix in ("toml", "json"):
        jb.write_model(model, path := tmp_path / f"again.{suffix}")
        assert eqx.tree_equal(jb.read_model(path), model)


SKYHOOK = '{type = "Proportional", gain = "-1.2 N s/mm"}'
PROBLEMS = [
    # what stands in the file, what stands there instead, lines from there to the problem
    (
        'drives = "actuator"',
        'drives = "actuatr"',
        0,
        "controllers.ride.drives: element 'actuatr' is unknown. Did you mean 'actuator'?",
    ),
    ('["damper"]', '["spring"]', 0, "controllers.sky.drives: 'spring' is unknown"),
    (
        '["damper"]',
        '["actuator"]',
        0,
        "controllers.sky.drives: names 'actuator', which 'ride' drives",
    ),
    ('limit = "2 kN"', 'limit = "-2 kN"', 0, "elements.actuator.limit: is -2000 N"),
    (
        'bandwidth = "20 Hz"\n',
        "",
        1,
        "elements.actuator.rate: limits the rate of a force that follows at once",
    ),
    (
        'rate = "1000 kN/s"',
        'rate = "1000 kN"',
        0,
        "elements.actuator.rate: is '1000 kN', in N (allowed: a unit such as N/s)",
    ),
    ('soft = "0.3', 'soft = "-0.3', 0, "elements.damper.soft: is -300 (allowed: >= 0)"),
    (
        'drives = "actuator"',
        'drives = "actuator"\ndelay = "4 ms"',
        1,
        "controllers.ride.delay: is that of the computation of a sampled law",
    ),
    (
        'drives = "actuator"',
        'drives = "actuator"\nevery = "0 ms"',
        1,
        "controllers.ride.every: is 0 s",
    ),
    (
        '"Position", on',
        '"Positon", on',
        0,
        "controllers.ride.reads.height.type: 'Positon' is unknown",
    ),
    (
        '"Position", on = "body"',
        '"Position", on = "bodi"',
        0,
        "controllers.ride.reads.height.on: body or support 'bodi' is unknown",
    ),
    ('"PID"', '"PIDD"', 0, "controllers.ride.law.type: 'PIDD' is unknown"),
    ("1e4", '"10 N/mm"', 0, "controllers.ride.law.proportional: is '10 N/mm', in N/m"),
    ('"-1.2 N s/mm"', '"-1.2 N/mm"', 0, "controllers.sky.law.gain: is '-1.2 N/mm', in N/m"),
    (
        SKYHOOK,
        '{type = "LinearFeedback", D = [[1, 2]]}',
        0,
        "controllers.sky.law.command: reads 1 numbers: speed (allowed: 2)",
    ),
    (
        SKYHOOK,
        '{type = "LinearFeedback", D = [[1], [2]]}',
        0,
        "controllers.sky.law.command: returns arrays of shape (2,) (allowed: (1,))",
    ),
    (
        SKYHOOK,
        '{type = "LinearFeedback", D = [[1]], C = [[1]]}',
        0,
        "controllers.sky.law.C: has shape (1, 1) (allowed: (1, 0))",
    ),
    ('on = "actuator"}', 'on = "spring"}', 0, "sensors.asked: 'spring' is unknown"),
    ('on = "damper"}', 'on = "dampr"}', 0, "sensors.force.on: element 'dampr' is unknown"),
]


@pytest.mark.parametrize("old, new, below, message", PROBLEMS)
def test_what_is_wrong_with_a_loop_is_said_with_its_line(old, new, below, message, tmp_path):
    line = LOOPS.count("\n", 0, LOOPS.index(old)) + 1 + below
    with pytest.raises(jb.JaxbodyError) as error:
        jb.read_study(written(tmp_path, LOOPS.replace(old, new, 1)))
    assert f"loops.toml:{line} {message}" in str(error.value)


def test_editors_know_loops(tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    check = jsonschema.Draft202012Validator(schema())
    values = read_document(written(tmp_path)).values
    check.validate(values)
    values["controllers"]["ride"]["drives"] = ["actuator"]
    check.validate(values)
    values["controllers"]["ride"].pop("law")
    assert not check.is_valid(values)


def test_numbers_of_loops_are_set_and_written_into_their_entries(tmp_path):
    document = read_document(path := written(tmp_path))
    set_value(document, "sky.law.gain=-3 N s/mm")
    assert document.values["controllers"]["sky"]["law"]["gain"] == "-3 N s/mm"
    model = jb.read_model(path)
    paths = ["sky.law.gain", "ride.law.proportional", "ride.reads.height.lag", "actuator.limit"]
    changed = jb.replace(model, dict(zip(paths, [-2e3, 5e3, 0.001, 500.0], strict=True)))
    places = [[("", leaf)] for leaf in leaves_of(model) if leaf.path in paths]
    space = SimpleNamespace(model=model, parameters=[SimpleNamespace(places=x) for x in places])
    assert update(path, read_document(path), space, {"": changed}) == []
    text = path.read_text()
    for entry in ('gain = "-2.0 N s/mm"', 'lag = "1.0 ms"', 'limit = "0.5 kN"', "al = 5000.0,"):
        assert entry in text
    assert eqx.tree_equal(jb.read_model(path), changed)


def test_a_measured_response_to_a_command_is_read(tmp_path):
    measured = """
[experiments.push]
type = "MeasuredResponse"
frequencies = "1, 2 Hz"
inputs.push = {type = "Command", on = "actuator"}
measured.asked.push = {real = [1, 1], imaginary = [0, 0]}
"""
    (run,) = jb.read_study(written(tmp_path, LOOPS + measured)).experiments.values()
    assert run.inputs == {"push": jb.Command("actuator")}
    with pytest.raises(jb.JaxbodyError, match=r"push\.inputs\.push\.on: 'tyre' is unknown"):
        jb.read_study(written(tmp_path, LOOPS + measured.replace('"actuator"', '"tyre"')))


def test_own_laws_are_written_as_json(tmp_path):
    own = jb.Controller(SPEED, "third", Damped(jnp.array(40.0), jnp.array(0.01)), every=0.01)
    parts = loops().parts()
    parts["elements"]["third"] = jb.Actuator("wheel", "road")
    parts["controllers"]["own"] = own
    jb.write_model(jb.Model(**parts), path := tmp_path / "own.json", allow=[__name__])
    assert json.loads(path.read_text())["controllers"]["own"]["law"] == {
        "type": f"{__name__}:Damped",
        "gain": 40.0,
        "time": 0.01,
    }
