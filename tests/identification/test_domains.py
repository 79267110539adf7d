"""Parameters stay in the domain that their field states, wherever the data pull them."""

from typing import ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.experiments.measurements import Measurement
from jaxbody.laws import Digressive, Friction, Linear, Polynomial, Stop, TensionOnly

AT = jnp.array([-0.4, -0.25, 0.05, 0.2, 0.3])
ENDS = ("mass", [0, 0, 0]), ("world", [0, 0, 0])


def holding(law, damper=False):
    body = {"mass": jb.Body(mass=1.0, position=[1, 0, 0])}
    laws = {"damper" if damper else "spring": law}
    return jb.Model(bodies=body, joints={"mass": jb.Guide("world", axis=[1, 0, 0])}, elements={"s": jb.SpringDamper(*ENDS, **laws)})


class Force(Measurement):
    """The force of the law of s at five places, without a simulation."""

    measured: dict = eqx.field(default_factory=dict)
    noise: dict | None = None
    channels: ClassVar = {"force": jb.Position("mass", axis=[1, 0, 0])}  # pyright: ignore[reportIncompatibleMethodOverride]

    def readings(self, model, integration):
        law = model["s"].spring or model["s"].damper
        return {"force": jax.vmap(law.force)(AT)}

    def axis(self, channel):
        return "x", AT, "m"

    def place(self, row):
        return "x", float(AT[row])


PULLED = {  # a law, its coefficient, and forces that a negative one would give
    "linear": (Linear(2.0), "spring.coefficient", lambda x: -3 * x),
    "damper": (Linear(0.5), "damper.coefficient", lambda x: -0.6 * x),
    "rope": (TensionOnly(2.0), "spring.stiffness", lambda x: -3 * x * (x > 0)),
    "stop": (Stop(gap=0.1, stiffness=5.0), "spring.stiffness", lambda x: 7 * (-x - 0.1) * (x < -0.1)),
    "slow": (Digressive(slow=2.0, fast=0.0, knee=0.1), "damper.slow", lambda x: -x / jnp.sqrt(1 + (x / 0.1) ** 2)),
    "fast": (Digressive(slow=2.0, fast=1.0, knee=0.1), "damper.fast", lambda x: -x),
    "level": (Friction(level=2.0, velocity=0.1), "damper.level", lambda x: -x / jnp.sqrt(x**2 + 0.01)),
}


@pytest.mark.parametrize("name", PULLED)
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_a_coefficient_that_the_data_pull_below_zero_stays_above_it(name):
    law, path, force = PULLED[name]
    run = Force({"force": force(AT)}, noise={"force": jnp.asarray(1e-3)})
    found = jb.fit(holding(law, "damper" in path), {"run": run}, free=[f"s.{path}"])
    value = float(found.estimates[f"s.{path}"])
    assert value > 0
    if name not in ("fast",):
        assert value < 1e-5 and found.status == jb.Status.AT_BOUND and f"s.{path} (zero)" in str(found)


def test_a_coefficient_of_either_sign_crosses_zero():
    run = Force({"force": -3 * AT}, noise={"force": jnp.asarray(1e-3)})
    found = jb.fit(holding(Polynomial([2.0])), {"run": run}, free=["s.spring.coefficients"])
    np.testing.assert_allclose(found.estimates["s.spring.coefficients"], [-3.0], rtol=1e-9)


def test_from_zero_a_fit_says_what_to_do():
    run = Force({"force": AT}, noise={"force": jnp.asarray(1e-3)})
    with pytest.raises(jb.JaxbodyError, match=r"s.spring.coefficient.*Start at a small positive number.*START_ON_BOUND"):
        jb.fit(holding(Linear(0.0)), {"run": run}, free=["s.spring.coefficient"])


@pytest.mark.parametrize(
    ("path", "value", "code"),
    [
        ("s.spring.coefficient", -1.0, "NEGATIVE"),
        ("s.free_length", -1.0, "NEGATIVE_LENGTH"),
        ("mass.mass", 0.0, "BAD_MASS"),
        ("mass.inertia", np.diag([1.0, 1, 3]), "TRIANGLE"),
        ("mass.inertia", [[1, 0.5, 0], [0, 1, 0], [0, 0, 1]], "NOT_SYMMETRIC"),
        ("mass.inertia", np.diag([1.0, 1, -1]), "NOT_POSITIVE"),
    ],
)
def test_replace_refuses_what_the_constructor_refuses(path, value, code):
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.replace(holding(Linear(2.0)), {path: value})
    assert refused.value.code == code


def test_what_was_allowed_to_be_negative_stays_so():
    with pytest.warns(jb.JaxbodyWarning, match="NEGATIVE_STIFFNESS"):
        spring = jb.Spring(*ENDS, stiffness=-2.0, allow_negative=True)
    model = jb.Model(bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])}, elements={"s": spring})
    assert jb.replace(model, {"s.stiffness": -3.0})["s"].stiffness == -3.0
    with pytest.raises(jb.JaxbodyError, match="NEGATIVE_STIFFNESS"):
        jb.replace(
            jb.Model(
                bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])}, elements={"s": jb.Spring(*ENDS, stiffness=2.0)}
            ),
            {"s.stiffness": -3.0},
        )
