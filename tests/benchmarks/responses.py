"""Speed of responses: 1000 frequencies from six motions of a base to six of a plate, and the
gradient of a band's rms with respect to thirty parameters.

`python tests/benchmarks/responses.py` prints medians of warm calls in milliseconds. The targets are
2 ms, and 10 ms for the gradient with respect to the stiffness, damping, free length and one point
of five springs.
"""

import sys
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

import jaxbody as jb

sys.path.insert(0, str(Path(__file__).parents[1]))
import rigs

jax.config.update("jax_enable_x64", True)
ROUNDS = 101
DIRECTIONS = ("x", "y", "z", "rx", "ry", "rz")


def warm(function, *args):
    """Median and least time of a call [ms]."""
    jax.block_until_ready(function(*args))
    spent = []
    for _ in range(ROUNDS):
        begin = time.perf_counter()
        jax.block_until_ready(function(*args))
        spent.append(1e3 * (time.perf_counter() - begin))
    return np.median(spent), min(spent)


def main():
    model = rigs.plate(damping=2.0)
    lin = jb.linearize(model, jb.equilibrium(model))
    f = jnp.linspace(0.1, 20.0, 1000)
    inputs = {d: jb.BaseMotion("base", d) for d in DIRECTIONS}
    outputs = {d: rigs.motion("plate", direction=d) for d in DIRECTIONS}
    rows = [
        (
            f"response by {method}",
            *warm(lambda m=method: jb.frequency_response(lin, f, inputs, outputs, method=m).values),
            "2 ms",
        )
        for method in ("direct", "modal")
    ]
    band = jb.vibration.Band(0.1, 20.0, points=1000)
    white = {
        d: jb.vibration.PowerLaw(1e-4, unit="(m/s)2/Hz" if len(d) == 1 else "(rad/s)2/Hz")
        for d in DIRECTIONS
    }
    felt = {"corner": jb.Acceleration("plate", [0.4, 0.3, 0.05], axis="z")}
    names = [f"s{i}" for i in range(5)]

    def rms(parameters):
        """Through equilibrium and linearization."""
        changed = jb.replace(model, {f"s*.{field}": values for field, values in parameters.items()})
        lin = jb.linearize(changed, jb.equilibrium(changed))
        return jb.random_response(lin, band, inputs, felt, white)["corner"]

    parameters = {
        field: jnp.stack([getattr(model[name], field) for name in names])
        for field in ("stiffness", "damping", "free_length", "a")
    }
    count = sum(x.size for x in parameters.values())
    compiled = jax.jit(rms)
    rows.append(("rms of a band, with equilibrium", *warm(compiled, parameters), ""))
    rows.append(
        (f"its gradient by {count} numbers", *warm(jax.jit(jax.grad(rms)), parameters), "10 ms")
    )
    print(f"{'':36s}{'median ms':>12s}{'least ms':>12s}{'to meet':>12s}")
    for name, median, least, target in rows:
        print(f"{name:36s}{median:12.2f}{least:12.2f}{target:>12s}")


if __name__ == "__main__":
    main()
