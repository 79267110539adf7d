"""How often 95 % intervals contain the true value, for white and AR(1) noise, by instrument;
`--write` puts the table into coverage.md.

A plate on five springs vibrates with its base; stiffnesses, a damping and a free length are fitted
to readings of one kind of instrument, by `jb.fit` from a start 2 to 10 % off, which estimates the
noise levels, too. The naive interval assumes white noise.
"""

import argparse
import datetime
import pathlib
import sys
import time
import warnings
from typing import Any

import diffrax
import jax
import numpy as np
from scipy.signal import lfilter
from scipy.stats import chi2, kstest

sys.path.insert(0, str(pathlib.Path(__file__).parents[1]))
import rigs

import jaxbody as jb
from jaxbody.fitting.statistics.uncertainties import quantile

SEED, SAMPLES, STEP = 2026, 250, 0.02
RHO = (0.0, 0.3, 0.6, 0.9)
START = (1.1, 0.9, 1.05, 0.95, 1.1, 0.9, 1.02)  # times the truth, from where fits set out
FREE = ["*.stiffness", "s0.damping", "s4.free_length"]
HOW: dict[str, Any] = {
    "stepsize_controller": diffrax.ConstantStepSize(),
    "dt0": STEP,
    "max_steps": 10 * SAMPLES,
}
CORNER, OTHER = rigs.CORNERS[0], rigs.CORNERS[2]
UP, BEAM = [0, 0, 1], {"axis": [0, 0, -1], "normal": [0, 0, 1]}
INSTRUMENTS: dict[str, tuple[dict[str, Any], Any]] = {  # sensors and their noise
    "accelerometer and gyro": (
        {"acc": jb.Accelerometer("plate", CORNER), "gyro": jb.sensors.Gyro("plate")},
        {"acc": 0.05, "gyro": 0.01},
    ),
    "pose": ({"pose": jb.sensors.BodyPose("plate")}, {"pose": [1e-3, 3e-3]}),
    "elongations": (
        {name: jb.Elongation(name) for name in ("s0", "s1", "s2", "s4")},
        dict.fromkeys(("s0", "s1", "s2", "s4"), 1e-3),
    ),
    "position and rotation": (
        {"p": jb.Position("plate", CORNER), "turn": jb.sensors.Rotation("plate")},
        {"p": 1e-3, "turn": 3e-3},
    ),
    "velocities": (
        {"v": jb.Velocity("plate", CORNER), "w": jb.sensors.AngularVelocity("plate")},
        {"v": 5e-3, "w": 0.01},
    ),
    "accelerations": (
        {"a": jb.Acceleration("plate", CORNER), "w'": jb.sensors.AngularAcceleration("plate")},
        {"a": 0.05, "w'": 0.2},
    ),
    "attitude, tilt and height": (
        {
            "turn": jb.sensors.Orientation("plate"),
            "tilt": jb.sensors.Inclinometer("plate"),
            "z": jb.Position("plate", axis="z"),
        },
        {"turn": 3e-3, "tilt": 3e-3, "z": 1e-3},
    ),
    "gauges": (
        {
            "a": jb.sensors.Displacement(("plate", CORNER), ("base", rigs.ON_BASE[0])),
            "b": jb.sensors.StringPotentiometer(("plate", OTHER), ("base", rigs.ON_BASE[1])),
        },
        {"a": 1e-3, "b": 1e-3},
    ),
    "lasers": (
        {
            "v": jb.sensors.LaserVibrometer("plate", CORNER, axis=UP),
            "v2": jb.sensors.LaserVibrometer("plate", OTHER, axis=[1, 0, 0.5]),
            "d": jb.sensors.LaserDistance("plate", [0, 0, 0.1], origin=[-0.3, 0.2, 1], **BEAM),
        },
        {"v": 5e-3, "v2": 5e-3, "d": 1e-3},
    ),
    "load cell and force plate": (
        {"cell": jb.sensors.LoadCell("s0"), "table": jb.sensors.ForcePlate("base")},
        {"cell": 0.5, "table": [2.0, 1.0]},
    ),
    "reaction of the base": ({"reaction": jb.sensors.Reaction("base")}, {"reaction": [2.0, 1.0]}),
}


class Study:
    """One kind of instrument: readings without noise, and fits of noisy ones."""

    def __init__(self, sensors: dict[str, Any], noise: dict[str, Any]):
        self.model, self.sensors, self.noise = rigs.plate(damping=1.5), sensors, noise
        base = jb.Harmonic(
            frequency=[0.9, 1.3, 2.1, 0.7, 1.7, 1.1],
            translation=[0.02, 0.015, 0.02],
            rotation=[0.05, 0.04, 0.05],
        )
        self.times, self.shaking = (
            STEP * np.arange(SAMPLES),
            {"motion": {"base": base}, "initial": jb.equilibrium(self.model).state},
        )
        clean = jb.measure(jb.simulate(self.model, self.times, **self.shaking, **HOW), sensors)
        self.exact = {name: np.asarray(reading) for name, reading in clean.items()}
        values = jb.parameter_paths(self.model)
        free = [path for path in values if path.endswith("stiffness")] + FREE[1:]
        self.truth = {path: np.asarray(values[path]) for path in free}
        self.start = jb.replace(
            self.model,
            {path: x * off for (path, x), off in zip(self.truth.items(), START, strict=True)},
        )

    def disturbed(self, rho: float, rng) -> dict[str, Any]:
        """Readings with AR(1) noise in every component."""
        result = {}
        for name, sensor in self.sensors.items():
            e = rng.normal(size=(SAMPLES, *sensor.noise_shape)) * np.sqrt(1 - rho**2)
            e[0] /= np.sqrt(1 - rho**2)
            level = sensor.spread(np.asarray(self.noise[name]))
            result[name] = np.asarray(
                sensor.disturbed(
                    self.exact[name], level * np.asarray(lfilter([1.0], [1.0, -rho], e, axis=0))
                )
            )
        return result

    def run(self, rho: float, replicates: int, seed: int) -> dict[str, Any]:
        """By parameter, how often the truth was in both intervals; how often noise was called
        correlated; p of squares."""
        held, naive, flagged, distances = [], [], [], []
        for i in range(replicates):
            rng = np.random.default_rng([seed, i, int(100 * rho)])
            run = jb.Experiment(
                self.times, **self.shaking, sensors=self.sensors, measured=self.disturbed(rho, rng)
            )
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", jb.JaxbodyWarning)  # of correlated residuals
                fit = jb.fit(self.start, {"run": run}, free=FREE, **HOW)
            assert fit.ok, fit.report()
            ends, uncertainty = fit.intervals(), fit.uncertainty
            held.append([ends[path][0] <= x <= ends[path][1] for path, x in self.truth.items()])
            error = np.array(
                [np.log(float(fit.estimates[path]) / x) for path, x in self.truth.items()]
            )
            far = quantile(0.95, uncertainty.samples - len(error)) * np.sqrt(
                np.diag(uncertainty.white_covariance)
            )
            naive.append(np.abs(error) <= far)
            flagged.append(uncertainty.correlated)
            distances.append(error @ np.linalg.solve(uncertainty.covariance, error))
        p = kstest(distances, chi2(len(self.truth)).cdf).pvalue
        return {
            "held": np.mean(held, 0),
            "naive": np.mean(naive, 0),
            "flagged": np.mean(flagged),
            "p": p,
        }


def row(name: str, rho: float, result: dict[str, Any]) -> str:
    shares = [100 * np.array([result[key].min(), result[key].max()]) for key in ("held", "naive")]
    cells = [f"{low:.1f} to {high:.1f}" for low, high in shares]
    return (
        f"| {name} | {rho} | {cells[0]} | {cells[1]} | {100 * result['flagged']:.1f} | "
        f"{result['p']:.3f} |"
    )


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--replicates", type=int, default=2000)
    parser.add_argument("--only", nargs="+", choices=list(INSTRUMENTS), default=list(INSTRUMENTS))
    parser.add_argument("--rho", nargs="+", type=float, default=RHO)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    lines = [
        "# Coverage of 95 % intervals",
        "",
        (
            f"`tests/benchmarks/coverage.py`, {options.replicates} whole fits a row by `jb.fit`, "
            f"seed {SEED}, {datetime.date.today()}. Percent of replicates whose"
        ),
        (
            "intervals contain the true value, smallest and largest over seven parameters, "
            f"{' '.join(FREE)}. With 2000"
        ),
        (
            "replicates the standard deviation of a share of 95 % is 0.5. `p` belongs to the "
            "Kolmogorov-Smirnov test of the"
        ),
        (
            "normalized squared errors against chi-squared, which is valid for white noise. With "
            "strongly correlated noise the"
        ),
        (
            "covariance itself is estimated from few independent numbers, so squares are larger; "
            "the t-quantiles of the intervals"
        ),
        f"account for that. {SAMPLES} samples a channel, starts 2 to 10 % off.",
        "",
        "| instrument | rho | contained, % | contained, naive intervals, % | flagged, % | p |",
        "|---|---|---|---|---|---|",
    ]
    for name in options.only:
        study = Study(*INSTRUMENTS[name])
        for rho in options.rho:
            start = time.time()
            lines.append(row(name, rho, study.run(rho, options.replicates, SEED)))
            print(lines[-1], f"{time.time() - start:.0f} s", flush=True)
    if options.write:
        page = pathlib.Path(__file__).with_suffix(".md")
        _, head, others = page.read_text().partition("\n## ")  # rows of whole_fits.py
        page.write_text("\n".join(lines) + "\n" + head + others)


if __name__ == "__main__":
    main()
