"""An energy of one's own: a magnet pulls an iron ball that hangs on a spring. A stronger one
softens its motion."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)


class Pull(eqx.Module):
    """V = -A/(3 d^3) of a magnet on the base and an iron ball at a distance d."""

    strength: jax.Array = jb.field("N m4", "nonnegative")

    def __call__(self, frames):
        d = frames["ball"].p - frames["base"].p
        return -self.strength / (3 * jnp.linalg.norm(d) ** 3)


model = jb.Model(
    bodies={"ball": jb.Body(mass=0.2)},
    supports={"base": jb.Support(position=[0, 0, -0.1])},
    joints={"ball": jb.Guide("world", axis=[0, 0, 1])},
    elements={
        "spring": jb.Spring(
            ("ball", [0, 0, 0]), ("world", [0, 0, 0.3]), stiffness=200.0, free_length=0.3
        )
    },
    energies={"magnet": Pull(2e-5)},
)
print(model)

# F = A/d^4 = k x at rest, with d = 0.1 - x; K = k - 4 A/d^5, the motion of the base acts by
# K~ = -4 A/d^5
eq = jb.equilibrium(model)
lin = jb.linearize(model, eq)
x = -float(eq.state.q[0])
d = 0.1 - x
assert abs(2e-5 / d**4 - 200.0 * x) < 1e-9
np.testing.assert_allclose(lin.K, [[200.0 - 4 * 2e-5 / d**5]], rtol=1e-12)
np.testing.assert_allclose(lin.K_tilde[:, 2], [-4 * 2e-5 / d**5], rtol=1e-12)
print(f"the ball is {1e3 * x:.3f} mm lower; K = {float(lin.K[0, 0]):.3f} N/m")

# K = 0 where x = d/4 = 0.02: a stronger magnet than A = k x d^4 there has no equilibrium, and the
# ball snaps to it
limit = 200.0 * 0.02 * 0.08**4
nearly = jb.replace(model, {"magnet.strength": 0.99 * limit})
softest = jb.linearize(nearly, jb.equilibrium(nearly)).K
assert 0 < float(softest[0, 0]) < 0.2 * 200.0
print(f"at 0.99 of the strength at which it snaps, K = {float(softest[0, 0]):.3f} N/m")
