"""Plots show the computed numbers in the given axes and change nothing else."""

import sys
from types import SimpleNamespace

import jax.numpy as jnp
import matplotlib
import numpy as np
import pytest
from matplotlib.figure import Figure
from pictures import has_color, pixels_at

import jaxbody as jb
from jaxbody import plots
from jaxbody.views.scenes import poses
from jaxbody.views.scenes.colors import COLORS, GRAY
from jaxbody.views.scenes.element_parts import DAMPER, RUBBER, STEEL


@pytest.fixture(autouse=True)
def nothing_else_is_touched():
    """Given axes, no window is opened and no style is changed."""

    def figures():
        pyplot = sys.modules.get("matplotlib.pyplot")
        return pyplot.get_fignums() if pyplot else []

    before = dict(matplotlib.rcParams), figures()
    yield
    assert (dict(matplotlib.rcParams), figures()) == before


@pytest.fixture
def ax():
    return Figure().subplots()


@pytest.fixture(scope="module")
def model():
    """A plate on two springs, an arm hinged to it and a weight on a guide of the base."""
    return jb.Model(
        bodies={
            "plate": jb.Body(mass=3.0, inertia=[0.3, 0.9, 1.2], com=[0.1, 0.2, 0]),
            "arm": jb.Body(mass=1.0, inertia=[0.1, 0.1, 0.1], position=[2, 0, 0]),
            "weight": jb.Body(mass=0.5, inertia=[0.1, 0.1, 0.1], position=[-3, 0, 0]),
        },
        supports={"base": jb.Support(position=[0, -2, 0])},
        elements={
            "left": jb.Spring(
                ("plate", [-1, 1, 0]),
                ("base", [-1, 4, 0]),
                stiffness=40.0,
                free_length=1.8,
                damping=1.0,
            ),
            "right": jb.Spring(
                ("plate", [1, 1, 0]), ("base", [1, 4, 0]), stiffness=60.0, free_length=1.8
            ),
            "middle": jb.Bushing(
                ("plate", [0, -1, 0]), ("base", [0, 0, 0]), stiffness=[30.0, 40.0, 50.0]
            ),
            "stay": jb.Spring(
                ("weight", [0, 0, 0]), ("base", [-3, 4, 0]), stiffness=20.0, free_length=2.0
            ),
        },
        joints={
            "arm": jb.Hinge("plate", axis=[0, 0, 1], at=[1, 0, 0]),
            "weight": jb.Guide("base", axis=[0, 1, 0]),
        },
        gravity=[0, -9.81, 0],
    )


@pytest.fixture(scope="module")
def trajectory():
    model = jb.Model(
        bodies={"plate": jb.Body(mass=3.0, inertia=[0.3, 0.9, 1.2], position=[0.5, 0, 0])},
        supports={"base": jb.Support()},
        elements={
            "s": jb.Spring(
                ("plate", [0.1, 0, 0]), ("base", [0, 2, 0]), stiffness=50.0, free_length=1.5
            )
        },
    )
    motion = {"base": jb.Harmonic(frequency=1.0, translation=[0.05, 0, 0])}
    return jb.simulate(model, jnp.linspace(0, 1, 21), motion=motion)


def lines(ax):
    return {line.get_label(): line for line in ax.lines}


@pytest.mark.long
def test_a_trajectory_is_drawn_from_the_reference_pose(trajectory, ax):
    assert plots.plot_trajectory(trajectory, ax=ax) is ax
    p = np.asarray(trajectory.poses["plate"].p)
    np.testing.assert_allclose(lines(ax)["plate x"].get_ydata(), p[:, 0] - 0.5, atol=1e-15)
    np.testing.assert_allclose(
        lines(ax)["base x"].get_ydata(),
        0.05 * np.cos(2 * np.pi * np.linspace(0, 1, 21)),
        atol=1e-12,
    )
    assert lines(ax)["base x"].get_linestyle() == "--" and "plate z" not in lines(ax)
    (below,) = (other for other in ax.figure.axes if other is not ax)
    R = np.asarray(trajectory.poses["plate"].R)
    np.testing.assert_allclose(
        lines(below)["plate about z"].get_ydata(), np.arctan2(R[:, 1, 0], R[:, 0, 0]), atol=1e-9
    )
    assert set(lines(below)) == {"plate about z"}
    assert (ax.get_ylabel(), below.get_ylabel(), below.get_xlabel()) == (
        "displacement [m]",
        "turn [rad]",
        "time [s]",
    )


def test_turns_are_drawn_through_whole_turns():
    angles = np.linspace(0, 20, 101)
    c, s, o = np.cos(angles), np.sin(angles), np.zeros(101)
    R = np.stack(
        [np.stack([c, -s, o], -1), np.stack([s, c, o], -1), np.stack([o, o, o + 1], -1)], -2
    )
    np.testing.assert_allclose(poses.turns(R, np.array([1.0, 0, 0, 0]))[:, 2], angles, atol=1e-9)


def test_forces_of_springs_are_drawn(trajectory, ax):
    plots.plot_forces(trajectory, ax=ax)
    force = np.asarray(trajectory.forces["s"])
    np.testing.assert_allclose(
        lines(ax)["s"].get_ydata(), force - force.mean(), atol=1e-12 * abs(force).max()
    )
    assert ax.get_ylabel() == "dynamic force, tension positive [N]"
    (text,) = ax.get_legend().get_texts()
    assert text.get_text() == f"s, mean {force.mean():.4g} N"
    with pytest.raises(jb.JaxbodyError, match="Known: s"):
        plots.plot_forces(trajectory, elements=("t",), ax=ax)


def test_a_fit_is_drawn_with_its_residuals(ax):
    times = np.linspace(0, 1, 11)
    predicted = np.stack([np.sin(times), np.cos(times), 0 * times], 1)
    measured = predicted + np.random.default_rng(0).normal(0, 0.01, predicted.shape)
    measured[3] = np.nan
    run = jb.Experiment(
        times, measured={"corner": measured}, sensors={"corner": jb.Position("plate")}
    )
    fit = SimpleNamespace(
        uncertainty=None,
        experiments={"run1": run},
        predicted={"run1": {"corner": predicted}},
        history=[10.0, 1.0, 0.1],
        rounds=(),
    )
    assert plots.plot_fit(fit, ax=ax) is ax
    means = predicted.mean(0)
    np.testing.assert_allclose(lines(ax)["corner y"].get_ydata(), predicted[:, 1] - means[1])
    assert "corner z" not in lines(ax)  # stands still
    (below,) = (other for other in ax.figure.axes if other is not ax)
    np.testing.assert_allclose(below.lines[1].get_ydata(), measured[:, 1] - predicted[:, 1])
    assert ax.get_ylabel() == "corner, from its mean [m]" and below.get_ylabel() == "residual [m]"
    with pytest.raises(jb.JaxbodyError, match="run1"):
        plots.plot_fit(fit, run="run2", ax=ax)
    other = Figure().subplots()
    plots.plot_history(fit, ax=other)
    assert other.get_yscale() == "log" and list(other.lines[0].get_ydata()) == [10.0, 1.0, 0.1]


def fitted(experiment, **predicted):
    """What a fit to one experiment would be, as far as pictures look at it."""
    return SimpleNamespace(
        uncertainty=None, experiments={"run": experiment}, predicted={"run": predicted}
    )


def test_of_two_units_those_of_one_are_drawn_by_their_names(ax):
    times = np.linspace(0, 1, 11)
    read = np.zeros((11, 6))
    read[:, [0, 2, 4]] = np.sin(np.outer(times, [1.0, 2.0, 3.0]))
    fit = fitted(
        jb.Experiment(
            times, sensors={"plate": jb.sensors.ForcePlate("base")}, measured={"plate": read + 0.1}
        ),
        plate=read,
    )
    plots.plot_fit(fit, ax=ax)
    assert ax.get_ylabel() == "plate force, from its mean [N]" and {"plate Fx", "plate Fz"} < set(
        lines(ax)
    )
    assert [text.get_text() for text in ax.get_legend().get_texts()] == [
        "plate Fx",
        "plate Fz",
        "measured",
        "fitted",
    ]
    other = Figure().subplots()
    plots.plot_fit(fit, sensor="plate moment", ax=other)
    assert other.get_ylabel() == "plate My [N m]"
    with pytest.raises(jb.JaxbodyError, match="Known: plate, plate force, plate moment"):
        plots.plot_fit(fit, sensor="plate torque", ax=ax)


def test_measured_quaternions_are_drawn_with_the_sign_of_those_fitted_and_their_turns_as_residuals(
    ax,
):
    times, angle = np.linspace(0, 1, 11), np.linspace(0, 1, 11)
    turned = np.stack([np.cos(angle / 2), 0 * angle, 0 * angle, np.sin(angle / 2)], 1)
    read = np.stack([np.cos(angle / 2 + 0.01), 0 * angle, 0 * angle, np.sin(angle / 2 + 0.01)], 1)
    fit = fitted(
        jb.Experiment(
            times, sensors={"imu": jb.sensors.Orientation("box")}, measured={"imu": -turned}
        ),
        imu=read,
    )
    plots.plot_fit(fit, ax=ax)
    below = ax.figure.axes[1]
    np.testing.assert_allclose(below.lines[2].get_ydata(), -0.02, atol=1e-12)
    assert (
        ax.get_ylabel() == "imu, from its mean [-]"
        and below.get_ylabel() == "residual [rad]"
        and "imu z" in lines(ax)
    )


def test_a_response_is_drawn_by_magnitude_and_phase(ax):
    f = np.linspace(1.0, 20.0, 30)
    ports = {
        "inputs": {"f": jb.PointForce("mass", direction="z")},
        "outputs": {"y": jb.Position("mass", axis="z")},
    }
    H = 1 / (25.0 - f**2 + 2j * f)
    fit = fitted(
        jb.MeasuredResponse(f, measured={("y", "f"): H * np.exp(0.3j)}, **ports), **{"y/f": H}
    )
    plots.plot_fit(fit, ax=ax)
    below = ax.figure.axes[1]
    assert (
        ax.get_yscale() == "log"
        and ax.get_ylabel() == "magnitude of y/f [m/N]"
        and below.get_ylabel() == "phase [degrees]"
    )
    np.testing.assert_allclose(
        below.lines[0].get_ydata() - below.lines[1].get_ydata(), np.rad2deg(0.3)
    )
    np.testing.assert_allclose(ax.lines[1].get_ydata(), np.abs(H))


def test_modes_are_marks_at_whole_numbers_frequencies_first(ax):
    modes = jb.MeasuredModes(damping_ratio=[0.02, 0.03, 0.01], frequency=[1.0, 2.0, 3.0])
    plots.plot_fit(
        fitted(modes, damping_ratio=np.full(3, 0.02), frequency=np.array([1.1, 2.1, 2.9])), ax=ax
    )
    assert ax.get_ylabel() == "frequency [Hz]" and all(
        line.get_linestyle() == "None" for line in ax.lines
    )
    below = ax.figure.axes[1]
    assert below.get_xlabel() == "mode" and all(tick == round(tick) for tick in below.get_xticks())
    other = Figure().subplots()
    plots.plot_fit(fitted(modes, damping_ratio=np.full(3, 0.02)), sensor="damping_ratio", ax=other)
    assert other.get_ylabel() == "damping_ratio [-]"


def test_a_history_shows_where_noise_was_estimated_again_and_what_failed(ax):
    plots.plot_history(
        SimpleNamespace(history=[10.0, np.nan, 0.03, 300.0, 250.0], rounds=(3,)), ax=ax
    )
    first, second, *_ = ax.lines
    assert list(first.get_xdata()) == [0, 2] and list(second.get_ydata()) == [300.0, 250.0]
    assert list(lines(ax)["noise estimated again"].get_xdata()) == [2.5, 2.5] and list(
        lines(ax)["could not be simulated"].get_xdata()
    ) == [1]


def test_chosen_candidates_are_drawn_first_and_those_without_a_share_are_not(ax):
    """A cubic at 41 places: -1, 1 and near +-1/sqrt 5 are chosen (test_criteria), and have all of
    the shares but for neighbors of the inner two."""
    x = np.linspace(-1, 1, 41)
    choice = jb.choose({f"{each:.2f}": each ** np.arange(4) for each in x}, n=4)
    assert choice.plot(ax=ax) is ax
    names = [text.get_text() for text in ax.get_yticklabels()]
    assert set(names[:4]) == set(choice.names) and 4 <= len(names) <= 8
    share = dict(zip(choice.candidates, choice.shares, strict=True))
    assert [bar.get_width() for bar in ax.patches] == [share[name] for name in names]
    colors = [bar.get_facecolor() for bar in ax.patches]
    assert len(set(colors[:4])) == 1 and colors[0] not in colors[4:]
    assert "4 of 41 by D: at least" in ax.get_title()


def test_a_model_is_drawn_through_its_attachment_points(model, ax):
    assert plots.draw_model(model, ax=ax) is ax
    for corner in ((-1, 1), (1, 1), (0, -1), (0.9, 0)):  # of the plate
        assert has_color(ax, 0.9 * np.array(corner), COLORS[0])
    for x in (-1, 1, -3):  # the springs end at y = 2, below their feet on the base
        assert has_color(ax, (x, 1.95), DAMPER if x == -1 else STEEL)
        assert has_color(ax, (x, 2.02), GRAY)
    assert has_color(ax, (0.15, -2), RUBBER) and not has_color(ax, (0.3, -2), RUBBER)
    assert {text.get_text() for text in ax.texts} >= {
        "plate",
        "arm",
        "weight",
        "left",
        "right",
        "middle",
        "stay",
    }
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("x [m]", "y [m]") and ax.get_aspect() == 1


def test_a_model_is_drawn_where_its_state_and_its_base_are(model, ax):
    q = model.reference.q.at[1].add(0.3)
    plots.draw_model(
        model,
        jb.State(q, model.reference.v),
        displaced={"base": [0.5, 0, 0, 0, 0, 0]},
        names=False,
        ax=ax,
    )
    assert has_color(ax, (-0.9, 1.25), COLORS[0]) and not has_color(ax, (0, -1.0), COLORS[0])
    for x in (-0.5, 1.5, -2.5):  # the feet are on the base
        assert has_color(ax, (x, 2.02), GRAY)
    assert has_color(ax, (-2.1, 0.2), COLORS[2])  # the weight's guide is on the base
    assert not ax.texts
    with pytest.raises(jb.JaxbodyError, match="Did you mean 'base'"):
        plots.draw_model(model, displaced={"bass": np.zeros(6)}, ax=ax)


@pytest.mark.parametrize("view, right, up", [("xy", "x", "y"), ("zy", "z", "y"), ("yx", "y", "x")])
def test_a_view_names_what_is_right_and_up(model, ax, view, right, up):
    plots.draw_model(model, view=view, ax=ax)
    assert (ax.get_xlabel(), ax.get_ylabel()) == (f"{right} [m]", f"{up} [m]")
    place = {"x": -3.3, "y": 0.3, "z": 0}  # on the weight
    assert has_color(ax, (place[right], place[up]), COLORS[2])


def test_an_unknown_view_is_refused(model, ax):
    with pytest.raises(jb.JaxbodyError, match="oblique"):
        plots.draw_model(model, view="xx", ax=ax)


def test_a_mode_is_drawn_over_the_model_at_rest(model, ax):
    """Along its shape, as far as the bushing's pin may leave its ring: 0.8 of 0.032 of the size,
    5 m along x; the model at rest is pale."""
    lin = SimpleNamespace(model=model, state=model.reference)
    shape = np.zeros((8, 1))
    shape[1, 0] = 2.0  # the plate along y
    modes = SimpleNamespace(
        model=model,
        shapes=shape,
        frequency=np.array([3.0]),
        damping_ratio=np.array([0.02]),
        names=("plate along y 100 %",),
    )
    plots.draw_model(model, names=False, ax=ax)
    other = plots.draw_mode(lin, modes, 1, ax=Figure().subplots())
    heights = np.arange(-1.3, -0.5, 0.002)
    lowest = [next(y for y in heights if has_color(x, (0.1, y), COLORS[0])) for x in (ax, other)]
    assert lowest[1] - lowest[0] == pytest.approx(0.8 * 0.032 * 5.0, abs=0.02)
    below = pixels_at(other, (0.1, sum(lowest) / 2))
    assert (below[:, 3] > 0).any() and not has_color(other, (0.1, sum(lowest) / 2), COLORS[0])
    assert (
        other.get_title() == "mode 1: 3 Hz, damping ratio 0.02\nkinetic energy: plate along y 100 %"
    )
    with pytest.raises(jb.JaxbodyError, match="1 to 1"):
        plots.draw_mode(lin, modes, 2, ax=ax)
