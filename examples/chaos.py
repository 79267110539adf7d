# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Chaos
#
# A double pendulum tumbles: after a few seconds the smallest change of a parameter has changed
# everything. How can its parameters be fitted to a record that no simulation follows?
#
# By multiple shooting: the record is cut into short segments, each with an initial state of its
# own, and the gaps between them are closed step by step (H. G. Bock, 1983).

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)

# %% [markdown]
# A record of both angles for five seconds, with noise of 10 mrad, from a release at rest. The mass
# of the lower rod is to be found.

# %%
true = jb.presets.double_pendulum(masses=(1.0, 0.6))
times, start = jnp.linspace(0.0, 5.0, 151), jb.State(q=jnp.array([2.2, 0.8]), v=jnp.zeros(2))
sensors = {name: jb.sensors.JointAngle(name) for name in ("upper", "lower")}
motion = jb.simulate(true, times, initial=start, rtol=1e-8)
measured = jb.measure(motion, sensors, noise=0.01, key=jax.random.key(0))
run = jb.Experiment(times, initial=start, sensors=sensors, measured=measured, noise=0.01)


# %% [markdown]
# The misfit of one simulation, over the mass: a mountain range with a hole at the truth, which no
# descent finds.


# %%
@jax.jit
@jax.vmap
def misfit(mass):
    q = jb.simulate(jb.replace(true, {"lower.mass": mass}), times, initial=start, rtol=1e-6).state.q
    return jnp.sqrt(
        jnp.mean(jnp.stack([q[:, 0] - measured["upper"], q[:, 1] - measured["lower"]]) ** 2)
    )


masses = jnp.linspace(0.3, 0.9, 601)
landscape = np.asarray(misfit(masses))
valleys = np.sum((landscape[1:-1] < landscape[:-2]) & (landscape[1:-1] < landscape[2:]))
print(f"{valleys} valleys between 0.3 and 0.9 kg")

# %% [markdown]
# Fifteen segments of a third of a second each: within one the motion is tame. The guess is a third
# too heavy.

# %%
guess = jb.replace(true, {"lower.mass": 0.8})
fit = jb.fitting.multiple_shooting(guess, {"run": run}, free="lower.mass", segments=15, rtol=1e-6)
print(fit)

# %%
estimate, error = (float(x["lower.mass"]) for x in (fit.estimates, fit.standard_errors))
figure, (above, below) = plt.subplots(2, figsize=(9, 6), layout="constrained")
above.plot(
    times, measured["lower"], "o", ms=3.5, mfc="white", mec="0.35", mew=0.8, label="measured"
)
for mass, look, name in (
    (0.606, "C1--", "1 % too heavy"),
    (estimate, "C0-", "fitted by multiple shooting"),
):
    q = jb.simulate(jb.replace(true, {"lower.mass": mass}), times, initial=start, rtol=1e-6).state.q
    above.plot(times, q[:, 1], look, lw=1.5, label=f"simulated, {name}")
above.set(xlabel="time [s]", ylabel="angle of the lower rod [rad]", xlim=(0, 5))
above.legend(frameon=False)
below.plot(masses, landscape, "0.4", lw=1)
below.plot(estimate, 0.01, "o", color="C0", ms=9)
below.plot(0.8, np.interp(0.8, masses, landscape), "s", color="C1", ms=8)
below.annotate(
    "guess",
    (0.8, np.interp(0.8, masses, landscape)),
    (0, -20),
    textcoords="offset points",
    color="C1",
    ha="center",
)
below.annotate(
    f"fit: {estimate:.5f} kg", (estimate, 0.01), (10, 2), textcoords="offset points", color="C0"
)
below.set(
    xlabel="mass of the lower rod [kg]",
    ylabel="misfit of one simulation [rad]",
    xlim=(0.3, 0.9),
    title=f"{valleys} valleys",
)

# %%
print(f"estimate {estimate:.6f} +- {error:.1g} kg, truth 0.6 kg")
assert abs(estimate - 0.6) < 1e-4 and valleys > 20

# %% [markdown]
# Read on: `gliders.py` and `pendulum.py`, fits of measured motions without chaos.
