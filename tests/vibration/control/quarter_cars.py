"""The quarter car of the reference cases by the preset, and a pair of forces on body and wheel, for
the mathematics of control without drives; tests/controlled_cars.py has the car with a drive."""

import dataclasses

import controlled_cars
import jax.numpy as jnp

import jaxbody as jb

W, ROAD = controlled_cars.WHITE, controlled_cars.ROAD["road"]
PUSHES = {"body": jb.PointForce("body"), "wheel": jb.PointForce("wheel")}
OUTPUTS = {
    "acceleration": jb.Acceleration("body", axis="z"),
    "stroke": jb.Elongation("suspension"),
    "tyre": jb.Elongation("tyre"),
}
SENSORS = {"stroke": jb.Elongation("suspension"), "speed": jb.Velocity("body", axis="z")}
Q, R = {"acceleration": 1.0, "stroke": 1e4, "tyre": 1e5}, {"actuator": 1e-6}


def linear(stiffness=16000.0, damping=1000.0, wheel=60.0):
    car = jb.presets.quarter_car(
        sprung=300.0, unsprung=wheel, stiffness=stiffness, damping=damping, tyre=190000.0
    )
    return jb.linearize(car, jb.equilibrium(car))


def with_actuator(lin, outputs):
    """The state space from the road and from a force up on the body and down on the wheel."""
    space = lin.state_space({"road": ROAD, **PUSHES}, outputs)

    def between(M):
        return jnp.stack([M[:, 0], M[:, 1] - M[:, 2]], 1)

    return dataclasses.replace(
        space,
        B=between(space.B),
        D=between(space.D),
        inputs=("road", "actuator"),
        input_units=("m/s", "N"),
    )
