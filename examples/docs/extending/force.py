"""A force of your own: a skyhook damper. An actuator pushes a table against the velocity that it
integrates from an accelerometer on the table, not against the velocity of the floor."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)


class Skyhook(jb.ForceElement):
    """F = -c u along z on the second frame, -F on the first; u' = a - u/T is the velocity that a
    leaky integrator makes of the reading a."""

    damping: jax.Array = jb.field("N s/m", "nonnegative")  # c
    memory: jax.Array = jb.field("s", "positive")  # T
    states, state_units = ("velocity",), ("m/s",)

    def forces(self, now):
        return now.opposed(-self.damping * now.z[0] * jnp.array([0, 0, 1.0]))

    def rates(self, now):
        return now.readings["a"] - now.z / self.memory


m, k, c, T = 50.0, 2e4, 1000.0, 5.0
skyhook = Skyhook(
    ("floor", "table"),
    jnp.array(c),
    jnp.array(T),
    reads={"a": jb.Acceleration("table", axis="z")},
)
model = jb.Model(
    bodies={"table": jb.Body(mass=m)},
    supports={"floor": jb.Support(position=[0, 0, -0.5])},
    joints={"table": jb.Guide("world", axis="z")},
    elements={
        "spring": jb.Spring(
            ("table", [0, 0, 0]), ("floor", [0, 0, 0]), stiffness=k, free_length=0.5
        ),
        "skyhook": skyhook,
    },
    gravity=[0, 0, -9.81],
)
print(model)
eq = jb.equilibrium(model)
lin = jb.linearize(model, eq)

# A column of K for the state, a row for its rate; M has -a, which the row reads
np.testing.assert_allclose(lin.M, [[m, 0], [-1, 0]], atol=1e-12)
np.testing.assert_allclose(lin.C, [[0, 0], [0, 1]], atol=1e-12)
np.testing.assert_allclose(lin.K, [[k, c], [0, 1 / T]], rtol=1e-12, atol=1e-9)

# By hand: m s^2 X = -k (X - floor) - c U, U = s^2 X T/(1 + T s)
f = np.array([0.5, np.sqrt(k / m) / (2 * np.pi), 10.0])
s = 2j * np.pi * f
by_hand = k / (m * s**2 + k + c * s**2 * T / (1 + T * s))
floor, table = {"floor": jb.BaseMotion("floor", "z")}, {"table": jb.Position("table", axis="z")}
response = jb.frequency_response(lin, f, floor, table)
np.testing.assert_allclose(response["table", "floor"], by_hand, rtol=1e-12)

# Its numbers are parameters like any other; at w^2 = k/m the motion is as 1/c


def at_resonance(model):
    lin = jb.linearize(model, jb.equilibrium(model))
    return jb.frequency_response(lin, f[1:2], floor, table).magnitude[0, 0, 0]


slope = jb.jit(jax.grad(at_resonance))(model)["skyhook"].damping
np.testing.assert_allclose(slope, -abs(k * (1 + T * s[1]) / (c * T * s[1] ** 2)) / c, rtol=1e-9)

# The same damper between floor and table lets the floor shake the table above the resonance
damped = abs((k + c * s) / (m * s**2 + c * s + k))
for each, skyhook, damper in zip(f, np.abs(by_hand), damped, strict=True):
    print(
        f"{each:6.3f} Hz: the table moves by {skyhook:.4f} of the floor's motion, "
        f"with a damper to the floor {damper:.4f}"
    )
