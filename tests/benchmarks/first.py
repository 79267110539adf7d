"""First results of fresh processes, compared with an earlier commit: `python
tests/benchmarks/first.py 4bdcbdb`.

Each job runs in new processes of both versions, in turn, each with an environment and a script of
its own, and of this version twice more with programs kept on disk, of which the second counts.
Processor time, that of child processes included, so that neither threads nor other work on the
machine change it much; ratios of medians decide. The floor is a plate in hand-written JAX, with
XLA's default options and with those that jaxbody uses.
"""

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).parents[2]
README = "README's script"
DEMO = "jaxbody demo"

BEGIN = """
import json, os, sys
import jax, diffrax
import jax.numpy as jnp
import numpy as np
jax.config.update("jax_enable_x64", True)
spent = lambda: sum(os.times()[:4])  # of this process and its children
begin = spent()
"""
MODEL = """
import jaxbody as jb
jit = getattr(jb, "jit", lambda function: function)
if os.environ.get("KEPT"):
    jb.keep_programs(os.environ["KEPT"])
car = jb.presets.quarter_car(damping=1500.0)
times = np.linspace(0.0, 2.0, 101)
motion = {"road": jb.Harmonic(frequency=1.3, translation=[0, 0, 0.01])}
first = lambda model: jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]
def ride(model):
    lin = jb.linearize(model, jb.equilibrium(model))
    roads, band = {"road": jb.BaseMotion("road", "z")}, jb.vibration.Band(0.2, 40.0, points=201)
    uneven = jb.vibration.RoadRoughness.iso("C").at_speed(20.0)
    return jb.random_response(lin, band, roads, {"body": jb.Acceleration("body", axis="z")}, {"road": uneven})
def record():
    sensors = {"body": jb.Position("body", axis="z")}
    run = dict(motion=motion, initial=jb.equilibrium(car).state, sensors=sensors)
    moved = jb.simulate(car, times, motion=motion, initial=run["initial"])
    noise = 1e-4 * np.random.default_rng(0).normal(size=len(times))
    return {"run": jb.Experiment(times, measured={"body": np.asarray(moved.poses["body"].p)[:, 2] + noise}, **run)}
guess = jb.replace(car, {"suspension.stiffness": 1.2 * float(car["suspension"].stiffness)})
def comfort(model):
    return {"acceleration": ride(model)["body"], "stiffness": model["suspension"].stiffness}
"""  # noqa: E501
END = "\nprint(json.dumps([spent() - begin, result]))"
JOBS = {  # after the imports of jax and diffrax; the result is compared
    "equilibrium and frequencies": "result = float(first(car))",
    "motion": "result = float(jb.simulate(car, times, motion=motion).state.q[-1, 0])",
    "random response": 'result = float(ride(car)["body"])',
    "frequencies of an engine on bushings": "result = float(first(jb.presets.engine_on_mounts()))",
    "gradient of a frequency": 'result = float(jit(jax.grad(first))(car)["suspension"].stiffness)',
    "gradient of a comfort value": (
        "result = float(jit(jax.grad(lambda model: "
        'ride(model)["body"]))(car)["suspension"].stiffness)'
    ),
    "vmap of five frequencies": (
        'k = float(car["suspension"].stiffness) * np.linspace(0.8, 1.2, 5)\n'
        "result = float(jit(jax.vmap(lambda k: first(jb.replace(car, "
        '{"suspension.stiffness": k}))))(k)[4])'
    ),
    "fit by optax": (
        "import optax\n"
        'fit = jb.fit(guess, record(), free=["suspension.stiffness"], method=optax.lbfgs())\n'
        'result = float(fit.estimates["suspension.stiffness"])'
    ),
    "fit by least squares": (
        'fit = jb.fit(guess, record(), free=["suspension.stiffness"])\n'
        'result = float(fit.estimates["suspension.stiffness"])'
    ),
    "tune of a quarter car": (
        'stiffness = float(car["suspension"].stiffness)\n'
        'limits = {"stiffness": (0.8 * stiffness, None)}\n'
        'design = jb.tune(car, comfort, free=["suspension.stiffness"], '
        'minimize="acceleration", limits=limits)\n'
        'result = float(design.values["suspension.stiffness"])'
    ),
}

# One plate on three springs that pull and bend nothing: V(q) = sum k (|r_a - r_b| - L)^2/2 + m g y,
# q = (p, rotation vector).
FLOOR = """
m, g, l = 3.0, 9.81, 0.7
k0, I = jnp.array([m * g / l, m * g / l, 120.0]), jnp.diag(jnp.array([0.3, 0.9, 1.2]))
a = l * jnp.array([[-3.0, 1, 0], [3, 1, 0], [0, -1, 0]])
b = l * jnp.array([[-5.0, 3, 0], [5, 3, 0], [0, -3, 0]])
L = jnp.array([2 * 2**0.5 * l - l * 2**0.5 / 2, 2 * 2**0.5 * l - l * 2**0.5 / 2, 2 * l])
mass = jnp.array([m, m, m, 0.3, 0.9, 1.2])

def rotated(w, x):
    t2, small = w @ w, w @ w < 1e-12
    safe = jnp.where(small, 1.0, t2)
    t = jnp.sqrt(safe)
    s, c = jnp.where(small, 1 - t2 / 6, jnp.sin(t) / t), jnp.where(small, 0.5 - t2 / 24, (1 - jnp.cos(t)) / safe)
    wx = jnp.cross(w, x)
    return x + s * wx + c * jnp.cross(w, wx)

def V(k, q, shift=0.0):
    ends = q[:3] + jax.vmap(lambda x: rotated(q[3:], x))(a) - b - jnp.array([1.0, 0, 0]) * shift
    return 0.5 * k @ (jnp.sqrt(jnp.sum(ends**2, 1)) - L) ** 2 + m * g * q[1]

def equilibrium(k):
    def newton(state):
        step = jnp.linalg.solve(jax.hessian(V, 1)(k, state[0]), jax.grad(V, 1)(k, state[0]))
        return state[0] - step, jnp.abs(step).max(), state[2] + 1
    return jax.lax.while_loop(lambda s: (s[1] > 1e-12) & (s[2] < 50), newton, (jnp.zeros(6), 1.0, 0))[0]

def shape(k):
    q = equilibrium(k)
    K = jax.hessian(V, 1)(k, q)
    values, vectors = jnp.linalg.eigh(K / jnp.sqrt(mass[:, None] * mass))
    return q, K, values[0], vectors[:, 0] / jnp.sqrt(mass)

def frequency(k):
    return jnp.sqrt(shape(k)[2]) / (2 * jnp.pi)

def slope(k):
    "d lambda/dk = phi' (dK/dk + dK/dq dq/dk) phi"
    q, K, value, phi = shape(k)
    along = lambda k, q: jax.jvp(lambda q: jax.jvp(lambda q: V(k, q), (q,), (phi,))[1], (q,), (phi,))[1]
    dk, dq = jax.grad(along, (0, 1))(k, q)
    back = jnp.linalg.solve(K, dq)
    dk = dk - jax.grad(lambda k: jax.grad(V, 1)(k, q) @ back)(k)
    return dk / (2 * jnp.sqrt(value)) / (2 * jnp.pi)

def motion(k):
    "RK4 with rotation vectors, for small turns: 5 s in steps of 2 ms"
    h = 2e-3
    def rate(t, y):
        return jnp.concatenate([y[6:], -jax.grad(V, 1)(k, y[:6], 0.01 * jnp.cos(5.0 * t)) / mass])
    def step(y, t):
        k1 = rate(t, y); k2 = rate(t + h / 2, y + h / 2 * k1); k3 = rate(t + h / 2, y + h / 2 * k2); k4 = rate(t + h, y + h * k3)
        y = y + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return y, y[0]
    return jax.lax.scan(step, jnp.zeros(12), h * jnp.arange(2500))[1]
begin = spent()
function, options = {function}, {options}
value = jax.block_until_ready(jax.jit(function, compiler_options=options)(k0))
result = float(jnp.sum(value))
"""  # noqa: E501
SAME = """
import jaxbody as jb
l, m, g = 0.7, 3.0, 9.81
ends = {"AB": ([-3, 1, 0], [-5, 3, 0]), "CD": ([3, 1, 0], [5, 3, 0]), "EF": ([0, -1, 0], [0, -3, 0])}
length = 2 * 2**0.5 * l - l * 2**0.5 / 2
model = jb.Model(
    bodies={"plate": jb.Body(mass=m, inertia=[0.3, 0.9, 1.2])}, supports={"base": jb.Support()}, gravity=[0, -g, 0],
    elements={name: jb.Spring(("plate", l * np.array(a)), ("base", l * np.array(b)), stiffness=120.0 if name == "EF" else m * g / l,
                              free_length=2 * l if name == "EF" else length) for name, (a, b) in ends.items()},
)
first = lambda model: jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]
begin = spent()
"""  # noqa: E501
FLOORS = {
    "frequency": "result = float(first(model))",
    "slope": (
        "s = jax.grad(first)(model)\nresult = float(sum(s[name].stiffness for name in "
        '("AB", "CD", "EF")))'
    ),
    "motion": (
        'moved = {"base": jb.Harmonic(frequency=5.0 / (2 * np.pi), translation=[0.01, 0, 0])}\n'
        "result = float(jb.simulate(model, np.arange(2501) * 2e-3, "
        "motion=moved).poses['plate'].p[1:, 0].sum())"
    ),
}
CLOSE = {"frequency": 1e-9, "slope": 1e-7, "motion": 1e-8}


def seconds(python: Path, script: str, **environment: str) -> tuple[float, float]:
    hidden = {"JAX_COMPILATION_CACHE_DIR", "XLA_FLAGS", "PYTHONPATH"}
    clean = (
        {name: value for name, value in os.environ.items() if name not in hidden}
        | environment
        | {"MPLBACKEND": "Agg"}
    )
    done = subprocess.run(
        [python, "-c", script],
        capture_output=True,
        text=True,
        timeout=900,
        env=clean,
        cwd=tempfile.gettempdir(),
    )
    if done.returncode:
        raise RuntimeError(done.stderr[-2000:])
    return tuple(json.loads(done.stdout.splitlines()[-1]))


def whole(command: str) -> str:
    """A process that runs another one and prints its processor time, and the time by the clock to
    its first table."""
    return f"""
import json, os, subprocess, sys, time
begin = time.perf_counter()
process = subprocess.Popen({command}, stdout=subprocess.PIPE, text=True)
first = None
for line in process.stdout:
    if line.startswith("Equilibrium") and first is None:
        first = time.perf_counter() - begin
assert process.wait() == 0
print(json.dumps([sum(os.times()[2:4]), first]))
"""


def script_of(job: str, source: Path) -> str:
    """Of the version with this source."""
    if job == README:
        kept = (
            'import os, jaxbody; os.environ.get("KEPT") and '
            'jaxbody.keep_programs(os.environ["KEPT"])\n'
        )
        return whole(
            f"[sys.executable, '-c', {kept + (source / 'examples' / 'contract.py').read_text()!r}]"
        )
    if job == DEMO:
        code = """import importlib.metadata, sys
sys.argv = ['jaxbody', 'demo', '--out', sys.argv[1]]
(command,) = importlib.metadata.entry_points(group='console_scripts', name='jaxbody')
command.load()()
"""
        return whole(f"[sys.executable, '-c', {code!r}, {tempfile.gettempdir() + '/first-demo'!r}]")
    return BEGIN + MODEL + JOBS[job] + END


def environment(folder: Path, python: str, name: str, source: Path) -> Path:
    """The Python of a new environment with jaxbody from this source."""
    place = folder / name
    if not place.exists():
        subprocess.run([python, "-m", "venv", place], check=True)
        subprocess.run([place / "bin" / "python", "-m", "pip", "install", "-q", source], check=True)
    return place / "bin" / "python"


def compare(python: str, folder: Path, commit: str, rounds: int, jobs: list[str]) -> Path:
    """Compare the jobs, and return the Python with the present jaxbody."""
    version = subprocess.run(
        [python, "-c", "import sys; print('%d.%d' % sys.version_info[:2])"],
        capture_output=True,
        text=True,
    ).stdout.strip()
    before = folder / "before"
    if not before.exists():
        subprocess.run(
            ["git", "-C", ROOT, "worktree", "add", "--detach", before, commit], check=True
        )
    old, new = (
        environment(folder, python, f"{version}-before", before),
        environment(folder, python, f"{version}-now", ROOT),
    )
    print(f"\nPython {version}: processor seconds before, now, kept; ratios", flush=True)
    for job in jobs:
        earlier, script, times = script_of(job, before), script_of(job, ROOT), ([], [], [])
        for _ in range(rounds):
            with tempfile.TemporaryDirectory() as empty:
                home = {"XDG_CACHE_HOME": empty}
                (a, x), (b, y) = seconds(old, earlier, **home), seconds(new, script, **home)
                kept = home | {"KEPT": empty + "/jaxbody"}
                if job != DEMO:  # it keeps programs by itself
                    seconds(new, script, **kept)
                c, z = seconds(new, script, **kept)
            if job not in (README, DEMO):
                assert abs(y - x) <= 1e-6 * abs(x) and z == y, (job, x, y, z)
            for own, spent in zip(times, (a, b, c), strict=True):
                own.append(spent)
        a, b, c = map(statistics.median, times)
        more = f"; first table {x:.2f}, {y:.2f}, {z:.2f}" if job == DEMO else ""
        print(f"{job:36} {a:6.2f} {b:6.2f} {c:6.2f}   {b / a:.2f}  {c / a:.2f}{more}", flush=True)
    return new


def floor(python: Path, rounds: int) -> None:
    print(
        "\nOne plate: jaxbody, floor with XLA's defaults, floor with jaxbody's options; "
        "ratio at equal options",
        flush=True,
    )
    unoptimized = '{"xla_backend_optimization_level": 0, "xla_cpu_parallel_codegen_split_count": 1}'
    for name, job in FLOORS.items():
        scripts = [BEGIN + SAME + job + END]
        scripts += [
            BEGIN + FLOOR.replace("{function}", name).replace("{options}", o) + END
            for o in ("None", unoptimized)
        ]
        runs = [[seconds(python, script) for script in scripts] for _ in range(rounds)]
        ours, theirs = runs[0][0][1], runs[0][1][1]
        assert abs(ours - theirs) <= CLOSE[name] * abs(theirs), (name, ours, theirs)
        medians = [statistics.median(run[i][0] for run in runs) for i in range(3)]
        equal = medians[1] if name == "motion" else medians[2]  # motions are optimized
        print(
            f"{name:12} {medians[0]:6.2f} {medians[1]:6.2f} {medians[2]:6.2f}   "
            f"{medians[0] / equal:.2f}",
            flush=True,
        )


if __name__ == "__main__":
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("commit", help="the earlier version")
    parser.add_argument("--rounds", type=int, default=5)
    parser.add_argument(
        "--python", nargs="+", default=[sys.executable], help="interpreters to make environments of"
    )
    parser.add_argument(
        "--folder",
        type=Path,
        help="folder of the environments, kept for another time; by default a new one",
    )
    parser.add_argument("--jobs", nargs="+", default=[README, DEMO, *JOBS], help="some of the jobs")
    given = parser.parse_args()
    with tempfile.TemporaryDirectory() as temporary:
        folder = given.folder or Path(temporary)
        folder.mkdir(exist_ok=True)
        for python in given.python:
            floor(compare(python, folder, given.commit, given.rounds, given.jobs), given.rounds)
        if given.folder is None:
            subprocess.run(
                ["git", "-C", ROOT, "worktree", "remove", "--force", folder / "before"], check=True
            )
