"""The first command, `jaxbody demo`: the plate of Stanescu and Mihalcea (2011) from its drawing to stiffnesses fitted to a noisy record.

A second thread compiles the next computation while this one prints and draws.
"""

from __future__ import annotations

import argparse
import time
from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

import numpy as np

NOISE = 2e-3  # m, of the simulated camera
LIKELY = 4.0  # standard errors within which the truth must lie
START = time.perf_counter()
DESCRIPTION = "Rigid bodies on springs from a base whose motion is imposed: models, motions, vibrations and fits, differentiable."
EPILOG = """in Python:
  import jaxbody as jb
  model = jb.presets.full_car()   # ready models; your own: help(jb.Model)
  print(jb.equilibrium(model))
  jb.plots.draw_model(model)      # pictures: dir(jb.plots); force laws: dir(jb.laws)
  help(jb.simulate)               # each public name has its example; all names: dir(jb)
"""

# (77) of the paper, entries in k/4: row, column, as printed, as a function of kt/k and l; all others are zero
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


def main(arguments: Sequence[str] | None = None) -> int:
    """`jaxbody` prints what there is; `jaxbody demo` ends with exit code 0 when the fitted stiffnesses agree with the true ones."""
    from jaxbody import __version__

    parser = argparse.ArgumentParser(
        prog="jaxbody", description=DESCRIPTION, epilog=EPILOG, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--version", action="version", version=f"jaxbody {__version__}")
    commands = parser.add_subparsers(dest="command", title="commands")
    demo = commands.add_parser("demo", help="a plate on three springs under a shaken base, from the drawing to fitted stiffnesses")
    demo.add_argument("--out", type=Path, default=Path("jaxbody-demo"), help="folder for the figures (default: ./jaxbody-demo)")
    demo.add_argument("--seed", type=int, default=0, help="of the measurement noise (default: 0)")
    given = parser.parse_args(arguments)
    if given.command is None:
        parser.print_help()
        return 0
    with ThreadPoolExecutor(max_workers=1) as ahead:
        return run(given.out, given.seed, ahead)


def run(out: Path, seed: int, ahead: ThreadPoolExecutor) -> int:
    """The whole tour: model, modes, motion, fit."""
    import jax

    jax.config.update("jax_enable_x64", True)
    import jax.numpy as jnp
    import optax

    import jaxbody as jb

    l, m, g, kt = 0.7, 3.0, 9.81, 120.0
    k = m * g / l
    say("The plate of N.-D. Stanescu and S. Mihalcea, 13th IFToMM World Congress, 2011, A14_316, section 7:")
    print(f"  m = {m} kg, l = {l} m, hung from AB and CD, k = m g/l = {k:.4g} N/m, held by EF, kt = {kt:g} N/m.")
    plate = model(l, m, g, k, kt)

    say("Differentiating the energies: K~, the force on the plate per displacement of the base ...")
    lin = jb.linearize(plate, plate.reference)
    compare_K_tilde(np.asarray(lin.K_tilde), k, kt, l)

    say("Searching for the equilibrium ...")
    pending = ahead.submit(jb.equilibrium, plate)
    out.mkdir(parents=True, exist_ok=True)
    figures = [draw_plate(plate, out)]
    eq = pending.result()
    print(eq)

    say("Integrating 5 s of the exact motion; the base shakes at 0.8 Hz by 10 mm along x, 20 mm along y and 20 mrad about z ...")
    times = jnp.linspace(0.0, 5.0, 501)
    motion = {"base": jb.Harmonic(frequency=0.8, translation=[0.01, 0.02, 0], rotation=[0, 0, 0.02])}
    pending = ahead.submit(jb.simulate, plate, times, motion=motion, initial=eq.state)
    xi = jnp.array([0.01, 0, 0, 0, 0, 0.02])
    compare_forces(np.asarray(lin.K_tilde @ xi), np.asarray(jb.excitation(plate, eq, {"base": xi})), k, l)
    say("Modes of small motions about the equilibrium:")
    lin = jb.linearize(plate, eq)
    modes = jb.modes(lin)
    print(modes)
    figures.append(draw_modes(lin, modes, out))
    trajectory = pending.result()
    say("The exact motion:")
    print(trajectory)

    sensors: dict[str, Any] = {"corner": jb.Position("plate", [3 * l, l, 0])}
    say(f"Measuring the corner C with {1000 * NOISE:g} mm of noise, then fitting the stiffnesses with optax, starting 30 % too stiff ...")
    measured = jb.measure(trajectory, sensors, noise=NOISE, key=jax.random.key(seed))
    experiment = jb.Experiment(times, motion=motion, initial=eq.state, sensors=sensors, measured=measured)
    guess = jb.replace(plate, {"*.stiffness": 1.3 * jnp.array([k, k, kt])})
    pending = ahead.submit(jb.fit, guess, {"run1": experiment}, free=["*.stiffness"], method=optax.lbfgs())
    figures.append(draw_motion(trajectory, out))
    fit = pending.result()
    figures.append(draw_fit(fit, out))
    good = compare_stiffnesses(fit, {"AB": k, "CD": k, "EF": kt})
    say("Figures: " + ", ".join(map(str, figures)))
    say("Done." if good else "The estimates are not where they should be.")
    return 0 if good else 1


def say(what: str) -> None:
    """A line on the way, with the seconds since the start."""
    print(f"\n[{time.perf_counter() - START:4.1f} s] {what}", flush=True)


def model(l: float, m: float, g: float, k: float, kt: float) -> Any:
    """The plate on its springs, with a little damping; O at the world's origin, weight along -y."""
    import jaxbody as jb

    free = 1.5 * 2**0.5 * l  # L - s of AB and CD (67)
    return jb.Model(
        bodies={"plate": jb.Body(mass=m, inertia=[0.3, 0.9, 1.2])},
        supports={"base": jb.Support(position=[0, -4 * l, 0])},
        elements={
            "AB": jb.Spring(("plate", [-3 * l, l, 0]), ("base", [-5 * l, 7 * l, 0]), stiffness=k, free_length=free, damping=1.0),
            "CD": jb.Spring(("plate", [3 * l, l, 0]), ("base", [5 * l, 7 * l, 0]), stiffness=k, free_length=free, damping=1.0),
            "EF": jb.Spring(("plate", [0, -l, 0]), ("base", [0, l, 0]), stiffness=kt, free_length=2 * l, damping=1.0),
        },
        gravity=[0, -g, 0],
    )


def printed_K_tilde(k: float, kt: float, l: float) -> np.ndarray:
    """(77)."""
    K = np.zeros((6, 6))
    for i, j, _, entry in PRINTED:
        K[i, j] = k / 4 * entry(kt / k, l)
    return K


def printed_force(k: float, l: float, xi0: float, phi0: float) -> np.ndarray:
    """(79), the amplitude of the excitation force under a base that moves by xi0 along x and turns by phi0 about z."""
    return k / 4 * np.array([5 * xi0 - 20 * l * phi0, 0, 0, 0, 0, 4 * l * xi0 + 32 * l**2 * phi0])


def compare_K_tilde(K_tilde: np.ndarray, k: float, kt: float, l: float) -> None:
    """The base's stiffness beside the paper's (77)."""
    from jaxbody.core.tables import Table, text

    printed, ways = printed_K_tilde(k, kt, l), ("x", "y", "z", "about x", "about y", "about z")
    rows = [(f"plate {ways[i]}", f"base {ways[j]}", K_tilde[i, j], printed[i, j], formula) for i, j, formula, _ in PRINTED]
    note = f"the other {36 - len(rows)} entries are zero; largest difference {np.abs(K_tilde - printed).max():.1g}"
    print(
        text(Table("K~ [N/m, N, N m]", ("force along", "displacement along", "jaxbody", "paper (77)", "k/4 times"), rows, note)), flush=True
    )


def compare_forces(linear: np.ndarray, exact: np.ndarray, k: float, l: float) -> None:
    """The force of a moved base beside the paper's (79) and the exact one."""
    from jaxbody.core.tables import Table, text

    say("The force of a base displaced by 10 mm along x and turned by 20 mrad about z:")
    printed = printed_force(k, l, 0.01, 0.02)
    rows = [(way, linear[i], printed[i], exact[i]) for i, way in ((0, "along x [N]"), (1, "along y [N]"), (5, "about z [N m]"))]
    print(text(Table("", ("", "K~ Xi", "paper (79)", "exact, finite Xi"), rows)), flush=True)


def compare_stiffnesses(fit: Any, truth: dict[str, float]) -> bool:
    """Truth beside estimate and standard error; True when the fit went well and all lie within LIKELY standard errors."""
    from jaxbody.core.tables import Table, text

    rows, good = [], bool(fit.ok)
    for name, true in truth.items():
        estimate, error = (float(x[f"{name}.stiffness"]) for x in (fit.estimates, fit.standard_errors))
        off = abs(estimate - true) / error
        good &= bool(off <= LIKELY)
        rows.append((name, 1.3 * true, true, estimate, error, f"{off:.1f}"))
    say(f"Fitted stiffnesses [N/m], {int(fit.evaluations)} evaluations, {fit.report()}:")
    print(text(Table("", ("spring", "start", "truth", "estimate", "standard error", "errors off"), rows)), flush=True)
    return good


def figure(width: float, height: float, rows: int, columns: int, **ratios: Any) -> tuple[Any, Any]:
    """A figure of its own, without a window or a global state, and its axes."""
    from matplotlib.figure import Figure

    made = Figure(figsize=(width, height), layout="constrained")
    return made, made.subplots(rows, columns, squeeze=False, gridspec_kw=ratios).ravel()


def saved(made: Any, path: Path) -> Path:
    """Where a figure was written to."""
    made.savefig(path, dpi=130)
    return path


def draw_plate(plate: Any, out: Path) -> Path:
    """The plate at rest, into plate.png."""
    from jaxbody.plots import draw_model

    made, (ax,) = figure(6.5, 4.6, 1, 1)
    draw_model(plate, ax=ax).set_title("the plate, its springs and the base", fontsize=9)
    return saved(made, out / "plate.png")


def draw_modes(lin: Any, modes: Any, out: Path) -> Path:
    """All six modes, into modes.png."""
    from jaxbody.plots import draw_mode

    made, axes = figure(11.0, 6.2, 2, 3)
    for i, ax in enumerate(axes):
        draw_mode(lin, modes, i + 1, ax=ax)
    return saved(made, out / "modes.png")


def draw_motion(trajectory: Any, out: Path) -> Path:
    """Positions and tensions over time, into motion.png."""
    from jaxbody.plots import plot_forces, plot_trajectory

    made, (above, below) = figure(8.0, 7.0, 2, 1, height_ratios=(1.6, 1.0))
    plot_trajectory(trajectory, ax=above)
    plot_forces(trajectory, ax=below)
    return saved(made, out / "motion.png")


def draw_fit(fit: Any, out: Path) -> Path:
    """The model, the record with the fit, and the way there, into fit.png."""
    from jaxbody.plots import draw_model, plot_fit, plot_history

    made, (left, middle, right) = figure(14.0, 4.4, 1, 3, width_ratios=(1.0, 1.25, 0.65))
    draw_model(fit.model, ax=left).set_title("the plate under a base that shakes", fontsize=9)
    plot_fit(fit, ax=middle).set_title("motion of its upper right corner, measured and fitted", fontsize=9)
    plot_history(fit, ax=right).set_title("the way there", fontsize=9)
    return saved(made, out / "fit.png")
