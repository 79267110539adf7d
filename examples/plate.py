# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # A plate on springs under a moving base
#
# A plate hangs from two springs at 45 degrees and is held by a third one. What force acts on
# it when the base moves, and how far can the base move before the linear formula of the paper
# is wrong?
#
# $$ F = \tilde K\,\Xi
# = \tfrac{k}{4}\,(5\,\xi_x - 20\,l\,\theta,\ 0,\ 0,\ 0,\ 0,\ 4\,l\,\xi_x + 32\,l^2\theta) $$
#
# is (79) in N.-D. Stanescu, S. Mihalcea, *On the Dynamics of Multibody Systems with Springs*,
# 13th IFToMM World Congress, 2011, for a base that moves by $\xi_x$ along x and turns by $\theta$
# about z.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb
from jaxbody.views.plots import draw_model

jax.config.update("jax_enable_x64", True)

# %% [markdown]
# Bodies have mass, supports have an imposed motion, and springs connect any two of them. Points are
# in the axes of their own body.

# %%
l, m, g = 0.7, 3.0, 9.81
k, kt = m * g / l, 120.0
free_length = 1.5 * 2**0.5 * l  # of the inclined springs: their tension carries the weight
model = jb.Model(
    bodies={"plate": jb.Body(mass=m, inertia=[0.3, 0.9, 1.2])},
    supports={"base": jb.Support(position=[0, -4 * l, 0])},
    elements={
        "AB": jb.Spring(
            ("plate", [-3 * l, l, 0]),
            ("base", [-5 * l, 7 * l, 0]),
            stiffness=k,
            free_length=free_length,
        ),
        "CD": jb.Spring(
            ("plate", [3 * l, l, 0]),
            ("base", [5 * l, 7 * l, 0]),
            stiffness=k,
            free_length=free_length,
        ),
        "EF": jb.Spring(
            ("plate", [0, -l, 0]), ("base", [0, l, 0]), stiffness=kt, free_length=2 * l
        ),
    },
    gravity=[0, -g, 0],
)
eq = jb.equilibrium(model)
lin = jb.linearize(model, eq)
print(eq, jb.modes(lin), sep="\n\n")

# %% [markdown]
# `lin.K_tilde` is the derivative of the potential energy in the motions of plate and base;
# `excitation` is the exact force. Its error grows with the square of the motion.

# %%
xi = jnp.array([0.01, 0, 0, 0, 0, 0.02])  # 10 mm and 20 mrad
sizes = jnp.linspace(0.0, 25.0, 51)
linear = sizes[:, None] * (lin.K_tilde @ xi)
exact = jnp.stack([jb.excitation(model, eq, {"base": size * xi}) for size in sizes])

# %%
figure, (left, right) = plt.subplots(
    1, 2, figsize=(10, 4.2), layout="constrained", width_ratios=[1.15, 1]
)
draw_model(model, displaced={"base": 25 * xi}, names=False, ax=left)
plt.setp(left.images, alpha=0.25)
draw_model(model, ax=left)
left.set_title("The base at rest; pale: moved by 25 cm and 0.5 rad", fontsize=10)
for i, name, color in ((5, "moment about z [N m]", "C1"), (0, "force along x [N]", "C0")):
    right.plot(sizes, exact[:, i], color, lw=2.5, label=name)
    right.plot(sizes, linear[:, i], color, ls="--", lw=1, label="linear, (79) of the paper")
right.set_title("Force of the base's motion on the plate", fontsize=10)
right.set(
    xlabel="motion of the base [cm], with 20 mrad per cm",
    ylabel="force [N] and moment [N m]",
    xlim=(0, 25),
)
right.legend(frameon=False)
right.grid(alpha=0.3)

# %% [markdown]
# For 10 mm and 20 mrad the linear force is that of the paper to rounding, and the exact force
# differs by half a percent.

# %%
printed = k / 4 * np.array([5 * 0.01 - 20 * l * 0.02, 0, 0, 0, 0, 4 * l * 0.01 + 32 * l**2 * 0.02])
force = lin.K_tilde @ xi
print(
    "paper",
    printed[[0, 5]],
    "linear",
    force[jnp.array([0, 5])],
    "exact",
    exact[2, jnp.array([0, 5])],
    "N, N m",
)
np.testing.assert_allclose(force, printed, atol=1e-12)
assert np.linalg.norm(exact[2] - printed) < 0.006 * np.linalg.norm(printed)

# %% [markdown]
# Read on: `contract.py` simulates this plate and fits its stiffnesses.
