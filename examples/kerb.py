"""A car drives over a kerb with its left wheels: bump stops, nonlinear dampers, anti-roll bars,
tyres that may leave the ground.

`python examples/kerb.py kerb.png` also saves the figure.
"""

import sys

import diffrax
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb
from jaxbody import laws
from jaxbody.views.plots.canvases import style, tidy

jax.config.update("jax_enable_x64", True)
up, g = [0, 0, 1], 9.81
# from the center of mass, x forward, y left
wheels = {"fl": (1.2, 0.75), "fr": (1.2, -0.75), "rl": (-1.4, 0.75), "rr": (-1.4, -0.75)}
mass, unsprung, radius, height = 1100.0, 38.0, 0.3, 0.55
k, travel, tyre, engagement = 23e3, 0.07, 2.1e5, 1e-3
# static load of each strut
load = {name: mass * g * (1.4 if x > 0 else 1.2) / 2.6 / 2 for name, (x, _) in wheels.items()}
# static deflection of each tyre
pressed = {name: (load[name] + unsprung * g) / tyre + engagement / 2 for name in wheels}


def spring(name):
    """A spring with a bump stop and a rebound stop, each `travel` away from the static position;
    gaps are measured from the free length."""
    stop = dict(stiffness=2.5e5, engagement=0.015)
    bump, rebound = load[name] / k + travel, max(travel - load[name] / k, 0.0)
    return (
        laws.Linear(k)
        + laws.BumpStop(gap=bump, **stop)
        + laws.BumpStop(gap=rebound, extension=True, **stop)
    )


damper = laws.TwoSided(
    bump=laws.Digressive(slow=1500.0, fast=400.0, knee=0.2),
    rebound=laws.Digressive(slow=3500.0, fast=1200.0, knee=0.2),
)

model = jb.Model(
    bodies={
        # pitch and roll about a point on the road
        "car": jb.Body(mass=mass, inertia=[450.0, 1500.0, 1700.0], com=[0, 0, height]),
        **{
            name: jb.Body(mass=unsprung, inertia=[1, 1, 1], position=[x, y, radius - pressed[name]])
            for name, (x, y) in wheels.items()
        },
    },
    supports={f"road {name}": jb.Support(position=[x, y, 0]) for name, (x, y) in wheels.items()},
    joints={
        "car": jb.joints.HeavePitchRoll("world"),
        **{name: jb.Guide("world", axis=up) for name in wheels},
    },
    elements={
        **{
            f"strut {name}": jb.SpringDamper(
                ("car", [x, y, height]),
                (name, [0, 0, pressed[name] - radius]),
                spring=spring(name),
                damper=damper,
                free_length=height,
            )
            for name, (x, y) in wheels.items()
        },
        **{
            f"tyre {name}": jb.Tyre(
                name, f"road {name}", stiffness=tyre, damping=60.0, radius=radius
            )
            for name in wheels
        },
        "front bar": jb.AntiRollBar("fl", "fr", "car", spring=12e3),
        "rear bar": jb.AntiRollBar("rl", "rr", "car", spring=6e3),
    },
    gravity=[0, 0, -g],
)
model = jb.preload(model, free="strut *.free_length").model  # the car stands level on its struts
eq = jb.equilibrium(model)
print(eq)

cases = {
    "braking": jb.LoadCase(acceleration=[-0.6, 0, 0]),
    "cornering": jb.LoadCase(acceleration=[0, 0.6, 0]),
}
pushed = jb.load_cases(model, cases, at=eq)
for i, case in enumerate(cases):
    print(
        f"{case} with 0.6 g, tyres [kN]:",
        *(f"{name} {-float(pushed.forces[f'tyre {name}'][i]) / 1e3:.2f}" for name in wheels),
    )

speed, kerb = 10.0, 0.08
profile = dict(height=kerb, at=3.0, ramp=0.03, speed=speed, footprint=0.15)
motion = {
    f"road {name}": jb.inputs.Road.kerb(position=x, **profile)
    for name, (x, y) in wheels.items()
    if y > 0
}  # the right wheels stay on the road
times = jnp.linspace(0.0, 1.5, 1501)
run = jb.simulate(model, times, motion=motion, initial=eq.state, rtol=1e-7)
run.raise_if_failed()
strokes, forces = run.elongations, run.forces
print(
    f"\n{'':14s}{'stroke [mm]':>22s}{'strut [kN]':>20s}{'tyre [kN]':>20s}{'in the air [ms]':>18s}"
)
for name in wheels:
    s, f, t = (
        np.asarray(x)
        for x in (
            strokes[f"strut {name}"] - strokes[f"strut {name}"][0],
            forces[f"strut {name}"],
            forces[f"tyre {name}"],
        )
    )
    stroke = f"{1e3 * s.min():8.1f} .. {1e3 * s.max():6.1f}"
    strut, contact = (f"{x.min() / 1e3:7.2f} .. {x.max() / 1e3:5.2f}" for x in (f, t))
    print(
        f"{name:14s}{stroke:>22s}{strut:>20s}{contact:>20s}{1e3 * np.mean(t > -1e-9) * 1.5:18.0f}"
    )


def roughness(further):
    """The rms acceleration of the car's center [m/s2] with the bump stops moved away by
    `further` [m]."""
    gaps = {
        path: gap + further
        for path, gap in jb.parameter_paths(model, "strut *.spring.terms.1.gap").items()
    }
    changed = jb.replace(model, gaps)
    v = jb.simulate(
        changed, times, motion=motion, initial=eq.state, rtol=1e-7, adjoint=diffrax.ForwardMode()
    ).state.v[:, 0]
    return jnp.sqrt(jnp.mean(jnp.diff(v) ** 2)) / (times[1] - times[0])


value, slope = jax.jvp(jax.jit(roughness), (0.0,), (1.0,))
print(
    f"\nrms acceleration of the body {float(value):.3f} m/s2; each mm of additional gap to the "
    "bump stops changes it"
)
print(f"by {float(slope) / 1e3:+.4f} m/s2")

figure, axes = plt.subplots(4, 1, figsize=(8, 9), sharex=True, layout="constrained")
axes[0].plot(times, 1e3 * run.state.q[:, 0], label="heave", **style(0))
axes[1].plot(times, np.rad2deg(run.state.q[:, 1]), label="pitch, nose down", **style(0))
axes[1].plot(times, np.rad2deg(run.state.q[:, 2]), label="roll, right side down", **style(1))
for i, name in enumerate(wheels):
    axes[2].plot(
        times,
        1e3 * (strokes[f"strut {name}"] - strokes[f"strut {name}"][0]),
        label=name,
        **style(i),
    )
    axes[3].plot(times, -forces[f"tyre {name}"] / 1e3, label=name, **style(i))
for ax, label in zip(
    axes, ("body [mm]", "body [degrees]", "strut's stroke [mm]", "tyre on road [kN]"), strict=True
):
    ax.set_ylabel(label)
axes[3].set_xlabel("time [s]")
axes[0].set_title(f"Left wheels over a kerb of {1e3 * kerb:.0f} mm at {3.6 * speed:.0f} km/h")
for ax, place in zip(
    axes, ("lower right", "center right", "lower right", "upper right"), strict=True
):
    ax.legend(loc=place, fontsize=8, frameon=False)
    tidy(ax)
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
