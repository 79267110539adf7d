"""Models that other programs judge, each built once: trees of every joint, springs of every kind,
moving supports, closures, memory."""

import functools

import numpy as np
import pytest

import jaxbody as jb
from jaxbody import presets

G = [0.4, -0.3, -9.7]
TILT = jb.EulerAngles("ZYX", [0.5, 0.2, 0.1])
MODELS = {}


def judged(build):
    """Enter a function that builds a model, under its name, called with random numbers of
    its own."""

    @functools.cache
    def model():
        return build(np.random.default_rng(sum(map(ord, build.__name__))))

    MODELS[build.__name__] = model
    return build


def body(rng, mass=2.0, size=0.3, **where):
    """A body of random mass and inertia, its center of mass off O."""
    A = size * rng.normal(size=(3, 3))
    # second moments of a mass distribution, so that no moment exceeds the sum of the others
    J = A @ A.T
    mass = mass * rng.uniform(0.5, 2)
    return jb.Body(
        mass=mass,
        inertia=mass * (np.trace(J) * np.eye(3) - J),
        com=0.3 * size * rng.normal(size=3),
        **where,
    )


def turn(rng):
    q = rng.normal(size=4)
    return q / np.linalg.norm(q)


def point(rng, size=0.3):
    return size * rng.normal(size=3)


def spring(rng, one, other, far=1.0, **more):
    """A spring with a damper between random points, those on the second frame far away."""
    numbers = {
        "stiffness": rng.uniform(50, 200),
        "free_length": rng.uniform(0.3, 0.8) * far,
        "damping": rng.uniform(0.5, 2),
    } | more
    return jb.Spring((one, point(rng)), (other, point(rng, far)), **numbers)


def six_by_six(rng, k=100.0):
    """Positive definite, as a stiffness or damping of translation and rotation."""
    A = rng.normal(size=(6, 6))
    scale = np.array([1, 1, 1, 0.3, 0.3, 0.3])
    return k * scale[:, None] * (A @ A.T / 6 + np.eye(6)) * scale


BASE = {"base": jb.Support([0.2, -0.1, 0.3], TILT)}


@judged
def tumbling_body(rng):
    return jb.Model(bodies={"top": body(rng, position=point(rng), orientation=turn(rng))})


@judged
def plate_on_five_springs(rng):
    elements = {f"s{i}": spring(rng, "plate", "base", 1.5) for i in range(5)}
    return jb.Model(
        bodies={"plate": body(rng, orientation=turn(rng))},
        supports=BASE,
        elements=elements,
        gravity=G,
    )


@judged
def two_bodies_on_springs(rng):
    ends = [
        ("one", "base"),
        ("one", "other"),
        ("other", "one"),
        ("other", "base"),
        ("other", "world"),
        ("one", "world"),
    ]
    bodies = {
        "one": body(rng, orientation=turn(rng)),
        "other": body(rng, position=[1, 0.2, 0.1], orientation=turn(rng)),
    }
    elements = {f"s{i}": spring(rng, *end, 1.5) for i, end in enumerate(ends)}
    return jb.Model(bodies=bodies, supports=BASE, elements=elements, gravity=G)


@judged
def oblique_pendulums(rng):
    """Three links on hinges whose axes cross at any angle."""
    names = ["a", "b", "c"]
    return jb.Model(
        bodies={
            n: body(rng, position=[0.3 * i, 0.1, -0.4 * i], orientation=turn(rng))
            for i, n in enumerate(names)
        },
        supports=BASE,
        joints={
            n: jb.Hinge(p, axis=point(rng), at=point(rng))
            for n, p in zip(names, ["base", "a", "b"], strict=True)
        },
        gravity=G,
    )


@judged
def chain_of_balls(rng):
    names = ["a", "b", "c"]
    return jb.Model(
        bodies={
            n: body(rng, position=[0.3 * i, 0.1, -0.4 * i], orientation=turn(rng))
            for i, n in enumerate(names)
        },
        supports=BASE,
        joints={
            n: jb.Ball(p, at=point(rng)) for n, p in zip(names, ["base", "a", "b"], strict=True)
        },
        elements={"s": spring(rng, "c", "world"), "t": spring(rng, "b", "base")},
        gravity=G,
    )


@judged
def heavy_top(rng):
    """A gyroscope on a ball joint at the tip."""
    top = jb.Body(
        mass=1.3,
        inertia=[0.03, 0.03, 0.05],
        com=[0, 0, 0.3],
        orientation=[0.9, 0.3, 0.2, 0.1] / np.sqrt(0.95),
    )
    return jb.Model(bodies={"top": top}, joints={"top": jb.Ball("world")}, gravity=[0, 0, -9.81])


@judged
def sliders(rng):
    """Oblique guides, one on the other, with springs."""
    return jb.Model(
        bodies={
            "a": body(rng, orientation=turn(rng)),
            "b": body(rng, position=[0.4, 0, 0.2], orientation=turn(rng)),
        },
        supports=BASE,
        joints={"a": jb.Guide("base", axis=[1, 0.3, 0.2]), "b": jb.Guide("a", axis=[0.1, 1, -0.4])},
        elements={
            "s": spring(rng, "a", "base"),
            "t": spring(rng, "b", "a"),
            "u": spring(rng, "b", "world"),
        },
        gravity=G,
    )


@judged
def crane(rng):
    """A trolley that moves in a plane, and a load that turns about two lines on it."""
    plane = jb.joints.Composite(
        "base", ["move", "move"], directions=[[1, 0.2, 0], [-0.2, 1, 0]], points=np.zeros((2, 3))
    )
    swing = jb.joints.Composite(
        "trolley",
        ["turn", "turn"],
        directions=[[1, 0, 0.3], [0, 1, 0]],
        points=[[0, 0, 0.1], [0, 0.1, 0]],
    )
    return jb.Model(
        bodies={
            "trolley": body(rng, position=[0.1, 0.2, -0.5], orientation=turn(rng)),
            "load": body(rng, position=[0.1, 0.3, -1.2]),
        },
        supports=BASE,
        joints={"trolley": plane, "load": swing},
        elements={"s": spring(rng, "load", "world"), "t": spring(rng, "trolley", "base")},
        gravity=G,
    )


@judged
def robot_arm(rng):
    """Six links on motions of every order, two of them on one joint."""
    joints = {
        "turret": jb.Hinge("base", axis="z"),
        "shoulder": jb.joints.Composite(
            "turret",
            ["turn", "move", "turn"],
            directions=rng.normal(size=(3, 3)),
            points=rng.normal(size=(3, 3)),
        ),
        "boom": jb.Guide("shoulder", axis=[0.3, 0.2, 1]),
        "wrist": jb.Ball("boom", at=[0.1, 0.2, 0.3]),
        "finger": jb.Hinge("wrist", axis=[1, 1, 0], at=[0.1, 0, 0]),
        "thumb": jb.Hinge("wrist", axis=[0, 1, 1], at=[0, 0.1, 0]),
    }
    bodies = {name: body(rng, position=point(rng), orientation=turn(rng)) for name in joints}
    return jb.Model(bodies=bodies, supports=BASE, joints=joints, gravity=G)


@judged
def free_on_a_carriage(rng):
    """A body that floats on springs over a carriage, with coordinates relative to it."""
    return jb.Model(
        bodies={
            "carriage": body(rng, orientation=turn(rng)),
            "load": body(rng, position=[0.2, 0.1, 0.6], orientation=turn(rng)),
        },
        supports=BASE,
        joints={
            "carriage": jb.Hinge("base", axis=[0.2, 1, 0.1], at=[0.1, 0, 0]),
            "load": jb.Free("carriage"),
        },
        elements={f"s{i}": spring(rng, "load", "carriage", 1.2) for i in range(4)},
        gravity=G,
    )


@judged
def flap_with_weight(rng):
    """A body fixed on one that turns, and a slider on it."""
    where = {"orientation": turn(rng), "position": [0.1, 0.2, -0.5]}
    return jb.Model(
        bodies={
            "flap": body(rng, **where),
            "weight": body(rng, position=[0.3, 0.2, -0.6]),
            "slider": body(rng, position=[0.2, 0.1, -0.4]),
        },
        supports=BASE,
        joints={
            "flap": jb.Hinge("base", axis=[0, 0.2, -1], at=[0, 0.2, 0]),
            "weight": jb.Fixed("flap"),
            "slider": jb.Guide("flap", axis=[1, 1, 0]),
        },
        elements={"s": spring(rng, "slider", "weight"), "t": spring(rng, "weight", "world")},
        gravity=G,
    )


@judged
def quarter_car(rng):
    return presets.quarter_car(damping=1500.0, tyre_damping=50.0)


@judged
def half_car(rng):
    return presets.half_car(front_damping=900.0, rear_damping=1100.0)


@judged
def rolling_car(rng):
    """Heave, pitch and roll, an axle that translates, and the springs between them."""
    car = body(rng, mass=20.0, position=[0, 0, 0.5])
    corners = [[1, 0.6, 0], [1, -0.6, 0], [-1, 0.6, 0], [-1, -0.6, 0]]
    elements = {
        f"s{i}": jb.Spring(
            ("car", c),
            ("base" if i < 2 else "axle", np.array(c) - [0, 0, 0.6]),
            stiffness=800.0 + 50 * i,
            free_length=0.7,
            damping=20.0,
        )
        for i, c in enumerate(corners)
    }
    elements |= {f"t{i}": spring(rng, "axle", "base", 1.2, stiffness=900.0) for i in range(3)}
    joints = {"car": jb.joints.HeavePitchRoll("base"), "axle": jb.Translation("base")}
    return jb.Model(
        bodies={"car": car, "axle": body(rng, mass=4.0)},
        supports=BASE,
        joints=joints,
        elements=elements,
        gravity=G,
    )


@judged
def engine_on_bushings(rng):
    """Bushings of six full stiffnesses and dampings, their frames turned."""
    elements = {
        f"mount {i}": jb.Bushing(
            ("base", point(rng)),
            ("engine", point(rng)),
            stiffness=six_by_six(rng, 300.0),
            damping=six_by_six(rng, 2.0),
            orientation=turn(rng),
            orientation_b=turn(rng),
        )
        for i in range(3)
    }
    return jb.Model(
        bodies={"engine": body(rng, orientation=turn(rng))},
        supports=BASE,
        elements=elements,
        gravity=G,
    )


@judged
def tree_with_bushings(rng):
    """A link on a hinge and a free body, bushings and a spring between them and the base."""
    ends = [("base", "link"), ("link", "load"), ("load", "world")]
    elements = {
        f"mount {i}": jb.Bushing(
            (one, point(rng)),
            (other, point(rng)),
            stiffness=six_by_six(rng),
            damping=six_by_six(rng, 1.0),
            orientation=turn(rng),
        )
        for i, (one, other) in enumerate(ends)
    }
    bodies = {
        "link": body(rng, orientation=turn(rng)),
        "load": body(rng, position=point(rng), orientation=turn(rng)),
    }
    joints = {"link": jb.Hinge("base", axis=[0.2, 1, 0.1], at=[0.1, 0, 0])}
    return jb.Model(
        bodies=bodies,
        supports=BASE,
        joints=joints,
        elements=elements | {"s": spring(rng, "load", "link")},
        gravity=G,
    )


@judged
def rotor_in_bushings(rng):
    """A disk that may spin fast, its forces in three directions only."""
    rotor = jb.Body(mass=3.0, inertia=[0.02, 0.02, 0.04], com=[0.01, 0, 0])
    mounts = {
        f"bearing {i}": jb.Bushing(
            ("world", [0, 0, z]),
            ("rotor", [0, 0, z]),
            stiffness=[4e3, 5e3, 2e3],
            damping=[4.0, 3, 2],
        )
        for i, z in enumerate([-0.2, 0.3])
    }
    return jb.Model(bodies={"rotor": rotor}, elements=mounts, gravity=[0, -9.81, 0])


@judged
def hinges_with_torsion_springs(rng):
    names = ["a", "b"]
    springs = {
        f"t {n}": jb.Torsion(p, n, axis=axis, spring=30.0, damper=0.5, free_angle=0.2)
        for n, p, axis in [("a", "base", [0, 0, 1.0]), ("b", "a", [0, 1, 0])]
    }
    return jb.Model(
        bodies={
            n: body(rng, position=[0.3 * i, 0.1, -0.4 * i], orientation=TILT)
            for i, n in enumerate(names)
        },
        supports=BASE,
        joints={
            "a": jb.Hinge("base", axis="z", at=[0, 0.1, 0]),
            "b": jb.Hinge("a", axis="y", at=[0.1, 0.2, 0.1]),
        },
        elements=springs | {"s": spring(rng, "b", "base")},
        gravity=G,
    )


@judged
def axle_with_anti_roll_bar(rng):
    corners = {"left": [0.2, 0.7, -0.3], "right": [0.2, -0.7, -0.3]}
    bodies = {"car": body(rng, mass=20.0, orientation=TILT)} | {
        n: body(rng, position=p) for n, p in corners.items()
    }
    elements = {f"{n} spring": spring(rng, n, "car", 0.8) for n in corners} | {
        f"{n} tyre": spring(rng, n, "base", 0.8) for n in corners
    }
    bar = jb.AntiRollBar(
        ("left", [0, -0.1, 0]),
        ("right", [0, 0.1, 0]),
        "car",
        axis=[0.1, 0, 1],
        spring=400.0,
        damper=3.0,
    )
    joints = {
        "car": jb.joints.HeavePitchRoll("base"),
        "left": jb.Guide("car", axis=[0, 0.2, 1]),
        "right": jb.Guide("car", axis=[0, -0.2, 1]),
    }
    return jb.Model(
        bodies=bodies, supports=BASE, joints=joints, elements=elements | {"bar": bar}, gravity=G
    )


@judged
def plate_with_inerters(rng):
    elements = {f"s{i}": spring(rng, "plate", "base", 1.5) for i in range(4)}
    ends = [("plate", "base"), ("plate", "world"), ("base", "plate")]
    elements |= {
        f"i{i}": jb.Inerter((a, point(rng)), (b, point(rng, 1.5)), inertance=rng.uniform(1, 4))
        for i, (a, b) in enumerate(ends)
    }
    return jb.Model(
        bodies={"plate": body(rng, orientation=turn(rng))},
        supports=BASE,
        elements=elements,
        gravity=G,
    )


@judged
def arm_with_inerters(rng):
    """Bodies on joints with inerters between them, one to the base."""
    return jb.Model(
        bodies={
            "arm": body(rng, orientation=turn(rng)),
            "load": body(rng, position=[0.4, 0, 0.2], orientation=turn(rng)),
        },
        supports=BASE,
        joints={
            "arm": jb.Hinge("base", axis=[1, 0.3, 0.2], at=[0, 0.3, 0]),
            "load": jb.Ball("arm", at=[0.2, 0.1, 0.4]),
        },
        elements={
            "s": spring(rng, "arm", "base"),
            "i": jb.Inerter(("arm", point(rng)), ("load", point(rng, 1.2)), inertance=2.0),
            "j": jb.Inerter(("load", point(rng)), ("base", point(rng, 1.2)), inertance=1.0),
        },
        gravity=G,
    )


@judged
def laws_of_springs(rng):
    """A hardening spring, a rope that is slack in part of the states, a stop, a digressive
    damper, friction."""
    laws = {
        "hardening": {"spring": jb.laws.Polynomial([80.0, 20.0, 50.0]), "damper": 1.0},
        "rope": {"spring": jb.laws.TensionOnly(200.0)},
        "stop": {
            "spring": jb.laws.Linear(60.0)
            + jb.laws.BumpStop(gap=0.05, stiffness=900.0, engagement=0.1)
        },
        "damper": {"spring": 90.0, "damper": jb.laws.Digressive(slow=30.0, fast=2.0, knee=0.3)},
        "friction": {"spring": 70.0, "damper": jb.laws.Friction(level=3.0, velocity=0.2)},
        "bilinear": {"spring": 70.0, "damper": jb.laws.TwoSided(bump=2.0, rebound=6.0)},
    }
    elements = {
        name: jb.SpringDamper(
            ("plate", point(rng)), ("base", point(rng, 1.5)), free_length=1.2, **law
        )
        for name, law in laws.items()
    }
    return jb.Model(
        bodies={"plate": body(rng, orientation=turn(rng))},
        supports=BASE,
        elements=elements,
        gravity=G,
    )


# Memory: inner states


def strut(rng, law, one="plate", other="base"):
    return jb.SpringDamper(
        (one, point(rng)), (other, point(rng, 1.5)), free_length=1.0, spring=law, damper=1.0
    )


@judged
def plate_on_rubber(rng):
    """Struts of springs with one and two Maxwell branches."""
    maxwell = [
        jb.laws.Maxwell(stiffness=rng.uniform(40, 90), relaxation_time=t)
        for t in (0.05, 0.3, 0.6, 0.1)
    ]
    laws = [
        jb.laws.Linear(90.0) + maxwell[0],
        jb.laws.Linear(80.0) + maxwell[1],
        jb.laws.Linear(70.0) + maxwell[2] + maxwell[3],
    ]
    elements = {f"r{i}": strut(rng, law) for i, law in enumerate(laws)} | {
        f"s{i}": spring(rng, "plate", "world", 1.5) for i in range(3)
    }
    return jb.Model(
        bodies={"plate": body(rng, orientation=turn(rng))},
        supports=BASE,
        elements=elements,
        gravity=G,
    )


@judged
def plate_with_hysteresis(rng):
    """Struts of Bouc and Wen, Dahl and LuGre beside springs."""
    laws = [
        jb.laws.Linear(90.0) + jb.laws.BoucWen(alpha=60.0, beta=2.0, gamma=0.8, delta=-0.3),
        jb.laws.Linear(80.0) + jb.laws.Dahl(stiffness=70.0, level=5.0),
        jb.laws.Linear(70.0)
        + jb.laws.LuGre(
            stiffness=90.0, damping=1.0, viscosity=0.4, level=4.0, static_level=6.0, velocity=0.5
        ),
    ]
    elements = {f"r{i}": strut(rng, law) for i, law in enumerate(laws)} | {
        f"s{i}": spring(rng, "plate", "world", 1.5) for i in range(3)
    }
    return jb.Model(
        bodies={"plate": body(rng, orientation=turn(rng))},
        supports=BASE,
        elements=elements,
        gravity=G,
    )


# Closures


@judged
def spatial_four_bar(rng):
    """A crank and a rocker on oblique hinges, a coupler on a ball between them; the loop is closed
    by another ball."""
    places = {
        "crank": np.array([0.05, 0.2, 0]),
        "coupler": np.array([0.5, 0.5, 0.1]),
        "rocker": np.array([1.0, 0.3, 0]),
    }
    pins = np.array([[0.1, 0.4, 0.1], [1.0, 0.6, 0.15]])
    return jb.Model(
        bodies={name: body(rng, position=place) for name, place in places.items()},
        supports=BASE,
        joints={
            "crank": jb.Hinge("world", axis=[0.1, 0, 1], at=[0, 0, 0]),
            "coupler": jb.Ball("crank", at=pins[0] - places["crank"]),
            "rocker": jb.Hinge("world", axis=[0, 0.2, 1], at=[0.9, 0, 0]),
        },
        closures={
            "pin": jb.closures.Ball(
                ("rocker", pins[1] - places["rocker"]), ("coupler", pins[1] - places["coupler"])
            )
        },
        elements={
            f"s{i}": spring(rng, n, "base", 1.2, free_length=0.3)
            for i, n in enumerate(["crank", "coupler", "rocker", "coupler"])
        },
        gravity=G,
    )


@judged
def strut_corner(rng):
    """An arm on a hinge, an upright on a ball at its end, guided by a line through its top and by
    a rod."""
    return jb.Model(
        bodies={
            "arm": body(rng, position=[0, 0.2, 0]),
            "upright": body(rng, mass=5.0, position=[0, 0.5, 0.1]),
        },
        supports={"base": jb.Support()},
        joints={
            "arm": jb.Hinge("base", axis=[1, 0.1, 0], at=[0, 0, 0]),
            "upright": jb.Ball("arm", at=[0, 0.3, 0]),
        },
        closures={
            "strut": jb.closures.Inline(
                ("upright", [0, -0.1, 0]), ("base", [0.05, 0.35, 0.7]), axis=[0.02, -0.1, 1]
            ),
            "tie": jb.closures.Rod(
                ("base", [0.3, 0.1, 0.1]), ("upright", [0.2, 0, 0]), length=0.42
            ),
        },
        elements={
            "spring": jb.Spring(
                ("upright", [0, -0.1, 0]),
                ("base", [0.05, 0.35, 0.7]),
                stiffness=900.0,
                free_length=0.75,
            ),
            "side": spring(rng, "upright", "base", 0.9),
        },
        gravity=G,
    )


@judged
def hung_platform(rng):
    """A platform that is free but for three rods."""
    corners, tops = (
        np.array([[0.5, 0, 0], [-0.3, 0.4, 0], [-0.3, -0.4, 0]]),
        np.array([[0.7, 0.1, 1.0], [-0.4, 0.5, 1.1], [-0.4, -0.3, 0.9]]),
    )
    rods = {
        f"rod {i}": jb.closures.Rod(("platform", a), ("base", b), length=1.0)
        for i, (a, b) in enumerate(zip(corners, tops, strict=True))
    }
    return jb.Model(
        bodies={"platform": body(rng)},
        supports={"base": jb.Support()},
        closures=rods,
        elements={f"s{i}": spring(rng, "platform", "base", 1.2) for i in range(3)},
        gravity=G,
    )


@judged
def clamped_frame(rng):
    """An arm on a ball, a free body welded to its end by a closure, and another that slides on that
    one by a closure."""
    return jb.Model(
        bodies={
            "left": body(rng, position=[0.2, 0, 0]),
            "right": body(rng, position=[0.6, 0, 0]),
            "slide": body(rng, position=[0.4, 0.5, 0]),
        },
        supports={"base": jb.Support()},
        joints={"left": jb.Ball("base", at=[0, 0, 0])},
        closures={
            "weld": jb.closures.Weld(("left", [0.2, 0, 0]), ("right", [-0.2, 0, 0])),
            "slot": jb.closures.Guide(
                ("right", [0, 0.2, 0]), ("slide", [0.2, -0.3, 0]), axis=[1, 0.5, 0]
            ),
        },
        elements={
            f"s{i}": spring(rng, n, "base", 1.2)
            for i, n in enumerate(["left", "right", "slide", "right", "slide"])
        },
        gravity=G,
    )


CLOSED = ("spatial_four_bar", "strut_corner", "hung_platform", "clamped_frame")
WITH_MEMORY = ("plate_on_rubber", "plate_with_hysteresis")
TREES = tuple(name for name in MODELS if name not in (*CLOSED, *WITH_MEMORY))


def marked(names, quick):
    """Parameters of a test, those that are not among the quick ones marked as long."""
    return [pytest.param(name, marks=[] if name in quick else pytest.mark.long) for name in names]
