"""Lagrange's equations as `lagrange.py` states them, in the forms that `simulate` integrates:
y = (q, v, z), on closures projected."""

from __future__ import annotations

from typing import Any

from jaxbody import lagrange
from jaxbody.core.arrays import Array, Float
from jaxbody.mechanics.closed_loops import ClosedLoops
from jaxbody.mechanics.dynamics import Dynamics, JointedBodies
from jaxbody.model.states import State


class LagrangeBodies(JointedBodies):
    """Bodies on joints of any kind."""

    def driven(self, u: Any, y: Float[Array, "ny"]) -> Float[Array, "ny"]:
        return _rate(self, u, y)[0]


class LagrangeLoops(ClosedLoops):
    """Bodies on joints and closures."""

    def driven_on_closures(
        self, t: Float[Array, ""], y: Float[Array, "ny"]
    ) -> tuple[Float[Array, "ny"], Any]:
        return _rate(self, t, y)


def _rate(
    dynamics: Dynamics, t: Float[Array, ""], y: Float[Array, "ny"]
) -> tuple[Float[Array, "ny"], Any]:
    """dy/dt, and the equations of v' and lambda."""
    model = dynamics.model
    q, v, z = model.layout.split(y)
    v_dot, z_dot, equations = lagrange.rates(
        model, State(q, v, z), dynamics.motions, dynamics.loads, t
    )
    return model.layout.pack(State(dynamics.coordinates.rate(q, v), v_dot, z_dot)), equations
