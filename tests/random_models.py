"""Random models of every kind of body, joint, element and law, as strategies of hypothesis."""

import hypothesis.strategies as st
import numpy as np
from hypothesis import reject

import jaxbody as jb
from jaxbody.files.kinds import CLOSURES, ELEMENTS, JOINTS
from jaxbody.geometry import rotations
from jaxbody.geometry.closures import AlongAxis

NUMBERS = st.floats(-1e9, 1e9, allow_subnormal=True) | st.sampled_from(
    [-0.0, 5e-324, 1e-300, 0.1, 1 / 3]
)
above_zero = st.floats(1e-9, 1e9)
below_one = st.floats(0, 1)
turns = (
    st.lists(st.floats(-1, 1), min_size=4, max_size=4)
    .filter(lambda q: np.linalg.norm(q) > 0.1)
    .map(lambda q: q / np.linalg.norm(q))
)
names = st.text(
    st.characters(exclude_categories=["C", "Z"], exclude_characters=".*?[]"), min_size=1, max_size=6
)
curves = (
    st.lists(above_zero, min_size=4, max_size=9)
    .map(np.cumsum)
    .filter(lambda x: (np.diff(x) > 0).all())
)
SIMPLE_LAWS = st.one_of(
    st.builds(jb.laws.Linear, above_zero),
    st.builds(jb.laws.Polynomial, st.lists(NUMBERS, min_size=1, max_size=4)),
    st.builds(
        jb.laws.BumpStop,
        gap=above_zero,
        stiffness=above_zero,
        engagement=above_zero,
        extension=st.booleans(),
    ),
    st.builds(jb.laws.TensionOnly, above_zero),
    st.builds(jb.laws.AirSpring, pressure=above_zero, area=above_zero, height=above_zero),
    st.builds(jb.laws.Digressive, slow=above_zero, fast=above_zero, knee=above_zero),
    st.builds(jb.laws.Friction, level=above_zero, velocity=above_zero),
    curves.map(lambda x: jb.laws.Tabulated(x, x)),
)
SOME_LAWS = SIMPLE_LAWS | st.builds(jb.laws.TwoSided, bump=SIMPLE_LAWS, rebound=SIMPLE_LAWS)
SOME_LAWS = (
    st.none()
    | SOME_LAWS
    | st.lists(SOME_LAWS, min_size=1, max_size=3).map(lambda laws: jb.laws.Sum(*laws))
)


WITH_POTENTIAL = [kind for kind in ELEMENTS if not issubclass(kind, jb.ForceElement)]


def inertia(moments, q):
    R = np.asarray(rotations.matrix(np.asarray(q)))
    a, b, c = moments
    return R @ np.diag([a + b, b + c, c + a]) @ R.T


def sine(a, b):
    """Of the angle between two directions."""
    a, b = (np.array(x) / np.abs(x).max() for x in (a, b))
    return np.linalg.norm(np.cross(a, b)) / np.linalg.norm(a) / np.linalg.norm(b)


@st.composite
def models(draw, numbers=NUMBERS):
    """The arguments of a Model; points are made of `numbers`."""
    points = st.lists(numbers, min_size=3, max_size=3)
    directions = points.filter(lambda x: np.linalg.norm(x) > 1e-100)
    crossed = st.tuples(directions, directions).filter(lambda pair: sine(*pair) > 1e-3)
    body_names = draw(st.lists(names, min_size=2, max_size=4, unique=True))
    *body_names, support = body_names
    size = st.floats(0.1, 10)
    bodies = {
        name: jb.Body(
            mass=draw(above_zero),
            inertia=inertia(draw(st.tuples(size, size, size)), draw(turns)),
            com=draw(points), position=draw(points), orientation=draw(turns),
        )
        for name in body_names
    }  # fmt: skip
    joints = {}
    for i, name in enumerate(body_names):
        kind, parent = (
            draw(st.sampled_from([None, *JOINTS])),
            draw(st.sampled_from(["world", support, *body_names[:i]])),
        )
        more = (
            {"axis": draw(directions)}
            if kind in (jb.Guide, jb.Hinge, jb.joints.Cylindrical)
            else {}
        )
        more |= (
            {"at": draw(st.none() | points)}
            if kind in (jb.Hinge, jb.Ball, jb.joints.Universal, jb.joints.Cylindrical)
            else {}
        )
        if kind in (jb.joints.Universal, jb.joints.Planar):
            more |= dict(zip(("first", "second"), draw(crossed), strict=True))
        if kind is jb.joints.Composite:
            steps = draw(st.lists(st.sampled_from(["move", "turn"]), min_size=1, max_size=3))
            more = {
                "steps": steps,
                "directions": [draw(directions) for _ in steps],
                "points": [draw(points) for _ in steps],
            }
        if kind is not None:
            joints[name] = kind(parent, **more)

    def end(owners):
        return draw(st.sampled_from(owners)), draw(points)

    def element(kind):
        frames = draw(st.permutations([*body_names, support, "world"]))
        a, b, c = end(frames[:1]), end(frames[1:2]), end(frames[2:3])
        stiffness = {"stiffness": draw(above_zero), "damping": draw(above_zero)}
        if kind is jb.Spring:
            return kind(a, b, **stiffness, free_length=draw(above_zero))
        if kind is jb.Bushing:
            k = draw(st.lists(above_zero, min_size=6, max_size=6))
            full = draw(st.booleans())
            return kind(
                a,
                b,
                stiffness=np.diag(k) if full else k[:3],
                orientation=draw(turns),
                orientation_b=draw(turns),
            )
        if kind is jb.Contact:
            return kind(a, b, distance=draw(above_zero), **stiffness)
        if kind is jb.Tyre:
            return kind(a, b, radius=draw(above_zero), axis=draw(directions), **stiffness)
        if kind is jb.Inerter:
            return kind(a, b, inertance=draw(above_zero))
        both = {"spring": draw(SOME_LAWS), "damper": draw(SOME_LAWS)}
        if kind is jb.SpringDamper:
            return kind(a, b, **both, free_length=draw(above_zero))
        if kind is jb.Torsion:
            return kind(a, b, axis=draw(directions), free_angle=draw(below_one), **both)
        if kind is jb.Mount:
            damping = draw(st.lists(above_zero, min_size=6, max_size=6))
            return kind(
                a,
                b,
                x=draw(SOME_LAWS),
                ry=draw(SOME_LAWS),
                damping=damping,
                orientation=draw(turns),
                orientation_b=draw(turns),
            )
        return kind(a, b, c, axis=draw(directions), **both)

    kinds = draw(st.lists(st.sampled_from(WITH_POTENTIAL), max_size=4))
    return {
        "bodies": bodies,
        "supports": {support: jb.Support(draw(points), draw(turns))},
        "joints": joints,
        "elements": {f"element {i}": element(kind) for i, kind in enumerate(kinds)},
        "gravity": draw(points),
    }


@st.composite
def models_with_closures(draw):
    """The arguments of a Model with closures of every kind."""
    parts = draw(models(st.floats(-10, 10)))
    points = st.lists(st.floats(-10, 10), min_size=3, max_size=3)
    directions = points.filter(lambda x: np.linalg.norm(x) > 1e-3)
    frames = [*parts["bodies"], *parts["supports"], "world"]
    try:
        layout = jb.Model(**parts).layout
    except jb.JaxbodyError:  # such as a spring of length zero
        reject()
    coordinates = list(layout.coordinate_places)

    def closure(kind):
        if kind is jb.closures.Coupling:
            of, by = draw(
                st.lists(st.sampled_from(coordinates), min_size=2, max_size=2, unique=True)
            )
            law = draw(
                st.none()
                | SIMPLE_LAWS
                | st.lists(SIMPLE_LAWS, min_size=2, max_size=3).map(lambda laws: jb.laws.Sum(*laws))
            )
            return kind(of, by, ratio=draw(NUMBERS)) if law is None else kind(of, by, function=law)
        names = draw(st.lists(st.sampled_from(frames), min_size=2, max_size=2, unique=True))
        more = {"axis": draw(directions)} if issubclass(kind, AlongAxis) else {}
        more |= {"length": draw(st.none() | above_zero)} if kind is jb.closures.Rod else {}
        return kind(*zip(names, (draw(points), draw(points)), strict=True), **more)

    known = [kind for kind in CLOSURES if kind is not jb.closures.Coupling or len(coordinates) > 1]
    kinds = draw(st.lists(st.sampled_from(known), min_size=1, max_size=4))
    return parts | {"closures": {f"closure {i}": closure(kind) for i, kind in enumerate(kinds)}}
