"""The full car on four double wishbones: loads by statics, frequencies against a plain car of the
same wheel rates, symmetry, curves."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg
from test_presets import full_car_matrices

import jaxbody as jb
from jaxbody import presets
from jaxbody.mechanics.constraints import how_open
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.suspension.suspensions import DOUBLE_WISHBONE

G = 9.81
WHEELS = ("fl", "fr", "rl", "rr")
MIRROR = np.array([1.0, -1, 1])
# case 2.4, dz = 0: of a spring of 30 kN/m with 4000 N
MOTION_RATIO, WHEEL_RATE = -0.546021078, 10128.077


@pytest.fixture(scope="module")
def car():
    return presets.full_car_on_double_wishbones()


@pytest.fixture(scope="module")
def eq(car):
    return jb.equilibrium(car)


@pytest.mark.long
def test_it_has_the_parts_of_a_car(car):
    assert len(car.layout.bodies) == 14 and car.layout.nv == 24
    assert len(car.independent) == 8  # heave, pitch, roll, four wheels, the rack
    assert float(how_open(Coordinates(car), car.reference.q)) < 1e-15
    for name in car.layout.bodies[1:]:
        if name[1] == "l":
            right = name[0] + "r" + name[2:]
            np.testing.assert_array_equal(car[right].com, car[name].com * MIRROR)
    for name in ("upper ball", "tie rod"):
        np.testing.assert_array_equal(car[f"fr {name}"].b, car[f"fl {name}"].b * MIRROR)
    higher = presets.full_car_on_double_wishbones(front_points={"tie rod inner": [0.05, 0.2, 0.26]})
    np.testing.assert_allclose(higher["fr tie rod"].a, [0.05, -0.2, 0.26], atol=1e-15)
    with pytest.raises(
        jb.JaxbodyError, match=r"car_on_double_wishbones.rear_points\['tie rod'\].*UNKNOWN_NAME"
    ):
        presets.full_car_on_double_wishbones(rear_points={"tie rod": [0, 0, 0]})


@pytest.mark.long
def test_the_reference_pose_is_the_equilibrium_and_the_wheels_carry_the_weight(car, eq):
    """Loads by the moments of all weights about the axles; bars are relaxed, and no force is on
    the rack."""
    assert eq.ok and bool(eq.stable)
    np.testing.assert_allclose(eq.state.q, car.reference.q, atol=1e-12)
    assert np.abs(np.asarray(eq.residual)).max() < 1e-9  # N, of weights of 12 kN
    masses = np.array([float(car[name].mass) for name in car.layout.bodies])
    x = np.array([float(car[name].position[0] + car[name].com[0]) for name in car.layout.bodies])
    front, rear = 1.2 - 0.02, -1.4 - 0.02  # of the wheel centers
    on_front = G * masses @ (x - rear) / (front - rear) / 2
    on_rear = G * masses @ (front - x) / (front - rear) / 2
    for name, load in zip(WHEELS, (on_front, on_front, on_rear, on_rear), strict=True):
        assert float(eq.forces[f"tyre {name}"]) == pytest.approx(-load, rel=1e-12)
        assert float(eq.reactions[f"road {name}"][0][2]) == pytest.approx(-load, rel=1e-12)
    assert (
        abs(float(eq.forces["bar front"])) < 1e-9
        and np.abs(np.asarray(eq.forces["steering"])).max() < 1e-9
    )
    for left, right in (("fl", "fr"), ("rl", "rr")):
        assert float(eq.forces[f"spring {left}"]) == pytest.approx(
            float(eq.forces[f"spring {right}"]), rel=1e-10
        )


@pytest.mark.long
def test_its_modes_are_those_of_a_plain_car_of_the_same_wheel_rates(car, eq):
    """Heave, pitch, roll and the four wheels by M and K of seven coordinates, written out by hand.
    Wheel rates are k r^2 + F times the curvature of case 2.4; to the sprung and unsprung masses the
    arms add what moves with each (half of 4 kg, and the inertia about the hinge), and the wheels,
    which the car takes along sideways in roll, 0.2 m below its axis, 4 m 0.2^2. Left out are the
    slope of the paths of the wheels (0.02), the weights of the arms, and the moments of inertia of
    uprights: each below 1 %."""
    curvature = (WHEEL_RATE - 30e3 * MOTION_RATIO**2) / 4000
    springs = [(70e3, -float(eq.forces["spring fl"])), (75e3, -float(eq.forces["spring rl"]))]
    rates = [k * MOTION_RATIO**2 + F * curvature for k, F in springs]
    carried = 8 * 2.5
    M, _, K, _ = full_car_matrices(
        mass=1100 + carried,
        inertia=(450 + carried * 0.5**2 + 4 * 30 * 0.2**2, 1500 + carried * 1.3**2),
        front=1.18,
        rear=1.42,
        track=1.9,
        mu=(32 + 2.5, 27 + 2.5),
        k=rates,
    )
    plain = np.sqrt(scipy.linalg.eigh(K, M, eigvals_only=True)) / (2 * np.pi)
    modes = jb.modes(jb.linearize(car, eq))
    np.testing.assert_allclose(modes.frequency[:7], plain, rtol=1e-2)
    assert [name.split()[0] for name in modes.names[:3]] == ["car"] * 3
    assert (
        "bounce" in modes.names[0] and "about y" in modes.names[1] and "about x" in modes.names[2]
    )
    # modes are symmetric or antisymmetric: heave and pitch have no roll, roll has neither
    for number in (0, 1, 2):
        shape = (
            np.abs(np.asarray(modes.shapes[:3, number]))
            / np.abs(np.asarray(modes.shapes[:3, number])).max()
        )
        assert min(shape[2], max(shape[:2])) < 1e-9


@pytest.mark.long
def test_wheels_of_the_car_have_the_curves_of_a_corner_and_are_symmetric():
    travel = np.array([-0.05, 0.0, 0.04])
    corner = jb.suspension.double_wishbone(radius=DOUBLE_WISHBONE["wheel center"][2]).curves(travel)
    left, right = (
        jb.suspension.car_on_double_wishbones().curves(wheel, travel) for wheel in ("fl", "fr")
    )
    for name in (
        "camber",
        "toe",
        "caster",
        "kingpin",
        "trail",
        "scrub radius",
        "roll center height",
    ):
        np.testing.assert_allclose(left[name], corner[name], atol=1e-9)
        np.testing.assert_allclose(right[name], left[name], atol=1e-10)
    for name, sign, shift in (("wheel x", 1, 1.2), ("wheel y", -1, 0.0), ("wheel z", 1, 0.0)):
        np.testing.assert_allclose(right[name], sign * left[name], atol=1e-10)
        np.testing.assert_allclose(left[name], corner[name] + shift, atol=1e-9)
    np.testing.assert_allclose(
        left["motion ratio of spring fl"], corner["motion ratio of spring"], atol=1e-9
    )
    assert np.abs(np.asarray(left["motion ratio of spring rl"])).max() < 1e-9


def tension(model, wheel):
    """Of the spring of a wheel as it is drawn: k (l - l0)."""
    spring, front = model[f"spring {wheel}"], wheel[0] == "f"
    at = np.array(DOUBLE_WISHBONE["spring upper"]), np.array(DOUBLE_WISHBONE["spring lower"])
    return (70e3 if front else 75e3) * (np.linalg.norm(at[0] - at[1]) - float(spring.free_length))


@pytest.mark.long
@pytest.mark.parametrize(
    "point", [name for name in DOUBLE_WISHBONE if not name.startswith("spring")]
)
def test_a_hard_point_of_the_car_moves_all_that_has_it_on_both_sides(point):
    """As in a car built anew, but for what the weights decide: springs keep their compression,
    tyres theirs."""
    place, end = np.add(DOUBLE_WISHBONE[point], [0.004, -0.003, 0.006]), "rear"
    moved, drawn = (
        jb.suspension.car_on_double_wishbones().moved({f"{end} {point}": place}),
        jb.suspension.car_on_double_wishbones(),
    )
    anew = jb.suspension.car_on_double_wishbones(rear_points={point: place})
    np.testing.assert_allclose(moved.hard_points[f"{end} {point}"], place, atol=1e-15)
    by_weights, changed = (
        {f"{kind} {wheel}" for kind in ("spring", "tyre") for wheel in WHEELS},
        set(),
    )
    for (path, a), b, c in zip(
        jb.parameter_paths(moved.model).items(),
        *(jb.parameter_paths(car.model).values() for car in (anew, drawn)),
        strict=True,
    ):
        name = path.split(".")[0]
        if name not in by_weights:
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-12, err_msg=path)
            changed |= {name} if not np.array_equal(a, c) else set()
    for a, b in zip(moved.wheels, anew.wheels, strict=True):
        np.testing.assert_allclose(a.center, b.center, atol=1e-15)
        np.testing.assert_allclose(a.axis, b.axis, atol=1e-12)
    for wheel in WHEELS:
        assert tension(moved.model, wheel) == pytest.approx(tension(drawn.model, wheel), rel=1e-12)
    of_rear = lambda name: (  # noqa: E731
        name.startswith(("rl ", "rr ")) or name in ("road rl", "road rr", "bar rear")
    )
    assert all(map(of_rear, changed)) and (changed or point == "axle inner")


@pytest.mark.long
def test_loads_and_frequencies_have_derivatives_by_hard_points():
    """Against differences of fourth order, whose error at steps of 1 mm is about (1 mm/0.1 m)^4."""
    car = jb.suspension.car_on_double_wishbones()
    x = jnp.concatenate(
        [car.hard_points[name] for name in ("front lower outer", "rear spring upper")]
    )

    @jax.jit
    def of(x):
        model = car.moved({"front lower outer": x[:3], "rear spring upper": x[3:]}).model
        eq = jb.equilibrium(model)
        return jnp.append(
            jb.modes(jb.linearize(model, eq)).frequency[:3], eq.forces["tyre rl"] / 1e3
        )

    slopes = jax.jit(jax.jacfwd(of))(x)
    for i, h in ((1, 1e-3), (2, 1e-3), (4, 1e-3)):
        near, far = (
            (of(x.at[i].add(k * h)) - of(x.at[i].add(-k * h))) / (2 * k * h) for k in (1, 2)
        )
        np.testing.assert_allclose(slopes[:, i], (4 * near - far) / 3, rtol=1e-6, atol=1e-6)


def test_a_car_takes_no_wheel_that_it_has_not():
    with pytest.raises(jb.JaxbodyError, match=r"'lf' is unknown.*UNKNOWN_NAME"):
        jb.suspension.car_on_double_wishbones().curves("lf", 0.0)


@pytest.mark.long
def test_a_kerb_under_the_left_wheels_rolls_the_car(car, eq):
    """Loops stay closed, and mirrored kerbs have mirrored motions (solved to 1e-8)."""
    times = np.linspace(0.0, 0.25, 26)
    lifted = 0.02 * np.clip(times / 0.05, 0, 1)[:, None] * np.array([0, 0, 1.0])
    runs = [
        jb.simulate(
            car,
            times,
            initial=eq.state,
            motion={f"road f{side}": jb.Sampled(times, translation=lifted)},
        )
        for side in ("l", "r")
    ]
    for run in runs:
        assert run.ok
        gaps = [float(how_open(Coordinates(car), q)) for q in np.asarray(run.state.q)[::5]]
        assert max(gaps) < 1e-12
    left, right = (np.asarray(run.state.q)[:, :3] for run in runs)
    assert np.abs(left[:, 2]).max() > 1e-3
    np.testing.assert_allclose(left[:, :2], right[:, :2], atol=1e-7)
    np.testing.assert_allclose(left[:, 2], -right[:, 2], atol=1e-7)
