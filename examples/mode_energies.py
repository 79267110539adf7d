"""An engine on its mounts: energies that identify its modes, its axes, and stiffnesses that decouple it about the torque roll axis.

`python examples/mode_energies.py modes.png` also saves the figure.
"""

import sys

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
from scipy.optimize import minimize

import jaxbody as jb
from jaxbody import plots

jax.config.update("jax_enable_x64", True)
if __name__ == "__main__":  # the process is this script's
    jb.fast_loops()
engine = jb.presets.engine_on_mounts()  # x along the crankshaft, y across, z up; published stiffnesses
lin = jb.linearize(engine, engine.reference)
energies = jb.mode_energies(lin, forward="x", up="z")
print(energies, jb.complex_modes(lin), jb.elastic_axes(lin, "engine"), sep="\n\n")

crankshaft = [1.0, 0.0, 0.0]
print("\noriginal:", jb.torque_roll_axis(lin, "engine", crankshaft), sep="\n")


# Stiffnesses of the mounts with which a torque of the crankshaft excites only one mode

k = jnp.stack([engine[f"mount {i}"].stiffness for i in (1, 2, 3)])


def changed(factors):
    """The engine on mounts whose stiffnesses along their axes are multiplied by exp(factors)."""
    model = jb.replace(engine, {"*.stiffness": k * jnp.exp(factors.reshape(3, 3))})
    return jb.linearize(model, model.reference)


@jax.jit
def cost(factors):
    """The coupling of the rotation about the torque roll axis with other motions, plus a small penalty on changes of stiffness."""
    return jb.torque_roll_axis(changed(factors), "engine", crankshaft).coupling ** 2 + 1e-3 * jnp.mean(factors**2)


optimum = minimize(jax.jit(jax.value_and_grad(cost)), np.zeros(9), jac=True, bounds=[(-1.5, 1.5)] * 9)
decoupled = changed(jnp.asarray(optimum.x))
axis = jb.torque_roll_axis(decoupled, "engine", crankshaft)
better = jb.mode_energies(decoupled, forward="x", up="z")
print("\ndecoupled:", axis, better, sep="\n")
print("mount stiffnesses [kN/m]", np.round(np.asarray(k * jnp.exp(optimum.x.reshape(3, 3))) / 1e3, 1), sep="\n")

# Modes tracked by shape from the original to the decoupled engine

branches = jb.track(lambda s: changed(s * optimum.x), jnp.linspace(0.0, 1.0, 21))

figure, axes = plt.subplot_mosaic([["before", "after"], ["branches", "mode"]], figsize=(12, 8), layout="constrained")
plots.plot_mode_energies(energies, ax=axes["before"]).set_title("kinetic energy [%], original", fontsize=9)
plots.plot_mode_energies(better, ax=axes["after"]).set_title("kinetic energy [%], decoupled", fontsize=9)
plots.plot_branches(branches, parameter="from the original mounts (0) to the decoupled ones (1)", ax=axes["branches"])
plots.draw_mode(lin, jb.modes(lin), 6, view="yz", ax=axes["mode"])
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)

published = [0.0105, 0.0415, 15.7859, 78.8366, 4.8406, 0.4850]  # % of the mode at 26.45 Hz, github hojjatkarami/NVHteam
assert np.abs(np.asarray(energies.kinetic["engine"])[:, 5] - published).max() < 0.51e-4
