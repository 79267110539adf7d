"""Compliance of a wheel: how its angles and its position change under a force at the contact or at
the center, on a suspension in equilibrium."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, Int
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import check_known
from jaxbody.core.results import Result
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.vectors import axial, product
from jaxbody.model.joints.kinematics import Chart, Coordinates
from jaxbody.suspension.wheels import Wheel
from jaxbody.vibration.linearizations import Linearization

READINGS = {"camber": "rad", "toe": "rad", "wheel x": "m", "wheel y": "m", "wheel z": "m"}
LOADS = {
    "force x": "N",
    "force y": "N",
    "force z": "N",
    "moment z": "N m",
    "force x at the center": "N",
}


class WheelCompliance(Result):
    """The compliance of a wheel: `compliance["toe", "force y"]` [rad/N] is the change of one
    reading per unit of one load of `wheel_compliance`; `values` (readings, loads): all of them."""

    values: Float[Array, "readings loads"]
    status: Int[Array, ""]

    def __getitem__(self, of: tuple[str, str]) -> Float[Array, ""]:
        for name, known in zip(of, (READINGS, LOADS), strict=True):
            check_known(name, "compliance[...]", known)
        return self.values[tuple(READINGS).index(of[0]), tuple(LOADS).index(of[1])]

    def _tables(self) -> list[tables.PrintedTable]:
        shown = (
            np.where(np.array(list(READINGS.values())) == "rad", 180 / np.pi, 1e3)[:, None]
            * 1e3
            * np.asarray(self.values)
        )
        heads = [f"{name} [{'deg' if unit == 'rad' else 'mm'}]" for name, unit in READINGS.items()]
        rows = [
            (f"1 k{unit} {name}", *shown[:, i].tolist())
            for i, (name, unit) in enumerate(LOADS.items())
        ]
        return [tables.PrintedTable("Compliance", ("by", *heads), rows, self.failure)]


def wheel_compliance(lin: Linearization, wheel: Wheel) -> WheelCompliance:
    """Compute how camber, toe and the center of a wheel change under loads, to first order about an
    equilibrium.

        dr/dF = G K^-1 J',   G = dr/dDelta,
        J the motion of the point on which the load acts, along the load

    The loads are forces on the wheel's body along x, y and z at the contact, a moment about z, as
    of a tyre, and a force along x at the center, as of a driven wheel without brakes. The travel is
    free, or held by the model: by a spring and a tyre, or by a closure such as
    `jb.closures.Equation` of the height of the center. Angles have the signs of ISO 8855, forces
    act along world axes.

    Args:
        lin: the linearization at an equilibrium, such as that of a corner with
            bushings (`jb.suspension.compliant`)
        wheel: the wheel

    The result has exact derivatives with respect to every number of the model. Error: UNKNOWN_NAME.

    A wheel on a spring of 200 N/mm and a guide rises by 5 mm under 1 kN:

    >>> model = jb.Model(
    ...     bodies={"upright": jb.Body(mass=20.0, inertia=[1, 1, 1])},
    ...     joints={"upright": jb.Guide("world", axis="z")},
    ...     elements={
    ...         "spring": jb.Spring(
    ...             ("upright", [0, 0.7, 0]),
    ...             ("world", [0, 0.7, 0.4]),
    ...             stiffness=2e5,
    ...             free_length=0.4,
    ...         )
    ...     },
    ... )
    >>> wheel = jb.suspension.Wheel("upright", center=[0, 0.75, 0], axis="y", radius=0.3)
    >>> compliance = jb.vibration.wheel_compliance(
    ...     jb.linearize(model, jb.equilibrium(model)), wheel
    ... )
    >>> (
    ...     round(float(compliance["wheel z", "force z"]) * 1e6, 9),
    ...     float(compliance["toe", "force y"]),
    ... )  # mm/kN
    (5.0, 0.0)
    """
    check_known(wheel.on, "wheel_compliance.wheel.on", lin.model.layout.bodies)
    return WheelCompliance(_compliance(lin, wheel), lin.status)


@program
def _compliance(lin: Linearization, wheel: Wheel) -> Float[Array, "readings loads"]:
    model, q = lin.model, lin.state.q
    chart, coordinates, row = Chart(model), Coordinates(model), model.layout.frame(wheel.on)

    def pose_at(delta: Array) -> Pose:
        return coordinates.at_rest(chart.retract(q, delta))[row].pose()

    zero = jnp.zeros(model.layout.nv, q.dtype)
    pose = pose_at(zero)
    side = wheel.side(pose)
    contact = pose.R.T @ (wheel.contact(pose) - pose.p)  # the point at the contact, in body axes

    def read(delta: Array) -> Array:
        alignment = wheel.alignment(pose_at(delta), side)
        return jnp.stack([alignment[name] for name in READINGS])

    def acted_on(delta: Array) -> tuple[Array, Array, Array]:
        at = pose_at(delta)
        return at.point(contact), axial(product(at.R, pose.R.T)), at.point(wheel.center)

    G, (J, turns, J_center) = jax.jacfwd(read)(zero), jax.jacfwd(acted_on)(zero)
    along = jnp.concatenate([J, turns[2:], J_center[:1]])
    N = lin.expanded(jnp.eye(len(lin.K), dtype=lin.K.dtype))[: model.layout.nv]
    return (G @ N) @ jnp.linalg.solve(lin.K, (along @ N).T)
