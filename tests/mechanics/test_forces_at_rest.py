"""Forces of elements and reactions of supports at an equilibrium, by statics, by the equations of
motion and by closed form."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

G = 9.81


@pytest.fixture(scope="module")
def crane():
    """An arm on a hinge of a tilted support, a hook that it carries, a spring that holds it, a
    bushing, a spiral spring, a free load."""
    turn = jb.EulerAngles("z", [0.3])
    return jb.Model(
        bodies={
            "arm": jb.Body(
                5.0, [0.1, 2.0, 2.0], com=[1, 0, 0], position=[0, 0, 1], orientation=turn
            ),
            "hook": jb.Body(2.0, [0.1, 0.1, 0.1], com=[0, 0, -0.2], position=[1.9, 0.6, 1]),
            "load": jb.Body(3.0, [0.2, 0.3, 0.4], position=[1.9, 0.6, 0]),
        },
        supports={
            "tower": jb.Support([0, 0, 0.5], orientation=turn),
            "floor": jb.Support([0.2, 0, -0.5]),
        },
        joints={"arm": jb.Hinge("tower", axis="y"), "hook": jb.Guide("arm", axis="x")},
        elements={
            "stay": jb.Spring(
                ("arm", [1.5, 0, 0]), ("tower", [0, 0, 1.5]), stiffness=600.0, free_length=1.2
            ),
            "coil": jb.Torsion("arm", "tower", axis="y", spring=30.0, damper=2.0),
            "slide": jb.Spring(
                ("hook", [0, 0, 0]), ("arm", [0, 0, 0]), stiffness=300.0, free_length=1.5
            ),
            "rope": jb.Spring(
                ("load", [0, 0, 0.2]), ("hook", [0, 0, -0.2]), stiffness=900.0, free_length=0.5
            ),
            "mount": jb.Bushing(
                ("load", [0, 0, 0]),
                ("floor", [1.7, 0.6, 0.5]),
                stiffness=np.diag([80.0, 90, 70, 9, 8, 7]),
            ),
        },
        gravity=[0, 0, -G],
    )


LOADS = {
    "wind": jb.Force(
        ("hook", [0, 0, 0.1]), force=[3.0, 5.0, -2.0], moment=[0.5, 0.2, 0.1], axes="body"
    )
}


@pytest.mark.parametrize(
    "loads", [pytest.param(None, marks=pytest.mark.long), LOADS], ids=["weights", "loads"]
)
@pytest.mark.nan
def test_they_are_those_of_a_motion_that_stays_there(crane, loads):
    """The residual of the search is 1e-9 N or less, and leaves accelerations that far from zero."""
    rest = jb.equilibrium(crane, loads=loads)
    assert rest.ok
    still = jb.simulate(crane, [0.0, 1e-3], initial=rest.state, loads=loads)
    assert set(rest.forces) == set(crane.element_names) and set(rest.reactions) == {
        "tower",
        "floor",
    }
    for name, force in rest.forces.items():
        np.testing.assert_allclose(force, still.forces[name][0], rtol=1e-9, atol=1e-9, err_msg=name)
    for name, both in rest.reactions.items():
        for mine, by_motion in zip(both, still.reactions[name], strict=True):
            np.testing.assert_allclose(mine, by_motion[0], rtol=1e-8, atol=1e-8, err_msg=name)


def test_supports_carry_all_weights_and_loads(crane):
    rest = jb.equilibrium(crane)
    total = sum(np.asarray(force) for force, _ in rest.reactions.values())
    np.testing.assert_allclose(total, [0, 0, -10.0 * G], atol=1e-8)


@pytest.mark.long
def test_a_fraction_of_the_loads_is_what_an_equilibrium_at_a_limit_point_carries():
    """A spring of the force 100 x (1 - x), at most 25 N, under 40 N."""
    law = jb.laws.Polynomial([100.0, -100.0])
    model = jb.Model(
        bodies={"weight": jb.Body(1.0)},
        supports={"roof": jb.Support([0, 0, 1])},
        joints={"weight": jb.Guide("world", axis="z")},
        elements={
            "hanger": jb.SpringDamper(
                ("weight", [0, 0, 0]), ("roof", [0, 0, 0]), spring=law, free_length=1.0
            )
        },
    )
    with pytest.warns(jb.JaxbodyWarning, match="LIMIT_POINT"):
        rest = jb.equilibrium(model, loads={"pull": jb.Force("weight", force=[0, 0, -40.0])})
    factor, force = float(rest.load_factor), float(rest.forces["hanger"])
    assert 0.5 < factor < 0.626 and force == pytest.approx(40.0 * factor, rel=1e-8)
    # the weight's guide stands on the world
    np.testing.assert_allclose(rest.reactions["roof"][0], [0, 0, -force], rtol=1e-12)


def test_a_pendulum_pulled_aside_moves_with_its_mass_as_in_closed_form():
    """tan(angle) = F/(m g), so that d(angle)/dm = -F g/((m g)^2 + F^2): the pull has a
    stiffness, too."""
    mass, pull = 2.0, 15.0
    model = jb.Model(
        bodies={"bob": jb.Body(mass, [0.1, 0.1, 0.1], com=[0, 0, -0.7])},
        joints={"bob": jb.Hinge("world", axis="y")},
        gravity=[0, 0, -G],
    )
    loads = {"pull": jb.Force(("bob", [0, 0, -0.7]), force=[pull, 0, 0])}
    angle = lambda m: -jb.equilibrium(jb.replace(model, {("bob.mass"): m}), loads=loads).state.q[0]  # noqa: E731
    value, slope = jax.jit(lambda m: jax.jvp(angle, (m,), (1.0,)))(mass)
    assert float(value) == pytest.approx(np.arctan(pull / (mass * G)), rel=1e-9)
    assert float(slope) == pytest.approx(-pull * G / ((mass * G) ** 2 + pull**2), rel=1e-9)


@pytest.mark.long
def test_forces_have_exact_derivatives_and_batches(crane):
    """The force of the stay changes with its free length as by central differences, whose error is
    1e-4^2 of the third derivative."""

    def stay(length):
        return jb.equilibrium(jb.replace(crane, {"stay.free_length": length})).forces["stay"]

    slope = jax.grad(stay)(1.2)
    assert float(slope) == pytest.approx(
        float(stay(1.2 + 1e-4) - stay(1.2 - 1e-4)) / 2e-4, rel=1e-6
    )
    batch = jax.vmap(
        lambda length: jb.equilibrium(jb.replace(crane, {"stay.free_length": length}))
    )(jnp.array([1.1, 1.2]))
    assert batch.forces["mount"].shape == (2, 6) and batch.reactions["floor"][0].shape == (2, 3)
    assert float(batch.forces["stay"][1]) == pytest.approx(float(stay(1.2)), rel=1e-9)


@pytest.mark.long
def test_they_are_printed_with_units_what_is_about_an_axis_apart(crane):
    text = repr(jb.equilibrium(crane))
    lines = {line.split()[0]: line for line in text.splitlines() if line.strip()}
    assert (
        "deformation [m]" in lines["element"]
        and "rotation [rad]" in lines["element"]
        and "moment [N m]" in lines["element"]
    )
    assert "force on it [N]" in lines["support"] and len(lines["tower"].split()) == 7
    assert (
        len(lines["coil"].split()) == 3
        and len(lines["stay"].split()) == 3
        and len(lines["mount"].split()) == 13
    )
    plain = repr(jb.equilibrium(jb.presets.quarter_car()))
    assert "elongation [m]  force [N]" in plain and "rotation" not in plain


@pytest.mark.long
def test_they_stand_in_the_dataset(crane):
    rest = jb.equilibrium(crane)
    data = rest.to_xarray()
    assert data["force"].attrs["units"] == "N" and data["reaction_moment"].attrs["units"] == "N m"
    np.testing.assert_array_equal(
        data["reaction_force"].sel(support="floor"), rest.reactions["floor"][0]
    )
    np.testing.assert_array_equal(data["mount_force"], rest.forces["mount"])
    np.testing.assert_array_equal(data["force"].sel(spring="stay"), rest.forces["stay"])
