# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # A double wishbone without bump steer
#
# A wheel on two wishbones steers itself as it rises: toe changes by three degrees over 200 mm of
# travel. How must its eight joints move, each coordinate by 15 mm at most, so that toe changes by
# less than 0.05 degrees over 80 mm of travel, and camber falls by 0.4 degrees on each 100 mm, so
# that the outer wheel stays upright as the car rolls in a curve?

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
corner = jb.suspension.double_wishbone()
drawn = corner.hard_points
JOINTS = (
    *(
        f"{arm} {joint}"
        for arm in ("lower", "upper")
        for joint in ("inner front", "inner rear", "outer")
    ),
    *("tie rod inner", "tie rod outer"),
)
NEAR = np.linspace(-0.04, 0.04, 9)


def line(travel):
    """The wanted camber [deg]."""
    return -1.909 - 4.0 * np.asarray(travel)


# %% [markdown]
# Each hard point is one parameter, which moves in all that has it: arms, ball joints, the tie rod.
# Of all designs within the limits, `tune` finds the one that moves the joints least. In the design
# position toe is zero and camber as drawn, whatever the joints.


# %%
def toe_and_camber(corner, travel):
    """Both in degrees."""
    found = corner.curves(travel)
    return jnp.rad2deg(found["toe"]), jnp.rad2deg(found["camber"])


def quantities(corner):
    toe, camber = toe_and_camber(corner, NEAR)
    moved = jnp.concatenate([corner.hard_points[name] - drawn[name] for name in JOINTS])
    return {
        "movement": 1e6 * jnp.sum(moved**2),
        "toe": toe,
        "camber off its line": camber - line(NEAR),
    }


design = jb.tune(
    corner,
    quantities,
    free=JOINTS,
    minimize="movement",
    limits={"toe": (-0.024, 0.024), "camber off its line": (-0.06, 0.06)},
    bounds={name: (drawn[name] - 0.015, drawn[name] + 0.015) for name in JOINTS},
)
print("the joints move by")
for name in JOINTS:
    print(f"  {name}: {np.round(1e3 * (design.values[name] - drawn[name]), 1)} mm")

# %% [markdown]
# Over all of the travel, as suspension engineers draw it; the pale bands are the limits.

# %%
TRAVEL, over_travel = np.linspace(-0.1, 0.1, 21), jax.jit(toe_and_camber)
figure, axes = plt.subplots(1, 2, figsize=(8, 4), sharey=True, layout="constrained")
axes[0].fill_betweenx([-40, 40], -0.024, 0.024, color="#dfe4ea")
axes[1].fill_betweenx(1e3 * NEAR, line(NEAR) - 0.06, line(NEAR) + 0.06, color="#dfe4ea")
for label, shown, style, color in (
    ("as drawn", corner, "--", "#e0803a"),
    ("joints moved", design.suspension, "-", "#1871bc"),
):
    for ax, curve in zip(axes, over_travel(shown, TRAVEL), strict=True):
        ax.plot(curve, 1e3 * TRAVEL, style, label=label, color=color)
axes[0].set_xlabel("toe [deg]")
axes[1].set_xlabel("camber [deg]")
axes[0].set_ylabel("travel [mm]")
axes[0].legend(frameon=False)
plt.show()

change = np.ptp(np.asarray(design.after["toe"]))
print(
    f"toe changes by {np.ptp(np.asarray(design.before['toe'])):.3f} degrees "
    f"before, {change:.3f} after"
)
assert design.ok and change < 0.05

# %% [markdown]
# Read on: the page Suspensions and other closed loops of the manual.
