"""Numbers that constructors and `replace` refuse where they are known: traced, they end in a status
and NaN, with NaN as derivative."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

SIX = np.diag([3.0, 3, 3, 1, 1, 1]) * 100
GOOD = {
    "mass": 2.0,
    "moments": [1.0, 2, 2.5],
    "com": [0.0, 0, 0],
    "turn": np.eye(3),
    "axis": [0.0, 0, 1],
    "matrix": SIX,
    "coefficients": [30.0, 30, 30],
    "stiffness": 50.0,
    "damping": 1.0,
    "free_length": 0.2,
    "point": [0.0, 0, 0.3],
    "table": [-1.0, 0, 1, 2],
    "forces": [-9.0, 0, 9, 20],
    "linear": 40.0,
}
BAD = {  # numbers of the list of bad inputs
    "4 mass": {"mass": -2.0},
    "4 no mass": {"mass": 0.0},
    "5 NaN": {"com": [0, np.nan, 0]},
    "5 infinite": {"stiffness": np.inf},
    "9 inertia": {"moments": [1.0, 2, -2.5]},
    "10 triangle": {"moments": [1.0, 2, 3.5]},
    "15 scaled": {"turn": 1.1 * np.eye(3)},
    "15 mirrored": {"turn": np.diag([1.0, 1, -1])},
    "22 stiffness": {"stiffness": -50.0},
    "22 bushing": {"coefficients": [30.0, -30, 30]},
    "22 law": {"linear": -40.0},
    "23 damping": {"damping": -1.0},
    "24 asymmetric": {"matrix": SIX + np.eye(6, k=1)},
    "24 indefinite": {"matrix": SIX - 400 * np.eye(6)},
    "28 table": {"table": [-1.0, 0, 0, 2]},
    "28 falls": {"forces": [-9.0, 0, -1, 20]},
    "free length": {"free_length": -0.2},
    "axis": {"axis": [0.0, 0, 0]},
}


def with_numbers(numbers):
    """A body on a bushing of each kind and springs, and another on a slide, each number given in
    the constructor."""
    n = {name: jnp.asarray(value, float) for name, value in numbers.items()}
    ends = ("block", [0, 0, 0]), ("base", [0, 0, 0])
    return jb.Model(
        bodies={
            "block": jb.Body(
                mass=n["mass"], inertia=n["moments"], com=n["com"], orientation=n["turn"]
            ),
            "slider": jb.Body(mass=1.0, position=[1, 0, 0]),
        },
        supports={"base": jb.Support()},
        joints={"slider": jb.Guide("world", axis=n["axis"])},
        elements={
            "six": jb.Bushing(*ends, stiffness=n["matrix"]),
            "three": jb.Bushing(*ends, stiffness=n["coefficients"], damping=[1.0, 1, 1]),
            "spring": jb.Spring(
                ("block", n["point"]),
                ("base", [0, 0, 0.7]),
                stiffness=n["stiffness"],
                damping=n["damping"],
                free_length=n["free_length"],
            ),
            "table": jb.SpringDamper(
                ("slider", [0, 0, 0]),
                ("base", [1, 0, 1]),
                spring=jb.laws.Tabulated(n["table"], n["forces"]),
            ),
            "linear": jb.SpringDamper(
                ("slider", [0, 0, 0]), ("base", [1, 0, -1]), spring=n["linear"]
            ),
        },
    )


def outcome(numbers):
    """Whether all results are ok, and their numbers."""
    model = with_numbers(numbers)
    eq = jb.equilibrium(model)
    modes = jb.modes(jb.linearize(model, eq))
    rate = jb.simulate(model, jnp.linspace(0.0, 0.01, 3), initial=eq.state)
    ok = [(result.status == jb.Status.OK.value) for result in (eq, modes, rate)]
    return jnp.stack(ok), jnp.concatenate([modes.frequency, rate.state.q[-1]])


def batch(cases):
    """The numbers of all cases, in rows."""
    rows = [GOOD | case for case in cases]
    return {name: jnp.asarray(np.array([row[name] for row in rows], float)) for name in GOOD}


@pytest.fixture(scope="module")
def outcomes():
    return jb.jit(jax.vmap(outcome))(batch([{}, *BAD.values()]))


@pytest.mark.long
def test_good_numbers_are_those_of_the_constructor(outcomes):
    """In the first row of the batch, though all others are bad."""
    ok, numbers = (np.asarray(x)[0] for x in outcomes)
    assert ok.all()
    model = with_numbers(GOOD)
    frequency = jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency
    np.testing.assert_allclose(numbers[: len(frequency)], frequency, rtol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize("case", BAD)
def test_a_bad_number_ends_in_a_status_and_nan(case, outcomes):
    ok, numbers = (np.asarray(x)[1 + list(BAD).index(case)] for x in outcomes)
    assert not ok.all()
    assert np.isnan(numbers).any()


def test_what_a_constructor_refuses_is_refused_when_it_is_known():
    for case, numbers in BAD.items():
        with pytest.raises(jb.JaxbodyError):
            with_numbers({name: np.asarray(value) for name, value in (GOOD | numbers).items()})
            pytest.fail(case)


PATHS = {
    "block.mass": -2.0,
    "block.inertia": np.diag([1.0, 2, 3.5]),
    "spring.stiffness": -50.0,
    "spring.damping": -1.0,
    "spring.free_length": -0.2,
    "six.stiffness": SIX - 400 * np.eye(6),
    "three.stiffness": np.array([30.0, -30, 30]),
    "table.spring.x": np.array([-1.0, 0, 0, 2]),
    "linear.spring.coefficient": -40.0,
    "slider.axis": np.zeros(3),
}


@pytest.mark.nan
def test_replace_under_jit_has_nan_where_it_refuses_known_numbers():
    model = with_numbers(GOOD)
    for path, value in PATHS.items():
        with pytest.raises(jb.JaxbodyError):
            jb.replace(model, {path: value})
    known = jb.parameter_paths(model)
    put = jax.jit(
        lambda values: {
            path: jb.parameter_paths(jb.replace(model, {path: value}), path)[path]
            for path, value in values.items()
        }
    )
    for path, value in put({path: jnp.asarray(value) for path, value in PATHS.items()}).items():
        assert np.isnan(value).any(), path
    for path, value in put({path: jnp.asarray(known[path]) for path in PATHS}).items():
        np.testing.assert_allclose(value, known[path], rtol=1e-15, err_msg=path)


def test_what_is_allowed_to_be_negative_stays():
    ends = ("block", [0, 0, 0]), ("base", [0, 0, 0])
    made = jax.jit(lambda k: jb.Bushing(*ends, stiffness=k, allow_negative=True).stiffness)
    for stiffness in ([30.0, -30, 30], SIX - 400 * np.eye(6)):
        with pytest.warns(jb.JaxbodyWarning, match="NEGATIVE_STIFFNESS"):
            known = jb.Bushing(*ends, stiffness=stiffness, allow_negative=True).stiffness
        np.testing.assert_array_equal(made(jnp.asarray(stiffness)), known)
    assert np.isnan(made(jnp.asarray(SIX + np.eye(6, k=1)))).all()  # it has no potential energy


@pytest.mark.long
def test_a_derivative_by_a_bad_number_is_nan():
    def stiff(k):
        model = with_numbers(GOOD | {"stiffness": k})
        return jb.potential_energy(model, model.reference)

    assert np.isfinite(jax.grad(stiff)(50.0)) and np.isnan(jax.grad(stiff)(-50.0))
    assert np.isnan(jax.jvp(stiff, (-50.0,), (1.0,))[1])
