"""Random models at rest whose coordinates are zero up to rounding, and what then acts on them: a
step load, gravity, a moving base."""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from typing import Any

import jax.numpy as jnp
import numpy as np
from random_drops import POINT, G, log_uniform
from scipy.linalg import expm

import jaxbody as jb

KINDS = ("car", "mass", "four_bar", "engine", "base")
LIMIT = 100  # errors of linear models, in rtol of the largest motion
SAMPLES = 11


@dataclass
class Start:
    """One case: a model, its initial state, what acts, and, of a linear model, the state matrix and
    the constant rate."""

    kind: str
    rtol: float
    end: float
    model: Any
    initial: Any
    motion: dict = field(default_factory=dict)
    loads: dict = field(default_factory=dict)
    linear: Any = None

    def __str__(self):
        q = np.asarray(self.initial.q)
        return (
            f"{self.kind}, rtol {self.rtol:.2g}, {self.end:.3g} s, q = "
            f"{np.array2string(q, precision=3)}"
        )


def random_start(seed: int, kind: str | None = None) -> Start:
    """A `car` in the equilibrium of its preload under a step load and a `mass` on a spring, up to
    1e-12 m from zero, under gravity, both with the exact motion; a `four_bar` from its reference
    pose under gravity; an `engine` at rest under a step load; a quarter car on a moving `base`.
    rtol is 1e-11 to 1e-6."""
    rng = np.random.default_rng([43, seed])
    kind = kind or KINDS[seed % len(KINDS)]
    rtol, end = log_uniform(rng, 1e-11, 1e-6), log_uniform(rng, 0.2, 2.0)
    return globals()[f"_{kind}"](rng, kind, rtol, end)


def _settled(model):
    """The model with the preload that makes its pose the equilibrium, and this equilibrium."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        model = jb.preload(model).model
        return model, jb.equilibrium(model).state


def _car(rng, kind, rtol, end):
    m1, m2, k1, k2, c = rng.uniform(0.5, 2.0, 5) * [400.0, 40.0, 2e4, 1.8e5, 1200.0]
    push = rng.uniform(100, 1000)
    car = jb.Model(
        bodies={
            "body": jb.Body(m1, inertia=POINT, position=[0, 0, 0.8]),
            "wheel": jb.Body(m2, inertia=POINT, position=[0, 0, 0.3]),
        },
        joints={name: jb.Guide("world", axis="z") for name in ("body", "wheel")},
        elements={
            "suspension": jb.Spring(
                ("body", [0, 0, 0]), ("wheel", [0, 0, 0]), stiffness=k1, damping=c, free_length=0.5
            ),
            "tyre": jb.Spring(
                ("wheel", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=k2, free_length=0.3
            ),
        },
        gravity=[0, 0, -G],
    )
    model, initial = _settled(car)
    stiffness = np.array([[k1, -k1], [-k1, k1 + k2]]) / [[m1], [m2]]
    damping = np.array([[c, -c], [-c, c]]) / [[m1], [m2]]
    linear = (
        np.block([[np.zeros((2, 2)), np.eye(2)], [-stiffness, -damping]]),
        np.array([0, 0, -push / m1, 0]),
    )
    loads = {"push": jb.Force("body", force=[0, 0, -push])}
    return Start(kind, rtol, end, model, initial, loads=loads, linear=linear)


def _mass(rng, kind, rtol, end):
    m, k = log_uniform(rng, 0.1, 1e3), log_uniform(rng, 10, 1e5)
    k = max(k, m * 4.0)  # it does not sink by more than 5 m
    k = min(k, m * 1e4)
    q = 0.0 if rng.random() < 0.1 else float(rng.choice([-1, 1])) * log_uniform(rng, 1e-18, 1e-12)
    length = 2 * m * G / k + 1.0
    model = jb.Model(
        bodies={"mass": jb.Body(m, inertia=POINT)},
        joints={"mass": jb.Guide("world", axis="z")},
        elements={
            "spring": jb.Spring(
                ("mass", [0, 0, 0]),
                ("world", [0, 0, -2 * length]),
                stiffness=k,
                free_length=2 * length,
            )
        },
        gravity=[0, 0, -G],
    )
    linear = np.array([[0, 1.0], [-k / m, 0]]), np.array([0, -G])
    return Start(kind, rtol, end, model, jb.State(q=np.array([q]), v=np.zeros(1)), linear=linear)


def _four_bar(rng, kind, rtol, end):
    a, b, c, d = np.array([0.04, 0.12, 0.08, 0.1]) * rng.uniform(0.9, 1.1, 4)
    model = jb.presets.four_bar(
        crank=a,
        coupler=b,
        rocker=c,
        ground=d,
        angle=rng.uniform(20, 160),
        stiffness=rng.uniform(1, 4),
        gravity=rng.uniform(1, 10),
    )
    return Start(kind, rtol, 0.1 * end, model, model.reference)


def _engine(rng, kind, rtol, end):
    model = jb.presets.engine_on_mounts(mass=139.5 * rng.uniform(0.8, 1.25), gravity=G)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        initial = jb.equilibrium(model).state if rng.random() < 0.5 else model.reference
    return Start(
        kind,
        rtol,
        end,
        model,
        initial,
        loads={"push": jb.Force("engine", force=rng.normal(size=3) * 300)},
    )


def _base(rng, kind, rtol, end):
    car = jb.presets.quarter_car(
        sprung=375 * rng.uniform(0.5, 2),
        unsprung=75 * rng.uniform(0.5, 2),
        damping=rng.uniform(0, 2000),
    )
    initial = jb.State(q=rng.normal(size=2) * 1e-17, v=np.zeros(2))
    shaken = jb.Harmonic(
        frequency=log_uniform(rng, 0.5, 20),
        translation=[0, 0, 0.01],
        translation_phase=float(rng.choice([0, np.pi / 2])),
    )
    return Start(kind, rtol, end, car, initial, motion={"road": shaken})


def judged(start: Start, **options):
    """Status, number of samples that are not finite, steps, and the error of linear models in rtol
    of the largest motion."""
    times = np.linspace(0, start.end, SAMPLES)
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)  # the status says as much
        run = jb.simulate(
            start.model,
            times,
            initial=start.initial,
            motion=start.motion,
            loads=start.loads,
            rtol=jnp.array(start.rtol),
            progress=False,
            **options,
        )
    q, v = np.asarray(run.state.q), np.asarray(run.state.v)
    missing = int((~np.isfinite(np.concatenate([q, v], 1)).all(1)).sum())
    error = np.nan
    if start.linear is not None:
        A, b = start.linear
        n = len(b)
        step = expm(np.block([[A, b[:, None]], [np.zeros((1, n + 1))]]) * times[1])
        y, rows = np.append(np.zeros(n), 1.0), []
        for _ in times:
            rows.append(y[: n // 2])
            y = step @ y
        rows = np.array(rows)
        error = float(np.abs(q - q[:1] - rows).max() / np.abs(rows).max()) / start.rtol
    steps = int(run.statistics["num_accepted_steps"]) + int(run.statistics["num_rejected_steps"])
    return {
        "status": jb.Status(int(run.status)).name,
        "missing": missing,
        "error": error,
        "steps": steps,
    }


def faults(result) -> list[str]:
    wrong = [] if result["status"] == "OK" else [result["status"]]
    wrong += [f"{result['missing']} of {SAMPLES} samples not finite"] if result["missing"] else []
    return wrong + ([f"error {result['error']:.1e} rtol"] if result["error"] > LIMIT else [])
