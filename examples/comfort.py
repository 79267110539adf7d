"""Ride comfort on a class C road: the best damping of a quarter car, and half a car whose rear wheel follows the front wheel."""

import sys

import diffrax
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb
from jaxbody import plots

jax.config.update("jax_enable_x64", True)
if __name__ == "__main__":  # the process is this script's
    jb.fast_loops()
speed = 20.0  # m/s
road = jb.Unevenness.iso("C")
band = jb.Band(0.1, 100.0, points=1001)

# 1. A quarter car (Jazar's numbers) over its damping: weighted acceleration, rms of travel and of the tyre's deflection
ms, mu, ks, kt = 375.0, 75.0, 35000.0, 193000.0
quarter = jb.presets.quarter_car(sprung=ms, unsprung=mu, stiffness=ks, tyre=kt)
at_road = {"road": jb.BaseMotion("road", "z")}
outputs = {
    "body": jb.Acceleration("body", axis="z"),
    "travel": jb.Elongation("suspension"),
    "tyre": jb.Elongation("tyre"),
}


def ride(damping, band=band):
    car = jb.replace(quarter, {"suspension.damping": damping})
    return jb.random_response(jb.linearize(car, car.reference), band, at_road, outputs, {"road": road.at_speed(speed)})


def comfort(damping):
    return jb.weighted(ride(damping), {"body": "Wk"})["body"]


dampings = jnp.linspace(400.0, 4000.0, 37)
rides, weighted = jax.jit(jax.vmap(lambda c: (ride(c), comfort(c))))(dampings)
best = dampings[jnp.argmin(weighted)]
slope = jax.jit(jax.value_and_grad(comfort))
for _ in range(20):  # Newton's method, from the best of the sweep, with second derivatives by differences of the slope
    (_, here), (_, there) = slope(best), slope(best + 1.0)
    best = best - here / (there - here)
print(f"least weighted acceleration {float(comfort(best)):.4f} m/s2 at a damping of {float(best):.1f} N s/m")

# Without weighting and over all frequencies, the smallest acceleration has a closed form: c = ks sqrt((ms + mu)/kt)
exact = ks * np.sqrt((ms + mu) / kt)
all_frequencies = jb.Band(1e-6, 1e7, points=2001)
W = 2 * np.pi**2 * 0.1**2 * float(road.level) * speed
least = np.sqrt(W / 2 * ((ms + mu) * ks**2 / (exact * ms**2) + kt * exact / ms**2))
minimum, gradient = jax.jit(jax.value_and_grad(lambda c: ride(c, all_frequencies)["body"]))(exact)
print(f"without weighting {minimum:.6f} m/s2 at {exact:.1f} N s/m, in closed form {least:.6f} m/s2")
assert abs(minimum / least - 1) < 1e-6 and abs(gradient) * exact < 1e-5 * minimum

# 2. Half a car (Rao's numbers) with dampers: the road reaches the rear axle one wheelbase after the front axle
half = jb.presets.half_car(front_damping=1200.0, rear_damping=1500.0)
lin = jb.linearize(half, half.reference)
w = 2 * np.pi * np.asarray(jb.modes(jb.linearize(jb.presets.half_car(), half.reference)).frequency)
np.testing.assert_allclose(w, [5.8593, 9.4341], rtol=2e-5)  # undamped, as printed by Rao
axles = {axle: jb.BaseMotion(axle, "z") for axle in ("front", "rear")}
at_axles = jb.CrossPSD(dict.fromkeys(axles, road.at_speed(speed)), delays={"rear": 2.5 / speed}, coherence={("front", "rear"): 1.0})
places = {"over the front axle": 1.0, "center of mass": 0.0, "over the rear axle": -1.5}
seats = {name: jb.Acceleration("body", [x, 0, 0], axis="z") for name, x in places.items()}
shaken = jb.random_response(lin, jb.Band(0.1, 100.0, points=4001), axles, seats, at_axles)
passengers = jb.weighted(shaken, dict.fromkeys(seats, "Wk"))
print(passengers)

# 3. A drive over one such road: the signal of an accelerometer on the body
distances, heights = jb.road_profile(road, length=400.0, spacing=0.05, key=jax.random.key(1))
wheels = {
    "front": jb.Road(distances, heights - heights[0], speed=speed),
    "rear": jb.Road(distances, heights - heights[0], speed=speed, position=-2.5),
}
times = jnp.arange(0.0, 18.0, 0.005)
steps = dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=0.05 / speed)  # one step per point of the road
run = jb.simulate(half, times, motion=wheels, initial=half.reference, max_steps=20_000, **steps)
run.raise_if_failed()
acceleration = jnp.gradient(run.state.v[:, 0], times[1] - times[0])
recorded = jb.weighted_signal(times, acceleration, "Wk")
print(recorded)
expected = float(passengers["center of mass"])
print(f"weighted rms of the drive {float(recorded.rms):.3f} m/s2, expected value for such roads {expected:.3f} m/s2")
assert abs(float(recorded.rms) / expected - 1) < 0.25  # one road of 360 m

figure, axes = plt.subplots(3, 1, figsize=(9, 10), layout="constrained")
for values, name in ((weighted, "weighted acceleration"), (rides.rms[:, 1], "travel"), (rides.rms[:, 2], "tyre deflection")):
    axes[0].plot(dampings, values / values.min(), label=name)
axes[0].axvline(float(best), color="gray", lw=0.8)
axes[0].set(
    xlabel="damping [N s/m]", ylabel="rms relative to its minimum", ylim=(0.95, 2.5), title="A quarter car on a class C road at 72 km/h"
)
axes[0].legend(frameon=False, fontsize=8, loc="upper right")
plots.plot_psd(passengers, ax=axes[1])
axes[1].set(title="Half a car: weighted acceleration, by seat", ylim=(1e-7, None))
axes[1].legend(frameon=False, fontsize=8, loc="lower left")
axes[2].plot(times, recorded.values, lw=0.7)
axes[2].set(xlabel="time [s]", ylabel="weighted acceleration [m/s2]", title=f"One drive, crest factor {float(recorded.crest_factor):.2f}")
if len(sys.argv) == 2 and sys.argv[1].endswith(".png"):
    figure.savefig(sys.argv[1], dpi=110)
else:
    plt.show()
