# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # A car on four double wishbones over a kerb
#
# A car of fourteen bodies, drawn from the hard points of its suspensions: arms, uprights with their
# wheels, a rack, and eight closures that close its loops. How does it vibrate, what happens as its
# left wheels cross a kerb, and which of its joints set its roll center?

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
car = jb.suspension.car_on_double_wishbones()
model = car.model
eq = jb.equilibrium(model)
modes = jb.modes(jb.linearize(model, eq))
print(modes)
assert eq.ok

# %% [markdown]
# The car bounces, pitches and rolls below 3 Hz; its wheels hop at 12 to 14 Hz. The springs are as
# long as the car needs to rest as it is drawn, so that the equilibrium is the reference pose.
#
# The left wheels roll onto a kerb of 40 mm at 10 m/s, the front one first. The road rises over
# 100 mm, and a contact of 150 mm smooths it.

# %%
SPEED = 10.0  # m/s
# m, forward of the center of mass
wheels = {name: float(model[f"road {name}"].position[0]) for name in ("fl", "rl")}
kerb = {
    f"road {name}": jb.inputs.Road.kerb(
        height=0.04, at=3.0, ramp=0.1, speed=SPEED, footprint=0.15, position=x
    )
    for name, x in wheels.items()
}
times = np.linspace(0.0, 1.2, 601)
run = jb.simulate(model, times, motion=kerb, initial=eq.state)
run.raise_if_failed()
q = np.asarray(run.state.q)[:, model.layout.q_slices["car"]]  # heave, pitch and roll
q = q - q[0]
sensors = {
    name: jb.Position(f"{name} upright", car.hard_points[f"{axle} wheel center"], axis="z")
    for name, axle in (("fl", "front"), ("rl", "rear"))
}
hubs = {name: np.asarray(z) - z[0] for name, z in jb.measure(run, sensors).items()}
for name in wheels:
    tyre, rest = (
        -float(f) / 1e3
        for f in (jnp.max(run.forces[f"tyre {name}"]), run.forces[f"tyre {name}"][0])
    )
    print(f"tyre {name}: {rest:.2f} kN at rest, at least {tyre:.2f} kN over the kerb")

# %% [markdown]
# In a curve the side forces of each axle act on the body at its roll center: the higher it is, the
# less the body rolls. Hard points set its height. Each derivative is exact, and all of them take
# one reverse pass through the closures.


# %%
def height(points):
    """Of the roll center of the front axle [m]."""
    return jb.suspension.double_wishbone(points).curves(0.0)["roll center height"][0]


corner = jb.suspension.double_wishbone()
slopes = {
    name: 10 * float(slope[2])
    for name, slope in jb.jit(jax.grad(height))(corner.hard_points).items()
}
most = sorted(slopes, key=lambda name: -abs(slopes[name]))[:8]
print(
    f"the roll center is {1e3 * float(height(corner.hard_points)):.1f} mm above the road; it "
    "rises with 10 mm of height of"
)
for name in most:
    print(f"  {name:18s} by {slopes[name]:6.1f} mm")

# %%
figure, axes = plt.subplots(1, 3, figsize=(12, 3.6), layout="constrained")
for (name, z), color in zip(hubs.items(), ("#1871bc", "#e0803a"), strict=True):
    axes[0].plot(times, 1e3 * z, color=color, label=f"wheel {name}")
axes[0].plot(times, 1e3 * q[:, 0], color="#3a3f45", label="car, heave")
axes[0].set(xlabel="time [s]", ylabel="height [mm]")
for i, (name, color) in enumerate({"pitch": "#1871bc", "roll": "#e0803a"}.items(), 1):
    axes[1].plot(times, np.rad2deg(q[:, i]), color=color, label=name)
axes[1].set(xlabel="time [s]", ylabel="angle [deg]")
axes[2].barh(most[::-1], [slopes[name] for name in most[::-1]], color="#1871bc")
axes[2].set(title="roll center of the front axle", xlabel="rise [mm] for 10 mm of height")
for ax in axes[:2]:
    ax.legend(frameon=False)
plt.show()

# %% [markdown]
# `jb.view(run).show()` plays the motion. Read on: the page Suspensions and other closed loops of
# the manual.
