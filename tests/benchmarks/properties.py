"""Properties of the mechanics over random models: `python properties.py --models 2000` prints them
with their limits.

With `--write` they go into properties.md. Structures of one to six bodies, each with as many
models; the programs of 13 shapes of four structures each are compiled once
(tests/random_mechanics.py draws them, tests/mechanics_properties.py states the properties; the
quick tests run a few). Seeds count from `--seed`.
"""

import argparse
import collections
import datetime
import os
import pathlib
import platform
import sys
import time
import warnings

import jax
import numpy as np

sys.path.insert(0, str(pathlib.Path(__file__).parents[1]))

import mechanics_properties as properties
from random_mechanics import Structure

import jaxbody as jb

jax.config.update("jax_enable_x64", True)
# compiling is most of the time
os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_backend_optimization_level=0"
# with more threads JAX 0.10 can stand still: large batches, page on limits
os.environ["NPROC"] = "1"
HERE = pathlib.Path(__file__).parent


class Results:
    """Values by property, with the structure and seed of each, and how searches for
    equilibria ended."""

    def __init__(self):
        self.values, self.worst, self.statuses = (
            collections.defaultdict(list),
            {},
            collections.Counter(),
        )

    def add(self, structure, seeds, found):
        for name, values in found.items():
            values = np.asarray(values, float) + 0.0
            self.values[name].append(values[~(values < 0)])
            i = int(np.argmax(np.where(np.isfinite(values), values, np.inf)))
            if not values[i] <= self.worst.get(name, (-1.0,))[0]:
                self.worst[name] = float(values[i]), structure.number, seeds[i]

    def rows(self):
        for name, limit in properties.LIMITS.items():
            values = np.concatenate(self.values[name]) if self.values[name] else np.zeros(0)
            if values.size:
                missed = int(np.sum(~(values <= limit)))
                yield (
                    name,
                    float(np.max(values)),
                    float(np.median(values)),
                    limit,
                    values.size,
                    missed,
                    self.worst[name][1:],
                )


def run(models, structures, seed):
    """Results of so many models, spread over structures; those of every sixth shape are also named
    in another order."""
    results, each, begin, programs, shape = (
        Results(),
        -(-models // structures),
        time.time(),
        None,
        None,
    )
    for number in range(structures):
        structure = Structure(number)
        if structure.shape != shape:
            jax.clear_caches()
            programs, shape = properties.Programs(), structure.shape
        seeds = [seed + i for i in range(each)]
        parts = [properties.at_random_states(structure, seeds, programs)]
        found, status = properties.at_rest(structure, seeds, programs)
        parts.append(found)
        if shape % 6 == 1:
            parts.append(properties.reordered(structure, seeds, programs))
        for part in parts:
            results.add(structure, seeds, part)
        results.statuses.update(jb.Status(int(s)).name for s in status)
        missed = [
            f"{name} ({worst:.1e})" for name, worst, _, _, _, missed, _ in results.rows() if missed
        ]
        print(
            f"{number + 1} of {structures}, {time.time() - begin:.0f} s; missed so far: "
            f"{', '.join(missed) or 'none'}",
            flush=True,
        )
        yield results, each * (number + 1), number + 1


def table(results, models, structures, seed):
    now = datetime.date.today().isoformat()
    lines = [
        "# Properties of the mechanics over random models",
        "",
        (
            f"`tests/benchmarks/properties.py`, {models} models of {structures} structures of "
            f"{-(-structures // 4)} shapes, seed {seed},"
        ),
        (
            f"{now}; jaxbody {jb.__version__}, jax {jax.__version__}, NumPy {np.__version__}, "
            f"Python {platform.python_version()}, float64."
        ),
        "",
        (
            "A value belongs to a model: the largest difference relative to the largest number of "
            "its kind. Models count where the property"
        ),
        (
            "applies: those of rests only where the search ended ok, T4 and T24 not where a law "
            "has kinks, T12 for a sixth of the shapes."
        ),
        (
            "Values of frequencies, shapes and sums over modes are divided by how far the "
            "condition of the mass matrix, its diagonal scaled to"
        ),
        "1, is beyond 1e3, the last also by how much further than 1e4 the poles are apart.",
        "",
        "| property | worst | median | limit | models | missed | worst in (structure, seed) |",
        "|---|---|---|---|---|---|---|",
    ]
    for name, worst, median, limit, n, missed, place in results.rows():
        lines.append(
            f"| {name} | {worst:.1e} | {median:.1e} | {limit:.0e} | {n} | {missed} | "
            f"{place[0]}, {place[1]} |"
        )
    counts = ", ".join(f"{name} {n}" for name, n in results.statuses.most_common())
    lines += ["", f"How the searches for equilibria ended: {counts}.", ""]
    return "\n".join(lines)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--models", type=int, default=2000)
    parser.add_argument("--structures", type=int, default=52)
    parser.add_argument("--seed", type=int, default=2026)
    parser.add_argument("--write", action="store_true", help="write properties.md beside this file")
    options = parser.parse_args()
    warnings.simplefilter("ignore", jb.JaxbodyWarning)  # statuses are counted
    text = ""
    for results, models, structures in run(options.models, options.structures, options.seed):
        text = table(results, models, structures, options.seed)
        if options.write:
            (HERE / "properties.md").write_text(text)
    print(text)


if __name__ == "__main__":
    main()
