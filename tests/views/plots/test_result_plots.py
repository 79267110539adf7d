"""Every result draws itself, by the function of its class; new pictures show the
result's numbers."""

import importlib
import inspect

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from matplotlib.figure import Figure
from pictures import units
from test_plots import lines, nothing_else_is_touched  # noqa: F401
from test_project import NAMED

import jaxbody as jb
from jaxbody import plots
from jaxbody.core.tables import Printed
from jaxbody.vibration.linearizations import LinearSystem
from jaxbody.views.plots import canvases
from jaxbody.views.plots.plots_of_results import PICTURES, picture_of

# numbers of different kinds; lists beside a `model`, which has a plot
WITHOUT_PLOT = {
    *(
        "Evidence",
        "FurtherMeasurements",
        "LeaveOneOut",
        "Plausibility",
        "WheelCompliance",
        "MjcfModel",
        "Study",
    ),
    *("Regulator", "Estimator", "Margins"),
}
MASS, STIFFNESS, DAMPING, FREQUENCY, AMPLITUDE = 2.0, 800.0, 16.0, 2.0, 0.01


def result_classes():
    """All classes of the package that print as tables and can be made."""
    classes = set()
    for module in NAMED:
        imported = importlib.import_module(f"jaxbody.{module}")
        classes |= {
            x
            for x in vars(imported).values()
            if inspect.isclass(x) and issubclass(x, Printed) and not inspect.isabstract(x)
        }
    return sorted(classes, key=lambda x: x.__name__)


def test_every_result_has_a_plot():
    classes = result_classes()
    assert {"Trajectory", "Fit", "Linearization", "SpinLinearization", "Record", "Model"} <= {
        x.__name__ for x in classes
    }
    assert {x.__name__ for x in classes if not hasattr(x, "plot")} == WITHOUT_PLOT


def test_every_public_function_returns_something_that_is_among_them():
    """By its annotation: a new result class cannot be missed because nothing imports it."""
    homes = [jb, *(getattr(jb, family) for family in jb._MODULES)]
    public = [getattr(home, name) for home in homes for name in dir(home)]
    returned = {
        inspect.signature(each).return_annotation for each in public if inspect.isfunction(each)
    }
    returned = {getattr(each, "__name__", each) for each in returned}
    results = {x.__name__ for x in result_classes()}
    assert len(returned & results) > 25


@pytest.mark.parametrize(
    "draw", [picture.draw for picture in PICTURES.values()], ids=lambda draw: draw.__name__
)
def test_a_plot_takes_axes_by_keyword_and_is_public(draw):
    parameter = inspect.signature(draw).parameters["ax"]
    assert parameter.default is None and parameter.kind is parameter.KEYWORD_ONLY
    assert getattr(plots, draw.__name__) is draw


def test_the_method_is_the_function_with_the_result():
    record = jb.Record([0.0, 0.1, 0.2], {"x": ([1.0, 2.0, 3.0], "mm")})
    assert record.plot.__func__ is plots.plot_record and list(
        inspect.signature(record.plot).parameters
    ) == ["channels", "ax"]
    assert (
        jb.design.Tuning.plot is plots.plot_tuning and jb.Experiment.plot is plots.plot_measurement
    )
    assert picture_of(type("Own", (LinearSystem,), {})).draw is plots.plot_matrix
    with pytest.raises(AttributeError, match="has no plot"):
        Printed.plot  # noqa: B018
    ax = Figure().subplots()
    assert record.plot(ax=ax) is ax and lines(ax)["x"].get_ydata().tolist() == [0.001, 0.002, 0.003]


# A mass on a spring and damper on a base that moves as a sine


@pytest.fixture(scope="module")
def model():
    spring = jb.Spring(
        ("mass", [0, 0, 0]),
        ("base", [0, -1, 0]),
        stiffness=STIFFNESS,
        damping=DAMPING,
        free_length=1.0,
    )
    return jb.Model(
        bodies={"mass": jb.Body(mass=MASS, inertia=[1, 1, 1])},
        supports={"base": jb.Support()},
        elements={"mount": spring},
        joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    )


@pytest.fixture(scope="module")
def run(model):
    """For 6 s, in which free motions decay by exp(-24)."""
    motion = {"base": jb.Harmonic(frequency=FREQUENCY, translation=[0, AMPLITUDE, 0])}
    return jb.simulate(model, jnp.linspace(0, 6, 1201), motion=motion)


@pytest.fixture(scope="module")
def lin(model):
    return jb.linearize(model, model.reference)


@pytest.mark.long
def test_the_energy_balance_is_flat(run):
    """To the accuracy of a cubic spline through 100 samples a period: (2 pi/100)^4/384 = 4e-8 of
    the energies, and of the integration."""
    ax = plots.plot_energies(run, ax=Figure().subplots())
    *parts, total = ax.lines
    assert [line.get_label() for line in parts] == [
        "kinetic",
        "potential",
        "dissipated",
        "work of the supports",
    ]
    assert total.get_label() == "kinetic + potential + dissipated - work"
    y = {line.get_label(): line.get_ydata() for line in ax.lines}
    assert np.ptp(total.get_ydata()) < 1e-6 * max(np.abs(x).max() for x in y.values())
    np.testing.assert_allclose(
        y["kinetic"], 0.5 * MASS * np.asarray(run.state.v)[:, 0] ** 2, rtol=1e-12, atol=1e-15
    )
    per_cycle = np.diff(np.interp([5.0, 5.5], run.times, y["dissipated"]))[0]
    assert per_cycle == pytest.approx(
        np.pi * DAMPING * 2 * np.pi * FREQUENCY * stroke() ** 2, rel=1e-6
    )
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("time [s]", "energy [J]")


def stroke():
    """Amplitude of the relative motion under a sine of the base: u m w^2/|k - m w^2 + i w c|."""
    w = 2 * np.pi * FREQUENCY
    return AMPLITUDE * MASS * w**2 / abs(STIFFNESS - MASS * w**2 + 1j * w * DAMPING)


@pytest.mark.long
def test_without_damping_and_supports_energy_is_kinetic_and_potential():
    pendulum = jb.presets.elastic_pendulum()
    moved = jb.State(pendulum.reference.q.at[0].add(0.05), pendulum.reference.v)
    free = jb.simulate(pendulum, jnp.linspace(0, 1, 51), initial=moved)
    names = [line.get_label() for line in plots.plot_energies(free, ax=Figure().subplots()).lines]
    assert names == ["kinetic", "potential", "kinetic + potential"]


@pytest.mark.long
def test_a_loop_encloses_what_a_damper_dissipates(run):
    """pi c w X^2 in a cycle; the polygon through n samples of an ellipse is smaller by sin(2
    pi/n)/(2 pi/n)."""
    ax = plots.plot_force_strokes(run, start=5.0, ax=Figure().subplots())
    (loop,) = ax.lines
    e, f = loop.get_xydata().T
    assert len(e) == 201 and loop.get_label() == "mount"
    area = abs(np.sum((f[1:] + f[:-1]) / 2 * np.diff(e))) / 2  # of two cycles
    n = 2 * np.pi / 100
    assert area == pytest.approx(
        np.pi * DAMPING * 2 * np.pi * FREQUENCY * stroke() ** 2 * np.sin(n) / n, rel=1e-6
    )
    assert (ax.get_xlabel(), ax.get_ylabel()) == ("elongation [m]", "force, tension positive [N]")
    with pytest.raises(jb.JaxbodyError, match="NO_DATA"):
        plots.plot_force_strokes(run, start=7.0)
    with pytest.raises(jb.JaxbodyError, match="Known: mount"):
        plots.plot_force_strokes(run, elements=("bolt",))


@pytest.mark.long
def test_a_phase_portrait_shows_rates_over_values(run):
    ax = plots.plot_phases(run, ax=Figure().subplots())
    portrait, start = ax.lines
    np.testing.assert_allclose(
        portrait.get_xydata().T, [np.asarray(run.state.q)[:, 0], np.asarray(run.state.v)[:, 0]]
    )
    assert portrait.get_label() == "mass move along its guide" and start.get_xydata().tolist() == [
        portrait.get_xydata()[0].tolist()
    ]
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_NAME"):
        plots.plot_phases(run, coordinates=("mass turn",))


@pytest.mark.long
def test_a_free_body_has_a_portrait_in_meters_and_one_in_radians():
    """Turning freely by 4 rad about z: the rotation vector goes on beyond half a turn."""
    plate = jb.Model(bodies={"plate": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])})
    start = jb.State(plate.reference.q, jnp.array([0.5, 0, 0, 0, 0, 4.0]))
    with pytest.warns(jb.JaxbodyWarning, match="UNATTACHED"):
        turning = jb.simulate(plate, jnp.linspace(0, 1, 11), initial=start)
    ax = plots.plot_phases(turning, ax=Figure().subplots())
    (below,) = (axes for axes in ax.figure.axes if axes is not ax)
    assert units(ax.figure) == ["m/s", "rad/s"]
    np.testing.assert_allclose(ax.lines[0].get_xdata(), np.linspace(0, 0.5, 11), atol=1e-9)
    np.testing.assert_allclose(
        below.lines[0].get_xydata().T, [np.linspace(0, 4, 11), np.full(11, 4.0)], atol=1e-6
    )


F = np.geomspace(0.5, 20, 30)


@pytest.mark.long
def test_the_dynamic_stiffness_of_a_spring_and_damper(lin):
    outputs = {
        "force": jb.sensors.LoadCell("mount"),
        "stroke": jb.Elongation("mount"),
        "y": jb.Position("mass", axis="y"),
    }
    response = jb.frequency_response(
        lin, F, {"pull": jb.PointForce("mass", direction="y")}, outputs
    )
    ax = plots.plot_dynamic_stiffness(
        response,
        pairs={"mount": ("force", "stroke"), "point": ("pull", "y")},
        ax=Figure().subplots(),
    )
    below = ax.figure.axes[-1]
    w = 2 * np.pi * F
    mount, point = STIFFNESS + 1j * w * DAMPING, STIFFNESS - MASS * w**2 + 1j * w * DAMPING
    for i, exact in enumerate((mount, point)):
        np.testing.assert_allclose(ax.lines[i].get_ydata(), np.abs(exact) / 1e3, rtol=1e-9)
        np.testing.assert_allclose(
            below.lines[i].get_ydata(), np.rad2deg(np.angle(exact)), rtol=1e-9
        )
    assert units(ax.figure) == ["N/mm", "degrees"] and set(lines(ax)) == {"mount", "point"}
    # of all that are m over N
    other = plots.plot_dynamic_stiffness(response, ax=Figure().subplots())
    np.testing.assert_allclose(lines(other)["y"].get_ydata(), np.abs(point) / 1e3, rtol=1e-9)
    with pytest.raises(jb.JaxbodyError, match=r"force \[N\] over pull \[N\].*BAD_UNIT"):
        plots.plot_dynamic_stiffness(response, pairs={"x": ("force", "pull")})
    with pytest.raises(jb.JaxbodyError, match="UNKNOWN_NAME"):
        plots.plot_dynamic_stiffness(response, pairs={"x": ("force", "strok")})


@pytest.mark.long
def test_a_force_opposed_to_the_motion_of_the_base_is_a_positive_stiffness(lin):
    """The mount pulls the base back: F/u = -(...) at low frequency, whose magnitude and sign are
    those of a mass on the mount."""
    response = jb.frequency_response(
        lin, F, {"base": jb.BaseMotion("base", "y")}, {"pull": jb.sensors.LoadCell("mount")}
    )
    ax = plots.plot_dynamic_stiffness(response, ax=Figure().subplots())
    w = 2 * np.pi * F
    k = STIFFNESS + 1j * w * DAMPING
    transfer = k * MASS * w**2 / (k - MASS * w**2)
    np.testing.assert_allclose(ax.lines[0].get_ydata(), np.abs(transfer) / 1e3, rtol=1e-9)
    assert abs(ax.figure.axes[-1].lines[0].get_ydata()[0]) < 5


def test_a_state_space_has_the_response_of_its_system(lin):
    ports = (
        {"push": jb.PointForce("mass", direction="y")},
        {"y": jb.Position("mass", axis="y"), "force": jb.sensors.LoadCell("mount")},
    )
    ax = plots.plot_state_space(lin.state_space(*ports), frequencies=F, ax=Figure().subplots())
    exact = jb.frequency_response(lin, F, *ports)
    np.testing.assert_allclose(lines(ax)["y"].get_ydata(), np.abs(exact["y", "push"]), rtol=1e-9)
    assert units(ax.figure) == ["m per N", "-", "degrees"]


def test_poles_are_frequencies_over_real_parts(lin):
    ax = jb.complex_modes(lin).plot(ax=Figure().subplots())
    (pole,) = [line for line in ax.lines if line.get_label().startswith("1: mass")]
    s = np.roots([MASS, DAMPING, STIFFNESS])[0]
    np.testing.assert_allclose(pole.get_xydata(), [[s.real, abs(s.imag) / (2 * np.pi)]])
    assert "ζ = 0.1" in {text.get_text() for text in ax.texts}


@pytest.mark.long
def test_a_matrix_is_drawn_as_coupling():
    car = jb.presets.half_car()
    lin = jb.linearize(car, car.reference)
    ax = lin.plot(ax=Figure().subplots())
    K = np.asarray(lin.K)
    np.testing.assert_allclose(ax.images[0].get_array()[0, 1], K[0, 1] / np.sqrt(K[0, 0] * K[1, 1]))
    assert f"{K[0, 1] / np.sqrt(K[0, 0] * K[1, 1]):.2f}" in {text.get_text() for text in ax.texts}
    with pytest.raises(jb.JaxbodyError, match="Did you mean"):
        lin.plot(matrix="KK")
    shapes = jb.modes(lin).plot(ax=Figure().subplots()).images[0].get_array()
    np.testing.assert_allclose(np.sum(np.asarray(shapes) ** 2, 0), 1.0)  # M couples nothing here


@pytest.mark.long
def test_backbones_are_drawn_to_five_percent():
    bob = jb.Body(mass=1.0, inertia=[1e-3, 1e-3, 1e-3], com=[0, 0, -0.5])
    pendulum = jb.Model(
        bodies={"bob": bob},
        joints={"bob": jb.Hinge("world", axis=[0, 1, 0])},
        gravity=[0, 0, -9.81],
    )
    ax = jb.vibration.backbone_curves(jb.linearize(pendulum, pendulum.reference)).plot(
        ax=Figure().subplots()
    )
    a, change = ax.lines[0].get_xydata().T
    np.testing.assert_allclose(change, -100 * a**2 / 16, atol=1e-9)
    assert change[-1] == pytest.approx(-5.0) and (ax.get_xlabel(), ax.get_ylabel()) == (
        "amplitude [rad]",
        "change of frequency [%]",
    )


@pytest.mark.long
def test_load_cases_are_drawn_by_unit():
    engine = jb.presets.engine_on_mounts(gravity=9.81)
    cases = jb.load_cases(
        engine,
        {"up": jb.LoadCase(acceleration=[0, 0, 3]), "left": jb.LoadCase(acceleration=[0, 1, 0])},
    )
    ax = cases.plot(ax=Figure().subplots())
    assert units(ax.figure) == ["m", "N", "rad"]
    places = [text.get_text() for text in ax.figure.axes[-1].get_xticklabels()]
    assert places == [f"mount {i} {axis}" for i in (1, 2, 3) for axis in "xyz"]
    forces = lines(ax.figure.axes[1])["up"].get_ydata()
    np.testing.assert_allclose(forces[places.index("mount 2 z")], cases.forces["mount 2"][0, 2])
    bodies = cases.plot(of="bodies", ax=Figure().subplots())
    np.testing.assert_allclose(lines(bodies)["left"].get_ydata(), cases.displacements["engine"][1])
    with pytest.raises(jb.JaxbodyError, match="elements, bodies"):
        cases.plot(of="loads")


def test_spectral_densities_have_a_panel_for_each_unit(lin):
    base, outputs = (
        {"base": jb.BaseMotion("base", "y")},
        {"y": jb.Position("mass", axis="y"), "pull": jb.sensors.LoadCell("mount")},
    )
    ride = jb.random_response(
        lin,
        jb.vibration.Band(0.5, 20.0),
        base,
        outputs,
        {"base": jb.vibration.PSD([0.5, 20.0], [1e-6, 1e-6], unit="m2/Hz")},
    )
    ax = ride.plot(ax=Figure().subplots())
    assert units(ax.figure) == ["m$^2$/Hz", "N$^2$/Hz"]
    np.testing.assert_array_equal(ax.figure.axes[1].lines[0].get_ydata(), ride.psd[1])


@pytest.mark.long
def test_elastic_axes_go_on_the_drawing_of_their_model():
    corners = [[1, 1, -0.2], [1, -1, -0.2], [-1, 1, -0.2], [-1, -1, -0.2]]
    legs = {
        f"leg{i}": jb.Bushing(("box", at), ("world", at), stiffness=[1e4, 2e4, 3e4])
        for i, at in enumerate(corners)
    }
    box = jb.Model(bodies={"box": jb.Body(mass=50.0, inertia=[4, 5, 6])}, elements=legs)
    lin = jb.linearize(box, box.reference)
    ax = jb.vibration.elastic_axes(lin, "box").plot(
        view="xz", ax=box.plot(view="xz", ax=Figure().subplots())
    )
    drawn = lines(ax)
    np.testing.assert_allclose(drawn["center of stiffness"].get_xydata(), [[0, -0.2]], atol=1e-12)
    (x0, z0), (x1, z1) = drawn["axis 1: 4e+04 N/m"].get_xydata()
    assert z0 == pytest.approx(-0.2) and z1 == pytest.approx(-0.2) and abs(x1 - x0) > 0.1
    assert len(drawn["axis 2: 8e+04 N/m"].get_xydata()) == 1  # along y, at the viewer
    with pytest.raises(jb.JaxbodyError, match="BAD_VIEW"):
        jb.vibration.elastic_axes(lin, "box").plot(view="oblique")


@pytest.mark.long
def test_a_batch_is_refused_with_a_remedy(model):
    runs = jax.vmap(
        lambda k: jb.simulate(jb.replace(model, {"mount.stiffness": k}), jnp.linspace(0, 0.1, 5))
    )(jnp.array([700.0, 800.0]))
    for draw in (
        plots.plot_trajectory,
        plots.plot_forces,
        plots.plot_energies,
        plots.plot_phases,
        plots.plot_force_strokes,
    ):
        with pytest.raises(jb.JaxbodyError, match=r"batch of 2.*x\[0\]"):
            draw(runs)
    one = jax.tree.map(lambda x: x[0], runs)
    assert one.plot(ax=Figure().subplots()).get_ylabel() == "displacement [m]"


# Colors

# of two lines of one dash pattern in gray print, L*; of any two colors in CIELAB
LEAST_LIGHTNESS, LEAST_DISTANCE = 12.0, 15.0
# linear RGB seen without one kind of cones (Machado, Oliveira, Fernandes, IEEE TVCG 15 (2009) 1291)
DEFICIENT = {
    "none": np.eye(3),
    "protanopia": [
        [0.152286, 1.052583, -0.204868],
        [0.114503, 0.786281, 0.099216],
        [-0.003882, -0.048116, 1.051998],
    ],
    "deuteranopia": [
        [0.367322, 0.860646, -0.227968],
        [0.280085, 0.672501, 0.047413],
        [-0.011820, 0.042940, 0.968881],
    ],
    "tritanopia": [
        [1.255528, -0.076749, -0.178779],
        [-0.078411, 0.930809, 0.147602],
        [0.004733, 0.691367, 0.303900],
    ],
}
XYZ = np.array(
    [
        [0.4124564, 0.3575761, 0.1804375],
        [0.2126729, 0.7151522, 0.0721750],
        [0.0193339, 0.1191920, 0.9503041],
    ]
)  # of sRGB


def cielab(colors, seen=DEFICIENT["none"]):
    """L*, a*, b* of "#rrggbb" (IEC 61966-2-1 and CIE 15)."""
    rgb = np.array([[int(color[i : i + 2], 16) / 255 for i in (1, 3, 5)] for color in colors])
    linear = (
        np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4) @ np.array(seen).T
    )
    x = np.clip(linear, 0, 1) @ XYZ.T / XYZ.sum(1)
    f = np.where(x > 216 / 24389, np.cbrt(x), (24389 / 27 * x + 16) / 116)
    return np.stack([116 * f[:, 1] - 16, 500 * (f[:, 0] - f[:, 1]), 200 * (f[:, 1] - f[:, 2])], -1)


def least(values):
    """The smallest distance of two rows."""
    apart = np.linalg.norm(values[:, None] - values[None], axis=-1)
    return np.min(apart[~np.eye(len(values), dtype=bool)])


def test_eight_lines_differ_in_gray_print_and_all_are_dark_enough():
    looks = [canvases.style(i) for i in range(8)]
    for dashes in {str(look["ls"]) for look in looks}:
        assert (
            least(cielab([look["color"] for look in looks if str(look["ls"]) == dashes])[:, :1])
            > LEAST_LIGHTNESS
        )
    assert cielab(canvases.COLORS)[:, 0].max() < 77  # on white


@pytest.mark.long
@pytest.mark.parametrize("kind", DEFICIENT)
def test_colors_differ_for_the_color_blind(kind):
    assert least(cielab(canvases.COLORS, DEFICIENT[kind])) > LEAST_DISTANCE
