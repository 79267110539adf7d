"""The rules of the project: files in layers, each with one idea, imports without side effects,
docstring examples that run."""

import ast
import builtins
import dis
import doctest
import gc
import graphlib
import importlib
import inspect
import operator
import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import conftest
import jax
import jax.numpy as jnp
import jaxtyping
import pytest
import stubs

import jaxbody as jb
from jaxbody.geometry import vectors

PACKAGE = Path(jb.__file__).parent

# of packages, from the ground up, as `help(jaxbody)` shows them
ORDER = re.findall(r"^    ([a-z]+) +[A-Z]", jb.__doc__ or "", re.M)
MODULES = sorted(
    ".".join(path.relative_to(PACKAGE).with_suffix("").parts) for path in PACKAGE.rglob("*.py")
)
NAMED = [module for module in MODULES if not module.endswith("__init__")]
# modules that are public themselves: families of names
OPEN = {
    *(
        "closures",
        "control",
        "joints",
        "laws",
        "modal",
        "sensors",
        "inputs",
        "signals",
        "presets",
        "suspension",
        "forces",
    ),
    *(
        "vibration",
        "shock",
        "records",
        "fitting",
        "design",
        "objectives",
        "files",
        "plots",
        "views",
    ),
    "units",
}
BORROWED = {"control": {"ControlLaw"}}  # the base class that controllers of a model need
EXPORTED = sorted(set(dir(jb)) - OPEN)
PUBLIC = EXPORTED + sorted(
    f"{family}.{name}"
    for family in OPEN - {"plots"}
    for name in dir(getattr(jb, family))
    if getattr(getattr(jb, family), name) is not getattr(jb, name, None)
)
MOST_LINES = 600
INSIDE = {  # packages within packages and the files beside them, from the ground up
    "core": ("core", "core.compilation", "core.workers"),
    "model": ("model.laws", "model.forces", "model.inputs", "model.elements", "model"),
    "suspension": ("suspension", "suspension.presets"),
    "vibration": ("vibration", "vibration.control"),
    "fitting": (
        "fitting.statistics",
        "fitting.parameters",
        "fitting.experiments",
        "fitting.modal",
        "fitting",
        "fitting.planning",
    ),
    "files": ("files", "files.studies", "files.interchange"),
    "views": ("views.scenes", "views.plots", "views"),
}
MUTUAL = {"model.joints"}  # belongs to the place around it: it has a base class that `model` needs
PLACES = [place for package in ORDER for place in INSIDE.get(package, (package,))]
NO_MECHANICS = {  # and what they may import
    "core": set(),
    "core.compilation": {"core"},
    "core.workers": {"core", "core.compilation"},
    "numerics": {"core", "core.compilation"},
    "fitting.statistics": {"core", "core.compilation", "numerics"},
}
APART = {"design", "fitting"}


def path_of(module: str) -> Path:
    return PACKAGE.joinpath(*module.split(".")).with_suffix(".py")


def tree_of(module: str) -> ast.Module:
    return ast.parse(path_of(module).read_text())


def imported_modules(tree: ast.AST) -> dict[str, int]:
    """Modules of this package that a file imports, anywhere in it, and at which line; "" for the
    package itself."""
    result: dict[str, int] = {}
    for node in ast.walk(tree):
        names: list[str] = []
        if isinstance(node, ast.ImportFrom):
            if node.level:
                names = ["a relative import"]
            elif (node.module or "").split(".")[0] == "jaxbody":
                names = [f"{node.module}.{alias.name}" for alias in node.names]
        elif isinstance(node, ast.Import):
            names = [alias.name for alias in node.names if alias.name.split(".")[0] == "jaxbody"]
        elif isinstance(node, ast.Call) and ast.unparse(node.func).endswith("import_module"):
            names = [
                arg.value
                for arg in node.args
                if isinstance(arg, ast.Constant) and str(arg.value).split(".")[0] == "jaxbody"
            ]
        for name in names:
            inside = name.removeprefix("jaxbody").removeprefix(".")
            if (
                inside
                and inside != "a relative import"
                and inside not in MODULES
                and f"{inside}.__init__" not in MODULES
            ):
                inside = inside.rpartition(".")[0]
            result.setdefault(inside, node.lineno)
    return result


def place_of(module: str) -> str:
    """The innermost of the places that a module is in; its first name where it is in none."""
    inside = [place for place in PLACES if f"{module}.".startswith(f"{place}.")]
    return max(inside, key=len, default=module.split(".")[0])


def misplaced(module: str, imports: dict[str, int]) -> list[str]:
    """What a file may not import, and where the thing belongs."""
    home, text = place_of(module), []
    for other, line in imports.items():
        package, place = (
            place_of(other),
            f"jaxbody/{module.replace('.', '/')}.py:{line} imports",
        )
        if other == "a relative import":
            text.append(f"{place} relatively: write the full name")
            continue
        place += f" jaxbody.{other}"
        if package not in PLACES:
            if home not in ("__init__", "app"):
                text.append(f"{place}: import the module that defines it, not the public name")
        elif home in PLACES and PLACES.index(package) > PLACES.index(home):
            text.append(
                f"{place}: {package} comes after {home}. What both need belongs into a package "
                f"before {package}; what needs both, after it"
            )
        elif home in NO_MECHANICS and package not in NO_MECHANICS[home] | {home}:
            text.append(
                f"{place}: {home} knows no mechanics. Give it numbers, or put this file into "
                f"{package} or after it"
            )
        elif {home, package} == APART:
            text.append(
                f"{place}: what tuning and fitting share belongs into fitting.parameters or "
                f"numerics"
            )
    return text


def test_every_package_has_its_place_in_the_order():
    packages = {
        ".".join(path.parent.relative_to(PACKAGE).parts) for path in PACKAGE.rglob("*/__init__.py")
    }
    assert sorted([*PLACES, *MUTUAL]) == sorted(["lagrange", *packages])


@pytest.mark.parametrize("module", MODULES)
def test_imports_go_down_only(module):
    assert misplaced(module, imported_modules(tree_of(module))) == []


def test_an_import_that_is_misplaced_would_be_found_and_its_place_is_said():
    source = (
        "def f():\n    from jaxbody.motion.simulations import simulate\n\n"
        "from jaxbody.core import units\nfrom jaxbody import mechanics\nfrom . import x\n"
        "plots = import_module('jaxbody.views.plots.plots_of_results')\n"
    )
    imports = imported_modules(ast.parse(source))
    assert imports == {
        "motion.simulations": 2,
        "core.units": 4,
        "mechanics": 5,
        "a relative import": 6,
        "views.plots.plots_of_results": 7,
    }
    text = "\n".join(misplaced("model.models", imports))
    assert (
        "jaxbody/model/models.py:2 imports jaxbody.motion.simulations: motion comes after model."
    ) in text
    assert (
        "models.py:5 imports jaxbody.mechanics: mechanics comes after model" in text
        and "models.py:6 imports relatively" in text
    )
    assert "core.units" not in text
    assert (
        "knows no mechanics"
        in misplaced("fitting.statistics.noises", {"core.errors": 1, "geometry.frames": 2})[0]
    )
    assert "parameters" in misplaced("design.fronts", {"fitting.fit_results": 3})[0]


def test_the_plan_has_no_circle_of_files():
    """Prints packages, what they import, the longest files, and what is imported inside functions
    so that others start sooner (`pytest -s`). All imports count."""
    graph = {
        module: {other for other in imported_modules(tree_of(module)) if other in NAMED}
        for module in NAMED
    }
    lines = {module: len(path_of(module).read_text().splitlines()) for module in NAMED}
    for package in ORDER:
        inside = [module for module in NAMED if module.split(".")[0] == package]
        arrows = {other.split(".")[0] for module in inside for other in graph[module]} - {package}
        print(
            f"{package:15}{len(inside):4} files{sum(lines[m] for m in inside):7} lines  <- "
            f"{', '.join(sorted(arrows, key=ORDER.index))}"
        )
    longest = sorted(NAMED, key=lambda module: -lines[module])[:10]
    print("longest: " + ", ".join(f"{module} {lines[module]}" for module in longest))
    for module in NAMED:
        for function in ast.walk(tree_of(module)):
            if isinstance(function, ast.FunctionDef) and (late := imported_modules(function)):
                print(f"inside {module}.{function.name}: {', '.join(late)}")
    assert list(graphlib.TopologicalSorter(graph).static_order())


@pytest.mark.parametrize("module", MODULES)
def test_a_file_is_short(module):
    assert len(path_of(module).read_text().splitlines()) <= MOST_LINES, "split it"


@pytest.mark.parametrize("module", NAMED)
def test_every_name_that_code_uses_is_there(module):
    """Ruff looks for undefined names in shapes, too, and cannot do it here; annotations are
    no code."""
    known = set(vars(importlib.import_module(f"jaxbody.{module}"))) | set(dir(builtins))
    codes, used = [compile(path_of(module).read_text(), module, "exec")], set()
    while codes:
        code = codes.pop()
        codes += [const for const in code.co_consts if inspect.iscode(const)]
        used |= {i.argval for i in dis.get_instructions(code) if i.opname == "LOAD_GLOBAL"}
    assert sorted(used - known) == []


TWICE = {
    # a user's own function: as a law of one number in `jb.laws`, of time in `jb.signals`; both
    # are public
    "Function",
    # a closure, in `jb.closures`, does what the joint of its name does
    *("Ball", "Guide", "Hinge"),
}


def test_a_class_or_type_has_a_name_of_its_own():
    """One word means one thing in the whole package."""
    places: dict[str, list[str]] = {}
    for module in MODULES:
        tree = tree_of(module)
        names = [node.name for node in ast.walk(tree) if isinstance(node, ast.ClassDef)]
        names += [
            node.targets[0].id
            for node in tree.body
            if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name)
        ]
        for name in names:
            if re.fullmatch("_?[A-Z]+[a-z][A-Za-z]*", name):
                places.setdefault(name, []).append(module)
    assert {
        name: modules for name, modules in places.items() if len(modules) > 1 and name not in TWICE
    } == {}


DERIVED = {  # from these concrete classes others derive, which are all that they are and more
    "Pose": "a frame is a pose with velocities",
    "Frame": "an instant is a table of frames with the state that it comes from",
    "JointedBodies": "closed loops are bodies on joints with multipliers",
    "ClosedLoops": "Lagrange's equations are integrated on closures as the structured ones are",
    "Chart": "coordinates are a chart with the reference poses",
    "Described": "prints the fields of a class, whatever they are",
    "Law": "states its force or its potential, either by the other; its constructor asks for one",
    "MeasuredModes": "identified modes are measured ones, with their poles",
    "MeasuredResponse": "estimated responses are measured ones, with their coherence",
    "Suspension": "a drawing of one's own; corners, axles and cars are suspensions with wheels",
}


def test_a_class_that_others_derive_from_is_abstract():
    """By a method or a field that it leaves to them; Equinox and abc then refuse to make one."""
    classes = set()
    for module in NAMED:
        imported = importlib.import_module(f"jaxbody.{module}")
        classes |= {
            x
            for x in vars(imported).values()
            if inspect.isclass(x) and x.__module__ == imported.__name__
        }
    left = ("__abstractmethods__", "__abstractvars__", "__abstractclassvars__")
    concrete = {
        base.__name__
        for x in classes
        for base in x.__bases__
        if base in classes and not any(getattr(base, a, ()) for a in left)
    }
    assert concrete == set(DERIVED)


@pytest.mark.parametrize(
    "base, missing",
    [
        (jb.Element, "deformation"),
        (jb.joints.Joint, "motions"),
        (jb.sensors.Sensor, "shape"),
        (jb.signals.Signal, "__call__"),
        (jb.laws.Law, "force"),
    ],
)
def test_an_abstract_class_says_what_it_lacks(base, missing):
    with pytest.raises((TypeError, jb.JaxbodyError), match=missing):
        base()


@pytest.mark.parametrize("module", MODULES)
def test_the_first_line_of_a_module_is_its_idea(module):
    first = path_of(module).read_text().splitlines()[0]
    assert first.startswith('"""') and len(first) > 20 and len(first) <= 100


@pytest.mark.parametrize("module", MODULES)
def test_nothing_is_evaluated_executed_or_unpickled(module):
    forbidden = {"eval", "exec", "compile", "__import__"}
    for node in ast.walk(tree_of(module)):
        if isinstance(node, ast.Call) and isinstance(node.func, ast.Name):
            assert node.func.id not in forbidden, f"{module}.py:{node.lineno}"
        if isinstance(node, ast.Import | ast.ImportFrom):
            names = {alias.name.split(".")[0] for alias in node.names} | {
                (getattr(node, "module", None) or "").split(".")[0]
            }
            assert not names & {"pickle", "dill", "cloudpickle", "marshal", "shelve"}, (
                f"{module}.py:{node.lineno}"
            )


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


@pytest.mark.long
@pytest.mark.everywhere
def test_import_has_no_side_effects():
    """Precision stays as it was, no array is made (JAX has not even looked for devices), nothing
    slow is imported that may not be needed."""
    done = subprocess.run(
        [sys.executable, "-c", IMPORT_ALONE], capture_output=True, text=True, timeout=300
    )
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
    done = subprocess.run(
        [sys.executable, "-c", USED], capture_output=True, text=True, timeout=300, check=True
    )
    ours, others = done.stdout.splitlines()
    packages = {place_of(name.removeprefix("jaxbody.")) for name in ours.split()}
    before = set(PLACES[: PLACES.index("motion")]) - {"suspension.presets"}
    assert "motion" in packages and packages <= before | {"motion"}
    assert "jaxbody.records.records" not in ours.split()
    assert others == ""


def test_no_function_has_the_name_of_a_module():
    """Importing the module would put it in the function's place."""
    last = {part for module in NAMED for part in module.split(".")}
    assert set(dir(jb)) & last == OPEN
    assert not any(inspect.ismodule(getattr(jb, name)) for name in EXPORTED)


def test_public_names_are_there_however_they_are_asked_for():
    everything: dict[str, object] = {}
    exec(
        "from jaxbody import *\nfrom jaxbody import Spring as S, laws as l\n"
        "import jaxbody.model.elements.springs as e",
        everything,
    )
    assert set(EXPORTED) <= set(everything) and everything["laws"] is everything["l"] is jb.laws
    assert everything["Spring"] is everything["S"] is everything["e"].Spring is jb.Spring
    assert not hasattr(jb, "Sprung")
    with pytest.raises(ImportError, match="Sprung"):
        exec("from jaxbody import Sprung")


@pytest.mark.parametrize("package", stubs.PACKAGES, ids=lambda package: package.__name__)
def test_type_checkers_are_given_the_same_names(package):
    assert stubs.place(package).read_text() == stubs.stub(package)
    offered = [line.split()[-1] for line in stubs.stub(package).splitlines() if " as " in line]
    assert sorted(offered) == dir(package)
    assert (PACKAGE / "py.typed").exists()


def test_the_root_has_what_a_first_script_needs():
    """Building blocks, drivers, results: about eighty; what is left stands in families."""
    assert set(jb._MODULES) == OPEN
    assert 70 <= len(EXPORTED) <= 90


def test_a_name_of_a_family_is_not_one_of_the_root():
    with pytest.raises(AttributeError, match=r"no attribute 'Gyro'; use jaxbody\.sensors\.Gyro$"):
        _ = jb.Gyro


FROM_A_ZIP = """
import sys
sys.path.insert(0, sys.argv[1])
import jaxbody as jb
import jaxbody.suspension.presets
assert jb.__file__.startswith(sys.argv[1])
jb.simulate(jb.presets.quarter_car(), [0.0, 0.01])
homes = [jb, *(getattr(jb, family) for family in jb._MODULES)]
[getattr(home, name) for home in homes for name in dir(home)]
"""


@pytest.mark.long
@pytest.mark.everywhere
def test_jaxbody_runs_from_a_zip(tmp_path):
    archive = shutil.make_archive(str(tmp_path / "jaxbody"), "zip", PACKAGE.parent, "jaxbody")
    command = [sys.executable, "-c", FROM_A_ZIP, archive]
    done = subprocess.run(
        command,
        capture_output=True,
        text=True,
        timeout=300,
        cwd=tmp_path,
        env=os.environ | {"JAX_ENABLE_X64": "1"},
    )
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize(
    "name", sorted(set(jb._MODULES) - set(jb._MODULES.values()) - {"inputs", "joints"})
)
def test_a_public_module_lists_what_it_offers_and_nothing_else(name):
    """Names with an example in their docstring and all functions of the plots: no imports and
    no helpers."""
    public = getattr(jb, name)
    home = public.__name__.removeprefix("jaxbody.")
    sources = [module for module in NAMED if module.startswith(f"{home}.")] or [home]
    offered = set()
    for source in sources:
        imported = importlib.import_module(f"jaxbody.{source}")
        own = {
            name: x
            for name, x in vars(imported).items()
            if getattr(x, "__module__", None) == imported.__name__ and name[0] != "_"
        }
        draws = {
            name
            for name, x in own.items()
            if inspect.isfunction(x)
            and "ax" in inspect.signature(x).parameters
            and inspect.signature(x).parameters["ax"].default is None
        }
        offered |= (
            draws
            if name == "plots"
            else {name for name, x in own.items() if ">>>" in (x.__doc__ or "")}
        )
    assert dir(public) == sorted(offered | BORROWED.get(name, set()))


def test_dir_of_a_public_module_lists_what_is_public():
    for module in (jb, *(getattr(jb, name) for name in OPEN)):
        assert dir(module) == sorted(module.__all__), module.__name__


def test_annotations_are_checked_where_pytest_is_asked_to(pytestconfig):
    """`pytest --typed`: shapes of arguments and results by jaxtyping and beartype, no implicit
    change of a type or a rank."""
    if not pytestconfig.option.typed:
        pytest.skip("for pytest --typed")
    with pytest.raises(jaxtyping.TypeCheckError, match="parameter 'b'"):
        vectors.cross(jnp.zeros(3), jnp.zeros(2))
    with pytest.raises(ValueError, match="rank_promotion"):
        jnp.zeros((2, 3)) + jnp.zeros(3)
    with pytest.raises(jax.dtypes.TypePromotionError):
        jnp.zeros(3) + jnp.arange(3)


@pytest.mark.parametrize("name", PUBLIC)
def test_everything_public_is_explained_by_an_example(name):
    thing = operator.attrgetter(name)(jb)
    assert callable(thing) and inspect.getdoc(thing), name
    assert doctest.DocTestParser().get_examples(thing.__doc__ or ""), f"{name} has no >>> example"


@pytest.mark.long
@pytest.mark.everywhere  # each public function has an example
@pytest.mark.parametrize("module", NAMED)
def test_examples_in_docstrings_run(module):
    """With jb, jax and jnp at hand."""
    if module in ("fitting.posteriors", "views.plots.fit_plots"):
        pytest.importorskip("blackjax", reason="needs jaxbody[posterior]")
    imported = importlib.import_module(f"jaxbody.{module}")
    names = {"jb": jb, "jax": jax, "jnp": jnp}
    runner = doctest.DocTestRunner(optionflags=doctest.NORMALIZE_WHITESPACE | doctest.ELLIPSIS)
    message: list[str] = []
    for test in doctest.DocTestFinder(exclude_empty=True).find(imported, module, extraglobs=names):
        runner.run(test, out=message.append)
    assert runner.summarize(verbose=False).failed == 0, "".join(message)


def test_the_suite_ends_without_stray_tracebacks():
    """At its end pytest collects garbage, in each worker; what is alive is left out of that, so
    that it ends before it is interrupted."""
    alive = len(gc.get_objects())
    conftest.pytest_sessionfinish()
    try:
        assert len(gc.get_objects()) < alive / 100
    finally:
        gc.unfreeze()
