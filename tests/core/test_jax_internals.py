"""Internal functions of JAX behave as jaxbody needs them, and there is a substitute where they no
longer exist."""

import ast
import importlib
import inspect
import subprocess
import sys
from pathlib import Path

import jax
import jax.numpy as jnp
import pytest

from jaxbody.core import jax_internals

pytestmark = pytest.mark.everywhere

TWO_DEVICES = """
import os
os.environ["XLA_FLAGS"] = "--xla_force_host_platform_device_count=2"
import jax, jax.numpy as jnp, numpy as np
jax.config.update("jax_enable_x64", True)
from jax.sharding import PartitionSpec as P
mesh = jax.make_mesh((2,), ("devices",), axis_types=(jax.sharding.AxisType.Auto,))
on_two = lambda function, given: jax.shard_map(function, mesh=mesh, in_specs=given, out_specs=P("devices"), check_vma=False)
"""  # noqa: E501

FREQUENCIES_ON_TWO = """
import jaxbody as jb
K = jnp.array([40.0, 90.0, 160.0, 250.0])

def frequency(k):
    spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 2.0, 0]), stiffness=k, free_length=2.0)
    model = jb.Model(bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])}, joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
                     elements={"spring": spring}, gravity=[0, -9.81, 0])
    return jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0]

both = lambda k: jnp.stack(jax.vmap(jax.value_and_grad(frequency))(k), -1)
f = np.sqrt(K / 2.0) / (2 * np.pi)
np.testing.assert_allclose(jax.jit(on_two(both, P("devices")))(K), np.stack([f, f / (2 * K)], -1), rtol=1e-10)
total = lambda c: jnp.sum(on_two(lambda k, c: jax.vmap(frequency)(c * k), (P("devices"), P()))(K, c))
np.testing.assert_allclose(jax.grad(total)(1.0), np.sum(f / 2), rtol=1e-10)
"""  # noqa: E501


def run_on_two(program: str) -> None:
    done = subprocess.run(
        [sys.executable, "-c", TWO_DEVICES + program], capture_output=True, text=True, timeout=600
    )
    assert done.returncode == 0, done.stderr[-2000:]


@pytest.mark.long
def test_frequencies_and_their_slopes_in_shard_map():
    """f = sqrt(k/m)/2 pi and df/dk = f/2k, two stiffnesses on each of two devices."""
    run_on_two(FREQUENCIES_ON_TWO)


def test_programs_lose_what_only_jax_itself_can_compile():
    table = jnp.arange(5.0)
    lowered = jax_internals.without_high_operations(
        jax.make_jaxpr(lambda x: jnp.interp(x, table, table**2))(1.5)
    )
    assert not getattr(lowered, "is_high", False)
    assert jax.core.eval_jaxpr(lowered.jaxpr, lowered.consts, 1.5) == [2.5]


INSIDE = ("jax._src", "jax.interpreters", "jax.extend", "jaxlib")


def names_of_the_inside(path):
    """What a file takes from these modules of JAX: names that it imports, and attributes of modules
    that it imports."""
    tree, modules, names = ast.parse(path.read_text()), set(), set()
    for node in ast.walk(tree):
        if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(INSIDE):
            for alias in node.names:
                of_module = f"{node.module}.{alias.name}"
                (
                    modules
                    if inspect.ismodule(vars(importlib.import_module(node.module)).get(alias.name))
                    else names
                ).add(of_module)
        elif isinstance(node, ast.Import):
            names |= {alias.name for alias in node.names if alias.name.startswith(INSIDE)}
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
            names |= {
                f"{module}.{node.attr}"
                for module in modules
                if module.rpartition(".")[2] == node.value.id
            }
        elif (
            isinstance(node, ast.Call)
            and isinstance(node.func, ast.Name)
            and node.func.id in ("getattr", "hasattr")
        ):
            of, name = map(ast.unparse, node.args[:2])
            names |= {
                f"{module}.{name[1:-1]}" for module in modules if module.rpartition(".")[2] == of
            }
    return names


def test_the_inside_of_jax_is_used_in_one_file_by_few_names_each_with_why():
    package = Path(jax_internals.__file__).parents[1]
    found = {
        path.relative_to(package).as_posix(): names
        for path in package.rglob("*.py")
        if (names := names_of_the_inside(path))
    }
    assert list(found) == ["core/jax_internals.py"]
    (names,) = found.values()
    assert len(names) <= 15, sorted(names)
    assert [
        name for name in names if name.rpartition(".")[2] not in str(jax_internals.__doc__)
    ] == []


def test_whether_anything_is_being_traced(monkeypatch):
    inside = []
    jax.make_jaxpr(lambda x: inside.append(jax_internals.outermost()) or x)(1.0)
    assert jax_internals.outermost() and inside == [False]
    monkeypatch.delattr("jax._src.core.trace_state_clean")
    assert not jax_internals.outermost()


def test_programs_lose_what_their_results_do_not_need(monkeypatch):
    traced = jax.make_jaxpr(lambda x: (jnp.sin(x), jnp.cos(x))[0])(1.0)
    kept = jax_internals.only_what_is_needed(traced)
    assert [eqn.primitive.name for eqn in kept.jaxpr.eqns] == ["sin"]
    monkeypatch.delattr(jax_internals.partial_eval, "dce_jaxpr")
    assert [eqn.primitive.name for eqn in jax_internals.only_what_is_needed(traced).jaxpr.eqns] == [
        "sin",
        "cos",
    ]
