"""The gallery: every kind of plot, drawn from a few models.

`python examples/gallery.py FOLDER` saves the pictures, `python examples/gallery.py FOLDER phases
poles` some of them; without a folder they are only drawn.
"""

import io
import os
import sys
import warnings
from functools import cache
from pathlib import Path

# each program runs once: it should compile fast
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")

import jax
import jax.numpy as jnp
import matplotlib
import numpy as np
from PIL import Image

matplotlib.use("Agg")
import matplotlib.pyplot as plt

import jaxbody as jb
from jaxbody import plots

jax.config.update("jax_enable_x64", True)
WHEELS = ("fl", "fr", "rl", "rr")
noise = np.random.default_rng(24)


# What the pictures show: each model and each result is made once


@cache
def car():
    return jb.presets.full_car()


@cache
def small_motions():
    return jb.linearize(car(), car().reference)


@cache
def ports():
    roads = {f"road {wheel}": jb.BaseMotion(f"road {wheel}", "z") for wheel in WHEELS}
    outputs = {name: jb.Position(name, axis="z") for name in ("car", "fl", "rl")}
    return roads, outputs | {
        "tyre fl": jb.sensors.LoadCell("tyre fl"),
        "tyre rl": jb.sensors.LoadCell("tyre rl"),
    }


@cache
def response():
    roads, outputs = ports()
    front = {name: roads[name] for name in ("road fl", "road fr")}
    return jb.frequency_response(small_motions(), jnp.geomspace(0.3, 30, 300), front, outputs)


@cache
def quarter():
    return jb.presets.quarter_car(damping=1500.0)


@cache
def shaken():
    """A quarter car on a sine of 1.2 Hz, from rest."""
    motion = {"road": jb.Harmonic(frequency=1.2, translation=[0, 0, 0.02])}
    return jb.simulate(quarter(), jnp.linspace(0, 5, 1001), motion=motion)


@cache
def driven():
    """A car over a bump, its rear wheels later than its front wheels."""
    t = jnp.linspace(0, 2, 401)
    bump = {
        axle: 0.05 * jnp.exp(-(((t - start) / 0.04) ** 2))
        for axle, start in (("f", 0.3), ("r", 0.43))
    }
    motion = {
        f"road {w}": jb.Sampled(
            t,
            translation=jnp.outer(
                bump[w[0]] * (1.0 if w[1] == "l" else 0.6), jnp.array([0, 0, 1.0])
            ),
        )
        for w in WHEELS
    }
    return jb.simulate(car(), t, motion=motion)


@cache
def engine():
    return jb.presets.engine_on_mounts(gravity=9.81)


@cache
def engine_small():
    return jb.linearize(engine(), jb.equilibrium(engine()))


@cache
def pendulum():
    """A pendulum with a damper in its hinge, which starts with a full turn."""
    bob = jb.Body(mass=1.0, inertia=[1e-3, 1e-3, 1e-3], com=[0, 0, -0.5])
    hinge, damper = (
        jb.Hinge("world", axis=[0, 1, 0]),
        jb.Torsion("bob", "world", axis=[0, 1, 0], damper=0.12),
    )
    model = jb.Model(
        bodies={"bob": bob},
        joints={"bob": hinge},
        elements={"friction": damper},
        gravity=[0, 0, -9.81],
    )
    return jb.simulate(
        model, jnp.linspace(0, 8, 801), initial=jb.State(jnp.array([-3.1]), jnp.array([4.0]))
    )


@cache
def track():
    """A measured oscillation of a mass on a spring, with noise."""
    spring = jb.Spring(
        ("mass", [0, 0, 0]), ("world", [-2, 0, 0]), stiffness=30.0, free_length=2.0, damping=0.5
    )
    body, joint = (
        jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0]),
        jb.Guide("world", axis=[1, 0, 0]),
    )
    model = jb.Model(bodies={"mass": body}, joints={"mass": joint}, elements={"spring": spring})
    times = jnp.linspace(0, 3, 121)
    true = jb.simulate(jb.replace(model, {"spring.stiffness": 38.0, "spring.damping": 0.8}), times)
    sensors = {"x": jb.Position("mass", axis=[1, 0, 0]), "tension": jb.sensors.LoadCell("spring")}
    measured = jb.measure(true, sensors, noise={"x": 0.02, "tension": 0.8}, key=jax.random.key(1))
    return model, jb.Experiment(times, sensors=sensors, measured=measured)


@cache
def fitted():
    model, run = track()
    return jb.fit(model, {"track": run}, free=["spring.stiffness", "spring.damping"])


def ride(model):
    """Comfort, travel and grip of a quarter car in the damping of its suspension."""
    c = model["suspension"].damping / 1500.0
    k = model["suspension"].stiffness / 35000.0
    return {"shake": c + k / c, "travel": 1 / (c * k), "sag": 0.105 / k}


FREE, BOUNDS = (
    ["suspension.damping", "suspension.stiffness"],
    {"*.damping": (500.0, 5000.0), "*.stiffness": (2e4, 6e4)},
)


def recorded():
    t = np.arange(400) / 200
    acceleration = 0.4 * np.sin(2 * np.pi * 3 * t)[:, None] * [0.2, 0, 1.0] + 0.02 * noise.normal(
        size=(400, 3)
    )
    stroke = 6 * np.cos(2 * np.pi * 3 * t)
    stroke[120:130] = np.nan
    return jb.Record(t, {"seat": (acceleration, "g"), "stroke": (stroke, "mm")}, max_gap=20)


def shaker():
    """The motion of a shaker from its acceleration."""
    t = np.arange(1000) / 100
    record = jb.Record(
        t, {"acc": (0.3 - 2 * np.cos(2 * np.pi * t) + 0.02 * noise.normal(size=1000), "m/s2")}
    )
    return jb.inputs.base_motion(record, "acc", axis=[1, 0, 0], degree=1)


def hammered():
    """A measured frequency response of a plate."""
    f = np.linspace(0.2, 2.0, 60)
    model = jb.replace(track()[0], {"spring.damping": 0.3})
    ports = {"f": jb.PointForce("mass", direction="x")}, {"x": jb.Position("mass", axis="x")}
    exact = np.asarray(
        jb.frequency_response(jb.linearize(model, jb.equilibrium(model)), f, *ports)["x", "f"]
    )
    rough = exact * (1 + 0.05 * noise.normal(size=60) + 0.05j * noise.normal(size=60))
    return jb.MeasuredResponse(f, inputs=ports[0], outputs=ports[1], measured={("x", "f"): rough})


@cache
def tested():
    """Responses estimated from a test with two shakers of an engine on mounts with little damping,
    stiffer than those of its model."""
    dry = {f"{name}.damping": 0.2 * engine()[name].damping for name in engine().element_names}
    stiff = {"mount 1.stiffness": [3e5, 2e5, 9e5]}
    lin = jb.linearize(jb.replace(engine(), dry | stiff), engine().reference)
    points = {"front": [1.35, 0.2, 0.45], "rear": [0.7, -0.2, 0.65]}
    ports = (
        {
            "shaker 1": jb.PointForce("engine", points["front"], direction=[1, 2, 3]),
            "shaker 2": jb.PointForce("engine", points["rear"], direction=[1, -1, 1]),
        },
        {
            f"{name} {axis}": jb.Acceleration("engine", at, axis=axis)
            for name, at in points.items()
            for axis in "xyz"
        },
    )
    own, rate, n = np.random.default_rng(5), 96.0, 2**15
    forces = own.normal(size=(2, n))
    f = np.arange(1, n // 2 + 1) * rate / n
    H = np.asarray(jb.frequency_response(lin, f, *ports).values)
    spectra = np.einsum("yuf,uf->yf", H, np.fft.rfft(forces)[:, 1:])
    y = np.fft.irfft(np.pad(spectra, ((0, 0), (1, 0))), n)
    y = y + 0.03 * y.std(1, keepdims=True) * own.normal(size=y.shape)
    channels = dict(zip(ports[0], [(x, "N") for x in forces], strict=True))
    channels |= dict(zip(ports[1], [(x, "m/s2") for x in y], strict=True))
    record = jb.Record(None, channels, rate=rate)
    return jb.modal.estimate_responses(
        record, inputs=ports[0], outputs=ports[1], segment=8.0, band=(5.0, 35.0)
    )


@cache
def identified():
    return jb.modal.identify_modes(tested())


def on_the_model():
    """Elastic axes on the drawing of an engine."""
    ax = engine().plot(view="xz")
    return jb.vibration.elastic_axes(engine_small(), "engine").plot(view="xz", ax=ax)


def roll_axis():
    return jb.vibration.torque_roll_axis(engine_small(), "engine", [1.0, 0, 0]).plot(
        view="xz", ax=engine().plot(view="xz")
    )


def balanced():
    """The preload of a car whose springs are softer than those that its height was set with."""
    return jb.preload(
        jb.replace(car(), {"spring f?.stiffness": 18000.0}), free=["spring*.free_length"]
    )


def stiffnesses():
    outputs = {"force": jb.sensors.LoadCell("suspension"), "stroke": jb.Elongation("suspension")}
    outputs |= {"tyre force": jb.sensors.LoadCell("tyre"), "tyre stroke": jb.Elongation("tyre")}
    lin = jb.linearize(quarter(), quarter().reference)
    response = jb.frequency_response(
        lin, jnp.geomspace(0.2, 50, 200), {"road": jb.BaseMotion("road", "z")}, outputs
    )
    return plots.plot_dynamic_stiffness(
        response, pairs={"suspension": ("force", "stroke"), "tyre": ("tyre force", "tyre stroke")}
    )


def states():
    roads, outputs = (
        {"road": jb.BaseMotion("road", "z")},
        {"stroke": jb.Elongation("suspension"), "tyre": jb.sensors.LoadCell("tyre")},
    )
    return jb.linearize(quarter(), quarter().reference).state_space(roads, outputs)


def cases():
    loads = {"bump": [0, 0, 3], "brake": [-1, 0, 0], "left turn": [0, 1, 0], "start": [0.6, 0, 0]}
    return jb.load_cases(engine(), {name: jb.LoadCase(acceleration=a) for name, a in loads.items()})


def branches():
    stiffness = jnp.linspace(1.5e4, 4e4, 26)
    half = jb.presets.half_car()
    return jb.vibration.track_modes(
        lambda k: jb.linearize(jb.replace(half, {"front spring.stiffness": k}), half.reference),
        stiffness,
    )


def truss():
    """A shallow truss that snaps through under a load beyond what it can carry."""
    rods = {
        name: jb.Spring(
            ("tip", [0, 0, 0]),
            ("world", [x, 0, 0]),
            stiffness=1e5,
            free_length=float(np.hypot(1, 0.2)),
        )
        for name, x in (("left", -1), ("right", 1))
    }
    model = jb.Model(
        bodies={"tip": jb.Body(1.0, [1, 1, 1], position=[0, 0, 0.2])},
        joints={"tip": jb.Guide("world", axis=[0, 0, 1])},
        elements=rods,
    )
    return model


def snapped():
    with warnings.catch_warnings():
        # of the limit point, which the picture shows
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        return jb.equilibrium(truss(), loads={"weight": jb.Force("tip", force=[0, 0, -2000.0])})


def random_ride():
    roads, _ = ports()
    outputs = {
        "car": jb.Acceleration("car", axis="z"),
        "wheel fl": jb.Acceleration("fl", axis="z"),
        "stroke fl": jb.Elongation("spring fl"),
    }
    road = jb.vibration.RoadRoughness.iso("C").at_speed(20.0)
    return jb.random_response(
        small_motions(), jb.vibration.Band(0.5, 25.0), roads, outputs, dict.fromkeys(roads, road)
    )


def shaken_engine():
    """Anchor forces of an engine in an earthquake along and across."""
    mounts = {name: jb.sensors.LoadCell(name, component=2) for name in engine().element_names}
    spectra = {
        "x": jb.shock.Eurocode8(2.0, "B"),
        "y": jb.shock.Eurocode8(2.0, "B"),
        "z": jb.shock.Eurocode8(2.0, vertical=True),
    }
    return jb.shock.spectrum_response(
        engine_small(), {"frame": spectra}, mounts, modal_damping=0.05
    )


def worn():
    """Springs of a car on a rough road for an hour."""
    roads, _ = ports()
    springs = {f"spring {wheel}": jb.sensors.LoadCell(f"spring {wheel}") for wheel in WHEELS}
    ride = jb.random_response(
        small_motions(),
        jb.vibration.Band(0.5, 25.0),
        roads,
        springs,
        dict.fromkeys(roads, jb.vibration.RoadRoughness.iso("D").at_speed(20.0)),
    )
    curve = jb.shock.SNCurve(5.0, cycles=1e6, level=6.0, unit="kN")
    return jb.shock.fatigue_damage(ride, dict.fromkeys(springs, curve), duration=3600.0)


def weighted():
    t = np.arange(4000) / 200
    return jb.vibration.weighted_signal(
        t, np.sin(2 * np.pi * 5 * t) * (1 + 0.5 * np.sin(0.7 * t)), "Wk"
    )


def bands():
    f = jnp.geomspace(0.3, 3.0, 120)

    def receptance(model):
        k, c = model["spring"].stiffness, model["spring"].damping
        w = 2 * jnp.pi * f
        return 1 / jnp.sqrt((k - w**2) ** 2 + (c * w) ** 2)

    return plots.plot_confidence_bands(
        jb.confidence_bands(fitted(), receptance),
        f,
        xlabel="frequency [Hz]",
        ylabel="receptance [m/N]",
    )


def validation():
    return jb.validate(fitted(), {"track": track()[1]})


def diagnosis():
    return jb.diagnose(fitted().model, {"track": track()[1]})


def multistart():
    """A long record of an oscillation: costs of wrong frequencies have minima of their own."""
    model, times = jb.replace(track()[0], {"spring.damping": 0.2}), jnp.linspace(0, 6, 121)
    sensors = {"x": jb.Position("mass", axis=[1, 0, 0])}
    measured = jb.measure(
        jb.simulate(jb.replace(model, {"spring.stiffness": 40.0}), times),
        sensors,
        noise=0.05,
        key=jax.random.key(2),
    )
    run = jb.Experiment(times, sensors=sensors, measured=measured)
    return jb.fitting.multistart(
        model, {"run": run}, free="spring.stiffness", starts=12, spread=0.5
    )


def choice():
    """Of accelerometers all over a car on a rig, those that tell most of a spring, a damper and
    the mass."""
    places = [(x, y) for x in (-1.8, -0.9, 0.0, 0.9, 1.8) for y in (-0.8, 0.0, 0.8)]
    rig = jb.MeasuredResponse(
        np.geomspace(0.7, 15.0, 12),
        inputs={"road": jb.BaseMotion("road fl", "z")},
        outputs={
            f"{x:g} m, {y:g} m": jb.Acceleration("car", [x, y, 0.0], axis="z") for x, y in places
        },
        noise=1.0,
    )
    free = ["spring fl.stiffness", "spring rr.stiffness", "spring fl.damping", "car.mass"]
    return jb.choose(
        jb.expected_fit(car(), {"rig": rig}, free=free), n=4, criterion="largest interval"
    )


def modes_of_car():
    return jb.modes(small_motions())


PICTURES = {
    "model": lambda: car().plot(),
    "equilibrium": lambda: jb.equilibrium(engine()).plot(),
    "equilibria": lambda: jb.find_equilibria(jb.presets.double_pendulum(), starts=32).plot(),
    "load_path": lambda: plots.plot_load_path(snapped()),
    "load_cases": lambda: cases().plot(),
    "load_cases_bodies": lambda: cases().plot(of="bodies"),
    "preload": lambda: balanced().plot(),
    "trajectory": lambda: driven().plot(),
    "forces": lambda: plots.plot_forces(driven()),
    "energies": lambda: plots.plot_energies(shaken()),
    "phases": lambda: plots.plot_phases(pendulum()),
    "force_strokes": lambda: plots.plot_force_strokes(shaken(), start=3.0),
    "matrix": lambda: small_motions().plot(),
    "modes": lambda: modes_of_car().plot(),
    "mode": lambda: plots.draw_mode(small_motions(), modes_of_car(), 2),
    "poles": lambda: jb.complex_modes(small_motions()).plot(),
    "mode_energies": lambda: jb.vibration.mode_energies(small_motions(), forward="x").plot(),
    "branches": lambda: branches().plot(parameter="front stiffness [N/m]"),
    "backbones": lambda: jb.vibration.backbone_curves(
        jb.linearize(jb.presets.double_pendulum(), jb.presets.double_pendulum().reference)
    ).plot(),
    "elastic_axes": on_the_model,
    "torque_roll_axis": roll_axis,
    "frequency_response": lambda: response().plot(),
    "transmissibility": lambda: plots.plot_transmissibility(response()),
    "dynamic_stiffness": stiffnesses,
    "state_space": lambda: states().plot(),
    "random_response": lambda: random_ride().plot(),
    "suspension_curves": lambda: (
        jb.suspension.double_wishbone().curves(np.linspace(-0.08, 0.08, 17)).plot()
    ),
    "shock_spectrum": lambda: jb.shock.shock_spectrum(
        jb.inputs.HalfSine(15 * 9.81, 0.011), jnp.geomspace(5, 500, 120), damping=[0.01, 0.05, 0.2]
    ).plot(),
    "design_spectrum": lambda: jb.shock.Eurocode8(2.0, "B").plot(damping=(0.02, 0.05, 0.2)),
    "spectrum_response": lambda: shaken_engine().plot(),
    "matched_record": lambda: jb.shock.spectrum_compatible_record(
        jb.shock.Eurocode8(2.0, "B"),
        duration=12.0,
        key=jax.random.key(0),
        frequencies=np.geomspace(0.5, 12.0, 30),
    ).plot(),
    "peak_factors": lambda: jb.shock.peak_factor(random_ride(), 60.0).plot(),
    "fatigue_damage": lambda: worn().plot(),
    "weighted_signal": lambda: weighted().plot(),
    "record": lambda: recorded().plot(),
    "recovered": lambda: shaker().plot(),
    "experiment": lambda: track()[1].plot(),
    "measured_response": lambda: hammered().plot(),
    "estimated_response": lambda: tested().plot(),
    "identified_modes": lambda: identified().plot(),
    "modal_assurance": lambda: identified().plot(model=engine()),
    "measured_modes": lambda: jb.MeasuredModes(
        frequency=[1.02, 1.36, 9.8], damping_ratio=[0.02, 0.05, 0.1]
    ).plot(),
    "diagnosis": lambda: diagnosis().plot(),
    "fit": lambda: fitted().plot(),
    "history": lambda: plots.plot_history(fitted()),
    "correlations": lambda: plots.plot_correlations(fitted()),
    "autocorrelation": lambda: plots.plot_autocorrelation(fitted()),
    "bands": bands,
    "validation": lambda: validation().plot(),
    "multistart": lambda: multistart().plot(),
    "profile": lambda: jb.fitting.profile_likelihood(fitted(), "spring.damping").plot(),
    "choice": lambda: choice().plot(),
    "tuning": lambda: jb.tune(
        quarter(),
        ride,
        minimize="shake",
        free=FREE,
        limits={"travel": (None, 1.0), "sag": (None, 0.12)},
        bounds=BOUNDS,
    ).plot(),
    "front": lambda: jb.pareto(
        quarter(),
        ride,
        minimize=["shake", "travel"],
        free=FREE,
        bounds=BOUNDS,
        limits={"sag": (None, 0.1)},
        points=6,
    ).plot(),
    "sensitivities": lambda: jb.design.sensitivities(
        car(),
        lambda m: {"first frequency": jb.modes(jb.linearize(m, m.reference)).frequency[0]},
        free=["*.stiffness", "car.mass"],
    ).plot(),
    "tolerances": lambda: jb.tolerances(
        quarter(), ride, {"suspension.stiffness": 2500.0, "suspension.damping": 150.0}
    ).plot(),
}


def save(ax, path):
    """At a size for a page; a palette of 64 colors keeps the file small."""
    data = io.BytesIO()
    ax.figure.savefig(data, dpi=100)
    plt.close(ax.figure)
    Image.open(data).convert("RGB").quantize(
        64, method=Image.Quantize.MAXCOVERAGE, dither=Image.Dither.NONE
    ).save(path, optimize=True)


if __name__ == "__main__":
    folder, *chosen = sys.argv[1:] or [None]
    for name in chosen or PICTURES:
        ax = PICTURES[name]()
        if folder is None:
            plt.close(ax.figure)
        else:
            Path(folder).mkdir(parents=True, exist_ok=True)
            save(ax, Path(folder, f"{name}.png"))
