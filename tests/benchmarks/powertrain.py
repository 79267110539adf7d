"""Processor time of a tuning with compilation: mounts that decouple a powertrain, from 64 starts;
under 20 s is expected."""

import pathlib
import sys
import time

import jax
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[1]))
import rigs

if __name__ == "__main__":
    jax.config.update("jax_enable_x64", True)
    begin = time.process_time(), time.perf_counter()
    _, result = rigs.decoupled_powertrain()
    spent = time.process_time() - begin[0], time.perf_counter() - begin[1]
    shares = result.runs.quantities["dominant"].min(-1)
    print(
        f"{spent[0]:.1f} s of the processor, {spent[1]:.1f} s in all; median of the least "
        f"dominant share {np.median(shares):.2f} %"
    )
