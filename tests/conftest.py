"""Tests compute in float64, each with its own reproducible random numbers; programs compiled for a
test file are released after it."""

import ctypes
import gc
import os
import sys
import tempfile
import traceback
from pathlib import Path

import equinox as eqx
import jax
import jaxlib.version
import jaxtyping
import numpy as np
import pytest
from beartype import BeartypeConf, beartype

jax.config.update("jax_enable_x64", True)
# What is traced are millions of objects that stay: looking for garbage among them as often as by
# default takes a tenth of the time
gc.set_threshold(50_000, 20, 50)

STATM = Path("/proc/self/statm")
# bytes of memory that a worker has in use; a file shares what it compiles
MUCH, MUCH_BETWEEN_FILES = 1.2e9, 0.8e9
# they raise where others are at fault
CHECKERS = {"jax", "jaxtyping", "beartype", "equinox", "numpy", "contextlib.py"}
# where a float is asked for, an int is one
beartyped = beartype(conf=BeartypeConf(is_pep484_tower=True))


def pytest_configure(config):
    """XLA compiles in less time, as compiling is most of what tests do: all programs without
    fusion emitters where XLA has a choice, those of the quick tests and of those with annotations
    checked without optimization, each in one piece (a fifth less time), and once for all workers.
    The others, and those chosen for every Python, run what users run."""
    if config.option.typed:
        jaxtyping.install_import_hook("jaxbody", "conftest.beartyped")
    if config.option.nans:
        jax.config.update("jax_debug_nans", True)
    flags = (
        ["--xla_cpu_use_fusion_emitters=false"]
        if jaxlib.version.__version__.startswith("0.10.")
        else []
    )
    if config.option.typed or config.option.markexpr == "not long":
        flags += ["--xla_backend_optimization_level=0", "--xla_cpu_parallel_codegen_split_count=1"]
        share_programs(config)
    os.environ["XLA_FLAGS"] = " ".join([os.environ.get("XLA_FLAGS", ""), *flags])


def share_programs(config):
    """JAX keeps compiled programs in a folder that the workers share, unless the user has one;
    workers start after this and inherit it."""
    if "JAX_COMPILATION_CACHE_DIR" not in os.environ:
        folder = tempfile.TemporaryDirectory(prefix="jaxbody-tests-")
        config.add_cleanup(folder.cleanup)
        kept = {
            "compilation_cache_dir": folder.name,
            "persistent_cache_min_compile_time_secs": 0,
            "persistent_cache_min_entry_size_bytes": -1,
        }
        for name, value in kept.items():
            os.environ[f"JAX_{name.upper()}"] = str(value)
            jax.config.update(f"jax_{name}", value)


@pytest.fixture
def rng():
    return np.random.default_rng(2011)


@pytest.fixture(params=["in lanes", pytest.param("by vmap", marks=pytest.mark.long)])
def batches(request):
    """Tests of batches run once more with lanes switched off: the way back where JAX changes what
    they rewrite."""
    if request.param == "in lanes":
        yield
    else:
        from jaxbody.numerics import lanes

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(lanes, "_no_lanes", lambda: "lanes are switched off")
            jax.clear_caches()
            yield
        jax.clear_caches()


@pytest.hookimpl(wrapper=True)
def pytest_pyfunc_call(pyfuncitem):
    """With --typed, a test is skipped in which not jaxbody is at fault: it gives a wrong kind, to
    see it refused, or it or another library promotes."""
    if not pyfuncitem.config.option.typed:
        return (yield)
    try:
        with jax.numpy_dtype_promotion("strict"), jax.numpy_rank_promotion("raise"):
            return (yield)
    except (jaxtyping.TypeCheckError, ValueError, pytest.fail.Exception) as raised:
        # which a `pytest.raises` did not expect
        error = raised.__context__ if isinstance(raised, pytest.fail.Exception) else raised
        if error is None:
            raise
        files = [Path(frame.filename) for frame in traceback.extract_tb(error.__traceback__)]
        last = [file for file in files if file.exists() and not CHECKERS & set(file.parts)][-1]
        # a wrong return value is always jaxbody's
        found = "checking the parameters of" in str(error) or "promotion" in str(error)
        if found and not last.is_relative_to(Path(sys.modules["jaxbody"].__path__[0])):
            pytest.skip("the test or another library gives another kind, or promotes")
        raise


@pytest.hookimpl(trylast=True)
def pytest_runtest_teardown(item, nextitem):
    """Release compiled programs, which JAX would keep with their traces in mapped memory, and
    return the memory to the system."""
    most = MUCH if nextitem and nextitem.path == item.path else MUCH_BETWEEN_FILES
    if STATM.exists() and int(STATM.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE") > most:
        eqx.clear_caches()
        jax.clear_caches()
        gc.collect()
        ctypes.CDLL(None).malloc_trim(0)


def pytest_sessionfinish():
    """What is alive stays out of the collections at the end: with millions of objects they take
    longer than the five seconds after which a worker is sent SIGINT, whose KeyboardInterrupt JAX's
    hook of the collector printed."""
    gc.freeze()


def pytest_addoption(parser):
    parser.addoption(
        "--typed",
        action="store_true",
        help="check all annotations of jaxbody, and raise where JAX would promote types or ranks",
    )
    parser.addoption(
        "--nans",
        action="store_true",
        help="raise where JAX makes a NaN; tests that are about one are left out",
    )
    parser.addoption(
        "--part",
        type=part,
        default=(1, 1),
        metavar="2/3",
        help="every third of the files, from the second one",
    )
    parser.addoption(
        "--part-of-examples",
        type=part,
        metavar="2/3",
        help="the same of the modules whose docstrings' examples are run",
    )


def part(text):
    """(2, 3) of "2/3"."""
    first, count = map(int, text.split("/"))
    if not 1 <= first <= count:
        raise ValueError(text)
    return first, count


def pytest_collection_modifyitems(config, items):
    """Whole files, which share what they compile; modules' examples share nothing."""
    for option, marker in (("typed", "untyped"), ("nans", "nan")):
        for item in items if getattr(config.option, option) else ():
            if item.get_closest_marker(marker):
                item.add_marker(pytest.mark.skip(reason=f"not with --{option}"))
    numbers = {path: n for n, path in enumerate(sorted({item.path for item in items}))}
    first, count = config.option.part
    asked = {item: numbers[item.path] % count == first - 1 for item in items}
    if of_examples := config.option.part_of_examples:
        first, count = of_examples
        examples = [
            item
            for item in items
            if getattr(item, "originalname", "") == "test_examples_in_docstrings_run"
        ]
        asked |= {item: n % count == first - 1 for n, item in enumerate(examples)}
    left_out = [item for item in items if not asked[item]]
    items[:] = [item for item in items if asked[item]]
    config.hook.pytest_deselected(items=left_out)
