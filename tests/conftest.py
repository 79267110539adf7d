"""The tests compute in float64, and each draws its own random numbers, the same in every run."""

import jax
import numpy as np
import pytest

jax.config.update("jax_enable_x64", True)


@pytest.fixture
def rng():
    return np.random.default_rng(2011)
