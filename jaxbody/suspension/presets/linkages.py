"""A planar four-bar linkage: crank, coupler and rocker on hinges, closed by a fourth one, with a
torsion spring at the crank."""

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.geometry.closures import Hinge as HingeClosure
from jaxbody.model.bodies import Body
from jaxbody.model.elements.torsions import Torsion
from jaxbody.model.joints.joints import Hinge
from jaxbody.model.models import Model

SLENDER = 0.05  # ratio of radius to length of a bar; affects the inertia about its axis only


def four_bar(
    *,
    crank=0.04,
    coupler=0.12,
    rocker=0.08,
    ground=0.1,
    angle=40.0,
    density=1.0,
    stiffness=2.0,
    gravity=0.0,
) -> Model:
    """Return a four-bar linkage in the plane of x and y: `crank` and `rocker` turn about hinges on
    the world at x = 0 and x = `ground`, `coupler` about one at the end of the crank; the closure
    `pin` joins its end to that of the rocker.

    Each bar has its O in its first hinge and its x along it. Three of the five conditions of the
    pin follow from the plane and are named as redundant. Without gravity the reference pose is
    the equilibrium.

    Args:
        crank, coupler, rocker, ground: lengths between hinges [m]
        angle: angle of the crank from x in the reference pose [deg]; the pin is above the line from
            the crank's end to the hinge of the rocker
        density: mass per length of the bars [kg/m]
        stiffness: of the torsion spring between world and crank, relaxed in the reference pose
            [N m/rad]
        gravity: [m/s2], along -y

    Errors: NOT_CLOSED where coupler and rocker do not meet. Source: R. L. Norton, Design of
    Machinery, for lengths and angle; the angles of coupler and rocker are those of
    Freudenstein's equation.

    >>> model = jb.presets.four_bar()
    >>> eq = jb.equilibrium(model)
    >>> len(eq.redundant), round(float(jb.modes(jb.linearize(model, eq)).frequency[0]), 4)
    (3, 18.1984)
    """
    turn = np.deg2rad(angle)
    end = crank * np.array([np.cos(turn), np.sin(turn)])  # of the crank
    between = np.array([ground, 0.0]) - end
    distance = np.hypot(*between)
    # of the angle at the end of the crank, in the triangle of coupler, rocker and the line between
    cosine = (distance**2 + coupler**2 - rocker**2) / (2 * distance * coupler)
    if not abs(cosine) <= 1:
        raise JaxbodyError(
            Problem(
                "NOT_CLOSED",
                "four_bar",
                f"has coupler and rocker that do not meet over {distance:.6g} m",
                distance,
                f"{abs(coupler - rocker):.6g} to {coupler + rocker:.6g} m",
                "Change a length or the angle of the crank.",
            )
        )
    of_coupler = np.arctan2(between[1], between[0]) + np.arccos(cosine)
    pin = end + coupler * np.array([np.cos(of_coupler), np.sin(of_coupler)])
    of_rocker = np.arctan2(pin[1], pin[0] - ground)

    def bar(length: float, start: tuple[float, float], turned: float) -> Body:
        """Return a uniform bar from `start`, at an angle of `turned` [rad] from the x axis."""
        mass, half = density * length, turned / 2
        across, about = mass * length**2 / 12, mass * (SLENDER * length) ** 2 / 2
        return Body(
            mass=mass,
            inertia=[about, across, across],
            com=[length / 2, 0, 0],
            position=[*start, 0],
            orientation=[np.cos(half), 0, 0, np.sin(half)],
        )

    return Model(
        bodies={
            "crank": bar(crank, (0.0, 0.0), turn),
            "coupler": bar(coupler, (end[0], end[1]), of_coupler),
            "rocker": bar(rocker, (ground, 0.0), of_rocker),
        },
        joints={
            "crank": Hinge("world", axis="z", at=[0, 0, 0]),
            "coupler": Hinge("crank", axis="z", at=[crank, 0, 0]),
            "rocker": Hinge("world", axis="z", at=[ground, 0, 0]),
        },
        closures={
            "pin": HingeClosure(("coupler", [coupler, 0, 0]), ("rocker", [rocker, 0, 0]), axis="z")
        },
        elements={"spring": Torsion("world", "crank", axis="z", spring=stiffness, free_angle=turn)},
        gravity=[0, -gravity, 0],
    )
