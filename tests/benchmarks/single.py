"""Float32 compared with float64 in time and accuracy for each task; `python single.py` runs each
precision in its own process."""

import argparse
import functools
import json
import subprocess
import sys
import warnings
from pathlib import Path

import numpy as np

SETS = {"T3": 1000, "T4": 10000}
TOLERANCES = {"T1": (1e-3, 1e-4, 1e-5), "T3": (1e-3, 1e-4, 1e-5), "T4": (0.0,)}


def measure(precision: int, folder: Path) -> None:
    """Results of all tasks into a file, their milliseconds printed."""
    import jax
    import jax.numpy as jnp
    from measured import medians
    from plate import JOB

    jax.config.update("jax_enable_x64", precision == 64)
    import jaxbody as jb

    warnings.simplefilter("ignore", jb.JaxbodyWarning)
    model, motion, number = (
        JOB.model(),
        JOB.motion(),
        jnp.float64 if precision == 64 else jnp.float32,
    )

    def path(k, times, rtol):
        return jb.simulate(
            jb.replace(model, {"*.stiffness": k}), times, motion=motion, rtol=rtol
        ).state.q

    def frequencies(k):
        changed = jb.replace(model, {"*.stiffness": k})
        return jb.modes(
            jb.linearize(changed, jb.equilibrium(changed)), allow_float32=True
        ).frequency

    tasks = {
        "T1": lambda rtol: jax.jit(lambda k: path(k, np.linspace(0, 10, 1001), rtol)),
        "T3": lambda rtol: jax.jit(jax.vmap(lambda k: path(k, np.array([0.0, 1.0]), rtol)[-1])),
        "T4": lambda _: jax.jit(jax.vmap(frequencies)),
    }
    result, functions = {}, {}
    for task, tolerances in TOLERANCES.items():
        for rtol in tolerances if precision == 32 else tolerances[-1:]:
            k = jnp.asarray(
                JOB.several_stiffnesses(SETS[task]) if task in SETS else JOB.stiffness, number
            )
            function = tasks[task](rtol if precision == 32 else 1e-10)
            result[f"{task} {rtol:g}"] = np.asarray(jax.block_until_ready(function(k)), float)
            functions[f"{task} {rtol:g}"] = functools.partial(function, k)
    np.savez(folder / f"{precision}.npz", **result)
    print(json.dumps(medians(functions, 7)))


def main() -> None:
    import tempfile

    with tempfile.TemporaryDirectory() as folder:
        spent = {}
        for precision in (64, 32):
            given = [sys.executable, __file__, "--precision", str(precision), "--folder", folder]
            spent[precision] = json.loads(
                subprocess.run(given, check=True, stdout=subprocess.PIPE).stdout.splitlines()[-1]
            )
        exact, single = (np.load(Path(folder) / f"{precision}.npz") for precision in (64, 32))
        print(
            "| task, rtol | ms in float32 | ms in float64, rtol 1e-10 | largest error of float32 "
            "|\n|---|---|---|---|"
        )
        for name in single.files:
            task = name.split()[0]
            (reference,) = (key for key in exact.files if key.startswith(task))
            error = np.abs(single[name] - exact[reference])
            error = (error / np.abs(exact[reference])).max() if task == "T4" else error.max()
            print(
                f"| {name} | {spent[32][name]:.3g} | {spent[64][reference]:.3g} | "
                f"{error:.1e}{' relative' if task == 'T4' else ''} |"
            )


if __name__ == "__main__":
    parser = argparse.ArgumentParser()
    parser.add_argument("--precision", type=int)
    parser.add_argument("--folder", type=Path)
    chosen = parser.parse_args()
    measure(chosen.precision, chosen.folder) if chosen.precision else main()
