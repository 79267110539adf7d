"""README's script and the example of its contract compile few programs, none of single operations
but the script's own."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[3]

pytestmark = pytest.mark.long

# Programs are jaxbody's where one of its files is among the callers. JAX reports each with its
# name.
COUNTED = """
import runpy, sys, traceback
import jax, jaxbody
from pathlib import Path

package, ours = str(Path(jaxbody.__file__).parent), []

def heard(event, seconds, fun_name="", **_):
    places = [f.filename for f in traceback.extract_stack() if f.filename.startswith(package)]
    if event == "/jax/core/compile/backend_compile_duration" and places:
        ours.append(fun_name.removeprefix("jit(").removesuffix(")"))

jax.monitoring.register_event_duration_secs_listener(heard)
"""
CONTRACT = (
    COUNTED
    + """
runpy.run_path('examples/contract.py', run_name='__main__')
assert not {"scipy.stats", "scipy.signal"} & set(sys.modules)  # 0.4 s to import, and its noise is white
print('programs', *sorted(ours))
"""  # noqa: E501
)
RIDE = (
    COUNTED
    + """
import jaxbody as jb
jax.config.update("jax_enable_x64", True)

def ride(model):
    lin = jb.linearize(model, jb.equilibrium(model))
    roads, uneven = {"road": jb.BaseMotion("road", "z")}, jb.vibration.RoadRoughness.iso("C").at_speed(20.0)
    sensors = {"body": jb.Acceleration("body", axis="z")}
    return {"acceleration": jb.random_response(lin, jb.vibration.Band(0.2, 40.0, points=201), roads, sensors, {"road": uneven})["body"]}

car = jb.presets.quarter_car(damping=1500.0)
found = ride(car), jb.tune(car, ride, free=["suspension.damping"], minimize="acceleration")
print('programs', *sorted(ours))
"""  # noqa: E501
)

REPLACED = (
    COUNTED
    + """
import jax.numpy as jnp, numpy as np, jaxbody as jb
car = jb.presets.quarter_car()
cars = jax.vmap(lambda k: jb.replace(car, {"suspension.stiffness": k}))(jnp.arange(1.0, 6.0))
assert any(set(range(1, 6)) <= set(np.ravel(x)) for x in jax.tree.leaves(cars))
print('programs', *sorted(ours))
"""
)

README = (
    COUNTED
    + """
code, = [part.split('```')[0] for part in Path('README.md').read_text().split('```python')[1:]]
exec(code)
print('programs', *sorted(ours))
"""
)
DRIVERS = ["_excitation", "_linearize", "_measured", "_modes", "equilibrium_of", "integrate"]
DRIVERS += ["_begin", "placed", "_step", "residual_and_jacobian"]  # of a fit by optax


def programs(script, *arguments):
    hidden = {"JAX_COMPILATION_CACHE_DIR", "XLA_FLAGS"}
    environment = {name: value for name, value in os.environ.items() if name not in hidden} | {
        "PYTHONPATH": str(ROOT)
    }
    command = [sys.executable, "-c", script, *map(str, arguments)]
    done = subprocess.run(
        command, capture_output=True, text=True, timeout=600, cwd=ROOT, env=environment, check=True
    )
    return done.stdout.splitlines()[-1].split()[1:]


def test_the_example_contract_compiles_one_program_for_each_driver():
    """And one for each jb.jit, beside what a result is printed with."""
    found = programs(CONTRACT)
    assert sorted([*DRIVERS, "<lambda>", "<lambda>"]) == found


def test_the_script_of_readme_compiles_its_drivers_only():
    """And those of its own solve by diffrax, two single operations among them."""
    own = ["<lambda>", "<lambda>", "bitwise_or", "convert_element_type", "motion"]
    fit = ["_begin", "placed", "_step", "residual_and_jacobian"]
    drivers = ["_evaluate", "_excitation", "_linearize", "drawn_reference", "integrate"]
    assert programs(README) == sorted(own + fit + drivers)


def test_a_random_response_and_a_design_compile_their_functions_only():
    response = ["_linearize", "_random_response", "equilibrium_of", "port_matrices"]
    assert programs(RIDE) == sorted([*response, "placed", "values_and_slopes"])


def test_a_batch_of_numbers_is_written_into_a_model_by_one_program():
    assert programs(REPLACED) == ["_with_traced"]
