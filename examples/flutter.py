# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # Flutter of a wing section, tuned away
#
# A wing section plunges on a spring and pitches about its elastic axis. Its lift acts ahead of the
# axis and grows with the angle; it has no potential and can feed a motion. At which pressure does
# the motion grow, does a light damper help, and which balance mass does?
#
# With the plunge $h$, downwards, the angle $\theta$, nose up, and the lift $Q\theta$ per unit of
# span at the distance $e$ ahead of the axis (R. Bisplinghoff, H. Ashley, R. Halfman,
# *Aeroelasticity*, 1955),
#
# $$ m\ddot h + S\ddot\theta + k_h h = -Q\theta, \qquad
# S\ddot h + I\ddot\theta + k_\theta\theta = Q e\,\theta. $$
#
# It flutters where both frequencies meet, and diverges, without oscillation, at $Q = k_\theta/e$.

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import brentq

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
m, S, I, kh, kt, e = 20.0, 2.0, 2.5, 8e3, 3e3, 0.1  # per meter of span
nose = 0.35  # m ahead of the axis
nose_up, wind = [0, -1, 0], {"chord": "x", "flow": [-1, 0, 0], "lift": "z"}
spring = ("axis", [0, 0, 0]), ("world", [0, 0, -1])  # the ends of the spring of the plunge


def section(balance, damper, damper_of_pitch):
    """A section with a balance mass in its nose."""
    return jb.Model(
        bodies={
            "axis": jb.Body(mass=m / 2, inertia=[1, 1, 1]),
            "wing": jb.Body(mass=m / 2, com=[-2 * S / m, 0, 0], inertia=[1, I - 2 * S**2 / m, 2]),
            "balance": jb.Body(mass=balance, position=[nose, 0, 0]),
        },
        joints={
            "axis": jb.Guide("world", axis="z"),
            "wing": jb.Hinge("axis", axis=nose_up),
            "balance": jb.Fixed("wing"),
        },
        elements={
            "plunge": jb.Spring(*spring, stiffness=kh, free_length=1.0, damping=damper),
            "pitch": jb.Torsion("wing", "axis", axis=nose_up, spring=kt, damper=damper_of_pitch),
            "air": jb.forces.SectionAirloads(
                ("wing", [e, 0, 0]), **wind, pressure=0.0, area=1.0, slope=1.0
            ),
        },
    )


bare = section(1e-9, 0.0, 0.0)  # without balance mass and dampers


def small_motions(model, pressure):
    model = jb.replace(model, {"air.pressure": pressure})
    return jb.linearize(model, model.reference)


# %% [markdown]
# Without dampers, flutter is where the difference of the two $\omega^2$ vanishes, divergence where
# $K$ is singular. Derivatives through both are exact.


# %%
def apart(pressure, torsion=kt):
    lin = small_motions(jb.replace(bare, {"pitch.spring.coefficient": torsion}), pressure)
    A = jnp.linalg.solve(lin.M, lin.K)
    return jnp.trace(A) ** 2 - 4 * jnp.linalg.det(A)


def root(function, low, high):
    compiled = jb.jit(function)
    return brentq(lambda pressure: float(compiled(pressure)), low, high, xtol=1e-9)


flutter = root(apart, 4e3, 5e3)
divergence = root(lambda Q: jnp.linalg.det(small_motions(bare, Q).K), 2e4, 4e4)
slope = -jnp.divide(*jax.grad(apart, (1, 0))(flutter, kt))
print(f"flutter at {flutter:.2f} Pa, {slope:.4f} Pa per N m/rad; divergence at {divergence:.2f} Pa")

# %% [markdown]
# Light dampers make flutter come earlier, where they slow one motion more than the other. Which is
# the lightest mass in the nose with which all motions decay up to 1.2 times the speed of undamped
# flutter? Free are a torsion spring up to 15 percent stiffer and the damper of the plunge.

# %%
light = {"plunge.damping": 30.0, "pitch.damper.coefficient": 1.0}
demanded = jnp.linspace(0.0, 1.2**2 * flutter, 13)


def slowest(model, pressure):
    rates = jb.complex_modes(small_motions(model, pressure)).decay_rate
    return jb.objectives.smooth_min(rates, 1e-3)


def quantities(model):
    decay = jax.vmap(lambda pressure: slowest(model, pressure))(demanded)
    return {"mass": model["balance"].mass, "decay": decay}


design = jb.tune(
    section(0.5, *light.values()),
    quantities,
    free=["balance.mass", "pitch.spring.coefficient", "plunge.damping"],
    bounds={"pitch.spring.coefficient": (2e3, 1.15 * kt), "plunge.damping": (1.0, 100.0)},
    minimize="mass",
    limits={"decay": (0.12, None)},
)
print({path: round(float(value), 3) for path, value in design.values.items()}, design.active)

# %%
cases = {"light dampers": ("C1", jb.replace(bare, light)), "tuned": ("C0", design.model)}
pressures, begins = np.linspace(0.0, 9e3, 226), {}
track = jb.jit(lambda model: jb.vibration.track_modes(lambda Q: small_motions(model, Q), pressures))
mean = (m * (kt - e * pressures) + kh * I - S * pressures) / (2 * (m * I - S**2))
product = kh * (kt - e * pressures) / (m * I - S**2)
split = np.emath.sqrt(mean**2 - product)
undamped = np.sqrt(np.stack([mean - split, mean + split], 1))
figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4.4), layout="constrained")
left.plot(pressures / 1e3, np.sort(undamped.real / (2 * np.pi)), "0.7", lw=4)
right.plot(pressures / 1e3, np.sort(undamped.imag), "0.7", lw=4)
left.plot([], [], "0.7", lw=4, label="undamped, closed form")
for name, (color, model) in cases.items():
    modes = track(model)
    f, zeta = np.asarray(modes.frequency), np.asarray(modes.damping_ratio)
    left.plot(pressures / 1e3, f, color, lw=1.8)
    right.plot(pressures / 1e3, 2 * np.pi * f * zeta / np.sqrt(1 - zeta**2), color, lw=1.8)
    left.plot([], [], color, lw=1.8, label=name)
    begins[name] = root(lambda Q, model=model: slowest(model, Q), 3e3, 9e3)
    right.plot(begins[name] / 1e3, 0, "o", color=color, ms=7)
    print(f"{name}: flutter at {begins[name]:.1f} Pa")
right.axvline(float(demanded[-1]) / 1e3, color="0.3", lw=1, ls=":")
right.text(6.7, -1.4, "demanded up to here", rotation=90, color="0.3", ha="right")
right.axhline(0, color="0.3", lw=0.8)
left.set(ylabel="frequency [Hz]", ylim=(2.5, 6.5), title="Frequencies meet where flutter begins")
right.set(ylabel="decay rate [1/s]", ylim=(-1.5, 1.5), title="Below zero a motion grows")
for ax in (left, right):
    ax.set(xlabel="dynamic pressure [kPa]", xlim=(0, 9))
left.legend(frameon=False)

# %%
assert abs(flutter / 4762.33108242224 - 1) < 1e-7 and abs(divergence / (kt / e) - 1) < 1e-9
assert abs(slope - 2.83787217122) < 1e-5
assert float(design.after["decay"].min()) > 0.1199
assert begins["light dampers"] < 0.8 * flutter < 1.44 * flutter < begins["tuned"]

# %% [markdown]
# Tuned, the dampers slow both motions nearly alike. Flutter begins where the demand ends, so the
# demand has to contain all margins. Read on: `rotor.py`, gyroscopic moments; `robust_absorber.py`,
# a design for numbers that are not known exactly.
