"""Programs on disk: a second process traces nothing and computes the same numbers; whatever is wrong with a file, it is made anew."""

import contextlib
import json
import os
import subprocess
import sys
import time
import zlib
from concurrent.futures import ThreadPoolExecutor

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.compilation import kept_programs
from jaxbody.compilation.array_functions import array_function
from jaxbody.compilation.kept_programs import KeptPrograms, keep_programs
from jaxbody.compilation.shared_settings import without_cache
from jaxbody.core.jax_internals import code_can_be_run

pytestmark = [pytest.mark.everywhere, pytest.mark.nan]

CODE = code_can_be_run()
ALL_KEPT = jax.__version_info__ >= (0, 8)  # jax 0.7 cannot export all that the gradient consists of

PROCESS = """
import json, sys
import jax, jax.numpy as jnp
jax.config.update("jax_enable_x64", True)
import jaxbody as jb

folder, damping = sys.argv[1], float(sys.argv[2])
kept = jb.keep_programs(folder) if folder else None
model = jb.presets.quarter_car(damping=damping)
frequency = lambda model: jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]
with jb.compile_times() as times:
    f, slope = jax.value_and_grad(frequency)(model)
    several = jax.vmap(lambda k: frequency(jb.replace(model, {"*.stiffness": k})))(jnp.array([1e4, 2e4]))
    plain = frequency(model)
    loud = jb.simulate(model, [0.0, 0.1], motion={"road": lambda t: 0.001 * t * jnp.array([0, 0, 1.0, 0, 0, 0])})
numbers = [f, plain, *jax.tree.leaves(slope), *several, *loud.state.q.ravel(), *loud.state.v.ravel()]
traced = sum(seconds for name, (seconds, *_) in times.programs.items() if name != "integrate")
state = [kept.loaded, kept.saved, kept.left_out] if kept else []
print(json.dumps([[float(x).hex() for y in numbers for x in jnp.ravel(y)], traced, *state]))
"""
ENDINGS = ("", "_pullback")
DRIVERS = {name + end for name in ("equilibrium_of", "_linearize", "_modes") for end in ENDINGS}


def process(folder, damping):
    hidden = {"JAX_COMPILATION_CACHE_DIR", "XLA_FLAGS"}
    environment = {name: value for name, value in os.environ.items() if name not in hidden}
    command = [sys.executable, "-c", PROCESS, str(folder), str(damping)]
    done = subprocess.run(command, capture_output=True, text=True, timeout=600, env=environment)
    assert done.returncode == 0, done.stderr
    return json.loads(done.stdout.splitlines()[-1])


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("cache") / "programs"


@pytest.mark.long
def test_a_second_process_traces_nothing_and_computes_the_same_numbers(folder):
    """With and without programs on disk to the last digit, as it is the same code; other numbers of the same structure, too."""
    first, second, other = process(folder, 1500.0), process(folder, 1500.0), process(folder, 900.0)
    assert first[0] == second[0] == process("", 1500.0)[0]
    assert other[0] == process("", 900.0)[0] != first[0]
    assert "cannot name" in first[4]["integrate"]  # its motion is a function of the user
    if ALL_KEPT:
        assert set(first[3]) >= DRIVERS and first[2] == []
        assert set(second[2]) == set(other[2]) == set(first[3]) and second[3] == other[3] == []
        assert second[1] < 0.2 * first[1]


@pytest.fixture
def kept(tmp_path, monkeypatch):
    """Programs of this process in a folder of their own; JAX's cache is that of all tests, or beside it."""
    monkeypatch.setattr(kept_programs, "_kept", None)
    before = jax.config.jax_compilation_cache_dir
    jax.config.update("jax_compilation_cache_dir", before or str(tmp_path / "of_jax"))
    yield keep_programs(tmp_path / "programs")
    kept_programs._types_of_results.cache_clear()  # which has what was kept, with its code, among its keys
    jax.config.update("jax_compilation_cache_dir", before)
    kept_programs.compilation_cache.reset_cache()


SMALL = jb.presets.quarter_car(damping=1500.0)


def poses(model):
    """The result of a small driver of the package, with its structure."""
    result = model.reference
    return jax.tree.map(np.asarray, result)


def again(folder):
    """What another process would see."""
    kept_programs._kept = None
    return keep_programs(folder)


def same(a, b):
    return jax.tree.structure(a) == jax.tree.structure(b) and all(map(np.array_equal, jax.tree.leaves(a), jax.tree.leaves(b)))


@pytest.fixture(params=["code", "exported"])
def form(request, monkeypatch):
    """What is kept of a program: its code, or what `jax.export` makes of it where code cannot be run."""
    if request.param == "exported" or not CODE:
        monkeypatch.setattr(kept_programs, "code_can_be_run", lambda: False)
    return ".code" if kept_programs.code_can_be_run() else ".program"


def test_a_program_is_saved_once_and_loaded_then(kept, form):
    expected = poses(SMALL)
    assert (kept.saved, kept.loaded, kept.left_out) == (["drawn_reference"], [], {})
    assert sorted(path.suffix for path in kept.folder.iterdir()) == [form, ".types"]
    assert all(path.stat().st_mode & 0o777 == 0o600 for path in kept.folder.iterdir())
    assert same(poses(SMALL), expected) and kept.saved == ["drawn_reference"]
    second = again(kept.folder)
    assert same(poses(jb.replace(SMALL, {"*.stiffness": 3.0})), expected)
    assert (second.saved, second.loaded) == ([], ["drawn_reference"])
    assert "drawn_reference" in repr(second) and "loaded" in repr(second)


def damaged(data):
    return data[:-7] + bytes([data[-7] ^ 1]) + data[-6:]


DAMAGES = {
    "truncated": lambda data: data[: len(data) // 2],
    "empty": lambda data: b"",
    "one bit": damaged,
    "foreign": lambda data: b"something else\n" + data,
    "of another program": lambda data: data.replace(data.split()[3], b"0" * 64, 1),
}


@pytest.mark.parametrize("damage", DAMAGES)
def test_a_damaged_file_is_replaced(kept, form, damage):
    expected = poses(SMALL)
    whole = {path: path.read_bytes() for path in kept.folder.iterdir()}
    for path, data in whole.items():
        path.write_bytes(DAMAGES[damage](data))
    second = again(kept.folder)
    assert same(poses(SMALL), expected) and (second.saved, second.loaded) == (["drawn_reference"], [])
    begins = {path.name: data.split(b"\n", 1)[1][:100] for path, data in whole.items()}
    replaced = {name: (second.read(name) or b"")[:100] for name in begins}
    assert all(replaced.values())
    assert all(replaced[name] == begin for name, begin in begins.items() if not name.endswith(".code"))  # XLA numbers its code anew


needs_code = pytest.mark.skipif(not CODE, reason="this version of JAX, or a device that is no CPU, cannot run saved code")


@needs_code
def test_saved_code_runs_without_lowering(kept):
    """To the last digit as when it was compiled. The arrays may go to another device, like those of any program."""
    expected = poses(SMALL)
    second = again(kept.folder)
    with jb.compile_times() as times:
        q = SMALL.reference.q
    assert (times.count, second.loaded, second.saved) == (0, ["drawn_reference"], [])
    assert np.array_equal(q, expected.q) and not q.committed


def file_of_code(folder):
    return next(folder.glob("*.code"))


def incomplete(code):
    """XLA notices a function that is missing only when it calls it."""

    def run(arrays):
        raise jax.errors.JaxRuntimeError("NOT_FOUND: Function broadcast_pad_fusion not found")

    return run


@needs_code
@pytest.mark.parametrize("broken", [lambda code: None, incomplete])
def test_code_that_does_not_run_is_replaced(kept, broken, monkeypatch):
    expected = poses(SMALL)
    code = file_of_code(kept.folder)
    second, before = again(kept.folder), code.read_bytes()
    with monkeypatch.context() as patched:
        patched.setattr(kept_programs, "runner", broken)
        assert same(poses(SMALL), expected) and (second.saved, second.loaded) == (["drawn_reference"], [])
    assert code.read_bytes() != before and second.read(code.name)
    third = again(kept.folder)
    assert same(poses(SMALL), expected) and (third.saved, third.loaded) == ([], ["drawn_reference"])


@needs_code
def test_saved_code_takes_arrays_of_numpy(kept):
    expected = poses(SMALL)
    second = again(kept.folder)
    assert np.array_equal(jax.tree.map(np.asarray, SMALL).reference.q, expected.q) and second.loaded == ["drawn_reference"]


def test_programs_of_random_keys_are_kept_without_code(kept):
    key = jax.random.key(3)
    program, arrays = array_function(jax.random.split, (key,))
    first = kept_programs.call(program, (), arrays)[0]
    second = again(kept.folder)
    for (keys,) in (first, kept_programs.call(program, (), arrays)[0]):
        assert np.array_equal(jax.random.key_data(keys), jax.random.key_data(jax.random.split(key)))
    assert len(kept.saved) == 1 and second.loaded == kept.saved and second.left_out == {} and not list(kept.folder.glob("*.code"))


@needs_code
def test_code_that_calls_python_is_not_kept(kept):
    """It would call an address of this process."""

    def doubled(x):
        return jax.lax.cond(x > 0, lambda: jax.pure_callback(lambda x: 2 * x, x, x), lambda: x)

    program, arrays = array_function(doubled, (jnp.array(3.0),))
    run = kept.compiled(program, (), tuple(map(jax.typeof, arrays)), "some.code")
    assert run(arrays) == [6.0] and kept.saved == [] and "function of Python" in kept.left_out["doubled"]
    assert not (kept.folder / "some.code").exists()


@needs_code
def test_bytes_that_are_no_code_are_not_run(kept):
    poses(SMALL)
    kept.write("some.code", zlib.compress(b"no code"), "f")
    assert kept.loaded_code("some.code") is None


@needs_code
def test_code_is_not_taken_from_the_cache_of_jax(kept, monkeypatch):
    """What XLA has loaded lacks functions when it is saved again."""
    with monkeypatch.context() as changed:  # `undo` would also undo what the fixture has set
        changed.setattr(kept_programs, "without_cache", contextlib.nullcontext)
        expected = poses(SMALL)  # compiled with JAX's cache
    enabled = jax.config.jax_enable_compilation_cache
    file_of_code(kept.folder).unlink()
    again(kept.folder)
    poses(SMALL)
    third = again(kept.folder)
    assert same(poses(SMALL), expected) and third.loaded == ["drawn_reference"] and third.saved == []
    assert jax.config.jax_enable_compilation_cache == enabled


@needs_code
def test_code_is_of_the_options_of_xla_and_jax(kept, monkeypatch):
    poses(SMALL)
    names = {kept_programs._settings()}
    monkeypatch.setenv("XLA_FLAGS", f"{os.environ.get('XLA_FLAGS', '')} --xla_cpu_prefer_vector_width=128")
    names.add(kept_programs._settings())
    with jax.default_matmul_precision("float32"):
        names.add(kept_programs._settings())
    assert len(names) == 3
    second = again(kept.folder)
    poses(SMALL)
    assert second.saved == ["drawn_reference"] and len(list(kept.folder.glob("*.code"))) == 2


@needs_code
def test_code_of_the_last_process_with_a_task_is_loaded_ahead(kept):
    expected = poses(SMALL)
    kept.note_task("modes car.toml")
    for task, count in {"modes bus.toml": 0, "modes car.toml": 1}.items():
        second = again(kept.folder)
        second.load_ahead(task)
        assert [name.endswith(".code") for name in second.ahead] == [True] * count
        if second.ahead:
            assert next(iter(second.ahead.values())).result() is not None
            file_of_code(kept.folder).unlink()  # it is in memory
        assert same(poses(SMALL), expected) and second.loaded == ["drawn_reference"]


def test_what_a_program_depends_on_is_in_its_name(kept, monkeypatch):
    names = {kept.name_of(jb.fit, ())}
    for key, value in {"_versions": lambda: "a line of source changed", "_precision": lambda: "float32"}.items():
        with monkeypatch.context() as changed:
            changed.setattr(kept_programs, key, value)
            names.add(kept.name_of(jb.fit, ()))
    types = [(jax.typeof(jnp.zeros(3)),), (jax.typeof(jnp.zeros(4)),), (jax.typeof(jnp.zeros(3, "float32")),), (jax.typeof(1.0),)]
    names |= {kept.name_of(jb.fit, t) for t in types} | {kept.name_of(jb.modes, ())}
    assert len(names) == 8 - (not jax.config.jax_enable_x64)
    assert all(text in kept_programs._versions() for text in (f"jax {jax.__version__}", "jaxlib", "diffrax"))
    assert str(jax.config.jax_enable_x64) in kept_programs._precision()


def test_the_source_of_the_package_is_part_of_the_name(monkeypatch, tmp_path):
    (tmp_path / "inner").mkdir()
    (tmp_path / "inner" / "a.py").write_text("x = 1")
    monkeypatch.setattr(kept_programs.resources, "files", lambda _: tmp_path)
    monkeypatch.setattr(kept_programs, "hash_of_source", kept_programs.hash_of_source.__wrapped__)  # else it is computed once
    texts = [kept_programs._versions.__wrapped__()]
    (tmp_path / "inner" / "a.py").write_text("x = 2")
    assert kept_programs._versions.__wrapped__() != texts[0]


@pytest.mark.parametrize("mode", [0o755, 0o770, 0o701])
def test_a_folder_that_is_open_to_others_is_refused(tmp_path, mode):
    (tmp_path / "programs").mkdir(mode=0o700)
    (tmp_path / "programs").chmod(mode)
    with pytest.raises(jb.JaxbodyError, match=f"{mode:04o}.*chmod 700") as error:
        keep_programs(tmp_path / "programs")
    assert error.value.code == "UNSAFE_FOLDER"


def test_a_folder_of_somebody_else_is_refused(tmp_path, monkeypatch):
    monkeypatch.setattr(os, "getuid", lambda: 12345)
    with pytest.raises(jb.JaxbodyError, match="belongs to user"):
        keep_programs(tmp_path / "programs")


def test_a_folder_that_cannot_be_made_is_named(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(jb.JaxbodyError, match="file") as error:
        keep_programs(tmp_path / "file" / "programs")
    assert error.value.code == "NOT_SAVED"


def test_a_full_disk_costs_the_file_only(kept, monkeypatch):
    def full(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "replace", full)
    assert poses(SMALL).q.shape == (2,) and kept.saved == []
    assert "No space left" in kept.left_out["drawn_reference"] and list(kept.folder.iterdir()) == []


def test_the_oldest_files_make_room(kept, monkeypatch):
    """Also those that seem to be of tomorrow, as the clock went back since: they are kept longest, and go when they are too many."""
    monkeypatch.setattr(kept_programs, "LARGEST", 2500)
    now = time.time()
    for name, age in {"old": 100, "older": 200, "new": 0, "of tomorrow": -86400}.items():
        kept.write(name, bytes(900), "f")
        if (kept.folder / name).exists():
            os.utime(kept.folder / name, (now - age, now - age))
    assert sorted(path.name for path in kept.folder.iterdir()) == ["new", "of tomorrow"]
    assert sum(path.stat().st_size for path in kept.folder.iterdir()) <= 2500


def test_what_was_read_is_not_old(kept, monkeypatch):
    kept.write("a", b"1", "f")
    os.utime(kept.folder / "a", (1, 1))
    assert kept.read("a") == b"1" and (kept.folder / "a").stat().st_mtime > 1e9


def test_two_writers_at_once_do_no_harm(kept):
    """A reader sees a whole file of one of them, or none."""
    contents = [bytes([i]) * 100_000 for i in range(8)]

    def write(content):
        for _ in range(20):
            assert KeptPrograms(kept.folder).write("same", content, "f")

    with ThreadPoolExecutor() as pool:
        running = [pool.submit(write, content) for content in contents]
        while not all(task.done() for task in running):
            assert kept.read("same") in (None, *contents)
        assert [task.result() for task in running] == [None] * 8
    assert [path.name for path in kept.folder.iterdir()] == ["same"]


@pytest.mark.long
def test_calls_without_jit_or_in_search_of_nan_go_past_it(kept):
    with jax.disable_jit():
        poses(SMALL)
    with jax.debug_nans(True):
        poses(SMALL)
    assert kept.saved == []


ON_TWO = """
import sys
import jax, jax.numpy as jnp
import jaxbody as jb
kept = jb.keep_programs(sys.argv[1])
model = jb.presets.quarter_car()
first, second = jax.devices()
for device in (second, first):
    assert jax.device_put(model, device).reference.q.shape == (2,)
    print(kept.saved)
"""


@pytest.mark.long
def test_programs_for_another_device_are_not_kept(tmp_path):
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=2"}
    command = [sys.executable, "-c", ON_TWO, str(tmp_path / "programs")]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, env=environment)
    assert done.stdout.splitlines() == ["[]", "['drawn_reference']"], done.stderr


@pytest.mark.long
def test_no_program_is_kept_unless_asked_for():
    """Neither by the import nor by a call of the library."""
    code = "import jax, jaxbody as jb; jb.presets.quarter_car().reference; print(jax.config.jax_compilation_cache_dir)"
    environment = {name: value for name, value in os.environ.items() if name != "JAX_COMPILATION_CACHE_DIR"}
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=300, check=True, env=environment)
    assert done.stdout.strip() == "None"


def test_threads_that_compile_without_a_cache_leave_it_as_it_was_and_name_code_alike():
    before, name = jax.config.jax_enable_compilation_cache, kept_programs._settings()
    one, other = without_cache(), without_cache()
    one.__enter__()
    other.__enter__()
    assert kept_programs._settings() == name
    one.__exit__(None, None, None)
    assert not jax.config.jax_enable_compilation_cache
    other.__exit__(None, None, None)
    assert jax.config.jax_enable_compilation_cache == before
