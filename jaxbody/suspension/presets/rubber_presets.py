"""A body on rubber isolators that stiffen with frequency, by the Prony series of the rubber."""

from __future__ import annotations

import numpy as np

from jaxbody.model.bodies import Body, Support
from jaxbody.model.elements.bushings import Mount
from jaxbody.model.laws.laws import Linear, Sum
from jaxbody.model.laws.rubber_laws import Maxwell
from jaxbody.model.models import Model

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
    """An `instrument` on four equal rubber isolators at (+-ax, +-ay, -az) from its center, on the
    support `floor`. Each is in every direction a Prony series,

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

    >>> law = rubber_isolators()["isolator 1"].z
    >>> K = jb.dynamic_stiffness(law, [1.0, 200.0])
    >>> [round(float(x)) for x in K.magnitude]
    [43184, 66308]
    """
    ax, ay, az = at
    points = [(x, y, -az) for x in (ax, -ax) for y in (ay, -ay)]
    laws = [
        Sum(Linear(k), *(Maxwell(stiffness=g * k, relaxation_time=tau) for g, tau in prony))
        for k in stiffness
    ]
    return Model(
        bodies={"instrument": Body(mass=mass, inertia=mass * np.asarray(gyration) ** 2)},
        supports={"floor": Support()},
        elements={
            f"isolator {i}": Mount(("instrument", p), ("floor", p), x=laws[0], y=laws[1], z=laws[2])
            for i, p in enumerate(points, 1)
        },
        gravity=[0, 0, -gravity],
    )
