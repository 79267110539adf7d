"""Drawn models: labels do not overlap, tyres are round, the drawing fills the frame, and oblique
views have no axis numbers."""

import itertools
import time

import numpy as np
import pytest
from matplotlib.figure import Figure
from matplotlib.text import Text
from pictures import has_color, pixels_at
from test_plots import nothing_else_is_touched  # noqa: F401

import jaxbody as jb
from jaxbody import plots
from jaxbody.views.scenes.colors import GRAY, INK
from jaxbody.views.scenes.element_parts import BAR, STEEL

CORNERS = {"fl": (1.2, 0.75), "fr": (1.2, -0.75), "rl": (-1.4, 0.75), "rr": (-1.4, -0.75)}


@pytest.fixture
def figure():
    return Figure(figsize=(6.4, 3.2), layout="constrained")


@pytest.fixture(scope="module")
def on_tyres():
    bodies = {"car": jb.Body(mass=1000.0, inertia=[400, 1400, 1500], position=[0, 0, 0.6])}
    bodies |= {
        name: jb.Body(mass=40.0, inertia=[1, 1, 1], position=[x, y, 0.3])
        for name, (x, y) in CORNERS.items()
    }
    joints = {"car": jb.joints.HeavePitchRoll("world")} | dict.fromkeys(
        CORNERS, jb.Guide("world", axis=[0, 0, 1])
    )
    elements = {}
    for name, (x, y) in CORNERS.items():
        elements[f"tyre {name}"] = jb.Tyre(
            (name, [0, 0, 0]), ("road", [x, y, 0]), stiffness=2e5, radius=0.31
        )
        elements[f"spring {name}"] = jb.Spring(
            ("car", [x, y, 0.1]), (name, [0, 0, 0]), stiffness=2e4, free_length=0.4
        )
    return jb.Model(
        bodies=bodies,
        supports={"road": jb.Support()},
        joints=joints,
        elements=elements,
        gravity=[0, 0, -9.81],
    )


@pytest.mark.long
@pytest.mark.parametrize(
    "preset", ["full_car", "half_car", "engine_on_mounts", "stewart_table", "isolated_table"]
)
def test_names_do_not_overprint(figure, preset):
    model = getattr(jb.presets, preset)()
    ax = plots.draw_model(model, ax=figure.subplots())
    figure.canvas.draw()
    named = [
        text for text in ax.texts if text.get_text() in (*model.layout.bodies, *model.element_names)
    ]
    assert len(named) == len(model.layout.bodies) + len(model.element_names)
    boxes = {}
    for text in named:
        text.get_window_extent()  # places it, and returns the box of the line that leads to it, too
        boxes[text.get_text()] = Text.get_window_extent(text)
    for (one, box), (other, beside) in itertools.combinations(boxes.items(), 2):
        assert not box.overlaps(beside), (one, other)


def test_a_name_stays_near_what_it_names(figure):
    ax = plots.draw_model(jb.presets.full_car(), ax=figure.subplots())
    far = {
        text.get_text(): np.hypot(*text.get_position())
        for text in ax.texts
        if hasattr(text, "xyann")
    }
    assert max(far.values()) < 72  # points


def test_tyres_are_round_with_their_radius(figure, on_tyres):
    ax = plots.draw_model(on_tyres, view="xz", names=False, ax=figure.subplots())
    for x, _ in CORNERS.values():
        for angle in np.deg2rad([-150, -90, -30]):  # below the car
            rim = np.array([np.cos(angle), np.sin(angle)])
            assert has_color(ax, [x, 0.3] + 0.30 * rim, INK)
            assert not has_color(ax, [x, 0.3] + 0.32 * rim, INK)
    above = plots.draw_model(on_tyres, view="xy", names=False, ax=Figure().subplots())
    assert (above.get_xlabel(), above.get_ylabel()) == ("x [m]", "y [m]")
    for y, seen in ((0.80, True), (1.0, False)):  # the car covers the rest of the wheel
        assert has_color(above, (1.2 + 0.28, y), INK) is seen


def test_an_oblique_view_has_its_axes_and_a_length_in_place_of_ticks(figure):
    """The axes have the scale of the picture: the wheels are 2.6 m apart along x."""
    ax = plots.draw_model(jb.presets.full_car(), ax=figure.subplots())
    assert not ax.axison and ax.get_xlabel() == ""
    axes = {
        line.get_gid(): np.diff(line.get_xydata(), axis=0)[0]
        for line in ax.lines
        if (line.get_gid() or "").startswith("axis")
    }
    (length,) = [
        float(text.get_text().removesuffix(" m"))
        for text in ax.texts
        if text.get_text().endswith(" m")
    ]
    wheels = {text.get_text(): np.array(text.xy) for text in ax.texts if hasattr(text, "xy")}
    np.testing.assert_allclose(
        wheels["fl"] - wheels["rl"], 2.6 / length * axes["axis x"], atol=1e-12
    )
    # of a parallel projection: both rows of the three drawn axes have the length of an axis
    look = np.stack([axes[f"axis {name}"] for name in "xyz"], -1) / length
    np.testing.assert_allclose(look @ look.T, np.eye(2), atol=1e-12)


@pytest.mark.parametrize("view", ["xz", None])
def test_the_frame_is_filled(figure, view):
    """What is drawn takes four fifths of the longer side and more than half of the other."""
    ax = plots.draw_model(jb.presets.full_car(), view=view, ax=figure.subplots())
    figure.canvas.draw()
    sides = np.array([np.ptp(ax.get_xlim()), np.ptp(ax.get_ylim())])
    shares = np.ptp(ax.dataLim.get_points(), axis=0) / sides
    assert shares.max() > 0.8 and shares.min() > 0.5
    box = ax.get_window_extent()
    # one scale for both
    assert box.height / box.width == pytest.approx(sides[1] / sides[0], rel=1e-6)


def test_a_joint_that_moves_along_axes_has_no_pivot_on_the_ground(figure):
    """A car on its heave, pitch and roll: nothing is below its middle, a foot below each spring."""
    model = jb.presets.half_car()
    ax = plots.draw_model(model, names=False, ax=figure.subplots())
    for x in np.linspace(-1.2, 0.7, 20):
        assert not pixels_at(ax, (x, -0.02))[:, 3].any()
    assert has_color(ax, (1.0, -0.01), GRAY) and has_color(ax, (-1.5, -0.01), GRAY)
    coil = [has_color(ax, (1.0 + x, 0.3), STEEL) for x in np.linspace(-0.1, 0.1, 41)]
    assert any(coil) and not coil[0] and not coil[-1]


def test_a_rod_of_a_loop_is_drawn_between_its_ends(figure):
    bar = jb.Body(mass=0.5, inertia=[1e-3, 2e-3, 2e-3])
    model = jb.Model(
        bodies={"left": bar, "right": bar},
        joints={
            "left": jb.Hinge("world", axis="z"),
            "right": jb.Hinge("world", axis="z", at=[0.5, 0, 0]),
        },
        closures={"rod": jb.closures.Rod(("left", [0, 0.2, 0]), ("right", [0.5, 0.3, 0]))},
        gravity=[0, -9.81, 0],
    )
    ax = plots.draw_model(model, view="xy", names=False, ax=figure.subplots())
    for share in (0.2, 0.5, 0.8):
        point = np.array([0.5 * share, 0.2 + 0.1 * share])
        assert has_color(ax, point, BAR)
        assert not has_color(ax, point - np.array([0, 0.03]), BAR)


@pytest.mark.long
def test_names_of_hundreds_of_springs_take_seconds(figure):
    """20 bodies on 200 springs: 15 s of the processor when every label looked at everything that
    is drawn."""
    rng = np.random.default_rng(0)
    bodies = {
        f"b{i}": jb.Body(1.0, [0.1, 0.1, 0.1], position=p)
        for i, p in enumerate(rng.uniform(-1, 1, (20, 3)))
    }
    pairs = [rng.choice(20, 2, replace=False) for _ in range(200)]
    ends = [
        ((f"b{a}", rng.uniform(-0.1, 0.1, 3)), (f"b{b}", rng.uniform(-0.1, 0.1, 3)))
        for a, b in pairs
    ]
    springs = {
        f"s{i}": jb.Spring(*each, stiffness=10.0, free_length=0.5) for i, each in enumerate(ends)
    }
    model = jb.Model(bodies=bodies, elements=springs)
    plots.draw_model(model, names=False, ax=figure.subplots())
    before = time.process_time()
    ax = plots.draw_model(model, ax=figure.add_subplot())
    assert len(ax.texts) >= 220 and time.process_time() - before < 6
