"""Programs on disk: a second process compiles nothing, and a folder that others may write to
is refused."""

import json
import os
import subprocess
import sys

import pytest

import jaxbody as jb

pytestmark = pytest.mark.everywhere

PROCESS = """
import json, sys
import jax
jax.config.update("jax_enable_x64", True)
import jaxbody as jb
folder = jb.keep_programs(*sys.argv[1:])
model = jb.presets.quarter_car()
frequency = lambda model: jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]
with jb.compile_times() as times:
    found = float(frequency(model)), float(jb.jit(jax.grad(frequency))(model)["suspension"].stiffness)
print(json.dumps([found, times.count, times.cached, str(folder)]))
"""  # noqa: E501


def process(*arguments, **environment):
    hidden = {"JAX_COMPILATION_CACHE_DIR", "XLA_FLAGS"}
    clean = {
        name: value
        for name, value in os.environ.items()
        if name not in hidden and not name.startswith("JAX_PERSISTENT")
    }
    command = [sys.executable, "-c", PROCESS, *map(str, arguments)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=600, env=clean | environment
    )
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.mark.long
def test_a_second_process_takes_all_programs_from_the_folder(tmp_path):
    first, second = (process(tmp_path / "programs") for _ in range(2))
    assert first[0] == second[0] and first[2] == 0
    assert second[2] >= second[1] == first[1] > 3 and second[3] == str(tmp_path / "programs")


def test_the_folder_is_that_of_the_user_and_private(tmp_path):
    expected = tmp_path / "cache" / "jaxbody"
    assert (
        process(XDG_CACHE_HOME=str(tmp_path / "cache"))[3] == str(expected)
        and expected.stat().st_mode & 0o777 == 0o700
    )
    given = tmp_path / "of_jax"
    # JAX's own setting stays
    assert process(tmp_path / "other", JAX_COMPILATION_CACHE_DIR=str(given))[3] == str(given)
    (tmp_path / "open").mkdir(mode=0o755)
    (tmp_path / "file").write_text("")
    with pytest.raises(jb.JaxbodyError, match=r"mode 0755.*chmod 700.*UNSAFE_FOLDER"):
        jb.keep_programs(tmp_path / "open")
    with pytest.raises(jb.JaxbodyError, match="NOT_SAVED"):
        jb.keep_programs(tmp_path / "file" / "below")
