"""A full car on four double wishbones: fourteen bodies, four loops at each wheel, in equilibrium as it is drawn."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from jaxbody.core.errors import Problems
from jaxbody.elements.bushings import Bushing
from jaxbody.elements.contacts import Tyre
from jaxbody.elements.elements import Element
from jaxbody.elements.springs import Spring
from jaxbody.elements.torsions import AntiRollBar
from jaxbody.geometry.closures import Ball as BallClosure
from jaxbody.geometry.closures import Closure, Rod
from jaxbody.joints.elementary_joints import Ball, Guide, Hinge
from jaxbody.joints.series_joints import HeavePitchRoll
from jaxbody.mechanisms.ready_corners import DOUBLE_WISHBONE, Points, points_of
from jaxbody.models.bodies import Body, Support
from jaxbody.models.joints import Joint
from jaxbody.models.models import Model

G = 9.81
ENGAGEMENT = 1e-3  # m, over which a tyre's stiffness builds up
ARM_INERTIA, UPRIGHT_INERTIA, RACK_INERTIA = (0.08, 0.02, 0.1), (0.6, 1.0, 0.6), (0.1, 0.01, 0.1)  # kg m2
SIDES = {"l": 1.0, "r": -1.0}


def full_car_on_double_wishbones(
    *, front_points: Mapping[str, Any] | None = None, rear_points: Mapping[str, Any] | None = None, mass=1100.0,
    inertia=(450.0, 1500.0, 1700.0), front=1.2, rear=1.4, height=0.5, unsprung=(32.0, 27.0), arm=4.0, rack=3.0,
    stiffness=(70000.0, 75000.0), damping=(4800.0, 5000.0), tyre=(190000.0, 190000.0), anti_roll=(12000.0, 6000.0), steering=2e6,
    gravity=G,
) -> Model:  # fmt: skip
    """A car whose wheels are on double wishbones: `car` heaves, pitches and rolls about its center of mass; on it are, for each wheel `fl`,
    `fr`, `rl` and `rr`, "fl lower arm", "fl upper arm" and "fl upright", which carries the wheel, and the `rack` of the front wheels.

    Tie rods have no mass: the front ones go to the rack, which a stiffness holds, the rear ones to the car. Springs are on the lower arms,
    anti-roll bars on the uprights; right wheels are mirrored. The free lengths are such that the reference pose is the equilibrium. In each
    pair the first number is for the front axle, the second for the rear axle.

    Args:
        front_points, rear_points: {name: place [m]} of the hard points of left wheels that differ from `jb.double_wishbone`, with the wheel
            center above x = 0 of the axle and z = 0 on the road
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

    Errors: UNKNOWN_NAME, BAD_SHAPE, NON_FINITE of hard points. Source: hard points as in `jb.double_wishbone`; the other numbers are those
    of a compact car.

    >>> car = full_car_on_double_wishbones()
    >>> len(car.layout.bodies), car.layout.nv, len(car.closure_names)
    (14, 24, 8)
    """
    with Problems() as problems:
        given = (("front_points", front_points), ("rear_points", rear_points))
        axles = [points_of(DOUBLE_WISHBONE, points, f"full_car_on_double_wishbones.{name}", problems) for name, points in given]
    wheels = {}
    for axle, (end, x) in enumerate((("f", front), ("r", -rear))):
        for side, sign in SIDES.items():
            points: Points = {name: np.asarray(point) * [1, sign, 1] for name, point in axles[axle].items()}
            wheels[end + side] = _Wheel(end + side, axle, points, np.array([x, 0.0, 0.0]), np.array([0.0, 0.0, height]))
    bodies = {"car": Body(mass=mass, inertia=inertia, position=[0, 0, height])}
    joints: dict[str, Joint] = {"car": HeavePitchRoll("world")}  # pyright: ignore[reportCallIssue]  # the class sets the other fields
    closures: dict[str, Closure] = {}
    for wheel in wheels.values():
        bodies |= wheel.bodies(arm, unsprung[wheel.axle])
        joints |= wheel.joints()
        closures |= wheel.closures()
    inner = wheels["fl"].points["tie rod inner"] * [1, 0, 1]
    bodies["rack"] = Body(mass=rack, inertia=RACK_INERTIA, com=inner, position=wheels["fl"].offset)
    joints["rack"] = Guide("car", axis="y")
    elements: dict[str, Element] = {}
    loads = _wheel_loads(bodies, wheels, gravity)
    for name, wheel in wheels.items():
        pull = wheel.spring_tension(bodies, loads[wheel.axle], gravity)
        k, c, k_tyre = stiffness[wheel.axle], damping[wheel.axle], tyre[wheel.axle]
        lower, upper = wheel.points["spring lower"], wheel.points["spring upper"]
        length, center = np.linalg.norm(upper - lower), wheel.points["wheel center"]
        ends = (f"{name} lower arm", lower), ("car", wheel.on_car(upper))
        elements[f"spring {name}"] = Spring(*ends, stiffness=k, damping=c, free_length=length - pull / k)
        radius = center[2] + loads[wheel.axle] / k_tyre + ENGAGEMENT / 2
        hub = (f"{name} upright", center)
        elements[f"tyre {name}"] = Tyre(hub, f"road {name}", stiffness=k_tyre, radius=radius, engagement=ENGAGEMENT)
    for axle, (end, name) in enumerate((("f", "front"), ("r", "rear"))):
        left, right = ((f"{end}{side} upright", wheels[end + side].points["wheel center"]) for side in SIDES)
        elements[f"bar {name}"] = AntiRollBar(left, right, "car", spring=anti_roll[axle])
    elements["steering"] = Bushing(("rack", inner), ("car", wheels["fl"].on_car(inner)), stiffness=[0, steering, 0])
    return Model(
        bodies=bodies,
        supports={f"road {name}": Support(position=wheel.center_in_world * [1, 1, 0]) for name, wheel in wheels.items()},
        joints=joints,
        elements=elements,
        closures=closures,
        gravity=[0, 0, -gravity],
    )


class _Wheel(NamedTuple):
    """A wheel with its suspension: hard points about the middle of its axle on the road, which is at `offset`; `center` is O of the car."""

    name: str
    axle: int
    points: Points
    offset: np.ndarray
    center: np.ndarray

    def on_car(self, point: np.ndarray) -> np.ndarray:
        """A point in the axes of the car, whose O is its center of mass."""
        return point + self.offset - self.center

    @property
    def center_in_world(self) -> np.ndarray:
        return self.offset + self.points["wheel center"]

    def bodies(self, arm: float, unsprung: float) -> dict[str, Body]:
        def body(mass: float, inertia: Any, *names: str) -> Body:
            com = np.mean([self.points[name] for name in names], 0)
            return Body(mass=mass, inertia=inertia, com=com, position=self.offset)

        return {
            f"{self.name} lower arm": body(arm, ARM_INERTIA, "lower inner front", "lower inner rear", "lower outer", "lower outer"),
            f"{self.name} upper arm": body(arm, ARM_INERTIA, "upper inner front", "upper inner rear", "upper outer", "upper outer"),
            f"{self.name} upright": body(unsprung, UPRIGHT_INERTIA, "wheel center"),
        }

    def joints(self) -> dict[str, Joint]:
        return {
            f"{self.name} lower arm": self._hinge("lower inner front", "lower inner rear"),
            f"{self.name} upper arm": self._hinge("upper inner front", "upper inner rear"),
            f"{self.name} upright": Ball(f"{self.name} lower arm", at=self.points["lower outer"]),
        }

    def _hinge(self, front: str, rear: str) -> Hinge:
        return Hinge("car", axis=self.points[front] - self.points[rear], at=self.on_car(self.points[front]))

    def closures(self) -> dict[str, Closure]:
        ball, inner, outer = (self.points[name] for name in ("upper outer", "tie rod inner", "tie rod outer"))
        held = ("rack", inner) if self.axle == 0 else ("car", self.on_car(inner))
        return {
            f"{self.name} upper ball": BallClosure((f"{self.name} upper arm", ball), (f"{self.name} upright", ball)),
            f"{self.name} tie rod": Rod(held, (f"{self.name} upright", outer)),
        }

    def velocities(self) -> dict[str, tuple[np.ndarray, np.ndarray, np.ndarray]]:
        """(angular velocity, a point, its velocity) of each body for the lower arm turning about its hinge at 1 rad/s on a car at rest: the
        upper ball has one velocity on both bodies, and the tie rod keeps its length."""
        at, n = self.points, {}
        for level in ("lower", "upper"):
            axis = at[f"{level} inner front"] - at[f"{level} inner rear"]
            n[level] = axis / np.linalg.norm(axis)
        lower = np.cross(n["lower"], at["lower outer"] - at["lower inner front"])
        upper = np.cross(n["upper"], at["upper outer"] - at["upper inner front"])
        up, out = at["upper outer"] - at["lower outer"], at["tie rod outer"] - at["lower outer"]
        rod = at["tie rod outer"] - at["tie rod inner"]
        A = np.zeros((4, 4))  # of the angular velocity of the upright and the rate of the upper arm
        A[:3, :3] = [[0, up[2], -up[1]], [-up[2], 0, up[0]], [up[1], -up[0], 0]]  # w x up
        A[:3, 3] = -upper
        A[3, :3] = np.cross(out, rod)
        *w, rate = np.linalg.solve(A, [*-lower, -rod @ lower])
        return {
            "lower arm": (n["lower"], at["lower inner front"], np.zeros(3)),
            "upper arm": (rate * n["upper"], at["upper inner front"], np.zeros(3)),
            "upright": (np.array(w), at["lower outer"], lower),
        }

    def spring_tension(self, bodies: Mapping[str, Body], load: float, gravity: float) -> float:
        """The tension of the spring that carries the load of the wheel: no power of all forces as the suspension moves on the car,

        N v_hub - sum m g v_com - T l' = 0"""
        moving = self.velocities()

        def velocity(name: str, point: Any) -> np.ndarray:
            w, at, v = moving[name]
            return v + np.cross(w, np.asarray(point) - at)

        weights = {name: float(bodies[f"{self.name} {name}"].mass) * gravity for name in moving}
        power = load * velocity("upright", self.points["wheel center"])[2]
        power -= sum(weights[name] * velocity(name, bodies[f"{self.name} {name}"].com)[2] for name in moving)
        along = self.points["spring lower"] - self.points["spring upper"]
        return power / (velocity("lower arm", self.points["spring lower"]) @ along / np.linalg.norm(along))


def _wheel_loads(bodies: Mapping[str, Body], wheels: Mapping[str, _Wheel], gravity: float) -> tuple[float, float]:
    """The load of a front and of a rear wheel [N], by the moments of all weights about the axles."""
    weights = np.array([float(body.mass) * gravity for body in bodies.values()])
    x = np.array([np.asarray(body.position)[0] + np.asarray(body.com)[0] for body in bodies.values()])
    front, rear = (wheel.center_in_world[0] for wheel in (wheels["fl"], wheels["rl"]))
    on_front = weights @ (x - rear) / (front - rear) / 2
    return on_front, weights.sum() / 2 - on_front
