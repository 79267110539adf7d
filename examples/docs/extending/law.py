"""A law of your own: a spring whose force hardens as a sinh, F = F0 sinh(x/x0), with two
coefficients that a fit may move."""

import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)


class Hardening(jb.laws.Law):
    """F = F0 sinh(x/x0)."""

    # F0; "force" is N in a spring, N m about an angle
    level: jax.Array = jb.field("force", "positive")
    width: jax.Array = jb.field("argument", "positive")  # x0

    def force(self, x):
        return self.level * jnp.sinh(x / self.width)


def oscillator(level, width):
    spring = Hardening(jnp.asarray(level), jnp.asarray(width))
    return jb.Model(
        bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        joints={"mass": jb.Guide("world", axis=[0, 0, 1])},
        elements={
            "spring": jb.SpringDamper(
                ("mass", [0, 0, 0]), ("world", [0, 0, 1]), spring=spring, free_length=1.0
            )
        },
        gravity=[0, 0, -9.81],
    )


model = oscillator(10.0, 0.02)
print(model)

# At rest F0 sinh(x/x0) = m g, and K = F0/x0 cosh(x/x0)
eq = jb.equilibrium(model)
x = 0.02 * np.arcsinh(2.0 * 9.81 / 10.0)
print("elongation", eq.elongations["spring"], "m, by hand", x)
assert abs(float(eq.elongations["spring"]) - x) < 1e-12
K = jb.linearize(model, eq).K[0, 0]
assert abs(float(K) - 10.0 / 0.02 * np.cosh(x / 0.02)) < 1e-9 * K

# Its coefficients are parameters like any other: fitted to a motion, they stay positive and print
# with their units
times = np.linspace(0.0, 2.0, 201)
height = {"z": jb.Position("mass", axis="z")}
measured = jb.measure(jb.simulate(model, times), height, noise=1e-5, key=jax.random.key(0))
run = jb.Experiment(times, sensors=height, measured=measured)
fit = jb.fit(oscillator(9.0, 0.018), {"run": run}, free=["spring.spring.*"])
print(fit)
assert abs(float(fit.estimates["spring.spring.level"]) / 10.0 - 1) < 0.01
