"""Noise-free recovery: random bodies on random springs, fitted from starts thirty percent off, and
the reports of undetermined parameters.

    python tests/benchmarks/recovery.py [--problems 200] [--seed 0]

Every problem is a body on four spring-dampers under a base that translates and rotates. Four
stiffnesses, four dampings and the mass are unknown; the data are the motion of one point. In every
fourth problem two springs are parallel, so that the data determine only their sums. The singular
values of a Jacobian by central differences of `simulate` at the true parameters show which problems
can be solved; recovered means every parameter to 1e-8.
"""

import argparse
import time
import warnings

import jax
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)

PATHS = (*(f"s{i}.stiffness" for i in range(4)), *(f"s{i}.damping" for i in range(4)), "body.mass")
TIMES = np.linspace(0.0, 2.0, 81)
RTOL = 1e-12
# relative singular values below which a direction is null, and above which it is known
NULL, UNSURE = 1e-7, 1e-5


def problem(rng, beside: bool):
    """(model, truth, motion, sensor) of one problem."""
    mass = rng.uniform(5, 20)
    size = rng.uniform(0.2, 0.5, 3)
    inertia = (
        mass
        / 3
        * np.array(
            [size[1] ** 2 + size[2] ** 2, size[0] ** 2 + size[2] ** 2, size[0] ** 2 + size[1] ** 2]
        )
    )
    corners = (
        np.array([[1, 1, 1], [1, -1, 1], [-1, 1, 1], [-1, -1, 1]])
        * size
        * rng.uniform(0.7, 1.0, (4, 3))
    )
    # it hangs: standing, some would fall
    feet = corners * [1.5, 1.5, 1.0] + [0, 0, 0.4] + rng.uniform(-0.1, 0.1, (4, 3))
    if beside:
        corners[3], feet[3] = corners[2], feet[2]
    stiffness, damping = 10 ** rng.uniform(2.5, 3.5, 4), 10 ** rng.uniform(0.5, 1.3, 4)
    model = jb.Model(
        bodies={"body": jb.Body(mass=mass, inertia=inertia)},
        supports={"base": jb.Support()},
        elements={
            f"s{i}": jb.Spring(
                ("body", a), ("base", b), stiffness=k, free_length=np.linalg.norm(b - a), damping=c
            )
            for i, (a, b, k, c) in enumerate(zip(corners, feet, stiffness, damping, strict=True))
        },
        gravity=[0, 0, -9.81],
    )
    shake = jb.Harmonic(
        frequency=rng.uniform(1, 3),
        translation=rng.uniform(-0.02, 0.02, 3),
        rotation=rng.uniform(-0.05, 0.05, 3),
    )
    return (
        model,
        np.array([*stiffness, *damping, mass]),
        {"base": shake},
        {"x": jb.Position("body", rng.uniform(-0.3, 0.3, 3))},
    )


def values_of(values):
    return dict(zip(PATHS, values, strict=True))


def singular_values(model, truth, motion, sensors):
    """Of the Jacobian in logarithms, by central differences."""

    def reading(values):
        trajectory = jb.simulate(
            jb.replace(model, values_of(values)), TIMES, motion=motion, rtol=RTOL
        )
        return np.asarray(jb.measure(trajectory, sensors)["x"]).ravel()

    h = 1e-4
    columns = [
        (reading(truth * np.exp(h * e)) - reading(truth * np.exp(-h * e))) / (2 * h)
        for e in np.eye(len(truth))
    ]
    S = np.linalg.svd(np.stack(columns, 1), compute_uv=False)
    return S / S[0]


def solve(rng, beside: bool):
    """(least singular value, largest error of a parameter, the fit)."""
    model, truth, motion, sensors = problem(rng, beside)
    trajectory = jb.simulate(model, TIMES, motion=motion, rtol=RTOL)
    run = jb.Experiment(
        TIMES, motion=motion, sensors=sensors, measured=jb.measure(trajectory, sensors), noise=1e-3
    )
    start = truth * rng.uniform(0.7, 1.3, len(truth))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        fit = jb.fit(jb.replace(model, values_of(start)), {"run": run}, free=PATHS, rtol=RTOL)
    result = np.array([float(fit.estimates[path]) for path in PATHS])
    return singular_values(model, truth, motion, sensors)[-1], np.abs(result / truth - 1).max(), fit


def main(problems: int, seed: int):
    rng = np.random.default_rng(seed)
    rows, begin = [], time.perf_counter()
    for i in range(problems):
        least, error, fit = solve(rng, beside=i % 4 == 3)
        rows.append((least, error, int(fit.status)))
        if i % 20 == 19:
            print(f"{i + 1} of {problems}, {time.perf_counter() - begin:.0f} s", flush=True)
    least, error, status = (np.array(x) for x in zip(*rows, strict=True))
    full, null = least > UNSURE, least < NULL
    recovered = full & (error < 1e-8) & (status == 0)
    flagged = null & (status == jb.Status.NOT_IDENTIFIABLE)
    print(
        f"seed {seed}: {full.sum()} of full rank, {recovered.sum()} recovered to 1e-8 "
        f"({100 * recovered.sum() / full.sum():.1f} %)"
    )
    print(
        f"{null.sum()} with a null direction, {flagged.sum()} flagged; "
        f"{(~full & ~null).sum()} between"
    )
    print(
        f"of full rank: median error {np.median(error[full]):.1e}, largest "
        f"{error[full].max():.1e}; wrongly flagged",
        (status[full] == 7).sum(),
    )
    for i in np.flatnonzero(full & ~recovered | null & ~flagged):
        print(
            f"  problem {i}: least singular value {least[i]:.1e}, error {error[i]:.1e}, "
            f"{jb.Status(status[i]).name}"
        )
    return full, recovered, null, flagged


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--problems", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    main(**vars(parser.parse_args()))
