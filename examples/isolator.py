"""An instrument on four isolators: transmissibility by direction, and accelerations on a floor with random vibration."""

import sys

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb
from jaxbody import plots

jax.config.update("jax_enable_x64", True)
if __name__ == "__main__":  # the process is this script's
    jb.fast_loops()

# The table of Harris, Shock and Vibration Handbook, chapter 3, with dampers
mass, gyration, stiffness, at = 200.0, (0.35, 0.42, 0.5), np.array([3e4, 5e4, 8e4]), (0.45, 0.3, 0.25)
table = jb.presets.isolated_table(mass=mass, gyration=gyration, stiffness=stiffness, at=at, damping=6e-3 * stiffness)
lin = jb.linearize(table, table.reference)  # the reference is the equilibrium: these isolators carry no weight
modes = jb.modes(lin)
print(modes)

# 1. Response of the instrument, 0.3 m above the table's center, to the motion of the floor
instrument = [0.1, 0.05, 0.3]
f = jnp.geomspace(0.5, 60.0, 1000)
floor = {"floor x": jb.BaseMotion("floor", "x"), "floor z": jb.BaseMotion("floor", "z")}
at_instrument = {"instrument x": jb.Position("table", instrument, axis="x"), "instrument z": jb.Position("table", instrument, axis="z")}
response = jb.frequency_response(lin, f, floor, at_instrument)
rubber = jb.frequency_response(lin, f, floor, at_instrument, loss_factor=0.1)  # rubber isolators add hysteretic damping
print(response)

# 2. Random vibration of the floor, 1e-6 (m/s2)2/Hz from 2 to 40 Hz, equal and uncorrelated in x and z
shaking = jb.PSD([2.0, 40.0], [1e-6, 1e-6], unit="(m/s2)2/Hz")
accelerations = {f"acceleration {name}": jb.Acceleration("table", instrument, axis=d) for name, d in (("x", "x"), ("z", "z"))}
stroke = {"stroke": jb.Elongation("isolator 1", component=2)}
band = jb.Band(2.0, 40.0, points=2001)


def ride(table):
    lin = jb.linearize(table, table.reference)
    return jb.random_response(lin, band, floor, accelerations | stroke, {name: shaking for name in floor})


vibration = ride(table)
print(vibration)
assert vibration.ok


# 3. Sensitivity of the rms vertical acceleration to the three stiffnesses of one isolator
def vertical(k):
    return ride(jb.replace(table, {"isolator 1.stiffness": k}))["acceleration z"]


share = jax.jit(jax.jacfwd(vertical))(stiffness) * stiffness / vibration["acceleration z"]
print("1 % more stiffness of isolator 1 along x, y, z changes the vertical rms by", np.round(np.asarray(share), 4), "%")

# 4. Vertically the table is a mass on one spring: transmissibility sqrt((1 + (2 z r)^2)/((1 - r^2)^2 + (2 z r)^2))
k, c = 4 * stiffness[2], 4 * 6e-3 * stiffness[2]
w0, z = np.sqrt(k / mass), c / (2 * np.sqrt(k * mass))
assert abs(w0 / (2 * np.pi) - 6.366198) < 1e-6  # Harris' vertical frequency
r = 2 * np.pi * np.asarray(f) / w0
vertical_response = response["instrument z", "floor z"]  # no tilt, because the table is symmetric about its center
expected = np.sqrt((1 + (2 * z * r) ** 2) / ((1 - r**2) ** 2 + (2 * z * r) ** 2))
np.testing.assert_allclose(jnp.abs(vertical_response), expected, rtol=1e-9)
crossing = float(jnp.interp(2**0.5 * w0 / (2 * np.pi), f, jnp.abs(vertical_response)))
print(f"transmissibility at sqrt(2) times the natural frequency: {crossing:.5f}")
assert abs(crossing - 1) < 1e-3  # isolation begins here for any damping

figure, (upper, lower) = plt.subplots(2, 1, figsize=(9, 7), layout="constrained")
plots.plot_transmissibility(response, ax=upper)
upper.plot(f, rubber.magnitude[1, 1], color="gray", lw=1.2, label="instrument z of floor z, rubber")
upper.legend(frameon=False, fontsize=8, loc="upper left", bbox_to_anchor=(1.0, 1.0))
upper.set_title("Transmissibility from the floor to the instrument")
plots.plot_psd(vibration, outputs=tuple(accelerations), ax=lower)
lower.set_title("Response to random vibration of the floor")
if len(sys.argv) == 2 and sys.argv[1].endswith(".png"):
    figure.savefig(sys.argv[1], dpi=110)
else:
    plt.show()
