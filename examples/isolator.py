# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # An instrument on isolators
#
# Four isolators hold a table with an instrument above a floor that vibrates. From which frequency
# on do they isolate, and what is left at the instrument?
#
# Along one axis the answer is known: whatever the damping, the motion is amplified below $\sqrt 2$
# times the natural frequency,
#
# $$ |T| = \sqrt{\frac{1 + (2\zeta r)^2}{(1 - r^2)^2 + (2\zeta r)^2}},
# \qquad |T| = 1 \text{ at } r = f/f_0 = \sqrt 2. $$

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb
from jaxbody import plots

jax.config.update("jax_enable_x64", True)
mass, gyration, stiffness, at = (
    200.0,
    (0.35, 0.42, 0.5),
    np.array([3e4, 5e4, 8e4]),
    (0.45, 0.3, 0.25),
)
table = jb.presets.isolated_table(
    mass=mass, gyration=gyration, stiffness=stiffness, at=at, damping=6e-3 * stiffness
)
# the table of Harris, Shock and Vibration Handbook, chapter 3, with dampers
lin = jb.linearize(table, table.reference)
print(jb.vibration.mode_energies(lin))

# %% [markdown]
# The instrument stands 0.3 m above the middle of the table. Up and down it moves as the formula
# says; sideways the table also rocks, so there are two resonances.

# %%
f = jnp.geomspace(0.5, 60.0, 1000)
floor = {"floor x": jb.BaseMotion("floor", "x"), "floor z": jb.BaseMotion("floor", "z")}
instrument = [0.1, 0.05, 0.3]
positions = {f"instrument {axis}": jb.Position("table", instrument, axis=axis) for axis in "xz"}
response = jb.frequency_response(lin, f, floor, positions)
print(response)

# %% [markdown]
# A floor with random vibration of 1e-6 (m/s2)2/Hz from 2 to 40 Hz, in both directions: what the
# instrument feels, and what a stiffer isolator would change.

# %%
shaking = jb.vibration.PSD([2.0, 40.0], [1e-6, 1e-6], unit="(m/s2)2/Hz")
accelerations = {
    f"acceleration {axis}": jb.Acceleration("table", instrument, axis=axis) for axis in "xz"
}
stroke = {"stroke": jb.Elongation("isolator 1", component=2)}


def ride(table):
    lin = jb.linearize(table, table.reference)
    return jb.random_response(
        lin,
        jb.vibration.Band(2.0, 40.0, points=2001),
        floor,
        accelerations | stroke,
        {name: shaking for name in floor},
    )


def vertical(k):
    return ride(jb.replace(table, {"isolator 1.stiffness": k}))["acceleration z"]


vibration = ride(table)
share = jb.jit(jax.jacfwd(vertical))(stiffness) * stiffness / vibration["acceleration z"]
print(vibration)
print(
    "1 % more stiffness of isolator 1 along x, y, z changes the vertical rms by",
    np.round(np.asarray(share), 4),
    "%",
)

# %%
k, c = 4 * stiffness[2], 4 * 6e-3 * stiffness[2]
f0, zeta = np.sqrt(k / mass) / (2 * np.pi), c / (2 * np.sqrt(k * mass))
figure, ax = plt.subplots(figsize=(9, 4.6), layout="constrained")
plots.plot_transmissibility(response, ax=ax)
ax.axvspan(2**0.5 * f0, 60.0, color="C2", alpha=0.1, lw=0)
ax.plot(2**0.5 * f0, 1.0, "o", color="k", ms=7, zorder=5)
ax.annotate(
    r"$\sqrt{2}\,f_0$ = 9.0 Hz",
    (2**0.5 * f0, 1.0),
    (12, 8),
    textcoords="offset points",
    fontsize=12,
)
ax.text(55, 6, "isolated", color="0.2", ha="right", fontsize=12)
ax.set(title="Motion of the instrument per motion of the floor", ylim=(3e-3, 12))
ax.legend(loc="center left", frameon=False)

# %% [markdown]
# The response of the model in six degrees of freedom is that of the formula, and it crosses 1 where
# it must.

# %%
r = np.asarray(f) / f0
expected = np.sqrt((1 + (2 * zeta * r) ** 2) / ((1 - r**2) ** 2 + (2 * zeta * r) ** 2))
computed = np.abs(response["instrument z", "floor z"])
crossing = float(np.interp(2**0.5 * f0, f, computed))
print(f"natural frequency {f0:.6f} Hz; transmissibility {crossing:.5f} at {2**0.5 * f0:.3f} Hz")
np.testing.assert_allclose(computed, expected, rtol=1e-9)
assert abs(f0 - 6.366198) < 1e-6 and abs(crossing - 1) < 1e-3  # Harris' vertical frequency

# %% [markdown]
# Read on: `comfort.py`, random vibration of a car; `mode_energies.py`, mounts that are decoupled.
