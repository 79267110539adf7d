"""Ready models: each function returns a Model and names its source; the defaults are the numbers of
the source.

Axes of the cars: x forward, y to the left, z up. Wheels and supports are `front` and `rear`, or
`fl`, `fr`, `rl` and `rr`. The reference pose is the equilibrium.
"""

from typing import Any

import numpy as np

from jaxbody.model import laws
from jaxbody.model.bodies import Body, Support
from jaxbody.model.elements.bushings import Bushing, Mount
from jaxbody.model.elements.springs import Spring
from jaxbody.model.elements.torsions import AntiRollBar
from jaxbody.model.joints.combined_joints import HeavePitch, HeavePitchRoll, Translation
from jaxbody.model.joints.joints import Guide, Hinge
from jaxbody.model.models import Model

G = 9.81
UP = (0, 0, 1)
POINT = np.full(3, 1e-3)  # kg m2, inertia of bodies that do not rotate


def quarter_car(
    *,
    sprung=375.0,
    unsprung=75.0,
    stiffness=35000.0,
    damping=0.0,
    tyre=193000.0,
    tyre_damping=0.0,
    gravity=G,
) -> Model:
    """Return a quarter of a car: `body` on `wheel` on the support `road`; body and wheel move along
    vertical guides.

    Args:
        sprung, unsprung: masses of the body and of the wheel [kg].
        stiffness, damping: stiffness and damping of the suspension [N/m, N s/m].
        tyre, tyre_damping: stiffness and damping of the tyre [N/m, N s/m].
        gravity: [m/s2], downward.

    Source: R. N. Jazar, Vehicle Dynamics: 8.8671 and 55.2694 rad/s undamped.

    >>> frequency = jb.modes(
    ...     jb.linearize(model := jb.presets.quarter_car(), jb.equilibrium(model))
    ... ).frequency
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


def _upright(
    upper: str, lower: str, stiffness, damping, free_length, at=(0, 0, 0), below=0.0
) -> Spring:
    return Spring(
        (upper, at),
        (lower, [0, 0, -below]),
        stiffness=stiffness,
        damping=damping,
        free_length=free_length,
    )


def half_car(
    *,
    mass=1000.0,
    gyration=0.9,
    front=1.0,
    rear=1.5,
    front_stiffness=18000.0,
    rear_stiffness=22000.0,
    front_damping=0.0,
    rear_damping=0.0,
    height=None,
    gravity=G,
) -> Model:
    """Return half a car, that is a car seen from the side: `body` heaves and pitches on two springs
    from the supports `front` and `rear`.

    Args:
        mass: mass of the body [kg].
        gyration: radius of gyration in pitch [m].
        front, rear: distances of the axles from the center of mass [m].
        front_stiffness, rear_stiffness: stiffnesses of the two springs [N/m].
        front_damping, rear_damping: dampings of the two springs [N s/m].
        height: height of the center of mass above the road [m]. The pitch axis then lies on the
            road, so that braking at the deceleration a loads the front axle by m a
            height/(front + rear). None puts the pitch axis through the center of mass, as in the
            source; braking then has no effect.
        gravity: [m/s2], downward.

    Source: S. S. Rao, Mechanical Vibrations, example 5.7: 5.8593 and 9.4341 rad/s.

    >>> jb.presets.half_car().layout.coordinates
    ('body move along z', 'body turn about y')
    """
    length = 0.5
    shares = {"front": rear / (front + rear), "rear": front / (front + rear)}
    at = {"front": front, "rear": -rear}
    place, com, top = _pivot(length, height)
    springs = {"front": (front_stiffness, front_damping), "rear": (rear_stiffness, rear_damping)}
    return Model(
        bodies={
            "body": Body(
                mass=mass,
                inertia=mass * gyration**2 * np.array([0.5, 1, 1]),
                com=com,
                position=place,
            )
        },
        supports={name: Support(position=[x, 0, 0]) for name, x in at.items()},
        # the class sets the other fields
        joints={"body": HeavePitch("world")},  # pyright: ignore[reportCallIssue]
        elements={
            f"{name} spring": _upright(
                "body", name, k, c, length + shares[name] * mass * gravity / k, (at[name], 0, top)
            )
            for name, (k, c) in springs.items()
        },
        gravity=[0, 0, -gravity],
    )


def _pivot(attached: float, height: float | None):
    """Return the position of O, the center of mass in body axes, and the height of the springs'
    upper ends above O.

    `attached` is the height of these ends above the road. With a `height` O lies on the road, and
    so do the lower ends of the springs: only the vertical parts of the spring forces then have a
    moment about O."""
    return (
        ([0, 0, attached], [0, 0, 0], 0.0)
        if height is None
        else ([0, 0, 0], [0, 0, height], attached)
    )


def full_car(
    *,
    mass=1100.0,
    inertia=(450.0, 1500.0, 1700.0),
    front=1.2,
    rear=1.4,
    track=1.5,
    unsprung=(40.0, 35.0),
    stiffness=(22000.0, 24000.0),
    damping=(1500.0, 1600.0),
    tyre=(190000.0, 190000.0),
    anti_roll=(12000.0, 6000.0),
    height=None,
    gravity=G,
) -> Model:
    """Return a car with seven degrees of freedom: `car` heaves, pitches and rolls; its four wheels
    move vertically.

    The wheels are `fl`, `fr`, `rl` and `rr`; under them are the supports `road fl` and so on. In
    each pair the first number is for the front axle, the second for the rear axle.

    Args:
        mass, inertia: mass and inertia of the car without its wheels [kg, kg m2].
        front, rear: distances of the axles from the center of mass [m].
        track: distance between the left and right wheels [m].
        unsprung: masses of one wheel [kg].
        stiffness, damping: stiffness and damping of the suspension at one wheel [N/m, N s/m].
        tyre: stiffnesses of one tyre [N/m].
        anti_roll: stiffnesses of the anti-roll bars [N/m at the wheels].
        height: height of the car's center of mass above the road [m]. The pitch and roll axes then
            lie on the road, so that braking and cornering transfer load between the wheels: braking
            at the deceleration a adds m a height/2(front + rear) to each front wheel. None puts the
            axes through the center of mass, as in the source; braking and cornering then have no
            effect.
        gravity: [m/s2], downward.

    Source: the seven-degree-of-freedom model of R. N. Jazar, Vehicle Dynamics, chapter 14. The
    numbers are those of a compact car and have no source.

    >>> jb.presets.full_car().layout.nv
    7
    """
    attached, radius = 0.55, 0.3
    place, com, top = _pivot(attached, height)
    below = 0.0 if height is None else radius
    wheels = {
        "fl": (front, track / 2, 0),
        "fr": (front, -track / 2, 0),
        "rl": (-rear, track / 2, 1),
        "rr": (-rear, -track / 2, 1),
    }
    share = (rear / (front + rear) / 2, front / (front + rear) / 2)
    bodies = {"car": Body(mass=mass, inertia=inertia, com=com, position=place)} | {
        name: Body(mass=unsprung[axle], inertia=POINT, position=[x, y, radius])
        for name, (x, y, axle) in wheels.items()
    }
    elements = {}
    for name, (x, y, axle) in wheels.items():
        sprung = share[axle] * mass * gravity
        sunk, pressed = sprung / stiffness[axle], (sprung + unsprung[axle] * gravity) / tyre[axle]
        elements[f"spring {name}"] = _upright(
            "car",
            name,
            stiffness[axle],
            damping[axle],
            attached - radius + below + sunk,
            (x, y, top),
            below,
        )
        elements[f"tyre {name}"] = _upright(name, f"road {name}", tyre[axle], 0.0, radius + pressed)
    for axle, side in enumerate(("f", "r")):
        elements[f"bar {'front' if side == 'f' else 'rear'}"] = AntiRollBar(
            f"{side}l", f"{side}r", "car", spring=anti_roll[axle]
        )
    return Model(
        bodies=bodies,
        supports={
            f"road {name}": Support(position=[x, y, 0]) for name, (x, y, _) in wheels.items()
        },
        joints={
            "car": HeavePitchRoll("world"),  # pyright: ignore[reportCallIssue]
            **{name: Guide("world", axis=UP) for name in wheels},
        },
        elements=elements,
        gravity=[0, 0, -gravity],
    )


ENGINE = np.array([[8.493, -1.187, -0.368], [-1.187, 3.505, 1.476], [-0.368, 1.476, 7.147]])
MOUNTS = np.array([[-0.0135, 0.389, 0.203], [0.424, -0.092, -0.175], [-0.182, -0.454, -0.068]])
MOUNT_STIFFNESS = np.array(
    [[91000.0, 200000, 949900], [147000, 61000, 140000], [80000, 156000, 150000]]
)
MOUNT_DAMPING = np.array([[910.0, 2000, 198], [1470, 610, 1400], [800, 1560, 1500]])


def full_car_on_double_wishbones(**numbers: Any) -> Model:
    """Return the model of `jb.suspension.car_on_double_wishbones`, which takes the same numbers.

    >>> len(jb.presets.full_car_on_double_wishbones().layout.bodies)
    14
    """
    # this imports more modules than all other presets together
    from jaxbody.suspension.ready_cars import car_on_double_wishbones

    return car_on_double_wishbones(**numbers).model


def engine_on_mounts(
    *,
    mass=139.5,
    inertia=ENGINE,
    points=MOUNTS,
    stiffness=MOUNT_STIFFNESS,
    damping=MOUNT_DAMPING,
    gravity=0.0,
) -> Model:
    """Return an engine on n mounts, bushings between the body `engine` and the support `frame`.

    Args:
        mass, inertia: mass and inertia of the engine [kg, kg m2], the inertia about its center
            of mass.
        points: positions of the mounts relative to the center of mass (n, 3) [m].
        stiffness, damping: stiffness and damping of the mounts along x, y, z (n, 3) [N/m, N s/m].
        gravity: [m/s2], downward; zero by default, as in the source.

    Source: a powertrain on three mounts (github hojjatkarami/NVHteam; the stiffness of mount 1
    includes its hydraulic branch): 7.50256052 ... 26.4512989 Hz.

    >>> jb.presets.engine_on_mounts().element_names
    ('mount 1', 'mount 2', 'mount 3')
    """
    mounts = zip(np.asarray(points), stiffness, damping, strict=True)
    return Model(
        bodies={"engine": Body(mass=mass, inertia=inertia)},
        supports={"frame": Support()},
        elements={
            f"mount {i}": Bushing(("engine", p), ("frame", p), stiffness=k, damping=c)
            for i, (p, k, c) in enumerate(mounts, 1)
        },
        gravity=[0, 0, -gravity],
    )


HYDRAULIC = {
    "stiffness": 512950.0,
    "damping": 198.0,
    "upper_stiffness": 436950.0,
    "fluid_mass": 62.8,
    "fluid_damping": 2666.0,
}


def hydraulic_engine_mounts(
    *, mass=139.5, inertia=ENGINE, points=MOUNTS, hydraulic=None, gravity=0.0
) -> Model:
    """Return an engine on a hydraulic mount and two rubber ones, between the body `engine` and the
    support `frame`: `engine_on_mounts` with the fluid of mount 1, along z, as an additional
    coordinate.

    Args:
        mass, inertia: mass and inertia of the engine [kg, kg m2], the inertia about its center
            of mass.
        points: positions of the mounts relative to the center of mass (3, 3) [m], the hydraulic
            one first.
        hydraulic: law of mount 1 along z; None: that of the source, which has no decoupler.
        gravity: [m/s2], downward; zero by default, as in the source.

    Source: a powertrain on three mounts (github hojjatkarami/NVHteam).

    >>> model = jb.presets.hydraulic_engine_mounts()
    >>> model.layout.states
    ('mount 1, fluid', 'mount 1, rate of fluid')
    >>> [
    ...     round(float(f), 4)
    ...     for f in jb.complex_modes(jb.linearize(model, model.reference)).natural_frequency
    ... ]
    [7.5009, 8.6181, 8.8047, 10.393, 12.1152, 20.6315, 27.4148]
    """
    rubber = engine_on_mounts(mass=mass, inertia=inertia, points=points)
    (x, y, _), (c_x, c_y, _) = MOUNT_STIFFNESS[0], MOUNT_DAMPING[0]
    place = np.asarray(points)[0]
    z = laws.Hydraulic(**HYDRAULIC) if hydraulic is None else hydraulic
    first = Mount(("engine", place), ("frame", place), x=x, y=y, z=z, damping=[c_x, c_y, 0.0])
    return Model(
        bodies={"engine": rubber["engine"]},
        supports={"frame": Support()},
        elements={"mount 1": first} | {name: rubber[name] for name in ("mount 2", "mount 3")},
        gravity=[0, 0, -gravity],
    )


def _corners(at: Any) -> list[tuple[Any, Any, Any]]:
    """Return the points at (+-ax, +-ay, -az)."""
    return [(x, y, -at[2]) for x in (at[0], -at[0]) for y in (at[1], -at[1])]


def isolated_table(
    *,
    mass=200.0,
    gyration=(0.35, 0.42, 0.5),
    stiffness=(3e4, 5e4, 8e4),
    damping=(0.0, 0.0, 0.0),
    at=(0.45, 0.3, 0.25),
    gravity=0.0,
) -> Model:
    """Return a table with two planes of symmetry on four equal upright isolators at (+-ax, +-ay,
    -az) from its center, on the support `floor`.

    Args:
        mass: mass of the table [kg].
        gyration: radii of gyration about x, y, z [m].
        stiffness, damping: stiffness and damping of one isolator along x, y, z [N/m, N s/m].
        at: ax, ay, az [m].
        gravity: [m/s2], downward; zero by default.

    Source: Harris, Shock and Vibration Handbook, chapter 3: z 6.366198 Hz, yaw 5.097929 Hz.

    >>> jb.presets.isolated_table().element_names[0]
    'isolator 1'
    """
    return Model(
        bodies={"table": Body(mass=mass, inertia=mass * np.asarray(gyration) ** 2)},
        supports={"floor": Support()},
        elements={
            f"isolator {i}": Bushing(
                ("table", p), ("floor", p), stiffness=stiffness, damping=damping
            )
            for i, p in enumerate(_corners(at), 1)
        },
        gravity=[0, 0, -gravity],
    )


def stewart_table(
    *,
    mass=50.0,
    inertia=(2.0, 2.0, 3.5),
    stiffness=1e4,
    damping=0.0,
    upper=0.4,
    lower=0.6,
    height=0.5,
    spread=15.0,
    gravity=G,
) -> Model:
    """Return a Stewart platform whose six legs are springs: `table` on three V-shaped pairs of legs
    from the support `base`.

    The free length of the legs is such that the reference pose is the equilibrium under the weight.

    Args:
        mass, inertia: mass and inertia of the table [kg, kg m2].
        stiffness, damping: stiffness and damping of one leg [N/m, N s/m].
        upper, lower: radii of the circles on which the legs end [m].
        height: height of the upper circle above the lower one [m].
        spread: half the angle between two neighboring leg ends [degrees].
        gravity: [m/s2], downward.

    Source: D. Stewart, Proc. Inst. Mech. Eng. 180 (1965) 371, in the symmetric form with leg ends
    in pairs.

    >>> jb.presets.stewart_table().layout.nv, len(jb.presets.stewart_table().element_names)
    (6, 6)
    """
    pairs = np.deg2rad([120 * i for i in range(3)])
    ends = np.deg2rad(spread) * np.array([-1, 1])
    above = [(upper * np.cos(p + e), upper * np.sin(p + e), 0) for p in pairs for e in ends]
    below = [
        (lower * np.cos(p - e), lower * np.sin(p - e), 0) for p in pairs + np.pi / 3 for e in ends
    ]
    below = [below[-1], *below[:-1]]  # each leg leans toward the neighboring pair
    length = np.linalg.norm(np.add(above[0], [0, 0, height]) - below[0])
    relaxed = length + mass * gravity * length / (6 * stiffness * height)
    return Model(
        bodies={"table": Body(mass=mass, inertia=inertia, position=[0, 0, height])},
        supports={"base": Support()},
        elements={
            f"leg {i}": Spring(
                ("table", a), ("base", b), stiffness=stiffness, damping=damping, free_length=relaxed
            )
            for i, (a, b) in enumerate(zip(above, below, strict=True), 1)
        },
        gravity=[0, 0, -gravity],
    )


def elastic_pendulum(
    *, mass=1.0, stiffness=4 * np.pi**2, free_length=0.75, damping=0.0, gravity=np.pi**2
) -> Model:
    """Return a bob that hangs on a spring from the world, free to move but not to rotate; in
    equilibrium the bob is at z = 0, below the pivot.

    Args:
        mass: mass of the bob [kg].
        stiffness, free_length, damping: stiffness, free length and damping of the spring [N/m, m,
            N s/m].
        gravity: [m/s2], downward.

    Source: P. Lynch, the swinging spring: in 2:1 resonance it alternates between bouncing and
    swinging, each time in another plane.

    >>> jb.presets.elastic_pendulum().layout.coordinates[2]
    'bob move along z'
    """
    length = free_length + mass * gravity / stiffness
    spring = Spring(
        ("bob", [0, 0, 0]),
        ("world", [0, 0, length]),
        stiffness=stiffness,
        free_length=free_length,
        damping=damping,
    )
    return Model(
        bodies={"bob": Body(mass=mass, inertia=POINT)},
        joints={"bob": Translation("world")},  # pyright: ignore[reportCallIssue]
        elements={"spring": spring},
        gravity=[0, 0, -gravity],
    )


def double_pendulum(*, masses=(1.0, 1.0), lengths=(1.0, 1.0), gravity=G) -> Model:
    """Return two uniform rods, `upper` and `lower`, that swing in the x-z plane on hinges about y.

    Source: for example L. D. Landau, E. M. Lifshitz, Mechanics, section 5, with rods instead of
    point masses.

    >>> jb.presets.double_pendulum().layout.motions
    (('upper', 'turn about its hinge'), ('lower', 'turn about its hinge'))
    """
    (m1, m2), (l1, l2) = masses, lengths

    def rod(m, l, z):
        return Body(
            mass=m,
            inertia=m * l**2 / 12 * np.array([1, 1, 0.01]),
            com=[0, 0, -l / 2],
            position=[0, 0, z],
        )

    return Model(
        bodies={"upper": rod(m1, l1, 0.0), "lower": rod(m2, l2, -l1)},
        joints={
            "upper": Hinge("world", axis=[0, 1, 0]),
            "lower": Hinge("upper", axis=[0, 1, 0], at=[0, 0, -l1]),
        },
        gravity=[0, 0, -gravity],
    )


def coupled_gliders(
    *, masses=(0.3, 0.3), stiffness=(3.0, 3.0, 3.0), damping=(0.0, 0.0, 0.0), span=1.5, length=0.3
) -> Model:
    """Return two gliders, `one` and `two`, on an air track along x, coupled to each other and to
    the ends of the track by springs.

    The springs are `left`, `middle` and `right`.

    Args:
        masses: masses of the two gliders [kg].
        stiffness, damping: stiffness and damping of the three springs [N/m, N s/m].
        span: length of the track [m]; in the reference pose each spring is a third of it long.
        length: free length of each spring [m].

    Source: M. Schmidt, H. Lipson, Science 324 (2009) 81; examples/gliders.py fits their record.

    >>> jb.presets.coupled_gliders().element_names
    ('left', 'middle', 'right')
    """
    places = {"one": span / 3, "two": 2 * span / 3}
    ends = {
        "left": (("world", [0, 0, 0]), ("one", [0, 0, 0])),
        "middle": (("one", [0, 0, 0]), ("two", [0, 0, 0])),
        "right": (("two", [0, 0, 0]), ("world", [span, 0, 0])),
    }
    return Model(
        bodies={
            name: Body(mass=m, inertia=POINT, position=[x, 0, 0])
            for (name, x), m in zip(places.items(), masses, strict=True)
        },
        joints={name: Guide("world", axis=[1, 0, 0]) for name in places},
        elements={
            name: Spring(*pair, stiffness=k, damping=c, free_length=length)
            for (name, pair), k, c in zip(ends.items(), stiffness, damping, strict=True)
        },
    )


PRONY = ((0.25, 0.1), (0.25, 0.01), (0.25, 0.001))


def rubber_isolators(
    *,
    mass=50.0,
    gyration=(0.25, 0.3, 0.35),
    stiffness=(1e4, 1e4, 4e4),
    prony=PRONY,
    at=(0.3, 0.25, 0.1),
    gravity=0.0,
) -> Model:
    """Return an `instrument` on four equal rubber isolators at (+-ax, +-ay, -az) from its center,
    on the support `floor`. In every direction the dynamic stiffness of each is a Prony series,

        K(i w) = k (1 + sum g_j i w tau_j/(1 + i w tau_j)),
        F(t) = k e (1 + sum g_j exp(-t/tau_j)) after a step e

    which is a spring and as many Maxwell branches.

    Args:
        mass: mass of the instrument [kg].
        gyration: its radii of gyration about x, y, z [m].
        stiffness: k of one isolator along x, y, z after a long time [N/m].
        prony: pairs of g_j, the stiffness of a branch relative to k, and tau_j, its relaxation
            time [s].
        at: ax, ay, az [m].
        gravity: [m/s2], downward; zero by default.

    Source of the form: R. S. Lakes, Viscoelastic Materials (2009), chapter 2. The numbers have no
    source: they are those of a rubber whose loss angle is about 5 to 8 degrees from 1 to 200 Hz.

    >>> law = jb.presets.rubber_isolators()["isolator 1"].z
    >>> K = jb.vibration.dynamic_stiffness(law, [1.0, 200.0])
    >>> [round(float(x)) for x in K.magnitude]
    [43184, 66308]
    """

    def isolator(k):
        return laws.Sum(
            laws.Linear(k),
            *(laws.Maxwell(stiffness=g * k, relaxation_time=tau) for g, tau in prony),
        )

    x, y, z = map(isolator, stiffness)
    return Model(
        bodies={"instrument": Body(mass=mass, inertia=mass * np.asarray(gyration) ** 2)},
        supports={"floor": Support()},
        elements={
            f"isolator {i}": Mount(("instrument", p), ("floor", p), x=x, y=y, z=z)
            for i, p in enumerate(_corners(at), 1)
        },
        gravity=[0, 0, -gravity],
    )
