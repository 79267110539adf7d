"""A motion of your own: a sweep of a shaking table, whose frequency rises in time; velocity and
acceleration are its derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
from scipy.integrate import solve_ivp

import jaxbody as jb

jax.config.update("jax_enable_x64", True)


class Chirp(jb.inputs.Motion):
    """z(t) = a sin(2 pi (f t + r t^2/2)), along z."""

    amplitude: jax.Array = jb.field("m")
    frequency: jax.Array = jb.field("Hz", "positive")  # f, at t = 0
    rate: jax.Array = jb.field("Hz/s")  # r

    def __call__(self, t):
        z = self.amplitude * jnp.sin(2 * jnp.pi * (self.frequency * t + self.rate * t**2 / 2))
        return jnp.zeros(6).at[2].set(z)


m, k, c = 2.0, 800.0, 4.0
model = jb.Model(
    bodies={"mass": jb.Body(mass=m, inertia=[1, 1, 1])},
    supports={"table": jb.Support(position=[0, 0, -1])},
    joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
    elements={
        "spring": jb.Spring(
            ("mass", [0, 0, 0]), ("table", [0, 0, 0]), stiffness=k, free_length=1.0, damping=c
        )
    },
)
sweep = Chirp(jnp.array(1e-3), jnp.array(1.0), jnp.array(0.5))
times = np.linspace(0.0, 8.0, 401)
z = jb.simulate(model, times, motion={"table": sweep}).poses["mass"].p[:, 2]
print("largest motion of the mass", f"{float(jnp.abs(z).max()) * 1e3:.3f} mm for 1 mm of the table")


# The same equation by SciPy: m x'' + c x' + k x = k z + c z'; the damper sees the velocity of
# the table
def pushed(t, y):
    phase, rate = 2 * np.pi * (t + t**2 / 4), 2 * np.pi * (1 + t / 2)
    force = 1e-3 * (k * np.sin(phase) + c * rate * np.cos(phase))
    return [y[1], (force - c * y[1] - k * y[0]) / m]


known = solve_ivp(pushed, (0, 8), [0, 0], "DOP853", times, rtol=1e-10, atol=1e-13).y[0]
assert np.abs(z - known).max() < 1e-8


# A function of time will do where nothing of it is to be fitted; made once, as a new function is
# compiled anew
def shake(t):
    return jnp.zeros(6).at[2].set(1e-3 * jnp.sin(2 * jnp.pi * (t + 0.25 * t**2)))


same = jb.simulate(model, times, motion={"table": shake}).poses["mass"].p[:, 2]
assert np.abs(same - z).max() < 1e-9
