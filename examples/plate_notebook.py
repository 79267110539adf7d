# ---
# jupyter:
#   jupytext:
#     formats: ipynb,py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
#   kernelspec:
#     display_name: Python 3
#     language: python
#     name: python3
# ---

# %% [markdown]
# # A plate on springs with a moving base
#
# The application of N.-D. Stanescu and S. Mihalcea (13th IFToMM World Congress, 2011, A14_316): a plate hangs from two springs at
# 45 degrees and is held by a third one. This file is a script; Jupyter opens it as a notebook with jupytext.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb
from jaxbody.plots import draw_mode, draw_model, plot_fit, plot_forces, plot_history, plot_trajectory

jax.config.update("jax_enable_x64", True)

# %% [markdown]
# ## The model
#
# Bodies have mass, supports have an imposed motion, and elements connect any two of them. Points are in the frame of their own body.

# %%
l, m, g = 0.7, 3.0, 9.81
k, kt = m * g / l, 120.0
free_length = 1.5 * 2**0.5 * l

model = jb.Model(
    bodies={"plate": jb.Body(mass=m, inertia=[0.3, 0.9, 1.2])},
    supports={"base": jb.Support(position=[0, -4 * l, 0])},
    elements={
        "AB": jb.Spring(("plate", [-3 * l, l, 0]), ("base", [-5 * l, 7 * l, 0]), stiffness=k, free_length=free_length, damping=1.0),
        "CD": jb.Spring(("plate", [3 * l, l, 0]), ("base", [5 * l, 7 * l, 0]), stiffness=k, free_length=free_length, damping=1.0),
        "EF": jb.Spring(("plate", [0, -l, 0]), ("base", [0, l, 0]), stiffness=kt, free_length=2 * l, damping=1.0),
    },
    gravity=[0, -g, 0],
)
draw_model(model)
model

# %% [markdown]
# ## Three scalar functions
#
# Kinetic energy, potential energy and dissipation are plain functions of the model, the state and the base's displacement. At
# equilibrium the potential energy is stationary.

# %%
eq = jb.equilibrium(model)
potential = jax.jit(lambda delta: jb.potential_energy(model, jb.State(jb.retract(model, eq.state.q, delta), eq.state.v)))
print("dV/dDelta =", np.round(jax.grad(potential)(jnp.zeros(6)), 9) + 0.0)
eq

# %% [markdown]
# ## Small motions
#
# The matrices of small motions are second derivatives of these functions. K is the sum of three parts, due to the stiffness of the springs,
# their tension and gravity; K~ gives the force on the plate per displacement of the base.

# %%
lin = jb.linearize(model, eq)
assert np.allclose(lin.K, jax.hessian(potential)(jnp.zeros(6)), atol=1e-9)
assert np.allclose(lin.K, lin.K_elastic + lin.K_geometric + lin.K_gravity, atol=1e-9)
print("share of the tension in the stiffness along z:", float(lin.K_geometric[2, 2] / lin.K[2, 2]))
print("K~ =", np.round(lin.K_tilde, 4) + 0.0, sep="\n")

# %%
modes = jb.modes(lin)
_, axes = plt.subplots(2, 3, figsize=(11, 6), layout="constrained")
for number, ax in enumerate(axes.flat, start=1):
    draw_mode(lin, modes, number, ax=ax)
modes

# %% [markdown]
# ## The range of the linear model
#
# `excitation` is the exact force due to a finite displacement Xi of the base. Its difference from K~ Xi decreases with the square of Xi.

# %%
direction = jnp.array([0.01, 0, 0, 0, 0, 0.02])
sizes = 2.0 ** -jnp.arange(6)
difference = jnp.array(
    [jnp.linalg.norm(jb.excitation(model, eq, {"base": size * direction}) - lin.K_tilde @ (size * direction)) for size in sizes]
)
_, ax = plt.subplots(figsize=(5, 3), layout="constrained")
ax.loglog(sizes, difference, "o-")
ax.set(xlabel="size of Xi", ylabel="exact force minus K~ Xi [N]")
assert np.allclose(np.diff(np.log2(difference))[-2:], -2, atol=0.01)

# %% [markdown]
# ## The exact motion
#
# The base vibrates. Its velocity, which acts on the dampers, is the derivative of the same function of time.

# %%
times = jnp.linspace(0.0, 5.0, 501)
motion = {"base": jb.Harmonic(frequency=0.8, translation=[0.01, 0.02, 0], rotation=[0, 0, 0.02])}
trajectory = jb.simulate(model, times, motion=motion, initial=eq.state)
plot_trajectory(trajectory)
plot_forces(trajectory)
trajectory

# %% [markdown]
# ## Stiffnesses from a measured motion
#
# A camera measures the position of the corner C with 2 mm of noise. The initial guess is 30 % too stiff.

# %%
sensors = {"corner": jb.Position("plate", [3 * l, l, 0])}
measured = jb.measure(trajectory, sensors, noise=2e-3, key=jax.random.key(0))
run = jb.Experiment(times, motion=motion, initial=eq.state, sensors=sensors, measured=measured)
guess = jb.replace(model, {path: 1.3 * value for path, value in jb.paths(model, "*.stiffness").items()})
fit = jb.fit(guess, {"run": run}, free=["*.stiffness"])
plot_fit(fit)
plot_history(fit)
fit
