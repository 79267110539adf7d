"""The command `jaxbody demo`: an engine on its mounts, from its file to tuned mounts; with --paper,
the plate of Stanescu and Mihalcea (2011), from its drawing to fitted stiffnesses."""

import time
import webbrowser
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from tempfile import TemporaryFile
from typing import Any

import numpy as np

import jaxbody as jb
from jaxbody.core.source_files import writing
from jaxbody.core.tables import PrintedTable, text

ENGINE = Path(__file__).with_name("ready") / "engine.toml"
OF_SENSORS = 0.05  # standard deviation of the simulated accelerometers [m/s2]
NOISE = 2e-3  # standard deviation of the simulated camera [m]
LIKELY = 4.0  # largest accepted error of an estimate, in standard errors
START = time.perf_counter()
# nonzero entries of the paper's (77) in units of k/4: row, column, as printed, function of kt/k, l
PRINTED = (
    (0, 0, "5", lambda r, l: 5.0),
    (0, 5, "-20 l", lambda r, l: -20 * l),
    (1, 1, "5 + 4 kt/k", lambda r, l: 5 + 4 * r),
    (2, 2, "2", lambda r, l: 2.0),
    (2, 3, "14 l", lambda r, l: 14 * l),
    (3, 2, "2 l", lambda r, l: 2 * l),
    (3, 3, "14 l^2", lambda r, l: 14 * l**2),
    (4, 4, "30 l^2", lambda r, l: 30 * l**2),
    (5, 0, "4 l", lambda r, l: 4 * l),
    (5, 5, "32 l^2", lambda r, l: 32 * l**2),
)


def run(out: Path, seed: int, show: bool) -> int:
    """Run the demo of the engine and write its report to the folder `out`; `seed`: seed of the
    measurement noise; `show`: open the report in the browser. Return 0 if fit and design succeed
    and the fit agrees with the true parameters, else 1. Error: NOT_SAVED, before anything is
    computed."""
    import jax

    prepare(out)
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
    modes, energies = jb.modes(lin), jb.mode_energies(lin)
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


def prepare(out: Path) -> None:
    """Create a folder, and test that it can be written to."""
    with writing(out):
        out.mkdir(parents=True, exist_ok=True)
        TemporaryFile(dir=out).close()


def run_paper(out: Path, seed: int) -> int:
    """Run the demo of the plate (model, modes, motion, fit) and write figures to the folder `out`;
    `seed`: seed of the measurement noise. Return 0 if the fit agrees with the true stiffnesses,
    else 1. Error: NOT_SAVED, before anything is computed."""
    import jax
    import optax

    prepare(out)
    l, m, g, kt = 0.7, 3.0, 9.81, 120.0
    k = m * g / l
    report(
        "The plate of N.-D. Stanescu and S. Mihalcea, 13th IFToMM World Congress, "
        "2011, A14_316, section 7:"
    )
    print(
        f"  m = {m} kg, l = {l} m, springs AB and CD above with k = m g/l = {k:.4g} N/m, spring "
        f"EF below with kt = {kt:g} N/m."
    )
    plate = model(l, m, g, k, kt)

    report(
        "Computing K~, the force on the plate per displacement of the base: minus the mixed "
        "second derivative of V, in closed form ..."
    )
    lin = jb.linearize(plate, plate.reference)
    compare_K_tilde(np.asarray(lin.K_tilde), k, kt, l)

    report("Computing the equilibrium, where jax.grad of V is zero ...")
    times = np.linspace(0.0, 5.0, 501)
    motion = {
        "base": jb.Harmonic(frequency=0.8, translation=[0.01, 0.02, 0], rotation=[0, 0, 0.02])
    }
    sensors: dict[str, Any] = {"corner": jb.Position("plate", [3 * l, l, 0])}

    eq = jb.equilibrium(plate)
    print(eq)

    report(
        "Simulating 5 s of the nonlinear motion by diffrax; the base at 0.8 Hz with 10 mm along "
        "x, 20 mm along y, 20 mrad about z ..."
    )
    xi = np.array([0.01, 0, 0, 0, 0, 0.02])
    compare_forces(
        np.asarray(lin.K_tilde) @ xi, np.asarray(jb.excitation(plate, eq, {"base": xi})), k, l
    )
    report("Modes about the equilibrium, by the Hessians of T, R and V:")
    lin = jb.linearize(plate, eq)
    modes = jb.modes(lin)
    print(modes)
    with figure(out / "plate.png", 6.5, 4.6) as (ax,):
        jb.plots.draw_model(plate, ax=ax).set_title(
            "the plate, its springs and the base", fontsize=9
        )
    with figure(out / "modes.png", 11.0, 6.2, 2, 3) as axes:
        for i, ax in enumerate(axes, 1):
            jb.plots.draw_mode(lin, modes, i, ax=ax)
    trajectory = jb.simulate(plate, times, motion=motion, initial=eq.state)
    report("The simulated motion:")
    print(trajectory)

    report(
        f"Measuring the corner C with {1000 * NOISE:g} mm of noise, then fitting the stiffnesses "
        "with optax from a start 30 % too stiff ..."
    )
    with figure(out / "motion.png", 8.0, 7.0, 2, 1, height_ratios=(1.6, 1.0)) as (above, below):
        jb.plots.plot_trajectory(trajectory, ax=above)
        jb.plots.plot_forces(trajectory, ax=below)
    experiment = jb.Experiment(
        times,
        motion=motion,
        initial=eq.state,
        sensors=sensors,
        measured=jb.measure(trajectory, sensors, noise=NOISE, key=jax.random.key(seed)),
    )
    guess = jb.replace(plate, {"*.stiffness": 1.3 * np.array([k, k, kt])})
    fit = jb.fit(guess, {"run1": experiment}, free=["*.stiffness"], method=optax.lbfgs())
    with figure(out / "fit.png", 14.0, 4.4, 1, 3, width_ratios=(1.0, 1.25, 0.65)) as (
        left,
        middle,
        right,
    ):
        jb.plots.draw_model(fit.model, ax=left).set_title(
            "the plate on its vibrating base", fontsize=9
        )
        jb.plots.plot_fit(fit, ax=middle).set_title(
            "motion of its upper right corner, measured and fitted", fontsize=9
        )
        jb.plots.plot_history(fit, ax=right).set_title("cost of the fit", fontsize=9)
    report(f"{int(fit.evaluations)} evaluations, {fit.report()}; in N/m:")
    agree = compare(fit, {"AB.stiffness": k, "CD.stiffness": k, "EF.stiffness": kt})
    names = ("plate", "modes", "motion", "fit")
    report("Figures: " + ", ".join(str(out / f"{name}.png") for name in names))
    report("Done." if agree else "The estimates are too far from the true values.")
    return 0 if agree else 1


def report(step: str) -> None:
    """Print a line with the seconds since the start."""
    print(f"\n[{time.perf_counter() - START:4.1f} s] {step}", flush=True)


def model(l: float, m: float, g: float, k: float, kt: float) -> Any:
    """Return the plate on its lightly damped springs; O at the origin of the world, gravity along
    -y; l [m], m [kg], g [m/s2], k and kt [N/m]."""
    free = 1.5 * 2**0.5 * l  # L - s of AB and CD (67)
    return jb.Model(
        bodies={"plate": jb.Body(mass=m, inertia=[0.3, 0.9, 1.2])},
        supports={"base": jb.Support(position=[0, -4 * l, 0])},
        elements={
            "AB": jb.Spring(
                ("plate", [-3 * l, l, 0]),
                ("base", [-5 * l, 7 * l, 0]),
                stiffness=k,
                free_length=free,
                damping=1.0,
            ),
            "CD": jb.Spring(
                ("plate", [3 * l, l, 0]),
                ("base", [5 * l, 7 * l, 0]),
                stiffness=k,
                free_length=free,
                damping=1.0,
            ),
            "EF": jb.Spring(
                ("plate", [0, -l, 0]),
                ("base", [0, l, 0]),
                stiffness=kt,
                free_length=2 * l,
                damping=1.0,
            ),
        },
        gravity=[0, -g, 0],
    )


def printed_K_tilde(k: float, kt: float, l: float) -> np.ndarray:
    """Return the matrix K~ of (77) in the paper: forces and moments on the plate for displacements
    and rotations of the base [N/m, N, N m]."""
    K = np.zeros((6, 6))
    for i, j, _, entry in PRINTED:
        K[i, j] = k / 4 * entry(kt / k, l)
    return K


def printed_force(k: float, l: float, xi0: float, phi0: float) -> np.ndarray:
    """Return the amplitude of the excitation force by (79) in the paper, for a base that moves by
    xi0 [m] along x and turns by phi0 [rad] about z."""
    return k / 4 * np.array([5 * xi0 - 20 * l * phi0, 0, 0, 0, 0, 4 * l * xi0 + 32 * l**2 * phi0])


def compare_K_tilde(K_tilde: np.ndarray, k: float, kt: float, l: float) -> None:
    """Print K~ and the paper's (77) side by side."""
    printed, axes = printed_K_tilde(k, kt, l), ("x", "y", "z", "about x", "about y", "about z")
    rows = [
        (f"plate {axes[i]}", f"base {axes[j]}", K_tilde[i, j], printed[i, j], formula)
        for i, j, formula, _ in PRINTED
    ]
    note = (
        f"the other {36 - len(rows)} entries are zero; largest difference "
        f"{np.abs(K_tilde - printed).max():.1g}"
    )
    columns = ("force along", "displacement along", "jaxbody", "paper (77)", "k/4 times")
    print(text(PrintedTable("K~ [N/m, N, N m]", columns, rows, note)), flush=True)


def compare_forces(linear: np.ndarray, exact: np.ndarray, k: float, l: float) -> None:
    """Print the force on the plate due to a displaced base [N, N m]: linear, by the paper's (79),
    and exact."""
    report(
        "The force due to a base displaced by 10 mm along x and turned by 20 mrad about "
        "z, by jax.grad of V:"
    )
    printed = printed_force(k, l, 0.01, 0.02)
    rows = [
        (axis, linear[i], printed[i], exact[i])
        for i, axis in ((0, "along x [N]"), (1, "along y [N]"), (5, "about z [N m]"))
    ]
    print(text(PrintedTable("", ("", "K~ Xi", "paper (79)", "exact, finite Xi"), rows)), flush=True)


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


@contextmanager
def figure(
    path: Path, width: float, height: float, rows: int = 1, columns: int = 1, **ratios: Any
) -> Iterator[Any]:
    """Create a figure without a window or global state; yield its axes and save it at the end of
    the block. Sizes in inches."""
    from matplotlib.figure import Figure

    new = Figure(figsize=(width, height), layout="constrained")
    yield new.subplots(rows, columns, squeeze=False, gridspec_kw=ratios).ravel()
    new.savefig(path, dpi=130)
