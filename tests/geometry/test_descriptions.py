"""Laws, elements and bodies print with their numbers and units, whatever is in their fields."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

ENDS = ("mass", [0, 0, 0]), ("world", [0, 0, 1])
LAWS = {
    "linear": (jb.laws.Linear(20e3), "Linear(20000)", "Linear(20000 N/m)"),
    "polynomial": (
        jb.laws.Polynomial([1e3, 2e4]),
        "Polynomial([1000 20000])",
        "Polynomial([1000 N/m, 20000 N/m2])",
    ),
    "stop": (
        jb.laws.BumpStop(gap=0.06, stiffness=2e5, engagement=0.01),
        "BumpStop(gap=0.06 m, stiffness=200000 N/m, engagement=0.01 m, extension=False)",
        "BumpStop(gap=0.06 m, stiffness=200000 N/m, engagement=0.01 m, extension=False)",
    ),
    "sum": (
        jb.laws.Linear(3.0) + jb.laws.TensionOnly(5.0),
        "Linear(3) + TensionOnly(5 N/m)",
        "Linear(3 N/m) + TensionOnly(5 N/m)",
    ),
    "table": (
        jb.laws.Tabulated(np.linspace(-0.1, 0.1, 21), np.linspace(-100, 300, 21)),
        "Tabulated(x=[21 numbers from -0.1 to 0.1], forces=[21 numbers from -100 to 300])",
        "Tabulated(x=[21 numbers from -0.1 to 0.1] m, forces=[21 numbers from -100 to 300] N)",
    ),
}


def model_with(**law):
    return jb.Model(
        bodies={"mass": jb.Body(mass=1.0)},
        joints={"mass": jb.Guide("world", axis="z")},
        elements={"s": jb.SpringDamper(*ENDS, **law)},
    )


@pytest.mark.parametrize("name", LAWS)
def test_a_law_prints_its_numbers_with_the_units_of_its_owner_where_it_has_one(name):
    law, alone, in_spring = LAWS[name]
    assert repr(law) == str(law) == alone
    assert f"spring={in_spring}" in repr(jb.SpringDamper(*ENDS, spring=law))
    assert in_spring in repr(model_with(spring=law))


def test_a_law_has_the_units_of_what_holds_it():
    damper = jb.SpringDamper(*ENDS, damper=jb.laws.TwoSided(bump=800.0, rebound=2400.0))
    assert "damper=TwoSided(bump=Linear(800 N s/m), rebound=Linear(2400 N s/m))" in repr(damper)
    turn = jb.Torsion("mass", "world", axis="z", spring=30.0, damper=2.0)
    assert "spring=Linear(30 N m/rad)" in repr(turn) and "damper=Linear(2 N m s/rad)" in repr(turn)


def test_a_law_of_your_own_prints_with_the_units_of_its_fields():
    class Cubic(jb.laws.Law):
        coefficient: jax.Array = jb.field("force/argument^3")

        def force(self, x):
            return self.coefficient * x**3

    assert repr(Cubic(jnp.array(8.0))) == "Cubic(8)"
    assert "Cubic(8 N/m3)" in repr(model_with(spring=Cubic(jnp.array(8.0))))
    assert "Function(<lambda>)" in repr(model_with(spring=lambda x: x))


def test_bodies_elements_loads_and_motions_print_their_numbers():
    body = jb.Body(mass=3.0, inertia=[0.3, 0.9, 1.2])
    assert repr(body).startswith("Body(mass=3 kg, inertia=diag[0.3 0.9 1.2] kg m2, com=[0 0 0] m")
    assert "inertia=array 3 x 3" in repr(jb.Body(mass=3.0, inertia=[0.3, 0.9, 1.2, 0.01, 0, 0]))
    assert "stiffness=[1000 2000 3000] N/m" in repr(jb.Bushing(*ENDS, stiffness=[1e3, 2e3, 3e3]))
    assert "stiffness=diag[1 N/m, 2 N/m, 3 N/m, 4 N m/rad, 5 N m/rad, 6 N m/rad]" in repr(
        jb.Bushing(*ENDS, stiffness=np.diag(np.arange(1, 7)))
    )
    sine = jb.signals.Sine(amplitude=[1, 0, 0], frequency=2.0)
    assert "force=Sine(amplitude=[1 0 0] N, frequency=2 Hz, phase=0 rad)" in repr(
        jb.Force("mass", force=sine)
    )
    assert repr(jb.Harmonic(frequency=0.8, translation=[0.01, 0, 0])).startswith(
        "Harmonic(frequency=0.8 Hz, translation=[0.01 0 0] m"
    )
    assert repr(jb.Guide("world", axis="z")) == "Guide(parent='world', axis=[0 0 1])"
    assert repr(jb.Position("mass", axis="z", gain=2.0)).startswith(
        "Position(gain=2, on='mass', axis=[0 0 1]"
    )


def test_what_is_traced_batched_or_no_number_prints_too():
    model, seen = model_with(spring=jb.laws.Polynomial([1e3, 2e4])), []
    jax.jit(lambda model: seen.append(repr(model["s"])))(model)
    assert "spring=Polynomial(traced)" in seen[0]
    batch = jax.vmap(lambda k: jb.replace(model, {"s.free_length": k}))(jnp.arange(3.0))
    assert "free_length=[0 1 2] m" in repr(batch["s"])
    for change in (
        lambda x: None,
        lambda x: True,
        lambda x: x.sum(),
        lambda x: jax.ShapeDtypeStruct(x.shape, x.dtype),
    ):
        assert repr(jax.tree.map(change, model["s"])).startswith(
            "SpringDamper(between=('mass', 'world')"
        )


class Network(jb.laws.Law):
    net: eqx.nn.MLP
    parts: dict

    def force(self, x):
        return self.net(x)


def test_a_network_in_a_law_prints_as_the_number_of_its_numbers():
    """16 + 16, 16 * 16 + 16 and 16 + 1 of weights and biases; a short dict as it is, a long
    one likewise."""
    net = eqx.nn.MLP("scalar", "scalar", 16, 2, activation=jax.nn.tanh, key=jax.random.key(1))
    assert repr(Network(net, {"a": 1})) == "Network(net=MLP(321 numbers), parts={'a': 1})"
    long = {f"weights {i}": jnp.zeros(3) for i in range(9)}
    assert repr(Network(net, long)) == "Network(net=MLP(321 numbers), parts=dict(27 numbers))"
    assert (
        max(map(len, str(model_with(spring=Network(net, {}), free_length=1.0)).splitlines())) < 120
    )
