"""Error and time of a simulation and of its gradient for several rtol: plate and three boxes, 10 s;
the table in simulate's docstring."""

import time

import jax
import jax.numpy as jnp
import numpy as np
import plate
import three
from job import TIMES

import jaxbody as jb

TOLERANCES = (1e-3, 1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9, 1e-10)
ROUNDS = 9


def main() -> None:
    jax.config.update("jax_enable_x64", True)
    for job in (plate.JOB, three.JOB):
        model, motion, exact = job.model(), job.motion(), job.solution(job.stiffness, rtol=1e-13)
        target = jnp.asarray(job.solution(job.true_stiffness))

        def path(k, rtol, model=model, motion=motion):
            return jb.simulate(
                jb.replace(model, {"*.stiffness": k}), TIMES, motion=motion, rtol=rtol
            )

        def cost(k, rtol, target=target, path=path):
            return jnp.mean((path(k, rtol).state.q - target) ** 2)

        k = jnp.asarray(job.stiffness)
        run = jax.jit(
            lambda k, rtol, path=path: (lambda s: (s.state.q, s.statistics["num_accepted_steps"]))(
                path(k, rtol)
            )
        )
        slope = jax.jit(jax.grad(cost))
        best = np.asarray(slope(k, 1e-12))
        spent: dict = {}
        for _ in range(ROUNDS):
            for rtol in TOLERANCES:
                for kind, function in (("run", run), ("slope", slope)):
                    begin = time.process_time()
                    jax.block_until_ready(function(k, rtol))
                    spent.setdefault((kind, rtol), []).append(time.process_time() - begin)
        print(
            f"\n{job.name}\n| rtol | steps | error [m, rad] | relative time | error of the "
            "gradient | relative time |\n"
            "|---|---|---|---|---|---|"
        )
        median = {key: float(np.median(times)) for key, times in spent.items()}
        for rtol in TOLERANCES:
            q, steps = run(k, rtol)
            error, wrong = (
                job.error(np.asarray(q), exact),
                np.abs(np.asarray(slope(k, rtol)) / best - 1).max(),
            )
            each = [median[kind, rtol] / median[kind, 1e-8] for kind in ("run", "slope")]
            print(
                f"| {rtol:g} | {int(steps)} | {error:.1e} | {each[0]:.2f} | "
                f"{wrong:.1e} | {each[1]:.2f} |",
                flush=True,
            )
        print(
            f"{1e3 * median['run', 1e-8]:.3g} ms and {1e3 * median['slope', 1e-8]:.3g} ms at 1e-8"
        )


if __name__ == "__main__":
    main()
