"""The speed of jaxbody beside a hand-written C++ program, on the reference job of plate.py: `python tests/benchmarks/run.py`.

Prints one table: medians, ratios to C of medians measured in turn in one process, errors reached, without and with XLA's option
for small loops; then the time to a first result in a fresh process and the time to compile. Needs g++.

    --rounds N     how often each function is timed (default 13)
    --only TEXT    only tasks whose name holds TEXT, "T4"
    --without, --with    only without, only with the option

Everything goes through the public functions, on a Model inside a jitted function of the stiffnesses.
"""

import argparse
import json
import os
import platform
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path

OPTION = "--xla_backend_extra_options=xla_cpu_small_while_loop_byte_threshold=100000000"  # to be set before the first computation
RTOL = 9e-5  # of T1 to T3: their errors are then half of those allowed
LIMITS = {"T1": 1e-6, "T2": 1e-4, "T3": 1e-6, "T4": 1e-9}  # errors allowed
TARGETS = {("T1", False): 20, ("T1", True): 3, ("T2", True): 8, ("T4", True): 4, ("T4", False): 4}  # ratios to C
STARTS = {"simulate": 4.0, "modes": 4.0, "gradient": None}  # seconds to a first result
MEASURED_AGAINST = {"T1": "T1 C RK4", "T2": "T2 C dual numbers", "T3": "T3 C SIMD RK4", "T4": "T4 C scalar"}


def user_functions(model, motion: dict, times) -> dict[str, Callable]:
    """What a user writes, each a function of the stiffnesses."""
    import diffrax
    import jax
    import jax.numpy as jnp

    import jaxbody as jb

    def stiffened(k):
        return jb.replace(model, {"*.stiffness": k})

    def path(k, times=times, **options):
        return jb.simulate(stiffened(k), times, motion=motion, rtol=RTOL, **options).state.q

    def loss(k, target):
        return jnp.sum((path(k, adjoint=diffrax.ForwardMode()) - target) ** 2)

    def modes(k):
        changed = stiffened(k)
        eq = jb.equilibrium(changed)
        found = jb.modes(jb.linearize(changed, eq))
        return found.frequency, found.status, eq.status, eq.stable

    return {
        "T1": jax.jit(path),
        "T2": jax.jit(jax.jacfwd(loss)),
        "T3": jax.jit(jax.vmap(lambda k: path(k, jnp.array([0.0, 1.0]))[-1])),
        "T4": jax.jit(jax.vmap(modes)),
        "slope": jax.jit(jax.grad(lambda k: modes(k)[0][0])),
    }


def medians(functions: dict[str, Callable], rounds: int) -> dict[str, float]:
    """Milliseconds, the functions called in turn."""
    import jax
    import numpy as np

    spent: dict[str, list[float]] = {name: [] for name in functions}
    for n in range(rounds + 1):
        for name, function in functions.items():
            start = time.perf_counter()
            jax.block_until_ready(function())
            if n:
                spent[name].append(1e3 * (time.perf_counter() - start))
    return {name: float(np.median(times)) for name, times in spent.items()}


def measure(rounds: int, only: str) -> dict:
    """Errors first, then times, of this process."""
    import jax
    import limit
    import numpy as np
    import plate

    jax.config.update("jax_enable_x64", True)
    written = user_functions(plate.model(), plate.motion(), plate.TIMES)
    k, k_1000, k_10000 = (
        jax.numpy.asarray(x) for x in (plate.STIFFNESS, plate.several_stiffnesses(1000), plate.several_stiffnesses(10000))
    )
    target = plate.solution(plate.TRUE_STIFFNESS)
    on_device = jax.numpy.asarray(target)
    calls = {
        "T1": lambda: written["T1"](k),
        "T2": lambda: written["T2"](k, on_device),
        "T3": lambda: written["T3"](k_1000),
        "T4": lambda: written["T4"](k_10000),
    }
    truths = {
        "T1": lambda: plate.solution(plate.STIFFNESS),
        "T2": lambda: slopes_of_loss(target),
        "T3": lambda: np.stack([plate.solution(x, np.array([0.0, 1.0]))[-1] for x in np.asarray(k_1000)[::50]]),
        "T4": lambda: frequencies(k_10000[::50]),
    }
    errors = {
        "T1": lambda found, truth: plate.error(found, truth),
        "T2": lambda found, truth: float(np.abs(found - truth).max() / np.abs(truth).max()),
        "T3": lambda found, truth: plate.error(found[::50], truth),
        "T4": lambda found, truth: float(np.abs(np.sort(found)[::50] / truth - 1).max()),
    }
    in_c = limit.tasks()
    chosen = [name for name in calls if only in name]
    first, reached = {}, {}
    for name in chosen:
        start = time.perf_counter()
        found = jax.block_until_ready(calls[name]())
        first[name] = time.perf_counter() - start
        if name == "T4":
            frequency, *statuses, stable = found
            assert np.asarray(stable).all() and not any(np.asarray(status).any() for status in statuses)
            found = frequency
        truth = truths[name]()
        reached[name] = errors[name](np.asarray(found), truth)
        for c_name in in_c:
            if c_name.startswith(name):
                found = in_c[c_name]()
                cut = {"T1": lambda y: np.vstack([truth[:1], y[:, :7]]), "T2": lambda y: y[1:]}.get(name, lambda y: y)
                reached[c_name] = errors[name](cut(found), truth)
    times = medians({name: f for name, f in {**in_c, **calls}.items() if name[:2] in chosen}, rounds)
    return {"first": first, "errors": reached, "times": times}


def slopes_of_loss(target):
    """The gradient of T2 by central differences of SciPy's solutions."""
    import numpy as np
    import plate

    def loss(k):
        return np.sum((plate.solution(k, rtol=1e-13) - target) ** 2)

    steps = 1e-5 * np.diag(plate.STIFFNESS)
    return np.array([(loss(plate.STIFFNESS + h) - loss(plate.STIFFNESS - h)) / (2 * h.sum()) for h in steps])


def frequencies(stiffnesses):
    """Those of T4 from SciPy: Newton's method with a stiffness by complex steps, and a general eigenvalue solver."""
    import numpy as np
    import plate
    import scipy.linalg

    M = np.diag(np.append(np.full(3, plate.MASS), plate.INERTIA))

    def force(k, x, R):
        """Generalized force in body axes at displaced (x, exp(theta)); complex numbers pass."""
        arm = plate.ON_PLATE @ R.T
        d = plate.ON_BASE - x - arm
        length = np.sqrt((d * d).sum(1))
        F = (k * (length - plate.FREE_LENGTH) / length)[:, None] * d
        return np.concatenate([F.sum(0) - [0, plate.MASS * plate.G, 0], R.T @ np.cross(arm, F).sum(0)])

    def stiffness(k, x, R):
        columns = []
        for i in range(6):
            step = 1e-30j * np.eye(6)[i]
            turned = R @ (np.eye(3) + np.cross(np.eye(3), step[3:]))
            columns.append(-force(k, x + step[:3], turned).imag / 1e-30)
        return np.stack(columns, 1)

    found = []
    for k in np.asarray(stiffnesses):
        x, R = np.zeros(3), np.eye(3)
        for _ in range(30):
            step = np.linalg.solve(stiffness(k, x, R), force(k, x, R))
            x, R = x + step[:3], R @ scipy.linalg.expm(np.cross(np.eye(3), step[3:]))
        K = stiffness(k, x, R)
        found.append(np.sqrt(scipy.linalg.eigh((K + K.T) / 2, M, eigvals_only=True)) / (2 * np.pi))
    return np.array(found)


def start(what: str) -> dict:
    """Seconds to a first result in this process, after the bare imports of jax and diffrax."""
    import diffrax  # noqa: F401
    import jax

    jax.config.update("jax_enable_x64", True)
    begun = time.perf_counter()
    import plate

    written = user_functions(plate.model(), plate.motion(), plate.TIMES)
    if what == "simulate":
        jax.block_until_ready(written["T1"](plate.STIFFNESS))
    elif what == "modes":
        import jaxbody as jb

        model = plate.model()
        jax.block_until_ready(jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency)
    else:
        jax.block_until_ready(written["slope"](plate.STIFFNESS))
    return {"seconds": time.perf_counter() - begun}


def compilation(rounds: int = 3) -> dict:
    """Seconds to trace and compile T1, T4 and the slope of the first frequency, for 5 and for 100 springs; the least of several."""
    import jax
    import numpy as np
    import plate

    jax.config.update("jax_enable_x64", True)
    spent: dict[str, float] = {}
    for _ in range(rounds):
        for copies in (1, 20):
            k = np.repeat(plate.STIFFNESS / copies, copies)
            written = user_functions(plate.model(copies), plate.motion(), plate.TIMES)
            for name in ("T1", "T4", "slope"):
                begun = time.perf_counter()
                written[name].lower(np.stack([k, k]) if name == "T4" else k).compile()
                key = f"{name} {5 * copies}"
                spent[key] = min(spent.get(key, np.inf), time.perf_counter() - begun)
    return spent


def child(*arguments: str, option: bool) -> dict:
    """What this program prints when it is run with these arguments."""
    flags = [os.environ.get("XLA_FLAGS", "")] + ([OPTION] if option else [])
    done = subprocess.run(
        [sys.executable, __file__, *arguments], env={**os.environ, "XLA_FLAGS": " ".join(flags)}, stdout=subprocess.PIPE, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def table(rounds: int, only: str, options: list[bool]) -> None:
    import importlib.metadata

    versions = " ".join(f"{name} {importlib.metadata.version(name)}" for name in ("jax", "jaxlib", "diffrax", "equinox", "numpy"))
    print(f"{processor()}, {os.cpu_count()} cores; Python {platform.python_version()}, {versions}\n")
    print(f"{'task':24s} {'ms':>9s} {'ratio to C':>11s} {'target':>7s} {'error':>9s} {'allowed':>8s} {'first call s':>13s}")
    for option in options:
        found = child("--measure", "--rounds", str(rounds), "--only", only, option=option)
        print("with the option" if option else "without the option")
        for name, ms in found["times"].items():
            ratio = ms / found["times"][MEASURED_AGAINST[name[:2]]]
            target = TARGETS.get((name, option), "")
            first = f"{found['first'][name]:13.2f}" if name in found["first"] else ""
            print(f"  {name:22s} {ms:9.3f} {ratio:11.2f} {target:>7} {found['errors'][name]:9.1e} {LIMITS[name[:2]]:8.0e} {first}")
    if only:
        return
    print("\nfirst result in a fresh process, seconds after the imports of jax and diffrax (T5)")
    for what, target in STARTS.items():
        print(f"  {what:22s} {child('--start', what, option=False)['seconds']:9.2f}   target {target or '-'}")
    print("\ntracing and compiling, seconds")
    spent = child("--compilation", option=False)
    for name in ("T1", "T4", "slope"):
        few, many = spent[f"{name} 5"], spent[f"{name} 100"]
        print(
            f"  {name:8s} 5 springs {few:6.2f}   100 springs {many:6.2f}   ratio {many / few:5.2f}   target {1.5 if name == 'T1' else '-'}"
        )


def processor() -> str:
    names = [line.split(":")[1].strip() for line in Path("/proc/cpuinfo").read_text().splitlines() if line.startswith("model name")]
    return names[0] if names else platform.processor()


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--rounds", type=int, default=13)
    parser.add_argument("--only", default="")
    parser.add_argument("--without", action="store_true")
    parser.add_argument("--with", action="store_true", dest="with_")
    for name in ("measure", "compilation"):
        parser.add_argument(f"--{name}", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--start", choices=STARTS, help=argparse.SUPPRESS)
    chosen = parser.parse_args()
    if chosen.measure:
        print(json.dumps(measure(chosen.rounds, chosen.only)))
    elif chosen.start:
        print(json.dumps(start(chosen.start)))
    elif chosen.compilation:
        print(json.dumps(compilation()))
    else:
        table(chosen.rounds, chosen.only, [True] if chosen.with_ else [False] if chosen.without else [False, True])
