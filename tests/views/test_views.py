"""What is drawn of a model: lengths, positions and shapes against the model's own numbers, or
against an independent computation."""

import hypothesis.strategies as st
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from random_models import models
from scipy.spatial import Delaunay

import jaxbody as jb
from jaxbody.views.scenes.colors import COLORS
from jaxbody.views.scenes.poses import still
from jaxbody.views.scenes.scenes import animation_of

PRESETS = [
    name for name in dir(jb.presets) if isinstance(getattr(jb.presets, name), type(lambda: 0))
]
L = 0.7


def plate():
    """The paper's plate: gravity along -y."""
    k, L0 = 3.0 * 9.81 / L / L, 2 * 2**0.5 * L - L * 2**0.5 / 2
    ends = {
        "AB": ([-3 * L, L, 0], [-5 * L, 7 * L, 0]),
        "CD": ([3 * L, L, 0], [5 * L, 7 * L, 0]),
        "EF": ([0, -L, 0], [0, L, 0]),
    }
    springs = {
        name: jb.Spring(
            ("plate", a),
            ("base", b),
            stiffness=k,
            free_length=2 * L if name == "EF" else L0,
            damping=1.0,
        )
        for name, (a, b) in ends.items()
    }
    return jb.Model(
        bodies={"plate": jb.Body(mass=3.0, inertia=[0.3, 0.9, 1.2])},
        supports={"base": jb.Support(position=[0, -4 * L, 0])},
        elements=springs,
        gravity=[0, -9.81, 0],
    )


SHAKEN = {"base": jb.Harmonic(frequency=0.8, translation=[0.1, 0, 0], rotation=[0, 0, 0.1])}


@pytest.fixture(scope="module")
def motion():
    return jb.simulate(plate(), jnp.linspace(0.0, 3.0, 76), motion=SHAKEN)


@pytest.fixture(scope="module")
def seen(motion):
    return jb.view(motion, trails={"corner": ("plate", [3 * L, L, 0])}, forces=True)


def length_as_drawn(part):
    """The extent of each frame's drawn mesh along the line that its ends make, from its vertices in
    world axes."""
    placed = np.stack([part.at(i).vertices for i in range(len(part.p))])
    ends = placed[:, [-2, -1]]  # the middles of the two caps of a wire
    return np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1)


def _place(motion, frame, point):
    """World positions (n, 3) of a point of a frame."""
    pose = motion.poses[frame]
    return np.asarray(pose.p) + np.asarray(pose.R) @ np.asarray(point)


@pytest.mark.long
def test_every_spring_is_drawn_with_the_length_of_the_model_in_every_frame(motion, seen):
    assert len(seen.animation.seconds) == 75  # 3 s, 25 frames per second
    times = seen.animation.seconds
    rows = [int(np.argmin(np.abs(np.asarray(motion.times) - t))) for t in times]
    for name, elongation in motion.elongations.items():
        expected = np.asarray(elongation)[rows] + float(motion.model[name].free_length)
        drawn = length_as_drawn(seen.animation.part("elements", name, "coil"))
        assert np.ptp(expected) > 0.05
        np.testing.assert_allclose(drawn, expected, rtol=0, atol=1e-6)


@pytest.mark.long
def test_springs_dampers_and_points_meet_the_bodies_that_move(motion, seen):
    """Ends by the poses that the trajectory itself states."""
    rows = [int(np.argmin(np.abs(np.asarray(motion.times) - t))) for t in seen.animation.seconds]
    for name in motion.model.element_names:
        element = motion.model[name]
        at = [
            _place(motion, frame, x)[rows]
            for frame, x in zip(element.between, element.points, strict=True)
        ]
        coil = seen.animation.part("elements", name, "coil")
        placed = np.stack([coil.at(i).vertices[[-2, -1]] for i in range(len(coil.p))])
        np.testing.assert_allclose(placed, np.stack(at, 1), atol=1e-9)
        for piece, end in (("piston", at[0]), ("damper", at[1])):
            np.testing.assert_allclose(
                seen.animation.part("elements", name, piece).p, end, atol=1e-9
            )
    corner = _place(motion, "plate", np.array([3 * L, L, 0]))[rows]
    np.testing.assert_allclose(seen.animation.trails[0].points, corner, atol=1e-9)


@pytest.mark.long
def test_arrows_have_the_forces_of_the_trajectory_to_one_scale(motion, seen):
    rows = [int(np.argmin(np.abs(np.asarray(motion.times) - t))) for t in seen.animation.seconds]
    drawn = {
        name: seen.animation.part("forces", name, "on plate").scale[:, 2] for name in motion.forces
    }
    expected = {name: np.abs(np.asarray(force))[rows] for name, force in motion.forces.items()}
    scale = max(map(np.max, drawn.values())) / max(map(np.max, expected.values()))
    for name, length in drawn.items():
        np.testing.assert_allclose(length, scale * expected[name], atol=1e-9)
    assert f"{max(map(np.max, expected.values())):.3g} N" in repr(seen)
    element = motion.model["AB"]  # in tension it pulls the plate towards its other end
    i = int(np.argmax(np.asarray(motion.forces["AB"])[rows]))
    pull = seen.animation.part("forces", "AB", "on plate").R[i, :, 2]
    towards = (_place(motion, "base", element.b) - _place(motion, "plate", element.a))[rows[i]]
    np.testing.assert_allclose(pull, towards / np.linalg.norm(towards), atol=1e-9)


def points_by_frame(model):
    """{frame: points of its elements and centers of mass}, gathered here from the
    elements themselves."""
    points = {name: [np.asarray(model[name].com)] for name in model.layout.bodies}
    for name in model.element_names:
        for frame, point in zip(model[name].between, model[name].points, strict=True):
            points.setdefault(frame, []).append(np.asarray(point))
    return points


def check_drawn(model):
    """Each body's points lie inside its shape; each line element has the distance of its ends."""
    animation = animation_of(still(model))
    size = animation.size
    tyres = {
        model[name].between[0]: model[name]
        for name in model.element_names
        if isinstance(model[name], jb.Tyre)
    }
    for body, points in points_by_frame(model).items():
        if body not in model.layout.bodies:
            continue
        solids = [
            part
            for part in animation.parts
            if part.path[:2] == ("bodies", body) and part.path[2] in ("solid", "hub")
        ]
        assert len(solids) == 1
        vertices = solids[0].mesh.vertices
        assert np.isfinite(vertices).all()
        if solids[0].path[2] == "hub":
            assert (
                np.linalg.norm(np.array(points) - np.asarray(tyres[body].a), axis=-1)
                < 1.2 * float(tyres[body].radius)
            ).all()
        else:
            scale = np.ptp(vertices, axis=0).max()
            inside = Delaunay(vertices / scale, qhull_options="QJ").find_simplex(
                np.array(points) / scale, tol=1e-9
            )
            assert (inside >= 0).all()
    poses = {name: pose for name, pose in zip(model.layout.frames, _poses(model), strict=True)}
    for name in model.element_names:
        element = model[name]
        coils = [part for part in animation.parts if part.path == ("elements", name, "coil")]
        if coils:
            a, b = (
                p + R @ np.asarray(x)
                for (p, R), x in zip(
                    (poses[f] for f in element.between), element.points, strict=True
                )
            )
            assert abs(coils[0].scale[0, 2] - np.linalg.norm(b - a)) <= 1e-6 * max(size, 1.0)
    for part in animation.parts:
        R = part.R
        np.testing.assert_allclose(
            R @ np.swapaxes(R, -1, -2), np.broadcast_to(np.eye(3), R.shape), atol=1e-6
        )
        assert (np.linalg.det(R) > 0).all()
    return animation


def _poses(model):
    """(p, R) of all frames in the reference pose, from the positions and orientations that the
    model was given."""
    from scipy.spatial.transform import Rotation

    yield np.zeros(3), np.eye(3)
    for name in (*model.layout.supports, *model.layout.bodies):
        q = np.asarray(model[name].orientation)
        yield np.asarray(model[name].position), Rotation.from_quat(q[[1, 2, 3, 0]]).as_matrix()


@pytest.mark.long
@pytest.mark.parametrize("name", PRESETS)
def test_ready_models_are_drawn(name):
    model = getattr(jb.presets, name)()
    animation = check_drawn(model)
    assert {part.path[1] for part in animation.parts if part.path[0] == "bodies"} == set(
        model.layout.bodies
    )
    assert {
        part.path[1] for part in animation.parts if part.path[0] in ("elements", "tyres")
    } == set(model.element_names)


def check_random_models(count):
    built = 0

    @settings(
        max_examples=count,
        deadline=None,
        derandomize=True,
        database=None,
        suppress_health_check=list(HealthCheck),
    )
    @given(models(st.floats(-10, 10)))
    def check(parts):
        nonlocal built
        try:
            model = jb.Model(**parts)
        except jb.JaxbodyError:
            return
        built += 1
        check_drawn(model)

    check()
    return built


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_random_models_of_every_kind_are_drawn():
    assert check_random_models(40) >= 30


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_a_hundred_random_models_are_drawn():
    assert check_random_models(150) >= 100


# Modes, roads, several side by side


@pytest.mark.long
def test_a_mode_swings_about_the_state_with_its_amplitude_and_phase():
    model = jb.presets.half_car()
    rest = jb.equilibrium(model)
    modes = jb.modes(jb.linearize(model, rest))
    seen = jb.view(modes, number=2, at=rest, amplitude=0.05, phase=np.pi / 2).animation
    body = seen.part("bodies", "body", "solid")
    at_rest = np.asarray(rest.state.q)[0] + float(model["body"].position[2])
    assert body.p[0, 2] == pytest.approx(at_rest, abs=1e-9)  # phase 90 degrees: at the middle
    heave, pitch = np.asarray(modes.shapes)[:, 1]
    ends = [np.array([x, 0, 0]) for x in (1.0, -1.5)]
    largest = max(
        np.linalg.norm(end - moved)
        for end in ends
        for moved in [_moved(body, end, i) - _rest(body, at_rest) for i in range(40)]
    )
    assert largest == pytest.approx(0.05, rel=0.02)  # to first order in the turn
    turned = np.arctan2(body.R[:, 0, 2], body.R[:, 0, 0])
    np.testing.assert_allclose((body.p[:, 2] - at_rest) * pitch, turned * heave, atol=1e-9)
    np.testing.assert_allclose(turned + np.roll(turned, 20), 0.0, atol=1e-9)
    assert "mode 2" in seen.title and f"{float(modes.frequency[1]):.4g} Hz" in seen.title


def _moved(part, point, i):
    return part.p[i] + part.R[i] @ point


def _rest(part, height):
    return np.array([part.p[0, 0], part.p[0, 1], height])


def test_complex_modes_move_with_their_phases():
    car = jb.presets.quarter_car(damping=3000.0)
    modes = jb.complex_modes(jb.linearize(car, car.reference))
    seen = jb.view(modes, number=1).animation
    z = np.stack([seen.part("bodies", name, "solid").p[:, 2] for name in ("body", "wheel")], 1)
    amplitudes = np.fft.rfft(z, axis=0)[1]
    shape = np.asarray(modes.shapes)[:, 0]
    assert amplitudes[1] / amplitudes[0] == pytest.approx(shape[1] / shape[0], rel=1e-6)


def test_a_mode_that_does_not_exist_is_named():
    car = jb.presets.quarter_car()
    modes = jb.modes(jb.linearize(car, car.reference))
    with pytest.raises(jb.JaxbodyError, match=r"is 3; there are modes 1 to 2.*UNKNOWN_MODE"):
        jb.view(modes, number=[1, 3])


def test_joints_of_several_lines_are_drawn_along_them():
    at = [0.2, 0.1, 0.0]
    joints = {
        "puck": jb.joints.Planar("world", first="x", second="y"),
        "yoke": jb.joints.Universal("puck", first="x", second="z", at=at),
        "shaft": jb.joints.Cylindrical("yoke", axis="z", at=at),
    }
    parts = jb.view(
        jb.Model(
            bodies=dict.fromkeys(joints, jb.Body(1.0, [1, 1, 1], com=[0, 0, 0.5])), joints=joints
        )
    ).animation.parts
    drawn = {
        part.path[1:]: (part.p[0], part.R[0, :, 2]) for part in parts if part.path[0] == "joints"
    }
    lines = {
        "puck": [[1, 0, 0], [0, 1, 0], [0, 0, 1]],
        "yoke": [[1, 0, 0], [0, 0, 1]],
        "shaft": [[0, 0, 1]] * 2,
    }
    for name, directions in lines.items():
        for i, n in enumerate(directions):
            p, axis = drawn[name, str(i + 1)]
            np.testing.assert_allclose(p, [0, 0, 0] if name == "puck" else at, atol=1e-15)
            np.testing.assert_allclose(np.abs(axis), n, atol=1e-15)


@pytest.fixture(scope="module")
def driven():
    car = jb.Model(
        bodies={
            "car": jb.Body(300.0, [1, 1, 1], position=[0, 0, 0.7]),
            "wheel": jb.Body(30.0, [1, 1, 1], position=[0, 0, 0.3]),
        },
        supports={"road": jb.Support()},
        joints={name: jb.Guide("world", axis=[0, 0, 1]) for name in ("car", "wheel")},
        elements={
            "strut": jb.SpringDamper(
                ("car", [0, 0, 0]), ("wheel", [0, 0, 0]), spring=2e4, damper=1e3, free_length=0.55
            ),
            "tyre": jb.Tyre("wheel", "road", stiffness=2e5, radius=0.32),
        },
        gravity=[0, 0, -9.81],
    )
    road = jb.inputs.Road([0.0, 5.0, 5.5, 20.0], [0.0, 0.0, 0.08, 0.08], speed=8.0, position=1.0)
    return jb.simulate(
        car, jnp.linspace(0.0, 2.0, 101), motion={"road": road}, initial=jb.equilibrium(car).state
    ), road


@pytest.mark.long
def test_a_road_passes_under_its_wheel(driven):
    run, road = driven
    animation = jb.view(run).animation
    surface, tyre = (
        animation.part("roads", "tyre", "surface"),
        animation.part("tyres", "tyre", "tyre"),
    )
    for i in (0, 10, 30, len(animation.seconds) - 1):
        t = animation.seconds[i]
        top = surface.at(i).vertices
        top = top[np.abs(top[:, 1] - top[:, 1].max()) < 1e-9]
        top = top[top[:, 2] > -1e-6]
        top = top[np.argsort(top[:, 0])]
        height = np.interp(0.0, top[:, 0], top[:, 2])
        assert height == pytest.approx(float(road(jnp.asarray(t))[2]), abs=1e-6)
        assert np.linalg.norm(
            tyre.at(i).vertices[:, [0, 2]] - tyre.p[i][[0, 2]], axis=1
        ).max() == pytest.approx(0.32, abs=1e-9)
    turned = np.unwrap(np.arctan2(tyre.R[:, 0, 0], tyre.R[:, 2, 0]))
    # forwards: the top of the wheel runs ahead
    np.testing.assert_allclose(turned - turned[0], 8.0 / 0.32 * animation.seconds, atol=1e-6)


def test_designs_stand_side_by_side(motion):
    still, moving = plate(), motion
    view = jb.view({"before": still, "after": moving})
    boxes = {}
    for part in view.animation.parts:
        if part.path[0] in ("before", "after") and part.framed:
            boxes.setdefault(part.path[0], []).append(part.at(0).vertices)
    right = view.animation.right
    assert max((x @ right).max() for x in boxes["before"]) < min(
        (x @ right).min() for x in boxes["after"]
    )
    assert [label.text for label in view.animation.labels if label.kind == "title"] == [
        "before",
        "after",
    ]
    assert len(view.animation.seconds) == 75 and "75 frames" in repr(view)


def test_motions_side_by_side_are_shown_at_the_same_times(motion):
    import dataclasses

    rows = np.r_[0:76:5]
    coarse = dataclasses.replace(
        motion, times=motion.times[rows], state=jb.State(motion.state.q[rows], motion.state.v[rows])
    )
    animation = jb.view({"coarse": coarse, "fine": motion}).animation
    assert len(animation.seconds) == 75
    lengths = [
        animation.part(group, "elements", "AB", "coil").scale[:, 2] for group in ("coarse", "fine")
    ]
    before = np.searchsorted(np.asarray(coarse.times), animation.seconds + 1e-9, side="right") - 1
    expected = np.asarray(coarse.elongations["AB"])[before] + float(motion.model["AB"].free_length)
    np.testing.assert_allclose(lengths[0], expected, atol=1e-6)
    assert len(lengths[1]) == 75 and np.ptp(lengths[0] - lengths[1]) > 1e-3


def test_trails_and_names_of_a_model_at_rest_are_written(tmp_path):
    view = jb.view(plate(), trails=["plate"], names=False)
    assert (
        view.save(tmp_path / "plate.html").stat().st_size > 5e5
        and view.save(tmp_path / "plate.png", width=200).exists()
    )


def test_a_tuning_shows_the_model_before_and_after():
    car = jb.presets.half_car(front_damping=1000.0, rear_damping=1000.0)
    place = {"front spring.a": (np.array([0.6, -0.1, -0.1]), np.array([1.4, 0.1, 0.1]))}
    tuned = jb.tune(
        car,
        lambda m: {"arm": (m["front spring"].a[0] - 1.3) ** 2},
        free=["front spring.a"],
        bounds=place,
        minimize="arm",
    )
    view = jb.view(tuned)
    ends = [
        view.animation.part(group, "elements", "front spring", "coil").p[0]
        for group in ("before", "after")
    ]
    assert (ends[1] - ends[0]) @ view.animation.right > 0.3


@pytest.mark.long
@pytest.mark.parametrize(
    "seconds, speed, played",
    [(0.05, 0.01, 5.0), (1.5, 0.2, 7.5), (10.0, 1.0, 10.0), (600.0, 10.0, 60.0)],
)
def test_short_motions_are_slowed_and_long_ones_quickened(seconds, speed, played):
    """The pendulum is not integrated for this: its motion is stretched in time."""
    import dataclasses

    pendulum = jb.presets.elastic_pendulum()
    run = jb.simulate(pendulum, jnp.linspace(0.0, 0.05, 3))
    view = jb.view(dataclasses.replace(run, times=run.times * seconds / 0.05))
    assert view.speed == speed and float(view.animation.seconds[-1]) == pytest.approx(played)


@pytest.mark.nan
def test_a_motion_that_failed_is_shown_until_then(motion):
    import dataclasses

    broken = dataclasses.replace(
        motion, state=jb.State(motion.state.q.at[40:].set(jnp.nan), motion.state.v)
    )
    assert float(jb.view(broken, speed=1.0).animation.seconds[-1]) == pytest.approx(
        float(motion.times[39])
    )
    with pytest.raises(jb.JaxbodyError, match="NONFINITE"):
        jb.view(
            dataclasses.replace(motion, state=jb.State(motion.state.q * jnp.nan, motion.state.v))
        )


def test_what_cannot_be_viewed_is_named_all_at_once():
    trimesh, model = pytest.importorskip("trimesh"), plate()
    with pytest.raises(jb.JaxbodyError) as error:
        shapes = {"plat": trimesh.creation.box([1, 1, 1]), "plate": 3.0}
        jb.view(
            model, shapes=shapes, trails=["corner"], amplitude=-1.0, speed=0.0, direction=[0, 0, 0]
        )
    assert [p.code for p in error.value.problems] == [
        "UNKNOWN_NAME", "WRONG_KIND", "UNKNOWN_NAME", "ZERO_AXIS", "BAD_NUMBER", "BAD_NUMBER"
    ]  # fmt: skip
    for what, code in ((3.0, "WRONG_KIND"), ({}, "NO_DATA"), ({"a": 3.0}, "WRONG_KIND")):
        with pytest.raises(jb.JaxbodyError, match=code):
            jb.view(what)


@pytest.mark.long
def test_colors_are_those_of_the_plots_and_up_is_against_gravity():
    view = jb.view(plate())
    assert view.animation.part("bodies", "plate", "solid").color == COLORS[0]
    np.testing.assert_allclose(view.animation.up, [0, 1, 0])
    np.testing.assert_allclose(view.animation.right, [1, 0, 0], atol=1e-12)
    assert (view.camera.position - view.camera.target)[2] > 0
    outline, _ = view.camera.project(view.animation.outline())
    assert np.isfinite(outline).all() and np.abs(outline[:, 1]).max() < np.tan(np.deg2rad(14))


def mount_gaps(view, model):
    """{mount: largest distance of the drawn pin from where it was at rest on the rubber ring}."""
    gaps = {}
    for name in model.element_names:
        pin, rubber = (view.animation.part("elements", name, word) for word in ("pin", "rubber"))
        at_rest = _place_at_rest(model, name)
        gaps[name] = np.linalg.norm(pin.p - rubber.p - at_rest, axis=-1).max()
    return gaps


def _place_at_rest(model, name):
    mount = model[name]
    places = [
        np.asarray(model[frame].position) + np.asarray(point)
        if frame != "world"
        else np.asarray(point)
        for frame, point in zip(mount.between, mount.points, strict=True)
    ]
    return places[0] - places[1]


def test_a_drawn_mode_keeps_bushings_together():
    """Every pin stays within its rubber ring, whose radius is read from the drawn ring, and one
    comes near its edge; a given amplitude is drawn as it is."""
    model = jb.presets.engine_on_mounts()
    modes = jb.modes(jb.linearize(model, model.reference))
    for number in range(1, 7):
        view = jb.view(modes, number=number)
        ring = np.abs(
            view.animation.part("elements", "mount 1", "rubber").mesh.vertices[:, :2]
        ).max()
        gaps = mount_gaps(view, model)
        assert 0.7 * ring < max(gaps.values()) < 0.9 * ring
        limited = max(gaps, key=gaps.get)
        assert f"limited by {limited}" in view.animation.caption
    torn = jb.view(modes, number=1, amplitude=0.1)
    assert max(mount_gaps(torn, model).values()) > 2 * ring
    assert "largest displacement 0.1 m" in torn.animation.caption


def test_a_motion_is_magnified_from_its_first_sample(motion):
    """The displacement of the plate is three times that of the trajectory, supports included, and
    springs still end on their bodies."""
    view = jb.view(motion, magnify=3.0)
    rows = [int(np.argmin(np.abs(np.asarray(motion.times) - t))) for t in view.animation.seconds]
    real = np.asarray(motion.poses["plate"].p)
    drawn = view.animation.part("bodies", "plate", "solid")
    np.testing.assert_allclose(drawn.p - real[0], 3 * (real[rows] - real[0]), atol=1e-9)
    turned = np.arctan2(drawn.R[:, 1, 0], drawn.R[:, 0, 0])
    R = np.asarray(motion.poses["plate"].R)[rows]
    np.testing.assert_allclose(turned, 3 * np.arctan2(R[:, 1, 0], R[:, 0, 0]), atol=1e-9)
    base = view.animation.part("supports", "base", "board").p
    moved = np.asarray(motion.poses["base"].p)[rows] - np.array([0, -4 * L, 0])
    np.testing.assert_allclose(base, np.array([0, -4 * L, 0]) + 3 * moved, atol=1e-9)
    coil = view.animation.part("elements", "AB", "coil")
    np.testing.assert_allclose(coil.p, drawn.p + drawn.R @ [-3 * L, L, 0], atol=1e-9)
    assert "displacements magnified 3 times" in view.animation.caption


def test_names_are_below_what_they_name():
    """So that a browser hides both together."""
    for name in ("full_car", "engine_on_mounts"):
        animation = jb.view(getattr(jb.presets, name)()).animation
        drawn = {part.path[:2] for part in animation.parts}
        assert {label.path[:2] for label in animation.labels} <= drawn | {("supports", "frame")}
