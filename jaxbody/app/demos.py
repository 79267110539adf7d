"""The command `jaxbody demo`: an engine on its mounts, from its file to tuned mounts."""

import time
import webbrowser
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np

import jaxbody as jb
from jaxbody.core.source_files import writing
from jaxbody.core.tables import PrintedTable, text

ENGINE = Path(__file__).with_name("ready") / "engine.toml"
OF_SENSORS = 0.05  # standard deviation of the simulated accelerometers [m/s2]
LIKELY = 4.0  # largest accepted error of an estimate, in standard errors
START = time.perf_counter()


def run(out: Path, seed: int, show: bool) -> int:
    """Run the demo of the engine and write its report to the folder `out`; `seed`: seed of the
    measurement noise; `show`: open the report in the browser. Return 0 if fit and design succeed
    and the fit agrees with the true parameters, else 1. Error: NOT_SAVED, before anything is
    computed."""
    import jax

    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=out).close()  # whether it can be written to
    report(
        f"An engine on two mounts and a strut: `jaxbody new engine`, read from {ENGINE.name} ..."
    )
    study = jb.read_study(ENGINE)
    engine = study.model

    def tell(*results: Any) -> None:
        print(*(result.summary(units=study.printed_units) for result in results), sep="\n\n")

    tell(engine)
    report("Equilibrium under the weight, where jax.grad of the potential energy V is zero ...")
    eq = jb.equilibrium(engine)
    tell(eq)
    report("Natural modes, by M, C and K: jax.hessian of T, R and V in closed form ...")
    lin = jb.linearize(engine, eq)
    modes, energies = jb.modes(lin), jb.vibration.mode_energies(lin)
    tell(modes, energies)
    report(
        "Transmissibility from the frame to the engine; the frame acts through the mixed second "
        "derivative of V ..."
    )
    response = jb.frequency_response(
        lin,
        np.geomspace(1, 50, 300),
        {"frame z": jb.BaseMotion("frame", "z")},
        {"engine z": jb.Position("engine", axis="z")},
    )
    tell(response)
    report("A shaker test of 0.5 s, simulated by diffrax: the frame moves along x, y and z ...")
    times = np.linspace(0.0, 0.5, 126)
    shaker = jb.Harmonic(frequency=[7.0, 6.0, 11.0, 1.0, 1.0, 1.0], translation=[5e-4, 5e-4, 5e-4])
    trajectory = jb.simulate(engine, times, motion={"frame": shaker}, initial=eq.state)
    tell(trajectory)
    report(
        f"Fitting mass and strut, 30 % off at first, to its accelerations with {OF_SENSORS:g} m/s2 "
        "of noise: least squares, with jax.jvp through the integration ..."
    )
    sensors: dict[str, Any] = {
        axis: jb.Acceleration("engine", [0.2, 0.1, 0], axis=axis) for axis in "xyz"
    }
    experiment = jb.Experiment(
        times,
        motion={"frame": shaker},
        initial=eq.state,
        sensors=sensors,
        measured=jb.measure(trajectory, sensors, noise=OF_SENSORS, key=jax.random.key(seed)),
    )
    free = "engine.mass", "strut.spring.terms.0.coefficient"
    truth = {path: jb.parameter_paths(engine, path)[path] for path in free}
    guess = jb.replace(engine, {path: 1.3 * x for path, x in truth.items()})
    fit = jb.fit(guess, {"shaker test": experiment}, free=free, rtol=1e-6)
    tell(fit)
    agree = compare(fit, truth)
    report(
        "Tuning mounts and strut of the fitted engine for uncoupled modes, with jax.jvp through "
        "equilibrium and modes ..."
    )
    tuning = jb.tune(fit.model, **study.designs["decoupled"])
    tell(tuning)
    report("Writing the report ...")
    page = jb.report(
        {
            "Model": engine,
            "Equilibrium": eq,
            "Modes": modes,
            "Energies of modes": energies,
            "Transmissibility": response,
            "Fit": fit,
            "Tuned mounts": tuning,
        },
        out / "engine.html",
        title="An engine on its mounts",
        files=[ENGINE],
        command="jaxbody demo",
        units=study.printed_units,
    )
    report(f"Report: {page}")
    if show:
        webbrowser.open(page.resolve().as_uri())
    return 0 if agree and tuning.ok else 1


def report(step: str) -> None:
    """Print a line with the seconds since the start."""
    print(f"\n[{time.perf_counter() - START:4.1f} s] {step}", flush=True)


def compare(fit: Any, truth: dict[str, Any]) -> bool:
    """Print true values, estimates and standard errors in SI. Return True if the fit succeeded and
    all errors are within LIKELY standard errors."""
    true, estimate, error = (
        np.array([float(values[path]) for path in truth])
        for values in (truth, fit.estimates, fit.standard_errors)
    )
    ratio = abs(estimate - true) / error
    rows = list(zip(truth, 1.3 * true, true, estimate, error, ratio.round(1), strict=True))
    columns = "parameter", "start", "truth", "estimate", "standard error", "error / standard error"
    print(text(PrintedTable("", columns, rows)), flush=True)
    return bool(fit.ok) and bool((ratio <= LIKELY).all())
