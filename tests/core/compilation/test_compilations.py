"""Compilations are reported; the option for fast loops is set on request, before JAX starts, and
only in versions that support it."""

import os
import subprocess
import sys
import time

import diffrax
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs

import jaxbody as jb
from jaxbody.core.compilation.compile_options import HAS_SLOW_LOOPS

pytestmark = pytest.mark.everywhere


def run(program, *arguments, **environment):
    """What a fresh process prints."""
    flags = {"XLA_FLAGS": "", **environment}
    command = [sys.executable, "-c", program, *arguments]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=300, env={**os.environ, **flags}
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


def by_themselves(model, amplitude, times):
    """What users call outside of any jit: motion, equilibrium, matrices, frequencies,
    a response."""
    motion = {"base": jb.Harmonic(frequency=2.0, translation=[0, 0, amplitude])}
    jb.simulate(model, times, motion=motion)
    lin = jb.linearize(model, jb.equilibrium(model))
    jb.modes(lin)
    inputs, outputs = (
        {"floor": jb.BaseMotion("base", "z")},
        {"plate": jb.Position("plate", axis="z")},
    )
    jb.frequency_response(lin, 1 + times, inputs, outputs)


@pytest.mark.long
def test_each_is_one_program_whatever_the_values():
    model, times = rigs.plate(damping=2.0), np.linspace(0, 0.1, 13)
    with jb.compile_times() as first:
        by_themselves(model, 1e-3, times)
    assert first.programs["integrate"][3] == 1  # the others may have been compiled for another test
    assert all(count <= 1 for *_, count in first.programs.values()), first
    with jb.compile_times() as then:
        by_themselves(
            jb.replace(
                model, {"*.stiffness": 77.0, "plate.mass": 3.0, "plate.com": [0.01, 0, 0.02]}
            ),
            2e-3,
            2 * times,
        )
    assert then.count == 0, then


@pytest.mark.long
def test_another_shape_or_option_is_another_program():
    model, options = rigs.plate(), dict(stepsize_controller=diffrax.ConstantStepSize(), dt0=0.01)
    begin = time.perf_counter()
    with jb.compile_times() as spent:
        jb.simulate(model, np.linspace(0, 0.1, 6), solver=diffrax.Euler(), **options)
    elapsed = time.perf_counter() - begin
    assert spent.programs["integrate"][3] == 1
    assert all(seconds > 0 for seconds in spent.programs["integrate"][:3])
    assert spent.count >= 1
    assert spent.seconds <= elapsed  # seconds they are, none of them counted twice
    assert "integrate" in repr(spent)
    before = spent.count
    jax.jit(lambda x: x * 3.25)(jnp.ones(7))
    assert spent.count == before  # it listens inside the block only


def test_a_program_that_runs_while_another_is_traced_is_counted_once():
    """The trace sleeps for 0.2 s and compiles and runs another program: its own time is that of the
    sleep, and a little."""

    @jax.jit
    def slept(x):
        time.sleep(0.2)
        with jax.ensure_compile_time_eval():
            matrix = jnp.linalg.inv(jnp.eye(7) + 0.125)
        return matrix @ x

    begin = time.perf_counter()
    with jb.compile_times() as spent:
        slept(jnp.ones(7))
    elapsed = time.perf_counter() - begin
    inner = sum(sum(seconds) for name, (*seconds, _) in spent.programs.items() if name != "slept")
    assert inner > 0 and 0.2 <= spent.programs["slept"][0] <= elapsed - inner
    assert spent.seconds <= elapsed


FAST = """
import os
import jax
import jaxbody as jb
print(jb.fast_loops(), jb.fast_loops(), os.environ["XLA_FLAGS"])
import jax.numpy as jnp
x = jax.lax.fori_loop(0, 100, lambda i, x: jnp.cos(x), jnp.ones(300000))
print(abs(x - 0.7390851332).max() < 1e-6, jb.fast_loops())
"""
LATE = """
import os
import jax
import jax.numpy as jnp
import jaxbody as jb
jnp.ones(3)
try:
    jb.fast_loops()
except jb.JaxbodyError as error:
    print(error.code, "before any array" in str(error), "threshold" in os.environ["XLA_FLAGS"])
"""
before_012 = pytest.mark.skipif(
    not HAS_SLOW_LOOPS, reason="from jaxlib 0.12 on fast_loops does nothing"
)


@before_012
@pytest.mark.long
def test_fast_loops_are_set_once_beside_what_is_there():
    held = "--xla_backend_extra_options="
    flags = f"--xla_cpu_prefer_vector_width=128 {held}xla_cpu_disable_new_fusion_emitters=false"
    message = run(FAST)
    width = "--xla_cpu_prefer_vector_width=512"
    assert message == [
        f"True True {width} {held}xla_cpu_small_while_loop_byte_threshold=100000000",
        "True True",
    ]
    assert (
        message[0].split()[2:]
        == run(FAST, XLA_FLAGS="--xla_cpu_multi_thread_eigen=true")[0].split()[3:]
    )
    kept = run(FAST.split("import jax.numpy")[0], XLA_FLAGS=flags)[0]
    assert kept.endswith(flags + ",xla_cpu_small_while_loop_byte_threshold=100000000")


@before_012
@pytest.mark.long
def test_fast_loops_come_too_late_after_the_first_array():
    assert run(LATE) == ["TOO_LATE True False"]


@pytest.mark.skipif(HAS_SLOW_LOOPS, reason="before jaxlib 0.12 fast_loops sets options")
def test_fast_loops_do_nothing_where_loops_are_fast():
    assert run(FAST, XLA_FLAGS="--xla_cpu_multi_thread_eigen=true") == [
        "False False --xla_cpu_multi_thread_eigen=true",
        "True False",
    ]


CACHED = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
import jaxbody as jb
model = jb.presets.quarter_car()
jb.quick_options()  # tries what XLA knows; where it does not know it (jaxlib 0.12), there is no program to keep
with jb.compile_times() as spent:
    trajectory = jb.simulate(model, [0.0, 0.1])
print(spent.cached, spent.count)
"""  # noqa: E501


@pytest.mark.long
def test_programs_are_taken_from_the_persistent_cache(tmp_path):
    """Where errors of equinox are off: their calls back into Python cannot be kept."""
    runs = []
    for _ in range(2):
        program = CACHED.replace("sys.argv[1]", repr(str(tmp_path)))
        runs.append([int(n) for n in run(program, EQX_ON_ERROR="nan")[0].split()])
    assert runs[0][0] < runs[0][1]
    assert runs[1][0] >= runs[1][1] > 0
