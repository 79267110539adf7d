"""A joint of your own: a nut on a screw, which turns as it falls."""

import jax
import jax.numpy as jnp

import jaxbody as jb
from jaxbody.geometry.frames import Pose

jax.config.update("jax_enable_x64", True)


class Screw(jb.joints.Joint):
    """q is the angle about z [rad]; the body moves along z by `lead` [m/rad] for each radian."""

    lead: jax.Array = jb.field("m")
    nq, nv, motions, turns = 1, 1, ("turn of the screw",), (True,)

    def pose(self, q, parent, rest):
        c, s = jnp.cos(q[0]), jnp.sin(q[0])
        R = jnp.array([[c, -s, 0], [s, c, 0], [0, 0, 1]])
        return parent @ Pose(rest.p + jnp.array([0, 0, self.lead * q[0]]), R @ rest.R)

    def axes(self, q, parent, body):
        n = parent.R[:, 2]
        # velocity of O and angular velocity, per unit of the speed
        return self.lead * n[None], n[None]


mass, inertia, lead, g = 0.3, 2e-5, 0.01, 9.81
model = jb.Model(
    bodies={"nut": jb.Body(mass=mass, inertia=[inertia] * 3)},
    joints={"nut": Screw("world", jnp.array(lead))},
    gravity=[0, 0, -g],
)
fall = jb.simulate(model, [0.0, 0.5, 1.0])
z = fall.poses["nut"].p[:, 2]
print("height", z, "m")

# Closed form: the acceleration is g / (1 + I / (m lead^2))
acceleration = g / (1 + inertia / (mass * lead**2))
print("by hand", -acceleration / 2, "m after one second")
assert abs(float(z[-1]) + acceleration / 2) < 1e-9

# The mass matrix in the angle, as M is the Hessian of T
M = jb.linearize(model, model.reference).M
assert abs(float(M[0, 0]) - (inertia + mass * lead**2)) < 1e-15
