"""An accelerometer with a delay of half a sample, a gain error of 0.2 % and a bias: coverage if
these are modeled, the residual test if not.

`python tests/benchmarks/transducers.py` fits a cart on a spring, shaken by its base, to an
accelerometer and an LVDT at 40 dB. Every replicate is a whole `jaxbody.fit` from a start 10 % off,
to a simulated record with its own noise. `--write` puts the table into transducers.md.
"""

import argparse
import datetime
import time
import warnings
from pathlib import Path

import jax
import numpy as np

import jaxbody as jb

SEED, STEP, SAMPLES = 2026, 0.005, 1000
CHAIN = {"gain": 1.002, "bias": 0.05, "delay": 0.5 * STEP}
NOMINAL = {"gain": 1.0, "bias": 0.0, "delay": 0.0}
FREE = ["s.stiffness", "s.damping"]
MODELED = [*FREE, "run.acc.gain", "run.acc.bias", "run.acc.delay"]
TONES = [(0.9, 0.03), (2.3, 0.01), (4.1, 0.004), (7.0, 0.002)]  # [Hz], [m]
TRUTH = {
    "s.stiffness": 400.0,
    "s.damping": 4.0,
    **{f"run.acc.{name}": x for name, x in CHAIN.items()},
}
ON = {"axis": [1, 0, 0]}
GAP = jb.sensors.Displacement("cart", "base", axis=[1, 0, 0])


class Study:
    """The record without noise, and fits to it with noise."""

    def __init__(self):
        self.model = jb.Model(
            bodies={"cart": jb.Body(mass=2.0, inertia=[1, 1, 1])},
            supports={"base": jb.Support()},
            joints={"cart": jb.Guide("base", axis=[1, 0, 0])},
            elements={
                "s": jb.Spring(
                    ("cart", [0, 0, 0]),
                    ("base", [1, 0.2, 0]),
                    stiffness=400.0,
                    free_length=1.0,
                    damping=4.0,
                )
            },
            gravity=[0, 0, -9.81],
        )
        tones = [
            jb.Harmonic(frequency=f, translation=[a, 0, 0], translation_phase=i)
            for i, (f, a) in enumerate(TONES)
        ]
        self.base = sum(tones[1:], tones[0])
        # the record is cut out of the motion: an instrument with a delay saw what was before
        times = STEP * np.arange(-2, SAMPLES)
        whole = jb.simulate(self.model, times, motion={"base": self.base}, rtol=1e-11)
        clean = jb.measure(whole, {"acc": jb.Accelerometer("cart", **ON, **CHAIN), "gap": GAP})
        self.times, self.initial = times[2:], jax.tree.map(lambda x: x[2], whole.state)
        self.clean = {name: np.asarray(x)[2:] for name, x in clean.items()}
        self.noise = {name: float(np.std(x)) / 100 for name, x in self.clean.items()}
        self.start = jb.replace(self.model, {"s.stiffness": 440.0, "s.damping": 3.6})

    def fit(self, seed: int, modeled: bool):
        rng = np.random.default_rng([SEED, seed])
        measured = {
            name: x + self.noise[name] * rng.normal(size=x.shape) for name, x in self.clean.items()
        }
        acc = jb.Accelerometer("cart", **ON, **(NOMINAL if modeled else {}))
        run = jb.Experiment(
            self.times,
            motion={"base": self.base},
            initial=self.initial,
            sensors={"acc": acc, "gap": GAP},
            measured=measured,
            noise=self.noise,
        )
        return jb.fit(self.start, {"run": run}, free=MODELED if modeled else FREE)

    def replicates(self, count: int, modeled: bool) -> dict:
        """Errors over true values, whether intervals hold them, and the residual test of
        each replicate."""
        errors, stated, held, flagged, least, factor = [], [], [], [], [], []
        for seed in range(count):
            result = self.fit(seed, modeled)
            ends = result.intervals()
            errors.append([float(x) - TRUTH[path] for path, x in result.estimates.items()])
            stated.append([float(result.standard_errors[path]) for path in result.estimates])
            held.append(
                [
                    float(ends[path][0]) <= TRUTH[path] <= float(ends[path][1])
                    for path in result.estimates
                ]
            )
            tests = [test.p for test in result.uncertainty.whiteness.values() if test is not None]
            flagged.append(result.uncertainty.correlated)
            least.append(min(1.0, len(tests) * min(tests)))
            factor.append(
                max(float(rms) / self.noise[name] for name, rms in result.noise["run"].items())
            )
        return {
            "paths": list(result.estimates),
            "errors": np.array(errors),
            "stated": np.array(stated),
            "held": np.array(held),
            "flagged": np.array(flagged),
            "white": np.array(least),
            "rms": np.array(factor),
        }


def report(modeled: dict, bare: dict) -> list[str]:
    delay = modeled["errors"][:, modeled["paths"].index("run.acc.delay")] / STEP
    lines = [
        (
            "| parameter | true | coverage, modeled, % | standard deviation of the estimate | "
            "coverage, not modeled, % | mean error, not modeled |"
        ),
        "|---|---|---|---|---|---|",
    ]
    for i, path in enumerate(modeled["paths"]):
        known = path in bare["paths"]
        j = bare["paths"].index(path) if known else 0
        other = (
            f"{100 * bare['held'][:, j].mean():.1f} | {bare['errors'][:, j].mean():.3g}"
            if known
            else "|"
        )
        lines.append(
            f"| {path} | {TRUTH[path]:g} | {100 * modeled['held'][:, i].mean():.1f} | "
            f"{modeled['errors'][:, i].std():.3g} | {other} |"
        )
    lines += [
        "",
        (
            f"Error of the delay: standard deviation {delay.std():.4f} samples, largest "
            f"{np.abs(delay).max():.4f}, mean {delay.mean():.5f}."
        ),
    ]
    for name, result in (("Modeled", modeled), ("Not modeled", bare)):
        lines.append(
            f"{name}: residuals reported as correlated in {100 * result['flagged'].mean():.1f} %, "
            f"p of the Ljung-Box test below 0.01 in {100 * (result['white'] < 0.01).mean():.1f} % "
            f"of replicates; largest rms over stated noise {result['rms'].mean():.3f}."
        )
    return lines


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--replicates", type=int, default=2000)
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    warnings.simplefilter("ignore", jb.JaxbodyWarning)
    begin = time.perf_counter()
    study = Study()
    modeled, bare = (
        study.replicates(options.replicates, True),
        study.replicates(max(options.replicates // 4, 10), False),
    )
    page = [
        "# A transducer with a delay, a gain error and a bias",
        "",
        (
            f"`tests/benchmarks/transducers.py`, seed {SEED}, {datetime.date.today()}; "
            f"{options.replicates} replicates with the errors in the fitted model and "
            f"{len(bare['errors'])} without them;"
        ),
        (
            f"{SAMPLES} samples at {1 / STEP:g} Hz of an accelerometer (delay half a sample, gain "
            f"1.002, bias {CHAIN['bias']} m/s2) and an"
            ' LVDT, 40 dB. "Coverage": percent of'
        ),
        "replicates whose 95 % interval contains the true value.",
        "",
        *report(modeled, bare),
    ]
    print("\n".join(page))
    print(f"{time.perf_counter() - begin:.0f} s")
    if options.write:
        (Path(__file__).parent / "transducers.md").write_text("\n".join(page) + "\n")


if __name__ == "__main__":
    main()
