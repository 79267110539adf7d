"""The measurements of one process: T1 to T4 of a job with jaxbody's public functions, C and the
peers; a first result; compile times."""

import time
from collections.abc import Callable

import numpy as np
from job import TIMES, Job

RTOL = {"plate": {"T1": 2e-4, "T2": 5e-4}, "three": {"T1": 2e-5, "T2": 2e-4}}
# of T3, seconds, constant as C's; errors are about half of those allowed
STEP = {"plate": 0.1, "three": 0.04}
FEW = 50  # T3 and T4 are checked at every fiftieth set
MEASURED_AGAINST = {
    "T1": "T1 C RK4",
    "T2": "T2 C dual numbers",
    "T3": "T3 C SIMD RK4",
    "T4": "T4 C scalar",
}
LIMITS = {"T1": 1e-6, "T2": 1e-4, "T3": 1e-6, "T4": 1e-9}  # errors allowed


def job_of(name: str) -> Job:
    import plate
    import three

    return {"plate": plate.JOB, "three": three.JOB}[name]


def user_functions(job: Job, copies: int = 1, jit: Callable | None = None) -> dict[str, Callable]:
    """What a user writes, each a function of the stiffnesses, in jax.jit or another."""
    import diffrax
    import jax
    import jax.numpy as jnp

    import jaxbody as jb

    model, motion, rtol = job.model(copies), job.motion(), RTOL[job.name]

    def stiffened(k):
        return jb.replace(model, {"*.stiffness": k})

    steps = {"stepsize_controller": diffrax.ConstantStepSize(), "dt0": STEP[job.name]}

    def path(k, times=TIMES, **options):
        return jb.simulate(stiffened(k), times, motion=motion, **options).state.q

    def loss(k, target):
        return jnp.sum((path(k, rtol=rtol["T2"], adjoint=diffrax.ForwardMode()) - target) ** 2)

    def modes(k):
        changed = stiffened(k)
        eq = jb.equilibrium(changed)
        result = jb.modes(jb.linearize(changed, eq))
        return result.frequency, result.status, eq.status, eq.stable

    jit = jit or jax.jit
    return {
        "T1": jit(lambda k: path(k, rtol=rtol["T1"])),
        "T2": jit(jax.jacfwd(loss)),
        "T3": jit(jax.vmap(lambda k: path(k, jnp.array([0.0, 1.0]), **steps)[-1])),
        "T4": jit(jax.vmap(modes)),
        "slope": jit(jax.grad(lambda k: modes(k)[0][0])),
    }


def calls(job: Job) -> dict[str, Callable]:
    """jaxbody's tasks, ready to call."""
    import jax

    written = user_functions(job)
    k, k_1000, k_10000 = (
        jax.numpy.asarray(x)
        for x in (job.stiffness, job.several_stiffnesses(1000), job.several_stiffnesses(10000))
    )
    target = jax.numpy.asarray(job.solution(job.true_stiffness))
    return {
        "T1": lambda: written["T1"](k),
        "T2": lambda: written["T2"](k, target),
        "T3": lambda: written["T3"](k_1000),
        "T4": lambda: written["T4"](k_10000),
    }


def truth(job: Job, task: str) -> np.ndarray:
    """The reference result of a task, by SciPy."""
    import references

    if task == "T1":
        return job.solution(job.stiffness)
    if task == "T2":
        return references.gradient(job)
    if task == "T3":
        return np.stack(
            [job.solution(k, TIMES[[0, 100]])[-1] for k in job.several_stiffnesses(1000)[::FEW]]
        )
    return references.frequencies(job, job.several_stiffnesses(10000)[::FEW])


def error(job: Job, task: str, result, truth: np.ndarray) -> float:
    """In the measure of the task."""
    if task == "T4" and isinstance(result, tuple):
        result, *statuses, stable = result
        assert np.asarray(stable).all() and not any(np.asarray(status).any() for status in statuses)
    result = np.asarray(result)
    if task == "T2":
        return float(np.abs(result - truth).max() / np.abs(truth).max())
    if task in ("T3", "T4"):  # both hold evenly spaced sets
        n = min(len(result), len(truth))
        result, truth = result[:: len(result) // n], truth[:: len(truth) // n]
    return float(np.abs(result / truth - 1).max()) if task == "T4" else job.error(result, truth)


def measure(job: Job, rounds: int, only: str, with_peers: bool) -> dict:
    """Errors first, then milliseconds of all in turn."""
    import jax
    import limit
    import peers

    jax.config.update("jax_enable_x64", True)
    functions, shares, skipped = {**limit.tasks(job), **calls(job)}, {}, []
    if with_peers:
        others, skipped = peers.tasks(job)
        functions |= {name: function for name, (function, _) in others.items()}
        shares = {name: share for name, (_, share) in others.items()}
    chosen = sorted((name for name in functions if only in name[:2]), key=lambda name: name[:2])
    first, errors, truths = {}, {}, {}
    for name in chosen:
        task = name[:2]
        if task not in truths:
            truths[task] = truth(job, task)
        begun = time.perf_counter()
        result = jax.block_until_ready(functions[name]())
        first[name] = time.perf_counter() - begun
        errors[name] = error(job, task, result, truths[task])
    times = medians({name: functions[name] for name in chosen}, rounds)
    times = {name: ms * shares.get(name, 1.0) for name, ms in times.items()}
    return {
        "first": {name: first[name] for name in LIMITS if name in first},
        "errors": errors,
        "times": times,
        "skipped": skipped,
    }


def medians(functions: dict[str, Callable], rounds: int) -> dict[str, float]:
    """Milliseconds, the functions called in turn; slow ones three times only."""
    import jax

    spent: dict[str, list[float]] = {name: [] for name in functions}
    for _ in range(rounds):
        for name, function in functions.items():
            if len(spent[name]) >= 3 and spent[name][0] > 150:
                continue
            begun = time.perf_counter()
            jax.block_until_ready(function())
            spent[name].append(1e3 * (time.perf_counter() - begun))
    return {name: float(np.median(times)) for name, times in spent.items()}


def start(job: Job, what: str) -> dict:
    """Seconds to a first result in this process, after the bare imports of jax and diffrax, and
    of these."""
    importing = time.perf_counter()
    import diffrax  # noqa: F401
    import jax

    jax.config.update("jax_enable_x64", True)
    begun = time.perf_counter()
    import jaxbody as jb

    jit = jb.jit if what.endswith("jb.jit") else jax.jit
    if what == "motion":
        jax.block_until_ready(
            jb.simulate(job.model(), TIMES, motion=job.motion(), rtol=RTOL[job.name]["T1"]).state.q
        )
    elif what == "frequencies":
        model = job.model()
        jax.block_until_ready(jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency)
    elif what.startswith("motion in"):
        jax.block_until_ready(user_functions(job, jit=jit)["T1"](job.stiffness))
    else:
        target = np.zeros((len(TIMES), 7 * len(job.mass)))
        jax.block_until_ready(user_functions(job, jit=jit)["T2"](job.stiffness, target))
    return {"imports": begun - importing, "seconds": time.perf_counter() - begun}


def compilation(job: Job, rounds: int = 3) -> dict:
    """Seconds to trace and compile T1, T4 and the slope of the first frequency, for the job's
    springs and for 20 times as many; the least of several."""
    import jax

    jax.config.update("jax_enable_x64", True)
    spent: dict[str, float] = {}
    for _ in range(rounds):
        for copies in (1, 20):
            k = np.repeat(job.stiffness / copies, copies)
            written = user_functions(job, copies)
            for name in ("T1", "T4", "slope"):
                begun = time.perf_counter()
                written[name].lower(np.stack([k, k]) if name == "T4" else k).compile()
                key = f"{name} {copies}"
                spent[key] = min(spent.get(key, np.inf), time.perf_counter() - begun)
    return spent
