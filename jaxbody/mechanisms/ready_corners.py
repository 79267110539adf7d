"""Ready suspensions of one wheel, by their hard points: double wishbone, MacPherson strut.

A hard point is given once, in the axes of the car, x forward, y to the left, z up [m], with the wheel in its design position; all bodies
have these axes and this origin there. Right wheels have points with negative y. The functions can be part of a compiled function of the
points, so that curves have derivatives by each of them.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import checked, is_concrete
from jaxbody.core.errors import Problems, unknown
from jaxbody.elements.springs import Spring
from jaxbody.geometry.closures import Ball as BallClosure
from jaxbody.geometry.closures import Inline, Rod
from jaxbody.mechanisms.corners import Corner
from jaxbody.mechanisms.wheels import Wheel
from jaxbody.models.bodies import Body
from jaxbody.models.joints import Ball, Guide, Hinge, Joint
from jaxbody.models.models import Model

Points = Mapping[str, Any]
ARM, UPRIGHT, RACK = 4.0, 20.0, 3.0  # kg, for what is not known; curves do not depend on masses
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
_COMMON = ("lower inner front", "lower inner rear", "lower outer", "tie rod inner", "tie rod outer", "axle inner", "wheel center")
MACPHERSON = {name: DOUBLE_WISHBONE[name] for name in _COMMON} | {"strut upper": (-0.04, 0.7, 0.85)}


def double_wishbone(hard_points: Points | None = None, *, stiffness=30e3, force=4000.0, radius=0.3) -> Corner:
    """A wheel on two triangular arms, with a tie rod to a rack and a spring on the lower arm.

    Args:
        hard_points: {name: place [m]} of those that differ from the source; the names are those of `DOUBLE_WISHBONE` beside this function
        stiffness, force: of the spring [N/m], and its compression in the design position [N]
        radius: loaded radius of the wheel [m]

    Errors: UNKNOWN_NAME, BAD_SHAPE, NON_FINITE. Source: hard points of the public project suspension-explorer.

    >>> round(float(jnp.rad2deg(double_wishbone().curves(0.0)["camber"][0])), 6)
    -1.909152
    """
    points = _points(DOUBLE_WISHBONE, hard_points, "double_wishbone")
    lower, upper = points["spring lower"], points["spring upper"]
    free_length = _distance(upper, lower) + force / stiffness
    model = Model(
        bodies=_bodies(points) | {"upper arm": _body(ARM, points, "upper outer")},
        joints={**_joints(points), "upper arm": _hinge(points, "upper inner front", "upper inner rear")},
        closures={
            "upper ball": BallClosure(("upper arm", points["upper outer"]), ("upright", points["upper outer"])),
            "tie rod": Rod(("rack", points["tie rod inner"]), ("upright", points["tie rod outer"])),
        },
        elements={"spring": Spring(("lower arm", lower), ("world", upper), stiffness=stiffness, free_length=free_length)},
    )
    return Corner(model, _wheel(points, radius, points["upper outer"]))


def macpherson(hard_points: Points | None = None, *, stiffness=30e3, force=4000.0, radius=0.3) -> Corner:
    """A wheel on a lower arm and a strut, which slides in the upright and ends at a ball joint on the body, with a tie rod to a rack; the
    spring acts along the strut, from the lower ball joint.

    Args:
        hard_points: {name: place [m]} of those that differ from the source; the names are those of `MACPHERSON` beside this function
        stiffness, force: of the spring [N/m], and its compression in the design position [N]
        radius: loaded radius of the wheel [m]

    Errors: UNKNOWN_NAME, BAD_SHAPE, NON_FINITE. Source: hard points of the public project suspension-explorer.

    >>> round(float(jnp.rad2deg(macpherson().curves(0.0)["kingpin"][0])), 6)
    17.102729
    """
    points = _points(MACPHERSON, hard_points, "macpherson")
    lower, upper = points["lower outer"], points["strut upper"]
    free_length = _distance(upper, lower) + force / stiffness
    model = Model(
        bodies=_bodies(points),
        joints=_joints(points),
        closures={
            "strut": Inline(("upright", lower), ("world", upper), axis=upper - lower),
            "tie rod": Rod(("rack", points["tie rod inner"]), ("upright", points["tie rod outer"])),
        },
        elements={"spring": Spring(("upright", lower), ("world", upper), stiffness=stiffness, free_length=free_length)},
    )
    return Corner(model, _wheel(points, radius, upper))


def _points(source: Points, given: Points | None, where: str) -> dict[str, Any]:
    points = {name: np.asarray(point) for name, point in source.items()}
    with Problems() as problems:
        for name, point in (given or {}).items():
            place = f"{where}.hard_points['{name}']"
            if name not in source:
                problems.collected.append(unknown(name, place, tuple(source)))
                continue
            points[name] = checked(point, ((3,),), place, problems, "Give x, y and z in meters.")
    return points


def _distance(a: Any, b: Any) -> Any:
    xp: Any = np if is_concrete((a, b)) else jnp
    return xp.linalg.norm(a - b)


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


def _wheel(points: dict[str, Any], radius: Any, upper: Any) -> Wheel:
    center = points["wheel center"]
    return Wheel("upright", center=center, axis=center - points["axle inner"], radius=radius, kingpin=[points["lower outer"], upper])
