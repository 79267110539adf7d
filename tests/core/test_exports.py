"""Results as xarray datasets hold the same numbers with names and units; without xarray the message
says how to install it."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.motion.trajectories import Trajectory


@pytest.fixture(scope="module")
def model():
    return jb.Model(
        bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        elements={
            "s": jb.Spring(
                ("mass", [0, 0, 0]),
                ("base", [0, 1, 0]),
                stiffness=50.0,
                free_length=0.9,
                damping=1.0,
            )
        },
        joints={"mass": jb.Guide("base", axis=[0, 1, 0])},
        gravity=[0, -9.81, 0],
    )


@pytest.fixture(scope="module")
def trajectory(model):
    return jb.simulate(
        model,
        jnp.linspace(0, 0.5, 6),
        motion={"base": jb.Harmonic(frequency=1.0, translation=[0.01, 0.02, 0])},
    )


@pytest.mark.long
def test_a_trajectory(trajectory):
    dataset = Trajectory.to_xarray(trajectory)
    np.testing.assert_array_equal(dataset["time"], trajectory.times)
    np.testing.assert_array_equal(
        dataset["position"].sel(frame="mass", axis="y"), trajectory.poses["mass"].p[:, 1]
    )
    np.testing.assert_array_equal(
        dataset["quaternion"].sel(frame="base", part="w"), trajectory.poses["base"].quaternion[:, 0]
    )
    np.testing.assert_array_equal(dataset["force"].sel(spring="s"), trajectory.forces["s"])
    np.testing.assert_array_equal(
        dataset["reaction_force"].sel(support="base"), trajectory.reactions["base"][0]
    )
    np.testing.assert_array_equal(dataset["kinetic_energy"], trajectory.energies["kinetic"])
    assert (
        dataset["position"].attrs["units"] == "m"
        and dataset["time"].attrs["units"] == "s"
        and int(dataset["status"]) == 0
    )


def test_a_batch_of_trajectories_has_samples_and_bushings_their_components(rng):
    def random(*shape):
        return rng.normal(size=(3, 6, *shape))

    springs = SimpleNamespace(names=("s", "t"), rows=SimpleNamespace(size=1))
    bushings = SimpleNamespace(names=("b",), rows=SimpleNamespace(size=6))
    batch = SimpleNamespace(
        model=SimpleNamespace(
            elements=(springs, bushings), layout=SimpleNamespace(supports=("base",), nz=0)
        ),
        times=random(),
        poses={
            name: SimpleNamespace(p=random(3), quaternion=random(4)) for name in ("base", "mass")
        },
        energies={"kinetic": random(), "potential": random()},
        elongations={"s": random(), "t": random(), "b": random(6)},
        forces={"s": random(), "t": random(), "b": random(6)},
        reactions={"base": (random(3), random(3))},
        status=np.array([0, 0, 4]),
    )
    dataset = Trajectory.to_xarray(batch)
    assert dataset["position"].dims == ("sample", "time", "frame", "axis") and dataset[
        "status"
    ].dims == ("sample",)
    np.testing.assert_array_equal(dataset["position"].sel(frame="mass"), batch.poses["mass"].p)
    np.testing.assert_array_equal(dataset["elongation"].sel(spring="t"), batch.elongations["t"])
    np.testing.assert_array_equal(dataset["b_force"], batch.forces["b"])
    np.testing.assert_array_equal(dataset["times"], batch.times)


@pytest.mark.long
def test_statics_and_small_motions(model):
    eq = jb.equilibrium(model)
    lin = jb.linearize(model, eq)
    modes = jb.modes(lin)
    dataset = eq.to_xarray()
    assert float(dataset["elongation"].sel(spring="s")) == float(eq.elongations["s"])
    assert float(dataset["q"].sel(part="mass 0")) == float(eq.state.q[0])
    dataset = lin.to_xarray()
    up, across = "mass move along its guide", "base move along y"
    assert float(dataset["K"].sel(coordinate=up, coordinate_2=up)) == float(lin.K[0, 0])
    assert float(dataset["M_tilde"].sel(coordinate=up, base=across)) == float(lin.M_tilde[0, 1])
    dataset = modes.to_xarray()
    assert float(dataset["frequency"].sel(mode=1)) == float(modes.frequency[0])
    np.testing.assert_array_equal(dataset["shape"].sel(mode=1), modes.shapes[:, 0])


@pytest.mark.long
def test_a_fit():
    times = jnp.linspace(0, 1, 4)
    sensors = {"place": jb.Position("mass"), "stretch": jb.Elongation("s")}
    measured = {"place": jnp.arange(12.0).reshape(4, 3), "stretch": jnp.arange(4.0)}
    experiment = jb.Experiment(times, measured=measured, sensors=sensors)
    fit = SimpleNamespace(
        estimates={"s.stiffness": jnp.array(50.0), "mass.com": jnp.array([1.0, 2.0, 3.0])},
        standard_errors={"s.stiffness": np.array(0.5), "mass.com": np.array([0.1, 0.2, np.inf])},
        intervals=lambda level: {
            "s.stiffness": (49.0, 51.0),
            "mass.com": ([0.8, 1.6, -np.inf], [1.2, 2.4, np.inf]),
        },
        singular_values=np.arange(4.0),
        predicted={"run1": {name: 2 * values for name, values in measured.items()}},
        experiments={"run1": experiment},
        status=jnp.array(7),
    )
    dataset = jb.fitting.Fit.to_xarray(fit)
    assert float(dataset["estimate"].sel(parameter="mass.com[1]")) == 2.0
    assert float(dataset["standard_error"].sel(parameter="mass.com[2]")) == np.inf
    np.testing.assert_array_equal(dataset["upper"], [51.0, 1.2, 2.4, np.inf])
    np.testing.assert_array_equal(dataset["run1_stretch_predicted"], 2 * np.arange(4.0))
    np.testing.assert_array_equal(dataset["run1_place_measured"], np.arange(12.0).reshape(4, 3))
    np.testing.assert_array_equal(dataset["run1_time"], times)
