"""The table of codes: every code of the package is in it with its meaning and remedy, and
no other."""

import ast
import re
from pathlib import Path

import jaxbody as jb
from jaxbody.core.codes import CODES

NOT_CODES = {
    "PID",
    "ABCDEFGH",
    "ASCE7",
    "CLASS",
    "CQC",
    "FILE",
    "GIF",
    "JAX_COMPILATION_CACHE_DIR",
    "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS",
    "JAX_PERSISTENT_CACHE_MIN_ENTRY_SIZE_BYTES",
    "MCK",  # the matrices
    "MKL_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "PJRT_NPROC",
    "MODULE",
    "PATH",
    "PNG",
    "TEXT",
    "NAME",
    "NFKC",
    "NONE",
    "NRMSE",
    "PSD",
    "RGB",
    "RK4",
    "SRSS",
    "XDG_CACHE_HOME",
    "XLA_FLAGS",
    "ZYX",
}
CODE = r"[A-Z][A-Z0-9]*(?:_[A-Z0-9]+)*"
COMPUTED = {"NEGATIVE_DAMPING", "NEGATIVE_STIFFNESS"}  # f"NEGATIVE_{field}" in elements
RAISES = {"add", "Problem", "warn", "JaxbodyWarning"}


def nodes():
    for file in Path(jb.__file__).parent.rglob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        table = [
            node
            for node in tree.body
            if isinstance(node, ast.Assign) and getattr(node.targets[0], "id", "") == "CODES"
        ]
        skipped = {id(node) for part in table for node in ast.walk(part)}
        yield from (node for node in ast.walk(tree) if id(node) not in skipped)


def called(node):
    return node.func.attr if isinstance(node.func, ast.Attribute) else getattr(node.func, "id", "")


def test_the_table_has_every_code_and_no_other():
    written = {
        node.value
        for node in nodes()
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    codes = {text for text in written if len(text) > 2 and re.fullmatch(CODE, text)} - NOT_CODES
    first = {
        node.args[0]
        for node in nodes()
        if isinstance(node, ast.Call) and called(node) in RAISES and node.args
    }
    raised = {
        node.value
        for node in first
        if isinstance(node, ast.Constant) and isinstance(node.value, str)
    }
    assert len(raised) > 100 and raised <= codes
    assert set(CODES) == codes | {status.name for status in jb.Status} | COMPUTED


def test_docstrings_name_codes_of_the_table():
    with_docstrings = (ast.Module, ast.ClassDef, ast.FunctionDef)
    docs = "\n".join(
        ast.get_docstring(node) or "" for node in nodes() if isinstance(node, with_docstrings)
    )
    stated = " ".join(re.findall(r"(?:Errors?|[Ww]arns)\b[^.]*", docs))
    named = {text for text in re.findall(rf"\b{CODE}\b", stated) if "_" in text}
    assert len(named) > 100 and named - set(CODES) - NOT_CODES == set()


def test_the_table_is_in_order_and_says_what_each_code_means_and_what_to_do():
    assert list(CODES) == sorted(CODES)
    lines = jb.error_codes().splitlines()
    assert len(lines) == len(CODES) and all(len(line) <= 140 for line in lines)
    for line, code in zip(lines, CODES, strict=True):
        meaning, remedy = CODES[code]
        assert line.split() == f"{code} {meaning}; {remedy}".split() and len(meaning + remedy) > 8
