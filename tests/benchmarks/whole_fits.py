"""How often 95 % intervals contain the true parameters of laws, of mounts with memory and of a
closed loop: rows of coverage.md.

    python tests/benchmarks/whole_fits.py hydraulic linkage "Bouc-Wen" ...
                                          [--replicates 2000] [--first 0]

Laws are fitted to a record of the displacement of a mass that a sum of sines pushes, a hydraulic
mount to its dynamic stiffness at two amplitudes, as a data sheet gives it, with 1 % noise; a
linkage of crank, rod and rocker, the length of its rod among the unknowns, to a record of the
rocker's end. Each replicate is a whole `jb.fit` from a start 30 % off, unless noted; all share
their programs. Of the law of Bouc and Wen `beta` is known: the data determine only its products
with `gamma` and `delta`, as a fit of all three says.
"""

import argparse
import warnings
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)

SEED = 2026
OFF = 1.3, 0.7, 0.7, 1.3, 0.7, 1.3  # times the truth, from where fits set out
SHEET = np.geomspace(2.0, 50.0, 16)  # [Hz]
AMPLITUDES, SHEET_NOISE = {"small": 2e-4, "large": 1e-3}, 0.01
TIMES = np.arange(301) / 750
SINES = np.arange(5.0, 100.0, 5.0)  # [Hz]
PHASES = np.random.default_rng(SEED).uniform(0, 2 * np.pi, SINES.size)


def on_guide(element, mass: float) -> jb.Model:
    return jb.Model(
        bodies={"m": jb.Body(mass=mass)},
        joints={"m": jb.Guide("world", axis="x")},
        elements={"mount": element},
    )


def strut(**laws) -> jb.SpringDamper:
    return jb.SpringDamper(("m", [0, 0, 0]), ("world", [1, 0, 0]), free_length=1.0, **laws)


class DataSheet:
    """Six parameters of a hydraulic mount, from magnitude and loss angle at two amplitudes."""

    names = (
        "stiffness",
        "damping",
        "upper_stiffness",
        "fluid_mass",
        "fluid_damping",
        "quadratic_damping",
    )
    truth = jb.laws.Hydraulic(
        **dict(zip(names, (2e5, 150.0, 3e5, 60.0, 800.0, 3e4), strict=True)), lower_stiffness=2e4
    )

    def __init__(self):
        self.model = on_guide(strut(spring=self.truth), mass=100.0)
        self.off = {f"mount.spring.{name}": off for name, off in zip(self.names, OFF, strict=True)}
        self.exact = {
            name: jb.vibration.dynamic_stiffness(self.model["mount"], SHEET, amplitude=X)
            for name, X in AMPLITUDES.items()
        }

    def measured(self, rng) -> dict[str, Any]:
        sheets = {}
        for name, X in AMPLITUDES.items():
            magnitude, angle = (
                np.asarray(self.exact[name].magnitude),
                np.asarray(self.exact[name].loss_angle),
            )
            sheets[name] = jb.fitting.MeasuredStiffness(
                "mount",
                SHEET,
                amplitude=X,
                magnitude=magnitude * (1 + SHEET_NOISE * rng.normal(size=magnitude.shape)),
                loss_angle=angle + SHEET_NOISE * rng.normal(size=angle.shape),
                noise={"magnitude": SHEET_NOISE * magnitude, "loss_angle": SHEET_NOISE},
            )
        return sheets


class OfRecord:
    """Parameters from a record of one sensor, with white noise, while sums of sines push a body."""

    def __init__(
        self,
        model: jb.Model,
        off: dict[str, Any],
        at,
        sines: int,
        force: float,
        sensor,
        times,
        noise: float,
        constant=0.0,
    ):
        def push(t):
            total = constant + force * jnp.sum(
                jnp.sin(2 * jnp.pi * SINES[:sines] * t + PHASES[:sines])
            )
            return jnp.stack([total, 0.0, 0.0])

        self.model, self.off, self.times, self.noise = model, off, times, noise
        self.loads: dict[str, Any] = {"push": jb.Force(at, force=push)}
        self.sensors: dict[str, Any] = {"reading": sensor}
        clean = jb.simulate(self.model, self.times, loads=self.loads, rtol=1e-9)
        self.exact = np.asarray(jb.measure(clean, self.sensors)["reading"])

    def measured(self, rng) -> dict[str, Any]:
        noisy = self.exact + self.noise * rng.normal(size=self.exact.shape)
        return {
            "run": jb.Experiment(
                self.times, loads=self.loads, sensors=self.sensors, measured={"reading": noisy}
            )
        }


def law(spring, damper, *names: str, off=OFF, constant=0.0):
    """A case: parameters of the spring and the damper of a mount of 2 kg. The law of Bouc and Wen
    has the values of the benchmark of Noel and Schoukens (2016)."""

    def case() -> OfRecord:
        offs = {f"mount.{name}": x for name, x in zip(names, off, strict=False)}
        model = on_guide(strut(spring=spring, damper=damper), mass=2.0)
        return OfRecord(
            model, offs, "m", 19, 15.0, jb.Position("m", axis="x"), TIMES, 1e-5, constant
        )

    return case


def linkage() -> OfRecord:
    """A stiffness, a damping, a mass and the length of the rod that closes a four-bar linkage,
    whose links are Norton's."""
    links = jb.replace(jb.presets.four_bar(), {"rocker.mass": 0.08})
    model = jb.Model(
        bodies={"crank": links["crank"], "rocker": links["rocker"]},
        joints={name: links.joint(name) for name in ("crank", "rocker")},
        elements={
            "spring": jb.Torsion(
                "world", "crank", axis="z", spring=2.0, damper=2e-3, free_angle=np.deg2rad(40.0)
            )
        },
        closures={
            "rod": jb.closures.Rod(("crank", [0.04, 0, 0]), ("rocker", [0.08, 0, 0]), length=0.12)
        },
    )
    off = {
        "spring.spring.coefficient": 1.3,
        "spring.damper.coefficient": 0.7,
        "rocker.mass": 1.3,
        "rod.length": 0.98,
    }
    end = "rocker", [0.08, 0, 0]
    return OfRecord(
        model, off, end, 10, 0.4, jb.Position(*end, axis="x"), np.arange(201) / 400, 2e-5
    )


def pendulum() -> OfRecord:
    """A pendulum on a hinge that a torsion spring holds, from the angle of its joint."""
    model = jb.Model(
        bodies={"boom": jb.Body(mass=2.0, com=[0.3, 0, 0], inertia=[0.01, 0.06, 0.06])},
        joints={"boom": jb.Hinge("world", axis="y")},
        elements={"spring": jb.Torsion("world", "boom", axis="y", spring=200.0, damper=0.5)},
    )
    off = {"spring.spring.coefficient": 1.3, "spring.damper.coefficient": 0.7, "boom.mass": 1.3}
    return OfRecord(
        model,
        off,
        ("boom", [0, 0, 0.3]),
        10,
        3.0,
        jb.sensors.JointAngle("boom"),
        np.arange(201) / 400,
        1e-3,
    )


laws = jb.laws
CASES = {
    "hydraulic": DataSheet,
    "linkage": linkage,
    "joint angle": pendulum,
    "Linear": law(5e4, 20.0, "spring.coefficient", "damper.coefficient"),
    "Polynomial": law(
        laws.Polynomial([4e4, 4e6, 5e9]), 20.0, "spring.coefficients", "damper.coefficient"
    ),
    "BumpStop": law(
        laws.Linear(4e4) + laws.Stop(gap=5e-4, stiffness=2e5),
        20.0,
        "spring.terms.1.gap",
        "spring.terms.1.stiffness",
    ),
    "TensionOnly": law(
        laws.Linear(3e4) + laws.TensionOnly(4e4),
        20.0,
        "spring.terms.0.coefficient",
        "spring.terms.1.stiffness",
    ),
    "TwoSided": law(
        5e4,
        laws.TwoSided(bump=15.0, rebound=45.0),
        "damper.bump.coefficient",
        "damper.rebound.coefficient",
    ),
    "AirSpring": law(
        laws.AirSpring(pressure=8e5, area=2e-3, height=0.04),
        20.0,
        "spring.area",
        "spring.height",
        constant=1400.0,
    ),
    "Tabulated": law(
        laws.Table(
            [-6e-3, -2e-3, -6e-4, 6e-4, 2e-3, 6e-3], [-540.0, -120.0, -24.0, 24.0, 120.0, 540.0]
        ),
        20.0,
        "spring.forces",
        off=(1.1,),
    ),
    "Digressive": law(
        5e4,
        laws.Digressive(slow=120.0, fast=20.0, knee=0.1),
        "damper.slow",
        "damper.fast",
        "damper.knee",
    ),
    "Friction": law(
        5e4,
        laws.Linear(10.0) + laws.Friction(level=6.0, velocity=0.02),
        "damper.terms.0.coefficient",
        "damper.terms.1.level",
    ),
    "Maxwell": law(
        laws.Linear(3e4) + laws.Maxwell(stiffness=4e4, relaxation_time=5e-3),
        None,
        *(
            "spring.terms.0.coefficient",
            "spring.terms.1.stiffness",
            "spring.terms.1.relaxation_time",
        ),
    ),
    "Dahl": law(
        laws.Linear(4e4) + laws.Dahl(stiffness=8e4, level=8.0),
        10.0,
        "spring.terms.1.stiffness",
        "spring.terms.1.level",
    ),
    "LuGre": law(
        laws.Linear(4e4)
        + laws.LuGre(stiffness=8e4, damping=20.0, level=5.0, static_level=7.0, velocity=0.05),
        5.0,
        "spring.terms.1.stiffness",
        "spring.terms.1.level",
    ),
    "Bouc-Wen": law(
        laws.Linear(5e4) + laws.BoucWen(alpha=5e4, beta=1e3, gamma=0.8, delta=-1.1),
        10.0,
        *("damper.coefficient", "spring.terms.0.coefficient"),
        *(f"spring.terms.1.{name}" for name in ("alpha", "gamma", "delta", "n")),
    ),
}


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("cases", nargs="+", choices=list(CASES))
    parser.add_argument("--replicates", type=int, default=2000)
    parser.add_argument("--first", type=int, default=0, help="number of the first replicate")
    options = parser.parse_args()
    for name in options.cases:
        case = CASES[name]()
        truth = {path: np.asarray(jb.parameter_paths(case.model)[path]) for path in case.off}
        start, held = (
            jb.replace(case.model, {path: x * case.off[path] for path, x in truth.items()}),
            [],
        )
        for i in range(options.first, options.first + options.replicates):
            with warnings.catch_warnings():
                warnings.simplefilter("ignore", jb.JaxbodyWarning)  # of correlated residuals
                fit = jb.fit(
                    start, case.measured(np.random.default_rng([SEED, i])), free=list(case.off)
                )
            ends = fit.intervals()
            held.append(
                np.concatenate(
                    [
                        np.ravel(fit.ok & (ends[path][0] <= x) & (x <= ends[path][1]))
                        for path, x in truth.items()
                    ]
                )
            )
            if len(held) % 100 == 0 or len(held) == options.replicates:
                print(f"{name}, of {len(held)}:", *case.off, *np.sum(held, 0), flush=True)


if __name__ == "__main__":
    main()
