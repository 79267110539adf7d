"""A model is a tree of arrays: replacement of whole arrays, pickled copies, laws that
contain networks."""

import copy
import pickle
import subprocess
import sys

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxbody as jb


def everything():
    """A model of each kind of element, joint and law."""
    law = jb.laws.Linear(3e4) + jb.laws.BumpStop(gap=0.08, stiffness=1e5, engagement=0.01)
    points = ("car", [0, 0, 0]), ("base", [0, 0, -1])
    return jb.Model(
        bodies={
            name: jb.Body(mass=2.0, inertia=[1, 1, 1])
            for name in ("car", "free", "arm", "fixed", "ball")
        },
        supports={"base": jb.Support()},
        joints={
            "car": jb.joints.HeavePitchRoll("base"),
            "arm": jb.Hinge("car", axis=[0, 0, 1]),
            "fixed": jb.Fixed("arm"),
            "ball": jb.Ball("base"),
        },
        elements={
            "strut": jb.SpringDamper(
                *points,
                spring=law,
                damper=jb.laws.TwoSided(bump=900.0, rebound=2100.0),
                free_length=0.5,
            ),
            "table": jb.SpringDamper(
                *points, spring=jb.laws.Tabulated([-1, 0, 1, 2], [-10, 0, 10, 40]), free_length=0.5
            ),
            "spring": jb.Spring(*points, stiffness=100.0, free_length=1.0),
            "bushing": jb.Bushing(("free", [0, 0, 0]), ("base", [0, 0, 0]), stiffness=[1, 2, 3]),
            "torsion": jb.Torsion("arm", "car", axis=[0, 0, 1], spring=30.0),
            "bar": jb.AntiRollBar(("arm", [0, 1, 0]), ("free", [0, -1, 0]), "car", spring=1e4),
        },
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "copied",
    [copy.deepcopy, lambda tree: pickle.loads(pickle.dumps(tree))],
    ids=["deepcopy", "pickle"],
)
def test_a_copied_or_pickled_model_has_the_same_tree_and_needs_no_compilation(copied):
    model = everything()
    twin = copied(model)
    assert jax.tree.structure(twin) == jax.tree.structure(model)
    assert jax.tree.all(jax.tree.map(np.array_equal, model, twin))
    function = eqx.filter_jit(lambda model: jb.potential_energy(model, model.reference))
    before = float(function(model))
    with jb.compile_times() as times:
        assert float(function(twin)) == before
    assert times.count == 0


@pytest.mark.long
def test_a_model_pickled_in_another_process_has_the_same_tree(tmp_path):
    file = tmp_path / "model.pickle"
    script = (
        "import pickle, jax, jaxbody as jb; jax.config.update('jax_enable_x64', True); "
        f"pickle.dump(jb.presets.quarter_car(damping=1500.0), open({str(file)!r}, 'wb'))"
    )
    subprocess.run([sys.executable, "-c", script], check=True, timeout=300)
    model, other = jb.presets.quarter_car(damping=1500.0), pickle.loads(file.read_bytes())
    assert jax.tree.structure(other) == jax.tree.structure(model)
    assert jax.tree.all(jax.tree.map(np.array_equal, model, other))


def test_tree_at_of_a_named_part_shows_the_call_of_replace():
    model = jb.presets.quarter_car(damping=1500.0)
    for name, path, where in (
        ("suspension", "stiffness", lambda m: m["suspension"].stiffness),
        ("body", "mass", lambda m: m["body"].mass),
        ("wheel", "axis", lambda m: m.joint("wheel").axis),
    ):
        with pytest.raises(jb.JaxbodyError) as raised:
            eqx.tree_at(where, model, jnp.array(5.0))
        assert raised.value.code == "NO_NODE"
        assert f'jb.replace(model, {{"{name}.{path}": value}})' in str(raised.value)
        assert raised.value.__cause__ is None and len(str(raised.value).splitlines()) == 1


def test_tree_at_of_a_whole_array_works():
    model = jb.presets.quarter_car(damping=1500.0)
    whole = eqx.tree_at(
        lambda m: m.elements[0].rows.stiffness, model, model.elements[0].rows.stiffness * 2
    )
    by_name = jb.replace(
        model, {name: 2 * value for name, value in jb.parameter_paths(model, "*.stiffness").items()}
    )
    assert eqx.tree_equal(whole, by_name)


class Learned(jb.laws.Law):
    """F = k (x + network(x))."""

    network: eqx.nn.MLP
    stiffness: float

    def force(self, x):
        return self.stiffness * (x + self.network(x[None])[0])


def network(seed, activation=jax.nn.tanh):
    return eqx.nn.MLP(1, 1, 3, 1, activation=activation, key=jax.random.key(seed))


def slider(**laws):
    return jb.Model(
        bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        joints={"mass": jb.Guide("base", axis=[1, 0, 0])},
        elements={
            name: jb.SpringDamper(
                ("mass", [0, 0, 0]), ("base", [-1, 0, 0]), spring=law, damper=5.0, free_length=1.0
            )
            for name, law in laws.items()
        },
    )


TIMES = np.linspace(0.0, 0.6, 13)


@pytest.mark.long
def test_a_law_that_holds_a_network_moves_as_its_numbers_say_and_can_be_differentiated_and_fitted():
    model = slider(s=Learned(network(1), 50.0))
    W1, b1, W2, b2 = (
        np.asarray(jb.parameter_paths(model)[f"s.spring.network.layers.{i}.{name}"])
        for i in (0, 1)
        for name in ("weight", "bias")
    )

    def rate(_, y):
        return [
            y[1],
            -(50.0 * (y[0] + W2[0] @ np.tanh(W1[:, 0] * y[0] + b1) + b2[0]) + 5.0 * y[1]) / 2.0,
        ]

    trajectory = jb.simulate(model, TIMES)
    expected = solve_ivp(rate, (0, TIMES[-1]), [0, 0], t_eval=TIMES, rtol=1e-11, atol=1e-13).y[0]
    # of 0.1 m; the default rtol of simulate
    assert np.abs(trajectory.state.q[:, 0] - expected).max() < 1e-7

    def end(model):
        return jb.simulate(model, TIMES[[0, -1]]).state.q[-1, 0]

    slope, step = jax.jit(jax.grad(end))(model)["s"].spring.network.layers[1].bias[0], 1e-4
    moved = [
        float(end(jb.replace(model, {"s.spring.network.layers.1.bias": b2 + sign * step})))
        for sign in (1, -1)
    ]
    # differences of a motion good to 1e-9
    assert float(slope) == pytest.approx((moved[0] - moved[1]) / (2 * step), rel=1e-5)

    run = jb.Experiment(
        TIMES,
        sensors={"x": jb.Position("mass", [0, 0, 0])},
        measured={"x": trajectory.poses["mass"].p},
    )
    fit = jb.fit(
        jb.replace(model, {"s.spring.network.layers.1.bias": b2 + 0.3}),
        {"run": run},
        free=["s.spring.network.layers.1.bias"],
    )
    assert np.asarray(fit.model["s"].spring.network.layers[1].bias) == pytest.approx(b2, rel=1e-4)


@pytest.mark.long
def test_laws_with_networks_of_one_structure_are_one_table_and_others_their_own():
    model = slider(
        a=Learned(network(1), 50.0),
        b=Learned(network(2), 60.0),
        c=Learned(network(3, jax.nn.softplus), 70.0),
    )
    assert [table.names for table in model.elements] == [("a", "b"), ("c",)]
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(model))
    moved = jb.simulate(model, TIMES[[0, -1]])
    x, v = moved.state.q[-1, 0], moved.state.v[-1, 0]
    for name, (seed, activation, k) in {
        "a": (1, jax.nn.tanh, 50.0),
        "b": (2, jax.nn.tanh, 60.0),
        "c": (3, jax.nn.softplus, 70.0),
    }.items():
        assert float(moved.forces[name][-1]) == pytest.approx(
            float(k * (x + network(seed, activation)(x[None])[0]) + 5.0 * v), rel=1e-12
        )


@pytest.mark.long
def test_the_energy_of_a_network_is_the_integral_of_its_force():
    law = Learned(network(1), 50.0)
    x = np.linspace(0.0, 0.3, 4001)
    forces = jax.vmap(law.force)(jnp.asarray(x))
    # the rule's error is h^2/12 f''
    assert float(law.potential(jnp.array(0.3))) == pytest.approx(np.trapezoid(forces, x), rel=1e-8)


def test_a_field_of_a_law_that_is_not_a_number_is_static_or_refused_by_its_path():
    class Named(jb.laws.Law):
        mode: str
        stiffness: float

        def force(self, x):
            return self.stiffness * x

    with pytest.raises(jb.JaxbodyError) as raised:
        slider(s=Named("hard", 3.0))
    assert raised.value.code == "NOT_A_NUMBER"
    assert "elements['s'].spring.mode" in str(raised.value) and "equinox.field(static=True)" in str(
        raised.value
    )


def test_whole_parts_and_laws_are_replaced_beside_numbers():
    """As if the model had been built with them; what is left is the same to the bit."""
    spring = jb.SpringDamper(
        ("mass", [0, 0, 0]), ("world", [0, 0, 1]), spring=500.0, free_length=0.8
    )
    parts = {
        "bodies": {"mass": jb.Body(2.0, [1, 1, 1])},
        "joints": {"mass": jb.Guide("world", axis=[0, 0, 1])},
    }
    model = jb.Model(**parts, elements={"s": spring, "t": spring}, gravity=[0, 0, -9.81])
    stop, bushing = (
        jb.laws.BumpStop(gap=0.01, stiffness=1e5, engagement=1e-3),
        jb.Bushing(("mass", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=[1e3] * 3),
    )
    changed = jb.replace(
        model,
        {
            "s.damper": stop,
            "t": bushing,
            "mass": jb.Ball("world"),
            "mass.mass": 3.0,
            "s.free_length": 0.7,
        },
    )
    with_stop = jb.SpringDamper(
        ("mass", [0, 0, 0]), ("world", [0, 0, 1]), spring=500.0, damper=stop, free_length=0.7
    )
    parts = {"bodies": {"mass": jb.Body(3.0, [1, 1, 1])}, "joints": {"mass": jb.Ball("world")}}
    wanted = jb.Model(**parts, elements={"s": with_stop, "t": bushing}, gravity=[0, 0, -9.81])
    assert jax.tree.structure(changed) == jax.tree.structure(wanted)
    assert all(map(np.array_equal, jax.tree.leaves(changed), jax.tree.leaves(wanted)))
    wrong = {"u": bushing, "s.free_length": stop, "mass": jb.Guide("nowhere", axis=[0, 0, 1])}
    with pytest.raises(
        jb.JaxbodyError, match=r"(?s)'u' is unknown.*\['s.free_length'\]: is no law"
    ):
        jb.replace(model, wrong)
    with pytest.raises(jb.JaxbodyError, match="'nowhere' is unknown"):
        jb.replace(model, {"mass": wrong["mass"]})
