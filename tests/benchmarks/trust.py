"""How far jaxbody is from the figures of trust.

    python trust.py [rests drift gradients speed kills interrupts units] [--share 0.01] [--write]

Without a name it measures all of them. `--share` takes this part of their numbers of models, kills
and so on. `--write` puts what was measured into trust.md; rows of what was not measured stay, and
those of what other scripts and tests measure are written by hand. Limits are those asked for, met
or not.
"""

import argparse
import collections
import datetime
import os
import pathlib
import random
import signal
import sys
import tempfile
import time
import warnings

HERE = pathlib.Path(__file__).parent
sys.path[:0] = [str(HERE.parent), str(HERE.parent / "mechanics")]

import jax  # noqa: E402
import jax.numpy as jnp  # noqa: E402
import mechanics_properties  # noqa: E402
import numpy as np  # noqa: E402
import rigs  # noqa: E402
from random_mechanics import Structure  # noqa: E402

import jaxbody as jb  # noqa: E402
from jaxbody.core.units import GRAVITY  # noqa: E402
from jaxbody.fitting.parameters.spaces import units_of  # noqa: E402
from jaxbody.lagrange import potential  # noqa: E402
from jaxbody.model.joints.kinematics import Chart  # noqa: E402
from jaxbody.model.leaf_paths import leaves_of  # noqa: E402
from jaxbody.model.models import scale_of, size_of  # noqa: E402

jax.config.update("jax_enable_x64", True)
BATCH, STRUCTURES = 500, 52


def rests(share):
    """Searches for equilibria of random trees; gradient and Hessian of the energy say whether one
    called ok is a stable equilibrium."""

    def searched(model):
        eq, chart = jb.equilibrium(model), Chart(model)

        def energy(delta):
            state = jb.State(chart.retract(eq.state.q, delta), eq.state.v, eq.state.z)
            return potential(*mechanics_properties.in_state(model, state))

        scale, zero = scale_of(model, size_of(model)), jnp.zeros(model.layout.nv)
        return {
            "status": eq.status,
            "gradient": jax.grad(energy)(zero) * scale,
            "K": jax.hessian(energy)(zero) * scale * scale[:, None],
            "size": size_of(model),
        }

    open_ones = [n for n in range(STRUCTURES) if not Structure(n).closed]
    each, statuses, wrong, shape, program = (
        int(share * 1e5 / len(open_ones)) + 1,
        collections.Counter(),
        0,
        None,
        None,
    )
    for number in open_ones:
        structure = Structure(number)
        if structure.shape != shape:
            jax.clear_caches()
            program, shape = mechanics_properties.Program(searched), structure.shape
        for first in range(0, each, BATCH):
            found = program([structure.model(seed) for seed in range(first, first + BATCH)])  # type: ignore[misc]
            ok = found["status"] == 0
            K = np.where(
                np.isfinite(found["K"]).all((1, 2), keepdims=True),
                found["K"],
                -np.eye(found["K"].shape[1]),
            )
            largest = np.abs(K).max((1, 2))
            unstable = np.linalg.eigvalsh(K)[:, 0] < -1e-12 * largest
            moving = ~(np.abs(found["gradient"]).max(1) <= 1e-9 * largest * found["size"])
            wrong += int(np.sum(ok & (unstable | moving)))
            statuses.update(jb.Status(int(s)).name for s in found["status"])
        print(number, dict(statuses), "wrongly ok", wrong, flush=True)
    counts = ", ".join(f"{name} {n}" for name, n in statuses.most_common())
    yield (
        "R2",
        "searches for equilibria that end in a stable one or an honest status",
        "99.9 % of 1e5, none falsely ok",
        f"{sum(statuses.values())}: {counts}; falsely ok {wrong}",
        wrong == 0,
    )


def drift(share):
    """Energy of a rig of two bodies over 10 s, relative to what is exchanged."""
    model = jb.replace(rigs.rig(), {"*.damping": 0.0})
    eq = jb.equilibrium(model)
    start = jb.State(
        jb.joints.retract(model, eq.state.q, jnp.array([0.04, -0.03, 0.05, 0.15, -0.1, 0.2, -0.3])),
        0.3 * jnp.ones(7),
    )
    found = jb.simulate(model, np.linspace(0, 10, 401), initial=start, rtol=1e-13)
    energy = np.asarray(found.energies["total"])
    error = np.abs(energy - energy[0]).max() / (energy[0] - float(eq.energy))
    yield "R3", "energy over 10 s, rtol 1e-13", "5e-12", f"{error:.1e}", error < 5e-12


def gradients(share):
    """Derivatives of a motion by forward mode and by the two adjoints of reverse mode, in
    constant steps."""
    import diffrax

    times, motion = np.linspace(0, 0.5, 26), {"base": jb.Harmonic(**rigs.SHAKING)}
    steps = dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=0.005, max_steps=128)

    def loss(p, adjoint=None):
        model = rigs.rig(p)
        found = jb.simulate(
            model, times, motion=motion, initial=model.reference, adjoint=adjoint, **steps
        )
        return jnp.sum(jnp.sin(3 * found.state.q)) + jnp.sum(found.state.v**2)

    by = {
        "forward": jax.jacfwd(lambda p: loss(p, diffrax.ForwardMode())),
        "reverse": jax.grad(loss),
        "direct": jax.grad(lambda p: loss(p, diffrax.DirectAdjoint())),
    }
    found = {name: jb.jit(g)(jax.tree.map(jnp.asarray, rigs.PARAMETERS)) for name, g in by.items()}
    worst = max(
        rigs.max_difference(g[kind], x) / np.abs(x).max()
        for g in found.values()
        for kind, x in found["forward"].items()
    )
    yield (
        "R5",
        "derivatives of a motion, modes and adjoints",
        "1e-10",
        f"{worst:.1e}",
        worst < 1e-10,
    )


def speed(share):
    """The gradient of the frequencies of a chain of six bodies, and its matrices, in time of
    the processor."""
    names = [f"b{i}" for i in range(6)]
    corners = np.array([[0.2, 0.1, 0], [-0.2, 0.1, 0], [0, -0.2, 0.1], [0, 0, -0.1]])
    springs = {
        f"{name} {i}": jb.Spring(
            (above, corner), (name, corner), stiffness=1e4, free_length=0.5, damping=20.0
        )
        for above, name in zip(["world", *names], names, strict=False)
        for i, corner in enumerate(corners)
    }
    bodies = {
        name: jb.Body(mass=2.0, inertia=[0.1, 0.1, 0.1], position=[0, 0, -0.6 * (i + 1)])
        for i, name in enumerate(names)
    }
    model = jb.Model(bodies=bodies, elements=springs, gravity=[0, 0, -9.81])
    stiffnesses = 1e4 * np.random.default_rng(0).uniform(0.8, 1.2, (20, len(springs)))

    def frequencies(k):
        changed = jb.replace(model, {"*.stiffness": k})
        return jnp.sum(jb.modes(jb.linearize(changed, jb.equilibrium(changed))).frequency)

    begin = time.process_time()
    compiled = jax.jit(jax.grad(frequencies)).lower(stiffnesses[0]).compile()
    seconds = time.process_time() - begin
    for k in stiffnesses:
        assert np.isfinite(compiled(k)).all()
    yield (
        "R12",
        "compiling the gradient of frequencies of six bodies [s]",
        "15",
        f"{seconds:.1f}",
        seconds <= 15,
    )
    linearize = jax.jit(
        lambda k, state: jb.linearize(jb.replace(model, {"*.stiffness": k}), state).K
    )
    spent = []
    for k in stiffnesses:
        begin = time.process_time()
        jax.block_until_ready(linearize(k, model.reference))
        spent.append(time.process_time() - begin)
    K = 1e3 * np.median(spent)
    yield "R12", "K of six bodies, compiled [ms]", "2", f"{K:.2f}", K <= 2
    programs = linearize._cache_size()
    yield "R12", "programs for 20 designs", "1", f"{programs}", programs == 1


def kills(share):
    """Writers of results killed at random moments: the file is the one before or the one after."""
    count, broken, unchanged = max(1, int(200 * share)), 0, 0
    rng = random.Random(0)
    times = np.linspace(0, 1, 2000)
    runs = [jb.Record(times, {"x": (np.full(2000, float(i)), "m")}) for i in range(2)]
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder, "run.zip")
        jb.write_results(runs[0], path)
        for _ in range(count):
            child = os.fork()
            if child == 0:
                while True:
                    for run in runs:
                        jb.write_results(run, path)
            time.sleep(rng.uniform(0.0, 0.1))
            os.kill(child, signal.SIGKILL)
            os.waitpid(child, 0)
            try:
                x = np.asarray(jb.read_results(path)["x"])
                unchanged += bool((x == x[0]).all())
            except jb.JaxbodyError:
                broken += 1
    yield (
        "R13",
        "files that are whole when their writer is killed",
        "200 of 200",
        f"{unchanged} of {count}",
        unchanged == count >= 200,
    )


def interrupts(share):
    """Fits that Ctrl-C stops at random moments: the time to the answer, and whether they go on from
    their checkpoints to the optimum."""
    count, late, same, stopped = max(1, int(500 * share)), 0.0, 0, 0
    rng, car, times = (
        np.random.default_rng(0),
        jb.presets.quarter_car(damping=1500.0),
        np.linspace(0.0, 2.0, 101),
    )
    motion = {
        "motion": {"road": jb.Harmonic(frequency=1.3, translation=[0, 0, 0.01])},
        "initial": jb.equilibrium(car).state,
    }
    sensors = {"body": jb.Position("body", axis="z")}
    moved = jb.measure(jb.simulate(car, times, **motion), sensors)["body"]
    run = jb.Experiment(
        times,
        **motion,
        sensors=sensors,
        measured={"body": np.asarray(moved) + 1e-4 * rng.normal(size=101)},
    )
    guess = jb.replace(car, {"suspension.stiffness": 3e4, "suspension.damping": 1000.0})

    def whole(**options):
        fit = jb.fit(
            guess, {"run": run}, free=["suspension.stiffness", "suspension.damping"], **options
        )
        return fit, np.array([float(x) for x in fit.estimates.values()])

    def interrupt(*_):
        raise KeyboardInterrupt

    optimum = whole()[1]
    begin = time.perf_counter()
    whole()
    duration = time.perf_counter() - begin
    earlier = signal.signal(signal.SIGALRM, interrupt)
    with tempfile.TemporaryDirectory() as folder:
        for i in range(count):
            path, delay = pathlib.Path(folder, f"{i}.npz"), rng.uniform(0.0, duration)
            begin = time.perf_counter()
            signal.setitimer(signal.ITIMER_REAL, delay)
            try:
                stopped += whole(checkpoint=path)[0].status == jb.Status.INTERRUPTED
            except KeyboardInterrupt:
                stopped += 1
            late = max(late, time.perf_counter() - begin - delay)
            signal.setitimer(signal.ITIMER_REAL, 0.0)
            found = whole(resume=path)[1] if path.exists() else whole()[1]
            same += np.allclose(found, optimum, rtol=1e-6)
        left = {path.suffix for path in pathlib.Path(folder).iterdir()} - {".npz"}
    signal.signal(signal.SIGALRM, earlier)
    measured = f"{late:.2f} s; {same} of {count}, {stopped} of them stopped" + (
        f"; left {left}" if left else ""
    )
    yield (
        "R13",
        "Ctrl-C answered; fits resumed",
        "2 s; 500 of 500",
        measured,
        late < 2 and same == count >= 500 and not left,
    )


BLUNDERS = {  # what was typed: the unit that is meant, and the factor that is left out
    "N/mm": ("N/m", 1e-3),
    "kN/m": ("N/m", 1e-3),
    "mm": ("m", 1e3),
    "g": ("kg", 1e3),
    "t": ("kg", 1e-3),
    "kg mm2": ("kg m2", 1e6),
    "kg cm2": ("kg m2", 1e4),
    "mm/s2": ("m/s2", 1e3),
    "9.81 m/s2": ("m/s2", 1 / GRAVITY),
}


def scaled(model, unit, factor):
    """The model with all its numbers in this unit times a factor; None where it has none
    that matter."""
    arrays, values = jax.tree.leaves(model), {}
    turning = [
        name
        for name in model.layout.bodies
        if model.layout.turns[model.layout.v_slices[name]].any()
    ]
    for leaf in leaves_of(model):
        if unit == "kg m2" and leaf.path.rsplit(".", 1)[0] not in turning:
            continue
        value = np.asarray(leaf.read(arrays))
        own = np.reshape([u == unit for u in units_of(leaf, model, value)], value.shape)
        if np.any(value[own]):
            values[leaf.path] = np.where(own, value * factor, value)
    return jb.replace(model, values) if values else None


def varied(model, rng):
    """Each stiffness, damping and mass times a factor of its own from 1/2 to 2, inertias as their
    masses, all lengths times one."""
    arrays, values = jax.tree.leaves(model), {}
    size, masses = (
        2.0 ** rng.uniform(-1, 1),
        {name: 2.0 ** rng.uniform(-1, 1) for name in model.layout.bodies},
    )
    for leaf in leaves_of(model):
        value, owner = np.asarray(leaf.read(arrays)), leaf.path.split(".")[0]
        factor = {"stiffness": 2.0 ** rng.uniform(-1, 1), "damping": 2.0 ** rng.uniform(-1, 1)}.get(
            leaf.field, 1.0
        )
        if leaf.field in ("mass", "inertia") and owner in masses:
            factor = masses[owner] * (size**2 if leaf.field == "inertia" else 1.0)
        elif value.size and set(units_of(leaf, model, value)) == {"m"}:
            factor = size
        values[leaf.path] = value * factor
    return jb.replace(model, values)


def units(share):
    """Ready models and variants of them, as they are and with all numbers of one unit typed
    in another."""
    rng, counts, flagged = np.random.default_rng(0), collections.Counter(), collections.Counter()

    def judged(model):
        return bool(jb.fitting.plausibility(model).words)

    for name in dir(jb.presets):
        ready = getattr(jb.presets, name)()
        for i in range(max(2, int(40 * share))):
            model = varied(ready, rng) if i else ready
            counts["sound"] += 1
            flagged["sound"] += judged(model)
            for typed, (unit, factor) in BLUNDERS.items():
                try:
                    wrong = scaled(model, unit, factor)
                    seen = wrong is not None and judged(wrong)
                except jb.JaxbodyError:  # the constructor refuses it
                    wrong, seen = True, True
                counts[typed] += wrong is not None
                flagged[typed] += seen
    rates = {key: 100 * flagged[key] / counts[key] for key in counts}
    wrong = [key for key in counts if key != "sound"]
    found = 100 * sum(flagged[key] for key in wrong) / sum(counts[key] for key in wrong)
    text = ", ".join(f"{key} {rates[key]:.0f} %" for key in wrong)
    yield (
        "R10",
        f"wrong units of ready models flagged, {sum(counts[key] for key in wrong)} blunders",
        "95 %, 1 % falsely",
        f"{found:.0f} % ({text}); falsely {rates['sound']:.1f} % of {counts['sound']}",
        found >= 95 and rates["sound"] <= 1,
    )


MEASURES = {f.__name__: f for f in (rests, drift, gradients, speed, kills, interrupts, units)}

RULE = "|---|---|---|---|---|---|"


def main():
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("names", nargs="*", choices=[[], *MEASURES])
    parser.add_argument("--share", type=float, default=1.0)
    parser.add_argument("--write", action="store_true")
    options = parser.parse_args()
    warnings.simplefilter("ignore", jb.JaxbodyWarning)
    path = HERE / "trust.md"
    head = [
        "# Figures of trust\n",
        "`tests/benchmarks/trust.py`\n",
        "| | what | limit | measured | met | date |",
        RULE,
    ]
    rows = {_what(row): row for row in path.read_text().partition(RULE)[2].split("\n")[1:-1]}
    for name in options.names or MEASURES:
        for figure, what, limit, value, met in MEASURES[name](options.share):
            row = (
                f"| {figure} | {what} | {limit} | {value} | {'yes' if met else 'no'} | "
                f"{datetime.date.today()} |"
            )
            rows[_what(row)] = row
            print(row, flush=True)
    text = "\n".join(
        [*head, *sorted(rows.values(), key=lambda row: int(row.split("|")[1].strip()[1:])), ""]
    )
    if options.write:
        path.write_text(text)
    print(text)


def _what(row: str) -> str:
    """What a row of the table is of."""
    return row.split("|")[2].partition(",")[0].strip()


if __name__ == "__main__":
    main()
