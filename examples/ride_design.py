"""A car suspension tuned for ride comfort: twelve parameters of springs, dampers, tyres and
anti-roll bars on a class C road.

The worst weighted vibration of the driver, at two speeds and with one or four persons aboard, is
minimized within the available strokes and with all tyres on the road. The same search with finite
differences follows. `python examples/ride_design.py ride.png` saves the figure.
"""

import sys
import time
from fnmatch import fnmatch

import jax
import jax.numpy as jnp
import matplotlib.pyplot as plt
import numpy as np
import scipy.optimize

import jaxbody as jb
from jaxbody import plots
from jaxbody.views.plots.canvases import COLORS

jax.config.update("jax_enable_x64", True)
car = jb.presets.full_car()
wheels = ("fl", "fr", "rl", "rr")
road, band = jb.vibration.RoadRoughness.iso("C"), jb.vibration.Band(0.2, 40.0, points=201)
speeds = jnp.array([15.0, 30.0])
loads = {  # the driver alone; four persons and luggage behind the center
    "car.mass": jnp.array([1175.0, 1480.0]),
    "car.com": jnp.array([[0.0, 0.02, 0.0], [-0.15, 0.0, 0.05]]),
    "car.inertia": jnp.stack(
        [jnp.diag(jnp.array([465.0, 1530.0, 1750.0])), jnp.diag(jnp.array([540.0, 1900.0, 2150.0]))]
    ),
}
at_wheels = {wheel: jb.BaseMotion(f"road {wheel}", "z") for wheel in wheels}
driver = {f"seat {axis}": jb.Acceleration("car", [0.2, 0.35, 0.3], axis=axis) for axis in "xyz"}
travel = {f"travel {wheel}": jb.Elongation(f"spring {wheel}") for wheel in wheels}
tyres = {f"tyre {wheel}": jb.sensors.LoadCell(f"tyre {wheel}") for wheel in wheels}
weights = {"seat x": "Wd", "seat y": "Wd", "seat z": "Wk"}
tracks = {
    (a, b): (1.0 if a[1] == b[1] else 0.5) for i, a in enumerate(wheels) for b in wheels[i + 1 :]
}  # the rear wheels follow the front wheels; left and right are partly correlated


def rides(model):
    """For each load and speed: weighted vibration of the driver [m/s2], strokes of the wheels [m],
    and shares of the tyre loads that may be lost.

    The strokes are measured from the equilibrium with the driver alone."""

    def loaded(values):
        aboard = jb.replace(model, values)
        eq = jb.equilibrium(aboard)
        lin = jb.linearize(aboard, eq)
        elongations = jnp.stack([eq.elongations[f"spring {wheel}"] for wheel in wheels])
        static = {
            f"tyre {wheel}": -aboard[f"tyre {wheel}"].stiffness * eq.elongations[f"tyre {wheel}"]
            for wheel in wheels
        }

        def driven(speed):
            delays = {wheel: 2.6 / speed for wheel in ("rl", "rr")}
            felt = jb.vibration.CrossPSD(
                dict.fromkeys(wheels, road.at_speed(speed)), delays=delays, coherence=tracks
            )
            ride = jb.random_response(lin, band, at_wheels, driver | travel | tyres, felt)
            strokes = jnp.stack([jb.objectives.stroke(ride, name) for name in travel])
            unloading = jnp.stack(
                [
                    3 * jb.objectives.road_holding(ride, {name: load})
                    for name, load in static.items()
                ]
            )
            return jb.objectives.comfort(ride, weights), strokes, unloading

        return elongations, *jax.vmap(driven)(speeds)

    elongations, felt, strokes, unloading = jax.vmap(loaded)(loads)
    static = jnp.abs(elongations - elongations[:1])[:, None]
    return {"felt": felt, "stroke": static + strokes, "tyre": unloading}


# over loads and speeds, for each wheel
worst = jax.vmap(lambda cases, width: jb.objectives.smooth_max(cases, width), (1, None))


def evaluate(model):
    ride = rides(model)
    return {
        "worst": jb.objectives.smooth_max(ride["felt"].ravel(), 0.01),
        "felt": ride["felt"],
        "stroke": worst(ride["stroke"].reshape(4, 4), 2e-4),
        "longest": jb.objectives.smooth_max(ride["stroke"].ravel(), 2e-3),
        "tyre": worst(ride["tyre"].reshape(4, 4), 2e-3),
    }


free = [*(f"spring {wheel}.{what}" for what in ("stiffness", "damping") for wheel in wheels)]
free += [
    "tyre fl.stiffness = tyre fr.stiffness",
    "tyre rl.stiffness = tyre rr.stiffness",
    "bar front.spring.coefficient",
    "bar rear.spring.coefficient",
]
bounds = {
    "spring *.stiffness": (14e3, 45e3),
    "spring *.damping": (500.0, 4000.0),
    "tyre *.stiffness": (160e3, 220e3),
    "bar *.coefficient": (0.0, 30e3),
}
limits = {"stroke": (None, 0.075), "tyre": (None, 0.75)}

begin = time.perf_counter()
design = jb.tune(car, evaluate, free=free, bounds=bounds, minimize="worst", limits=limits)
first = time.perf_counter() - begin
begin = time.perf_counter()
jb.tune(car, evaluate, free=free, bounds=bounds, minimize="worst", limits=limits)
exact = time.perf_counter() - begin
print(design)

# The same optimizer and the same function, with derivatives by finite differences

start = jnp.array([jb.parameter_paths(car)[path] for path in design.values])
ends = np.array(
    [
        next(ends for pattern, ends in bounds.items() if fnmatch(path, pattern))
        for path in design.values
    ]
)
factors = ends[:, 0] > 0  # parameters that vary by factors
size = np.where(factors, 1.0, np.diff(ends)[:, 0] / 2)
scaled = np.where(
    factors[:, None],
    np.log(np.maximum(ends, 1.0) / start[:, None]),
    (ends - start[:, None]) / size[:, None],
)
names = {
    path: [path, path.replace("l.", "r.")] if path.startswith("tyre") else [path]
    for path in design.values
}


@jax.jit
def numbers(u):
    x = jnp.where(factors, start * jnp.exp(u), start + size * u)
    values = evaluate(
        jb.replace(car, {path: x[i] for i, paths in enumerate(names.values()) for path in paths})
    )
    limited = jnp.concatenate([1 - values["stroke"] / 0.075, 1 - values["tyre"] / 0.75])
    return values["worst"] / design.before["worst"], limited


begin = time.perf_counter()
numbers(jnp.zeros(12))
compiling = time.perf_counter() - begin
calls = []


def objective(u):
    calls.append(1)
    return float(numbers(u)[0])


begin = time.perf_counter()
margins = [dict(type="ineq", fun=lambda u: np.asarray(numbers(u)[1]))]
rough = scipy.optimize.minimize(
    objective,
    np.zeros(12),
    bounds=scaled,
    constraints=margins,
    method="SLSQP",
    options=dict(ftol=1e-10, maxiter=200),
)
differences = time.perf_counter() - begin
least = float(design.after["worst"])
print(
    f"exact derivatives: {least:.5f} m/s2 in {exact:.2f} s, {design.evaluations} evaluations; "
    f"{first:.1f} s with compilation"
)
print(
    f"differences:       {rough.fun * design.before['worst']:.5f} m/s2 in {differences:.2f} s, "
    f"{len(calls)} evaluations of the objective;",
    f"{compiling + differences:.1f} s with compilation",
)
assert design.ok and abs(rough.fun * design.before["worst"] / least - 1) < 1e-4

# The trade-off between comfort and stroke, and the parameter with the largest influence

front = jb.pareto(
    car,
    evaluate,
    minimize=["worst", "longest"],
    free=free,
    bounds=bounds,
    limits={"tyre": (None, 0.75)},
    points=9,
)
print(front)
# a bar that tuning removed has no ten percent more
present = [path for path in free if design.values[path.partition(" = ")[0]] > 0]
strongest = jb.design.sensitivities(design.model, evaluate, free=present, change=0.1)
print("largest influence on it:", ", ".join(strongest.ranked("worst")[:3]))

figure, axes = plt.subplot_mosaic(
    [["felt", "front"], ["stroke", "tornado"], ["search", "search"]],
    figsize=(12, 10),
    layout="constrained",
)
cases = [
    f"{who}\n{3.6 * speed:.0f} km/h"
    for who in ("alone", "four aboard")
    for speed in np.asarray(speeds)
]
for i, (when, quantities) in enumerate({"before": design.before, "tuned": design.after}.items()):
    axes["felt"].bar(
        np.arange(4) + 0.4 * i - 0.2,
        np.ravel(quantities["felt"]),
        0.38,
        color=COLORS[i],
        label=when,
    )
    shares = np.concatenate(
        [np.asarray(quantities["stroke"]) / 0.075, np.asarray(quantities["tyre"]) / 0.75]
    )
    axes["stroke"].bar(np.arange(8) + 0.4 * i - 0.2, shares, 0.38, color=COLORS[i], label=when)
axes["felt"].set_xticks(range(4), cases, fontsize=8)
axes["felt"].set(ylabel="weighted acceleration [m/s2]", title="Vibration at the driver's seat")
axes["stroke"].axhline(1.0, color="black", lw=0.8)
axes["stroke"].set_xticks(
    range(8), [f"{what}\n{wheel}" for what in ("stroke", "tyre") for wheel in wheels], fontsize=8
)
axes["stroke"].set(
    ylabel="share of the limit",
    ylim=(0, 1.6),
    title="Limits: stroke 75 mm, at least a quarter of each tyre load",
)
plots.plot_front(front, ax=axes["front"]).set(
    xlabel="longest stroke [m]",
    ylabel="worst vibration [m/s2]",
    title="Trade-off between comfort and stroke",
)
axes["front"].plot(
    float(design.after["longest"]),
    float(design.after["worst"]),
    "*",
    ms=13,
    color=COLORS[1],
    label="the design",
)
plots.plot_tornado(strongest, "worst", ax=axes["tornado"]).set(
    xlabel="worst vibration [m/s2]", title="Largest influences on it"
)
plots.plot_tuning(design, ax=axes["search"]).set(
    ylabel="worst vibration [m/s2]", title=f"The search, {design.evaluations} evaluations"
)
for name in ("felt", "stroke", "front"):
    axes[name].legend(frameon=False, fontsize=8, loc="upper right")
if len(sys.argv) == 2 and sys.argv[1].endswith(".png"):
    figure.savefig(sys.argv[1], dpi=110)
else:
    plt.show()
