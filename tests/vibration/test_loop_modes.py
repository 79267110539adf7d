"""Small motions of models with closures: closed forms, reductions by hand, stiff springs in the
place of closures, and derivatives."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.optimize import brentq

import jaxbody as jb
from jaxbody.lagrange import kinetic, potential
from jaxbody.model.joints.frame_tables import frames_of, gaps
from jaxbody.model.joints.kinematics import Coordinates

G = 9.81
# of the parallelogram: its cranks hang from hinges GROUND apart and carry a coupler
ARM, GROUND = 0.5, 0.3
MASSES = {"left": 1.0, "right": 2.0, "coupler": 3.0}
ABOUT = 0.04  # inertia of each body about its center of mass
INERTIA = 2 * ABOUT + (MASSES["left"] + MASSES["right"]) * ARM**2 / 4 + MASSES["coupler"] * ARM**2
# moment by the sine of the angle
WEIGHT = G * ARM * (MASSES["left"] / 2 + MASSES["right"] / 2 + MASSES["coupler"])
DAMPING = 3.0


def parallelogram(
    closed="hinge", *, ground=GROUND, soft=None, base="world", supports=None, elements=None
):
    pin = ("coupler", [ground, -ARM, 0]), ("right", [ground, -ARM, 0])
    joints = {
        "left": jb.Hinge(base, axis="z", at=[0, 0, 0]),
        "right": jb.Hinge(base, axis="z", at=[ground, 0, 0]),
        "coupler": jb.Hinge("left", axis="z", at=[0, -ARM, 0]),
    }
    places = {
        "left": [0, -ARM / 2, 0],
        "right": [ground, -ARM / 2, 0],
        "coupler": [ground / 2, -ARM, 0],
    }
    bodies = {
        name: jb.Body(mass=MASSES[name], inertia=[0.02, 0.03, ABOUT], com=com)
        for name, com in places.items()
    }
    elements = elements or {}
    if soft is not None:
        elements = elements | {"pin": jb.Bushing(*pin, stiffness=np.diag([soft] * 3 + [0.0] * 3))}
    closures = (
        {}
        if soft is not None
        else {
            "pin": jb.closures.Hinge(*pin, axis="z")
            if closed == "hinge"
            else jb.closures.Ball(*pin)
        }
    )
    return jb.Model(
        bodies=bodies,
        joints=joints,
        closures=closures,
        elements=elements,
        supports=supports,
        gravity=[0, -G, 0],
    )


@pytest.mark.long
@pytest.mark.parametrize("closed", ["hinge", "ball"])
def test_a_parallelogram_swings_as_a_pendulum(closed):
    model = parallelogram(closed)
    lin = jb.linearize(model, jb.equilibrium(model))
    assert lin.coordinates == ("left turn about its hinge",)
    np.testing.assert_allclose([lin.M[0, 0], lin.K[0, 0]], [INERTIA, WEIGHT], rtol=1e-12)
    modes = jb.modes(lin)
    assert float(modes.frequency[0]) == pytest.approx(
        np.sqrt(WEIGHT / INERTIA) / (2 * np.pi), rel=1e-12
    )
    # all three turn by as much
    np.testing.assert_allclose(np.abs(modes.shapes[:, 0]) * np.sqrt(INERTIA), 1.0, rtol=1e-12)
    np.testing.assert_allclose(modes.shapes[0], -modes.shapes[2], rtol=1e-12)
    damped = jb.complex_modes(lin)
    np.testing.assert_allclose(damped.frequency, modes.frequency, rtol=1e-10)
    assert damped.shapes.shape == (3, 1)
    shares = jb.vibration.mode_energies(lin).kinetic_shares
    turning = [100 * ABOUT / INERTIA] * 2 + [0.0]
    moving = [
        100 * m * (ARM / f) ** 2 / INERTIA for m, f in zip(MASSES.values(), (2, 2, 1), strict=True)
    ]
    np.testing.assert_allclose(
        [np.sum(shares[i]) for i in range(3)], np.add(turning, moving), rtol=1e-10
    )
    assert modes.names[0].startswith("coupler along x")


CRANK, COUPLER, ROCKER, BASE = 0.12, 0.36, 0.24, 0.3
# mass, distance of its center, inertia
BAR = {"crank": (0.8, 0.05, 0.002), "coupler": (1.5, 0.2, 0.02), "rocker": (1.1, 0.1, 0.008)}
TORQUE, REST = 30.0, 0.4  # of the torsion spring at the crank


def angles(crank):
    """Angles of coupler and rocker, open circuit, in closed form."""
    x, y = BASE - CRANK * np.cos(crank), -CRANK * np.sin(crank)
    d = np.sqrt(x * x + y * y)
    coupler = np.arctan(y / x) + np.arccos((COUPLER**2 + d * d - ROCKER**2) / (2 * COUPLER * d))
    end = (
        CRANK * np.cos(crank) + COUPLER * np.cos(coupler) - BASE,
        CRANK * np.sin(crank) + COUPLER * np.sin(coupler),
    )
    return coupler, np.pi / 2 - np.arctan(end[0] / end[1])


def centers(crank):
    coupler, rocker = angles(crank)
    along = lambda r, a: np.array([r * np.cos(a), r * np.sin(a)])  # noqa: E731
    pin = along(CRANK, crank)
    return (
        along(BAR["crank"][1], crank),
        pin + along(BAR["coupler"][1], coupler),
        np.array([BASE, 0]) + along(BAR["rocker"][1], rocker),
    )


def rate(function, x, h=1e-30):
    return np.imag(np.array(function(x + 1j * h))) / h


def four_bar(angle, coupler=COUPLER):
    """Drawn closed, at a crank angle; bodies have the axes of the world."""
    of_coupler, _ = angles(angle)
    pin = np.array([CRANK * np.cos(angle), CRANK * np.sin(angle), 0.0])
    end = pin + coupler * np.array([np.cos(of_coupler), np.sin(of_coupler), 0.0])
    foot = np.array([BASE, 0.0, 0.0])
    joints = {
        "crank": jb.Hinge("world", axis="z", at=[0, 0, 0]),
        "coupler": jb.Hinge("crank", axis="z", at=pin),
        "rocker": jb.Hinge("world", axis="z", at=foot),
    }
    bodies = {
        name: jb.Body(mass=BAR[name][0], inertia=[BAR[name][2]] * 3, com=np.append(np.real(c), 0.0))
        for name, c in zip(BAR, centers(angle), strict=True)
    }
    closures = {"pin": jb.closures.Hinge(("coupler", end), ("rocker", end), axis="z")}
    spring = jb.Torsion("world", "crank", axis="z", spring=TORQUE, free_angle=REST - angle)
    return jb.Model(
        bodies=bodies,
        joints=joints,
        closures=closures,
        elements={"spring": spring},
        gravity=[0, -G, 0],
    )


def moment(crank):
    """dV/d angle of the crank."""
    heights = rate(lambda a: [c[1] for c in centers(a)], crank)
    return G * sum(m * h for (m, *_), h in zip(BAR.values(), heights, strict=True)) + TORQUE * (
        crank - REST
    )


@pytest.mark.long
def test_a_four_bar_linkage_has_the_frequency_of_its_effective_inertia():
    """M = sum of m |C'|^2 + J w^2, K = V'' by the angle of the crank, from the closed form of
    the angles."""
    crank = brentq(moment, 0.2, 0.6, xtol=1e-15)
    model = four_bar(0.5)
    eq = jb.equilibrium(model)
    assert float(eq.state.q[0]) + 0.5 == pytest.approx(crank, abs=1e-12)
    inertia = sum(
        m * np.sum(rate(lambda a, i=i: centers(a)[i], crank) ** 2) + J * turn**2
        for i, ((m, _, J), turn) in enumerate(
            zip(BAR.values(), [1.0, *rate(angles, crank)], strict=True)
        )
    )
    h = 1e-3
    stiffness = (
        8 * (moment(crank + h) - moment(crank - h)) - moment(crank + 2 * h) + moment(crank - 2 * h)
    ) / (12 * h)
    modes = jb.modes(jb.linearize(model, eq))
    turns = np.array(modes.shapes[:, 0]) / modes.shapes[0, 0]
    np.testing.assert_allclose([turns[0] + turns[1], turns[2]], rate(angles, crank), rtol=1e-10)
    assert float(modes.frequency[0]) == pytest.approx(
        np.sqrt(stiffness / inertia) / (2 * np.pi), rel=1e-9
    )  # differences of fourth order


@pytest.mark.long
def test_frequencies_have_derivatives_by_points():
    model = four_bar(0.5)
    end = np.asarray(model["pin"].a)

    def frequency(x):
        changed = jb.replace(
            model,
            {
                "pin.a": jnp.asarray(end) + jnp.array([x[0], x[1], 0.0]),
                "spring.spring.coefficient": TORQUE + x[2],
            },
        )
        return jb.modes(jb.linearize(changed, jb.equilibrium(changed))).frequency[0]

    zero = jnp.zeros(3)
    forward, reverse, value = (
        jax.jit(jax.jacfwd(frequency))(zero),
        jax.jit(jax.grad(frequency))(zero),
        jax.jit(frequency),
    )
    np.testing.assert_allclose(forward, reverse, rtol=1e-9)
    h = np.array([1e-5, 1e-5, 1e-3])
    differences = [
        (value(zero.at[i].set(h[i])) - value(zero.at[i].set(-h[i]))) / (2 * h[i]) for i in range(3)
    ]
    np.testing.assert_allclose(forward, differences, rtol=1e-6)


@pytest.mark.long
def test_closures_are_the_limit_of_stiff_springs():
    """The error of the lowest frequency is inversely proportional to the stiffness."""
    pull = {
        "pull": jb.Spring(
            ("coupler", [0, -ARM, 0]), ("world", [0.8, -0.2, 0]), stiffness=200.0, free_length=0.3
        )
    }
    first = lambda model: float(jb.modes(jb.linearize(model, jb.equilibrium(model))).frequency[0])  # noqa: E731
    ideal, stiff = first(parallelogram(elements=pull)), np.array([1e5, 1e6, 1e7])
    errors = [abs(first(parallelogram(soft=k, elements=pull)) - ideal) for k in stiff]
    slopes = np.diff(np.log(errors)) / np.diff(np.log(stiff))
    np.testing.assert_allclose(slopes, -1.0, atol=5e-3)


def on_a_base():
    """The parallelogram on a base, with a spring and a damper to it."""
    pull = jb.Spring(
        ("coupler", [0, -ARM, 0]),
        ("base", [0.6, -ARM, 0]),
        stiffness=80.0,
        free_length=0.6,
        damping=DAMPING,
    )
    return parallelogram(base="base", supports={"base": jb.Support()}, elements={"pull": pull})


@pytest.mark.long
def test_a_base_drives_a_closed_loop_as_by_its_equation_of_motion():
    """M q'' + C q' + K q = -m L x'' for the mass that moves along; the base feels the inertia
    of all."""
    lin = jb.linearize(on_a_base(), jb.equilibrium(on_a_base()))
    along = ARM * (MASSES["left"] / 2 + MASSES["right"] / 2 + MASSES["coupler"])
    C, K, total = DAMPING * ARM**2, WEIGHT + 80.0 * ARM**2, sum(MASSES.values())
    f = np.array([0.3, 0.9, 2.7])
    s = 2j * np.pi * f
    swing = -along * s**2 / (INERTIA * s**2 + C * s + K)
    sensors = {
        "coupler": jb.Position("coupler", axis="x"),
        "base": jb.sensors.Reaction("base", component=0),
        "pull": jb.sensors.LoadCell("pull"),
    }
    response = jb.frequency_response(
        lin, f, inputs={"x": jb.BaseMotion("base", "x")}, outputs=sensors
    )
    by_force = -(total + along * swing) * s**2
    expected = {
        "coupler": 1 + ARM * swing,
        "base": by_force,
        "pull": -(80.0 + DAMPING * s) * ARM * swing,
    }
    for i, name in enumerate(sensors):
        np.testing.assert_allclose(
            np.asarray(response.values)[i, 0], expected[name], rtol=1e-10, err_msg=name
        )
    push = jb.frequency_response(
        lin,
        f,
        inputs={"F": jb.PointForce("coupler", direction="x")},
        outputs={"x": jb.Position("coupler", axis="x")},
    )
    np.testing.assert_allclose(
        np.asarray(push.values)[0, 0], ARM**2 / (INERTIA * s**2 + C * s + K), rtol=1e-10
    )
    space = lin.state_space(
        {"F": jb.PointForce("coupler", direction="x")}, {"x": jb.Position("coupler", axis="x")}
    )
    assert space.states == ("left turn about its hinge", "rate of left turn about its hinge")
    A, B, row = (np.asarray(x) for x in (space.A, space.B, space.C))
    by_space = [(row @ np.linalg.solve(x * np.eye(2) - A, B))[0, 0] for x in s]
    np.testing.assert_allclose(by_space, np.asarray(push.values)[0, 0], rtol=1e-10)
    f = np.linspace(0.3, 2.7, 601)
    s = 2j * np.pi * f
    white, x = (
        {"x": jb.vibration.PSD([0.1, 10.0], [1.0, 1.0], unit="m2/Hz")},
        {"x": jb.BaseMotion("base", "x")},
    )
    spectrum = jb.random_response(lin, f, x, {"coupler": sensors["coupler"]}, white)
    follows = 1 - along * ARM * s**2 / (INERTIA * s**2 + C * s + K)
    np.testing.assert_allclose(np.asarray(spectrum.psd)[0], np.abs(follows) ** 2, rtol=1e-9)


@pytest.mark.long
def test_blocks_of_the_base_are_second_derivatives_of_the_energies_on_the_closures():
    """K | -K~ | K_bb and M | -M~ | M_bb as Hessians of V and T along q(q_i, Xi) from
    solving c = 0."""
    model = jb.Model(
        bodies={name: parallelogram()[name] for name in ("left", "coupler")},
        joints={
            "left": jb.Ball("world", at=[0, 0, 0]),
            "coupler": jb.Hinge("left", axis="z", at=[0, -ARM, 0]),
        },
        closures={"rod": jb.closures.Rod(("base", [0.1, 0.4, 0.05]), ("left", [0, -0.3, 0]))},
        elements={
            "pull": jb.Spring(
                ("base", [0.45, 0.3, 0.1]),
                ("coupler", [0.2, -0.4, 0.05]),
                stiffness=300.0,
                free_length=0.5,
            )
        },
        supports={"base": jb.Support()},
        gravity=[0, -G, 0],
    )
    eq = jb.equilibrium(model)
    assert eq.ok
    lin = jb.linearize(model, eq)
    coordinates, own = Coordinates(model), np.array(model.independent)
    others, still = np.setdiff1d(np.arange(model.layout.nv), own), jnp.zeros(model.layout.nv)

    def frames(x, v):
        """The frames at increments x of the independent coordinates and of Xi, the others by
        Newton's method."""
        supports = coordinates.supports_at(x[len(own) :].reshape(1, 6), jnp.zeros((1, 6)))
        return coordinates.frames(coordinates.retract(eq.state.q, increments(x)), v, supports)

    def increments(x):
        supports = coordinates.supports_at(x[len(own) :].reshape(1, 6), jnp.zeros((1, 6)))

        def conditions(dependent, given):
            q = coordinates.retract(eq.state.q, still.at[own].set(given).at[others].set(dependent))
            return gaps(model, coordinates, coordinates.frames(q, still, supports), q)

        dependent, given = jnp.zeros(len(others)), x[: len(own)]
        for _ in range(6):
            dependent = dependent - jnp.linalg.solve(
                jax.jacfwd(conditions)(dependent, given), conditions(dependent, given)
            )
        return still.at[own].set(given).at[others].set(dependent)

    zero = jnp.zeros(len(own) + 6)
    K = jax.hessian(lambda x: potential(model, frames(x, still)))(zero)

    def moving(rates):
        state = jb.State(eq.state.q, jax.jvp(increments, (zero,), (rates,))[1])
        return frames_of(model, state, None, rates[len(own) :].reshape(1, 6))

    M = jax.hessian(lambda rates: kinetic(model, moving(rates)))(zero)
    n = len(own)
    for H, names in ((K, ("K", "K_tilde", "K_bb")), (M, ("M", "M_tilde", "M_bb"))):
        for part, sign, name in (
            (H[:n, :n], 1, names[0]),
            (H[:n, n:], -1, names[1]),
            (H[n:, n:], 1, names[2]),
        ):
            np.testing.assert_allclose(
                sign * getattr(lin, name), part, atol=1e-9 * np.abs(H).max(), err_msg=name
            )
    split = lin.K_elastic + lin.K_geometric + lin.K_gravity + lin.K_closures
    np.testing.assert_allclose(split, lin.K, atol=1e-10 * np.abs(lin.K).max())


@pytest.mark.long
def test_an_open_state_and_another_models_equilibrium_are_reported():
    model = four_bar(0.5)
    eq = jb.equilibrium(model)
    open_ = jb.State(model.reference.q + jnp.array([0.1, 0.0, 0.0]), jnp.zeros(3))
    with pytest.warns(jb.JaxbodyWarning, match="NOT_CLOSED"):
        jb.modes(jb.linearize(model, open_))
    stale = jb.replace(model, {"spring.spring.coefficient": 2 * TORQUE})
    with pytest.warns(jb.JaxbodyWarning, match="STALE"):
        jb.linearize(stale, eq)


@pytest.mark.long
def test_axes_of_a_mounted_body_are_those_without_the_loop_beside_it():
    corners = {"a": [1, 1, -0.2], "b": [1, -1, -0.3], "c": [-1, 0.5, -0.1]}
    legs = {
        name: jb.Bushing(("box", at), ("world", at), stiffness=[1e4, 2e4, 3e4])
        for name, at in corners.items()
    }
    box = {"box": jb.Body(mass=50.0, inertia=[4, 5, 6], com=[0.1, 0, 0.2])}
    beside = {
        "first": jb.Body(mass=1.0, inertia=[1, 1, 1]),
        "second": jb.Body(mass=2.0, inertia=[1, 1, 1]),
    }
    rod = jb.closures.Rod(("world", [3, 0, 0.5]), ("second", [3, 0, 0]))
    loop = jb.Model(
        bodies={"first": beside["first"], **box, "second": beside["second"]},
        joints={"first": jb.Guide("world", axis="x"), "second": jb.Guide("first", axis="z")},
        closures={"rod": rod},
        elements=legs
        | {
            "spring": jb.Spring(
                ("second", [3, 0, 0]), ("world", [4, 0, 0]), stiffness=50.0, free_length=1.0
            )
        },
    )
    alone, beside_it = (
        jb.linearize(model, model.reference)
        for model in (jb.Model(bodies=box, elements=legs), loop)
    )
    for function, more in (
        (jb.vibration.elastic_axes, ()),
        (jb.vibration.torque_roll_axis, ([1, 0, 0],)),
    ):
        expected, found = (function(lin, "box", *more) for lin in (alone, beside_it))
        for name in (
            "center",
            "stiffness",
            "points",
            "torsional_stiffness",
            "direction",
            "frequency",
            "coupling",
        ):
            if hasattr(expected, name):
                np.testing.assert_allclose(
                    getattr(found, name),
                    getattr(expected, name),
                    rtol=1e-12,
                    atol=1e-12,
                    err_msg=name,
                )
    held = jb.Model(
        bodies=box,
        elements=legs,
        closures={"rod": jb.closures.Rod(("world", [0, 0, 1]), ("box", [0, 0, 0]))},
    )
    with pytest.raises(jb.JaxbodyError, match=r"'box' follows other bodies by closures.*NOT_FREE"):
        jb.vibration.elastic_axes(jb.linearize(held, held.reference), "box")
