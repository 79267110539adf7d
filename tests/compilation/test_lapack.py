"""jaxlib finds LAPACK without the rest of scipy.linalg, which can be imported afterwards as if nothing had been loaded of it."""

import subprocess
import sys

import pytest

from jaxbody.compilation import late_imports

pytestmark = pytest.mark.everywhere

ALONE = """
import sys
import jax, jax.numpy as jnp, numpy as np
from jaxbody.compilation import late_imports
jaxlibs_own = {jaxlibs_own}
if jaxlibs_own:
    late_imports.PathFinder = type("NoFinder", (), {{"find_spec": staticmethod(lambda name, folder: None)}})
late_imports.find_lapack()
A = jnp.array([[4.0, 1.0], [1.0, 3.0]])
values = jnp.linalg.eigh(A)[0]
again = jax.__version_info__ < (0, 8)  # jaxlib then looks each time, and imports all of it
assert ("scipy.linalg" in sys.modules) == (jaxlibs_own or again), [name for name in sys.modules if "linalg" in name]
import scipy.linalg
from scipy.linalg.lapack import dpotrf
assert scipy.linalg.cython_lapack.__name__ == late_imports.HOLDERS[1] and scipy.linalg.cython_blas is sys.modules[late_imports.HOLDERS[0]]
np.testing.assert_allclose(values, scipy.linalg.eigh(np.asarray(A))[0], rtol=1e-6)  # float32
np.testing.assert_allclose(jnp.linalg.cholesky(A), np.tril(dpotrf(np.asarray(A), lower=True)[0]), rtol=1e-6)
"""


@pytest.mark.parametrize("jaxlibs_own", [False, True])
def test_programs_with_lapack_run_and_scipy_linalg_can_be_imported_later(jaxlibs_own):
    """Also where its parts cannot be loaded alone: jaxlib then imports all of it. If False fails, SciPy or jaxlib has moved."""
    done = subprocess.run([sys.executable, "-c", ALONE.format(jaxlibs_own=jaxlibs_own)], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr


def test_lapack_is_looked_up_once_and_without_a_function_of_jaxlib(monkeypatch):
    """By the lowering of a factorization, where that function does not exist."""
    lowered = []
    monkeypatch.setattr(late_imports.jnp.linalg, "cholesky", lambda x: lowered.append(x.shape) or x)
    for exists, count in ((True, 0), (False, 1)):
        if not exists:
            monkeypatch.delattr("jaxlib.lapack.prepare_lapack_call")
        late_imports.find_lapack.cache_clear()
        late_imports.find_lapack()
        late_imports.find_lapack()
        assert len(lowered) == count
