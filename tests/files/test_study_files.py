"""Studies in files: the motions of supports, as in Python."""

import numpy as np
import pytest

import jaxbody as jb

SHAKER = """jaxbody = 1
units = {length = "mm", mass = "kg", time = "s", angle = "deg"}
bodies.box = {mass = 2, inertia = "1, 1, 1 kg m2"}
supports.table = {}
supports.floor = {}
joints.box = {type = "Fixed", parent = "table"}

[motion.table]
type = "Harmonic"
frequency = "90 1/min"
translation = [0, 0, 10]
rotation = "0, 2, 0 deg"
translation_phase = 90
"""


def test_motions_are_those_of_python(tmp_path):
    (tmp_path / "shaker.toml").write_text(SHAKER)
    study = jb.read_study(tmp_path / "shaker.toml")
    expected = jb.Harmonic(frequency=1.5, translation=[0, 0, 0.01], rotation=[0, np.deg2rad(2), 0], translation_phase=np.pi / 2)
    assert list(study.motion) == ["table"] and study.model.layout.bodies == ("box",)
    for name, value in vars(expected).items():
        np.testing.assert_allclose(getattr(study.motion["table"], name), value, rtol=1e-15)
    same = jb.read_model(tmp_path / "shaker.toml")
    assert jb.paths(same).keys() == jb.paths(study.model).keys()


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("[motion.table]", "[motion.tabel]", "shaker.toml:8 motion.tabel: 'tabel' is unknown. Did you mean 'table'?"),
        ("Harmonic", "Harmonik", "shaker.toml:9 motion.table.type: 'Harmonik' is unknown. Did you mean 'Harmonic'?"),
        ("90 1/min", "90 mm", "shaker.toml:10 motion.table.frequency: is '90 mm', in m"),
        ("[0, 0, 10]", "[0, 10]", "shaker.toml:11 motion.table.translation: has shape (2,)"),
        ("translation =", "amplitude =", "shaker.toml:11 motion.table.amplitude: 'amplitude' is unknown"),
    ],
)
def test_problems_are_reported_with_their_line(old, new, message, tmp_path):
    (tmp_path / "shaker.toml").write_text(SHAKER.replace(old, new, 1))
    with pytest.raises(jb.JaxbodyError) as error:
        jb.read_study(tmp_path / "shaker.toml")
    assert message in str(error.value)
