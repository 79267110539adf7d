"""Closures in model files: every number to the bit, units and names checked with their lines before
JAX is imported."""

import json
import re
import subprocess
import sys

import jax.numpy as jnp
import manual_pages
import numpy as np
import pytest
from file_schemas import schema
from hypothesis import HealthCheck, given, settings
from random_models import models_with_closures
from test_model_files import again, same_to_the_bit

import jaxbody as jb
from jaxbody.files.kinds import CLOSURES
from jaxbody.suspension.suspensions import Corner

BAR = jb.Body(mass=0.5, inertia=[1e-3, 2e-3, 2e-3])
STEERING = '''jaxbody = 1
units = {length = "mm", mass = "kg", time = "s", angle = "deg"}

[bodies]
rack.mass = 3
pinion.inertia = "1e-4, 1e-4, 2e-4 kg m2"
pinion.mass = "0.4 kg"
upright.mass = "20 kg"
upright.inertia = "0.2, 0.2, 0.2 kg m2"

[joints]
rack = {type = "Guide", parent = "world", axis = "y"}
pinion = {type = "Hinge", parent = "world", axis = "x"}

[closures.mesh]
type = "Coupling"
of = "rack.q"
by = "pinion.q"
ratio = "8 mm/rad"

[closures.ball]
type = "Ball"
a = ["world", "0, 0.7, 0.3 m"]
b = ["upright", [0, 700, 300]]

[closures."tie rod"]
type = "Rod"
a = ["rack", "0, 0.2, 0.25 m"]
b = ["upright", "0.15, 0.8, 0.275 m"]
length = 630

[closures.strut]
type = "Inline"
a = ["upright", [0, 0, 0]]
b = ["world", "0, 0, 600 mm"]
axis = "z"
'''  # fmt: skip


def four_bar(pin):
    """A four-bar of one freedom, closed by `pin`."""
    joints: dict[str, jb.joints.Joint] = {
        "crank": jb.Hinge("world", axis="z"),
        "coupler": jb.Hinge("crank", axis="z", at=[0.04, 0, 0]),
        "rocker": jb.Hinge("world", axis="z", at=[0.1, 0, 0]),
    }
    return jb.Model(bodies=dict.fromkeys(joints, BAR), joints=joints, closures={"pin": pin})


def geared(coupling):
    """A rack, a nut with two coordinates and a pinion, of which two are coupled."""
    joints: dict[str, jb.joints.Joint] = {
        "rack": jb.Guide("world", axis="y"),
        "nut": jb.joints.Cylindrical("world", axis="x"),
        "pinion": jb.Hinge("world", axis="x"),
    }
    return jb.Model(bodies=dict.fromkeys(joints, BAR), joints=joints, closures={"mesh": coupling})


ENDS = ("coupler", [0.16, 0, 0]), ("rocker", [0.18, 0, 0])
CURVE = jb.laws.Tabulated(np.linspace(-1.0, 1.0, 5), 0.01 * np.linspace(-1.0, 1.0, 5) ** 3)
MODELS = {
    "double wishbone": lambda: jb.suspension.double_wishbone().model,
    "MacPherson": lambda: jb.suspension.macpherson().model,
    "five links": lambda: (
        jb.suspension.five_link({"lower front outer": [0.04, 0.66, 1 / 3 - 0.14]}).model
    ),
    "solid axle": lambda: jb.suspension.solid_axle().model,
    "ball": lambda: four_bar(jb.closures.Ball(*ENDS)),
    "hinge": lambda: four_bar(jb.closures.Hinge(*ENDS, axis=[1e-3, 0.1, 1])),
    "guide": lambda: four_bar(jb.closures.Guide(*ENDS, axis="x")),
    "inline": lambda: four_bar(jb.closures.Inline(*ENDS, axis="y")),
    "weld": lambda: four_bar(jb.closures.Weld(*ENDS)),
    "rod": lambda: four_bar(jb.closures.Rod(*ENDS, length=0.1 / 3)),
    "ratio": lambda: geared(jb.closures.Coupling("rack.q", "pinion.q", ratio=-0.008)),
    "screw": lambda: geared(jb.closures.Coupling("nut.q.0", "nut.q.1", ratio=0.004 / (2 * np.pi))),
    "curve": lambda: geared(jb.closures.Coupling("rack.q", "nut.q.1", function=CURVE)),
    "law": lambda: geared(
        jb.closures.Coupling("rack.q", "pinion.q", function=jb.laws.Linear(0.25))
    ),
    "sum": lambda: geared(
        jb.closures.Coupling("rack.q", "pinion.q", function=jb.laws.Linear(0.25) + CURVE)
    ),
}


@pytest.mark.long
@pytest.mark.parametrize("suffix", ["toml", "json"])
@pytest.mark.parametrize("name", MODELS)
def test_models_with_closures_are_the_same_again(name, suffix, tmp_path):
    model = MODELS[name]()
    same_to_the_bit(model, again(model, tmp_path / f"model.{suffix}"))


def check_random_models(count, folder):
    built = 0

    @settings(
        max_examples=count,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(models_with_closures())
    def check(parts):
        nonlocal built
        try:
            model = jb.Model(**parts)
        except jb.JaxbodyError as error:
            # ends that cannot move relative to each other, a rod without length
            assert {problem.code for problem in error.problems} <= {"RIGID", "ZERO_LENGTH"}
            return
        built += 1
        for suffix in ("toml", "json"):
            same_to_the_bit(model, again(model, folder / f"model.{suffix}"))

    check()
    return built


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_random_models_with_closures_are_the_same_again(tmp_path):
    assert check_random_models(60, tmp_path) > 20


def read(folder, text=STEERING, **options):
    (folder / "steering.toml").write_text(text)
    return jb.read_model(folder / "steering.toml", **options)


def test_a_file_by_hand_is_the_model_in_python(tmp_path):
    model = read(tmp_path)
    assert model["mesh"].ratio == pytest.approx(0.008, rel=1e-15) and model["mesh"].rows == (
        "move",
    )
    np.testing.assert_allclose(model["ball"].b, [0, 0.7, 0.3], rtol=1e-15)
    assert model["tie rod"].length == pytest.approx(0.63, rel=1e-15)
    np.testing.assert_array_equal(model["strut"].a, np.zeros(3))
    assert model.closure_names == ("mesh", "ball", "tie rod", "strut")


@pytest.mark.long
def test_units_of_couplings_are_those_of_their_coordinates(tmp_path):
    nut = '[joints.nut]\ntype = "Cylindrical"\nparent = "world"\naxis = "x"\n[joints]'
    of = STEERING.replace('by = "pinion.q"', 'by = "nut.q.1"').replace("[joints]", nut)
    of = of.replace("[bodies]", "[bodies]\nnut.mass = 1\nnut.inertia = [1e3, 1e3, 1e3]")
    for ratio, value in (
        ('"9 mm/deg"', 0.009 * 180 / np.pi),
        ("9", 0.009 * 180 / np.pi),
        ('"0.5 m/rad"', 0.5),
    ):
        assert read(tmp_path, of.replace('"8 mm/rad"', ratio))["mesh"].ratio == pytest.approx(
            value, rel=1e-14
        )
    table = (
        'function = {type = "Tabulated", x = "-90, 0, 45, 90 deg", forces = ["-10 mm", 0, 4, 10]}'
    )
    law = read(tmp_path, STEERING.replace('ratio = "8 mm/rad"', table))["mesh"].function
    np.testing.assert_allclose(law.x, [-np.pi / 2, 0, np.pi / 4, np.pi / 2], rtol=1e-15)
    np.testing.assert_allclose(law.forces, [-0.01, 0, 0.004, 0.01], rtol=1e-15)
    steps = of.replace(
        'type = "Cylindrical"',
        'type = "Composite"\nsteps = ["move", "turn"]\npoints = [[0, 0, 0], [0, 0, 0]]',
    )
    steps = steps.replace('axis = "x"\n[joints]', "directions = [[1, 0, 0], [1, 0, 0]]\n[joints]")
    assert read(tmp_path, steps)["mesh"].ratio == pytest.approx(0.008, rel=1e-15)
    free = STEERING.replace('by = "pinion.q"', 'by = "upright.q.2"').replace("mm/rad", "mm/m")
    assert read(tmp_path, free)["mesh"].ratio == pytest.approx(0.008, rel=1e-15)


@pytest.mark.parametrize(
    "old, new, line, message",
    [
        (
            'of = "rack.q"',
            'of = "rack.q.0"',
            17,
            "closures.mesh.of: coordinate 'rack.q.0' is unknown. Did you mean 'rack.q'?",
        ),
        (
            'by = "pinion.q"',
            'by = "upright.q.4"',
            18,
            "closures.mesh.by: coordinate 'upright.q.4' is unknown",
        ),
        (
            '"8 mm/rad"',
            '"8 mm"',
            19,
            "closures.mesh.ratio: is '8 mm', in m (allowed: a unit such as m rad-1)",
        ),
        ('ratio = "8 mm/rad"\n', "", 15, "closures.mesh: needs a ratio or a function"),
        (
            'ratio = "8 mm/rad"',
            'function = "8 mm"',
            19,
            "closures.mesh.function: is '8 mm', in m (allowed: a unit such as m rad-1)",
        ),
        (
            'ratio = "8 mm/rad"',
            'function = {type = "Tabulated", x = "0, 1 m", forces = [0, 1]}',
            19,
            "closures.mesh.function.x: is '0, 1 m'",
        ),
        (
            'type = "Ball"',
            'type = "Bal"',
            22,
            "closures.ball.type: 'Bal' is unknown. Did you mean 'Ball'?",
        ),
        ('type = "Ball"', 'type = "Universal"', 22, "closures.ball.type: 'Universal' is unknown"),
        ('type = "Ball"', 'type = "Equation"', 22, "closures.ball.type: 'Equation' is unknown"),
        (
            '["world", "0, 0.7, 0.3 m"]',
            '["world", "0, 0.7, 0.3 m2"]',
            23,
            "closures.ball.a[1]: is '0, 0.7, 0.3 m2', in m2",
        ),
        (
            '["upright", [0, 700, 300]]',
            '["upright", [0, 700]]',
            21,
            "closures.ball, second end (upright): has shape (2,)",
        ),
        (
            '["upright", [0, 700, 300]]',
            '["uprigt", [0, 700, 300]]',
            24,
            "closures.ball.b[0]: body or support 'uprigt' is unknown",
        ),
        (
            'a = ["rack", "0, 0.2, 0.25 m"]',
            'a = ["upright", [0, 1, 0]]',
            26,
            "closures.'tie rod': has both ends on 'upright'",
        ),
        (
            "length = 630",
            "length = -630",
            30,
            "closures.'tie rod'.length: is -0.63 m (allowed: > 0)",
        ),
        ("length = 630", 'length = "630 kg"', 30, "closures.'tie rod'.length: is '630 kg', in kg"),
        ("length = 630", "lenght = 630", 30, "closures.'tie rod'.lenght: 'lenght' is unknown"),
        ('axis = "z"\n', "", 32, "closures.strut: has no 'axis'"),
        ('axis = "z"\n', "axis = [0, 0, 0]", 36, "closures.strut.axis: has length zero"),
        (
            "[closures.ball]",
            "[closures.rack]",
            21,
            "closures.rack: is also the name of one of the bodies",
        ),
    ],
)
def test_problems_are_reported_with_their_line(old, new, line, message, tmp_path):
    assert old in STEERING
    with pytest.raises(jb.JaxbodyError) as error:
        read(tmp_path, STEERING.replace(old, new, 1))
    assert f"steering.toml:{line} {message}" in str(error.value)
    assert len(str(error.value).splitlines()) <= 12


class OnRail(jb.closures.Closure):
    """A wheel on a rail."""

    height: jnp.ndarray = jb.field("m", "positive")
    rows = ("height",)

    def gap(self, A, B, rest):
        return self.offset(A, B)[2:] - self.height


class Screw(jb.joints.Joint):
    """A nut on a screw, and a turn of its handle."""

    lead: jnp.ndarray = jb.field("m/rad")
    nq, nv, motions, turns = 2, 2, ("move", "turn"), (False, True)

    def pose(self, q, parent, rest):
        return parent @ rest

    def axes(self, q, parent, body):
        return jnp.zeros((2, 3)), jnp.zeros((2, 3))


def test_own_classes_are_taken_from_modules_that_are_allowed(tmp_path):
    ends = ("world", "wheel"), jnp.zeros(3), jnp.ones(3)
    model = jb.Model(bodies={"wheel": BAR}, closures={"rail": OnRail(*ends, height=jnp.array(0.1))})
    path = tmp_path / "own.toml"
    same_to_the_bit(model, again(model, path, allow=[__name__]))
    with pytest.raises(
        jb.JaxbodyError, match=f"closures.rail: is a OnRail from {__name__}.*NOT_ALLOWED"
    ):
        jb.write_model(model, path)
    with pytest.raises(jb.JaxbodyError, match=f"names the module '{__name__}'.*NOT_ALLOWED"):
        jb.read_model(path)
    path.write_text(path.read_text().replace("height = 0.1", "height = -0.1"))
    with pytest.raises(
        jb.JaxbodyError, match=r"own.toml:\d+ closures.rail.height: is -0.1 m.*NOT_POSITIVE"
    ):
        jb.read_model(path, allow=[__name__])


def test_couplings_take_the_units_of_the_coordinates_of_own_joints(tmp_path):
    text = STEERING.replace(
        'pinion = {type = "Hinge", parent = "world", axis = "x"}',
        f'pinion = {{type = "{__name__}:Screw", parent = "world", lead = "2 mm/rad"}}',
    )
    turned = text.replace('"pinion.q"', '"pinion.q.1"')
    assert read(tmp_path, turned, allow=[__name__])["mesh"].ratio == pytest.approx(0.008, rel=1e-15)
    for wrong, message in (
        (
            turned.replace('mm/rad"\n', 'mm"\n'),
            r"toml:19 closures.mesh.ratio: is '8 mm', in m \(allowed: a unit such as m rad-1\)",
        ),
        (text, r"toml:18 closures.mesh.by: coordinate 'pinion.q' is unknown"),
    ):
        with pytest.raises(jb.JaxbodyError, match=message):
            read(tmp_path, wrong, allow=[__name__])


def test_functions_of_python_are_named(tmp_path):
    with pytest.raises(jb.JaxbodyError, match=r"closures.mesh.function: is a function.*OWN_CODE"):
        jb.write_model(
            geared(jb.closures.Coupling("rack.q", "pinion.q", function=jnp.sin)),
            tmp_path / "m.toml",
        )
    rule = jb.closures.Equation(lambda A, B: B.p[0] - A.p[0], ("world", "box"))
    with pytest.raises(
        jb.JaxbodyError, match=r"closures.rule: is a Equation of your own Python.*OWN_CODE"
    ):
        jb.write_model(jb.Model(bodies={"box": BAR}, closures={"rule": rule}), tmp_path / "m.toml")
    assert not list(tmp_path.iterdir())


def test_every_closure_is_in_the_schema():
    known = {vars(jb.closures)[name] for name in jb.closures.__all__}
    assert known - set(CLOSURES) == {jb.closures.Closure, jb.closures.Equation}  # of the user's own
    assert {f"closure {kind.__name__}" for kind in CLOSURES} <= set(schema()["$defs"])


@pytest.mark.long
def test_editors_accept_what_is_read(tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    check = jsonschema.Draft202012Validator(schema())
    for name, model in MODELS.items():
        jb.write_model(model(), tmp_path / f"{name}.json")
        values = json.loads((tmp_path / f"{name}.json").read_text())
        check.validate(values)
        values["closures"][next(iter(values["closures"]))]["type"] = "Bal"
        assert not check.is_valid(values)


@pytest.mark.long
def test_names_and_units_are_checked_before_JAX_is_imported(tmp_path):
    path = tmp_path / "steering.toml"
    path.write_text(
        STEERING.replace('"8 mm/rad"', '"8 mm"')
        .replace('"upright", [', '"uprigt", [')
        .replace('by = "pinion.q"', 'by = "pinion"')
    )
    code = (
        "import sys; from pathlib import Path; from jaxbody.files.documents import read_document; "
        "from jaxbody.files.schemas import checked_values\n"
        f"try: checked_values(read_document(Path({str(path)!r})))\n"
        "except ValueError as error: print(*(problem.code for problem in error.problems), 'jax' "
        "in sys.modules, 'numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["UNKNOWN_NAME", "UNKNOWN_BODY", "UNKNOWN_BODY", "False", "False"]


@pytest.mark.long
def test_a_corner_of_a_file_has_the_same_curves(tmp_path):
    corner = jb.suspension.double_wishbone()
    read = again(corner.model, tmp_path / "corner.toml")
    curves = [Corner(model, corner.wheel).curves(0.04) for model in (corner.model, read)]
    assert float(curves[0]["camber"][0]) == float(curves[1]["camber"][0])


@pytest.mark.long
def test_the_steering_of_the_manual_is_read(tmp_path):
    text = (manual_pages.DOCS / "guide" / "files.md").read_text()
    (block,) = re.findall(r"^```toml\n(.*?)^```", text, re.M | re.S)
    model = read(tmp_path, block)
    assert (
        model["mesh"].ratio == pytest.approx(0.008, rel=1e-15) and jb.suspension.assemble(model).ok
    )
