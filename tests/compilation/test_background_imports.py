"""Modules are imported by another thread while XLA compiles, and only then."""

import sys
import threading

import jax
import pytest

from jaxbody.compilation.background_imports import imported_while_compiling

pytestmark = pytest.mark.everywhere

MODULE = """
import sys, threading
sys.imported_by = threading.current_thread()
"""


def test_a_module_is_imported_while_a_program_is_compiled(tmp_path, monkeypatch):
    (tmp_path / "imported_late.py").write_text(MODULE)
    monkeypatch.syspath_prepend(tmp_path)
    with imported_while_compiling("imported_late"):
        assert jax.jit(lambda x: 3.5 * x)(2.0) == 7.0
    assert sys.imported_by is not threading.main_thread() and "imported_late" in sys.modules
    del sys.modules["imported_late"], sys.imported_by
    with imported_while_compiling("imported_late"):
        pass  # nothing is compiled: it is imported when it is needed
    jax.jit(lambda x: 4.5 * x)(2.0)
    assert "imported_late" not in sys.modules


def test_errors_are_those_of_the_import_statement(tmp_path, monkeypatch):
    (tmp_path / "imported_in_vain.py").write_text("1 / 0")
    monkeypatch.syspath_prepend(tmp_path)
    with imported_while_compiling("imported_in_vain"):
        assert jax.jit(lambda x: 5.5 * x)(2.0) == 11.0
    with pytest.raises(ZeroDivisionError):
        import imported_in_vain  # noqa: F401
    with pytest.raises(KeyError), imported_while_compiling("imported_in_vain"):
        raise KeyError
