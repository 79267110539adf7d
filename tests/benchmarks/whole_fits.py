"""How often 95 % intervals contain the true parameters of mounts with memory and of a closed loop: rows of coverage.md.

    python tests/benchmarks/whole_fits.py hydraulic|bouc_wen|linkage [--replicates 2000] [--first 0]

A hydraulic mount is fitted to its dynamic stiffness at two amplitudes, as a data sheet gives it, with 1 % noise; a mount with hysteresis
of Bouc and Wen to a record of the displacement of a mass that a sum of sines pushes; a linkage of crank, rod and rocker, the length of its
rod among the unknowns, to a record of the rocker's end. Each replicate is a whole `jb.fit` from a start 30 % off (2 % of the length); all
share their programs. `beta` is known: the data determine only its products with `gamma` and `delta`, as a fit of all three says.
"""

import argparse
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
jb.fast_loops()

SEED = 2026
SHEET = np.geomspace(2.0, 50.0, 16)  # [Hz]
AMPLITUDES, SHEET_NOISE = {"small": 2e-4, "large": 1e-3}, 0.01
TIMES, RECORD_NOISE = np.arange(301) / 750, 1e-5
SINES = np.arange(5.0, 100.0, 5.0)  # [Hz]
PHASES = np.random.default_rng(SEED).uniform(0, 2 * np.pi, SINES.size)


def on_guide(element, mass: float) -> jb.Model:
    return jb.Model(bodies={"m": jb.Body(mass=mass)}, joints={"m": jb.Guide("world", axis="x")}, elements={"mount": element})


def strut(**laws) -> jb.SpringDamper:
    return jb.SpringDamper(("m", [0, 0, 0]), ("world", [1, 0, 0]), free_length=1.0, **laws)


class Hydraulic:
    """Six parameters from a data sheet: magnitude and loss angle at two amplitudes."""

    off = np.array([1.3, 0.7, 0.7, 1.3, 0.7, 1.3])
    truth = np.array([2e5, 150.0, 3e5, 60.0, 800.0, 3e4])
    names = "stiffness", "damping", "upper_stiffness", "fluid_mass", "fluid_damping", "quadratic_damping"
    paths = tuple(f"mount.spring.{name}" for name in names)

    def __init__(self):
        mount = self.model(self.truth)["mount"]
        self.exact = {name: jb.dynamic_stiffness(mount, SHEET, amplitude=X) for name, X in AMPLITUDES.items()}

    def model(self, values) -> jb.Model:
        law = jb.laws.Hydraulic(**dict(zip(self.names, values, strict=True)), lower_stiffness=2e4)
        return on_guide(strut(spring=law), mass=100.0)

    def measured(self, rng) -> dict[str, Any]:
        sheets = {}
        for name, X in AMPLITUDES.items():
            magnitude, angle = np.asarray(self.exact[name].magnitude), np.asarray(self.exact[name].loss_angle)
            sheets[name] = jb.MeasuredStiffness(
                "mount",
                SHEET,
                amplitude=X,
                magnitude=magnitude * (1 + SHEET_NOISE * rng.normal(size=magnitude.shape)),
                loss_angle=angle + SHEET_NOISE * rng.normal(size=angle.shape),
                noise={"magnitude": SHEET_NOISE * magnitude, "loss_angle": SHEET_NOISE},
            )
        return sheets


class BoucWen:
    """Six parameters from a record; values of the benchmark of Noel and Schoukens (2016)."""

    off = Hydraulic.off
    truth = np.array([10.0, 5e4, 5e4, 0.8, -1.1, 1.0])
    paths = ("mount.damper.coefficient", "mount.spring.terms.0.coefficient") + tuple(
        f"mount.spring.terms.1.{name}" for name in ("alpha", "gamma", "delta", "n")
    )

    def __init__(self):
        def push(t):
            return jnp.stack([15 * jnp.sum(jnp.sin(2 * jnp.pi * SINES * t + PHASES)), 0.0, 0.0])

        self.loads: dict[str, Any] = {"push": jb.Force("m", force=push)}
        self.sensors: dict[str, Any] = {"x": jb.Position("m", axis="x")}
        clean = jb.simulate(self.model(self.truth), TIMES, loads=self.loads, rtol=1e-9)
        self.exact = np.asarray(jb.measure(clean, self.sensors)["x"])

    def model(self, values) -> jb.Model:
        c, k, alpha, gamma, delta, n = values
        law = jb.laws.Linear(k) + jb.laws.BoucWen(alpha=alpha, beta=1e3, gamma=gamma, delta=delta, n=n)
        return on_guide(strut(spring=law, damper=c), mass=2.0)

    def measured(self, rng) -> dict[str, Any]:
        noisy = self.exact + RECORD_NOISE * rng.normal(size=self.exact.shape)
        return {"run": jb.Experiment(TIMES, loads=self.loads, sensors=self.sensors, measured={"x": noisy})}


class Linkage:
    """A stiffness, a damping, a mass and the length of the rod that closes a four-bar linkage, from a record under a push; the links are
    Norton's."""

    off = np.array([1.3, 0.7, 1.3, 0.98])
    truth = np.array([2.0, 2e-3, 0.08, 0.12])
    paths = "spring.spring.coefficient", "spring.damper.coefficient", "rocker.mass", "rod.length"
    times, noise = np.arange(201) / 400, 2e-5

    def __init__(self):
        def push(t):
            return jnp.stack([0.4 * jnp.sum(jnp.sin(2 * jnp.pi * SINES[:10] * t + PHASES[:10])), 0.0, 0.0])

        self.loads: dict[str, Any] = {"push": jb.Force(("rocker", [0.08, 0, 0]), force=push)}
        self.sensors: dict[str, Any] = {"x": jb.Position("rocker", [0.08, 0, 0], axis="x")}
        clean = jb.simulate(self.model(self.truth), self.times, loads=self.loads, rtol=1e-9)
        self.exact = np.asarray(jb.measure(clean, self.sensors)["x"])

    def model(self, values) -> jb.Model:
        stiffness, damping, mass, length = values
        links = jb.replace(jb.presets.four_bar(), {"rocker.mass": mass})
        return jb.Model(
            bodies={"crank": links["crank"], "rocker": links["rocker"]},
            joints={name: links.joint(name) for name in ("crank", "rocker")},
            elements={"spring": jb.Torsion("world", "crank", axis="z", spring=stiffness, damper=damping, free_angle=np.deg2rad(40.0))},
            closures={"rod": jb.closures.Rod(("crank", [0.04, 0, 0]), ("rocker", [0.08, 0, 0]), length=length)},
        )

    def measured(self, rng) -> dict[str, Any]:
        noisy = self.exact + self.noise * rng.normal(size=self.exact.shape)
        return {"run": jb.Experiment(self.times, loads=self.loads, sensors=self.sensors, measured={"x": noisy})}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("case", choices=["hydraulic", "bouc_wen", "linkage"])
    parser.add_argument("--replicates", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="number of the first replicate")
    options = parser.parse_args()
    case = {"hydraulic": Hydraulic, "bouc_wen": BoucWen, "linkage": Linkage}[options.case]()
    start, held = case.model(case.truth * case.off), []
    for i in range(options.first, options.first + options.replicates):
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", jb.JaxbodyWarning)  # of correlated residuals
            fit = jb.fit(start, case.measured(np.random.default_rng([SEED, i])), free=list(case.paths))
        ends = fit.intervals()
        held.append([fit.ok and ends[path][0] <= x <= ends[path][1] for path, x in zip(case.paths, case.truth, strict=True)])
        if len(held) % 10 == 0:
            print(f"of {len(held)}:", *(f"{path} {n}" for path, n in zip(case.paths, np.sum(held, 0), strict=True)), flush=True)


if __name__ == "__main__":
    main()
