# ---
# jupyter:
#   kernelspec: {display_name: Python 3, language: python, name: python3}
# ---

# %% [markdown]
# # An active suspension, and what a semi-active damper keeps of it
#
# A damper between body and wheel is a compromise: a soft one lets the wheel lose its grip, a stiff
# one shakes the passengers. How much better are an actuator with a skyhook law, one with an optimal
# law, and a damper whose valve follows that law but can only take energy out?
#
# On a road of class B at 72 km/h the velocity of the road is white noise of the intensity
# $W = 2\pi^2 n_0^2\,G_d(n_0)\,V$. The optimal linear law, the linear-quadratic regulator (LQR), has
# the least mean of
#
# $$ \ddot x_b^2 + q_1 (x_b - x_w)^2 + q_2 (x_w - x_r)^2 + r u^2. $$

# %%
import diffrax
import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
mb, mw, ks, bs, kt = 300.0, 60.0, 16e3, 1e3, 190e3
speed, class_b = 20.0, jb.vibration.RoadRoughness.iso("B")
W = 2 * np.pi**2 * 0.1**2 * float(class_b.level) * speed
road = {"road": jb.BaseMotion("road", "z", kind="velocity")}
outputs = {
    "acceleration": jb.Acceleration("body", axis="z"),
    "travel": jb.Elongation("spring"),
    "tyre": jb.Elongation("tyre"),
}
speeds = {f"{name} speed": jb.Velocity(name, axis="z") for name in ("body", "wheel")}
reads = {name: outputs[name] for name in ("travel", "tyre")} | speeds


def quarter_car(drive, damper=bs):
    """A quarter car with a drive between wheel and body, which follows four readings."""
    law = jb.control.state_feedback([[0.0, 0.0, 0.0, 0.0]])
    return jb.Model(
        bodies={
            "body": jb.Body(mass=mb, position=[0, 0, 1.0]),
            "wheel": jb.Body(mass=mw, position=[0, 0, 0.4]),
        },
        supports={"road": jb.Support()},
        joints={"body": jb.Guide("world", axis="z"), "wheel": jb.Guide("world", axis="z")},
        elements={
            "spring": jb.SpringDamper("wheel", "body", spring=ks, damper=damper, free_length=0.6),
            "tyre": jb.Spring("road", "wheel", stiffness=kt, free_length=0.4),
            "drive": drive,
        },
        controllers={"ride": jb.Controller(reads, "drive", law)},
    )


def with_gains(car, G):
    """The car with the law u = -G y of its readings y."""
    return jb.replace(car, {"ride.law.D": -jnp.asarray(G).reshape(1, 4)})


# %% [markdown]
# The rms on the road: body acceleration [m/s²], travel of the suspension [mm], dynamic force of the
# tyre [N], force of the drive [N]. The passive car has other dampings, the skyhook actuator other
# gains on the velocity of the body. Frequencies end at 200 Hz, those of a road with a point each
# 5 cm.

# %%
band, units = jb.vibration.Band(0.01, 200.0, points=201), np.array([1.0, 1e3, kt, 1.0])
seen = outputs | {"force": jb.sensors.DriveForce("drive")}


@jb.jit
def ride(car):
    lin = jb.linearize(car, car.reference)
    return jb.random_response(lin, band, road, seen, {"road": class_b.at_speed(speed)}).rms * units


active = quarter_car(jb.Actuator("wheel", "body"))
dampings = np.geomspace(350.0, 5000.0, 25)


def passive(damping):
    return jb.replace(active, {"spring.damper.coefficient": damping})


by_damping = np.array([ride(passive(c)) for c in dampings])
skyhooks = np.array([0.0, 1000.0, 2000.0, 3000.0, 4000.0])
by_skyhook = np.array([ride(with_gains(active, [0, 0, c, 0])) for c in skyhooks])

# %% [markdown]
# The optimal law feeds back all states. `gains` finds it on named readings, a controller takes it,
# and the cost that the regulator states is that of the car with this controller (it counts all
# frequencies). Other weights of the tyre give a front.

# %%
q1, r, chosen = 1e3, 1e-6, 6e4
lin = jb.linearize(active, active.reference)
undamped = quarter_car(jb.Actuator("wheel", "body"), damper=0.0)
free = jb.linearize(undamped, undamped.reference)


@jb.jit
def optimum(lin, q2):
    """The least cost, and the gains on the readings."""
    regulator = jb.control.lqr(
        lin,
        {"acceleration": 1.0, "travel": q1, "tyre": q2},
        {"u": r},
        inputs={"u": jb.Command("drive")} | road,
        outputs=outputs,
        noise={"road": W},
    )
    return regulator.cost, regulator.gains(lin, reads)


cost, gains = optimum(lin, chosen)
optimal = with_gains(active, gains)
at_best = ride(optimal)
mean = at_best**2 / units**2 @ np.array([1.0, q1, chosen, r])
print("gains:", {name: round(float(g), 1) for name, g in zip(reads, gains[0], strict=True)})
print(f"cost {float(cost):.6f}, that of the car with its controller {float(mean):.6f}")

front = np.array([ride(with_gains(active, optimum(lin, q)[1])) for q in np.geomspace(4e3, 6e5, 15)])

# %% [markdown]
# The actuator of this optimum also does what a spring and a damper do without energy. Which spring,
# damper and gains give the same ride with the least force? The spring has to carry the body, with
# a sag of 0.25 m at 12 kN/m.


# %%
def quantities(car):
    return dict(zip(("acceleration", "travel", "tyre", "force"), ride(car), strict=True))


design = jb.tune(
    optimal,
    quantities,
    free=["spring.spring.coefficient", "spring.damper.coefficient", "ride.law.D"],
    bounds={
        "spring.spring.coefficient": (12e3, 40e3),
        "spring.damper.coefficient": (100.0, 5e3),
    },
    minimize="force",
    limits={
        "acceleration": (None, float(at_best[0])),
        "travel": (None, float(at_best[1])),
        "tyre": (None, float(at_best[2])),
    },
)
print(design)
tuned = ride(design.model)

# %% [markdown]
# A semi-active damper has no actuator. Its valve follows the optimal force where that lies between
# two curves, and is fully soft or hard elsewhere. The curves are those of no make: as in textbooks,
# they bend at 0.2 m/s, and rebound is twice as hard as bump. There is no other damper, so the law
# is the optimum of a car without one. This is not linear: the car drives over 600 m of road, of
# which the first two seconds do not count.


# %%
def curve(slow, fast):
    return jb.laws.TwoSided(
        bump=jb.laws.Digressive(slow=slow, fast=fast, knee=0.2),
        rebound=jb.laws.Digressive(slow=2 * slow, fast=2 * fast, knee=0.2),
    )


valve = jb.forces.ControlledDamper("wheel", "body", soft=curve(300, 200), hard=curve(2500, 700))
semi = quarter_car(valve, damper=0.0)
distances, heights = jb.vibration.road_profile(
    class_b, length=600.0, spacing=0.05, key=jax.random.key(1)
)
under = {"road": jb.inputs.Road(distances, heights - heights[0], speed=speed)}
times = np.arange(0.0, 30.0, 0.01)
# one step for each point of the road
steps = dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=0.05 / speed, max_steps=20_000)


@jb.jit
def drives(car, gains):
    """The rms along the road with each of several gains."""

    def drive(G):
        here = with_gains(car, G)
        run = jb.simulate(here, times, motion=under, initial=here.reference, **steps)
        read = jb.measure(run, seen)
        return jnp.stack([jnp.std(read[name][200:]) for name in seen]) * units

    return jax.vmap(drive)(gains)


weights = [1e4, 3e4, chosen, 1e5, 3e5]
with_damper = jnp.stack([0 * gains, *(optimum(lin, q)[1] for q in weights)])
without = jnp.stack([optimum(free, q)[1] for q in weights])
by_actuator, semi_active = (
    np.asarray(drives(car, G)) for car, G in ((active, with_damper), (semi, without))
)

# %% [markdown]
# Body acceleration against grip: down and to the left both are better.

# %%
figure, ax = plt.subplots(figsize=(8, 5.4), layout="constrained")
ax.plot(by_damping[:, 2], by_damping[:, 0], "0.35", lw=2.5)
ax.plot(front[:, 2], front[:, 0], "C0", lw=2.5)
ax.plot(by_skyhook[:, 2], by_skyhook[:, 0], "C1", marker=".", ms=9, lw=1.5)
ax.plot(semi_active[:, 2], semi_active[:, 0], "C2o--", mfc="white", mew=2, ms=8, lw=1, zorder=6)
ax.plot(at_best[2], at_best[0], "C3*", ms=19, zorder=5)
label = {"fontsize": 11, "va": "center"}
for c, shift in ((500, (0, 0.025)), (1000, (26, 0.018)), (2000, (27, 0.01))):
    y, _, x, _ = ride(passive(float(c)))
    ax.plot(x, y, "o", color="0.35", ms=6)
    ax.text(x + shift[0], y + shift[1], f"{c} N s/m", color="0.35", ha="center", **label)
ax.text(470, 0.9, "passive, by its damping", color="0.35", **label)
ax.text(650, 0.405, "actuator, optimal law (LQR)", color="C0", rotation=-12, ha="center", **label)
ax.text(527, 0.582, "skyhook, to 4000 N s/m", color="C1", **label)
ax.text(638, 0.505, "semi-active damper,\nsimulated", color="C2", **label)
ax.annotate(
    f"one optimum: {at_best[3]:.0f} N of force;\nspring and damper tuned\n"
    f"with its gains: {tuned[3]:.0f} N",
    (at_best[2], at_best[0]),
    (372, 0.47),
    color="C3",
    arrowprops={"arrowstyle": "-", "color": "C3", "shrinkB": 8},
    **label,
)
ax.set(
    xlabel="rms dynamic force of the tyre [N]",
    ylabel="rms acceleration of the body [m/s²]",
    xlim=(360, 740),
    ylim=(0.34, 1.04),
    title="A quarter car on a class B road at 72 km/h",
)
ax.spines[["top", "right"]].set_visible(False)

# %%
rows = {
    "passive, 1000 N s/m": by_skyhook[0],
    "skyhook, 2000 N s/m": by_skyhook[2],
    "LQR": at_best,
    "LQR, all tuned": tuned,
    "passive, simulated": by_actuator[0],
    "LQR, simulated": by_actuator[3],
    "semi-active, simulated": semi_active[2],
}
print(f"{'':24}{'body [m/s2]':>12}{'travel [mm]':>12}{'tyre [N]':>12}{'drive [N]':>12}")
for name, (a, travel, tyre, force) in rows.items():
    print(f"{name:24}{a:12.3f}{travel:12.2f}{tyre:12.1f}{force:12.1f}")


def less(rms):
    """Less acceleration than that of the passive car with the same force of the tyre, a share."""
    rising = by_damping[: np.argmin(by_damping[:, 2]) + 1][::-1]
    return 1 - rms[:, 0] / np.interp(rms[:, 2], rising[:, 2], rising[:, 0])


share = less(semi_active[:4]) / less(by_actuator[1:5])
print("semi-active, of the actuator's gain in comfort:", share.round(2))

# %%
assert abs(mean / cost - 1) < 0.01
np.testing.assert_allclose(by_actuator[[0, 3], :3], [by_skyhook[0, :3], at_best[:3]], rtol=0.03)
np.testing.assert_allclose(tuned[:3], at_best[:3], rtol=1e-3)
assert design.ok and tuned[3] < 0.7 * at_best[3] and np.all((share > 0.6) & (share < 1))

# %% [markdown]
# - **Skyhook**: comfort improves up to the front, at 2000 N s/m by 13 %, grip does not.
# - **LQR**: comfort improves by 7 % and grip by 5 % at once, with less travel; other weights go
#   further in either. The simulated drive shows the same within 2 %.
# - **Tuned together**: the same ride with a third less force. A softer spring and a stiffer damper
#   do what the actuator did.
# - **Semi-active**: the same law through the valve keeps two thirds to four fifths of the gain in
#   comfort at equal grip, without an actuator. The valve here is quick and knows all readings; a
#   `bandwidth` of the damper and an estimator, `jb.control.kalman`, are the next steps.
#
# At $\sqrt{k_t/m_w}$ no force between body and wheel changes the acceleration of the body, nor at
# $\sqrt{k_t/(m_b + m_w)}$ the travel: these are limits of any law. Read on: the page Control of the
# guide; `comfort.py`, the best passive damping; `ride_design.py`, a whole car.
