"""Many bodies with many elements: compile time, and time per step, which must be linear in the
number of elements.

`python tests/benchmarks/many.py` simulates chains of 5 to 50 bodies with four elements each,
springs and struts with laws, on a moving base with constant steps. The table compares the ratio of
the time per step to that of the smallest chain with the ratio of the numbers of elements.
"""

import time

import diffrax
import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb
from jaxbody import laws

jax.config.update("jax_enable_x64", True)
STEPS, ROUNDS = 200, 7


def chain(n):
    """n bodies, each on four elements from the one below (the first from the base): two springs,
    two struts."""
    rng = np.random.default_rng(0)
    bodies = {
        f"b{i}": jb.Body(mass=2.0, inertia=[0.02, 0.03, 0.04], position=[0, 0, 0.5 * (i + 1)])
        for i in range(n)
    }
    elements = {}
    for i in range(n):
        below = f"b{i - 1}" if i else "base"
        for j, (x, y) in enumerate([(0.2, 0.2), (-0.2, 0.2), (-0.2, -0.2), (0.2, -0.2)]):
            ends = (
                (f"b{i}", [x, y, 0]),
                (below, [x + 0.1 * rng.normal(), y + 0.1 * rng.normal(), 0]),
            )
            if j < 2:
                elements[f"e{i}{j}"] = jb.Spring(*ends, stiffness=2e4, free_length=0.5, damping=5.0)
            else:
                law = laws.Polynomial([2e4, 0.0, 1e6])
                elements[f"e{i}{j}"] = jb.SpringDamper(
                    *ends, spring=law, damper=laws.TwoSided(bump=4.0, rebound=8.0), free_length=0.5
                )
    return jb.Model(
        bodies=bodies, supports={"base": jb.Support()}, elements=elements, gravity=[0, 0, -9.81]
    )


def main():
    motion = {"base": jb.Harmonic(frequency=3.0, translation=[0.01, 0, 0.005])}
    times = jnp.linspace(0.0, STEPS * 1e-4, 2)
    runs, rows = {}, []
    for n in (5, 10, 25, 50):
        model = chain(n)

        @jax.jit
        def run(model):
            options = dict(
                solver=diffrax.Dopri8(), stepsize_controller=diffrax.ConstantStepSize(), dt0=1e-4
            )
            return jb.simulate(model, times, motion=motion, **options).state.q[-1]

        begin = time.perf_counter()
        q = run(model).block_until_ready()
        rows.append((n, len(model.element_names), time.perf_counter() - begin))
        assert np.isfinite(q).all()
        runs[n] = (run, model)
    spent = {n: [] for n in runs}
    for _ in range(ROUNDS):  # in turn
        for n, (run, model) in runs.items():
            begin = time.perf_counter()
            run(model).block_until_ready()
            spent[n].append((time.perf_counter() - begin) / STEPS)
    per_step = {n: np.median(s) for n, s in spent.items()}
    print(
        f"{'bodies':>8s}{'elements':>10s}{'first result [s]':>18s}{'per step [us]':>16s}"
        f"{'ratio':>8s}{'elements':>10s}"
    )
    for n, m, first in rows:
        print(
            f"{n:8d}{m:10d}{first:18.1f}{1e6 * per_step[n]:16.1f}{per_step[n] / per_step[5]:8.2f}"
            f"{m / 20:10.2f}"
        )


if __name__ == "__main__":
    main()
