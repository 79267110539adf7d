"""The tests compute in float64, each draws its own random numbers, the same in every run, and programs compiled for a file go with it."""

import gc
import os
from pathlib import Path

import jax
import jaxlib.version
import numpy as np
import pytest

from jaxbody.numerics import lanes

jax.config.update("jax_enable_x64", True)
# `jaxbody.quick_options` for all programs, else a third of the time of the tests is compiling
if jaxlib.version.__version__.startswith("0.10."):
    os.environ["XLA_FLAGS"] = os.environ.get("XLA_FLAGS", "") + " --xla_cpu_use_fusion_emitters=false"

MAPS = Path("/proc/self/maps")
MANY = 20_000  # pieces of mapped memory; Linux ends a process that asks for more than 65530


@pytest.fixture
def rng():
    return np.random.default_rng(2011)


@pytest.fixture(params=["in lanes", pytest.param("by vmap", marks=pytest.mark.long)])
def batches(request):
    """Tests of batches run once more with lanes switched off: the way back where JAX changes what they rewrite."""
    if request.param == "in lanes":
        yield
    else:
        with lanes.switched_off():
            yield


@pytest.fixture(autouse=True, scope="module")
def room_for_programs():
    """Every compiled program is mapped memory."""
    yield
    if MAPS.exists() and MAPS.read_text().count("\n") > MANY:
        jax.clear_caches()


def pytest_sessionfinish():
    """What is alive stays out of the collections at the end: with millions of objects they take longer than the five seconds after which a
    worker is sent SIGINT, whose KeyboardInterrupt JAX's hook of the collector printed."""
    gc.freeze()


def pytest_addoption(parser):
    parser.addoption("--third", type=int, choices=(1, 2, 3), help="of the files, those whose number among all leaves this rest")


def pytest_collection_modifyitems(config, items):
    """Whole files, which share what they compile."""
    if third := config.getoption("third"):
        files = sorted({item.path for item in items})
        left_out = [item for item in items if files.index(item.path) % 3 != third - 1]
        items[:] = [item for item in items if item not in left_out]
        config.hook.pytest_deselected(items=left_out)
