# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Two gliders on an air track
#
# Two gliders are coupled to each other and to the ends of their track by springs. What is the ratio
# of their masses, seen from their motion alone, and does the model predict what happens next?
#
# The record is M. Schmidt's and H. Lipson's, Science 324 (2009) 81: positions in tracker units,
# each from its own zero, for 16.5 s. Only ratios of masses and forces follow from a motion, so the
# first mass is set to 1.

# %%
import os
from pathlib import Path

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
file = Path(
    os.environ.get("JAXBODY_DATA", "../../shared/data"), "gliders", "real_double_linear_h_1.txt"
)
assert file.exists(), f"There is no {file}: set JAXBODY_DATA to the folder of the measured data."
# velocities: the authors' numerical derivatives
channels = {"x1": (2, "1"), "x2": (3, "1"), "v1": (4, "1/s"), "v2": (5, "1/s")}
record = jb.read_record(file, time=(1, "s"), channels=channels)
print(record)

# %% [markdown]
# The model, with rough guesses of all numbers: two masses on guides between three springs. The free
# lengths of the outer springs hold the unknown rest positions; glider 2 has its zero one span to
# the right.

# %%
span, along = 1000.0, {"axis": [1, 0, 0]}
rest1, rest2 = record["x1"].mean(), span + record["x2"].mean()
model = jb.Model(
    bodies={
        "glider1": jb.Body(mass=1.0, inertia=[1, 1, 1]),
        "glider2": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[span, 0, 0]),
    },
    joints={"glider1": jb.Guide("world", **along), "glider2": jb.Guide("world", **along)},
    elements={
        "left": jb.Spring(
            ("world", [rest1 - span, 0, 0]),
            ("glider1", [0, 0, 0]),
            stiffness=5.0,
            free_length=span,
            damping=0.1,
        ),
        "middle": jb.Spring(
            ("glider1", [0, 0, 0]),
            ("glider2", [0, 0, 0]),
            stiffness=55.0,
            free_length=rest2 - rest1,
        ),
        "right": jb.Spring(
            ("glider2", [0, 0, 0]),
            ("world", [rest2 + span, 0, 0]),
            stiffness=5.0,
            free_length=span,
            damping=0.1,
        ),
    },
)
sensors = {
    "x1": jb.Position("glider1", **along),
    "x2": jb.Position("glider2", [-span, 0, 0], **along),
}
free = [
    "*.stiffness",
    "left.damping",
    "right.damping",
    "glider2.mass",
    "left.free_length",
    "right.free_length",
    "track.initial.*",
]


def run_of(part):
    """A part of the record as an experiment, with a guess of its initial state."""
    start = jb.State(
        q=jnp.array([part["x1"][0], part["x2"][0]]), v=jnp.array([part["v1"][0], part["v2"][0]])
    )
    return jb.Experiment(
        part.times, initial=start, sensors=sensors, measured={name: part[name] for name in sensors}
    )


# %% [markdown]
# One fit to the first 11 seconds predicts the rest; another to the whole record gives the best
# estimate of the mass.

# %%
half = jb.fit(model, {"track": run_of(record.part(0, 11.0))}, free=free)
fit = jb.fit(model, {"track": run_of(record)}, free=free)
print(fit)
trajectory = jb.simulate(half.model, record.times, initial=half.experiments["track"].initial)
predicted, later = jb.measure(trajectory, sensors), record.times > 11.0

# %%
figure, axes = plt.subplots(2, sharex=True, figsize=(9, 5), layout="constrained")
for ax, name, color in zip(axes, sensors, ("C0", "C1"), strict=True):
    ax.axvspan(11.0, record.times[-1], color="0.92", zorder=0)
    ax.plot(
        record.times, record[name], "o", ms=3.5, mfc="white", mec="0.35", mew=0.8, label="measured"
    )
    ax.plot(record.times, predicted[name], color, lw=1.5, label="model fitted to the first 11 s")
    error = np.sqrt(np.mean((predicted[name] - record[name])[later] ** 2)) / np.std(record[name])
    ax.set_title(f"predicted, not fitted: error {100 * error:.1f} %", loc="right", fontsize=10)
    ax.set(ylabel=f"glider {name[1]} [tracker units]", xlim=(0, record.times[-1]))
    ax.legend(loc="upper left", bbox_to_anchor=(0, 1.17), ncols=2, frameon=False)
    assert error < 0.02
axes[1].set_xlabel("time [s]")

# %%
ratio, frequencies = (
    float(fit.model["glider2"].mass),
    jb.modes(jb.linearize(fit.model, jb.equilibrium(fit.model))).frequency,
)
print(
    f"mass ratio {ratio:.3f}, natural frequencies {frequencies[0]:.4f} and {frequencies[1]:.4f} Hz"
)
assert abs(ratio - 2.48) < 0.01 and np.allclose(frequencies, [0.3346, 1.7137], rtol=2e-3)

# %% [markdown]
# Plain fits of two coupled oscillators to this record give 2.48 and 0.3346, 1.7137 Hz too. Read on:
# `glider.py`, one glider against the closed form of its decay; `pendulum.py`; `silverbox.py`.
