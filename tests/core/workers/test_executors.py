"""Real processes: killed at random, killed by a chunk, interrupted and started again; by loky, the
standard pool and Dask."""

import multiprocessing
import os
import random
import signal
import subprocess
import sys
import threading
import time
from concurrent.futures import ProcessPoolExecutor, ThreadPoolExecutor
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.core.workers import chunk_programs
from jaxbody.core.workers.executors import check_workers

loky = pytest.importorskip("loky", reason="needs jaxbody[cluster]")
pytest.importorskip("xarray", reason="needs jaxbody[xarray]")
CAR = jb.presets.quarter_car(damping=1500.0)
OVER = {
    "suspension.stiffness": np.linspace(2e4, 6e4, 25),
    "body.mass": np.linspace(300.0, 450.0, 8),
}
POISON = 333.0


def slow(model):
    """A few ms for each model: a sum that is not shortened by what is known of it."""
    k, m = model["suspension"].stiffness, model["body"].mass

    def more(i, x):
        return x + jnp.sin(k * i) / m

    return {
        "sum": jax.lax.fori_loop(0, 60_000, more, 0.0),
        "frequency": jnp.sqrt(jnp.array([k, 2 * k]) / m) / (2 * jnp.pi),
    }


def quick(model):
    return {"frequency": jnp.sqrt(model["suspension"].stiffness / model["body"].mass)}


@pytest.fixture(scope="module")
def alone():
    return jb.sweep(CAR, slow, OVER, chunk=8)


def assert_same(a, b):
    for name in ("sum", "frequency"):
        assert a[name].dims == b[name].dims and (a[name].values == b[name].values).all()


def poisonous(program, shared, rows, function=None):
    """In place of `compute_chunk`: ends the process that computes a certain mass."""
    if any((np.asarray(x) == POISON).any() for x in rows):
        os.kill(os.getpid(), signal.SIGKILL)
    return chunk_programs.compute_chunk(program, shared, rows, function)


def children():
    """Process ids of loky's workers."""
    own = Path(f"/proc/{os.getpid()}/task").glob("*/children")
    ids = [int(word) for file in own for word in file.read_text().split()]
    return [pid for pid in ids if b"popen_loky" in Path(f"/proc/{pid}/cmdline").read_bytes()]


def kill_one(rng):
    """Kill one of loky's workers, if there is one."""
    try:
        os.kill(rng.choice(children()), signal.SIGKILL)
    except (IndexError, OSError):  # none, or it has just ended by itself
        return False
    return True


@pytest.mark.long
def test_two_processes_compute_the_bits_of_one_although_one_is_killed(alone):
    """By its process id, while both compute; results are in the order of the sweep."""
    killed, end = [], threading.Event()

    def kill():
        while not killed and not end.wait(0.1):
            if len(children()) == 2 and kill_one(random):
                killed.append(True)

    killer = threading.Thread(target=kill)
    killer.start()
    try:
        two = jb.sweep(CAR, slow, OVER, chunk=8, workers=2)
    finally:
        end.set()
        killer.join()
    assert_same(alone, two)
    assert killed and (two["status"] == 0).all() and "status" not in alone


@pytest.mark.long
def test_a_worker_killed_at_a_random_moment_costs_nothing_twenty_times(alone):
    """One in each of twenty sweeps, whatever it is doing: starting, loading a program,
    computing, waiting."""
    rng, killed = random.Random(5), []
    for _ in range(20):
        killer = threading.Timer(rng.uniform(0.0, 4.0), lambda: killed.append(kill_one(rng)))
        killer.start()
        assert_same(alone, jb.sweep(CAR, slow, OVER, chunk=8, workers=2))
        killer.join()
    assert sum(killed) >= 15


@pytest.mark.long
def test_a_poisonous_chunk_is_recorded_and_its_neighbors_are_done(monkeypatch):
    monkeypatch.setattr("jaxbody.core.workers.executors.compute_chunk", poisonous)
    masses = np.array([300.0, 310.0, POISON, 340.0, 350.0, 360.0, 370.0])
    with pytest.warns(
        jb.JaxbodyWarning, match="1 of 4 chunks failed three times, rows 2 to 4"
    ) as caught:
        result = jb.sweep(CAR, quick, {"body.mass": masses}, chunk=2, workers=2)
    assert caught[0].message.code == "LOST"
    np.testing.assert_array_equal(result["status"], [0, 0, jb.Status.LOST, jb.Status.LOST, 0, 0, 0])
    stiffness = float(CAR["suspension"].stiffness)
    np.testing.assert_allclose(
        result["frequency"],
        np.where(result["status"] == 0, np.sqrt(stiffness / masses), np.nan),
        rtol=1e-15,
    )


@pytest.mark.long
def test_a_standard_pool_that_breaks_is_reported(monkeypatch):
    monkeypatch.setattr("jaxbody.core.workers.executors.compute_chunk", poisonous)
    over = {"body.mass": np.array([300.0, 310.0, POISON, 340.0])}
    with (
        ProcessPoolExecutor(1, multiprocessing.get_context("spawn")) as pool,
        pytest.raises(jb.JaxbodyError, match="Give workers= a number of processes") as error,
    ):
        jb.sweep(CAR, quick, over, chunk=1, workers=pool)
    assert error.value.code == "BAD_WORKERS"


def other_version():
    """As an initializer of a pool: a worker with another jaxbody."""
    own = chunk_programs.versions()
    chunk_programs.versions = lambda: (("jaxbody", "0.0.9"), *own[1:])


@pytest.mark.long
def test_a_worker_with_another_version_is_refused_by_name():
    words = r"worker .*:\d+: has jaxbody 0\.0\.9 \(allowed: jaxbody 0\.1\.0"
    pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"), initializer=other_version)
    with pool, pytest.raises(jb.JaxbodyError, match=words):
        jb.sweep(CAR, quick, {"body.mass": [300.0, 310.0]}, chunk=1, workers=pool)


def closed():
    pool = ProcessPoolExecutor(1, multiprocessing.get_context("spawn"))
    pool.shutdown()
    return pool


class Client:
    def get_executor(self):
        pass


@pytest.mark.parametrize(
    "workers, words",
    [
        (0, "is 0 .*This machine has"),
        (-2, "is -2"),
        (True, "is a bool"),
        ("2", "is a str"),
        (ThreadPoolExecutor(1), "is an executor of threads"),
        (ProcessPoolExecutor, "is the class ProcessPoolExecutor"),
        (Client(), r"is a Client .*client\.get_executor\(pure=False\)"),
        (closed(), "takes no work: cannot schedule new futures after shutdown"),
    ],
)
def test_workers_that_cannot_work_are_refused_before_anything_is_computed(workers, words):
    def never(model):
        raise AssertionError("traced")

    with pytest.raises(jb.JaxbodyError, match=words) as error:
        jb.sweep(CAR, never, {"body.mass": [300.0]}, workers=workers)
    assert error.value.code == "BAD_WORKERS" and error.value.where == "sweep.workers"


def test_all_problems_of_a_call_at_once():
    with pytest.raises(jb.JaxbodyError) as error:
        jb.sweep(CAR, quick, {"body.mass": [300.0]}, workers=0, chunk=0, chunks=[0])
    assert {"BAD_WORKERS", "BAD_CHUNK"} == {problem.code for problem in error.value.problems}
    check_workers(None, "sweep.workers")


DRIVER = """
import signal
import sys
import jax
signal.signal(signal.SIGINT, signal.default_int_handler)  # a process in the background ignores it
jax.config.update("jax_enable_x64", True)
import jaxbody as jb
sys.path.insert(0, {tests!r})
from core.workers.test_executors import CAR, OVER, slow
jb.sweep(CAR, slow, OVER, chunk=4, workers={workers}, out={out!r}, progress=True)
"""


def driver(out, workers=2, **options):
    """The sweep in a script without a main guard."""
    script = DRIVER.format(tests=str(Path(__file__).parents[2]), out=str(out), workers=workers)
    environment = os.environ | {"PYTHONPATH": str(Path(jb.__file__).parents[1])}
    return subprocess.Popen(
        [sys.executable, "-c", script],
        stderr=subprocess.PIPE,
        text=True,
        env=environment,
        **options,
    )


def wait_for_chunks(process, out, count):
    end = time.monotonic() + 60
    while time.monotonic() < end:
        flags = out / "status" / "c"
        if flags.is_dir() and len(os.listdir(flags)) >= count:
            return
        assert process.poll() is None, process.communicate()[1]
        time.sleep(0.02)
    raise AssertionError("no chunks within a minute")


@pytest.mark.long
@pytest.mark.parametrize("how", [signal.SIGKILL, signal.SIGINT])
def test_a_killed_driver_continues_with_what_is_missing(tmp_path, alone, how):
    """Killed it leaves its store as it is; Ctrl-C ends it with a warning. What is there is not
    computed again."""
    pytest.importorskip("zarr", reason="needs jaxbody[cluster]")
    out = tmp_path / "s.zarr"
    process = driver(out, start_new_session=True)
    wait_for_chunks(process, out, 10)
    os.killpg(process.pid, how)
    errors = process.communicate()[1]
    if how == signal.SIGINT:
        assert (
            "the same call continues" in errors
            and "Traceback" not in errors
            and process.returncode == 0
        )
    flags = out / "status" / "c"
    there = {flag.name: flag.stat().st_mtime_ns for flag in flags.iterdir()}
    assert 10 <= len(there) < 50
    process = driver(out)
    assert process.communicate()[1].count("\\rsweep") <= 50 - len(there) and process.returncode == 0
    assert {name: (flags / name).stat().st_mtime_ns for name in there} == there and len(
        os.listdir(flags)
    ) == 50
    data = jb.sweep(CAR, slow, OVER, chunk=4, out=out)
    labeled = data.set_index(design=list(OVER)).unstack("design").transpose(*OVER, ...)
    assert (data["status"] == 0).all()
    np.testing.assert_array_equal(labeled["frequency"], alone["frequency"])
    # by chunks of 4 in place of 8
    np.testing.assert_allclose(labeled["sum"], alone["sum"], rtol=1e-12)


class Interrupting:
    """In place of stderr: presses Ctrl-C at the third report of progress."""

    count = 0

    def write(self, text):
        self.count += "sweep" in text
        if self.count == 3:
            os.kill(os.getpid(), signal.SIGINT)

    def flush(self):
        pass


@pytest.mark.long
def test_ctrl_c_without_a_store_returns_what_is_done(monkeypatch):
    # a process in the background ignores it
    signal.signal(signal.SIGINT, signal.default_int_handler)
    monkeypatch.setattr(sys, "stderr", Interrupting())
    over = {"body.mass": np.linspace(300.0, 450.0, 4000)}
    with pytest.warns(jb.JaxbodyWarning, match="of 4000 rows were not computed"):
        result = jb.sweep(CAR, slow, over, chunk=8, workers=2, progress=True)
    ok = result["status"].values == 0
    assert (
        16 < ok.sum() < 4000
        and np.isfinite(result["sum"].values[ok]).all()
        and np.isnan(result["sum"].values[~ok]).all()
    )
    assert set(result["status"].values[~ok]) == {jb.Status.INTERRUPTED}


@pytest.fixture(scope="module")
def dask():
    distributed = pytest.importorskip("distributed", reason="needs jaxbody[cluster]")
    with (
        distributed.LocalCluster(
            n_workers=2, threads_per_worker=1, dashboard_address=None, host="127.0.0.1"
        ) as cluster,
        distributed.Client(cluster) as client,
    ):
        yield client


@pytest.mark.long
def test_dask_computes_the_bits_of_one_process(alone, dask):
    with dask.get_executor(pure=False) as executor:
        assert_same(alone, jb.sweep(CAR, slow, OVER, chunk=8, workers=executor))


def processes_of(dask):
    """Process ids of both workers, when the scheduler knows of the last one that has ended and its
    nanny has started another."""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        ids = dask.run(os.getpid, on_error="ignore").values()
        if len(ids) == 2 and all(isinstance(pid, int) for pid in ids):
            return list(ids)
        time.sleep(0.2)
    raise AssertionError("there are not two workers after a minute")


@pytest.mark.long
def test_workers_of_dask_killed_at_random_moments_cost_nothing(alone, dask):
    rng = random.Random(7)
    for _ in range(5):
        pid = rng.choice(processes_of(dask))
        killer = threading.Timer(rng.uniform(0.0, 2.0), os.kill, (pid, signal.SIGKILL))
        killer.start()
        with dask.get_executor(pure=False) as executor:
            assert_same(alone, jb.sweep(CAR, slow, OVER, chunk=8, workers=executor))
        killer.join()


@pytest.mark.long
def test_a_chunk_that_kills_each_worker_of_dask_is_recorded_and_its_neighbors_are_done(
    monkeypatch, dask
):
    """Dask gives a chunk up after the first worker here (the fourth by default), and may blame
    another on the same worker. Whether nannies start workers again, which they seldom do not,
    is Dask's."""
    monkeypatch.setattr("jaxbody.core.workers.executors.compute_chunk", poisonous)
    masses = np.array([300.0, 310.0, POISON, 340.0, 350.0, 360.0, 370.0, 380.0, 390.0])
    dask.run_on_scheduler(lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", 0))
    with (
        dask.get_executor(pure=False) as executor,
        pytest.warns(jb.JaxbodyWarning, match="1 of 5 chunks failed three times, rows 2 to 4"),
    ):
        result = jb.sweep(CAR, quick, {"body.mass": masses}, chunk=2, workers=executor)
    np.testing.assert_array_equal(
        result["status"], np.where(np.arange(9) // 2 == 1, jb.Status.LOST, 0)
    )
    stiffness = float(CAR["suspension"].stiffness)
    np.testing.assert_allclose(
        result["frequency"],
        np.where(result["status"] == 0, np.sqrt(stiffness / masses), np.nan),
        rtol=1e-15,
    )
    dask.run_on_scheduler(lambda dask_scheduler: setattr(dask_scheduler, "allowed_failures", 3))


NOTEBOOK = [
    "import jax, numpy as np\njax.config.update('jax_enable_x64', True)\nimport jaxbody as jb",
    "car = jb.presets.quarter_car(damping=1500.0)\n"
    "mass_of = lambda model: model['body'].mass\n"
    "quantities = lambda model: {'ratio': model['suspension'].stiffness / mass_of(model)}",
    (
        "two = jb.sweep(car, quantities, {'body.mass': np.linspace(300.0, 400.0, 40)}, "
        "chunk=4, workers=2)\n"
        "print(bool((two['status'] == 0).all()), float(two['ratio'][0] * 300.0 / "
        "car['suspension'].stiffness))"
    ),
]


@pytest.mark.long
def test_a_notebook_computes_by_two_processes(monkeypatch):
    """Functions of its cells, which have no module that a worker could import."""
    nbclient, nbformat = (
        pytest.importorskip(name, reason="comes with nbmake") for name in ("nbclient", "nbformat")
    )
    monkeypatch.setenv("PYTHONPATH", str(Path(jb.__file__).parents[1]))
    notebook = nbformat.v4.new_notebook(
        cells=[nbformat.v4.new_code_cell(source) for source in NOTEBOOK]
    )
    nbclient.NotebookClient(notebook, timeout=300, kernel_name="python3").execute()
    (output,) = [output for output in notebook.cells[-1].outputs if output.get("name") == "stdout"]
    assert output.text == "True 1.0\n"


def spring_record():
    spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    joints = {"mass": jb.Guide("world", axis=[1, 0, 0])}
    body = jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])
    times, sensors = jnp.linspace(0, 1, 6), {"x": jb.Position("mass", axis=[1, 0, 0])}
    run = jb.Experiment(
        times, sensors=sensors, measured={"x": jnp.cos(2 * jnp.pi * times)}, noise=0.01
    )
    return jb.Model(bodies={"mass": body}, elements={"spring": spring}, joints=joints), {"run": run}


@pytest.mark.long
def test_multistart_has_the_same_optima_by_two_processes():
    """21 starts are two batches, the second one filled up; its program has LAPACK's QR."""
    model, runs = spring_record()
    one, two = (
        jb.fitting.multistart(model, runs, free=["spring.stiffness"], starts=21, workers=workers)
        for workers in (None, 2)
    )
    assert (
        (one.cost == two.cost).all()
        and (one.hits == two.hits).all()
        and one.failures == two.failures == 0
    )
    assert (one.estimates["spring.stiffness"] == two.estimates["spring.stiffness"]).all()


@pytest.mark.long
def test_tolerances_have_the_same_samples_by_two_processes():
    scatter = {"suspension.stiffness": 1750.0, "body.mass": 10.0}
    one, two = (
        jb.tolerances(CAR, quick, scatter, samples=1000, workers=workers) for workers in (None, 2)
    )
    assert (one.samples == two.samples).all() and one.ok and two.ok


@pytest.mark.long
def test_tune_finds_the_same_designs_by_two_processes():
    """Of 20 starts each search is the same; so is the count of evaluations."""

    def trade(model):
        c, k = model["suspension"].damping / 1500.0, model["suspension"].stiffness / 2e4
        return {"shake": c + 1 / c + jnp.sin(5 * c) + k, "sag": 1 / k}

    bounds = {"suspension.*": (300.0, 60000.0)}
    options = dict(
        free=["suspension.damping", "suspension.stiffness"],
        minimize="shake",
        limits={"sag": (None, 1.2)},
        bounds=bounds,
        starts=20,
    )
    one, two = (jb.tune(CAR, trade, workers=workers, **options) for workers in (None, 2))
    assert one.ok and one.evaluations == two.evaluations and one.active == two.active
    for a, b in zip(
        jax.tree.leaves((one.values, one.runs, one.after, one.history)),
        jax.tree.leaves((two.values, two.runs, two.after, two.history)),
        strict=True,
    ):
        np.testing.assert_array_equal(a, b)
    np.testing.assert_allclose(one.values["suspension.stiffness"], 2e4 / 1.2, rtol=1e-6)
