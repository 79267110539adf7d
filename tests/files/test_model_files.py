"""Models in files: every number to the bit, problems with their lines, nothing executed."""

import json
import subprocess
import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from file_schemas import schema
from hypothesis import HealthCheck, given, settings
from mutated_files import check_changed
from random_models import models

import jaxbody as jb
from jaxbody.files.kinds import (
    CONTROL_LAWS,
    ELEMENTS,
    INPUTS,
    JOINTS,
    LAWS,
    LOADS,
    MOTIONS,
    PULSES,
    SENSORS,
    TYPES,
    arguments_of,
)
from jaxbody.files.schemas import SCHEMA_FILE
from jaxbody.model.laws.laws import Law

PRESETS = [
    name for name in dir(jb.presets) if isinstance(getattr(jb.presets, name), type(lambda: 0))
]
ENGINE = '''jaxbody = 1
gravity = "0, 0, -9.81 m/s2"

[bodies.engine]  # with its gearbox
mass = "180 kg"
inertia = "8, 12, 10 kg m2"
position = "0, 0, 500 mm"
orientation = {sequence = "ZYX", angles = "0, 3, 0 deg"}

[supports.frame]
position = [0, 0, "0.4 m"]

[elements.left]
type = "Bushing"
a = ["engine", "0.3, 0.25, -0.1 m"]
b = ["frame", "0.3, 0.25, 0 m"]
stiffness = "200, 200, 400 N/mm"

[elements.right]
type = "SpringDamper"
a = ["engine", "0.3, -0.25, -0.1 m"]
b = ["frame", "0.3, -0.25, -0.2 m"]
spring = ["200 N/mm", {type = "BumpStop", gap = "8 mm", stiffness = "3 kN/mm"}]
damper = {type = "TwoSided", bump = "0.9 N s/mm", rebound = "2.1 N s/mm"}

[elements.rear]
type = "Torsion"
a = "engine"
b = "frame"
axis = [0, 1, 0]
spring = {type = "Tabulated", file = "rear.csv"}
'''  # fmt: skip


class Cubic(Law):
    coefficient: jax.Array = jb.field("force/argument^3", "nonnegative")

    def force(self, x):
        return self.coefficient * x**3


class Pusher(jb.Element):
    """An element whose law has no stated unit."""

    spring: Law = jb.field()

    def deformation(self, A, B):
        return (B.point(self.b) - A.point(self.a))[2]

    def energy(self, e):
        return self.spring.potential(e)

    def dissipation(self, e, e_dot):
        return jnp.zeros_like(e)


class Charges(jb.Element):
    strength: jax.Array = jb.field("N m2", "positive")

    def deformation(self, A, B):
        return jnp.linalg.norm(B.point(self.b) - A.point(self.a))

    def energy(self, e):
        return self.strength / e

    def dissipation(self, e, e_dot):
        return jnp.zeros_like(e)


def same_to_the_bit(model, again):
    (leaves, structure), (others, structure_again) = (
        jax.tree.flatten(model),
        jax.tree.flatten(again),
    )
    assert structure == structure_again
    for leaf, other in zip(leaves, others, strict=True):
        assert (
            leaf.dtype == other.dtype and np.asarray(leaf).tobytes() == np.asarray(other).tobytes()
        )


def again(model, path, **options):
    jb.write_model(model, path, **options)
    return jb.read_model(path, **options)


@pytest.mark.long
@pytest.mark.everywhere
@pytest.mark.parametrize("suffix", ["toml", "json"])
@pytest.mark.parametrize("name", PRESETS)
def test_presets_are_the_same_again(name, suffix, tmp_path):
    model = getattr(jb.presets, name)()
    same_to_the_bit(model, again(model, tmp_path / f"{name}.{suffix}"))


# Random models


def check_random_models(count, folder):
    built = 0

    @settings(
        max_examples=count,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(models())
    def check(parts):
        nonlocal built
        try:
            model = jb.Model(**parts)
        except jb.JaxbodyError:  # such as names that look alike, or a contact of length zero
            return
        built += 1
        for suffix in ("toml", "json"):
            same_to_the_bit(model, again(model, folder / f"model.{suffix}"))

    check()
    return built


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_random_models_are_the_same_again(tmp_path):
    assert check_random_models(40, tmp_path) > 20


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_a_thousand_random_models_are_the_same_again(tmp_path):
    assert check_random_models(1500, tmp_path) >= 1000


def test_single_precision_is_the_same_again(tmp_path):
    jax.config.update("jax_enable_x64", False)
    try:
        model = jb.presets.full_car()
        assert model.gravity.dtype == jnp.float32
        same_to_the_bit(model, again(model, tmp_path / "car.toml"))
    finally:
        jax.config.update("jax_enable_x64", True)


# What a person writes


def engine(folder, text=ENGINE):
    (folder / "rear.csv").write_text(
        "angle [deg], moment [Nm]\n" + "".join(f"{i}, {3 * i}\n" for i in range(-5, 6))
    )
    (folder / "engine.toml").write_text(text)
    return folder / "engine.toml"


def test_a_file_by_hand_is_the_model_in_python(tmp_path):
    angles = np.arange(-5.0, 6.0)
    model = jb.Model(
        bodies={
            "engine": jb.Body(
                180.0,
                [8, 12, 10],
                position=[0, 0, 0.5],
                orientation=jb.EulerAngles("ZYX", np.deg2rad([0.0, 3, 0])),
            )
        },
        supports={"frame": jb.Support([0, 0, 0.4])},
        elements={
            "left": jb.Bushing(
                ("engine", [0.3, 0.25, -0.1]), ("frame", [0.3, 0.25, 0]), stiffness=[2e5, 2e5, 4e5]
            ),
            "right": jb.SpringDamper(
                ("engine", [0.3, -0.25, -0.1]),
                ("frame", [0.3, -0.25, -0.2]),
                spring=jb.laws.Linear(2e5) + jb.laws.BumpStop(gap=0.008, stiffness=3e6),
                damper=jb.laws.TwoSided(bump=900.0, rebound=2100.0),
            ),
            "rear": jb.Torsion(
                "engine",
                "frame",
                axis=[0, 1, 0],
                spring=jb.laws.Tabulated(np.deg2rad(angles), 3 * angles),
            ),
        },
        gravity=[0, 0, -9.81],
    )
    read = jb.read_model(engine(tmp_path))
    assert jax.tree.structure(read) == jax.tree.structure(model)
    for leaf, other in zip(jax.tree.leaves(read), jax.tree.leaves(model), strict=True):
        # rounding of the conversions of units
        np.testing.assert_allclose(leaf, other, rtol=1e-15, atol=1e-18)


@pytest.mark.everywhere
@pytest.mark.parametrize(
    "old, new, line, message",
    [
        (
            'mass = "180 kg"',
            "mass = 180",
            5,
            "bodies.engine.mass: is 180 without a unit (allowed: a unit such as kg)",
        ),
        ('mass = "180 kg"', 'mass = "-180 kg"', 5, "bodies.engine.mass: is -180 kg (allowed: > 0)"),
        ('mass = "180 kg"', 'weight = "180 kg"', 5, "bodies.engine.weight: 'weight' is unknown"),
        ('mass = "180 kg"\n', "", 4, "bodies.engine: has no 'mass'"),
        (
            "8, 12, 10 kg m2",
            "8, 12, 30 kg m2",
            6,
            "bodies.engine.inertia: has principal moments 8, 12, 30 kg m2",
        ),
        ("0, 0, 500 mm", "0, 0, 500 mm2", 7, "bodies.engine.position: is '0, 0, 500 mm2', in m2"),
        ("0, 0, 500 mm", "0, 500 mm", 7, "bodies.engine.position: has shape (2,)"),
        ("0, 3, 0 deg", "0, 3, 0", 8, "bodies.engine.orientation.angles: is 3 without a unit"),
        (
            "[supports.frame]",
            "[bodies.engine]",
            10,
            "bodies.engine: is stated twice, first in line 4",
        ),
        (
            '"Bushing"',
            '"Busing"',
            14,
            "elements.left.type: 'Busing' is unknown. Did you mean 'Bushing'?",
        ),
        ('"Bushing"', '"os:system"', 14, "elements.left.type: names the module 'os'"),
        (
            '["engine", "0.3, 0.25, -0.1 m"]',
            '["engin", "0.3, 0.25, -0.1 m"]',
            15,
            "elements.left.a[0]: body or support 'engin' is unknown",
        ),
        (
            '["engine", "0.3, 0.25, -0.1 m"]',
            "3",
            15,
            "elements.left.a: is 3 (allowed: a text or a list)",
        ),
        (
            "200, 200, 400 N/mm",
            "200, -200, 400 N/mm",
            17,
            "elements.left.stiffness: has coefficients 200000, -200000, 400000",
        ),
        ("8 mm", "-8 mm", 23, "elements.right.spring[1].gap: is -0.008 m"),
        (
            '"3 kN/mm"',
            '"3 kN mm"',
            23,
            (
                "elements.right.spring[1].stiffness: is '3 kN mm', in N m "
                "(allowed: a unit such as N/m)"
            ),
        ),
        (
            '"0.9 N s/mm"',
            '"0.9 N/mm"',
            24,
            "elements.right.damper.bump: is '0.9 N/mm', in N/m (allowed: a unit such as N s/m)",
        ),
        ('"rear.csv"', '"../rear.csv"', 31, "elements.rear.spring.file: names '../rear.csv'"),
        ('"rear.csv"', '"read.csv"', 31, "elements.rear.spring.file: "),
        ('file = "rear.csv"', "x = [0]", 31, "elements.rear.spring: needs either points or a file"),
        (
            '"rear.csv"',
            '"rear.csv", x = [0], forces = [0]',
            31,
            "elements.rear.spring: needs either points or a file",
        ),
        (
            "jaxbody = 1",
            "jaxbody = 2",
            1,
            (
                "jaxbody: is version 2 (allowed: 1). This jaxbody reads version 1: "
                "install a newer one."
            ),
        ),
        ("jaxbody = 1\n", "\n", None, "jaxbody: does not state its version"),
        (
            "[bodies.engine]",
            "[bodies.engin]",
            15,
            "elements.left.a[0]: body or support 'engine' is unknown",
        ),
        ("axis = [0, 1, 0]", "axis = [0, 0, 0]", 30, "elements.rear.axis: has length zero"),
        ('gravity = "0, 0, -9.81 m/s2"', 'gravity = "9.81 m/s2"', 2, "gravity: has shape ()"),
    ],
)
def test_problems_are_reported_with_their_line(old, new, line, message, tmp_path):
    assert old in ENGINE
    with pytest.raises(jb.JaxbodyError) as error:
        jb.read_model(engine(tmp_path, ENGINE.replace(old, new, 1)))
    assert f"engine.toml{f':{line}' if line else ''} {message}" in str(error.value)
    assert len(str(error.value).splitlines()) <= 12


def test_types_of_earlier_drafts_are_read(tmp_path):
    text = ENGINE.replace('"BumpStop"', '"Stop"').replace('"Tabulated"', '"Table"')
    assert text.count('"Stop"') == text.count('"Table"') == 1
    old, new = (jb.read_model(engine(tmp_path, each)) for each in (text, ENGINE))
    same_to_the_bit(old, new)


def test_stages_are_arguments_of_sensors_that_take_them():
    class Plain(jb.sensors.Sensor):
        def __init__(self, on):
            super().__init__(on)

        def reading(self, model, frames):
            return frames.t

    assert [argument.name for argument in arguments_of(Plain)] == ["on"]
    assert {"gain", "lag"} <= {argument.name for argument in arguments_of(jb.Position)}


def test_all_problems_are_in_one_error(tmp_path):
    text = (
        ENGINE.replace("180 kg", "180 m")
        .replace('"frame", "0.3, 0.25', '"fram", "0.3, 0.25')
        .replace('"Bushing"', '"Spring"')
        .replace("gap", "gab")
        .replace("[0, 1, 0]", '"up"')
    )
    with pytest.raises(jb.JaxbodyError) as error:
        jb.read_model(engine(tmp_path, text))
    assert [problem.code for problem in error.value.problems] == [
        "WRONG_DIMENSION",
        "UNKNOWN_BODY",
        "MISSING_ENTRY",
        "UNKNOWN_NAME",
        "UNKNOWN_NAME",
    ]


def test_own_classes_are_taken_from_modules_that_are_allowed(tmp_path):
    ends = {"a": jnp.zeros(3), "b": jnp.ones(3)}
    ball = jb.Body(mass=0.2, inertia=[1, 1, 1])
    elements = {
        "pair": Charges(("ball", "world"), **ends, strength=jnp.array(0.5)),
        "pusher": Pusher(
            ("ball", "world"), **ends, spring=jb.laws.BumpStop(gap=1.0, stiffness=3.0)
        ),
        "rubber": jb.SpringDamper(
            ("ball", [0, 0, 0]), ("world", [0, 0, 1]), spring=Cubic(jnp.array(8.0))
        ),
    }
    model = jb.Model(bodies={"ball": ball}, elements=elements)
    same_to_the_bit(model, again(model, tmp_path / "own.toml", allow=[__name__]))
    with pytest.raises(
        jb.JaxbodyError, match=f"elements.pair: is a Charges from {__name__}.*NOT_ALLOWED"
    ):
        jb.write_model(model, tmp_path / "own.toml")
    with pytest.raises(jb.JaxbodyError, match=f"names the module '{__name__}'.*NOT_ALLOWED"):
        jb.read_model(tmp_path / "own.toml")
    with pytest.raises(jb.JaxbodyError, match="which cannot be imported"):
        (tmp_path / "own.json").write_text(
            '{"jaxbody": 1, "bodies": {"a": {"mass": "1 kg"}}, "joints": {"a": {"type": '
            '"mine.joints:Nut"}}}'
        )
        jb.read_model(tmp_path / "own.json", allow=["mine.joints"])
    text = (tmp_path / "own.toml").read_text()
    for old, new, code in (
        ("0.5", "-0.5", "NOT_POSITIVE"),
        ("strength", "length", "MISSING_ENTRY"),
        ("Charges", "given", "UNKNOWN_NAME"),
    ):
        (tmp_path / "own.toml").write_text(text.replace(old, new))
        with pytest.raises(jb.JaxbodyError) as error:
            jb.read_model(tmp_path / "own.toml", allow=[__name__])
        assert error.value.code == code and "own.toml" in error.value.where


def test_what_has_no_text_is_named(tmp_path):
    spring = jb.SpringDamper(("ball", [0, 0, 0]), ("world", [0, 0, 1]), spring=lambda x: x**3)
    model = jb.Model(
        bodies={"ball": jb.Body(mass=1.0)},
        joints={"ball": jb.Translation("world")},
        elements={"s": spring},
    )
    with pytest.raises(
        jb.JaxbodyError, match=r"elements.s.spring: is a Function of your own Python.*OWN_CODE"
    ):
        jb.write_model(model, tmp_path / "m.toml")
    car = jb.presets.quarter_car()
    with pytest.raises(jb.JaxbodyError, match=r"is a batch of 2 models.*BAD_SHAPE"):
        jb.write_model(jax.tree.map(lambda x: jnp.stack([x, x]), car), tmp_path / "m.toml")
    with pytest.raises(jb.JaxbodyError, match="TRACED"):
        jax.jit(lambda model: jb.write_model(model, tmp_path / "m.toml"))(car)
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_FORMAT"):
        jb.write_model(car, tmp_path / "m.yaml")
    with pytest.raises(jb.JaxbodyError, match="NOT_SAVED"):
        jb.write_model(car, tmp_path / "none" / "m.toml")
    assert not list(tmp_path.iterdir())


# The schema


def test_the_schema_is_that_of_the_fields():
    assert json.loads(SCHEMA_FILE.read_text()) == schema(), "run `python tests/file_schemas.py`"


BASES = {jb.laws.Hysteretic, jb.laws.Inertial, jb.laws.Viscoelastic, jb.inputs.Load}  # of one's own


def test_every_class_of_the_package_is_in_the_schema():
    def below(kind):
        return {x for sub in kind.__subclasses__() for x in {sub, *below(sub)}}

    homes = (jb, jb.laws, jb.joints, jb.inputs, jb.sensors, jb.forces, jb.control)
    public = {getattr(home, name) for home in homes for name in dir(home) if name[0].isupper()}
    wanted = {
        kind
        for base in (
            jb.Element,
            jb.joints.Joint,
            Law,
            jb.ForceElement,
            jb.control.ControlLaw,
            jb.sensors.Sensor,
        )
        for kind in below(base) & public
    }
    assert len(wanted) > 40 and wanted - set(TYPES.values()) == {
        jb.laws.Function,
        jb.laws.Sum,
        *BASES,
    }  # Python, and a list of laws
    assert set(TYPES.values()) == {
        *JOINTS,
        *ELEMENTS,
        *LAWS,
        *MOTIONS,
        *PULSES,
        *LOADS,
        *INPUTS,
        *SENSORS,
        *CONTROL_LAWS,
        jb.Controller,
        jb.signals.Sine,
    }


def test_editors_accept_what_is_read_and_refuse_what_is_not(tmp_path):
    jsonschema = pytest.importorskip("jsonschema")
    check = jsonschema.Draft202012Validator(schema())
    jb.write_model(jb.presets.full_car(), tmp_path / "car.json")
    for values in (
        json.loads((tmp_path / "car.json").read_text()),
        jb.files.documents.read_document(engine(tmp_path)).values,
    ):
        check.validate(values)
        values["bodies"][next(iter(values["bodies"]))].pop("mass")
        assert not check.is_valid(values)


# Safety


def test_a_file_is_checked_before_JAX_is_imported(tmp_path):
    path = engine(tmp_path, ENGINE.replace("180 kg", "180 m"))
    code = (
        "import sys; from pathlib import Path; from jaxbody.files.documents import read_document; "
        "from jaxbody.files.schemas import checked_values\n"
        f"try: checked_values(read_document(Path({str(path)!r})))\n"
        "except ValueError as error: print(error.code, 'jax' in sys.modules, "
        "'numpy' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["WRONG_DIMENSION", "False", "False"]


@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_mutated_files_are_models_or_clear_errors(tmp_path):
    assert check_mutations(300, tmp_path) > 20


@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
@pytest.mark.long
def test_ten_thousand_mutated_files_are_models_or_clear_errors(tmp_path):
    assert check_mutations(10000, tmp_path) > 500


def check_mutations(count, folder):
    """The number of changed files that are still models."""
    return check_changed(engine(folder), count, jb.read_model)


def test_an_orientation_that_follows_from_the_drawing_is_not_written(tmp_path):
    path = tmp_path / "m.toml"
    turned = jb.Body(2.0, [1, 1, 1], orientation=jb.EulerAngles("XYZ", [0.3, -0.2, 0.5]))
    ends = {
        "a": ("box", [0, 0, 0]),
        "b": ("world", [0, 0, 0]),
        "orientation": jb.EulerAngles("Y", [0.4]),
    }
    own = jb.Bushing(**ends, stiffness=[1, 2, 3], orientation_b=jb.EulerAngles("Z", [0.1]))
    model = jb.Model(
        bodies={"box": turned}, elements={"mount": jb.Mount(**ends, x=3.0), "own": own}
    )
    jb.write_model(model, path)
    assert path.read_text().count("orientation_b") == 1
    same_to_the_bit(model, jb.read_model(path))
