# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Comfort on a rough road
#
# A soft damper lets a car bounce on its springs, a stiff one passes every bump on to the passenger.
# Which damping is best for comfort on a class C road at 72 km/h?
#
# For the acceleration over all frequencies, not weighted, the answer for a quarter car has a
# closed form,
#
# $$ c = k_s \sqrt{(m_s + m_u)/k_t}. $$
#
# ISO 2631 weights what people feel most, from 4 to 12 Hz; its answer must be computed.

# %%
import diffrax
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
ms, mu, ks, kt = 375.0, 75.0, 35000.0, 193000.0  # R. N. Jazar, Vehicle Dynamics
quarter = jb.presets.quarter_car(sprung=ms, unsprung=mu, stiffness=ks, tyre=kt)
speed, road, class_c = (
    20.0,
    {"road": jb.BaseMotion("road", "z")},
    jb.vibration.RoadRoughness.iso("C"),
)
band = jb.vibration.Band(0.1, 100.0, points=1001)
outputs = {
    "body": jb.Acceleration("body", axis="z"),
    "travel": jb.Elongation("suspension"),
    "tyre": jb.Elongation("tyre"),
}


def ride(damping, band):
    car = jb.replace(quarter, {"suspension.damping": damping})
    return jb.random_response(
        jb.linearize(car, car.reference), band, road, outputs, {"road": class_c.at_speed(speed)}
    )


def comfort(damping):
    """The weighted acceleration [m/s2]."""
    return jb.vibration.weighted_response(ride(damping, band), {"body": "Wk"})["body"]


# %% [markdown]
# Everything is a JAX function of the damping: a batch of 37 dampings, and Newton's method with
# exact derivatives for the best one.

# %%
dampings = jnp.linspace(400.0, 4000.0, 37)
rides, weighted = jb.jit(jax.vmap(lambda c: (ride(c, band), comfort(c))))(dampings)
best, slope = float(dampings[jnp.argmin(weighted)]), jb.jit(jax.grad(comfort))
for _ in range(6):  # the second derivative by differences of the slope
    here, there = slope(best), slope(best + 1.0)
    best -= float(here / (there - here))
print(
    ride(best, band),
    f"weighted acceleration {comfort(best):.4f} m/s2 at a damping of {best:.1f} N s/m",
    sep="\n\n",
)

# %% [markdown]
# A drive over one such road, simulated: an accelerometer on the body reads what the spectra
# predict, as far as one road is like another.

# %%
distances, heights = jb.vibration.road_profile(
    class_c, length=400.0, spacing=0.05, key=jax.random.key(1)
)
times = jnp.arange(0.0, 18.0, 0.005)
car, under = (
    jb.replace(quarter, {"suspension.damping": best}),
    {"road": jb.inputs.Road(distances, heights - heights[0], speed=speed)},
)
# one step per point of the road
steps = dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=0.05 / speed, max_steps=20_000)
drive = jb.simulate(car, times, motion=under, initial=car.reference, **steps)
recorded = jb.vibration.weighted_signal(times, jb.measure(drive, outputs)["body"], "Wk")
print(recorded)
assert abs(float(recorded.rms) / float(comfort(best)) - 1) < 0.25

# %%
exact = ks * np.sqrt((ms + mu) / kt)
figure, ax = plt.subplots(figsize=(8, 4.6), layout="constrained")
ax.plot(dampings, 100 * (weighted / weighted.min() - 1), "C0-", lw=3, label="weighted acceleration")
for i, name, look in (
    (0, "acceleration", "C1--"),
    (1, "travel of the suspension", "C2-."),
    (2, "deflection of the tyre", "C3:"),
):
    ax.plot(dampings, 100 * (rides.rms[:, i] / rides.rms[:, i].min() - 1), look, lw=1.8, label=name)
for at, color, name in ((best, "C0", "best comfort"), (exact, "C1", "closed form")):
    ax.plot(at, 0, "o", color=color, ms=9)
    ax.text(at, -3, f"{name}\n{at:.0f} N s/m", color=color, ha="center", va="top")
ax.set(
    xlabel="damping [N s/m]", ylabel="rms, above its minimum [%]", ylim=(-14, 80), xlim=(400, 4000)
)
ax.set_title("A quarter car on a class C road at 72 km/h", fontsize=10)
ax.legend(frameon=False)

# %% [markdown]
# The least acceleration over all frequencies, and its damping, are those of the closed form.

# %%
W = 2 * np.pi**2 * 0.1**2 * float(class_c.level) * speed
least = np.sqrt(W / 2 * ((ms + mu) * ks**2 / (exact * ms**2) + kt * exact / ms**2))
minimum, gradient = jb.jit(
    jax.value_and_grad(lambda c: ride(c, jb.vibration.Band(1e-6, 1e7, points=2001))["body"])
)(exact)
print(
    f"least acceleration {minimum:.6f} m/s2 at {exact:.1f} N s/m, in closed form {least:.6f} m/s2"
)
assert abs(minimum / least - 1) < 1e-6 and abs(gradient) * exact < 1e-5 * minimum

# %% [markdown]
# Read on: `ride_design.py`, twelve parameters of a whole car at two speeds and two loads;
# `kerb.py`, what a kerb does to it.
