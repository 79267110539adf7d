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


CACHED = """
import sys
import jax
jax.config.update("jax_enable_x64", True)
jax.config.update("jax_compilation_cache_dir", sys.argv[1])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.0)
import jaxbody as jb
model = jb.presets.quarter_car()
with jb.compile_times() as spent:
    trajectory = jb.simulate(model, [0.0, 0.1])
print(spent.cached, spent.count)
"""


@pytest.mark.long
def test_programs_are_taken_from_the_persistent_cache(tmp_path):
    """Where errors of equinox are off: their calls back into Python cannot be kept."""
    runs = []
    for _ in range(2):
        program = CACHED.replace("sys.argv[1]", repr(str(tmp_path)))
        runs.append([int(n) for n in run(program, EQX_ON_ERROR="nan")[0].split()])
    assert runs[0][0] < runs[0][1]
    assert runs[1][0] >= runs[1][1] > 0
