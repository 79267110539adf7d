"""Files and data are never run: no eval, exec, pickle, shell, YAML or network in what reads and
writes them, by any name."""

import ast
from pathlib import Path

import pytest

import jaxbody as jb

PACKAGE = Path(jb.__file__).parent
STARTING = {"mjcf_documents": {"subprocess"}}  # a program of the package, to which the file is data
READERS = ("files", "files/studies", "files/interchange", "records")
REFUSED = {
    "eval",
    "exec",
    "compile",
    "__import__",
    "builtins",
    "__builtins__",
    "globals",
    "__subclasses__",
    "import_module",
    "runpy",
    "ctypes",
    "pickle",
    "cPickle",
    "dill",
    "cloudpickle",
    "joblib",
    "marshal",
    "shelve",
    "read_pickle",
    "to_pickle",
    "allow_pickle",
    "yaml",
    "os",
    "popen",
    "Popen",
    "subprocess",
    "pty",
    "socket",
    "urllib",
    "urllib3",
    "http",
    "requests",
    "ftplib",
    "urlopen",
    "urlretrieve",
}
ALLOWED = {
    "re.compile": "a pattern is no program",
    "allow_pickle=False": "NumPy's word for refusing",
    "importlib.import_module": (
        "of the modules in allow=[...], see "
        "test_own_classes_are_taken_from_modules_that_are_allowed"
    ),
}


def words(node):
    """The names in a node of a syntax tree: used, imported or written as text for getattr and
    the like."""
    if isinstance(node, ast.Name):
        return [node.id]
    if isinstance(node, ast.Attribute):
        return [node.attr]
    if isinstance(node, ast.keyword):
        return [node.arg]
    if isinstance(node, ast.alias):
        return node.name.split(".")
    if isinstance(node, ast.ImportFrom):
        return (node.module or "").split(".")
    if isinstance(node, ast.Constant) and isinstance(node.value, str):
        return (
            node.value.split(".")
            if all(part.isidentifier() for part in node.value.split("."))
            else []
        )
    return []


def refused_in(text, allowed=frozenset()):
    """What a program says that is refused, but for these words."""
    nodes = (node for node in ast.walk(ast.parse(text)) if ast.unparse(node) not in ALLOWED)
    return [ast.unparse(node) for node in nodes if (REFUSED - allowed) & set(words(node))]


@pytest.mark.parametrize(
    "path",
    [path for package in READERS for path in sorted((PACKAGE / package).glob("*.py"))],
    ids=lambda path: path.stem,
)
def test_no_file_can_run_anything(path):
    assert refused_in(path.read_text(), STARTING.get(path.stem, frozenset())) == []


def test_modules_are_imported_in_one_place():
    found = [
        path.name
        for package in READERS
        for path in (PACKAGE / package).glob("*.py")
        if "import_module" in path.read_text()
    ]
    assert found == ["builders.py"]


EVIL = [
    "eval(text)",
    "run = exec",
    "import os as x",
    "import os.path",
    "from os import system as s",
    "from subprocess import run",
    "getattr(module, 'eval')",
    "np.load(file, allow_pickle=True)",
    "__import__('x')",
    "import pickle",
    "pd.read_pickle(file)",
    "import yaml",
    "from urllib.request import urlopen",
    "().__class__.__base__.__subclasses__()",
    "vars(x)['__builtins__']",
    "compile(text, '', 'exec')",
    "from importlib import import_module",
]


@pytest.mark.parametrize("text", EVIL)
def test_it_is_found_by_any_name(text):
    assert refused_in(text)
