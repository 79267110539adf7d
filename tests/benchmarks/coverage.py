"""How often 95 % intervals contain the true value, for white and AR(1) noise, by instrument; `--write` puts the table into coverage.md.

A plate on five springs vibrates with its base; stiffnesses, a damping and a free length are fitted to readings of one kind of instrument.
Most fits are linearized steps, not `jaxbody.fit`: Gauss-Newton steps from the true values, computed in batches, with Jacobians that are
accurate to second order in the steps. Noise levels are estimated, and uncertainties come from the functions that `jaxbody.fit` calls. Rows
"by jb.fit" are whole fits, from a start 2 to 10 % off. The naive interval assumes white noise.
"""

import argparse
import datetime
import pathlib
import sys
import time
import warnings
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from scipy.signal import lfilter
from scipy.stats import chi2, kstest

sys.path.insert(0, str(pathlib.Path(__file__).parents[1]))
import rigs

import jaxbody as jb
from jaxbody.experiments.experiments import Integration
from jaxbody.experiments.residual_series import records_of
from jaxbody.identification.intervals import interval_of_u
from jaxbody.identification.residuals import Task, residual_and_jacobian
from jaxbody.parameters.spaces import space_of
from jaxbody.statistics.quantiles import quantile
from jaxbody.statistics.uncertainties import assess

SEED, STEP, TOGETHER, CHANGE = 2026, 0.02, 64, 1e-3
RHO = (0.0, 0.3, 0.6, 0.9)
START = (1.1, 0.9, 1.05, 0.95, 1.1, 0.9, 1.02)  # times the truth, from where whole fits set out
FREE = ["*.stiffness", "s0.damping", "s4.free_length"]
CORNER = rigs.CORNERS[0]
SENSORS = {
    "accelerometer and gyro": ({"acc": jb.Accelerometer("plate", CORNER), "gyro": jb.Gyro("plate")}, {"acc": 0.05, "gyro": 0.01}),
    "pose": ({"pose": jb.BodyPose("plate")}, [1e-3, 3e-3]),
    "elongations": ({name: jb.Elongation(name) for name in ("s0", "s1", "s2", "s4")}, 1e-3),
}


class Study:
    """One instrument, n samples: readings without noise, and fits of batches of noisy ones."""

    def __init__(self, sensors: dict, level: Any, n: int):
        model = rigs.plate(damping=1.5)
        start = jb.equilibrium(model).state
        times = STEP * np.arange(n)
        base = jb.Harmonic(frequency=[0.9, 1.3, 2.1, 0.7, 1.7, 1.1], translation=[0.02, 0.015, 0.02], rotation=[0.05, 0.04, 0.05])
        clean = jb.measure(jb.simulate(model, times, motion={"base": base}, initial=start), sensors)
        run = jb.Experiment(times, motion={"base": base}, initial=start, sensors=sensors, measured=clean, noise=level)
        how = Integration(jnp.asarray(1e-8), None, diffrax.ConstantStepSize(), jnp.asarray(STEP), 10 * n)
        self.task = Task(space_of(model, FREE, "fit", runs={"run": run}), {"run": run.noise}, how)
        again = self.task.experiments["run"].readings(model, how, None)  # of these steps, so that the truth is where residuals are noise
        self.task = eqx.tree_at(lambda t: t.space.runs["run"].measured, self.task, again)
        self.records = records_of(self.task.experiments)
        J = [
            np.asarray(residual_and_jacobian(self.task, u)[1])
            for u in CHANGE * np.array([*np.eye(self.task.space.size), *-np.eye(self.task.space.size)])
        ]
        self.J, self.H = (
            sum(J) / len(J),
            np.stack([(a - b) / (2 * CHANGE) for a, b in zip(J[: len(J) // 2], J[len(J) // 2 :], strict=True)], -1),
        )
        self.fits = eqx.filter_jit(jax.vmap(self._fit))
        self.shapes = {name: (n, *sensor.noise_shape) for name, sensor in sensors.items()}

    def _fit(self, noise: dict):
        run = self.task.experiments["run"]
        new = {s: run.sensors[s].disturbed(run.measured[s], run.sensors[s].spread(run.noise[s]) * e) for s, e in noise.items()}
        task = eqx.tree_at(lambda t: t.space.runs["run"].measured, self.task, new)
        start = jnp.zeros(task.space.size)
        u = start - jnp.linalg.lstsq(self.J, task.residual(start))[0]
        return u, task.residual(u), self.J + self.H @ u

    def noises(self, rho: float, count: int, rng) -> dict:
        """AR(1) of variance one in every component."""
        result = {}
        for name, (n, *rest) in self.shapes.items():
            e = rng.normal(size=(count, n, *rest)) * np.sqrt(1 - rho**2)
            e[:, 0] /= np.sqrt(1 - rho**2)
            result[name] = lfilter([1.0], [1.0, -rho], e, axis=1)
        return result

    def _rng(self, rho: float, seed: int):
        return np.random.default_rng([seed, len(self.records), int(100 * rho), self.shapes[next(iter(self.shapes))][0]])

    def run_by_fit(self, rho: float, replicates: int, seed: int) -> dict:
        """By `jb.fit` itself, intervals as it prints them; noise levels estimated."""
        truth = {parameter.path: np.asarray(parameter.form.start) for parameter in self.task.space.parameters}
        start = jb.replace(self.task.space.model, {path: x * START[i % len(START)] for i, (path, x) in enumerate(truth.items())})
        run, held, naive, flagged, distances = self.task.experiments["run"], [], [], [], []
        noises = self.noises(rho, replicates, self._rng(rho, seed))
        for i in range(replicates):
            new = {s: run.sensors[s].disturbed(x, run.sensors[s].spread(run.noise[s]) * noises[s][i]) for s, x in run.measured.items()}
            replicate = jb.Experiment(run.times, motion=run.motion, initial=run.initial, sensors=run.sensors, measured=new)
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", jb.JaxbodyWarning)  # of correlated residuals
                result = jb.fit(
                    start,
                    {"run": replicate},
                    free=FREE,
                    stepsize_controller=diffrax.ConstantStepSize(),
                    dt0=STEP,
                    max_steps=10 * len(run.times),
                )
            assert result.ok, result.report()
            ends, uncertainty = result.intervals(), result.uncertainty
            held.append([ends[path][0] <= x <= ends[path][1] for path, x in truth.items()])
            error = np.array([np.log(float(result.estimates[path]) / x) for path, x in truth.items()])
            far = quantile(0.95, uncertainty.samples - len(error)) * np.sqrt(np.diag(uncertainty.white_covariance))
            naive.append(np.abs(error) <= far)
            flagged.append(uncertainty.correlated)
            distances.append(error @ np.linalg.solve(uncertainty.covariance, error))
        return shares(held, naive, flagged, distances)

    def run(self, rho: float, replicates: int, seed: int) -> dict:
        rng = self._rng(rho, seed)
        held, naive, flagged, distances = [], [], [], []
        while len(held) < replicates:
            for u, r, J in zip(*map(np.asarray, self.fits(self.noises(rho, TOGETHER, rng))), strict=True):
                u, uncertainty = assessed(u, r, J, self.task.space.names, self.records)
                low, high = interval_of_u(u, uncertainty, 0.95)
                held.append((low <= 0) & (high >= 0))
                far = quantile(0.95, len(r) - len(u)) * np.sqrt(np.diag(uncertainty.white_covariance))
                naive.append(np.abs(u) <= far)
                flagged.append(uncertainty.correlated)
                distances.append(u @ np.linalg.solve(uncertainty.covariance, u))
        return shares(*(each[:replicates] for each in (held, naive, flagged, distances)))


def shares(held: list, naive: list, flagged: list, distances: list) -> dict:
    """Of replicates, by parameter, and the p-value of normalized squares."""
    held, naive = np.array(held), np.array(naive)
    p = kstest(distances, chi2(held.shape[1]).cdf).pvalue
    return {"held": held.mean(0), "naive": naive.mean(0), "flagged": np.mean(flagged), "p": p}


def assessed(u, r, J, labels, records):
    """One more step with each unit of each sensor weighted by its estimated noise, as in `fit`, and the uncertainty of its result."""
    weights = np.ones(len(r))
    for group in {one.group for one in records}:
        rows = np.concatenate([one.rows for one in records if one.group == group])
        weights[rows] = 1 / np.sqrt(np.mean(r[rows] ** 2))
    r, J = r * weights, J * weights[:, None]
    step = np.linalg.lstsq(J, -r, rcond=None)[0]
    return u + step, assess(r + J @ step, J, [], [], labels, records)


def row(name: str, n: int, rho: float, result: dict) -> str:
    shares = [100 * np.array([result[key].min(), result[key].max()]) for key in ("held", "naive")]
    cells = [f"{low:.1f} to {high:.1f}" for low, high in shares]
    return f"| {name} | {n} | {rho} | {cells[0]} | {cells[1]} | {100 * result['flagged']:.1f} | {result['p']:.3f} |"


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--replicates", type=int, default=2000)
    parser.add_argument("--fits", type=int, default=200, help="replicates of rows by jb.fit, of the first instrument")
    parser.add_argument("--only", default="")
    parser.add_argument("--samples", type=int, nargs="+", default=[250])
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    lines = [
        "# Coverage of 95 % intervals",
        "",
        f"`tests/benchmarks/coverage.py`, {options.replicates} replicates a row, seed {SEED}, {datetime.date.today()}. Percent of"
        " replicates whose intervals",
        f"contain the true value, smallest and largest over seven parameters, {' '.join(FREE)}. With 2000",
        "replicates the standard deviation of a share of 95 % is 0.5. `p` belongs to the Kolmogorov-Smirnov test of the",
        "normalized squared errors against chi-squared, which is valid for white noise. With strongly correlated noise the",
        "covariance itself is estimated from few independent numbers, so squares are larger; the t-quantiles of the intervals",
        "account for that.",
        "",
        "These fits are linearized steps, not `jb.fit`: one Gauss-Newton step from the truth, with a Jacobian to second order,",
        f'then the functions that `jb.fit` calls for its uncertainties. Rows "by jb.fit" are {options.fits} whole fits each, from a start',
        f"2 to 10 % off; the standard deviation of a share of 95 % is then {100 * np.sqrt(0.95 * 0.05 / options.fits):.1f}.",
        "",
        "| instrument | samples a channel | rho | contained, % | contained, naive intervals, % | flagged, % | p |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, (sensors, level) in SENSORS.items():
        for n in options.samples if options.only in name else ():
            study = Study(sensors, level, n)
            for rho in RHO:
                start = time.time()
                lines.append(row(name, n, rho, study.run(rho, options.replicates, SEED)))
                print(lines[-1], f"{time.time() - start:.0f} s", flush=True)
        if name == next(iter(SENSORS)) and options.fits and options.only in name:
            study = Study(sensors, level, options.samples[0])
            for rho in (RHO[0], RHO[2]):
                start = time.time()
                lines.append(row(f"{name}, by jb.fit", options.samples[0], rho, study.run_by_fit(rho, options.fits, SEED)))
                print(lines[-1], f"{time.time() - start:.0f} s", flush=True)
    if options.write:
        page = pathlib.Path(__file__).with_suffix(".md")
        _, head, others = page.read_text().partition("\n## ")  # rows of whole_fits.py
        page.write_text("\n".join(lines) + "\n" + head + others)


if __name__ == "__main__":
    main()
