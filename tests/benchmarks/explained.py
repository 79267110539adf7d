"""Fits of records with blunders, none of which may be ok, and of honest records in noise, none of
which may be FAR_OFF.

`python tests/benchmarks/explained.py` fits stiffnesses and dampings of a table on a shaker, with a
wheel that runs down, to an accelerometer, two displacements and an encoder: `--count` times with
one blunder each (a sign, exchanged cables, a unit, an encoder that starts again after a turn, a
record of another run) and as often without, with noise of 0 to 30 % of each signal. Truth, guess,
noise and base motion are drawn. `--write` puts the table into explained.md.
"""

import argparse
import datetime
import time
import warnings
from collections import Counter
from pathlib import Path

import jax
import numpy as np

import jaxbody as jb

SEED, STEP, SAMPLES = 2026, 0.02, 401
FREE = [
    "lower.stiffness",
    "lower.damping",
    "upper.stiffness",
    "upper.damping",
    "drag.damper.coefficient",
]
TRUTH = {
    "lower.stiffness": 900.0,
    "lower.damping": 12.0,
    "upper.stiffness": 400.0,
    "upper.damping": 5.0,
    "drag.damper.coefficient": 0.05,
}
UNITS = {
    "thousandths": 1e3,
    "thousands": 1e-3,
    "degrees": 180 / np.pi,
    "inches": 1 / 0.0254,
    "m/s2 for g": 9.80665,
    "g": 1 / 9.80665,
}
NOISE = 0.3  # largest, of the standard deviation of each signal
SCATTER = 0.15  # of the logarithms of the guess
TIMES = STEP * np.arange(SAMPLES)
SENSORS = {
    "acc": jb.Accelerometer("top", axis=[0, 0, 1]),
    "low": jb.sensors.Displacement("table", "base", axis=[0, 0, 1]),
    "high": jb.sensors.Displacement("top", "base", axis=[0, 0, 1]),
    "turn": jb.sensors.JointAngle("wheel"),
}
INITIAL = jb.State(q=np.zeros(3), v=np.array([0.0, 0.0, 12.0]))  # the wheel spins


def table(values=TRUTH):
    """A table and a top on springs over a shaken base, and a wheel that runs down."""
    model = jb.Model(
        bodies={
            "table": jb.Body(mass=3.0, inertia=[1, 1, 1]),
            "top": jb.Body(mass=1.0, inertia=[1, 1, 1]),
            "wheel": jb.Body(mass=1.0, inertia=[0.1, 0.1, 0.1]),
        },
        supports={"base": jb.Support()},
        joints={
            "table": jb.Guide("world", axis="z"),
            "top": jb.Guide("world", axis="z"),
            "wheel": jb.Hinge("world", axis="z"),
        },
        elements={
            "lower": jb.Spring(
                ("table", [0, 0, 0]),
                ("base", [0, 0, -1]),
                stiffness=900.0,
                damping=12.0,
                free_length=1.0,
            ),
            "upper": jb.Spring(
                ("top", [0, 0, 1]),
                ("table", [0, 0, 0]),
                stiffness=400.0,
                damping=5.0,
                free_length=1.0,
            ),
            "drag": jb.Torsion("wheel", "world", axis="z", damper=0.05),
        },
    )
    return jb.replace(model, values)


def drawn(rng):
    """Truth, guess, motion of the base and clean readings of one case; another run of the same rig
    follows from another draw."""
    truth = {path: x * np.exp(0.3 * rng.normal()) for path, x in TRUTH.items()}
    guess = {path: x * np.exp(SCATTER * rng.normal()) for path, x in truth.items()}
    phases, sizes = rng.uniform(0, 2 * np.pi, 12), rng.uniform(0.5, 1.5, 12)
    tones = np.linspace(0.4, 5.0, 12)
    z = sum(
        0.003 * a / (1 + f) * (np.sin(2 * np.pi * f * TIMES + p) - np.sin(p))
        for f, a, p in zip(tones, sizes, phases, strict=True)
    )
    motion = {"base": jb.Sampled(TIMES, translation=np.c_[0 * z, 0 * z, z])}
    with warnings.catch_warnings():
        # of half a turn, where the drag has no jump
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        run = jb.simulate(table(truth), TIMES, motion=motion, initial=INITIAL, rtol=1e-9)
    return (
        truth,
        guess,
        motion,
        {name: np.asarray(x) for name, x in jb.measure(run, SENSORS).items()},
    )


def blundered(kind, clean, rng):
    """The readings with one blunder, and its words."""
    name = str(rng.choice(list(SENSORS)))
    if kind == "sign":
        return clean | {name: -clean[name]}, name
    if kind == "exchanged":
        return clean | {"low": clean["high"], "high": clean["low"]}, "low and high"
    if kind == "unit":
        unit = str(rng.choice(list(UNITS)))
        return clean | {name: UNITS[unit] * clean[name]}, f"{name} in {unit}"
    if kind == "wrapped":
        degrees = bool(rng.integers(2))
        wrapped = (clean["turn"] + np.pi) % (2 * np.pi) - np.pi
        return clean | {
            "turn": np.rad2deg(wrapped) if degrees else wrapped
        }, "degrees" if degrees else "radians"
    return clean | {name: drawn(rng)[3][name][::-1]}, name


def case(kind, seed):
    """The fit of one case, with its true values, its blunder and the share of noise."""
    rng = np.random.default_rng([SEED, seed])
    truth, guess, motion, clean = drawn(rng)
    record, words = (clean, "") if kind == "honest" else blundered(kind, clean, rng)
    level = rng.uniform(0, NOISE)
    noisy = {
        name: x + level * clean[name].std() * rng.normal(size=x.shape) for name, x in record.items()
    }
    if kind == "wrapped":
        noisy["turn"] = record["turn"] + 1e-3 * rng.normal(size=SAMPLES)  # an encoder
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        run = jb.Experiment(TIMES, motion=motion, initial=INITIAL, sensors=SENSORS, measured=noisy)
        fit = jb.fit(
            table(guess),
            {"run": run},
            free=FREE,
            max_evaluations=40,
            max_steps=1000,
            progress=False,
        )
    return fit, truth, words, level


KINDS = ("sign", "exchanged", "unit", "wrapped", "unrelated")


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument(
        "--count", type=int, default=200, help="of blunders, and of honest records (default: 200)"
    )
    parser.add_argument("--write", action="store_true", help="write explained.md")
    options = parser.parse_args()
    jax.config.update("jax_enable_x64", True)
    started, rows, wrong = time.time(), {}, []
    for i in range(options.count):
        for kind in (KINDS[i % len(KINDS)], "honest"):
            fit, truth, words, level = case(kind, i)
            status = jb.Status(int(fit.status)).name
            rows.setdefault(kind, Counter())[status] += 1
            bad = status == "FAR_OFF" if kind == "honest" else status == "OK"
            if bad:
                wrong.append((kind, i, words, level))
                print("WRONG", kind, i, words, f"noise {level:.2f}", fit.report()[:300], flush=True)
            elif kind == "honest":
                inside = all(abs(float(fit.estimates[p]) / x - 1) < 0.5 for p, x in truth.items())
                rows[kind]["near the truth"] += inside
        print(
            f"{i + 1} of {options.count}, {time.time() - started:.0f} s, {len(wrong)} wrong",
            flush=True,
        )
    lines = [
        "# Records with blunders, and honest ones",
        "",
        (
            f"`tests/benchmarks/explained.py`, seed {SEED}, {datetime.date.today()}; "
            f"{options.count} records with one blunder each and"
        ),
        (
            f"{options.count} without, noise of 0 to {100 * NOISE:.0f} % of each signal. "
            f"Wrong: {len(wrong)}."
        ),
        "",
        "| record | fits | status |",
        "|---|---|---|",
    ]
    for kind, counts in rows.items():
        near = counts.pop("near the truth", None)
        note = "" if near is None else f"; {near} within 50 % of all true values"
        lines.append(
            f"| {kind} | {sum(counts.values())} | "
            f"{', '.join(f'{name} {n}' for name, n in counts.most_common())}{note} |"
        )
    print("\n".join(lines))
    if options.write:
        Path(__file__).with_suffix(".md").write_text("\n".join(lines) + "\n")


if __name__ == "__main__":
    main()
