# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # The friction of a pendulum
#
# A pendulum on a bearing was filmed while it swung: does its bearing have dry friction, or does
# viscous damping explain the decay?
#
# $$ \ddot x + a \sin x + c\,\dot x + F\,\frac{\dot x}{\sqrt{\dot x^2 + w_0^2}} = 0 $$
#
# Only ratios to the inertia follow from a motion: it is set to 1. Without any fit, period and
# amplitude of a swing give $a$ by the complete elliptic integral, $T = 4 K(\sin(A/2))/\sqrt a$.
# Data: M. Schmidt, H. Lipson, Science 324 (2009) 81, in a time unit that is not defined.

# %%
import os
from pathlib import Path

import diffrax
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.special import ellipk

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
file = Path(os.environ.get("JAXBODY_DATA", "../../shared/data"), "gliders", "real_pend_h_1.txt")
assert file.exists(), f"There is no {file}: set JAXBODY_DATA to the folder of the measured data."
record = jb.read_record(
    file, time=(1, "s"), channels={"angle": (2, "rad"), "rate": (3, "rad/s")}, irregular=True
)
print(record)

# %% [markdown]
# Two laws of our own: the moment of the weight, from its energy, and dry friction $F$ of either
# sign, so that its interval can contain 0.


# %%
class Weight(jb.laws.Law):
    moment: jax.Array = jb.field("force")  # a

    def potential(self, x):
        return self.moment * (1 - jnp.cos(x))


class Dry(jb.laws.Law):
    level: jax.Array = jb.field("force")  # F

    def force(self, w):
        return self.level * w / jnp.sqrt(w**2 + 0.05**2)


about, half = {"axis": [0, 0, 1]}, 52.0
hinge = jb.Torsion(
    "world",
    "rod",
    spring=Weight(jnp.array(1.33)),
    damper=jb.laws.Linear(0.01) + Dry(jnp.array(0.003)),
    **about,
)
model = jb.Model(
    bodies={"rod": jb.Body(1.0, [1, 1, 1])},
    joints={"rod": jb.Hinge("world", **about)},
    elements={"hinge": hinge},
)
start, sensors = (
    jb.State(record["angle"][:1], record["rate"][:1]),
    {"angle": jb.sensors.JointAngle("rod", bias=0.0)},
)  # bias: zero of the angle
steps = {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 1 / 6}
free = ["hinge.spring.moment", "hinge.damper.*", "swing.angle.bias", "swing.initial.*"]
fit = jb.fit(
    model,
    {"swing": jb.Experiment(initial=start, sensors=sensors, measured=record.part(0, half))},
    free=free,
    **steps,
)
print(fit)

# %% [markdown]
# The interval of $F$, `terms.1.level`, contains zero and ends below half a percent of $a$. One sees
# it without a fit: in a logarithmic plot viscous damping gives a straight line of amplitudes; dry
# friction takes the same height from each swing, so that the line bends down.

# %%
steady = record["angle"] - float(fit.estimates["swing.angle.bias"])
# crossings of zero, upward, between two samples
up = np.flatnonzero((steady[:-1] < 0) & (steady[1:] >= 0))
crossings = record.times[up] - steady[up] * np.diff(record.times)[up] / np.diff(steady)[up]
amplitudes = (np.maximum.reduceat(steady, up) - np.minimum.reduceat(steady, up))[:-1] / 2
middles = (crossings[1:] + crossings[:-1]) / 2
angle = jb.simulate(
    fit.model, record.times, initial=fit.experiments["swing"].initial, **steps
).state.q[:, 0]
error = np.std((angle - steady)[record.times > half]) / np.std(steady[record.times > half])
rate, offset = np.polyfit(middles, np.log(amplitudes), 1)
figure, (left, right) = plt.subplots(
    1, 2, figsize=(11, 4), layout="constrained", width_ratios=[2, 1]
)
left.axvspan(half, record.times[-1], color="0.92", zorder=0)
left.plot(record.times, steady, "o", ms=3.5, mfc="white", mec="0.35", mew=0.8, label="measured")
left.plot(record.times, angle, "C0", lw=1.3, label="model fitted to the first half")
left.set(xlabel="time", ylabel="angle [rad]", xlim=(5, record.times[-1]))
left.legend(loc="lower left", bbox_to_anchor=(0, 1), ncols=2, frameon=False)
left.set_title(f"predicted: error {100 * error:.1f} %", loc="right", fontsize=10)
right.semilogy(middles, amplitudes, "o", mfc="white", mec="0.35", label="measured swings")
right.semilogy(middles, np.exp(offset + rate * middles), "C0", label="viscous")
right.semilogy(middles, np.exp(offset) * (1 + rate * middles), "C1--", label="dry")
right.set(xlabel="time", ylabel="amplitude of a swing [rad]")
right.minorticks_off()
right.set_yticks([0.6, 0.8, 1.0, 1.2, 1.4], ["0.6", "0.8", "1.0", "1.2", "1.4"])
right.legend(frameon=False)

# %%
a = float(fit.estimates["hinge.spring.moment"])
periodic = np.mean((4 * ellipk(np.sin(amplitudes / 2) ** 2) / np.diff(crossings)) ** 2)
print(f"a = {a:.4f}, from periods and amplitudes {periodic:.4f}")
level, spread = (
    float(x["hinge.damper.terms.1.level"]) for x in (fit.estimates, fit.standard_errors)
)
assert (
    level - 2 * spread < 0 < level + 2 * spread < 0.005 * a
    and abs(a / periodic - 1) < 0.01
    and error < 0.035
)

# %% [markdown]
# The fitted $a$ is that of the elliptic integral within a percent. Read on:
# `silverbox.py`; `glider.py`.
