# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # A double wishbone without bump steer
#
# A wheel on two wishbones steers itself as it rises: toe changes by three degrees over 200 mm of travel. How must its eight joints move,
# each coordinate by 15 mm at most, so that toe changes by less than 0.05 degrees over 80 mm of travel?

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import least_squares

import jaxbody as jb
from jaxbody.mechanisms.ready_corners import DOUBLE_WISHBONE

jax.config.update("jax_enable_x64", True)
TRAVEL = np.linspace(-0.1, 0.1, 21)
JOINTS = (
    *(f"{arm} {joint}" for arm in ("lower", "upper") for joint in ("inner front", "inner rear", "outer")),
    *("tie rod inner", "tie rod outer"),
)
drawn = np.concatenate([DOUBLE_WISHBONE[name] for name in JOINTS])

# %% [markdown]
# The suspension is built from its hard points within the compiled function, so that toe has derivatives by each of them. The loop of the
# wishbones is closed by a ball joint, `jb.closures.Ball`, the tie rod is `jb.closures.Rod`.


# %%
@jax.jit
def toe(places):
    """Toe over travel [deg] for places of the eight joints [m]."""
    points = dict(zip(JOINTS, places.reshape(-1, 3), strict=True))
    return jnp.rad2deg(jb.double_wishbone(points).curves(TRAVEL)["toe"])


slopes = jax.jit(jax.jacfwd(toe))
near = np.abs(TRAVEL) <= 0.0401
little = 0.01 * np.eye(drawn.size) / 0.015  # of every movement counts, as many others would do
found = least_squares(
    lambda x: np.concatenate([np.asarray(toe(x))[near], little @ (x - drawn)]),
    drawn,
    jac=lambda x: np.concatenate([np.asarray(slopes(x))[near], little]),
    bounds=(drawn - 0.015, drawn + 0.015),
    x_scale=0.01,
)

# %% [markdown]
# In the design position toe is zero, whatever the joints: the length of the tie rod follows from them.

# %%
before, after = (np.asarray(toe(x)) for x in (drawn, found.x))
change = np.ptp(after[near])
print(f"toe changes by {np.ptp(before[near]):.3f} degrees before, {change:.3f} after; the joints move by")
for name, moved in zip(JOINTS, 1e3 * (found.x - drawn).reshape(-1, 3), strict=True):
    print(f"  {name}: {np.round(moved, 1)} mm")
assert change < 0.05

# %% [markdown]
# Over all of the travel, as suspension engineers draw it; the pale band is 0.05 degrees wide over 80 mm.

# %%
figure, ax = plt.subplots(figsize=(5, 4), layout="constrained")
ax.fill_betweenx([-40, 40], -0.025, 0.025, color="#dfe4ea")
for label, curve, style in (("as drawn", before, "--"), ("joints moved", after, "-")):
    ax.plot(curve, 1e3 * TRAVEL, style, label=label, color={"--": "#e0803a", "-": "#1871bc"}[style])
ax.set(xlabel="toe [deg]", ylabel="travel [mm]")
ax.legend(frameon=False)
plt.show()

# %% [markdown]
# Read on: the page Suspensions and other closed loops of the manual.
