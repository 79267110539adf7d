"""A ride with a skyhook actuator over the passive ride, and designs with their optimal controllers:
`python tests/benchmarks/controlled_rides.py`.

The quarter car of tests/controlled_cars.py; medians of rounds in which both rides take turns,
after a check that they differ by what the skyhook does.
"""

import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from controlled_cars import OUTPUTS, ROAD, WHITE, quarter_car

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
ROUNDS, DESIGNS = 31, 1000
TIMES = np.linspace(0.0, 10.0, 501)
UNEVEN = jb.Harmonic(frequency=1.3, translation=[0, 0, 0.01])


def ride(model):
    @jax.jit
    def run(k):
        here = jb.replace(model, {"spring.spring.coefficient": k})
        return jb.simulate(here, TIMES, motion={"road": UNEVEN}, rtol=1e-6).state.q

    return run


def cost(p):
    model = jb.replace(
        quarter_car(), {"spring.spring.coefficient": p[0], "spring.damper.coefficient": p[1]}
    )
    return jb.control.lqr(
        jb.linearize(model, model.reference),
        {"acceleration": 1.0, "travel": 1e4, "tyre": 1e5},
        {"u": 1e-6},
        inputs={"u": jb.Command("drive")} | ROAD,
        outputs=OUTPUTS,
        noise={"road": WHITE},
    ).cost


def timed(call):
    start = time.perf_counter()
    jax.block_until_ready(call())
    return time.perf_counter() - start


def main():
    passive = jb.Model(
        **{k: x for k, x in quarter_car().parts().items() if k not in ("elements", "controllers")},
        elements={k: x for k, x in quarter_car().parts()["elements"].items() if k != "drive"},
    )
    rides = {
        "passive": ride(passive),
        "skyhook": ride(quarter_car(law=jb.control.skyhook(2000.0))),
        "skyhook, bandwidth 20 Hz": ride(
            quarter_car(jb.Actuator("wheel", "body", bandwidth=20.0), jb.control.skyhook(2000.0))
        ),
    }
    swings = {name: float(jnp.ptp(run(16e3)[-100:, 0])) for name, run in rides.items()}
    assert swings["skyhook"] < 0.6 * swings["passive"], swings
    calls = [lambda run=run: run(16e3) for run in rides.values()]
    medians = np.median([[timed(call) for call in calls] for _ in range(ROUNDS)], 0)
    for name, t in zip(rides, medians, strict=True):
        print(f"{name:26s} {t * 1e3:8.2f} ms, {t / medians[0]:.2f} of the passive ride")

    p = jnp.stack([jnp.linspace(8e3, 30e3, DESIGNS), jnp.linspace(600.0, 2500.0, DESIGNS)], 1)
    for what, function in (("cost", cost), ("cost and its gradient", jax.value_and_grad(cost))):
        many = jax.jit(jax.vmap(function))
        values = jax.tree.leaves(many(p))
        assert all(np.isfinite(x).all() for x in values)
        np.testing.assert_allclose(values[0][::333], [cost(x) for x in p[::333]], rtol=1e-9)
        t = np.median([timed(lambda many=many: many(p)) for _ in range(5)])
        print(f"{what:26s} {DESIGNS / t:8.0f} designs a second")


if __name__ == "__main__":
    main()
