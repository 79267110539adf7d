# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Two planned runs
#
# A cabinet stands on a mount. A shaker has pushed it up and down, which tells nothing of how stiff
# the mount is against sliding and rocking. Which two runs, out of two dozen that the laboratory
# could make, would tell most, and how sure could one be after them?

# %%
import warnings

import jax
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
model = jb.Model(
    bodies={"cabinet": jb.Body(180.0, [30.0, 26.0, 10.0], com=[0, 0, 0.7])},
    joints={"cabinet": jb.joints.Planar("world", first="x", second="z")},
    elements={
        "mount": jb.Mount(
            ("cabinet", [0, 0, 0]),
            ("world", [0, 0, 0]),
            x=5e5,  # N/m
            z=9e5,
            ry=6e4,  # N m/rad
            damping=[900, 0, 1200, 0, 150, 0],
        )
    },
)
free = {"mount.x.coefficient": 5.5e5, "mount.z.coefficient": 9e5, "mount.ry.coefficient": 5.4e4}
truth, noise = jb.replace(model, free), 0.2  # m/s2
guess = jb.replace(model, {"mount.z.coefficient": 8e5})

# %% [markdown]
# A plan is an experiment without data, in which the noise is stated: the shaker pushes for one
# second with 200 N at a place, in a direction, at a frequency, and two accelerometers read.

# %%
times = np.linspace(0.0, 1.0, 201)
sensors = {
    "top": jb.Acceleration("cabinet", [0, 0, 1.4], axis="x"),
    "foot": jb.Acceleration("cabinet", [0.3, 0, 0], axis="z"),
}
x, z = np.array([200.0, 0, 0]), np.array([0, 0, 200.0])  # N
ways = {"top": ([0, 0, 1.4], x), "middle": ([0, 0, 0.7], x), "foot": ([0, 0, 0], x)}
ways |= {"edge": ([0.3, 0, 0], z), "center": ([0, 0, 0], z)}


def run(way, hertz, measured=None):
    place, force = ways[way]
    push = jb.Force(("cabinet", place), force=jb.signals.Sine(amplitude=force, frequency=hertz))
    return jb.Experiment(
        times, sensors=sensors, loads={"push": push}, noise=noise, measured=measured
    )


def made(way, hertz, seed):
    """The same run, made with the true cabinet."""
    motion = jb.simulate(truth, times, loads=run(way, hertz).loads)
    return run(way, hertz, jb.measure(motion, sensors, noise=noise, key=jax.random.key(seed)))


# %% [markdown]
# The vertical run determines one of three stiffnesses, and the fit says so. What would help?

# %%
vertical = made("center", 8.0, 0)
with warnings.catch_warnings():
    warnings.simplefilter("ignore", jb.JaxbodyWarning)  # it is printed
    first = jb.fit(guess, {"vertical": vertical}, free=list(free))
print(first.report().replace("; ", ";\n  "))
print(jb.fitting.further_measurements(first, most=3))

# %% [markdown]
# Any push to the side would help. Of the runs that the laboratory can make, `choose` finds the two
# after which the larger of the two unknown errors is smallest, at the model as it is known so far.
# No other two can be much better: the efficiency says by how much at most.

# %%
candidates = {
    f"{way} at {hertz} Hz": run(way, hertz)
    for way in ways
    if way != "center"
    for hertz in (2, 3, 4, 8, 12, 16)
}
criterion = "largest interval of mount.x.*, mount.ry.*"
choice = jb.choose(candidates, n=2, each="run", existing=first, criterion=criterion)
print(choice)

# %% [markdown]
# The two runs are made. All three together give the stiffnesses; the errors are close to what was
# expected, although the truth is not where the runs were planned.

# %%
chosen = {name: name.split()[::2] for name in choice.names}
records = {name: made(way, float(f), i) for i, (name, (way, f)) in enumerate(chosen.items(), 1)}
fit = jb.fit(first.model, {"vertical": vertical} | records, free=list(free))
print(fit)

# %%
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 3.8), layout="constrained")
choice.plot(ax=left)
rows, errors = np.arange(3), np.sqrt(np.diag(fit.covariance))
for shift, label, values in (
    (-0.25, "after the vertical run", choice.before),
    (0.0, "expected with both runs", choice.after),
    (0.25, "reached with both runs", errors),
):
    right.barh(rows + shift, np.where(np.isfinite(values), 100 * values, 0), 0.22, label=label)
for row in np.flatnonzero(np.isinf(choice.before)):
    right.text(0.022, row - 0.25, "not determined", va="center", color="C0")
right.set_yticks(rows, [name.removesuffix(".coefficient") for name in choice.parameters])
right.set(xscale="log", xlabel="standard error [%]", xlim=(0.02, 2))
right.invert_yaxis()
right.legend(frameon=False, fontsize=9)

# %%
for path, (low, high) in fit.intervals(0.99).items():
    print(f"{path:22} {free[path]:8.0f}   {low:8.6g} to {high:8.6g}")
    assert low < free[path] < high
np.testing.assert_allclose(errors, choice.after, rtol=0.5)
assert np.isinf(choice.before).sum() == 2 and choice.efficiency > 0.8

# %% [markdown]
# Read on: the page Planning measurements of the guide; `modal_test.py`, a test with many channels.
