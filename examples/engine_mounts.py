"""An engine on three mounts under ten load cases: its displacements, the mount forces, and which
mount to stiffen.

`python examples/engine_mounts.py mounts.png` also saves the figure.
"""

import sys

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
# x along the crankshaft, y across, z up; published stiffnesses
model = jb.presets.engine_on_mounts(gravity=9.81)


def drive(torque):
    """The torque at the wheels turns the powertrain about the driveshafts, across the car."""
    return {"drive": jb.Force("engine", moment=[0, torque, 0], axes="body")}


cases = {
    "3 g up": jb.LoadCase(acceleration=[0, 0, 3]),
    "2 g down": jb.LoadCase(acceleration=[0, 0, -2]),
    "1 g braking": jb.LoadCase(acceleration=[-1, 0, 0]),
    "1 g starting": jb.LoadCase(acceleration=[1, 0, 0]),
    "1 g left turn": jb.LoadCase(acceleration=[0, 1, 0]),
    "1 g right turn": jb.LoadCase(acceleration=[0, -1, 0]),
    "full torque": jb.LoadCase(loads=drive(400.0)),
    "full torque in reverse": jb.LoadCase(loads=drive(-300.0)),
    "torque and left turn": jb.LoadCase(acceleration=[0, 0.7, 0], loads=drive(400.0)),
    "towing eye pulled": jb.LoadCase(
        loads={"eye": jb.Force(("engine", [0.3, 0.0, 0.2]), force=[1500.0, 0.0, 0.0])}
    ),
}
result = jb.load_cases(model, cases)
result.raise_if_failed()
print(result)


def farthest(stiffness):
    """The displacement of the top of the engine in every case [m], as a function of the stiffnesses
    of the mounts along their axes."""
    changed = jb.load_cases(jb.replace(model, {"*.stiffness": stiffness}), cases)
    top = jnp.array([0.0, 0.0, 0.3])
    return jnp.linalg.norm(
        changed.displacements["engine"] + jnp.cross(changed.rotations["engine"], top), axis=-1
    )


k = jnp.stack([model[f"mount {i}"].stiffness for i in (1, 2, 3)])
moved, slopes = farthest(k), jb.jit(jax.jacfwd(farthest))(k)
worst = int(jnp.argmax(moved))
effect = 1e3 * 0.1 * k * slopes[worst]
print(
    f"\nThe top of the engine moves farthest, {1e3 * float(moved[worst]):.2f} mm, in "
    f"'{list(cases)[worst]}'."
)
print("Change of this displacement by 10 % more stiffness of each mount [mm]:")
print(
    "\n".join(
        f"  mount {i + 1}   x {dx:+.3f}   y {dy:+.3f}   z {dz:+.3f}"
        for i, (dx, dy, dz) in enumerate(np.asarray(effect))
    )
)

names = list(cases)
figure, axes = plt.subplots(1, 2, figsize=(11, 5), sharey=True, constrained_layout=True)
rows = np.arange(len(names))
for j, axis in enumerate("xyz"):
    axes[0].barh(
        rows + 0.25 * (j - 1), 1e3 * result.displacements["engine"][:, j], 0.25, label=axis
    )
for j, mount in enumerate(("mount 1", "mount 2", "mount 3")):
    axes[1].barh(
        rows + 0.25 * (j - 1),
        np.linalg.norm(result.forces[mount][:, :3], axis=1) / 1e3,
        0.25,
        label=mount,
    )
axes[0].set_yticks(rows, names)
axes[0].invert_yaxis()
axes[0].set_xlabel("displacement of the center of mass [mm]")
axes[1].set_xlabel("force of the mount [kN]")
for ax in axes:
    ax.grid(axis="x", alpha=0.3)
    ax.legend()
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
