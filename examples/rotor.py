# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # The whirl of a rotor
#
# A disk at the end of a shaft in two elastic bearings spins, and it whirls in four modes. At which
# speeds does its unbalance meet a natural frequency, and why only once?
#
# With the displacement $z = x + iy$ and the tilt $\varphi$, both complex, a whirl $e^{i\omega t}$
# is forward for $\omega > 0$, backward for $\omega < 0$, and has the closed form (A. Stodola;
# G. Genta, *Dynamics of Rotating Systems*, 2005)
#
# $$ (k_{zz} - m\,\omega^2)\,(k_{\varphi\varphi} + I_p\,\Omega\,\omega - I\,\omega^2)
# - k_{z\varphi}^2 = 0. $$

# %%
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)

# %% [markdown]
# The disk turns about z. The bearings hold two points of its axis, 10 and 30 cm below it, by
# springs along x and y; a stiff spring holds it along z.

# %%
m, I, Ip, k, near, far = 12.0, 0.12, 0.24, 1e6, -0.1, -0.3
bearings = {
    "near x": (near, "x"),
    "near y": (near, "y"),
    "near z": (near, "z"),
    "far x": (far, "x"),
    "far y": (far, "y"),
}
springs = {}
for name, (z, axis) in bearings.items():
    end = np.eye(3)["xyz".index(axis)] + [0, 0, z]
    springs[name] = jb.Spring(
        ("disk", [0, 0, z]),
        ("world", end),
        stiffness=1000 * k if axis == "z" else k,
        free_length=1.0,
    )
model = jb.Model(bodies={"disk": jb.Body(mass=m, inertia=[I, I, Ip])}, elements=springs)


def spinning(speed):
    """Small motions about a spin [rad/s]."""
    return jb.vibration.linearize_spin(
        model, jb.State(model.reference.q, jnp.zeros(6).at[5].set(speed))
    )


print(jb.complex_modes(spinning(2 * np.pi * 80.0)))

# %% [markdown]
# For each speed: frequencies, the direction of each whirl, and the response to an unbalance of 1 g
# m, which turns with the disk.

# %%
speeds, spin = np.linspace(0.5, 100.0, 200), jnp.diag(jnp.array([0, 0, 0, 0, 0, 1.0]))
frequencies, directions, amplitudes = (np.zeros((200, n)) for n in (6, 6, 1))
for i, w in enumerate(2 * np.pi * speeds):
    lin = spinning(w)
    modes = jb.complex_modes(lin)
    frequencies[i], directions[i] = modes.frequency, jb.vibration.whirl(lin, modes)
    unbalance = 1e-3 * w**2 * jnp.array([1.0, -1.0j, 0, 0, 0, 0])
    amplitudes[i] = abs(
        jnp.linalg.solve(lin.K - w**2 * lin.M + 1j * w * lin.G + spin, unbalance)[0]
    )

# %% [markdown]
# The closed form, and the speed at which it has the root $\omega = \Omega$. A thin disk ($I_p > I$)
# has only one such critical speed: its gyroscopic moment stiffens the other forward whirl faster
# than the speed rises.

# %%
kzz, kpp, kzp = 2 * k, k * (near**2 + far**2), k * (near + far)


def closed_form(w):  # rad/s
    roots = np.roots([m * I, -m * Ip * w, -kzz * I - m * kpp, kzz * Ip * w, kzz * kpp - kzp**2])
    return np.sort(np.abs(roots)) / (2 * np.pi)


squares = np.roots([m * (I - Ip), -m * kpp - kzz * (I - Ip), kzz * kpp - kzp**2])
expected = np.array([closed_form(2 * np.pi * speed) for speed in speeds])
(critical,) = np.sqrt(squares[squares > 0]) / (2 * np.pi)

# %%
figure, (top, bottom) = plt.subplots(
    2, sharex=True, figsize=(8, 6.6), layout="constrained", height_ratios=[2.2, 1]
)
for sign, color, marker, name in (
    (1, "C0", "o", "forward whirl"),
    (-1, "C1", "v", "backward whirl"),
):
    rows, columns = np.where(sign * directions[3::8] > 0.5)
    top.plot(
        speeds[3::8][rows], frequencies[3::8][rows, columns], marker, color=color, ms=7, label=name
    )
top.plot(speeds, expected, "0.6", lw=1.5, zorder=1)
top.plot(speeds, speeds, "0.4", lw=1.2, ls="--")
top.text(70, 73, "speed of the spin", color="0.3", rotation=18, ha="center")
top.plot(critical, critical, "o", mfc="none", mec="k", ms=16)
top.set(
    ylabel="natural frequency [Hz]",
    ylim=(0, 250),
    title="Campbell diagram; gray lines: closed form",
)
top.legend(loc=(0.03, 0.36))
bottom.semilogy(speeds, 1e6 * amplitudes, "C0", lw=1.6)
bottom.axvline(critical, color="k", lw=0.8, ls=":")
bottom.set(xlabel="speed of the spin [Hz]", ylabel="unbalance response [μm]", xlim=(0, 100))

# %%
print(
    f"critical speed {critical:.3f} Hz; largest difference of a frequency "
    f"{np.abs(frequencies[:, 1:5] - expected).max():.1e} Hz"
)
np.testing.assert_allclose(frequencies[:, 1:5], expected, rtol=1e-8)
assert abs(speeds[np.argmax(amplitudes)] - critical) <= 0.5

# %% [markdown]
# The unbalance, which turns forward, meets only one of the four whirls. Read on:
# `mode_energies.py`, an engine without spin.
