"""The sweep that the recipes in this folder compute: frequencies and travel of a quarter car for
200 000 designs, in chunks of 4096.

python designs.py --out sweep.zarr                      all chunks, in this process
python designs.py --out sweep.zarr --workers 8          by eight processes of this machine
python designs.py --out sweep.zarr --job 3 --jobs 20    the chunks 3, 23, 43 ... of a job array
python designs.py --out sweep.zarr --dask address       by the Dask cluster whose scheduler has this
                                                        address, or this file
Called again, each continues where it stopped.
"""

import argparse
import contextlib

import jax
import numpy as np

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
DESIGNS, CHUNK = 200_000, 4096


def quantities(model):
    lin = jb.linearize(model, model.reference)
    return {
        "frequency": jb.modes(lin).frequency,
        "travel": model["body"].mass * 9.81 / model["suspension"].stiffness,
    }


def executor_of(address: str):
    """An executor of a Dask cluster, closed before its client."""
    from distributed import Client

    stack = contextlib.ExitStack()
    file = {"scheduler_file": address} if address.endswith(".json") else {"address": address}
    client = stack.enter_context(Client(**file))
    return stack, stack.enter_context(client.get_executor(pure=False, retries=2))


def main() -> None:
    parser = argparse.ArgumentParser()
    parser.add_argument("--out", required=True)
    parser.add_argument("--workers", type=int)
    parser.add_argument("--job", type=int, default=0)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--dask")
    parser.add_argument("--designs", type=int, default=DESIGNS)
    args = parser.parse_args()
    over = {
        "suspension.stiffness": (15e3, 40e3),
        "body.mass": (250.0, 450.0),
        "tyre.stiffness": (150e3, 250e3),
    }
    chunks = range(args.job, -(-args.designs // CHUNK), args.jobs)
    stack, workers = (
        executor_of(args.dask) if args.dask else (contextlib.nullcontext(), args.workers)
    )
    with stack:
        car = jb.presets.quarter_car(damping=1500.0)
        result = jb.sweep(
            car,
            quantities,
            over,
            samples=args.designs,
            chunk=CHUNK,
            chunks=chunks,
            workers=workers,
            out=args.out,
        )
    status = result["status"].values
    print(
        f"{np.count_nonzero(status == 0)} of {args.designs} designs, "
        f"{np.count_nonzero(status == jb.Status.LOST)} lost"
    )


if __name__ == "__main__":
    main()
