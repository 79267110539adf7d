"""Ready axles by their hard points: a solid axle on three trailing links and a Panhard rod.

Hard points are in the axes of the car, x forward, y to the left, z up, in meters, in the design
position; the axle has these axes and this origin there.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from jaxbody.core.errors import Problems
from jaxbody.geometry.closures import Rod
from jaxbody.model.bodies import Body
from jaxbody.model.models import Model
from jaxbody.suspension.alignment_curves import SuspensionCurves, suspension_curves
from jaxbody.suspension.ready_corners import points_of, spring_between
from jaxbody.suspension.suspensions import Suspension
from jaxbody.suspension.wheels import Wheel

# kg, kg m2, for what is not known; curves do not depend on them
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
AXLE_LINKS = {
    f"{name} link": (f"{name} link front", f"{name} link rear")
    for name in ("left lower", "right lower", "upper")
}
RODS = AXLE_LINKS | {"Panhard rod": ("Panhard rod body", "Panhard rod axle")}


class Axle(Suspension):
    """A suspension of both wheels: `model`, in the design position, whose body "axle" has the axes
    and the origin of the car; `left` and `right`, its wheels; hard points as of a `Suspension`.

    >>> axle = jb.solid_axle()
    >>> axle.model.closure_names
    ('left lower link', 'right lower link', 'upper link', 'Panhard rod')
    """

    left: Wheel
    right: Wheel

    @property
    def wheels(self):
        return self.left, self.right

    def curves(self, left: Any, right: Any) -> SuspensionCurves:
        """Curves of the left wheel over the rise of the centers of both [m], numbers or as many as
        the other has; see `suspension_curves`. Derivatives "left" are those by this wheel alone,
        with the other held; both together are the bounce of the axle.

        >>> axle = jb.solid_axle()
        >>> camber = axle.curves([-0.03, 0.0, 0.03], [0.03, 0.0, -0.03])["camber"]  # doctest: +SKIP
        """
        drive = {"left": self.left, "right": self.right}
        return suspension_curves(
            self.model, drive=drive, over={"left": left, "right": right}, wheel=self.left
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
    """A solid axle on two lower links and an upper one, with a Panhard rod that holds it sideways,
    and two springs. The links have no mass.

    Args:
        hard_points: {name: place [m]} of those that differ; the names are those of `SOLID_AXLE`
            beside this function
        mass, inertia: of the axle with its wheels [kg, kg m2], about its center of mass midway
            between the wheels
        stiffness, force: of each spring [N/m], and its compression in the design position [N]
        radius: loaded radius of the wheels [m]

    Errors: UNKNOWN_NAME, BAD_SHAPE, NON_FINITE, WRONG_SIDE, UNIT.

    The axle has two freedoms, bounce and roll: with one wheel up by 3 cm and the other down, it
    leans by 6 cm in its track of 1.5 m.

    >>> curves = solid_axle().curves(0.03, -0.03)
    >>> round(float(jnp.sin(-curves["camber"][0])), 6)  # of the left wheel
    0.04
    """
    with Problems() as problems:
        points = points_of(SOLID_AXLE, hard_points, "solid_axle.hard_points", problems)
    center = (points["left wheel center"] + points["right wheel center"]) / 2
    springs = {
        f"{side} spring": spring_between(
            "axle", points[f"{side} spring lower"], points[f"{side} spring upper"], stiffness, force
        )
        for side in ("left", "right")
    }
    model = Model(
        bodies={"axle": Body(mass=mass, inertia=inertia, com=center)},
        closures={
            name: Rod(("world", points[on_car]), ("axle", points[on_axle]))
            for name, (on_car, on_axle) in RODS.items()
        },
        elements=springs,
    )
    wheels = {
        side: Wheel(
            "axle", center=points[f"{side} wheel center"], axis=[0, outward, 0], radius=radius
        )
        for side, outward in (("left", 1), ("right", -1))
    }
    return Axle(model, **wheels, hard_points=points, build=solid_axle)
