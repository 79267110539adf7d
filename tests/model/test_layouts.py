"""A layout asks only the blocks of its coordinates: a row of joints, and of an owner that is no
joint and has states of its own."""

import jax.numpy as jnp
import numpy as np

from jaxbody.model.joints.joints import Ball, Free, Guide, Hinge
from jaxbody.model.layouts import CoordinateBlock, Layout
from jaxbody.model.states import State

JOINTS = {
    "top": Ball("base"),
    "arm": Hinge("top", axis=[0, 0, 1]),
    "box": Free(),
    "sled": Guide("arm", axis=[1, 0, 0]),
}
MOUNT = CoordinateBlock(
    "mount", object, ("flow of the fluid",), ("m",), ("m/s",), states=("branch 1", "branch 2")
)
LAYOUT = Layout(
    tuple(JOINTS),
    ("base",),
    tuple(joint.parent for joint in JOINTS.values()),
    (*(j.block(name) for name, j in JOINTS.items()), MOUNT),
)


def test_sizes_slices_labels_and_units():
    assert (LAYOUT.nq, LAYOUT.nv, LAYOUT.nz, LAYOUT.nxi) == (
        4 + 1 + 7 + 1 + 1,
        3 + 1 + 6 + 1 + 1,
        2,
        6,
    )
    assert LAYOUT.q_slices["box"] == slice(5, 12) and LAYOUT.v_slices["mount"] == slice(11, 12)
    assert LAYOUT.q_units == ("",) * 4 + ("rad",) + ("m",) * 3 + ("",) * 4 + ("m", "m")
    assert LAYOUT.v_units == ("rad/s",) * 4 + ("m/s",) * 3 + ("rad/s",) * 3 + ("m/s", "m/s")
    assert LAYOUT.coordinates[-2:] == ("sled move along its guide", "mount flow of the fluid")
    assert np.flatnonzero(~LAYOUT.turns).tolist() == [4, 5, 6, 10, 11]
    assert np.flatnonzero(~LAYOUT.angular).tolist() == [5, 6, 7, 12, 13]


def test_a_state_is_packed_and_unpacked_with_normalized_quaternions():
    q, v, z = (jnp.asarray(np.random.default_rng(3).normal(size=n)) for n in (14, 12, 2))
    state = LAYOUT.unpack(LAYOUT.pack(State(q, v, z)))
    expected = np.array(q)
    for quaternion in (slice(0, 4), slice(8, 12)):
        expected[quaternion] /= np.linalg.norm(expected[quaternion])
    assert np.abs(state.q - expected).max() < 1e-15
    assert (state.v == v).all() and (state.z == z).all()


def test_rows_of_owners_are_split_and_joined():
    v = jnp.arange(12.0)
    order = [("sled", "arm"), ("mount",), ("box",), ("top",)]
    pieces = [(owners, LAYOUT.rows_of(owners, v, LAYOUT.v_slices)) for owners in order]
    assert pieces[0][1].tolist() == [[10.0], [3.0]]
    assert (LAYOUT.joined(pieces) == v).all()


def test_frames_that_others_carry():
    assert LAYOUT.chains["sled"] == ("sled", "arm", "top", "base")
    assert LAYOUT.depths == {"top": 0, "arm": 1, "box": 0, "sled": 2}
    assert LAYOUT.frames == ("world", "base", "top", "arm", "box", "sled")
    carried = {
        name: [other for other, one in zip(LAYOUT.frames, row, strict=True) if one]
        for name, row in zip(LAYOUT.frames, LAYOUT.carries, strict=True)
    }
    assert (
        carried["base"] == ["base", "top", "arm", "sled"]
        and carried["arm"] == ["arm", "sled"]
        and carried["world"] == ["world", "box"]
    )
