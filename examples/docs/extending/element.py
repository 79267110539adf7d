"""An element of your own: an elastic rope that carries a load on a pulley.

From one anchor over the pulley to the other: e = |A - P| + |P - B| - l0, V = k e^2/2.
"""

import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)


class Rope(jb.Element):
    """An elastic rope from `a` on the first frame over a small pulley at `b` on the second to
    `anchor`, also on the first."""

    anchor: jax.Array = jb.field("m")
    stiffness: jax.Array = jb.field("N/m", "positive")
    free_length: jax.Array = jb.field("m", "nonnegative")

    def deformation(self, A, B):
        pulley = B.point(self.b)
        return (
            sum(jnp.linalg.norm(A.point(end) - pulley) for end in (self.a, self.anchor))
            - self.free_length
        )

    def energy(self, e):
        return 0.5 * self.stiffness * e**2

    def dissipation(self, e, e_dot):
        return jnp.zeros_like(e)


# A load of 5 kg hangs on its pulley from two points of the ceiling, 2 c apart; the rope is longer
# than 2 c by far
c, k, l0, m, g = 0.3, 8000.0, 2.0, 5.0, 9.81
rope = Rope(
    ("world", "load"),
    jnp.array([-c, 0, 0]),
    jnp.zeros(3),
    jnp.array([c, 0, 0]),
    jnp.array(k),
    jnp.array(l0),
)
model = jb.Model(
    bodies={"load": jb.Body(mass=m, inertia=[0.01, 0.01, 0.01], position=[0, 0, -1.0])},
    joints={"load": jb.Guide("world", axis=[0, 0, 1])},
    elements={"rope": rope},
    gravity=[0, 0, -g],
)
eq = jb.equilibrium(model)
print(eq)

# By hand: each half has length h, 2 T z/h = m g with T = k (2 h - l0), z = sqrt(h^2 - c^2)
h = (float(eq.elongations["rope"]) + l0) / 2
z = np.sqrt(h**2 - c**2)
print(
    f"tension {k * (2 * h - l0):.6g} N carries {2 * k * (2 * h - l0) * z / h:.6g} N; the "
    f"weight is {m * g:.6g} N"
)
assert abs(2 * k * (2 * h - l0) * z / h - m * g) < 1e-8
assert abs(float(eq.state.q[0]) - (1.0 - z)) < 1e-9

# Forces, stiffness and derivatives follow from the three functions
K = float(jb.linearize(model, eq).K[0, 0])
assert abs(K - (4 * k * (z / h) ** 2 + 2 * k * (2 * h - l0) * c**2 / h**3)) < 1e-6 * K
print("frequency", jb.modes(jb.linearize(model, eq)).frequency[0], "Hz")
