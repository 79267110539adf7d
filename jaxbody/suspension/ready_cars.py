"""A car on four double wishbones, defined by its hard points: fourteen bodies, two closures at each
wheel, in equilibrium as it is drawn."""

from collections.abc import Mapping
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import is_concrete
from jaxbody.core.errors import Problems, check_known
from jaxbody.geometry.closures import Ball as BallClosure
from jaxbody.geometry.closures import Closure, Rod
from jaxbody.model.bodies import Body, Support
from jaxbody.model.elements.bushings import Bushing
from jaxbody.model.elements.contacts import Tyre
from jaxbody.model.elements.elements import Element
from jaxbody.model.elements.springs import Spring
from jaxbody.model.elements.torsions import AntiRollBar
from jaxbody.model.joints.combined_joints import HeavePitchRoll
from jaxbody.model.joints.joints import Ball, Guide, Hinge, Joint
from jaxbody.model.models import Model
from jaxbody.suspension.alignment_curves import SuspensionCurves, suspension_curves
from jaxbody.suspension.suspensions import (
    DOUBLE_WISHBONE,
    Points,
    Suspension,
    points_of,
    wheel_of,
)
from jaxbody.suspension.wheels import Wheel

G = 9.81
ENGAGEMENT = 1e-3  # m, compression over which a tyre's stiffness builds up
# kg m2
ARM_INERTIA, UPRIGHT_INERTIA, RACK_INERTIA = (0.08, 0.02, 0.1), (0.6, 1.0, 0.6), (0.1, 0.01, 0.1)
ENDS, SIDES = ("f", "r"), {"l": 1.0, "r": -1.0}


class Car(Suspension):
    """A car on double wishbones: `model`, in the design position; `fl`, `fr`, `rl` and `rr`, its
    wheels; hard points as in a `Suspension`, such as "front lower outer" and "rear lower outer",
    are those of left wheels; the right wheels are their mirror images.

    >>> car = jb.suspension.car_on_double_wishbones()
    >>> car.moved({"rear tie rod inner": [0.05, 0.2, 0.26]}).model["rr tie rod"].a[1:].tolist()
    [-0.2, -0.24]
    """

    fl: Wheel
    fr: Wheel
    rl: Wheel
    rr: Wheel

    def curves(self, wheel: str, travel: Any, steering: Any = 0.0) -> SuspensionCurves:
        """Compute curves of a wheel, such as "fl", over its travel [m] and the displacement of the
        rack [m], each one number or as many as the other has, while the car is held. The wheel
        force is that of all elements, including the tyre; see `suspension_curves`. Errors:
        UNKNOWN_NAME.

        >>> car = jb.suspension.car_on_double_wishbones()
        >>> toe = car.curves("fr", [-0.04, 0.0, 0.04])["toe"]  # doctest: +SKIP
        """
        names = tuple(end + side for end in ENDS for side in SIDES)
        check_known(wheel, "Car.curves.wheel", names)
        held = {name: f"car.q.{i}" for i, name in enumerate(("heave", "pitch", "roll"))}
        moved = getattr(self, wheel)
        return suspension_curves(
            self.model,
            drive={"travel": moved, "steering": "rack.q"} | held,
            over={"travel": travel, "steering": steering} | dict.fromkeys(held, 0.0),
            wheel=moved,
        )


def car_on_double_wishbones(
    *,
    front_points: Points | None = None,
    rear_points: Points | None = None,
    mass=1100.0,
    inertia: Any = (450.0, 1500.0, 1700.0),
    front=1.2,
    rear=1.4,
    height=0.5,
    unsprung: Any = (32.0, 27.0),
    arm=4.0,
    rack=3.0,
    stiffness: Any = (70000.0, 75000.0),
    damping: Any = (4800.0, 5000.0),
    tyre: Any = (190000.0, 190000.0),
    anti_roll: Any = (12000.0, 6000.0),
    steering=2e6,
    gravity=G,
) -> Car:
    """Return a car whose wheels are on double wishbones: `car` heaves, pitches and rolls about its
    center of mass; on it are, for each wheel `fl`, `fr`, `rl` and `rr`, "fl lower arm", "fl upper
    arm" and "fl upright", which carries the wheel, and the `rack` of the front wheels.

    Tie rods have no mass: the front ones end at the rack, which is held by a stiffness, the rear
    ones at the car. Springs are on the lower arms, anti-roll bars on the uprights; right wheels are
    mirrored. The free lengths are such that the reference pose is the equilibrium. In each pair the
    first number is for the front axle, the second for the rear axle.

    Args:
        front_points, rear_points: {name: place [m]} of the hard points of left wheels that differ
            from `jb.suspension.double_wishbone`, with the wheel center above x = 0 of the axle and
            z = 0 on the road
        mass, inertia: of the car without suspensions [kg, kg m2]
        front, rear: distances of the axles from the center of mass [m]
        height: of the center of mass of the car above the road [m]
        unsprung: masses of one wheel with its upright [kg]
        arm, rack: masses of an arm and of the rack [kg]
        stiffness, damping: of one spring, along it [N/m, N s/m]
        tyre: stiffnesses of one tyre [N/m]
        anti_roll: stiffnesses of the anti-roll bars [N/m at the wheels]
        steering: stiffness that holds the rack on the car [N/m]
        gravity: [m/s2], downward

    A car whose points are `moved` keeps the compression of its springs and the rest of its numbers,
    so that it settles elsewhere.

    Errors: UNKNOWN_NAME, BAD_SHAPE, NON_FINITE, WRONG_SIDE, UNIT of hard points. Source: hard
    points as in `jb.suspension.double_wishbone`; the other numbers are those of a compact car.

    >>> model = jb.suspension.car_on_double_wishbones().model
    >>> len(model.layout.bodies), model.layout.nv, len(model.closure_names)
    (14, 24, 8)
    """
    with Problems() as problems:
        axles = [
            points_of(DOUBLE_WISHBONE, points, f"car_on_double_wishbones.{end}_points", problems)
            for end, points in (("front", front_points), ("rear", rear_points))
        ]
    xp: Any = (
        np if is_concrete((axles, front, rear, height, mass, unsprung, arm, rack, gravity)) else jnp
    )
    wheels = {}
    for axle, (end, x) in enumerate(zip(ENDS, (front, -rear), strict=True)):
        for side, sign in SIDES.items():
            points: Points = {
                name: xp.asarray(point) * np.array([1, sign, 1])
                for name, point in axles[axle].items()
            }
            offset, center = xp.stack([x, 0.0, 0.0]), xp.stack([0.0, 0.0, height])
            wheels[end + side] = _Drawn(
                end + side,
                axle,
                points,
                offset,
                center,
                {"lower arm": arm, "upper arm": arm, "upright": unsprung[axle]},
                xp,
            )
    bodies = {"car": Body(mass=mass, inertia=inertia, position=wheels["fl"].center)}
    # the class sets the other fields
    joints: dict[str, Joint] = {"car": HeavePitchRoll("world")}  # pyright: ignore[reportCallIssue]
    closures: dict[str, Closure] = {}
    for wheel in wheels.values():
        bodies |= wheel.bodies()
        joints |= wheel.joints()
        closures |= wheel.closures()
    inner = wheels["fl"].points["tie rod inner"] * np.array([1, 0, 1])
    bodies["rack"] = Body(mass=rack, inertia=RACK_INERTIA, com=inner, position=wheels["fl"].offset)
    joints["rack"] = Guide("car", axis="y")
    elements: dict[str, Element] = {}
    loads = _wheel_loads(wheels, mass, (rack, inner + wheels["fl"].offset), gravity)
    for name, wheel in wheels.items():
        pull = wheel.spring_tension(loads[wheel.axle], gravity)
        k, c, k_tyre = stiffness[wheel.axle], damping[wheel.axle], tyre[wheel.axle]
        lower, upper = wheel.points["spring lower"], wheel.points["spring upper"]
        length, center = xp.linalg.norm(upper - lower), wheel.points["wheel center"]
        elements[f"spring {name}"] = Spring(
            (f"{name} lower arm", lower),
            ("car", wheel.on_car(upper)),
            stiffness=k,
            damping=c,
            free_length=length - pull / k,
        )
        elements[f"tyre {name}"] = Tyre(
            (f"{name} upright", center),
            f"road {name}",
            stiffness=k_tyre,
            radius=center[2] + loads[wheel.axle] / k_tyre + ENGAGEMENT / 2,
            engagement=ENGAGEMENT,
        )
    for axle, (end, name) in enumerate(zip(ENDS, ("front", "rear"), strict=True)):
        left, right = (
            (f"{end}{side} upright", wheels[end + side].points["wheel center"]) for side in SIDES
        )
        elements[f"bar {name}"] = AntiRollBar(left, right, "car", spring=anti_roll[axle])
    elements["steering"] = Bushing(
        ("rack", inner), ("car", wheels["fl"].on_car(inner)), stiffness=[0, steering, 0]
    )
    model = Model(
        bodies=bodies,
        supports={
            f"road {name}": Support(position=wheel.center_in_world * np.array([1, 1, 0]))
            for name, wheel in wheels.items()
        },
        joints=joints,
        elements=elements,
        closures=closures,
        gravity=xp.stack([0.0, 0.0, -gravity]),
    )
    named = {
        f"{name} {point}": place
        for name, points in zip(("front", "rear"), axles, strict=True)
        for point, place in points.items()
    }
    return Car(
        model,
        **{name: wheel.wheel() for name, wheel in wheels.items()},
        hard_points=named,
        build=_weightless,
    )


def _weightless(points: Points) -> Car:
    """Return the car with these hard points and relaxed springs."""
    front, rear = (
        {name.removeprefix(f"{end} "): at for name, at in points.items() if name.startswith(end)}
        for end in ("front", "rear")
    )
    return car_on_double_wishbones(front_points=front, rear_points=rear, gravity=0.0)


class _Drawn(NamedTuple):
    """A wheel with its suspension: `points`, the hard points about the middle of its axle on the
    road, which is at `offset`; `center`, the reference point O of the car; `masses` of its bodies
    [kg]; `xp`, NumPy or jax.numpy for the arithmetic."""

    name: str
    axle: int
    points: Points
    offset: Any
    center: Any
    masses: Mapping[str, Any]
    xp: Any

    def on_car(self, point: Any) -> Any:
        """Return a point in the axes of the car, whose O is its center of mass."""
        return point + self.offset - self.center

    @property
    def center_in_world(self) -> Any:
        return self.offset + self.points["wheel center"]

    def wheel(self) -> Wheel:
        at = self.points
        return wheel_of(at, at["wheel center"][2], at["upper outer"], f"{self.name} upright")

    @property
    def centers(self) -> dict[str, Any]:
        """{body: its center of mass}; that of an arm is midway between its outer point and the
        middle of its hinge."""

        def of_arm(level: str) -> Any:
            front, rear, outer = (
                self.points[f"{level} {name}"] for name in ("inner front", "inner rear", "outer")
            )
            return (front + rear + 2 * outer) / 4

        return {
            "lower arm": of_arm("lower"),
            "upper arm": of_arm("upper"),
            "upright": self.points["wheel center"],
        }

    def bodies(self) -> dict[str, Body]:
        inertia = {"lower arm": ARM_INERTIA, "upper arm": ARM_INERTIA, "upright": UPRIGHT_INERTIA}
        return {
            f"{self.name} {name}": Body(
                mass=self.masses[name], inertia=inertia[name], com=com, position=self.offset
            )
            for name, com in self.centers.items()
        }

    def joints(self) -> dict[str, Joint]:
        return {
            f"{self.name} lower arm": self._hinge("lower inner front", "lower inner rear"),
            f"{self.name} upper arm": self._hinge("upper inner front", "upper inner rear"),
            f"{self.name} upright": Ball(f"{self.name} lower arm", at=self.points["lower outer"]),
        }

    def _hinge(self, front: str, rear: str) -> Hinge:
        return Hinge(
            "car", axis=self.points[front] - self.points[rear], at=self.on_car(self.points[front])
        )

    def closures(self) -> dict[str, Closure]:
        ball, inner, outer = (
            self.points[name] for name in ("upper outer", "tie rod inner", "tie rod outer")
        )
        held = ("rack", inner) if self.axle == 0 else ("car", self.on_car(inner))
        return {
            f"{self.name} upper ball": BallClosure(
                (f"{self.name} upper arm", ball), (f"{self.name} upright", ball)
            ),
            f"{self.name} tie rod": Rod(held, (f"{self.name} upright", outer)),
        }

    def velocities(self) -> dict[str, tuple[Any, Any, Any]]:
        """Return (angular velocity, a point, its velocity) of each body while the lower arm turns
        about its hinge at 1 rad/s on a car at rest: the upper ball has the same velocity on both
        bodies, and the tie rod keeps its length."""
        at, n, xp = self.points, {}, self.xp
        for level in ("lower", "upper"):
            axis = at[f"{level} inner front"] - at[f"{level} inner rear"]
            n[level] = axis / xp.linalg.norm(axis)
        lower = xp.cross(n["lower"], at["lower outer"] - at["lower inner front"])
        upper = xp.cross(n["upper"], at["upper outer"] - at["upper inner front"])
        up, out = at["upper outer"] - at["lower outer"], at["tie rod outer"] - at["lower outer"]
        rod = at["tie rod outer"] - at["tie rod inner"]
        # coefficients of the unknowns in w x up - rate upper, at the upper ball
        of_ball = xp.concatenate([xp.cross(np.eye(3), up).T, -upper[:, None]], 1)
        of_rod = xp.concatenate([xp.cross(out, rod), np.zeros(1)])  # rod . (w x out)
        right = xp.concatenate([-lower, -(rod @ lower)[None]])
        # the unknowns: w of the upright, rate of the upper arm
        solved = xp.linalg.solve(xp.concatenate([of_ball, of_rod[None]]), right)
        return {
            "lower arm": (n["lower"], at["lower inner front"], np.zeros(3)),
            "upper arm": (solved[3] * n["upper"], at["upper inner front"], np.zeros(3)),
            "upright": (solved[:3], at["lower outer"], lower),
        }

    def spring_tension(self, load: Any, gravity: Any) -> Any:
        """Return the tension T [N] of the spring that carries the wheel load N, from the condition
        that the power of all forces is zero while the suspension moves on the car at rest:

        N v_hub - sum m g v_com - T l' = 0"""
        if is_concrete(gravity) and gravity == 0:
            return 0.0
        moving = self.velocities()

        def velocity(name: str, point: Any) -> Any:
            w, at, v = moving[name]
            return v + self.xp.cross(w, point - at)

        power = load * velocity("upright", self.points["wheel center"])[2]
        power -= sum(
            self.masses[name] * gravity * velocity(name, com)[2]
            for name, com in self.centers.items()
        )
        along = self.points["spring lower"] - self.points["spring upper"]
        return power / (
            velocity("lower arm", self.points["spring lower"]) @ along / self.xp.linalg.norm(along)
        )


def _wheel_loads(
    wheels: Mapping[str, _Drawn], mass: Any, rack: tuple[Any, Any], gravity: Any
) -> tuple[Any, Any]:
    """Return the load of a front and of a rear wheel [N], by the moments of all weights about the
    axles; `rack`: its mass and center."""
    weights, moments = (mass + rack[0]) * gravity, rack[0] * gravity * rack[1][0]
    for wheel in wheels.values():
        for name, com in wheel.centers.items():
            weights += wheel.masses[name] * gravity
            moments += wheel.masses[name] * gravity * (com + wheel.offset)[0]
    front, rear = (wheels[name].center_in_world[0] for name in ("fl", "rl"))
    on_front = (moments - weights * rear) / (front - rear) / 2
    return on_front, weights / 2 - on_front
