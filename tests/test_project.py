"""The project keeps its own rules: files in layers, each with one idea, imports without side effects, examples in docstrings that run."""

import ast
import builtins
import dis
import doctest
import gc
import importlib
import inspect
import os
import shutil
import subprocess
import sys
from pathlib import Path

import conftest
import jax
import jax.numpy as jnp
import pytest

import jaxbody as jb

PACKAGE = Path(jb.__file__).parent

# From the ground up; a module imports only from modules before it.
ROWS = (
    "jax_internals progress_lines errors tables results arrays arguments precisions exports compilations recompilations options units texts sources mat_files universal_files formats",
    "lane_marks symmetric_eigenvalues lanes trigonometry vectors rotations frames linear_solves eigenproblems integrators",
    "tracings motions samplings repairs measurements recordings response_files base_motions splines signals roads orientations places bodies joints curves laws elements torsions contacts loads element_checks storage states models presets naming checks",
    "kinematics mechanics dynamics momenta derivatives",
    "culprits load_paths descents statics cases preloads equilibria linear_readings ports state_spaces linearizations",
    "mode_names vibrations energies mount_axes spins poles branches nonlinearities",
    "modal_dampings spectra road_spectra frequency_responses random_responses weightings collocations rests simulations",
    "channels transducers sensors records attitudes instruments gauges",
    "experiments diagnoses plausibilities measured_responses measured_modes parametrizations ties free_parameters field_units losses colorings tasks checkpoints beginnings",
    "autocorrelations noises uncertainties intervals searches fits implicit_fits identification multistarts shootings profiles validations confidence_bands",
    "design_spaces interior_points optimizers design_programs kinks tunings objectives designs fronts sweeps sensitivity_analyses tolerance_analyses",
    "canvases annotations model_plots motion_plots mode_plots response_plots fit_plots measured_plots design_plots plots demos",
)
LAYERS = " ".join(ROWS).split()

MODULES = sorted(path.stem for path in PACKAGE.glob("*.py") if path.stem != "__init__")
OPEN = {"laws", "objectives", "plots", "presets", "signals", "units"}  # modules that are public themselves
EXPORTED = sorted(set(dir(jb)) - OPEN)


def tree_of(module: str) -> ast.Module:
    return ast.parse((PACKAGE / f"{module}.py").read_text())


def imported_modules(tree: ast.AST) -> set[str]:
    """Modules of this package that a file imports, anywhere in it."""
    found = set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and node.level == 0 and node.module == "jaxbody":
            found |= {alias.name if alias.name in MODULES else "__init__" for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.level == 0 and (node.module or "").startswith("jaxbody."):
            found.add((node.module or "").split(".")[1])
        elif isinstance(node, ast.ImportFrom) and node.level:
            found.add("a relative import")
        elif isinstance(node, ast.Import):
            found |= {alias.name.partition(".")[2] or "__init__" for alias in node.names if alias.name.split(".")[0] == "jaxbody"}
    return found


def test_every_module_has_its_layer():
    assert len(set(LAYERS)) == len(LAYERS)
    assert sorted(set(MODULES) - set(LAYERS)) == [], "give new modules their place in LAYERS"


@pytest.mark.parametrize("module", MODULES)
def test_imports_go_down_only(module):
    allowed = {"__init__"} if module == "demos" else set()  # the first command uses the library as its users do
    allowed |= set(LAYERS[: LAYERS.index(module)])
    assert sorted(imported_modules(tree_of(module)) - allowed) == []


def test_an_upward_import_would_be_found():
    source = "def f():\n    from jaxbody.simulations import simulate\n\nimport jaxbody\nfrom jaxbody import statics\nfrom . import x\n"
    assert imported_modules(ast.parse(source)) == {"simulations", "__init__", "statics", "a relative import"}


@pytest.mark.parametrize("module", MODULES)
def test_every_name_that_code_uses_is_there(module):
    """Ruff looks for undefined names in shapes, too, and cannot do it here; annotations are no code."""
    known = set(vars(importlib.import_module(f"jaxbody.{module}"))) | set(dir(builtins))
    codes, used = [compile((PACKAGE / f"{module}.py").read_text(), module, "exec")], set()
    while codes:
        code = codes.pop()
        codes += [const for const in code.co_consts if inspect.iscode(const)]
        used |= {i.argval for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"}
    assert sorted(used - known) == []


@pytest.mark.parametrize("module", ["__init__", *MODULES])
def test_the_first_line_of_a_module_is_its_idea(module):
    first = (PACKAGE / f"{module}.py").read_text().splitlines()[0]
    assert first.startswith('"""') and len(first) > 20 and len(first) <= 140


@pytest.mark.parametrize("module", ["__init__", *MODULES])
def test_nothing_is_evaluated_executed_or_unpickled(module):
    forbidden = {"eval", "exec", "compile", "__import__"}
    for node in ast.walk(tree_of(module)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in forbidden, f"{module}.py:{node.lineno}"
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = {alias.name.split(".")[0] for alias in node.names} | {(getattr(node, "module", None) or "").split(".")[0]}
            assert not names & {"pickle", "dill", "cloudpickle", "marshal", "shelve"}, f"{module}.py:{node.lineno}"


IMPORT_ALONE = """
import sys
import jax
from jax._src import xla_bridge
import jaxbody
for name in dir(jaxbody):
    getattr(jaxbody, name)
print(jax.config.jax_enable_x64, xla_bridge.backends_are_initialized())
print(*sorted({"matplotlib", "scipy.optimize", "xarray", "pandas"} & set(sys.modules)))
"""


@pytest.mark.everywhere
def test_import_has_no_side_effects():
    """Precision stays as it was, no array is made (JAX has not even looked for devices), nothing slow is imported that may not be needed."""
    done = subprocess.run([sys.executable, "-c", IMPORT_ALONE], capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout == "False False\n\n"


USED = """
import sys
import jaxbody as jb
jb.Model, jb.Body, jb.Support, jb.Spring, jb.Harmonic, jb.simulate
print(*sorted(name for name in sys.modules if name.startswith("jaxbody.")))
print(*sorted({"optax", "scipy", "matplotlib", "threadpoolctl"} & set(sys.modules)))
"""


def test_what_is_not_used_is_not_imported():
    done = subprocess.run([sys.executable, "-c", USED], capture_output=True, text=True, timeout=300, check=True)
    ours, others = done.stdout.splitlines()
    layers = [LAYERS.index(name.partition(".")[2]) for name in ours.split()]
    assert "jaxbody.simulations" in ours and max(layers) == LAYERS.index("simulations")
    assert not {"jaxbody.vibrations", "jaxbody.measurements", "jaxbody.presets"} & set(ours.split())
    assert others == ""


def test_no_function_has_the_name_of_a_module():
    """Importing the module would put it in the function's place."""
    assert set(dir(jb)) & set(MODULES) == OPEN
    assert not any(inspect.ismodule(getattr(jb, name)) for name in EXPORTED)


def test_public_names_are_there_however_they_are_asked_for():
    everything: dict[str, object] = {}
    exec("from jaxbody import *\nfrom jaxbody import Spring as S, laws as l, elements as e", everything)
    assert set(EXPORTED) <= set(everything) and everything["laws"] is everything["l"] is jb.laws
    assert everything["Spring"] is everything["S"] is everything["e"].Spring is jb.Spring
    assert not hasattr(jb, "Sprung")
    with pytest.raises(ImportError, match="Sprung"):
        exec("from jaxbody import Sprung")


def test_type_checkers_are_given_the_same_names():
    offered = set()
    for node in ast.parse((PACKAGE / "__init__.pyi").read_text()).body:
        if isinstance(node, ast.ImportFrom):
            for alias in node.names:
                assert alias.asname == alias.name
                where = importlib.import_module(node.module or "")
                assert hasattr(where, alias.name) or importlib.import_module(f"{node.module}.{alias.name}")
                assert alias.name in OPEN or getattr(where, alias.name) is getattr(jb, alias.name)
                offered.add(alias.name)
    assert sorted(offered) == dir(jb)
    assert (PACKAGE / "py.typed").exists()


FROM_A_ZIP = """
import sys
sys.path.insert(0, sys.argv[1])
import jaxbody as jb
import jaxbody.presets
assert jb.__file__.startswith(sys.argv[1])
jb.simulate(jb.presets.quarter_car(), [0.0, 0.01])
[getattr(jb, name) for name in dir(jb)]
"""


@pytest.mark.everywhere
def test_jaxbody_runs_from_a_zip(tmp_path):
    archive = shutil.make_archive(str(tmp_path / "jaxbody"), "zip", PACKAGE.parent, "jaxbody")
    command = [sys.executable, "-c", FROM_A_ZIP, archive]
    done = subprocess.run(command, capture_output=True, text=True, timeout=300, cwd=tmp_path, env=os.environ | {"JAX_ENABLE_X64": "1"})
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("module", sorted(OPEN))
def test_a_public_module_lists_what_it_offers_and_nothing_else(module):
    """What has an example in its docstring, and of pictures whatever any module of pictures draws: no imports, no helpers."""
    sources = [name for name in MODULES if name.endswith("_plots")] if module == "plots" else [module]
    offered = set()
    for source in sources:
        imported = importlib.import_module(f"jaxbody.{source}")
        own = {name: x for name, x in vars(imported).items() if getattr(x, "__module__", None) == imported.__name__ and name[0] != "_"}
        draws = {
            name
            for name, x in own.items()
            if inspect.isfunction(x) and "ax" in inspect.signature(x).parameters and inspect.signature(x).parameters["ax"].default is None
        }
        offered |= draws if module == "plots" else {name for name, x in own.items() if ">>>" in (x.__doc__ or "")}
    assert dir(importlib.import_module(f"jaxbody.{module}")) == sorted(offered)


@pytest.mark.parametrize("name", EXPORTED)
def test_everything_public_is_explained_by_an_example(name):
    thing = getattr(jb, name)
    assert callable(thing) and inspect.getdoc(thing), name
    assert doctest.DocTestParser().get_examples(thing.__doc__ or ""), f"{name} has no >>> example"


# Whose examples take more than five seconds, nearly all of it compiling.
SLOW = [
    "branches",
    "cases",
    "confidence_bands",
    "equilibria",
    "mode_plots",
    "mount_axes",
    "multistarts",
    "nonlinearities",
    "objectives",
    "poles",
    "shootings",
    "spins",
]


@pytest.mark.everywhere  # each public function has an example
@pytest.mark.parametrize("module", [pytest.param(m, marks=[pytest.mark.long] * (m in SLOW)) for m in MODULES])
def test_examples_in_docstrings_run(module):
    """With jb, jax, jnp and the public names at hand."""
    imported = importlib.import_module(f"jaxbody.{module}")
    names = {name: getattr(jb, name) for name in EXPORTED} | {"jb": jb, "jax": jax, "jnp": jnp}
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    told: list[str] = []
    for test in doctest.DocTestFinder(exclude_empty=True).find(imported, module, extraglobs=names):
        runner.run(test, out=told.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(told)


def test_the_suite_ends_without_stray_tracebacks():
    """At its end pytest collects garbage, in each worker; what is alive is left out of that, so that it ends before it is interrupted."""
    alive = len(gc.get_objects())
    conftest.pytest_sessionfinish()
    try:
        assert len(gc.get_objects()) < alive / 100
    finally:
        gc.unfreeze()
