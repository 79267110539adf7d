"""Results as xarray datasets hold the same numbers under names, with units; without xarray the way to get it is told."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.simulations.trajectories import Trajectory


@pytest.fixture(scope="module")
def model():
    return jb.Model(
        bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        elements={"s": jb.Spring(("mass", [0, 0, 0]), ("base", [0, 1, 0]), stiffness=50.0, free_length=0.9, damping=1.0)},
        joints={"mass": jb.Guide("base", axis=[0, 1, 0])},
        gravity=[0, -9.81, 0],
    )


@pytest.fixture(scope="module")
def trajectory(model):
    return jb.simulate(model, jnp.linspace(0, 0.5, 6), motion={"base": jb.Harmonic(frequency=1.0, translation=[0.01, 0.02, 0])})


def test_a_trajectory(trajectory):
    made = Trajectory.to_xarray(trajectory)
    np.testing.assert_array_equal(made["time"], trajectory.times)
    np.testing.assert_array_equal(made["position"].sel(frame="mass", axis="y"), trajectory.poses["mass"].p[:, 1])
    np.testing.assert_array_equal(made["quaternion"].sel(frame="base", part="w"), trajectory.poses["base"].quaternion[:, 0])
    np.testing.assert_array_equal(made["force"].sel(spring="s"), trajectory.forces["s"])
    np.testing.assert_array_equal(made["reaction_force"].sel(support="base"), trajectory.reactions["base"][0])
    np.testing.assert_array_equal(made["kinetic_energy"], trajectory.energies["kinetic"])
    assert made["position"].attrs["units"] == "m" and made["time"].attrs["units"] == "s" and int(made["status"]) == 0


def test_a_batch_of_trajectories_has_samples_and_bushings_their_components(rng):
    def some(*shape):
        return rng.normal(size=(3, 6, *shape))

    springs = SimpleNamespace(names=("s", "t"), rows=SimpleNamespace(size=1))
    bushings = SimpleNamespace(names=("b",), rows=SimpleNamespace(size=6))
    batch = SimpleNamespace(
        model=SimpleNamespace(elements=(springs, bushings), layout=SimpleNamespace(supports=("base",))),
        times=some(),
        poses={name: SimpleNamespace(p=some(3), quaternion=some(4)) for name in ("base", "mass")},
        energies={"kinetic": some(), "potential": some()},
        elongations={"s": some(), "t": some(), "b": some(6)},
        forces={"s": some(), "t": some(), "b": some(6)},
        reactions={"base": (some(3), some(3))},
        status=np.array([0, 0, 4]),
    )
    made = Trajectory.to_xarray(batch)
    assert made["position"].dims == ("sample", "time", "frame", "axis") and made["status"].dims == ("sample",)
    np.testing.assert_array_equal(made["position"].sel(frame="mass"), batch.poses["mass"].p)
    np.testing.assert_array_equal(made["elongation"].sel(spring="t"), batch.elongations["t"])
    np.testing.assert_array_equal(made["b_force"], batch.forces["b"])
    np.testing.assert_array_equal(made["times"], batch.times)


def test_statics_and_small_motions(model):
    eq = jb.equilibrium(model)
    lin = jb.linearize(model, eq)
    modes = jb.modes(lin)
    made = eq.to_xarray()
    assert float(made["elongation"].sel(spring="s")) == float(eq.elongations["s"])
    assert float(made["q"].sel(part="mass 0")) == float(eq.state.q[0])
    made = lin.to_xarray()
    up, across = "mass move along its guide", "base move along y"
    assert float(made["K"].sel(coordinate=up, coordinate_2=up)) == float(lin.K[0, 0])
    assert float(made["M_tilde"].sel(coordinate=up, base=across)) == float(lin.M_tilde[0, 1])
    made = modes.to_xarray()
    assert float(made["frequency"].sel(mode=1)) == float(modes.frequency[0])
    np.testing.assert_array_equal(made["shape"].sel(mode=1), modes.shapes[:, 0])


def test_a_fit():
    times = jnp.linspace(0, 1, 4)
    sensors = {"place": jb.Position("mass"), "stretch": jb.Elongation("s")}
    measured = {"place": jnp.arange(12.0).reshape(4, 3), "stretch": jnp.arange(4.0)}
    experiment = jb.Experiment(times, measured=measured, sensors=sensors)
    fit = SimpleNamespace(
        estimates={"s.stiffness": jnp.array(50.0), "mass.com": jnp.array([1.0, 2.0, 3.0])},
        standard_errors={"s.stiffness": np.array(0.5), "mass.com": np.array([0.1, 0.2, np.inf])},
        intervals=lambda level: {"s.stiffness": (49.0, 51.0), "mass.com": ([0.8, 1.6, -np.inf], [1.2, 2.4, np.inf])},
        singular_values=np.arange(4.0),
        predicted={"run1": {name: 2 * values for name, values in measured.items()}},
        experiments={"run1": experiment},
        status=jnp.array(7),
    )
    made = jb.Fit.to_xarray(fit)
    assert float(made["estimate"].sel(parameter="mass.com[1]")) == 2.0
    assert float(made["standard_error"].sel(parameter="mass.com[2]")) == np.inf
    np.testing.assert_array_equal(made["upper"], [51.0, 1.2, 2.4, np.inf])
    np.testing.assert_array_equal(made["run1_stretch_predicted"], 2 * np.arange(4.0))
    np.testing.assert_array_equal(made["run1_place_measured"], np.arange(12.0).reshape(4, 3))
    np.testing.assert_array_equal(made["run1_time"], times)
