"""An instrument on four isolators: how much of the floor's shaking arrives, by direction, and what damping is best against a random floor."""

import sys

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb
from jaxbody import plots

jax.config.update("jax_enable_x64", True)

# the table of Harris, Shock and Vibration Handbook, chapter 3, with dampers
mass, gyration, stiffness, at = 200.0, (0.35, 0.42, 0.5), np.array([3e4, 5e4, 8e4]), (0.45, 0.3, 0.25)
table = jb.presets.isolated_table(mass=mass, gyration=gyration, stiffness=stiffness, at=at, damping=6e-3 * stiffness)
lin = jb.linearize(table, table.reference)  # where it is at rest: these isolators carry no weight
modes = jb.modes(lin)
print(modes)

# 1. What arrives at the instrument, 0.3 m above the table's centre, of the floor's motion and of its tilting
instrument = [0.1, 0.05, 0.3]
f = jnp.geomspace(0.5, 60.0, 1000)
floor = {"floor x": jb.BaseMotion("floor", "x"), "floor z": jb.BaseMotion("floor", "z")}
seen = {"instrument x": jb.PointMotion("table", instrument, "x"), "instrument z": jb.PointMotion("table", instrument, "z")}
response = jb.frequency_response(lin, f, floor, seen)
rubber = jb.frequency_response(lin, f, floor, seen, loss_factor=0.1)  # isolators of rubber: hysteresis besides
print(response)

# 2. A floor that shakes at random, 1e-6 (m/s2)2/Hz from 2 to 40 Hz, in all directions alike but not together
shaking = jb.PSD([2.0, 40.0], [1e-6, 1e-6], unit="(m/s2)2/Hz")
felt = {f"{name} felt": jb.PointMotion("table", instrument, d, kind="acceleration") for name, d in (("x", "x"), ("z", "z"))}
stroke = {"stroke": jb.ElementDeformation("isolator 1", component=2)}
band = jb.Band(2.0, 40.0, points=2001)


def ride(table):
    lin = jb.linearize(table, table.reference)
    return jb.random_response(lin, band, floor, felt | stroke, {name: shaking for name in floor})


found = ride(table)
print(found)
assert found.ok


# 3. What the rms of vertical acceleration owes to the three stiffnesses of one isolator
def vertical(k):
    return ride(jb.replace(table, {"isolator 1.stiffness": k}))["z felt"]


share = jax.jit(jax.jacfwd(vertical))(stiffness) * stiffness / found["z felt"]
print("a percent more stiffness of isolator 1 along x, y, z changes the vertical rms by", np.round(np.asarray(share), 4), "percent")

# 4. Straight up the instrument is a mass on one spring: transmissibility sqrt((1 + (2 z r)^2)/((1 - r^2)^2 + (2 z r)^2))
k, c = 4 * stiffness[2], 4 * 6e-3 * stiffness[2]
w0, z = np.sqrt(k / mass), c / (2 * np.sqrt(k * mass))
assert abs(w0 / (2 * np.pi) - 6.366198) < 1e-6  # Harris' vertical frequency
r = 2 * np.pi * np.asarray(f) / w0
straight = response["instrument z", "floor z"]  # symmetric about its centre, it does not tilt
expected = np.sqrt((1 + (2 * z * r) ** 2) / ((1 - r**2) ** 2 + (2 * z * r) ** 2))
np.testing.assert_allclose(jnp.abs(straight), expected, rtol=1e-9)
crossing = float(jnp.interp(2**0.5 * w0 / (2 * np.pi), f, jnp.abs(straight)))
print(f"transmissibility at sqrt(2) times the natural frequency: {crossing:.5f}")
assert abs(crossing - 1) < 1e-3  # where isolation begins, whatever the damping

figure, (upper, lower) = plt.subplots(2, 1, figsize=(9, 7), layout="constrained")
plots.plot_transmissibility(response, ax=upper)
upper.plot(f, rubber.magnitude[1, 1], color="gray", lw=1.2, label="instrument z of floor z, rubber")
upper.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
upper.set_title("What arrives of the floor's motion")
plots.plot_psd(found, outputs=tuple(felt), ax=lower)
lower.set_title("Under a floor that shakes at random")
if len(sys.argv) == 2 and sys.argv[1].endswith(".png"):
    figure.savefig(sys.argv[1], dpi=110)
else:
    plt.show()
