"""Ready models: functions that return a Model, each with its source; their arguments are the numbers of the source unless others are given.

Cars: x forward, y to the left, z up, wheels and supports `front`, `rear`, or `fl`, `fr`, `rl`, `rr`; the reference pose is the equilibrium.
"""

from __future__ import annotations

import numpy as np

from jaxbody.elements.bushings import Bushing
from jaxbody.elements.springs import Spring
from jaxbody.elements.torsions import AntiRollBar
from jaxbody.models.bodies import Body, Support
from jaxbody.models.joints import Guide, HeavePitch, HeavePitchRoll, Hinge, Translation
from jaxbody.models.models import Model

G = 9.81
UP = (0, 0, 1)
POINT = np.full(3, 1e-3)  # kg m2, of bodies that do not turn


def quarter_car(*, sprung=375.0, unsprung=75.0, stiffness=35000.0, damping=0.0, tyre=193000.0, tyre_damping=0.0, gravity=G) -> Model:
    """A quarter of a car: `body` on `wheel` on the support `road`, all on vertical guides. Masses [kg], stiffnesses [N/m], damping [N s/m].

    Source: R. N. Jazar, Vehicle Dynamics: 8.8671 and 55.2694 rad/s undamped.

    >>> frequency = modes(linearize(model := quarter_car(), equilibrium(model))).frequency
    >>> round(float(2 * jnp.pi * frequency[0]), 4)
    8.8671
    """
    length, radius = 0.4, 0.3
    carried = (sprung * gravity / stiffness, (sprung + unsprung) * gravity / tyre)
    return Model(
        bodies={
            "body": Body(mass=sprung, inertia=POINT, position=[0, 0, radius + length]),
            "wheel": Body(mass=unsprung, inertia=POINT, position=[0, 0, radius]),
        },
        supports={"road": Support()},
        joints={"body": Guide("world", axis=UP), "wheel": Guide("world", axis=UP)},
        elements={
            "suspension": _upright("body", "wheel", stiffness, damping, length + carried[0]),
            "tyre": _upright("wheel", "road", tyre, tyre_damping, radius + carried[1]),
        },
        gravity=[0, 0, -gravity],
    )


def _upright(upper: str, lower: str, stiffness, damping, free_length, at=(0, 0, 0), below=0.0) -> Spring:
    return Spring((upper, at), (lower, [0, 0, -below]), stiffness=stiffness, damping=damping, free_length=free_length)


def half_car(
    *, mass=1000.0, gyration=0.9, front=1.0, rear=1.5, front_stiffness=18000.0, rear_stiffness=22000.0, front_damping=0.0, rear_damping=0.0,
    height=None, gravity=G,
) -> Model:  # fmt: skip
    """Half a car, or a car seen from the side: `body`, free to heave and pitch, on a spring at each axle from the supports `front` and `rear`.

    `front`, `rear`: distances of the axles from the centre of mass [m], `gyration`: radius of gyration in pitch [m]. `height` of the centre of mass above the
    road [m], on which the axis of pitch then lies, so that braking loads the front axle by m a height/(front + rear); without it the axis goes through the
    centre of mass, as in the source, and braking does nothing. Source: S. S. Rao, Mechanical Vibrations, example 5.7: 5.8593 and 9.4341 rad/s.

    >>> half_car().layout.coordinates
    ('body move along z', 'body turn about y')
    """
    length = 0.5
    shares = {"front": rear / (front + rear), "rear": front / (front + rear)}
    at = {"front": front, "rear": -rear}
    place, com, top = _pivot(length, height)
    springs = {"front": (front_stiffness, front_damping), "rear": (rear_stiffness, rear_damping)}
    return Model(
        bodies={"body": Body(mass=mass, inertia=mass * gyration**2 * np.array([0.5, 1, 1]), com=com, position=place)},
        supports={name: Support(position=[x, 0, 0]) for name, x in at.items()},
        joints={"body": HeavePitch("world")},  # pyright: ignore[reportCallIssue]  # the class states the others
        elements={
            f"{name} spring": _upright("body", name, k, c, length + shares[name] * mass * gravity / k, (at[name], 0, top))
            for name, (k, c) in springs.items()
        },
        gravity=[0, 0, -gravity],
    )


def _pivot(attached: float, height: float | None):
    """Of a car whose springs are attached that far above the road: its O, its centre of mass and the springs' ends above O. Springs below end on the road
    where O does, so that their forces have no moment about O but that of their verticals."""
    return ([0, 0, attached], [0, 0, 0], 0.0) if height is None else ([0, 0, 0], [0, 0, height], attached)


def full_car(
    *, mass=1100.0, inertia=(450.0, 1500.0, 1700.0), front=1.2, rear=1.4, track=1.5, unsprung=(40.0, 35.0), stiffness=(22000.0, 24000.0),
    damping=(1500.0, 1600.0), tyre=(190000.0, 190000.0), anti_roll=(12000.0, 6000.0), height=None, gravity=G,
) -> Model:  # fmt: skip
    """A car of seven degrees of freedom: `car`, free to heave, pitch and roll, on four wheels that move vertically on four supports `road fl` ...

    Of each pair the first is for a front, the second for a rear wheel: `unsprung` mass [kg], `stiffness` [N/m] and `damping` [N s/m] of the suspension,
    `tyre` stiffness [N/m]; `anti_roll` [N/m at the wheels] for an axle. `front`, `rear`, `track` [m]. `height` of the car's centre of mass above the road
    [m], on which the axes of pitch and roll then lie, so that braking and cornering load wheels by m a height/2(front + rear) and so on; without it these axes
    go through the centre of mass, as in the source, and neither does anything. Source: the seven degree model of R. N. Jazar, Vehicle Dynamics,
    chapter 14; the numbers are of a compact car, without a source.

    >>> full_car().layout.nv
    7
    """
    attached, radius = 0.55, 0.3
    place, com, top = _pivot(attached, height)
    below = 0.0 if height is None else radius
    wheels = {"fl": (front, track / 2, 0), "fr": (front, -track / 2, 0), "rl": (-rear, track / 2, 1), "rr": (-rear, -track / 2, 1)}
    share = (rear / (front + rear) / 2, front / (front + rear) / 2)
    bodies = {"car": Body(mass=mass, inertia=inertia, com=com, position=place)}
    bodies |= {name: Body(mass=unsprung[axle], inertia=POINT, position=[x, y, radius]) for name, (x, y, axle) in wheels.items()}
    elements = {}
    for name, (x, y, axle) in wheels.items():
        sprung = share[axle] * mass * gravity
        sunk, pressed = sprung / stiffness[axle], (sprung + unsprung[axle] * gravity) / tyre[axle]
        elements[f"spring {name}"] = _upright(
            "car", name, stiffness[axle], damping[axle], attached - radius + below + sunk, (x, y, top), below
        )
        elements[f"tyre {name}"] = _upright(name, f"road {name}", tyre[axle], 0.0, radius + pressed)
    for axle, side in enumerate(("f", "r")):
        elements[f"bar {'front' if side == 'f' else 'rear'}"] = AntiRollBar(f"{side}l", f"{side}r", "car", spring=anti_roll[axle])
    return Model(
        bodies=bodies,
        supports={f"road {name}": Support(position=[x, y, 0]) for name, (x, y, _) in wheels.items()},
        joints={"car": HeavePitchRoll("world"), **{name: Guide("world", axis=UP) for name in wheels}},  # pyright: ignore[reportCallIssue]
        elements=elements,
        gravity=[0, 0, -gravity],
    )


ENGINE = np.array([[8.493, -1.187, -0.368], [-1.187, 3.505, 1.476], [-0.368, 1.476, 7.147]])
MOUNTS = np.array([[-0.0135, 0.389, 0.203], [0.424, -0.092, -0.175], [-0.182, -0.454, -0.068]])
MOUNT_STIFFNESS = np.array([[91000.0, 200000, 949900], [147000, 61000, 140000], [80000, 156000, 150000]])
MOUNT_DAMPING = np.array([[910.0, 2000, 198], [1470, 610, 1400], [800, 1560, 1500]])


def engine_on_mounts(*, mass=139.5, inertia=ENGINE, points=MOUNTS, stiffness=MOUNT_STIFFNESS, damping=MOUNT_DAMPING, gravity=0.0) -> Model:
    """An engine on n mounts from the support `frame`: bushings at `points` from the centre of mass (n, 3), `stiffness` [N/m] and `damping` [N s/m] along the axes (n, 3).

    Source: a powertrain on three mounts (github hojjatkarami/NVHteam, the hydraulic branch of mount 1 in its stiffness): 7.50256052 ... 26.4512989 Hz.

    >>> engine_on_mounts().element_names
    ('mount 1', 'mount 2', 'mount 3')
    """
    mounts = zip(np.asarray(points), stiffness, damping, strict=True)
    return Model(
        bodies={"engine": Body(mass=mass, inertia=inertia)},
        supports={"frame": Support()},
        elements={f"mount {i}": Bushing(("engine", p), ("frame", p), stiffness=k, damping=c) for i, (p, k, c) in enumerate(mounts, 1)},
        gravity=[0, 0, -gravity],
    )


def isolated_table(*, mass=200.0, gyration=(0.35, 0.42, 0.5), stiffness=(3e4, 5e4, 8e4), damping=(0.0, 0.0, 0.0), at=(0.45, 0.3, 0.25), gravity=0.0) -> Model:  # fmt: skip
    """A table with two planes of symmetry on four equal upright isolators at (+-ax, +-ay, -az) from its centre, on the support `floor`.

    `gyration`: radii about x, y, z [m]; `stiffness` [N/m] and `damping` [N s/m] of one isolator along x, y, z; `at`: ax, ay, az [m].
    Source: Harris, Shock and Vibration Handbook, chapter 3: z 6.366198 Hz, yaw 5.097929 Hz.

    >>> isolated_table().element_names[0]
    'isolator 1'
    """
    ax, ay, az = at
    points = [(x, y, -az) for x in (ax, -ax) for y in (ay, -ay)]
    return Model(
        bodies={"table": Body(mass=mass, inertia=mass * np.asarray(gyration) ** 2)},
        supports={"floor": Support()},
        elements={
            f"isolator {i}": Bushing(("table", p), ("floor", p), stiffness=stiffness, damping=damping) for i, p in enumerate(points, 1)
        },
        gravity=[0, 0, -gravity],
    )


def stewart_table(*, mass=50.0, inertia=(2.0, 2.0, 3.5), stiffness=1e4, damping=0.0, upper=0.4, lower=0.6, height=0.5, spread=15.0, gravity=G) -> Model:  # fmt: skip
    """A table on six springs in three V's, a Stewart platform whose legs are springs, on the support `base`; relaxed legs would be those of the reference pose without weight.

    `upper`, `lower`: radii of the circles on which legs end [m], `height` between these [m], `spread`: half the angle between two neighbouring ends [degrees].
    Source: D. Stewart, Proc. Inst. Mech. Eng. 180 (1965) 371, in the symmetric form with ends in pairs.

    >>> stewart_table().layout.nv, len(stewart_table().element_names)
    (6, 6)
    """
    pairs = np.deg2rad([120 * i for i in range(3)])
    ends = np.deg2rad(spread) * np.array([-1, 1])
    above = [(upper * np.cos(p + e), upper * np.sin(p + e), 0) for p in pairs for e in ends]
    below = [(lower * np.cos(p - e), lower * np.sin(p - e), 0) for p in pairs + np.pi / 3 for e in ends]
    below = [below[-1], *below[:-1]]  # each leg leans to the neighbouring pair
    length = np.linalg.norm(np.add(above[0], [0, 0, height]) - below[0])
    relaxed = length + mass * gravity * length / (6 * stiffness * height)
    legs = {
        f"leg {i}": Spring(("table", a), ("base", b), stiffness=stiffness, damping=damping, free_length=relaxed)
        for i, (a, b) in enumerate(zip(above, below, strict=True), 1)
    }
    return Model(
        bodies={"table": Body(mass=mass, inertia=inertia, position=[0, 0, height])},
        supports={"base": Support()},
        elements=legs,
        gravity=[0, 0, -gravity],
    )


def elastic_pendulum(*, mass=1.0, stiffness=4 * np.pi**2, free_length=0.75, damping=0.0, gravity=np.pi**2) -> Model:
    """A bob on a spring from the world, free to swing, not to turn; at z = 0 in equilibrium, the pivot `length` above.

    Source: P. Lynch, the swinging spring: in 2:1 resonance, its swing plane turns with every pulsation.

    >>> elastic_pendulum().layout.coordinates[2]
    'bob move along z'
    """
    length = free_length + mass * gravity / stiffness
    spring = Spring(("bob", [0, 0, 0]), ("world", [0, 0, length]), stiffness=stiffness, free_length=free_length, damping=damping)
    return Model(
        bodies={"bob": Body(mass=mass, inertia=POINT)},
        joints={"bob": Translation("world")},  # pyright: ignore[reportCallIssue]
        elements={"spring": spring},
        gravity=[0, 0, -gravity],
    )


def double_pendulum(*, masses=(1.0, 1.0), lengths=(1.0, 1.0), gravity=G) -> Model:
    """Two uniform rods, `upper` and `lower`, hanging on hinges about y in the x-z plane.

    Source: for example L. D. Landau, E. M. Lifshitz, Mechanics, section 5, with rods for points.

    >>> double_pendulum().layout.motions
    (('upper', 'turn about its hinge'), ('lower', 'turn about its hinge'))
    """
    (m1, m2), (l1, l2) = masses, lengths

    def rod(m, l, z):
        return Body(mass=m, inertia=m * l**2 / 12 * np.array([1, 1, 0.01]), com=[0, 0, -l / 2], position=[0, 0, z])

    return Model(
        bodies={"upper": rod(m1, l1, 0.0), "lower": rod(m2, l2, -l1)},
        joints={"upper": Hinge("world", axis=[0, 1, 0]), "lower": Hinge("upper", axis=[0, 1, 0], at=[0, 0, -l1])},
        gravity=[0, 0, -gravity],
    )


def coupled_gliders(*, masses=(0.3, 0.3), stiffness=(3.0, 3.0, 3.0), damping=(0.0, 0.0, 0.0), span=1.5, length=0.3) -> Model:
    """Two gliders on an air track along x, between the ends of the track and each other on three springs `left`, `middle`, `right`, stretched from
    `length` to a third of `span` [m].

    Source: M. Schmidt, H. Lipson, Science 324 (2009) 81, whose record examples/gliders.py fits.

    >>> coupled_gliders().element_names
    ('left', 'middle', 'right')
    """
    places = {"one": span / 3, "two": 2 * span / 3}
    ends = {
        "left": (("world", [0, 0, 0]), ("one", [0, 0, 0])),
        "middle": (("one", [0, 0, 0]), ("two", [0, 0, 0])),
        "right": (("two", [0, 0, 0]), ("world", [span, 0, 0])),
    }
    return Model(
        bodies={name: Body(mass=m, inertia=POINT, position=[x, 0, 0]) for (name, x), m in zip(places.items(), masses, strict=True)},
        joints={name: Guide("world", axis=[1, 0, 0]) for name in places},
        elements={
            name: Spring(*pair, stiffness=k, damping=c, free_length=length)
            for (name, pair), k, c in zip(ends.items(), stiffness, damping, strict=True)
        },
    )
