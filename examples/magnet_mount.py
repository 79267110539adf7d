"""An energy of one's own: an instrument that floats on repelling magnets. The magnets are fitted to
a measured motion, then tuned.

Two magnets on one axis, at a distance e much larger than themselves, repel each other as dipoles
do. A copper plate between them damps:

    V(e) = A/(3 e^3),   F = A/e^4,   R = c e_dot^2/2

Each is a function of frames in a few lines. Their fields state unit and domain, so A and c stay
positive in `fit`, `tune` and `replace`, and print with their units. Forces, equilibrium, stiffness
and frequencies follow.
The instrument of mass m floats where A/e^4 = m g. There K = 4 A/e^5 = 4 m g/e, so its frequency
depends on the distance only:

    w^2 = 4 g/e

The record is computed by SciPy from x'' = A/(m x^4) - g - c x'/m, with noise added.

To save the figure, give a file name: python examples/magnet_mount.py magnets.png
"""

import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.integrate import solve_ivp

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
MASS, G, DRAWN = 2.0, 9.81, 0.06


class Magnets(eqx.Module):
    """V of two repelling magnets, one on the instrument and one at the origin of the world."""

    strength: jax.Array = jb.field("N m4", "positive")

    def __call__(self, frames):
        return self.strength / (3 * jnp.linalg.norm(frames["instrument"].p) ** 3)


class Plate(eqx.Module):
    """R of the copper plate between them, c e_dot^2/2 with e_dot along the line between
    the magnets."""

    damping: jax.Array = jb.field("N s/m", "nonnegative")

    def __call__(self, frames):
        magnet = frames["instrument"]
        return self.damping * (magnet.v @ magnet.p / jnp.linalg.norm(magnet.p)) ** 2 / 2


def instrument(strength: float, damping: float) -> jb.Model:
    """An instrument guided vertically, 60 mm above the lower magnet in its reference pose."""
    return jb.Model(
        bodies={
            "instrument": jb.Body(mass=MASS, inertia=[0.01, 0.01, 0.01], position=[0, 0, DRAWN])
        },
        joints={"instrument": jb.Guide("world", axis=[0, 0, 1])},
        energies={"magnets": Magnets(strength)},
        dissipations={"plate": Plate(damping)},
        gravity=[0, 0, -G],
    )


# 1. The record: the instrument is released at rest 60 mm above the lower magnet
TRUE = {"magnets.strength": 5.0e-5, "plate.damping": 4.0}
times, noise = np.linspace(0.0, 1.0, 201), 1e-4
A, c = TRUE.values()
height = solve_ivp(
    lambda _, x: [x[1], A / (MASS * x[0] ** 4) - G - c / MASS * x[1]],
    (0, 1),
    [0.06, 0.0],
    "DOP853",
    times,
    rtol=1e-10,
).y[0]
measured = height + noise * np.random.default_rng(7).normal(size=times.shape)

# 2. The fit, from magnets of half the strength and hardly any damping
guess = instrument(2.5e-5, 0.5)
start = jb.State(q=jnp.zeros(1), v=jnp.zeros(1))
position = jb.Position("instrument", axis=[0, 0, 1])
release = jb.Experiment(
    times, initial=start, sensors={"height": position}, measured={"height": measured}, noise=noise
)
fit = jb.fit(guess, {"release": release}, free=list(TRUE))
print(fit)
for path, true in TRUE.items():
    assert abs(float(fit.estimates[path]) - true) < 4 * float(fit.standard_errors[path]), path

# 3. Where the instrument floats, and how fast it oscillates
floating = jb.equilibrium(fit.model)
modes = jb.modes(jb.linearize(fit.model, floating))
distance = DRAWN + float(floating.state.q[0])
print(floating, modes, sep="\n")
assert abs(distance / (float(fit.estimates["magnets.strength"]) / (MASS * G)) ** 0.25 - 1) < 1e-9
assert abs(float(modes.frequency[0]) / (np.sqrt(4 * G / distance) / (2 * np.pi)) - 1) < 1e-9


# 4. The weakest magnets that keep a distance of 30 mm, for the lowest price
def float_at(model):
    eq = jb.equilibrium(model)
    return {"strength": model["magnets"].strength * 1e5, "distance": DRAWN + eq.state.q[0]}


design = jb.tune(
    fit.model,
    float_at,
    free="magnets.strength",
    minimize="strength",
    limits={"distance": (0.03, None)},
    bounds={"magnets.strength": (1e-6, 1e-3)},
)
print(design)
assert abs(float(design.values["magnets.strength"]) / (MASS * G * 0.03**4) - 1) < 1e-6

figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4), layout="constrained")
left.plot(times, 1e3 * measured, ".", ms=3, color="0.5", label="measured")
left.plot(times, 1e3 * fit.predicted["release"]["height"], lw=1.2, label="fitted")
left.set(xlabel="time [s]", ylabel="height [mm]", title="Released 60 mm above the lower magnet")
e = np.linspace(0.025, 0.06, 200)
for name, model in {"fitted": fit.model, "tuned": design.model}.items():
    right.plot(1e3 * e, float(model["magnets"].strength) / e**4, label=name)
right.axhline(MASS * G, color="0.5", lw=0.8)
right.annotate("weight", (1e3 * e[-1], MASS * G), ha="right", va="bottom", color="0.4")
right.set(xlabel="distance [mm]", ylabel="force [N]", title="Force of the magnets", ylim=(0, 80))
for ax in (left, right):
    ax.legend(frameon=False)
    ax.grid(alpha=0.3)
if len(sys.argv) == 2 and sys.argv[1].endswith(".png"):
    figure.savefig(sys.argv[1], dpi=110)
else:
    plt.show()
