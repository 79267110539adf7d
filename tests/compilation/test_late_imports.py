"""Modules are imported by another thread while XLA compiles, and only then; laws and presets at their first use."""

import importlib
import subprocess
import sys
import threading

import jax
import pytest

from jaxbody.compilation.late_imports import while_compiling
from jaxbody.workers.chunk_programs import precision

pytestmark = pytest.mark.everywhere

MODULE = """
import sys, threading
sys.imported_by = threading.current_thread()
"""


def test_a_module_is_imported_while_a_program_is_compiled(tmp_path, monkeypatch):
    (tmp_path / "imported_late.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    with while_compiling(lambda: importlib.import_module("imported_late")):
        assert jax.jit(lambda x: 3.5 * x)(2.0) == 7.0
    assert sys.imported_by is not threading.main_thread() and "imported_late" in sys.modules
    del sys.modules["imported_late"], sys.imported_by
    with while_compiling(lambda: importlib.import_module("imported_late")):
        pass  # nothing is compiled: it is imported when it is needed
    jax.jit(lambda x: 4.5 * x)(2.0)
    assert "imported_late" not in sys.modules


def test_errors_are_those_of_the_import_statement(tmp_path, monkeypatch):
    (tmp_path / "imported_in_vain.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(tmp_path)
    with while_compiling(lambda: importlib.import_module("imported_in_vain")):
        assert jax.jit(lambda x: 5.5 * x)(2.0) == 11.0
    with pytest.raises(ZeroDivisionError):
        import imported_in_vain  # noqa: F401
    with pytest.raises(KeyError), while_compiling(lambda: importlib.import_module("imported_in_vain")):
        raise KeyError


@pytest.mark.parametrize("other", [False, True])
def test_a_task_computes_with_the_precision_of_its_caller_or_not_at_all(other):
    """A context of one thread is none of another: what the task had made in float64 would be taken for float32."""
    done = []
    with precision(jax.config.jax_enable_x64 != other), while_compiling(lambda: done.append(threading.current_thread())):
        jax.jit(lambda x: (6.5 + other) * x)(2.0)
    assert (done == []) == other and threading.main_thread() not in done


def test_laws_and_presets_are_imported_at_their_first_use():
    script = """
import sys
import jaxbody as jb
car = jb.presets.quarter_car()
assert "jaxbody.laws.hydraulic_mounts" not in sys.modules and "jaxbody.presets.linkages" not in sys.modules
assert jb.laws.Hydraulic is sys.modules["jaxbody.laws.hydraulic_mounts"].Hydraulic and jb.presets.four_bar
from jaxbody.laws import *
assert LuGre is jb.laws.LuGre
try:
    jb.laws.Hydrolic
except AttributeError as error:
    assert str(error) == "module 'jaxbody.laws' has no attribute 'Hydrolic'"
else:
    raise AssertionError
"""
    done = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
