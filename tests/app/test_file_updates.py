"""New numbers in a file: read again to the bit, in the units that stood there, with
every comment."""

import json
import re
from types import SimpleNamespace

import jax
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.app.file_updates import update
from jaxbody.files.documents import read_document
from jaxbody.files.model_files import toml_of, values_of
from jaxbody.model.leaf_paths import leaves_of

BOX = """# a box
jaxbody = 1
gravity = "0, 0, -9.81 m/s2"  # here
bodies.box = {mass = "2 kg", inertia = "1e6, 2e6, 2e6 kg mm2"}  # of steel

[supports]
table.position = ["0 mm", "0 m", "-10 cm"]

[joints]
box = {type = "Translation", parent = "table"}

[elements.left]
type = "SpringDamper"
a = ["box", "100, 0, 0 mm"]        # the bracket
b = ["table", ["10 cm", 0, "-0.5 m"]]
free_length = "0.5 m"
spring = ["21 N/mm",               # catalogue
          {type = "BumpStop", gap = "8 mm", stiffness = "3 kN/mm"}]
damper = {type = "TwoSided", bump = "0.9 N s/mm", rebound = "2.1 N s/mm"}

[elements.right]
type = "Bushing"
a = ["box", "-100, 0, 0 mm"]
b = ["table", "0, 0, 0 m"]
stiffness = "200, 200, 400 N/mm"   # three directions
"""


def space_of_all(model, kept=lambda leaf: True):
    """A space in which every number of a model is free but unit vectors."""
    leaves = [
        leaf
        for leaf in leaves_of(model)
        if leaf.kind.domain not in ("direction", "rotation") and kept(leaf)
    ]
    return SimpleNamespace(
        model=model, parameters=[SimpleNamespace(places=[("", leaf)]) for leaf in leaves]
    )


def changed(model):
    """The model with other numbers that need all digits."""
    return jax.tree.map(lambda x: x * np.array(1.0 + np.pi * 1e-3, x.dtype), model)


def check_update(path, space, model, rounding=0.0):
    before = path.read_text()
    assert update(path, read_document(path), space, {"": model}) == []
    again = jb.read_model(path)
    expected, found = jax.tree.leaves(model), jax.tree.leaves(again)
    for (_, leaf), *_ in [parameter.places for parameter in space.parameters]:
        np.testing.assert_allclose(
            leaf.read(found), leaf.read(expected), rtol=rounding, atol=0, err_msg=leaf.path
        )
    return before, path.read_text()


@pytest.mark.parametrize("name", ["full_car", "engine_on_mounts", "double_pendulum"])
@pytest.mark.parametrize("format", ["toml", "json"])
def test_every_number_of_a_preset_is_read_again_to_the_bit(name, format, tmp_path):
    model = getattr(jb.presets, name)()
    values, path = values_of(model), tmp_path / f"model.{format}"
    path.write_text(toml_of(values, units=True) if format == "toml" else json.dumps(values))
    before, after = check_update(path, space_of_all(model), changed(model))
    assert before.count("#") == after.count("#")


def test_units_comments_and_order_stay(tmp_path):
    path = tmp_path / "box.toml"
    path.write_text(BOX)
    model = jb.read_model(path)
    stated = {
        "mass",
        "inertia",
        "position",
        "a",
        "b",
        "free_length",
        "stiffness",
        "coefficient",
        "gap",
        "bump",
        "rebound",
        "gravity",
    }
    space = space_of_all(
        model,
        lambda leaf: leaf.field in stated and not leaf.path.startswith(("box.position", "right.b")),
    )
    # not every double is one of centimeters
    before, after = check_update(path, space, changed(model), rounding=2.3e-16)
    number = r"-?\d[\d.e+-]*"
    assert re.sub(number, "#", before.replace(" 0,", " 0.0,")) == re.sub(number, "#", after)
    assert 'spring = ["21.0659' in after and "[0.0, " not in after


def test_terms_of_a_sum_have_their_own_places(tmp_path):
    path = tmp_path / "box.toml"
    path.write_text(
        BOX.replace(
            'gap = "8 mm", stiffness = "3 kN/mm"}]',
            'gap = "8 mm", stiffness = "3 kN/mm"}, "4 N/mm"]',
        )
    )
    model = jb.read_model(path)
    wanted = [
        f"left.spring.terms.{i}.{name}"
        for i, name in ((0, "coefficient"), (1, "gap"), (1, "stiffness"), (2, "coefficient"))
    ]
    space = space_of_all(model, lambda leaf: leaf.path in wanted)
    assert len(space.parameters) == 4
    check_update(path, space, changed(model), rounding=2.3e-16)
    path.write_text(
        BOX.replace(
            'spring = ["21 N/mm",               # catalogue',
            'spring = [{type = "Linear", coefficient = "1 N/m"}, "21 N/mm",',
        )
    )
    model = jb.read_model(path)
    space = space_of_all(model, lambda leaf: leaf.path == "left.spring.terms.1.coefficient")
    check_update(path, space, changed(model), rounding=2.3e-16)


def test_numbers_of_a_unit_system_stay_in_it(tmp_path):
    path = tmp_path / "box.toml"
    text = BOX.replace(
        "jaxbody = 1",
        'jaxbody = 1\nunits = {length = "mm", mass = "kg", force = "N", time = "s", angle = "deg"}',
    )
    path.write_text(
        text.replace('"21 N/mm"', "21")
        .replace('"200, 200, 400 N/mm"', "[200, 200, 400]")
        .replace('"2 kg"', "2")
    )
    model = jb.read_model(path)
    stated = {"mass", "stiffness", "coefficient"}
    check_update(
        path,
        space_of_all(model, lambda leaf: leaf.field in stated and "rotation" not in leaf.path),
        changed(model),
    )
    factor = 1.0 + np.pi * 1e-3
    values = read_document(path).values
    np.testing.assert_allclose(values["elements"]["left"]["spring"][0], 21 * factor, rtol=1e-14)
    np.testing.assert_allclose(
        values["elements"]["right"]["stiffness"],
        [200 * factor, 200 * factor, 400 * factor],
        rtol=1e-14,
    )
    np.testing.assert_allclose(values["bodies"]["box"]["mass"], 2 * factor, rtol=1e-14)


def test_what_stands_in_another_file_is_named(tmp_path):
    (tmp_path / "curve.csv").write_text("x [mm],F [N]\n0,0\n1,10\n2,30\n3,50\n")
    path = tmp_path / "box.toml"
    path.write_text(BOX.replace('["21 N/mm",', '[{type = "Tabulated", file = "curve.csv"},'))
    model = jb.read_model(path)
    space = space_of_all(
        model, lambda leaf: leaf.path in ("left.spring.terms.0.forces", "box.mass")
    )
    assert update(path, read_document(path), space, {"": changed(model)}) == [
        "left.spring.terms.0.forces"
    ]
    assert (
        "curve.csv" in path.read_text()
        and jb.read_model(path)["box"].mass == changed(model)["box"].mass
    )
