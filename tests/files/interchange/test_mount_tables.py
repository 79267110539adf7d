"""A data sheet of mounts: the same bushings as by hand, and problems with their lines."""

import numpy as np
import pytest

import jaxbody as jb

SHEET = """# engine E12, issue 3
name; x [mm]; y [mm]; z [mm]; kx [N/mm]; ky [N/mm]; kz [N/mm]; rz [deg]; cz [N s/mm]; krx
left; 100; 250; 500; 200; 210; 400; 90; 0.5; 30 N m/deg
right; 100; -250; 50 cm; 200; 210; 400; ; 0.5; 0
"""
TURN = jb.EulerAngles("XYZ", [0.1, -0.2, 0.3])
BODIES = {
    "engine": jb.Body(180.0, [8, 12, 10], position=[0.1, 0, 0.6], orientation=TURN),
    "frame": jb.Support([0, 0, 0.4]),
}


def sheet(folder, text):
    (folder / "mounts.csv").write_text(text)
    return folder / "mounts.csv"


def test_the_mounts_are_where_they_are_drawn_and_relaxed(tmp_path):
    """In the reference pose both frames of each mount coincide at its place; its energy when the
    engine moves is that of its stiffness."""
    mounts = jb.files.read_mounts(sheet(tmp_path, SHEET), BODIES)
    assert list(mounts) == ["left", "right"] and mounts["left"].between == ("engine", "frame")
    np.testing.assert_allclose(mounts["right"].b, [0.1, -0.25, 0.1], atol=1e-15)
    np.testing.assert_allclose(
        np.diag(mounts["left"].stiffness), [2e5, 2.1e5, 4e5, 30 * 180 / np.pi, 0, 0], rtol=1e-15
    )
    assert mounts["right"].stiffness.tolist() == [2e5, 2.1e5, 4e5] and mounts[
        "right"
    ].damping.tolist() == [0, 0, 500.0]
    model = jb.Model(
        bodies={"engine": BODIES["engine"]}, supports={"frame": BODIES["frame"]}, elements=mounts
    )
    assert abs(float(jb.potential_energy(model, model.reference))) < 1e-20
    # the left one is turned by 90 degrees about z
    for axis, (left, right) in enumerate([(2.1e5, 2e5), (2e5, 2.1e5), (4e5, 4e5)]):
        moved = jb.State(model.reference.q.at[axis].add(1e-3), model.reference.v)
        np.testing.assert_allclose(
            jb.potential_energy(model, moved), 0.5e-6 * (left + right), rtol=1e-9
        )


def test_columns_name_the_bodies(tmp_path):
    text = (
        "kz [N/m],name,a,b,x [m],y [m],z [m],kx [N/m],ky [N/m]\n3,m,engine,world,0,0,1,1,2\n"
        "4,n,frame,engine,0,0,1,1,2\n"
    )
    mounts = jb.files.read_mounts(sheet(tmp_path, text), BODIES)
    assert mounts["m"].between == ("engine", "world") and mounts["n"].between == ("frame", "engine")
    np.testing.assert_allclose(mounts["m"].b, [0, 0, 1])
    assert mounts["n"].stiffness.tolist() == [1, 2, 4]


@pytest.mark.parametrize(
    "old, new, message",
    [
        ("kx [N/mm]", "k1 [N/mm]", "mounts.csv:2: 'k1' is unknown."),
        ("kx [N/mm]", "k1 [N/mm]", "mounts.csv:2: has no column 'kx'"),
        ("kx [N/mm]", "ky [N/mm]", "mounts.csv:2: has the column 'ky' twice"),
        ("kx [N/mm]", "kx", "mounts.csv:3 kx: is 200 without a unit"),
        (
            "kx [N/mm]",
            "kx [mm]",
            "mounts.csv:3 kx: is '200 mm', in m (allowed: a unit such as N/m)",
        ),
        ("kx [N/mm]", "kx [N/mn]", "mounts.csv:3 kx: unit 'N/mn' is unknown"),
        ("210; 400; ;", "210; soft; ;", "mounts.csv:4 kz: is 'soft'"),
        (
            "210; 400; ;",
            "210; -400; ;",
            "mounts.csv:4 Bushing.stiffness: has coefficients 200000, 210000, -400000",
        ),
        (
            "210; 400; ;",
            "210; ; ;",
            "mounts.csv:4 kz: is empty (allowed: a number). Write 0 if it is zero.",
        ),
        ("210; 400; ;", "210; 4 5; ;", "mounts.csv:4 kz: is '4 5'"),
        ("right; 100; ", "right; ", "mounts.csv:4: has 9 cells"),
        ("right;", "left;", "mounts.csv:4: 'left' is the name of a mount above"),
        ("right;", ";", "mounts.csv:4 name: is empty (allowed: a name)"),
        ("kx [N/mm]", "kx", "Write it in the heading, kx [N/m], or here, 200 N/m."),
        ("0.5; 0\n", "0,5; 0\n", "mounts.csv: has commas in its numbers"),
        (SHEET[22:], "", "mounts.csv: has no line of headings and lines of mounts"),
    ],
)
def test_problems_are_reported_with_their_line(old, new, message, tmp_path):
    assert old in SHEET
    with pytest.raises(jb.JaxbodyError) as error:
        jb.files.read_mounts(sheet(tmp_path, SHEET.replace(old, new, 1)), BODIES)
    assert message in str(error.value)


def test_an_unknown_body_is_named(tmp_path):
    text = "name,a,x [m],y [m],z [m],kx [N/m],ky [N/m],kz [N/m]\nm,engin,0,0,1,1,2,3\n"
    with pytest.raises(
        jb.JaxbodyError, match=r"mounts.csv:2: 'engin' is unknown. Did you mean 'engine'\?"
    ):
        jb.files.read_mounts(sheet(tmp_path, text), BODIES)


def test_bodies_of_empty_cells_are_those_without_columns(tmp_path):
    text = (
        "name,a,b,x [m],y [m],z [m],kx [N/m],ky [N/m],kz [N/m]\nm,,,0,0,1,1,2,3\n"
        "n,frame,world,0,0,1,1,2,3\n"
    )
    mounts = jb.files.read_mounts(sheet(tmp_path, text), BODIES)
    assert [mount.between for mount in mounts.values()] == [("engine", "frame"), ("frame", "world")]
