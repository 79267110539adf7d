"""MJCF and URDF files that others wrote: energies and dampers as MuJoCo computes them, what is left
out, problems with their lines."""

import re
from pathlib import Path

import numpy as np
import pytest

import jaxbody as jb
from jaxbody.files.interchange import mjcf_documents

mujoco = pytest.importorskip("mujoco")
gymnasium = pytest.importorskip("gymnasium")

import mujoco_states  # noqa: E402
from mutated_files import check_changed_text  # noqa: E402

ASSETS = Path(gymnasium.__file__).parent / "envs/mujoco/assets"
LEGS = {
    "contact of geoms",
    "armature of joints",
    "limits of joints",
    "actuator motor",
    "light",
    "camera",
    "asset texture",
    "asset material",
}
BUSY = "springs and dampers of several joints of one body that turns"
FILES = {  # what is left out
    "ant": LEGS | {"custom numeric"},
    "half_cheetah": LEGS,
    "hopper": LEGS | {"visual map"},
    "humanoid": LEGS | {"visual map", "tendons other than between two sites", BUSY},
    "inverted_double_pendulum": {
        "custom numeric",
        "contact of geoms",
        "limits of joints",
        "actuator motor",
    },
    "inverted_pendulum": {"contact of geoms", "limits of joints", "actuator motor"},
    "point": {"asset texture", "asset material", "light", "contact of geoms", "actuator motor"},
    "pusher_v5": {
        "light",
        "contact of geoms",
        "armature of joints",
        "limits of joints",
        "actuator motor",
    },
    "reacher": {"contact of geoms", "armature of joints", "limits of joints", "actuator motor"},
    "swimmer": LEGS - {"contact of geoms"} | {"density of the medium", "viscosity of the medium"},
    "walker2d_v5": LEGS,
}


def agree(model, m, rng, count=3):
    """T, V (from that of the reference pose) and R are MuJoCo's, to rounding of sums of some
    twenty terms."""
    states = list(mujoco_states.random_states(model, count, rng))
    theirs = np.array(
        [mujoco_states.energies(m, mujoco_states.put(model, state, m)) for state in states]
    )
    ours = np.array([mujoco_states.energies_here(model, state) for state in states])
    theirs[:, 1] -= theirs[0, 1]
    ours[:, 1] -= ours[0, 1]
    np.testing.assert_allclose(ours, theirs, rtol=1e-12, atol=1e-12 * np.abs(theirs).max())


@pytest.mark.parametrize("name", FILES)
def test_public_files_have_the_energies_that_mujoco_computes(name, rng):
    m = mujoco.MjModel.from_xml_path(str(ASSETS / f"{name}.xml"))
    read = jb.files.read_mjcf(ASSETS / f"{name}.xml")
    assert {each.what for each in read.left_out} == FILES[name]
    if BUSY in FILES[name]:
        for body in np.flatnonzero(m.body_jntnum > 1):
            joints = slice(m.body_jntadr[body], m.body_jntadr[body] + m.body_jntnum[body])
            m.jnt_stiffness[joints] = m.dof_damping[m.jnt_dofadr[joints]] = 0
    agree(read.model, m, rng)


def compiled(tmp_path, text, **others):
    """Our model of a file and MuJoCo's."""
    for name, content in {"model": text, **others}.items():
        (tmp_path / f"{name}.xml").write_text(f"<mujoco>{content}</mujoco>")
    return jb.files.read_mjcf(tmp_path / "model.xml"), mujoco.MjModel.from_xml_path(
        str(tmp_path / "model.xml")
    )


SHAPES = """<worldbody><body name="a"><freejoint/>
<geom type="sphere" size="0.1" pos="1 2 3"/>
<geom type="capsule" size="0.1 0.3" euler="20 30 40" density="700"/>
<geom type="cylinder" size="0.1" fromto="0 0 1 0 0 -1"/>
<geom type="box" size="0.1 0.2 0.3" zaxis="0.3 -0.2 -1"/>
</body><geom type="plane" size="1 1 1"/></worldbody>"""
KINDS = """<compiler angle="radian" eulerseq="XzY" settotalmass="20" autolimits="true"/>
<option gravity="1 2 -9"><flag energy="enable"/></option>
<default><joint damping="0.3"/><geom density="500"/><default class="soft"><joint stiffness="7" springref="0.2"/><site pos="0 0 0.1"/>
<tendon stiffness="11"/><default class="softer"><joint stiffness="3"/></default></default></default>
<worldbody><site name="high" pos="0 0 3"/>
<body name="shelf" pos="0.1 0.2 0.3" euler="0.3 0.2 0.1"><geom size="0.3"/>
 <body name="door" pos="0.5 0 0" childclass="soft"><joint name="hinge" axis="1 0.2 0" pos="0 0.1 0" ref="0.1"/>
  <geom type="box" size="0.1 0.2 0.3"/><site name="low"/>
  <body pos="0 0 -0.1" name="handle"><geom size="0.1"/>
   <frame pos="0.1 0 0" euler="0.1 0 0.3"><body name="knob" pos="0 0.2 0">
    <joint class="softer" type="slide" axis="0 1 1"/><geom size="0.05"/></body></frame></body></body></body>
 <body name="cart"><joint type="slide" axis="1 0 0" stiffness="5"/><joint type="slide" axis="1 1 0" damping="2" springref="0.3"/>
  <geom size="0.2"/>
  <body name="bob" pos="0 0 -1"><joint name="ball" type="ball" pos="0 0 1" stiffness="4" damping="0"/>
   <geom size="0.1"/><site name="of bob" pos="0.1 0 0"/></body></body>
<body name="fan" pos="0 2 0"><joint axis="1 0 0"/><body pos="0 0.1 0.3" euler="0.2 0 0.5"><geom type="box" size="0.1 0.2 0.3"/></body></body>
<include file="part.xml"/></worldbody><include file="motors.xml"/>
<tendon><spatial name="rope" class="soft" springlength="0 0.5"><site site="high"/><site site="low"/></spatial>
<spatial stiffness="9" damping="1.5"><site site="of bob"/><site site="low"/></spatial></tendon>"""  # noqa: E501
PART = """<body name="included" pos="1 0 0"><joint name="push" type="slide"/><joint name="turn" axis="0 1 0" stiffness="2"/>
<geom type="box" size="0.1 0.1 0.2" pos="0.1 0 0"/></body>"""  # noqa: E501
MOTORS = '<actuator>\n<motor joint="turn"/></actuator>'


def test_shapes_have_their_mass_and_inertia(tmp_path, rng):
    read, m = compiled(tmp_path, SHAPES)
    np.testing.assert_allclose(read.model["a"].mass, m.body_mass[1], rtol=1e-14)
    np.testing.assert_allclose(read.model["a"].com, m.body_ipos[1], rtol=1e-12)
    agree(read.model, m, rng)


def test_springs_of_all_kinds_of_joints_and_tendons(tmp_path, rng):
    read, m = compiled(tmp_path, KINDS, part=PART, motors=MOTORS)
    model = read.model
    assert model.layout.supports == ("shelf",) and isinstance(
        model.joint("included"), jb.joints.Composite
    )
    assert {each.what: each.where for each in read.left_out} == {
        "contact of geoms": "model.xml",
        BUSY: "part.xml:1",
        "actuator motor": "motors.xml:2",
    }
    # of the slide of a body that turns, which is left out
    m.dof_damping[m.jnt_dofadr[m.body("included").jntadr[0]]] = 0
    agree(model, m, rng, count=5)


PARTS = """<worldbody><geom name="floor" type="plane" size="1 1 1"/><body name="wall"><geom size="1"/>
<body name="a.b" pos="0 0 1"><joint type="slide" name="c"/><inertial mass="2" pos="0 0 0.1" diaginertia="1 2 2.5" quat="1 1 0 0"/>
<body pos="0 1 0"><geom size="0.1" mass="1"/></body>
<body name="hook" pos="0 0 1"><site name="s"/><site name="t"/></body>
</body></body></worldbody>
<tendon><fixed name="f"><joint joint="c" coef="1"/></fixed><spatial stiffness="2" springlength="0.1 0.2"><site site="s"/><site site="t"/></spatial>
<spatial><site site="s"/><site site="t"/></spatial></tendon><actuator><motor joint="c"/></actuator>"""  # noqa: E501


def test_bodies_without_joints_are_supports_fixed_or_parts(tmp_path, rng):
    read, m = compiled(tmp_path, PARTS)
    model = read.model
    assert model.layout.supports == ("wall",) and model.layout.bodies == ("a_b", "body 3")
    assert isinstance(model.joint("body 3"), jb.Fixed) and model["a_b"].mass == 2
    left_out = {each.what: each.where for each in read.left_out}
    assert left_out == {  # without a line where the file gives no name
        "contact of geoms": "model.xml",
        "the name 'a.b', here 'a_b'": "model.xml:2",
        "tendons other than between two sites": "model.xml:6",
        "tendons with a dead band above zero": "model.xml",
        "tendons without stiffness and damping": "model.xml",
        "actuator motor": "model.xml:7",
    }
    assert re.search(r"contact of geoms +3 +model.xml", str(read))
    state = jb.State(np.array([0.3]), np.array([2.0]))
    d = mujoco.MjData(m)
    d.qpos[:], d.qvel[:] = state.q, state.v
    mujoco.mj_forward(m, d)
    np.testing.assert_allclose(
        mujoco_states.energies_here(model, state)[0], mujoco_states.energies(m, d)[0], rtol=1e-14
    )


def test_what_is_complete_says_so(tmp_path):
    (tmp_path / "m.xml").write_text(
        '<mujoco><worldbody><body><joint/><inertial mass="1" pos="0 0 0" diaginertia="1 1 '
        '1"/></body></worldbody></mujoco>'
    )
    read = jb.files.read_mjcf(tmp_path / "m.xml")
    assert read.left_out == () and "nothing" in str(read)


BALL = '<geom size="0.1"/>'


@pytest.mark.parametrize(
    "text, messages",
    [
        (
            "<worldbody>\n<body><joint stiffness='-3' name='j'/>{}</body>\n"
            "<body><joint stiffness='-4' name='k'/>{}</body></worldbody>",
            ["2 problems", "model.xml:2 ", "-3", "model.xml:3 ", "-4", "NEGATIVE"],
        ),
        (
            "<worldbody>\n<body name='b'><joint type='ball'/><joint type='slide'/>{}</body>"
            "</worldbody>",
            ["model.xml:2 joint: is a ball joint, one of several", "WRONG_KIND"],
        ),
        (
            "<worldbody>\n<body><joint stiffness='soft'/>{}</body></worldbody>",
            ["refused by MuJoCo's compiler: XML Error: bad format", "line 2", "UNREADABLE"],
        ),
        (
            "<worldbody>\n<body name='b'><joint/></body></worldbody>",
            ["mass and inertia of moving bodies", "Element name 'b'", "line 2", "UNREADABLE"],
        ),
        ("<include file='../x.xml'/>", ["model.xml:1: names '../x.xml'", "OUTSIDE_FOLDER"]),
        (
            "<include file='/etc/passwd'/>\n<include file='../x.xml'/>",
            ["model.xml:1: names '/etc/passwd'", "model.xml:2: names", "OUTSIDE_FOLDER"],
        ),
        ("<compiler meshdir='/etc'/>", ["model.xml:1: names '/etc'", "OUTSIDE_FOLDER"]),
        (
            "<asset>\n<model name='arm' file='arm.xml'/></asset>",
            ["model.xml:2: names", "arm.xml'", "OUTSIDE_FOLDER"],
        ),
        ("<include file='model.xml'/>", ["'model.xml' already included", "UNREADABLE"]),
        ("<include file='none.xml'/>", ["none.xml", "NO_FILE"]),
        ("<worldbody>\n<body></worldbody>", ["model.xml:2: mismatched tag.", "SYNTAX"]),
        ("<worldbody>" + 250 * "<body>", ["nested too deep (allowed: 200 levels)", "TOO_LARGE"]),
    ],
)
def test_problems_have_their_line(text, messages, tmp_path):
    (tmp_path / "model.xml").write_text(f"<mujoco>{text.replace('{}', BALL)}</mujoco>")
    with pytest.raises(jb.JaxbodyError) as raised:
        jb.files.read_mjcf(tmp_path / "model.xml")
    for message in messages:
        assert message in str(raised.value)


@pytest.mark.parametrize(
    "content, code",
    [
        ("<sdf/>", "WRONG_FORMAT"),
        (
            '<!DOCTYPE x [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "&a;&a;&a;">]><mujoco>&b;</mujoco>',
            "WRONG_KIND",
        ),
        (
            '<!DOCTYPE x [<!ENTITY a SYSTEM "file:///etc/passwd">]><mujoco>&a;</mujoco>',
            "WRONG_KIND",
        ),
        ('<?xml version="1.0" encoding="latin-1"?><mujoco model="\xe9"/>', "SYNTAX"),
        ("", "EMPTY_FILE"),
    ],
)
def test_files_of_another_kind(content, code, tmp_path):
    (tmp_path / "model.xml").write_text(content, encoding="latin-1")
    with pytest.raises(jb.JaxbodyError) as raised:
        jb.files.read_mjcf(tmp_path / "model.xml")
    assert raised.value.code == code


BOWL = """<worldbody><body name="bowl"><freejoint/><geom size=".1" mass="1"/>
<replicate count="4" euler="0 0 90"><geom size=".05" pos=".5 0 0" mass="2"/></replicate></body></worldbody>"""  # noqa: E501
TETRAHEDRON = "v 0 0 0\nv 0.6 0 0\nv 0 0.6 0\nv 0 0 0.6\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
MESH = """<asset><mesh name="m" file="{}"/></asset>
<worldbody><body name="stone"><freejoint/><geom type="mesh" mesh="m" density="2000"/></body></worldbody>"""  # noqa: E501


def test_what_is_replicated_has_its_mass(tmp_path):
    """Five balls of 1 kg and 4 times 2 kg, these 0.5 m from the axis."""
    read, _ = compiled(tmp_path, BOWL)
    bowl = read.model["bowl"]
    np.testing.assert_allclose(bowl.mass, 9.0, rtol=1e-14)
    np.testing.assert_allclose(
        bowl.inertia[2, 2], 0.4 * (1 * 0.1**2 + 8 * 0.05**2) + 8 * 0.5**2, rtol=1e-12
    )


def test_a_mesh_beside_the_file_has_mass_and_one_elsewhere_is_not_read(tmp_path):
    """A tetrahedron with three edges at right angles of the length a has the volume a^3/6 and its
    center at a/4."""
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "m.obj").write_text(TETRAHEDRON)
    read, _ = compiled(tmp_path / "models", MESH.format("m.obj"))
    # MuJoCo's meshes are of 32 bits
    np.testing.assert_allclose(read.model["stone"].mass, 2000 * 0.6**3 / 6, rtol=1e-6)
    (tmp_path / "m.obj").write_text(TETRAHEDRON)
    for name in ("../m.obj", str(tmp_path / "m.obj")):
        with pytest.raises(jb.JaxbodyError, match=r"model.xml:1: names .*OUTSIDE_FOLDER"):
            compiled(tmp_path / "models", MESH.format(name))
    with pytest.raises(jb.JaxbodyError, match=r"opening file 'n.obj'. \[UNREADABLE\]"):
        compiled(tmp_path / "models", MESH.format("n.obj"))


URDF = """<robot name="arm"><link name="base"/>
<link name="rod"><inertial><origin xyz="0 0 -0.4" rpy="0.1 0 0"/><mass value="3"/>
 <inertia ixx="0.2" iyy="0.25" izz="0.1" ixy="0.01" ixz="0" iyz="0"/></inertial>
 <visual><geometry><mesh filename="package://arm/rod.stl"/></geometry></visual></link>
<joint name="pivot" type="revolute"><parent link="base"/><child link="rod"/><origin xyz="0 0 1" rpy="0 0 0"/><axis xyz="0 1 0"/>
 <limit lower="-1" upper="1" effort="5" velocity="2"/><dynamics damping="0.7"/></joint></robot>"""  # noqa: E501


def test_a_urdf_is_read_by_mujoco(tmp_path):
    """The moment about the pivot: that about the center of mass, turned by 0.1 about x, and m l^2;
    meshes are not looked for."""
    (tmp_path / "arm.urdf").write_text(URDF)
    read = jb.files.read_mjcf(tmp_path / "arm.urdf")
    rod, hinge = read.model["rod"], read.model.joint("rod")
    turn = np.array([[1, 0, 0], [0, np.cos(0.1), -np.sin(0.1)], [0, np.sin(0.1), np.cos(0.1)]])
    np.testing.assert_allclose(
        rod.inertia, turn @ [[0.2, 0.01, 0], [0.01, 0.25, 0], [0, 0, 0.1]] @ turn.T, atol=1e-12
    )
    np.testing.assert_allclose(rod.com, [0, 0, -0.4], atol=1e-15)
    assert isinstance(hinge, jb.Hinge) and [each.what for each in read.left_out] == [
        "limits of joints"
    ]
    lin = jb.linearize(read.model, read.model.reference)
    np.testing.assert_allclose(
        lin.M,
        turn[1] @ [[0.2, 0.01, 0], [0.01, 0.25, 0], [0, 0, 0.1]] @ turn[1] + 3 * 0.4**2,
        rtol=1e-12,
    )
    np.testing.assert_allclose(lin.C, 0.7, rtol=1e-14)


@pytest.mark.parametrize(
    "program, message",
    [
        ("import os, signal\nos.kill(os.getpid(), signal.SIGKILL)", "with the exit code -9"),
        ("import time\ntime.sleep(60)", "more than 2 s"),
    ],
)
def test_a_compiler_that_crashes_or_never_ends_is_an_error(program, message, tmp_path, monkeypatch):
    process = tmp_path / "mujoco_process.py"
    process.write_text(program)
    monkeypatch.setattr(mjcf_documents, "__file__", str(process))
    monkeypatch.setattr(mjcf_documents, "LONGEST", 2.0)
    (tmp_path / "arm.urdf").write_text(URDF)
    with pytest.raises(jb.JaxbodyError, match=rf"{message}.*UNREADABLE"):
        jb.files.read_mjcf(tmp_path / "arm.urdf")


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_mutated_files_are_models_or_clear_errors(tmp_path):
    for name, content in {"model": KINDS, "part": PART, "motors": MOTORS}.items():
        (tmp_path / f"{name}.xml").write_text(f"<mujoco>{content}</mujoco>")
    assert 10 < check_changed_text(tmp_path / "model.xml", 100, jb.files.read_mjcf) < 90
