# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # An active suspension, and what a semi-active damper keeps of it
#
# A soft damper between body and wheel lets the wheel lose its grip, a stiff one shakes the
# passengers. On a road of class B at 72 km/h, how much better are an actuator with a skyhook law,
# one with an optimal law, and a damper whose valve follows that law but only takes energy out?

# %%
import diffrax
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
ks, bs, kt, speed, class_b = 16e3, 1e3, 190e3, 20.0, jb.vibration.RoadRoughness.iso("B")
W = 2 * np.pi**2 * 0.1**2 * float(class_b.level) * speed
road = {"road": jb.BaseMotion("road", "z", kind="velocity")}
outputs = {"travel": jb.Elongation("spring"), "tyre": jb.Elongation("tyre")}
speeds = {f"{name} speed": jb.Velocity(name, axis="z") for name in ("body", "wheel")}
reads, outputs = outputs | speeds, {"acceleration": jb.Acceleration("body", axis="z")} | outputs
seen = outputs | {"force": jb.sensors.DriveForce("drive")}


def quarter_car(drive, damper=bs):
    up, law = jb.Guide("world", axis="z"), jb.control.state_feedback([[0.0, 0.0, 0.0, 0.0]])
    spring = jb.SpringDamper("wheel", "body", spring=ks, damper=damper, free_length=0.6)
    tyre = jb.Spring("road", "wheel", stiffness=kt, free_length=0.4)
    body = jb.Body(mass=300.0, position=[0, 0, 1.0])
    return jb.Model(
        bodies={"body": body, "wheel": jb.Body(mass=60.0, position=[0, 0, 0.4])},
        supports={"road": jb.Support()},
        joints={"body": up, "wheel": up},
        elements={"spring": spring, "tyre": tyre, "drive": drive},
        controllers={"ride": jb.Controller(reads, "drive", law)},
    )


def with_gains(car, G):
    return jb.replace(car, {"ride.law.D": -jnp.asarray(G).reshape(1, 4)})


# %% [markdown]
# Acceleration [m/s²], travel [mm], forces of tyre and drive [N]: passive, and with a skyhook.

# %%
band, units = jb.vibration.Band(0.01, 200.0, points=201), np.array([1.0, 1e3, kt, 1.0])


@jb.jit
def ride(car):
    lin = jb.linearize(car, car.reference)
    return jb.random_response(lin, band, road, seen, {"road": class_b.at_speed(speed)}).rms * units


actuator = jb.Actuator("wheel", "body")
active, dampings = quarter_car(actuator), np.geomspace(350.0, 5000.0, 25)
passive = np.array([ride(quarter_car(actuator, c)) for c in dampings])
skyhook = np.array([ride(with_gains(active, [0, 0, c, 0])) for c in range(0, 4001, 1000)])

# %% [markdown]
# The optimal law (LQR) has the least mean of $\ddot x_b^2 + q_1 (x_b - x_w)^2 + q_2 (x_w - x_r)^2 +
# r u^2$. It feeds back all states; `gains` finds it on named readings. Other $q_2$ give a front.


# %%
@jb.jit
def optimum(car, q2, q1=1e3, r=1e-6):
    lin, inputs = jb.linearize(car, car.reference), {"u": jb.Command("drive")} | road
    Q = {"acceleration": 1.0, "travel": q1, "tyre": q2}
    regulator = jb.control.lqr(lin, Q, {"u": r}, inputs=inputs, outputs=outputs, noise={"road": W})
    return regulator.cost, regulator.gains(lin, reads)


cost, gains = optimum(active, 6e4)
best = ride(with_gains(active, gains))
weights = np.geomspace(4e3, 6e5, 15)
front = np.array([ride(with_gains(active, optimum(active, q)[1])) for q in weights])

# %% [markdown]
# Which spring, damper and gains give the same ride with the least force?

# %%
design = jb.tune(
    with_gains(active, gains),
    lambda car: dict(zip(seen, ride(car), strict=True)),
    free=["spring.spring.coefficient", "spring.damper.coefficient", "ride.law.D"],
    bounds={"spring.spring.coefficient": (12e3, 40e3), "spring.damper.coefficient": (100.0, 5e3)},
    minimize="force",
    limits={name: (None, float(x)) for name, x in zip(outputs, best, strict=False)},
)
tuned = ride(design.model)

# %% [markdown]
# The valve of a semi-active damper follows the optimal force of a car without damper where that
# lies between two curves (typical ones, of no make), simulated over 600 m of road.


# %%
def curve(slow, fast):
    bump, rebound = (jb.laws.Digressive(slow=f * slow, fast=f * fast, knee=0.2) for f in (1, 2))
    return jb.laws.TwoSided(bump=bump, rebound=rebound)


valve = jb.forces.ControlledDamper("wheel", "body", soft=curve(300, 200), hard=curve(2500, 700))
semi, undamped = quarter_car(valve, 0.0), quarter_car(actuator, 0.0)
x, z = jb.vibration.road_profile(class_b, length=600.0, spacing=0.05, key=jax.random.key(1))
motion, times = {"road": jb.inputs.Road(x, z - z[0], speed=speed)}, np.arange(0.0, 30.0, 0.01)
steps = dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=0.05 / speed, max_steps=20_000)


@jb.jit
def driven(gains):
    here = with_gains(semi, gains)
    run = jb.simulate(here, times, motion=motion, initial=here.reference, **steps)
    read = jb.measure(run, seen)
    return jnp.stack([jnp.std(read[name][200:]) for name in seen]) * units


valves = np.array([driven(optimum(undamped, q)[1]) for q in (1e4, 3e4, 6e4, 1e5, 3e5)])

# %%
figure, ax = plt.subplots(figsize=(8, 5.4), layout="constrained")
for rows, style, at, text in (
    (passive, {"color": "0.35", "lw": 2.5}, (470, 0.9), "passive, by its damping"),
    (front, {"color": "C0", "lw": 2.5}, (455, 0.42), "actuator, optimal law (LQR)"),
    (skyhook, {"color": "C1", "marker": "."}, (527, 0.582), "skyhook, to 4000 N s/m"),
    (valves, {"color": "C2", "marker": "o", "ls": "--"}, (638, 0.5), "semi-active damper"),
):
    ax.plot(rows[:, 2], rows[:, 0], **style)
    ax.text(*at, text, color=style["color"], fontsize=11)
ax.plot(best[2], best[0], "C3*", ms=19, zorder=5)
text = f"one optimum: {best[3]:.0f} N of force;\nspring and damper tuned too: {tuned[3]:.0f} N"
ax.annotate(text, (best[2], best[0]), (372, 0.47), color="C3", arrowprops={"arrowstyle": "-"})
ax.set(xlabel="rms dynamic force of the tyre [N]", ylabel="rms acceleration of the body [m/s²]")
ax.set(xlim=(360, 740), ylim=(0.34, 1.04))

# %%
rising = passive[: np.argmin(passive[:, 2]) + 1][::-1]
less = [1 - y[:, 0] / np.interp(y[:, 2], rising[:, 2], rising[:, 0]) for y in (valves[:4], front)]
share = less[0] / np.interp(valves[:4, 2], front[::-1, 2], less[1][::-1])
print(design, f"semi-active, of the actuator's gain in comfort: {share.round(2)}", sep="\n")
assert abs((best / units) ** 2 @ np.array([1.0, 1e3, 6e4, 1e-6]) / cost - 1) < 0.01 and design.ok
assert np.allclose(tuned[:3], best[:3], rtol=1e-3) and tuned[3] < 0.7 * best[3]
assert np.all((share > 0.6) & (share < 1))

# %% [markdown]
# - **Skyhook**: comfort improves by 13 % at 2000 N s/m, grip does not.
# - **LQR**: comfort improves by 7 % and grip by 5 % at once; spring and damper tuned with the
#   gains, the same ride needs a third less force.
# - **Semi-active**: the law through the valve keeps three quarters of the gain in comfort or more.
#
# Read on: the page Control of the guide; `comfort.py`, the best passive damping.
