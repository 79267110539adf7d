"""Every curve has its name, no two look the same, and every axis has one unit, for a car with seven
degrees of freedom."""

from types import SimpleNamespace

import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from test_plots import lines, nothing_else_is_touched  # noqa: F401

import jaxbody as jb
from jaxbody import plots
from jaxbody.views.plots import canvases

WHEELS = ("fl", "fr", "rl", "rr")


@pytest.fixture(scope="module")
def car():
    return jb.presets.full_car()


@pytest.fixture(scope="module")
def response(car):
    lin = jb.linearize(car, car.reference)
    roads = {f"road {wheel}": jb.BaseMotion(f"road {wheel}", "z") for wheel in WHEELS}
    outputs = {name: jb.Position(name, axis="z") for name in ("car", *WHEELS)}
    outputs |= {f"force {wheel}": jb.sensors.LoadCell(f"tyre {wheel}") for wheel in WHEELS}
    return jb.frequency_response(lin, jnp.geomspace(0.2, 30.0, 12), roads, outputs)


def assert_named_and_distinct(ax, count):
    named = [text.get_text().split(", mean ")[0] for text in ax.get_legend().get_texts()]
    looks = {
        (line.get_color(), line._dash_pattern[1] and tuple(line._dash_pattern[1]))
        for line in ax.lines
        if line.get_label() in named
    }
    assert len(named) == len(set(named)) == len(looks) == count


@pytest.mark.long
def test_the_responses_of_a_car_are_all_named_and_a_panel_has_one_unit(response):
    ax = plots.plot_frequency_response(
        response, ax=Figure(figsize=(9, 7), layout="constrained").subplots()
    )
    forces, phases = (axes for axes in ax.figure.axes if axes is not ax)
    assert_named_and_distinct(ax, 20)
    assert_named_and_distinct(forces, 16)
    assert (ax.get_ylabel(), forces.get_ylabel(), phases.get_ylabel()) == (
        "magnitude [-]",
        "magnitude [N per m]",
        "phase [degrees]",
    )
    assert (
        len(phases.lines) == 36
        and not ax.xaxis.get_tick_params()["labelbottom"]
        and phases.get_xlabel() == "frequency [Hz]"
    )
    np.testing.assert_allclose(
        lines(forces)["force fl of road fl"].get_ydata(),
        np.abs(response["force fl", "road fl"]),
        rtol=1e-14,
    )
    ax = plots.plot_transmissibility(response, ax=Figure(figsize=(7, 4)).subplots())
    assert_named_and_distinct(ax, 20)


def test_a_single_input_is_the_title_of_the_legend():
    car = jb.presets.quarter_car(damping=1500.0)
    road, body = {"road": jb.BaseMotion("road", "z")}, {"body": jb.Position("body", axis="z")}
    response = jb.frequency_response(
        jb.linearize(car, car.reference), jnp.geomspace(0.1, 50, 10), road, body
    )
    for plot in (plots.plot_frequency_response, plots.plot_transmissibility):
        ax = plot(response, ax=Figure().subplots())
        assert ax.get_legend().get_title().get_text() == "input: road"


@pytest.mark.long
def test_names_beside_the_axes_stay_within_their_height(response):
    figure = Figure(figsize=(9, 4), layout="constrained")
    ax = plots.plot_transmissibility(response, ax=figure.subplots())
    figure.canvas.draw()
    assert ax.get_legend().get_window_extent().y0 > ax.get_window_extent().y0 - 5


@pytest.mark.long
def test_the_motion_and_the_forces_of_a_car_are_all_named(car):
    motion = {
        f"road {wheel}": jb.Harmonic(frequency=1.0 + i, translation=[0, 0, 0.01])
        for i, wheel in enumerate(WHEELS)
    }
    run = jb.simulate(car, jnp.linspace(0, 0.2, 11), motion=motion)
    ax = plots.plot_trajectory(run, ax=Figure().subplots())
    assert_named_and_distinct(ax, 9)
    assert ax.get_legend() and ax.get_ylabel() == "displacement [m]"
    ax = plots.plot_forces(run, ax=Figure().subplots())
    assert_named_and_distinct(ax, 10)


@pytest.mark.long
def test_moments_have_a_panel_of_their_own():
    """A torsion spring of 30 N m/rad turned by 0.2 rad, a bushing that resists turning by 5 N
    m/rad, a spring that has a force."""
    elements = {
        "spring": jb.Spring(
            ("arm", [1, 0, 0]), ("world", [1, 0, -1]), stiffness=10.0, free_length=1.0
        ),
        "torsion": jb.Torsion("arm", "world", axis=[0, 0, 1], spring=30.0),
        "bushing": jb.Bushing(
            ("arm", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=np.diag([1.0, 1, 1, 5, 5, 5])
        ),
    }
    joints = {"arm": jb.Hinge("world", axis=[0, 0, 1])}
    model = jb.Model(
        bodies={"arm": jb.Body(mass=1.0, inertia=[1, 1, 1])}, joints=joints, elements=elements
    )
    start = jb.State(jnp.array([0.2]), jnp.zeros(1))
    ax = plots.plot_forces(
        jb.simulate(model, jnp.linspace(0, 0.01, 3), initial=start), ax=Figure().subplots()
    )
    (below,) = (axes for axes in ax.figure.axes if axes is not ax)
    assert (ax.get_ylabel(), below.get_ylabel()) == (
        "dynamic force opposing\nthe deformation [N]",
        "dynamic moment [N m]",
    )
    assert (
        set(lines(below)) == {"torsion", "bushing about z"}
        and "spring" in lines(ax)
        and "torsion" not in lines(ax)
    )
    means = dict(text.get_text().split(", mean ") for text in below.get_legend().get_texts())
    for name, moment in (("torsion", 6.0), ("bushing about z", 1.0)):
        mean = float(means[name].removesuffix(" N m"))
        assert abs(mean + lines(below)[name].get_ydata()[0]) == pytest.approx(moment, rel=0.005)


@pytest.mark.long
def test_tension_is_a_word_of_what_has_a_length(car):
    """A bushing deforms along its axes, as the place of its second end seen from its first, and its
    force is positive with that."""
    engine = jb.presets.engine_on_mounts(gravity=9.81)
    cases = {"bump": jb.LoadCase(acceleration=[0, 0, 1])}
    ax = jb.load_cases(engine, cases).plot(ax=Figure().subplots())
    labels = [axes.get_ylabel() for axes in ax.figure.axes]
    assert labels[:2] == ["stroke [m]", "force opposing\nthe deformation [N]"]
    run = jb.simulate(engine, jnp.linspace(0, 0.02, 3))
    ax = plots.plot_force_strokes(run, ax=Figure().subplots())
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("deformation [m]", labels[1])
    along_z = dict(zip([line.get_label() for line in ax.lines], ax.lines, strict=True))[
        "mount 1 z"
    ].get_xydata()
    assert np.all(along_z[1:, 0] * along_z[1:, 1] > 0)
    assert (
        jb.load_cases(car, cases).plot(ax=Figure().subplots()).figure.axes[1].get_ylabel()
        == "force, tension positive [N]"
    )


def test_thirty_two_lines_look_different():
    looks = [canvases.style(i) for i in range(32)]
    assert len({(look["color"], str(look["ls"])) for look in looks}) == 32


@pytest.mark.long
def test_rows_without_energy_are_left_out_and_counted(car):
    energies = jb.vibration.mode_energies(jb.linearize(car, car.reference), forward="x")
    ax = plots.plot_mode_energies(energies, ax=Figure().subplots())
    (image,) = ax.images
    shares = np.asarray(energies.kinetic_shares).reshape(-1, 7)
    assert image.get_array().shape == (7, 7) and len(shares) == 30
    assert ax.get_title() == "kinetic energy [%]; 23 rows below 0.05 % left out"
    np.testing.assert_allclose(np.asarray(image.get_array()).sum(0), 100.0, atol=23 * 0.05)


def test_a_tornado_counts_the_parameters_that_it_leaves_out():
    count = 22
    result = SimpleNamespace(
        quantities=("y",),
        row=lambda _: 0,
        order=lambda _: np.arange(count),
        nominal=np.zeros(1),
        change=0.01,
        low=-np.ones((1, count)),
        high=np.ones((1, count)),
        parameters=[f"p{i}" for i in range(count)],
    )
    ax = plots.plot_tornado(result, ax=Figure().subplots())
    assert ax.get_title() == "the strongest 15 of 22 parameters" and len(ax.get_yticks()) == 15


@pytest.mark.long
def test_branches_beyond_eight_look_different():
    frequency = jnp.arange(1.0, 13.0) * jnp.ones((3, 1))
    names = ["body bounce"] * 12  # the same name is no reason to take one curve for another
    result = SimpleNamespace(
        values=jnp.arange(3.0),
        frequency=frequency,
        mac=jnp.ones((3, 12)),
        status=jnp.zeros(3),
        names=names,
    )
    assert_named_and_distinct(plots.plot_tracked_modes(result, ax=Figure().subplots()), 12)
