"""States: lists are taken wherever arrays are, and anything that is no State is named where it
is given."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

MODEL = jb.Model(
    bodies={"mass": jb.Body(2.0)},
    joints={"mass": jb.Guide("world", axis="z")},
    supports={"base": jb.Support()},
    elements={
        "spring": jb.Spring(
            ("mass", [0, 0, 0]), ("base", [0, 0, 5.0]), stiffness=8.0, free_length=4.0
        )
    },
)
TAKE_A_STATE = {
    "simulate": lambda state: jb.simulate(MODEL, [0.0, 0.1], initial=state).state.q,
    "equilibrium": lambda state: jb.equilibrium(MODEL, start=state).state.q,
    "linearize": lambda state: jb.linearize(MODEL, state).K,
    "load_cases": lambda state: (
        jb.load_cases(MODEL, {"up": jb.LoadCase(acceleration=[0, 0, 1.0])}, at=state).forces
    ),
    "preload": lambda state: (
        jb.preload(MODEL, free=["spring.free_length"], pose=state).model["spring"].free_length
    ),
    "excitation": lambda state: jb.excitation(MODEL, state, {"base": [0, 0, 0.1, 0, 0, 0]}),
    "kinetic_energy": lambda state: jb.kinetic_energy(MODEL, state),
    "potential_energy": lambda state: jb.potential_energy(MODEL, state),
    "lagrangian": lambda state: jb.lagrangian(MODEL, state),
    "dissipation": lambda state: jb.dissipation(MODEL, state),
    "Experiment": lambda state: (
        jb.Experiment(
            [0.0, 1.0],
            initial=state,
            sensors={"z": jb.Position("mass", axis="z")},
            measured={"z": [0.0, 1.0]},
        ).initial.q
    ),
    "plot": lambda state: MODEL.plot(state) and 0.0,
}


@pytest.mark.nan  # load paths are filled up with NaN
@pytest.mark.parametrize("name", TAKE_A_STATE)
def test_a_state_of_lists_and_whole_numbers_is_that_of_arrays_and_what_is_no_state_is_named(name):
    expected = TAKE_A_STATE[name](jb.State(jnp.array([1.0]), jnp.array([2.0])))
    for given in (
        jb.State([1], [2.0]),
        jb.State(np.array([1]), np.array([2])),
        jb.State(q=(1.0,), v=[jnp.array(2.0)]),
    ):
        assert jax.tree.all(jax.tree.map(np.array_equal, TAKE_A_STATE[name](given), expected))
    for given in ([1.0], np.array([1.0]), "here"):
        with pytest.raises(
            jb.JaxbodyError,
            match=r"is an? (list|ndarray|str).*allowed: jb\.State\(q, v\).*WRONG_KIND",
        ):
            TAKE_A_STATE[name](given)


def test_lists_of_traced_numbers_make_a_state_and_words_do_not():
    rate = jax.grad(lambda v: jb.kinetic_energy(MODEL, jb.State([0.0], [v])))(3.0)
    np.testing.assert_allclose(rate, 2.0 * 3.0)
    np.testing.assert_allclose(jb.joints.retract(MODEL, [0.5], [1]), [1.5])
    with pytest.raises(jb.JaxbodyError, match=r"State\.v: is 'fast'.*NOT_A_NUMBER"):
        jb.State([0.0], "fast")
