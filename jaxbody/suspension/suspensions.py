"""Suspensions drawn by hard points: a model, and points that are one parameter wherever they are
used. Ready ones: double wishbone, MacPherson strut and five links of one wheel, and a solid axle on
three trailing links and a Panhard rod.

A hard point is given once, in the axes of the car, x forward, y to the left, z up [m], with the
wheel in its design position; all bodies have these axes and this origin there. Right wheels have
points with negative y. The functions can be part of a compiled function of the points, so that
curves have derivatives with respect to each of them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, checked, device_array, is_concrete
from jaxbody.core.errors import Problems, check_all_known, unknown
from jaxbody.geometry.closures import Ball as BallClosure
from jaxbody.geometry.closures import Closure, Inline, Rod
from jaxbody.model.bodies import Body
from jaxbody.model.elements.springs import Spring
from jaxbody.model.joints.joints import Ball, Guide, Hinge, Joint
from jaxbody.model.models import Model
from jaxbody.suspension.alignment_curves import SuspensionCurves, suspension_curves
from jaxbody.suspension.wheels import Wheel

S = TypeVar("S", bound="Suspension")


class Suspension(eqx.Module):
    """The model of a suspension, defined by hard points, such as a `Corner` or an `Axle`.

    Args:
        model: in the design position
        hard_points: {name: place [m]} of the points that are one parameter wherever they are used;
            by default none
        build: function {name: place} -> the suspension with these hard points, whose other numbers
            do not matter; it determines what each hard point moves

    `fit` and `tune` take a suspension in place of a model; its hard points are then free by their
    names, free=["lower outer"], with bounds in meters.

    A pendulum whose pin is a hard point:

    >>> def drawn(points):
    ...     model = jb.Model(
    ...         bodies={"bar": jb.Body(mass=1.0, inertia=[1, 1, 1])},
    ...         joints={"bar": jb.Hinge("world", axis="y", at=points["pin"])},
    ...     )
    ...     return jb.suspension.Suspension(model, hard_points=points, build=drawn)
    >>> pendulum = drawn({"pin": [0.0, 0.0, 1.0]})
    >>> pendulum.moved({"pin": [0.0, 0.0, 2.0]}).model.joint("bar").at.tolist()
    [0.0, 0.0, 2.0]
    """

    model: Model
    hard_points: dict[str, Float[Array, "3"]] = eqx.field(
        default_factory=dict, kw_only=True, converter=lambda at: jax.tree.map(device_array, at)
    )
    build: Callable[[dict[str, Any]], Suspension] | None = eqx.field(
        static=True, default=None, kw_only=True
    )

    @property
    def wheels(self) -> tuple[Wheel, ...]:
        """The wheels of the suspension, in the order of its fields."""
        return tuple(part for part in vars(self).values() if isinstance(part, Wheel))

    def moved(self: S, places: Mapping[str, Any]) -> S:
        """Return the suspension with these hard points at other places {name: place [m]}, in the
        model and the wheels: points, axes, lengths of rods. All other numbers remain; a spring
        keeps its compression in the design position. Errors: UNKNOWN_NAME, BAD_SHAPE, NON_FINITE,
        WRONG_SIDE.

        >>> corner = jb.suspension.double_wishbone().moved({"tie rod inner": [0.05, 0.2, 0.255]})
        >>> corner.model["tie rod"].a.tolist()
        [0.05, 0.2, 0.255]
        """
        check_all_known(places, "moved", self.hard_points)
        if self.build is None or not places:
            return self
        points = self.hard_points | dict(places)
        before, after = (self.build(x) for x in (self.hard_points, points))
        leaves, treedef = jax.tree.flatten(_without_points(self))
        changes = zip(
            leaves,
            *(jax.tree.leaves(_without_points(drawn)) for drawn in (before, after)),
            strict=True,
        )
        moved = jax.tree.unflatten(treedef, [now + (new - old) for now, old, new in changes])
        return dataclasses.replace(moved, hard_points=after.hard_points)


def _without_points(suspension: Suspension) -> Any:
    return dataclasses.replace(suspension, hard_points={})


class Corner(Suspension):
    """A suspension of one wheel.

    Args:
        model: in the design position; all its bodies have the axes and the origin of the car
        wheel: the wheel
        steering: the path of the coordinate that steers, such as "rack.q"
        hard_points, build: those of a `Suspension`

    >>> corner = jb.suspension.double_wishbone()
    >>> corner.steering, corner.model.layout.bodies
    ('rack.q', ('lower arm', 'upright', 'rack', 'upper arm'))
    """

    wheel: Wheel
    steering: str = eqx.field(static=True, default="rack.q")

    def curves(self, travel: Any, steering: Any = 0.0) -> SuspensionCurves:
        """Compute the curves of the suspension over `travel`, the rise of the wheel's center [m],
        and `steering`, the coordinate that steers [m or rad]: each a number or a row, rows of equal
        lengths; see `suspension_curves`.

        >>> corner = jb.suspension.double_wishbone()
        >>> toe = corner.curves([-0.04, 0.0, 0.04])["toe"]  # doctest: +SKIP
        """
        return suspension_curves(
            self.model,
            drive=self.drive,
            over={"travel": travel, "steering": steering},
            wheel=self.wheel,
        )

    @property
    def drive(self) -> dict[str, Any]:
        """The driven readings, which are prescribed along the curves: "travel", the rise of the
        wheel's center, and "steering"."""
        return {"travel": self.wheel, "steering": self.steering}


Points = Mapping[str, Any]
ARM, UPRIGHT, RACK = 4.0, 20.0, 3.0  # kg, assumed; curves do not depend on masses
INERTIA = np.full(3, 0.2)  # kg m2

DOUBLE_WISHBONE = {
    "lower inner front": (0.25, 0.4, 0.2),
    "lower inner rear": (-0.25, 0.45, 0.2),
    "lower outer": (0.0, 0.9, 0.2),
    "upper inner front": (0.225, 0.35, 0.5),
    "upper inner rear": (-0.275, 0.35, 0.5),
    "upper outer": (-0.025, 0.75, 0.5),
    "tie rod inner": (0.05, 0.2, 0.25),
    "tie rod outer": (0.15, 0.8, 0.275),
    "axle inner": (-0.02, 0.8, 0.308426),
    "wheel center": (-0.02, 0.95, 0.313426),
    "spring lower": (0.0, 0.7, 0.21),
    "spring upper": (0.0, 0.55, 0.6),
}
_COMMON = (
    "lower inner front",
    "lower inner rear",
    "lower outer",
    "tie rod inner",
    "tie rod outer",
    "axle inner",
    "wheel center",
)
MACPHERSON = {name: DOUBLE_WISHBONE[name] for name in _COMMON} | {"strut upper": (-0.04, 0.7, 0.85)}
FIVE_LINK = {
    "lower front inner": (0.22, 0.38, 0.2),
    "lower front outer": (0.04, 0.66, 0.19),
    "lower rear inner": (-0.16, 0.36, 0.19),
    "lower rear outer": (-0.03, 0.66, 0.2),
    "upper front inner": (0.12, 0.42, 0.5),
    "upper front outer": (-0.01, 0.61, 0.51),
    "upper rear inner": (-0.18, 0.4, 0.49),
    "upper rear outer": (-0.07, 0.62, 0.5),
    "tie rod inner": (0.12, 0.34, 0.25),
    "tie rod outer": (0.15, 0.66, 0.26),
    "axle inner": (0.0, 0.66, 0.298),
    "wheel center": (0.0, 0.76, 0.3),
    "spring lower": (-0.03, 0.62, 0.22),
    "spring upper": (-0.02, 0.52, 0.62),
}
LINKS = ("lower front", "lower rear", "upper front", "upper rear")
LARGEST = 20  # m, largest distance between hard points of one suspension
ACROSS = ("tie rod inner",)  # points that may be on the other side of the car


def double_wishbone(
    hard_points: Points | None = None, *, stiffness=30e3, force=4000.0, radius=0.3
) -> Corner:
    """Return a wheel on two triangular arms, with a tie rod to a rack and a spring on the lower
    arm.

    Args:
        hard_points: {name: place [m]} of those that differ from the source; the names are those of
            `DOUBLE_WISHBONE` beside this function
        stiffness, force: stiffness of the spring [N/m], and its compressive force in the design
            position [N]
        radius: loaded radius of the wheel [m]

    Errors: UNKNOWN_NAME, BAD_SHAPE, NON_FINITE, WRONG_SIDE, UNIT. Source: hard points of the public
    project suspension-explorer.

    >>> round(float(jnp.rad2deg(jb.suspension.double_wishbone().curves(0.0)["camber"][0])), 6)
    -1.909152
    """
    points = _points(DOUBLE_WISHBONE, hard_points, "double_wishbone")
    lower, upper = points["spring lower"], points["spring upper"]
    model = Model(
        bodies=_bodies(points) | {"upper arm": _body(ARM, points, "upper outer")},
        joints={
            **_joints(points),
            "upper arm": _hinge(points, "upper inner front", "upper inner rear"),
        },
        closures={
            "upper ball": BallClosure(
                ("upper arm", points["upper outer"]), ("upright", points["upper outer"])
            ),
            "tie rod": _tie_rod(points),
        },
        elements={"spring": spring_between("lower arm", lower, upper, stiffness, force)},
    )
    return Corner(
        model,
        wheel_of(points, radius, points["upper outer"]),
        hard_points=points,
        build=double_wishbone,
    )


def macpherson(
    hard_points: Points | None = None, *, stiffness=30e3, force=4000.0, radius=0.3
) -> Corner:
    """Return a wheel on a lower arm and a strut, which slides in the upright and ends at a ball
    joint on the body, with a tie rod to a rack; the spring acts along the strut, from the lower
    ball joint.

    Args:
        hard_points: {name: place [m]} of those that differ from the source; the names are those of
            `MACPHERSON` beside this function
        stiffness, force: stiffness of the spring [N/m], and its compressive force in the design
            position [N]
        radius: loaded radius of the wheel [m]

    Errors: UNKNOWN_NAME, BAD_SHAPE, NON_FINITE, WRONG_SIDE, UNIT. Source: hard points of the public
    project suspension-explorer.

    >>> jb.suspension.macpherson().model.closure_names
    ('strut', 'tie rod')
    """
    points = _points(MACPHERSON, hard_points, "macpherson")
    lower, upper = points["lower outer"], points["strut upper"]
    model = Model(
        bodies=_bodies(points),
        joints=_joints(points),
        closures={
            "strut": Inline(("upright", lower), ("world", upper), axis=upper - lower),
            "tie rod": _tie_rod(points),
        },
        elements={"spring": spring_between("upright", lower, upper, stiffness, force)},
    )
    return Corner(model, wheel_of(points, radius, upper), hard_points=points, build=macpherson)


def five_link(
    hard_points: Points | None = None, *, stiffness=30e3, force=4000.0, radius=0.3
) -> Corner:
    """Return a wheel on four links and a tie rod to a rack, with a spring on the upright. The links
    have no mass. The upright has no fixed steering axis: curves use the screw axis of its steering
    motion.

    Args:
        hard_points: {name: place [m]} of those that differ; the names are those of `FIVE_LINK`
            beside this function
        stiffness, force: stiffness of the spring [N/m], and its compressive force in the design
            position [N]
        radius: loaded radius of the wheel [m]

    Errors: UNKNOWN_NAME, BAD_SHAPE, NON_FINITE, WRONG_SIDE, UNIT.

    >>> corner = jb.suspension.five_link({"tie rod outer": [0.15, 0.7, 0.265]})
    >>> corner.model.closures[0].names
    ('lower front link', 'lower rear link', 'upper front link', 'upper rear link', 'tie rod')
    """
    points = _points(FIVE_LINK, hard_points, "five_link")
    lower, upper = points["spring lower"], points["spring upper"]
    links: dict[str, Closure] = {
        f"{name} link": Rod(
            ("world", points[f"{name} inner"]), ("upright", points[f"{name} outer"])
        )
        for name in LINKS
    }
    model = Model(
        bodies={
            "upright": _body(UPRIGHT, points, "wheel center"),
            "rack": _body(RACK, points, "tie rod inner"),
        },
        joints={"rack": Guide("world", axis="y")},
        closures=links | {"tie rod": _tie_rod(points)},
        elements={"spring": spring_between("upright", lower, upper, stiffness, force)},
    )
    return Corner(model, wheel_of(points, radius), hard_points=points, build=five_link)


def _points(source: Points, given: Points | None, where: str) -> dict[str, Any]:
    """Return the hard points of the source, replaced by those that are given, and check that they
    are on one side of the car."""
    with Problems() as problems:
        points = points_of(source, given, f"{where}.hard_points", problems)
        if not problems.collected and is_concrete(points):
            _check_side(points, given or {}, where, problems)
    return points


def points_of(
    source: Points, given: Points | None, where: str, problems: Problems
) -> dict[str, Any]:
    """Return the hard points of the source, replaced by those that are given. Errors: UNKNOWN_NAME,
    BAD_SHAPE, NON_FINITE, WRONG_SIDE, UNIT."""
    points: dict[str, Any] = {name: np.asarray(point) for name, point in source.items()}
    for name, point in (given or {}).items():
        place = f"{where}['{name}']"
        if name in source:
            points[name] = checked(point, ((3,),), place, problems, "Give x, y and z in meters.")
        else:
            problems.collected.append(unknown(name, place, tuple(source)))
    if not problems.collected and is_concrete(points):
        _check_axes(points, where, problems)
    return points


def _check_axes(points: dict[str, Any], where: str, problems: Problems) -> None:
    """Check by the names of the points that x is forward and z up, and that lengths are in meters.
    Problems: WRONG_SIDE, UNIT."""
    for axis, i, (ahead, behind) in (
        ("x forward", 0, ("front", "rear")),
        ("z up", 2, ("upper", "lower")),
    ):
        one, other = (
            float(np.mean([point[i] for name, point in points.items() if word in name]))
            for word in (ahead, behind)
        )
        if one < other:
            problems.add(
                "WRONG_SIDE",
                where,
                (
                    f"has '{ahead}' points at {axis[0]} = {one:.4g} m on average, and '{behind}' "
                    f"ones at {other:.4g} m"
                ),
                value=(one, other),
                limit=axis,
                hint=(
                    f"Is {axis[0]} {'rearward' if i == 0 else 'down'} there? Turn the axes of the "
                    "points: two signs change, not one."
                ),
            )
    if (extent := float(np.ptp(np.array(list(points.values())), 0).max())) > LARGEST:
        problems.add(
            "UNIT",
            where,
            f"spans {extent:.4g} m",
            value=extent,
            limit=f"{LARGEST} m",
            hint="Give all points in meters, not mm.",
        )


def _check_side(points: dict[str, Any], given: Points, where: str, problems: Problems) -> None:
    """Check that all points are on the side of the wheel. Problem: WRONG_SIDE."""
    side = "y > 0 on the left" if points["wheel center"][1] > 0 else "y < 0 on the right"
    wrong = [
        name
        for name, point in points.items()
        if name not in ACROSS and point[1] * points["wheel center"][1] < 0
    ]
    if wrong:
        listed = ", ".join(f"'{name}' at y = {float(points[name][1]):.6g} m" for name in wrong)
        problems.add(
            "WRONG_SIDE",
            f"{where}.hard_points",
            f"has {listed}",
            value=wrong,
            limit=f"{side}, as the wheel center",
            hint=(
                "Correct the signs of y."
                if given.keys() >= set(wrong)
                else "Give all points of a right wheel: those that are not given are those of a "
                "left one."
            ),
        )


def _bodies(points: dict[str, Any]) -> dict[str, Body]:
    return {
        "lower arm": _body(ARM, points, "lower outer"),
        "upright": _body(UPRIGHT, points, "wheel center"),
        "rack": _body(RACK, points, "tie rod inner"),
    }


def _body(mass: float, points: dict[str, Any], at: str) -> Body:
    return Body(mass=mass, inertia=INERTIA, com=points[at])


def _joints(points: dict[str, Any]) -> dict[str, Joint]:
    return {
        "lower arm": _hinge(points, "lower inner front", "lower inner rear"),
        "upright": Ball("lower arm", at=points["lower outer"]),
        "rack": Guide("world", axis="y"),
    }


def _hinge(points: dict[str, Any], front: str, rear: str) -> Hinge:
    return Hinge("world", axis=points[front] - points[rear], at=points[front])


def wheel_of(points: Points, radius: Any, upper: Any = None, on: str = "upright") -> Wheel:
    """Return the wheel on a body of these hard points. `upper`: upper point of its steering axis,
    whose lower point is the lower outer one; None: there is no such axis."""
    center = points["wheel center"]
    return Wheel(
        on,
        center=center,
        axis=center - points["axle inner"],
        radius=radius,
        kingpin=None if upper is None else [points["lower outer"], upper],
    )


def _tie_rod(points: dict[str, Any]) -> Rod:
    return Rod(("rack", points["tie rod inner"]), ("upright", points["tie rod outer"]))


def spring_between(on: str, lower: Any, upper: Any, stiffness: Any, force: Any) -> Spring:
    """Return the spring from a body up to the car, compressed by `force` [N] in the design
    position."""
    xp: Any = np if is_concrete((upper, lower)) else jnp
    return Spring(
        (on, lower),
        ("world", upper),
        stiffness=stiffness,
        free_length=xp.linalg.norm(upper - lower) + force / stiffness,
    )


# kg, kg m2, assumed; curves do not depend on them
AXLE, AXLE_INERTIA = 80.0, (18.0, 2.0, 18.0)

SOLID_AXLE = {
    "left lower link front": (0.55, 0.45, 0.28),
    "left lower link rear": (0.0, 0.5, 0.26),
    "right lower link front": (0.55, -0.45, 0.28),
    "right lower link rear": (0.0, -0.5, 0.26),
    "upper link front": (0.4, 0.0, 0.46),
    "upper link rear": (0.0, 0.0, 0.48),
    "Panhard rod body": (-0.12, 0.48, 0.34),
    "Panhard rod axle": (-0.12, -0.48, 0.32),
    "left spring lower": (-0.02, 0.5, 0.32),
    "left spring upper": (-0.02, 0.47, 0.62),
    "right spring lower": (-0.02, -0.5, 0.32),
    "right spring upper": (-0.02, -0.47, 0.62),
    "left wheel center": (0.0, 0.75, 0.31),
    "right wheel center": (0.0, -0.75, 0.31),
}
RODS = {  # {rod of the solid axle: (its point on the car, its point on the axle)}
    f"{name} link": (f"{name} link front", f"{name} link rear")
    for name in ("left lower", "right lower", "upper")
} | {"Panhard rod": ("Panhard rod body", "Panhard rod axle")}


class Axle(Suspension):
    """A suspension of both wheels: `model`, in the design position, whose body "axle" has the axes
    and the origin of the car; `left` and `right`, its wheels; hard points as in a `Suspension`.

    >>> axle = jb.suspension.solid_axle()
    >>> axle.model.closure_names
    ('left lower link', 'right lower link', 'upper link', 'Panhard rod')
    """

    left: Wheel
    right: Wheel

    def curves(self, left: Any, right: Any) -> SuspensionCurves:
        """Compute curves of the left wheel over the rise of the centers of both [m], each one
        number or as many as the other has; see `suspension_curves`. The derivatives "left" are with
        respect to the rise of this wheel while the other is held; the sum of both is the derivative
        with respect to the bounce of the axle.

        >>> axle = jb.suspension.solid_axle()
        >>> camber = axle.curves([-0.03, 0.0, 0.03], [0.03, 0.0, -0.03])["camber"]  # doctest: +SKIP
        """
        return suspension_curves(
            self.model,
            drive={"left": self.left, "right": self.right},
            over={"left": left, "right": right},
            wheel=self.left,
        )


def solid_axle(
    hard_points: Mapping[str, Any] | None = None,
    *,
    mass=AXLE,
    inertia: Any = AXLE_INERTIA,
    stiffness=30e3,
    force=4000.0,
    radius=0.31,
) -> Axle:
    """Return a solid axle on two lower links and an upper one, with a Panhard rod that holds it
    sideways, and two springs. The links have no mass.

    Args:
        hard_points: {name: place [m]} of those that differ; the names are those of `SOLID_AXLE`
            beside this function
        mass, inertia: of the axle with its wheels [kg, kg m2], about its center of mass midway
            between the wheels
        stiffness, force: stiffness of each spring [N/m], and its compressive force in the design
            position [N]
        radius: loaded radius of the wheels [m]

    Errors: UNKNOWN_NAME, BAD_SHAPE, NON_FINITE, WRONG_SIDE, UNIT.

    The axle has two degrees of freedom, bounce and roll: with one wheel up by 3 cm and the other
    down, it leans by 6 cm in its track of 1.5 m.

    >>> curves = jb.suspension.solid_axle().curves(0.03, -0.03)
    >>> round(float(jnp.sin(-curves["camber"][0])), 6)  # of the left wheel
    0.04
    """
    with Problems() as problems:
        points = points_of(SOLID_AXLE, hard_points, "solid_axle.hard_points", problems)
    center = (points["left wheel center"] + points["right wheel center"]) / 2
    model = Model(
        bodies={"axle": Body(mass=mass, inertia=inertia, com=center)},
        closures={
            name: Rod(("world", points[on_car]), ("axle", points[on_axle]))
            for name, (on_car, on_axle) in RODS.items()
        },
        elements={
            f"{side} spring": spring_between(
                "axle",
                points[f"{side} spring lower"],
                points[f"{side} spring upper"],
                stiffness,
                force,
            )
            for side in ("left", "right")
        },
    )
    wheels = {
        side: Wheel(
            "axle", center=points[f"{side} wheel center"], axis=[0, outward, 0], radius=radius
        )
        for side, outward in (("left", 1), ("right", -1))
    }
    return Axle(model, **wheels, hard_points=points, build=solid_axle)
