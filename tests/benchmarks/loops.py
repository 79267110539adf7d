"""Closed loops: a corner's time per step beside that of a tree of as many bodies, derivatives of
equilibria and curves by hard points beside their values, a second of a full car over a kerb.

`python tests/benchmarks/loops.py [step] [curves] [design] [car]` prints medians and least times of
warm calls, in milliseconds. Limits: a step within 4 times that of the tree, derivatives within 3
times their values.
"""

import sys
import time
import warnings
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb
from jaxbody.suspension.suspensions import DOUBLE_WISHBONE

jax.config.update("jax_enable_x64", True)
TESTS = Path(__file__).parents[1]
sys.path[:0] = [str(TESTS), str(TESTS / "judges")]
ROUNDS = 15
KERB = 0.02  # m


def warm(function):
    """Median and least time of a call [ms]."""
    jax.block_until_ready(function())
    spent = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        jax.block_until_ready(function())
        spent.append(1e3 * (time.perf_counter() - begin))
    return float(np.median(spent)), min(spent)


def step():
    """Half a second of a double wishbone that its spring lifts, and of the same bodies
    without closures."""
    model, times = jb.suspension.double_wishbone().model, np.linspace(0.0, 0.5, 51)
    names = model.layout.bodies
    tree = jb.Model(
        bodies={name: model[name] for name in names},
        joints={name: model.joint(name) for name in names},
        elements={"spring": model["spring"]},
    )
    per_step = {}
    for name, each in (("corner", model), ("tree of as many bodies", tree)):
        run = jb.simulate(each, times)
        taken = sum(int(run.statistics[f"num_{kind}_steps"]) for kind in ("accepted", "rejected"))
        median, least = warm(lambda each=each: jb.simulate(each, times).state.q)
        per_step[name] = least / taken
        print(
            f"{name}: {taken} steps, {median:.1f} ms, least {least:.1f} ms, "
            f"{1e3 * least / taken:.1f} us a step"
        )
    one, other = per_step.values()
    print(f"ratio of least times per step {one / other:.2f} (limit 4)")


def compared(name, function, with_slopes):
    """How much longer a function takes with its derivatives."""
    one, other = warm(function), warm(with_slopes)
    print(
        f"{name}: {one[0]:.2f} ms, least {one[1]:.2f}; with derivatives {other[0]:.2f} ms, "
        f"least {other[1]:.2f}"
    )
    print(f"ratio of least times {other[1] / one[1]:.2f} (limit 3)", flush=True)


def with_rows_of_slopes(of, points):
    """(values, derivatives by the points) of a vector-valued function of a travel and the points:
    reverse mode at each travel by itself."""

    def at(travel):
        def twice(points):
            found = of(travel, points)
            return found, found

        slopes, found = jax.jacrev(twice, has_aux=True)(points)
        return found, slopes

    return jax.vmap(at)


def curves():
    """Toe and camber at eleven travels, and their derivatives by the 36 coordinates of twelve
    hard points."""
    travel = np.linspace(-0.08, 0.08, 11)
    points = {name: jnp.array(point) for name, point in DOUBLE_WISHBONE.items()}

    def toe_and_camber(travel, points):
        found = jb.suspension.double_wishbone(points).curves(travel)
        return jnp.stack([found["toe"], found["camber"]])

    alone = jax.jit(lambda x: toe_and_camber(travel, x))
    reverse = jax.jit(
        lambda x: with_rows_of_slopes(lambda t, x: toe_and_camber(t, x)[:, 0], x)(travel)
    )
    forward = jax.jit(
        lambda x: (toe_and_camber(travel, x), jax.jacfwd(lambda x: toe_and_camber(travel, x))(x))
    )
    compared("curves of a corner, reverse mode", lambda: alone(points), lambda: reverse(points))
    compared("curves of a corner, forward mode", lambda: alone(points), lambda: forward(points))


def design():
    """Of the full car: load of a tyre in equilibrium, the sum of its seven lowest frequencies, toe
    and camber of a wheel at eleven travels, by the 60 coordinates of twenty hard points."""
    car, travel = jb.suspension.car_on_double_wishbones(), np.linspace(-0.05, 0.05, 11)
    points = {
        name: at
        for name, at in car.hard_points.items()
        if not name.endswith(("axle inner", "wheel center"))
    }

    def load(points):
        return jb.equilibrium(car.moved(points).model).forces["tyre fl"]

    def frequencies(points):
        model = car.moved(points).model
        return jnp.sum(jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[:7])

    for name, of in (("load in equilibrium", load), ("frequencies", frequencies)):
        alone, both = jax.jit(of), jax.jit(jax.value_and_grad(of))
        compared(
            f"{name} of the car", lambda alone=alone: alone(points), lambda both=both: both(points)
        )

    def toe_and_camber(travel, points):
        found = car.moved(points).curves("fl", travel)
        return jnp.stack([found["toe"], found["camber"]])

    alone = jax.jit(lambda x: toe_and_camber(travel, x))
    both = jax.jit(
        lambda x: with_rows_of_slopes(lambda t, x: toe_and_camber(t, x)[:, 0], x)(travel)
    )
    compared("curves of the car", lambda: alone(points), lambda: both(points))


def car():
    """A second of the full car whose front left wheel goes over a kerb of 2 cm, from its
    equilibrium, which is its reference pose; beside Exudyn where it is installed. Errors are
    largest distances of car and hub at the end from those with rtol 1e-12. Without anti-roll bars,
    which Exudyn has not."""
    model, times = (
        jb.suspension.car_on_double_wishbones(anti_roll=(1e-6, 1e-6)).model,
        np.linspace(0.0, 1.0, 101),
    )
    motion = {
        "road fl": lambda t: (
            KERB * jnp.clip((t - 0.1) / 0.05, 0, 1) * np.array([0, 0, 1.0, 0, 0, 0])
        )
    }

    def end(run):
        return np.concatenate([np.asarray(run.poses[name].p[-1]) for name in ("car", "fl upright")])

    exact = end(jb.simulate(model, times, motion=motion, rtol=1e-12))
    for rtol in (1e-4, 1e-6, None):
        options = {} if rtol is None else {"rtol": rtol}
        run = jb.simulate(model, times, motion=motion, **options)
        taken = sum(int(run.statistics[f"num_{kind}_steps"]) for kind in ("accepted", "rejected"))
        median, least = warm(
            lambda options=options: jb.simulate(model, times, motion=motion, **options).state.q
        )
        print(
            f"rtol {rtol or 'by default'}: {taken} steps, {median:.0f} ms, least {least:.0f}, "
            f"error {np.abs(end(run) - exact).max():.1e} m",
            flush=True,
        )
    try:
        from car_in_exudyn import Car
    except ImportError:
        print("Exudyn is not installed: pip install 'jaxbody[judges]'")
        return
    for steps in (1000, 2000, 4000, 8000):
        runs = [
            Car(model, {"fl": lambda t: KERB * np.clip((t - 0.1) / 0.05, 0, 1)}).motion(1.0, steps)
            for _ in range(3)
        ]
        place, least = runs[0][0], 1e3 * min(spent for _, spent in runs)
        print(
            f"Exudyn, {steps} steps: least {least:.0f} ms, error "
            f"{np.abs(place - exact).max():.1e} m",
            flush=True,
        )


def main():
    warnings.simplefilter("ignore", jb.JaxbodyWarning)
    for name in sys.argv[1:] or ("step", "curves", "design", "car"):
        {"step": step, "curves": curves, "design": design, "car": car}[name]()


if __name__ == "__main__":
    main()
