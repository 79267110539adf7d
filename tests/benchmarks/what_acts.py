"""Random drops, shocks after quiet, and starts from rounding: how many motions pass over what acts.

    python tests/benchmarks/what_acts.py [drops shocks starts] [--cases 40] [--only SEED] [--check]
                                         [--write]

400 drops, 400 shocks and 200 starts by default, each against a judge of its own
(tests/random_drops.py, random_shocks.py, random_rests.py; the quick tests run twenty of each).
Failures are printed with their numbers; `--only 17` repeats one case, of shocks with the same
`--presets`. `--check` also compares the reference of each shock with one of half the steps.
`--write` puts the table into what_acts.md every twenty cases; kinds not measured stay. All take an
hour and more on two cores, most of it compiling shocks.
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

HERE = pathlib.Path(__file__).parent
sys.path.insert(0, str(HERE.parent))

import random_drops  # noqa: E402
import random_rests  # noqa: E402
import random_shocks  # noqa: E402

import jaxbody as jb  # noqa: E402

jax.config.update("jax_enable_x64", True)
# compiling is most of the time
os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_backend_optimization_level=0"
CASES = {"drops": 400, "shocks": 400, "starts": 200}
LISTED = 12  # failures of a kind in the table
HEAD = (
    "| | cases | right | wrong | said | ended | worst of the right | steps: median, most | judge |"
)
RULE = "|---|---|---|---|---|---|---|---|---|"


class Row:
    """Counts of one kind: wrong is a result that states no failure, `ended` one with a status,
    `said` one with a warning."""

    def __init__(self):
        self.verdicts, self.errors, self.steps, self.judge = collections.Counter(), [], [], []

    def add(self, verdict, error, steps, judge):
        self.verdicts[verdict] += 1
        self.steps.append(steps)
        self.judge.append(judge)
        if verdict == "right":
            self.errors.append(error)

    def text(self, name):
        counts = " | ".join(
            str(self.verdicts[verdict]) for verdict in ("right", "wrong", "said", "ended")
        )
        worst, judge = (
            f"{np.nanmax(x):.1e}" if np.isfinite(x).any() else "" for x in (self.errors, self.judge)
        )
        return (
            f"| {name} | {len(self.steps)} | {counts} | {worst} | {np.median(self.steps):.0f}, "
            f"{max(self.steps)} | {judge} |"
        )


def drops(seeds, options):
    """(row, verdict, error, steps, accuracy of the judge, text) of each."""
    for seed in seeds:
        drop = random_drops.random_drop(seed)
        result = random_drops.judged(drop)
        wrong = random_drops.faults(result)
        verdict = "ended" if result["status"] != "OK" else "wrong" if wrong else "right"
        error = max(result[name] for name in ("turning points", "own energy", "energy"))
        row = f"drops: {drop.kind}, {'damped' if drop.damping else 'undamped'}"
        yield (
            row,
            verdict,
            error,
            result["steps"],
            result["judge"],
            f"drop {seed}: {drop}: {', '.join(wrong)}",
        )


def shocks(seeds, options):
    """In the order of what is compiled."""
    last = None
    arguments_of = {seed: random_shocks.spread(seed, tuple(options.presets)) for seed in seeds}
    for seed in sorted(seeds, key=lambda seed: [*arguments_of[seed].values(), seed]):
        arguments = arguments_of[seed]
        if arguments["preset"] != last:
            jax.clear_caches()
            last = arguments["preset"]
        shock = random_shocks.random_shock(seed, **arguments)
        result = random_shocks.judged(shock, options.check)
        row = f"shocks: {shock.given}" if shock.solver == "default" else f"shocks by {shock.solver}"
        detail = (
            f"{result['error']:.1e}"
            if result["verdict"] == "wrong"
            else " ".join([result["status"], *result["codes"]])
        )
        yield (
            row,
            result["verdict"],
            result["error"],
            result["steps"],
            result["judge"],
            f"shock {seed}: {shock}: {detail}",
        )


def starts(seeds, options):
    for seed in sorted(seeds, key=lambda seed: (seed % len(random_rests.KINDS), seed)):
        start = random_rests.random_start(seed)
        result = random_rests.judged(start)
        wrong = random_rests.faults(result)
        verdict = "ended" if result["status"] != "OK" else "wrong" if wrong else "right"
        error = result["error"] * start.rtol
        yield (
            f"starts: {start.kind}",
            verdict,
            error,
            result["steps"],
            np.nan,
            f"start {seed}: {start}: {', '.join(wrong)}",
        )


def measured(kind, seeds, options):
    """Rows by name, and the lines of failures, after every twenty cases and at the end."""
    rows, lines, begin = collections.defaultdict(Row), [], time.time()
    for n, (name, verdict, error, steps, judge, text) in enumerate(
        globals()[kind](seeds, options), 1
    ):
        for row in (name, f"**{kind}**"):
            rows[row].add(verdict, error, steps, judge)
        if verdict != "right":
            lines.append(text)
            print(f"{verdict}: {text}", flush=True)
        elif len(seeds) == 1:
            print(f"right: {text}{error:.1e}, {steps} steps")
        if n % 20 == 0:
            print(
                f"{kind}: {n} of {len(seeds)}, {time.time() - begin:.0f} s, {len(lines)} not right",
                flush=True,
            )
        if n % 20 == 0 or n == len(seeds):
            yield [rows[name].text(name) for name in sorted(rows)], lines


def written(path, kinds, note):
    """The table with these kinds in place of what it had of them."""
    parts = {}
    if path.exists():
        for part in path.read_text().split("\n## ")[1:]:
            parts[part.partition("\n")[0]] = part.partition("\n")[2].strip()
    for kind, (rows, lines, seeds) in kinds.items():
        now = (
            f"{datetime.date.today()}, jax {jax.__version__}, Python {platform.python_version()}, "
            f"cases {seeds[0]} to {seeds[-1]}"
        )
        listed = [f"- {line}" for line in lines[:: -(-len(lines) // LISTED) or 1]]
        parts[kind] = "\n".join(
            [
                f"{now}{'; ' if note else ''}{note}.",
                "",
                HEAD,
                RULE,
                *rows,
                "",
                f"Not right ({len(listed)} of them):"[: 99 * bool(lines)],
                "",
                *listed,
            ]
        )
    head = [
        "# Motions that pass over what acts",
        "",
        (
            "`tests/benchmarks/what_acts.py`. Drops at rtol 1e-9: no energy rises by more than "
            "1e-6 of that of the fall, and turning points"
        ),
        (
            "are those of integration from event to event to 1e-6 of the height. Shocks at the "
            "default rtol: positions and velocities are"
        ),
        (
            "those of short constant steps to 1e-5 of the largest. Starts at rtol 1e-11 to 1e-6: "
            "they do not end early, and linear ones are"
        ),
        (
            "exact to 100 rtol. `said` warned, `ended` has a status other than OK. The judge's "
            "column is its own error: energy lost or gained,"
        ),
        "and what half the step changes.",
        "",
    ]
    order = [kind for kind in CASES if kind in parts]
    path.write_text(
        "\n".join(head)
        + "\n".join(f"\n## {kind}\n\n{parts[kind].strip()}\n" for kind in order).lstrip("\n")
    )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kinds", nargs="*", choices=[[], *CASES])
    parser.add_argument("--cases", type=int, help="of each kind")
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--only", type=int, metavar="SEED")
    parser.add_argument(
        "--presets",
        nargs="+",
        choices=[*random_shocks.PRESETS],
        default=[*random_shocks.PRESETS],
        help="of shocks",
    )
    parser.add_argument("--check", action="store_true")
    parser.add_argument("--write", action="store_true")
    parser.add_argument(
        "--note", default="", help="what the table says of the state that was measured"
    )
    options = parser.parse_args()
    warnings.simplefilter("ignore", jb.JaxbodyWarning)
    kinds = {}
    for kind in options.kinds or CASES:
        seeds = (
            range(options.first, options.first + (options.cases or CASES[kind]))
            if options.only is None
            else [options.only]
        )
        for rows, lines in measured(kind, seeds, options):
            kinds[kind] = rows, lines, seeds
            if options.write:
                written(HERE / "what_acts.md", kinds, options.note)
        print("\n".join([HEAD, RULE, *kinds[kind][0]]), flush=True)


if __name__ == "__main__":
    main()
