"""Classes of the user's own: a runnable example for each base class, and a clear error for each
missing part."""

import doctest

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

MISSING = {  # what each kind of its own has to state
    jb.Element: (lambda kind: kind(("a", "b"), 0, 0), {"deformation", "energy", "dissipation"}),
    jb.joints.Joint: (lambda kind: kind("world"), {"pose", "axes"}),
    jb.sensors.Sensor: (lambda kind: kind("a"), {"reading"}),
    jb.inputs.Load: (lambda kind: kind("a", 0), {"at_point"}),
    jb.inputs.Motion: (lambda kind: kind(), {"__call__"}),
    jb.signals.Signal: (lambda kind: kind(), {"__call__"}),
}


@pytest.mark.parametrize("base", MISSING, ids=lambda base: base.__name__)
def test_a_method_left_out_is_named(base):
    make, names = MISSING[base]
    with pytest.raises(TypeError, match="Can't instantiate abstract class Mine") as raised:
        make(
            type(
                "Mine",
                (base,),
                {
                    "shape": (),
                    "unit": "m",
                    "nq": 1,
                    "nv": 1,
                    "motions": ("turn",),
                    "turns": (True,),
                },
            )
        )
    for name in names:
        assert name in str(raised.value)


@pytest.mark.parametrize(
    "base, given, name",
    [
        (jb.joints.Joint, {"nq": 1, "nv": 1, "motions": ("turn",)}, "turns"),
        (jb.sensors.Sensor, {"shape": (), "on": ""}, "unit"),
    ],
)
def test_a_number_or_word_left_out_is_named(base, given, name):
    methods = dict.fromkeys(MISSING[base][1], lambda self, *_: None)
    with pytest.raises(TypeError, match=f"class attributes {{'{name}'}}"):
        type("Mine", (base,), methods | given)("a")


def test_a_law_without_force_and_potential_is_refused():
    class Mine(jb.laws.Law):
        pass

    with pytest.raises(jb.JaxbodyError, match="Mine: states neither force nor potential"):
        Mine()

    class Softening(Mine):
        def potential(self, x):
            return jnp.log(jnp.cosh(x))

    assert float(Softening().force(jnp.array(0.5))) == pytest.approx(
        float(jnp.tanh(0.5)), rel=1e-12
    )


@pytest.mark.parametrize(
    "base, uses",
    [(jb.Element, "equilibrium("), (jb.joints.Joint, "simulate("), (jb.sensors.Sensor, "measure(")],
)
def test_the_docstring_shows_a_whole_class_that_is_used(base, uses):
    """Under twenty lines; that it runs is for the doctests."""
    sources = [example.source for example in doctest.DocTestParser().get_examples(base.__doc__)]
    assert any(f"{base.__name__}):" in source for source in sources) and any(
        uses in source for source in sources
    )
    assert sum(source.count("\n") for source in sources) < 20
    assert not any("issubclass" in source for source in sources)


class Charges(jb.Element):
    """Repelling charges, with a unit and a domain stated, and a number without."""

    strength: jax.Array = jb.field("N m2", "positive")
    offset: jax.Array

    def deformation(self, A, B):
        return jnp.linalg.norm(B.point(self.b) - A.point(self.a)) + 0 * self.offset

    def energy(self, e):
        return self.strength / e

    def dissipation(self, e, e_dot):
        return jnp.zeros_like(e)


@pytest.mark.long
def test_a_field_of_ones_own_is_fitted_tuned_and_printed_with_its_unit():
    """Released at rest at height h over the other charge, x'' = strength/(m x^2) - g; at 0.5 m it
    stays where strength = 0.5^2 m g."""
    pair = Charges(("ball", "world"), jnp.zeros(3), jnp.zeros(3), jnp.array(0.3), jnp.array(-1.0))
    model = jb.Model(
        bodies={"ball": jb.Body(mass=0.2, inertia=[1, 1, 1], position=[0, 0, 0.5])},
        joints={"ball": jb.Guide("world", axis=[0, 0, 1])},
        elements={"pair": pair},
        gravity=[0, 0, -10],
    )
    assert "strength [N m2]" in str(model) and "offset [" not in str(model)
    run = jb.Experiment(
        [0.0, 0.05, 0.1, 0.15],
        sensors={"z": jb.Position("ball", axis=[0, 0, 1])},
        measured={"z": 0.5 + 1e-6 * np.array([0, 1, -1, 1])},
        noise=1e-5,
    )
    result = jb.fit(model, {"run": run}, free=["pair.strength"])
    np.testing.assert_allclose(result.estimates["pair.strength"], 0.5, rtol=1e-3)
    assert " N m2 " in str(result)
    tuned = jb.tune(model, lambda model: (model["pair"].strength - 0.7) ** 2, free="pair.strength")
    np.testing.assert_allclose(tuned.model["pair"].strength, 0.7, rtol=1e-3)
    with pytest.raises(jb.JaxbodyError, match=r"-1 N m2.*NOT_POSITIVE"):
        jb.replace(model, {"pair.strength": -1.0})
    assert jb.replace(model, {"pair.offset": -5.0})["pair"].offset == -5.0
