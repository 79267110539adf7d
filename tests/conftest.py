"""The tests compute in float64, and each draws its own random numbers, the same in every run."""

import os

# Most of the suite's time goes into optimizing programs that run once.
os.environ.setdefault("XLA_FLAGS", "--xla_backend_optimization_level=0")

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)


@pytest.fixture
def rng():
    return np.random.default_rng(2011)
