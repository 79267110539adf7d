"""Models written as MJCF: MuJoCo simulates the same motion, and what is read again is the
same model."""

import sys

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs

import jaxbody as jb
from jaxbody import presets

mujoco = pytest.importorskip("mujoco")

import mujoco_states  # noqa: E402

BOX = {"mass": 2.0, "inertia": [0.10, 0.16, 0.20, 0.01, -0.02, 0.015], "com": [0.05, -0.02, 0.03]}
ARM = jb.Support([0.1, 0, 0.3], jb.EulerAngles("ZYX", [0.5, 0.2, 0.1]))
TURNED = jb.Body(
    **BOX, position=[0.1, 0.2, -0.5], orientation=jb.EulerAngles("XYZ", [0.4, -0.3, 0.2])
)
ON_ARM = mujoco_states.multiplied(ARM.orientation * np.array([1, -1, -1, -1]), TURNED.orientation)
G = [0.3, 0, -9.8]


def ball():
    """A box on a ball joint on a turned support, with a spring about all axes and a rope that
    becomes slack."""
    at = np.array([0, 0.1, 0.1])
    on_box = rigs.turned(TURNED.orientation).T @ (
        rigs.turned(ARM.orientation) @ at + ARM.position - TURNED.position
    )
    rubber = jb.Bushing(
        ("arm", at),
        ("box", on_box),
        stiffness=np.diag([0, 0, 0, 5.0, 5.0, 5.0]),
        orientation=ON_ARM,
    )
    rope = jb.SpringDamper(
        ("box", [0.2, 0.1, 0]),
        ("world", [0.3, -0.2, 0.2]),
        spring=jb.laws.TensionOnly(300.0),
        free_length=0.95,
    )
    return jb.Model(
        bodies={"box": TURNED},
        supports={"arm": ARM},
        joints={"box": jb.Ball("arm", at=at)},
        elements={"rubber": rubber, "rope": rope},
        gravity=G,
    )


def crane():
    """A trolley that moves in a plane on springs, and a load that turns about two axes on it; all
    axes are oblique to the bodies'."""
    plane = jb.joints.Composite(
        "arm", ["move", "move"], directions=[[1, 0.2, 0], [-0.2, 1, 0]], points=np.zeros((2, 3))
    )
    swing = jb.joints.Composite(
        "trolley",
        ["turn", "turn"],
        directions=[[1, 0, 0.3], [0, 1, 0]],
        points=[[0, 0, 0.1], [0, 0.1, 0]],
    )
    along = mujoco_states.multiplied(
        [np.cos(np.arctan(0.2) / 2), 0, 0, np.sin(np.arctan(0.2) / 2)], [1, 0, 0, 0]
    )
    across = mujoco_states.multiplied(ON_ARM * [1, -1, -1, -1], along)
    rails = jb.Bushing(
        ("arm", [0.02, 0.3, 0]),
        ("trolley", [0, 0, 0]),
        stiffness=[40, 70, 0],
        damping=[1, 2, 0],
        orientation=along,
        orientation_b=across,
    )
    return jb.Model(
        bodies={
            "trolley": TURNED,
            "load": jb.Body(0.7, [0.02, 0.03, 0.04], position=[0.1, 0.3, -1.2]),
        },
        supports={"arm": ARM},
        joints={"trolley": plane, "load": swing},
        elements={
            "rails": rails,
            "rod": jb.Spring(
                ("load", [0, 0, 0]), ("world", [0.2, 0, -2]), stiffness=30.0, damping=0.5
            ),
        },
        gravity=G,
    )


def flap():
    """A flap on a hinge whose spring is relaxed elsewhere, a weight fixed to it, and a slider on it
    with a spring."""
    weight = jb.Body(
        0.2, [0.001, 0.001, 0.001], position=[0.2, 0.3, -0.6], orientation=TURNED.orientation
    )
    slider = jb.Body(
        0.5, [0.01, 0.01, 0.01], position=[0.15, 0.2, -0.6], orientation=TURNED.orientation
    )
    hinge = jb.Torsion(
        "flap",
        "arm",
        axis=[0, 0, 1],
        spring=6.0,
        damper=0.2,
        free_angle=0.3,
        orientation=[0, 1, 0, 0],
        orientation_b=[0, 1, 0, 0],
    )
    return jb.Model(
        bodies={
            "flap": jb.Body(**BOX, position=[0.1, 0.2, -0.5], orientation=ARM.orientation),
            "weight": weight,
            "slider": slider,
        },
        supports={"arm": ARM},
        joints={
            "flap": jb.Hinge("arm", axis=[0, 0, -1], at=[0, 0.2, 0]),
            "weight": jb.Fixed("flap"),
            "slider": jb.Guide("flap", axis=[1, 1, 0]),
        },
        elements={
            "hinge": hinge,
            "spring": jb.Spring(
                ("slider", [0, 0, 0]),
                ("flap", [0.5, 0.5, 0]),
                stiffness=90.0,
                free_length=0.5,
                damping=1.0,
            ),
        },
        gravity=G,
    )


def shafts():
    """A puck on a turned support, a yoke on a universal joint on it, and a shaft that slides and
    turns in the yoke."""
    joints = {
        "puck": jb.joints.Planar("arm", first=[1, 0.2, 0], second=[-0.1, 1, 0.1]),
        "yoke": jb.joints.Universal(
            "puck", first=[0, 1, 0.2], second=[1, 0, 0], at=[0.1, 0.1, -0.2]
        ),
        "shaft": jb.joints.Cylindrical("yoke", axis=[0, 0.2, 1], at=[0.02, 0, 0]),
    }
    ends = {"puck": [0.3, 0.3, 0.1], "yoke": [-0.2, 0.1, -1.4], "shaft": [0.4, 0.1, -0.6]}
    light = {"mass": 0.7, "inertia": [0.02, 0.03, 0.04]}
    return jb.Model(
        bodies={
            "puck": TURNED,
            "yoke": jb.Body(**light, position=[0.1, 0.3, -0.9]),
            "shaft": jb.Body(**light, position=[0.1, 0.35, -1.0]),
        },
        supports={"arm": ARM},
        joints=joints,
        elements={
            f"{name} spring": jb.Spring(
                (name, [0, 0, 0]), ("world", at), stiffness=40.0, damping=0.5
            )
            for name, at in ends.items()
        },
        gravity=G,
    )


MODELS = {
    "plate": lambda: rigs.plate(damping=1.0),
    "rig": rigs.rig,
    "quarter car": lambda: presets.quarter_car(damping=1500.0, tyre_damping=50.0),
    "half car": presets.half_car,
    "Stewart table": presets.stewart_table,
    "elastic pendulum": presets.elastic_pendulum,
    "double pendulum": presets.double_pendulum,
    "gliders": lambda: presets.coupled_gliders(damping=(0.1, 0.0, 0.2)),
    "ball": ball,
    "crane": crane,
    "flap": flap,
    "shafts": shafts,
}


@pytest.fixture(scope="module", params=MODELS)
def written(request, tmp_path_factory):
    """A model, and its file."""
    model, path = MODELS[request.param](), tmp_path_factory.mktemp("mjcf") / "model.xml"
    jb.files.write_mjcf(model, path)
    return model, path


def by_mujoco(model, path, start, times, step):
    """Positions and rotation matrices of the bodies at these times."""
    m = mujoco.MjModel.from_xml_path(str(path))
    m.opt.timestep = step
    d, places = mujoco_states.put(model, start, m), []
    for time in times:
        while d.time < time - step / 2:
            mujoco.mj_step(m, d)
        mujoco.mj_kinematics(m, d)
        places.append(
            [np.concatenate([d.body(body).xpos, d.body(body).xmat]) for body in model.layout.bodies]
        )
    return np.array(places)


@pytest.mark.long
def test_mujoco_simulates_the_same_motion(written, rng):
    """To the error of MuJoCo's integration, which is at most the change by halving its step; 1e-10:
    the tolerance of ours."""
    model, path = written
    q = jb.joints.retract(model, model.reference.q, 0.02 * rng.normal(size=model.layout.nv))
    start, times = (
        jb.State(q, jnp.array(0.2 * rng.normal(size=model.layout.nv))),
        np.linspace(0.0, 0.8, 5),
    )
    poses = jb.simulate(model, times, initial=start, rtol=1e-12).poses
    ours = np.stack(
        [
            np.concatenate([poses[body].p, poses[body].R.reshape(-1, 9)], -1)
            for body in model.layout.bodies
        ],
        1,
    )
    coarse, fine = (by_mujoco(model, path, start, times, step) for step in (0.001, 0.0005))
    moved = np.abs(ours - ours[0]).max()
    assert moved > 0.02 and np.abs(coarse - fine).max() < 1e-4 * moved
    assert np.abs(ours - fine).max() <= np.abs(coarse - fine).max() + 1e-10


def test_writing_does_not_need_mujoco(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "mujoco", None)
    jb.files.write_mjcf(presets.quarter_car(), tmp_path / "car.xml")
    assert 'name="tyre"' in (tmp_path / "car.xml").read_text()


@pytest.mark.long
def test_what_is_read_again_is_the_same(written, rng):
    """Energies at some states; the order of the bodies may be another."""
    model, path = written
    read = jb.files.read_mjcf(path)
    # a bushing along two slides becomes two
    assert read.left_out == () and set(read.model.names) >= set(model.names)
    states = list(mujoco_states.random_states(model, 3, rng))
    again = [
        mujoco_states.energies_here(read.model, mujoco_states.reordered(state, model, read.model))
        for state in states
    ]
    here = np.array([mujoco_states.energies_here(model, state) for state in states])
    np.testing.assert_allclose(again, here, rtol=1e-12, atol=1e-12 * np.abs(here).max())


def test_bodies_and_springs_keep_their_numbers(tmp_path):
    jb.files.write_mjcf(rigs.plate(damping=1.0), tmp_path / "plate.xml")
    plate, again = rigs.plate(damping=1.0), jb.files.read_mjcf(tmp_path / "plate.xml").model
    for name in ("plate", "s3"):
        for leaf, same in zip(
            jax.tree.leaves(plate[name]), jax.tree.leaves(again[name]), strict=True
        ):
            # of principal axes and of a division by the mass
            np.testing.assert_allclose(same, leaf, rtol=2e-15)
    np.testing.assert_array_equal(plate.gravity, again.gravity)


BODY, ENDS = jb.Body(1.0, [1, 1, 1]), (("body", [0, 0, 0]), ("world", [0, 0, 1]))


@pytest.mark.long
@pytest.mark.parametrize(
    "parts, messages",
    [
        (
            {
                "elements": {
                    "s": jb.SpringDamper(
                        *ENDS, spring=jb.laws.Polynomial([1.0, 2.0]), free_length=1.0
                    )
                }
            },
            ["elements['s']: has a law that is not linear", "ropes"],
        ),
        (
            {"elements": {"m": jb.Bushing(*ENDS, stiffness=[1, 2, 3])}},
            ["elements['m']: is a Bushing that is no spring of a joint"],
        ),
        (
            {
                "elements": {"t": jb.Torsion("body", "world", axis=[1, 0, 0], spring=2.0)},
                "joints": {"body": jb.Hinge("world", axis=[0, 0, 1])},
            },
            ["elements['t']: is a Torsion that is no spring of a joint", "about that of a hinge"],
        ),
        (
            {
                "elements": {
                    name: jb.Torsion("body", "world", axis=[1, 0, 0], spring=2.0) for name in "tu"
                },
                "joints": {"body": jb.Hinge("world", axis=[1, 0, 0])},
            },
            ["elements['u']: is a second spring of a joint"],
        ),
        (
            {"elements": {"c": jb.Tyre(*ENDS, stiffness=1e3, radius=0.3)}},
            ["elements['c']: has the type Tyre"],
        ),
        (
            {"bodies": {"body": BODY, "rider": BODY}, "joints": {"rider": jb.Free("body")}},
            ["joints['rider']: is Free on 'body'"],
        ),
        (
            {
                "bodies": {"body": jb.Body(1.0, [0, 0, 0])},
                "joints": {"body": jb.Guide("world", axis=[0, 0, 1])},
            },
            ["bodies['body']: has the smallest principal moment 0 kg m2", "NOT_POSITIVE"],
        ),
    ],
)
def test_what_mjcf_does_not_have_is_refused_by_name(parts, messages, tmp_path):
    with pytest.raises(jb.JaxbodyError) as raised:
        jb.files.write_mjcf(jb.Model(**{"bodies": {"body": BODY}, **parts}), tmp_path / "model.xml")
    for message in messages:
        assert message in str(raised.value)
    assert not list(tmp_path.iterdir())
