"""Models of many sizes in everything that computes, in a process of its own, which prints each
job's name before the job starts: one that ends the process is known by name.

python tests/size_jobs.py "chain of 21: modes" "chain of 21: modes in a grad" "chain of 2 by
Kvaerno5: simulate in a jit"
"""

import os
import subprocess
import sys
import time
from collections.abc import Callable, Iterable
from dataclasses import dataclass
from functools import cache, partial
from typing import Any

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import optimistix
import scipy.linalg

import jaxbody as jb

TIMES = np.linspace(0.0, 0.05, 6)
BATCH = np.array([1.0, 0.9, 1.15])
STEP = 1e-3  # of differences
CLOSE = 1e-9  # relative to the largest number
LONGEST = 2400  # s, for one process
METHOD = optimistix.LevenbergMarquardt(rtol=1e-10, atol=1e-10)


# Models


def chain(n: int) -> jb.Model:
    """Equal masses on a guide, each on a spring from the one before, the first one on one from
    the world."""
    names = [f"b{i}" for i in range(n)]
    return jb.Model(
        bodies={
            name: jb.Body(mass=1.0, inertia=[1, 1, 1], position=[i + 1.0, 0, 0])
            for i, name in enumerate(names)
        },
        joints={name: jb.Guide("world", axis="x") for name in names},
        elements={
            f"s{i}": jb.Spring(
                (b, [0, 0, 0]), (a, [0, 0, 0]), stiffness=1e3, free_length=1.0, damping=2.0
            )
            for i, (a, b) in enumerate(zip(["world", *names], names, strict=False))
        },
    )


def frequencies_of_chain(n: int):
    return (
        2
        * np.sqrt(1e3)
        * np.sin((2 * np.arange(1, n + 1) - 1) * np.pi / (2 * (2 * n + 1)))
        / (2 * np.pi)
    )


DIRECTIONS = np.array([1e3, 1.3e3, 1.6e3, 12.0, 15.0, 18.0])  # N/m, N m/rad
INERTIA = 0.01


def on_bushings(n: int) -> jb.Model:
    """Free bodies of different masses, each on a bushing."""
    at = [[float(i), 0, 0] for i in range(n)]
    return jb.Model(
        bodies={
            f"b{i}": jb.Body(mass=1 + i / n, inertia=[INERTIA * (1 + i / n)] * 3, position=p)
            for i, p in enumerate(at)
        },
        elements={
            f"c{i}": jb.Bushing((f"b{i}", [0, 0, 0]), ("world", p), stiffness=np.diag(DIRECTIONS))
            for i, p in enumerate(at)
        },
    )


def frequencies_on_bushings(n: int):
    mass = 1 + np.arange(n)[:, None] / n
    return np.sort(np.sqrt(DIRECTIONS / (mass * np.repeat([1.0, INERTIA], 3))).ravel()) / (
        2 * np.pi
    )


LEVERS = (
    np.array([[0.0, 0, 0], [0.3, 0, 0], [0, 0.25, 0.1], [0.1, -0.2, 0.2]]),
    np.array([0.02, 0.03, 0.04]),
)  # m, kg m2


def springs_of(n: int, bodies: int):
    """(body, its end, direction) of each spring, all around."""
    for i in range(n):
        z, turn = 1 - (2 * i + 1) / n, i * np.pi * (3 - 5**0.5)
        yield (
            i % bodies,
            LEVERS[0][i // bodies % 4],
            np.array([*(np.sqrt(1 - z * z) * np.array([np.cos(turn), np.sin(turn)])), z]),
        )


def on_springs(n: int, bodies: int) -> jb.Model:
    """Free bodies on relaxed springs from the world."""
    at = [np.array([2.0 * i, 0, 0]) for i in range(bodies)]
    return jb.Model(
        bodies={
            f"b{i}": jb.Body(mass=1 + i / bodies, inertia=LEVERS[1], position=p)
            for i, p in enumerate(at)
        },
        elements={
            f"s{i}": jb.Spring(
                (f"b{b}", a), ("world", at[b] + a + u), stiffness=500.0, free_length=1.0
            )
            for i, (b, a, u) in enumerate(springs_of(n, bodies))
        },
    )


def frequencies_on_springs(n: int, bodies: int):
    """By K = sum of k w w^T with w = (u, a x u)."""
    K = np.zeros((bodies, 6, 6))
    for b, a, u in springs_of(n, bodies):
        w = np.concatenate([u, np.cross(a, u)])
        K[b] += 500.0 * np.outer(w, w)
    M = [np.diag([1 + i / bodies] * 3 + list(LEVERS[1])) for i in range(bodies)]
    squares = np.concatenate(
        [scipy.linalg.eigh(k, m, eigvals_only=True) for k, m in zip(K, M, strict=True)]
    )
    return np.sqrt(np.sort(squares)) / (2 * np.pi)


# with natural frequencies [Hz]
SIZES: dict[str, tuple[Callable[[], jb.Model], Callable[[], Any]]] = {
    **{
        f"chain of {n}": (partial(chain, n), partial(frequencies_of_chain, n))
        for n in (1, 2, 10, 21, 40, 60)
    },
    **{
        f"{n} on bushings": (partial(on_bushings, n), partial(frequencies_on_bushings, n))
        for n in (1, 6, 20, 60)
    },
    **{
        f"{b} on {n} springs": (partial(on_springs, n, b), partial(frequencies_on_springs, n, b))
        for b, n in ((1, 10), (1, 500), (5, 200))
    },
}
PRESETS = {name: getattr(jb.presets, name) for name in dir(jb.presets)}
CONSTANT = {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": 1e-3}
SOLVERS = {  # those that pages and docstrings name first
    "Dopri8": {"solver": diffrax.Dopri8()},
    "Tsit5": {"solver": diffrax.Tsit5()},
    "Heun": {"solver": diffrax.Heun(), "rtol": 1e-6},
    "Kvaerno5": {"solver": diffrax.Kvaerno5()},
    "Gauss": {"solver": jb.Gauss(stages=3), **CONSTANT},
    "Kvaerno3": {"solver": diffrax.Kvaerno3(), "rtol": 1e-5},
    "Dopri5": {"solver": diffrax.Dopri5(), "rtol": 1e-6},
    "constant steps": {"solver": diffrax.Tsit5(), **CONSTANT},
}


@dataclass(frozen=True, eq=False)
class Case:
    """A model by x, which multiplies the mass of its first body; that body is pushed at its center
    of mass, as its O may be in a hinge."""

    model: jb.Model
    options: dict[str, Any]
    first: str
    mass: float
    center: np.ndarray

    @property
    def path(self) -> str:
        return f"{self.first}.mass"

    @property
    def run(self) -> dict[str, Any]:
        return {
            "loads": {
                "push": jb.Force(
                    (self.first, self.center), force=self.mass * np.array([1.0, 0.7, 1.3])
                )
            },
            "initial": "rest",
        }

    def by(self, x) -> jb.Model:
        return jb.replace(self.model, {self.path: x * self.mass})


@cache
def case_of(name: str) -> Case:
    """Of "chain of 2" or "chain of 2 by Kvaerno5"."""
    name, _, solver = name.partition(" by ")
    model = SIZES[name][0]() if name in SIZES else PRESETS[name]()
    first = model.layout.bodies[0]
    return Case(
        model,
        SOLVERS[solver] if solver else {},
        first,
        float(model[first].mass),
        np.asarray(model[first].com),
    )


# Functions of x


def equilibrium(case: Case, x):
    return jb.equilibrium(case.by(x)).state.q


def linearize(case: Case, x):
    lin = jb.linearize(model := case.by(x), model.reference)
    return jnp.stack([lin.M, lin.C, lin.K])


def modes(case: Case, x):
    return jb.modes(jb.linearize(model := case.by(x), jb.equilibrium(model))).frequency


def simulate(case: Case, x):
    return jb.simulate(case.by(x), TIMES, **case.run, **case.options).state.q


def fit(case: Case, x):
    """x, found again from the motion of the first body, from 1.1 x on."""
    sensors = {"place": jb.Position(case.first, case.center)}
    measured = jb.measure(jb.simulate(case.by(x), TIMES, **case.run, **case.options), sensors)
    run = jb.Experiment(TIMES, sensors=sensors, measured=measured, noise=1e-6, **case.run)
    method = METHOD if isinstance(x, jax.core.Tracer) else "least_squares"
    guess = case.by(1.1 * jax.lax.stop_gradient(x))
    return (
        jb.fit(guess, {"run": run}, free=[case.path], method=method, **case.options).estimates[
            case.path
        ]
        / case.mass
    )


FUNCTIONS = {f.__name__: f for f in (equilibrium, linearize, modes, simulate, fit)}


# Ways to call them: {"value" or "slope": result at x = 1}


def slope(function, x):
    """The derivative of the mean; a fit has forward mode only."""
    return (
        jax.jacfwd(function)(x)
        if function.func is fit
        else jax.grad(lambda x: function(x).mean())(x)
    )


def in_batch_of_slopes(function):
    values, slopes = jb.jit(jax.vmap(lambda x: (function(x), slope(function, x))))(BATCH)
    return {"value": values[0], "slope": slopes[0]}


WAYS = {
    "": lambda f: {"value": f(1.0)},
    " in a vmap": lambda f: {"value": jax.vmap(f)(BATCH)[0]},
    " in a grad": lambda f: {"slope": slope(f, 1.0)},
    " in a jit": lambda f: {"value": jax.jit(f)(1.0)},
    " in a grad in a jit": lambda f: {"slope": jb.jit(partial(slope, f))(1.0)},
    " with its grad in a vmap in a jit": in_batch_of_slopes,
}
OUTSIDE_AND_INSIDE = ("", " with its grad in a vmap in a jit")


def done(name: str, earlier: dict) -> None:
    """Does a job, such as "chain of 21: modes in a grad"; raises where a result is another one
    than elsewhere."""
    of, _, words = name.partition(": ")
    called, _, way = words.partition(" ")
    function = partial(FUNCTIONS[called], case_of(of))
    for kind, result in WAYS[f" {way}" if way else ""](function).items():
        result = np.asarray(result)
        assert np.isfinite(result).all(), f"{kind} is not finite"
        # a hundredth of a standard error: where a method may stop
        tolerance = 1e-5 if called == "fit" else CLOSE
        size = max(
            np.abs(result).max(),
            np.abs(earlier[of, called, "value"]).max() if (of, called, "value") in earlier else 0,
        )
        expected = {}
        if (of, called, kind) in earlier:
            expected["that of an earlier way"] = earlier[of, called, kind], tolerance * size + 1e-12
        elif called == "fit":
            expected["1"] = 1.0, tolerance
        elif kind == "slope":
            ahead, behind = (np.asarray(function(1 + h)) for h in (STEP, -STEP))
            expected["a difference"] = (
                (ahead - behind).mean() / (2 * STEP),
                1e-5 * np.abs(ahead).max() + 1e-12,
            )
        elif called == "modes" and of in SIZES:
            expected["the closed form"] = SIZES[of][1](), tolerance * size
        for what, (numbers, near) in expected.items():
            off = np.abs(result - numbers).max()
            assert off <= near, f"{kind} differs from {what} by {off:.3g}, more than {near:.3g}"
        earlier.setdefault((of, called, kind), result)


def main(names: list[str]) -> None:
    jax.config.update("jax_enable_x64", True)
    earlier: dict = {}
    for name in names:
        print(name, end=" -> ", flush=True)
        begin = time.perf_counter()
        try:
            done(name, earlier)
        except Exception as error:  # the other jobs are of interest, too
            print(f"{type(error).__name__}: {' '.join(str(error).split())[:300]}", flush=True)
        else:
            print(f"ok, {time.perf_counter() - begin:.1f} s", flush=True)


def failures(names: list[str]) -> list[str]:
    """Lines about jobs that failed in a process of their own; about one that ended the process, or
    ran on, and those after it."""
    # what users run, not the quick options of the quick tests
    environment = os.environ | {"XLA_FLAGS": ""}
    with subprocess.Popen(
        [sys.executable, "-W", "ignore", __file__, *names],
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
    ) as process:
        try:
            output, errors = process.communicate(timeout=LONGEST)
        except subprocess.TimeoutExpired:
            process.kill()
            output, errors = process.communicate()
    print(output)
    lines = [line for line in output.splitlines() if " -> ok" not in line]
    begun = len(output.splitlines())
    if process.returncode:
        why = [line for line in errors.splitlines() if "Check failed" in line or "Error" in line]
        lines.append(
            f"... ended the process with {process.returncode}: {why[-1] if why else errors[-600:]}"
        )
    return lines + [f"{name} was not run" for name in names[begun:]]


def jobs(case: str, functions: str, ways: Iterable[str] = WAYS) -> list[str]:
    """Names of jobs: functions in these ways."""
    return [f"{case}: {function}{way}" for function in functions.split() for way in ways]


if __name__ == "__main__":
    main(sys.argv[1:])
