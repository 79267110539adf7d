"""Joint reactions: closed forms of a pendulum, a chain, a cantilever and a moving guide; momentum,
zero work, and other responses."""

import warnings

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs

import jaxbody as jb
from jaxbody.mechanics.closed_loops import dynamics_of
from jaxbody.model.forces.force_elements import ForceInputs
from jaxbody.motion.trajectories import read

G = 9.81
RANDOM = np.random.default_rng(19)
read_all = jax.jit(
    lambda model, q, v, sensors, motions=(), loads=(), t=0.0: read(
        model, motions, jnp.asarray(t), jb.State(q, v), sensors, loads
    )
)


def at(model, q, v, sensors, *more):
    return {
        name: np.asarray(x)
        for name, x in read_all(
            model, jnp.asarray(q, float), jnp.asarray(v, float), sensors, *more
        ).items()
    }


# At a state: closed forms


@pytest.mark.parametrize(("q", "w"), [(0.0, 0.0), (0.7, 0.0), (0.7, 3.0), (-2.2, -5.0)])
def test_a_pendulum_pulls_on_its_hinge(q, w):
    """Along the rod m g cos q + m l w^2, across it m g sin q J/(J + m l^2), no moment at the hinge,
    and about the center of mass that of the force."""
    m, l, J, pivot = 2.0, 0.6, 0.4, np.array([0.3, -0.1, 0.2])
    # O is the center of mass
    rod = jb.Body(mass=m, inertia=[0.3, J, 0.1], position=pivot - l * np.eye(3)[2])
    model = jb.Model(
        bodies={"rod": rod},
        joints={"rod": jb.Hinge("world", axis=[0, 1, 0], at=pivot)},
        gravity=[0, 0, -G],
    )
    sensors = {
        "hinge": jb.sensors.Reaction("rod"),
        "mass": jb.sensors.Reaction("rod", [0, 0, 0]),
        "up": jb.sensors.Reaction("rod", component=2),
    }
    result = at(model, [q], [w], sensors)
    along, across = np.array([np.sin(q), 0, np.cos(q)]), np.array([np.cos(q), 0, -np.sin(q)])
    F = (m * G * np.cos(q) + m * l * w**2) * along - m * G * np.sin(q) * J / (J + m * l**2) * across
    np.testing.assert_allclose(result["hinge"], [*F, 0, 0, 0], rtol=0, atol=1e-12 * 60)
    np.testing.assert_allclose(
        result["mass"], [*F, *np.cross(l * along, F)], rtol=0, atol=1e-12 * 60
    )
    np.testing.assert_allclose(result["up"], F[2], rtol=0, atol=1e-12 * 60)


def test_a_chain_of_two_links_pulls_on_both_hinges():
    """Double pendulum, uniform rods of length 2 l: the equations of Lagrange, written out, then m
    a - m g of each; the axes of the lower hinge turn with the upper rod."""
    m, l, J = np.array([2.0, 1.5]), np.array([0.4, 0.3]), np.array([0.11, 0.05])
    links = {
        "upper": jb.Body(mass=m[0], inertia=[0.11, J[0], 0.02], position=[0, 0, -l[0]]),
        "lower": jb.Body(mass=m[1], inertia=[0.05, J[1], 0.02], position=[0, 0, -2 * l[0] - l[1]]),
    }
    joints = {
        "upper": jb.Hinge("world", axis=[0, 1, 0], at=[0, 0, 0]),
        "lower": jb.Hinge("upper", axis=[0, 1, 0], at=[0, 0, -l[0]]),
    }
    model = jb.Model(bodies=links, joints=joints, gravity=[0, 0, -G])
    a, b, da, db = 0.8, -0.5, 2.0, -3.0  # angles from the vertical and their rates, both absolute
    c, s, L = np.cos(a - b), np.sin(a - b), 2 * l[0]
    M = np.array(
        [
            [J[0] + m[0] * l[0] ** 2 + m[1] * L**2, m[1] * L * l[1] * c],
            [m[1] * L * l[1] * c, J[1] + m[1] * l[1] ** 2],
        ]
    )
    right = [
        -m[1] * L * l[1] * s * db**2 - (m[0] * l[0] + m[1] * L) * G * np.sin(a),
        m[1] * L * l[1] * s * da**2 - m[1] * l[1] * G * np.sin(b),
    ]
    dda, ddb = np.linalg.solve(M, right)

    def arm(length, angle, rate, change):
        """Acceleration of the end of an arm that hangs down at angle 0 and turns about y."""
        return length * (
            -change * np.array([np.cos(angle), 0, -np.sin(angle)])
            + rate**2 * np.array([np.sin(angle), 0, np.cos(angle)])
        )

    g = np.array([0, 0, -G])
    lower = m[1] * (arm(L, a, da, dda) + arm(l[1], b, db, ddb) - g)
    upper = m[0] * (arm(l[0], a, da, dda) - g) + lower
    result = at(
        model,
        [a, b - a],
        [da, db - da],
        {"upper": jb.sensors.Reaction("upper"), "lower": jb.sensors.Reaction("lower")},
    )
    # world to the axes of the upper rod
    in_upper = np.array([[np.cos(a), 0, -np.sin(a)], [0, 1, 0], [np.sin(a), 0, np.cos(a)]])
    np.testing.assert_allclose(result["upper"], [*upper, 0, 0, 0], rtol=0, atol=1e-12 * 100)
    np.testing.assert_allclose(
        result["lower"], [*in_upper @ lower, 0, 0, 0], rtol=0, atol=1e-12 * 100
    )


def test_a_console_bends_its_hinge():
    """A beam on a hinge about the vertical: the hinge carries its weight, the load at its tip, and
    their moments about both other axes."""
    m, c, tip = 3.0, np.array([0.5, 0.0, 0.0]), np.array([1.2, 0.0, 0.1])
    F = np.array([0.0, 0.0, -40.0])
    beam = jb.Body(mass=m, inertia=[0.1, 0.4, 0.4], com=c)
    model = jb.Model(
        bodies={"beam": beam},
        joints={"beam": jb.Hinge("world", axis=[0, 0, 1])},
        gravity=[0, 0, -G],
    )
    sensors = {"root": jb.sensors.Reaction("beam"), "plate": jb.sensors.ForcePlate("world")}
    load = (jb.Force(("beam", tip), force=F),)
    result = at(model, [0.0], [0.0], sensors, (), load)
    weight = np.array([0, 0, -m * G])
    np.testing.assert_allclose(
        result["root"],
        -np.concatenate([weight + F, np.cross(c, weight) + np.cross(tip, F)]),
        rtol=0,
        atol=1e-11,
    )
    np.testing.assert_allclose(result["plate"], -result["root"], rtol=0, atol=1e-11)
    welded = jb.Model(bodies={"beam": beam}, joints={"beam": jb.Fixed("world")}, gravity=[0, 0, -G])
    result = at(welded, [], [], {"root": jb.sensors.Reaction("beam")}, (), load)
    np.testing.assert_allclose(
        result["root"],
        -np.concatenate([weight + F, np.cross(c, weight) + np.cross(tip, F)]),
        rtol=0,
        atol=1e-11,
    )


def test_a_guide_on_a_moving_base_pushes_sideways():
    """A carriage whose guide stands along z on a base that shakes along x and z: m x_b'' sideways,
    nothing along the guide, and the moment about O from a center of mass off the guide; the base
    stands turned about z, so that its axes are not those of the world."""
    m, c, d, f, t = 4.0, np.array([0.05, 0.02, 0.1]), np.array([0.02, 0.0, 0.03]), 1.7, 0.31
    turn = 0.6
    base = jb.Support(orientation=[np.cos(turn / 2), 0, 0, np.sin(turn / 2)])
    model = jb.Model(
        bodies={
            "carriage": jb.Body(
                mass=m, inertia=[0.1, 0.1, 0.1], com=c, orientation=base.orientation
            )
        },
        supports={"base": base},
        joints={"carriage": jb.Guide("base", axis=[0, 0, 1])},
        gravity=[0, 0, -G],
    )
    motion = (jb.Harmonic(frequency=f, translation=d),)
    result = at(model, [0.1], [0.4], {"guide": jb.sensors.Reaction("carriage")}, motion, (), t)[
        "guide"
    ]
    w = 2 * np.pi * f
    acceleration = -(w**2) * np.asarray(motion[0](t))[:3]
    # world to base
    Rz = np.array([[np.cos(turn), np.sin(turn), 0], [-np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
    F = Rz @ (m * acceleration * [1, 1, 0])
    np.testing.assert_allclose(result[:3], F, rtol=0, atol=1e-12 * 100)
    np.testing.assert_allclose(result[3:], np.cross(c, F), rtol=0, atol=1e-12 * 100)


# Everywhere: momentum and work


KINDS = {
    "fixed": jb.Fixed("arm"),
    "guide": jb.Guide("arm", axis=[0.3, -0.4, 1.0]),
    "hinge": jb.Hinge("arm", axis=[0.3, 1.0, 0.2], at=[0.1, 0.0, 0.3]),
    "ball": jb.Ball("arm", at=[0.1, 0.2, -0.1]),
    "translation": jb.Translation("arm"),
    "car": jb.joints.HeavePitchRoll("arm"),
}


def tree(joint):
    """An arm on a hinge of a base, a box on the arm by any joint; springs and dampers between them
    and to base and world."""
    p = rigs.PARAMETERS
    ends = [("box", "base"), ("box", "arm"), ("arm", "world")]
    springs = {
        f"s{i}": jb.Spring(
            (one, p["a"][i]),
            (other, p["b"][i] + [0, 0, 1]),
            stiffness=90.0 + 20 * i,
            free_length=0.4,
            damping=3.0,
        )
        for i, (one, other) in enumerate(ends)
    }
    return jb.Model(
        bodies={
            "box": jb.Body(
                mass=2.0, inertia=p["inertia"][0], com=p["com"][0], position=[0.2, -0.1, 0.4]
            ),
            "arm": jb.Body(
                mass=0.8, inertia=p["inertia"][1], com=p["com"][1], position=[0.1, -0.1, -0.2]
            ),
        },
        supports={
            "base": jb.Support(position=p["position"], orientation=rigs.unit(p["orientation"]))
        },
        joints={"arm": jb.Hinge("base", axis=p["axis"], at=p["at"]), "box": joint},
        elements=springs,
        gravity=p["gravity"],
    )


PUSH = (jb.Force(("box", [0.1, 0.3, 0.0]), force=[3.0, -8.0, 5.0], moment=[0.4, 0.2, -0.3]),)
SHAKEN = (jb.Harmonic(**rigs.SHAKING),)


def momenta(model, t, q, v):
    """Momentum and moment of momentum about the world's origin of box and arm."""
    coordinates = dynamics_of(model, SHAKEN).coordinates
    frames = coordinates.frames(q, v, coordinates.supports_moving(SHAKEN, t))
    bodies, moving = model.bodies.rows, frames[model.layout.first_body :]
    P = bodies.mass[:, None] * moving.velocity(bodies.com)
    J = jnp.einsum("nij,njk,nlk,nl->ni", moving.R, bodies.inertia, moving.R, moving.w)
    return jnp.concatenate([P, J + jnp.cross(moving.point(bodies.com), P)], -1)


@pytest.mark.long
@pytest.mark.parametrize("kind", KINDS)
def test_what_joints_and_all_else_exert_is_the_rate_of_momentum(kind):
    """d(momentum)/dt of the box, and of box and arm together, against gravity, load, springs and
    the one joint that holds them, all about the world's origin; and the joint does no work: the
    reaction about O has no part along its directions."""
    model = tree(KINDS[kind])
    layout = model.layout
    q0, v = model.reference.q, jnp.asarray(RANDOM.normal(size=layout.nv))
    dynamics, t = dynamics_of(model, SHAKEN, PUSH), jnp.array(0.3)

    @jax.jit
    def quantities(delta):
        q = dynamics.coordinates.retract(q0, delta)
        tangent = dynamics.coordinates.rate(q, v), dynamics.acceleration(t, q, v)
        rate = jax.jvp(
            lambda t, q, v: momenta(model, t, q, v), (t, q, v), (jnp.ones(()), *tangent)
        )[1]
        supports = dynamics.coordinates.supports_moving(SHAKEN, t)
        frames, axes = dynamics.coordinates.frames_and_axes(q, v, supports)
        elements = [
            element.wrenches(*(frames[layout.frame(end)] for end in element.between))
            for element in (model[f"s{i}"] for i in range(3))
        ]
        sensors = {name: jb.sensors.Reaction(name, [0, 0, 0]) for name in ("box", "arm")}
        return (
            rate,
            frames,
            axes,
            elements,
            PUSH[0].forces(ForceInputs((frames[layout.frame("box")],), {}, jnp.zeros(0), t))[0],
            read(model, SHAKEN, t, jb.State(q, v), sensors, PUSH),
        )

    rate, frames, axes, elements, push, result = jax.tree.map(
        np.asarray, quantities(jnp.asarray(0.4 * RANDOM.normal(size=layout.nv)))
    )
    row, p = {name: layout.frame(name) for name in layout.frames}, frames.p

    def about_origin(name, F, M):
        return np.concatenate([F, M + np.cross(p[row[name]], F)])

    held = {}
    for name, parent in (("box", "arm"), ("arm", "base")):
        F, M = (frames.R[row[parent]] @ x for x in np.split(result[name], 2))
        held[name] = about_origin(name, F, M)
        rows = slice(*{"box": (0, layout.nv - 1), "arm": (layout.nv - 1, layout.nv)}[name])
        power = axes[0][rows] @ F + axes[1][rows] @ M
        np.testing.assert_allclose(power, 0, atol=1e-11 * np.abs(result[name]).max())
    applied = {name: 0.0 for name in layout.frames}
    for i, ends in enumerate(elements):
        for end, wrench in zip(model[f"s{i}"].between, ends, strict=True):
            applied[end] = applied[end] + about_origin(end, *wrench)
    for name in layout.bodies:
        weight = model[name].mass * np.asarray(model.gravity)
        com = p[row[name]] + frames.R[row[name]] @ np.asarray(model[name].com)
        applied[name] = applied[name] + np.concatenate([weight, np.cross(com, weight)])
    applied["box"] = applied["box"] + about_origin("box", *push)
    for carried in (["box"], ["box", "arm"]):
        total = sum(applied[name] for name in carried) + held[carried[-1]]
        momentum = sum(rate[layout.bodies.index(name)] for name in carried)
        np.testing.assert_allclose(momentum, total, rtol=0, atol=1e-12 * 30 * np.abs(total).max())


@pytest.mark.long
def test_derivatives_of_reactions_agree():
    """Forward, backward and differences, by the state and by the numbers of the model."""
    model, sensors = tree(KINDS["guide"]), {"box": jb.sensors.Reaction("box", [0.1, 0, 0.2])}
    x0, rebuild = jax.flatten_util.ravel_pytree(
        (jnp.array([0.1, -0.2]), jnp.array([0.5, -1.0]), model)
    )

    @jax.jit
    def reading(x):
        q, v, model = rebuild(x)
        return read(model, SHAKEN, jnp.array(0.2), jb.State(q, v), sensors, PUSH)["box"]

    towards, onto = RANDOM.normal(size=x0.size), RANDOM.normal(size=6)
    forward = jax.jit(lambda x: jax.jvp(reading, (x,), (towards,))[1])(x0)
    backward = jax.jit(jax.grad(lambda x: reading(x) @ onto))(x0)
    np.testing.assert_allclose(forward @ onto, backward @ towards, rtol=1e-11)
    h = 1e-4
    one, two, three = (
        (reading(x0 + k * h * towards) - reading(x0 - k * h * towards)) / (2 * k * h)
        for k in (1, 2, 3)
    )
    np.testing.assert_allclose(
        forward, 1.5 * one - 0.6 * two + 0.1 * three, rtol=1e-7, atol=1e-7 * np.abs(forward).max()
    )


# Along a trajectory, in a fit, in responses


@pytest.fixture(scope="module")
def chain():
    """Two links on hinges about y, the upper in the origin of a base; centers of mass off the
    hinges, so that they hang askew; a spring and a damper turn one against the other."""
    links = {
        "upper": jb.Body(mass=2.0, inertia=[0.1, 0.11, 0.02], com=[0.3, 0, -0.4]),
        "lower": jb.Body(
            mass=1.5, inertia=[0.05, 0.05, 0.02], com=[-0.05, 0, -0.3], position=[0, 0, -0.8]
        ),
    }
    joints = {
        "upper": jb.Hinge("base", axis=[0, 1, 0], at=[0, 0, 0]),
        "lower": jb.Hinge("upper", axis=[0, 1, 0]),
    }
    spring = jb.Torsion("upper", "lower", axis=[0, 1, 0], spring=3.0, damper=0.2)
    return jb.Model(
        bodies=links,
        supports={"base": jb.Support()},
        joints=joints,
        elements={"spring": spring},
        gravity=[0, 0, -G],
    )


@pytest.mark.long
def test_responses_of_reactions_are_those_of_supports_and_of_accelerations(chain):
    """The upper hinge, all that the base holds, against the reaction on the base, which comes from
    K, C and M of (Delta, Xi); the lower against Newton's law for its link, by the acceleration of
    its center of mass less the push on it. Axes of the base and of the upper link turn: what they
    carry at rest is then seen from another side."""
    lin = jb.linearize(chain, jb.equilibrium(chain))
    inputs = {
        "push": jb.PointForce("lower", [0.1, 0, -0.5], "x"),
        "moment": jb.PointForce("upper", direction="ry"),
        "shake": jb.BaseMotion("base", "x", kind="acceleration"),
        "turn": jb.BaseMotion("base", "ry"),
    }
    joints = {
        f"{name} {k}": jb.sensors.Reaction(name, component=k)
        for name in ("upper", "lower")
        for k in (0, 2, 4)
    }
    others = {
        d: jb.sensors.Reaction("base", component=k) for d, k in (("x", 0), ("z", 2), ("ry", 4))
    }
    com = {d: jb.Acceleration("lower", chain["lower"].com, axis=d) for d in ("x", "z")}
    turned = {"phi": jb.sensors.Rotation("upper", axis="y")}
    outputs = {**joints, **others, **{f"com {d}": port for d, port in com.items()}, **turned}
    H = jb.frequency_response(lin, [0.3, 1.1, 2.7, 9.0], inputs, outputs)
    rest = at(
        chain,
        lin.state.q,
        np.zeros(2),
        {name: jb.sensors.Reaction(name) for name in ("upper", "lower")},
    )
    F, upper_turn = rest["upper"][[0, 2]], float(lin.state.q[0])
    # askew, and both components are there
    assert abs(upper_turn) > 0.1 and np.abs(rest["lower"][[0, 2]]).min() > 1.0
    R0 = np.array(
        [[np.cos(upper_turn), np.sin(upper_turn)], [-np.sin(upper_turn), np.cos(upper_turn)]]
    )  # (x, z) in the axes of the upper link, in world axes
    for name in inputs:
        phi = 1.0 if name == "turn" else 0.0
        close = {"rtol": 0, "atol": 1e-10 * np.abs(H.values).max()}
        np.testing.assert_allclose(H["upper 0", name], -H["x", name] - phi * F[1], **close)
        np.testing.assert_allclose(H["upper 2", name], -H["z", name] + phi * F[0], **close)
        np.testing.assert_allclose(H["upper 4", name], -H["ry", name], **close)
        np.testing.assert_allclose(H["lower 4", name], 0, **close)
        of_world = R0 @ np.array([np.asarray(H["lower 0", name]), np.asarray(H["lower 2", name])])
        f = R0 @ rest["lower"][[0, 2]]
        of_world = of_world + np.asarray(H["phi", name]) * np.array([[f[1]], [-f[0]]])
        expected = 1.5 * np.array([np.asarray(H["com x", name]), np.asarray(H["com z", name])])
        expected[0] -= name == "push"
        np.testing.assert_allclose(of_world, expected, **close)


@pytest.mark.long
def test_all_that_the_world_carries_is_an_output_of_responses(chain):
    """Of a chain that hangs on the world it is the reaction of its one hinge, from the other side:
    the push goes through to the world at 0+ Hz, the weight does not change."""
    joints = {
        "upper": jb.Hinge("world", axis=[0, 1, 0], at=[0, 0, 0]),
        "lower": chain.joint("lower"),
    }
    links = {name: chain[name] for name in joints}
    model = jb.Model(
        bodies=links, joints=joints, elements={"spring": chain["spring"]}, gravity=[0, 0, -G]
    )
    lin = jb.linearize(model, jb.equilibrium(model))
    outputs = {
        f"{kind.__name__} {k}": kind(on, component=k)
        for kind, on in ((jb.sensors.ForcePlate, "world"), (jb.sensors.Reaction, "upper"))
        for k in range(6)
    }
    H = jb.frequency_response(
        lin, [1e-5, 2.0], {"push": jb.PointForce("lower", [0, 0, -0.3], "x")}, outputs
    )
    for k in range(6):
        np.testing.assert_allclose(
            H[f"ForcePlate {k}", "push"],
            -H[f"Reaction {k}", "push"],
            rtol=0,
            atol=1e-10 * np.abs(H.values).max(),
        )
    np.testing.assert_allclose(H.values[:3, 0, 0], [1, 0, 0], rtol=0, atol=1e-6)


@pytest.mark.long
def test_an_accelerometer_is_an_output_of_responses(chain):
    """To first order it reads the acceleration of its point along its axis, and g where it turns:
    -g phi across, in the plane of the motion."""
    lin = jb.linearize(chain, jb.equilibrium(chain))
    x, z = np.eye(3)[[0, 2]]
    outputs = {
        "read": jb.Accelerometer("lower", [0, 0, -0.5], axis=x),
        "phi": jb.sensors.Rotation("lower", axis="y"),
        "along x": jb.Acceleration("lower", [0, 0, -0.5], axis=x),
        "along z": jb.Acceleration("lower", [0, 0, -0.5], axis=z),
    }
    H = jb.frequency_response(lin, [0.3, 2.0], {"shake": jb.BaseMotion("base", "x")}, outputs)
    angle = float(lin.state.q.sum())
    e, across = (
        np.array([np.cos(angle), -np.sin(angle)]),
        np.array([-np.sin(angle), -np.cos(angle)]),
    )  # the axis in the world, and its change by a turn
    expected = (
        e[0] * H["along x", "shake"]
        + e[1] * H["along z", "shake"]
        + across[1] * G * H["phi", "shake"]
    )
    np.testing.assert_allclose(H["read", "shake"], expected, rtol=1e-10)


@pytest.mark.long
def test_a_loss_factor_with_a_sensor_of_forces_is_refused(chain):
    """Hysteresis is no part of what such a sensor reads: its force would silently be that of the
    spring alone."""
    lin = jb.linearize(chain, jb.equilibrium(chain))
    for sensor in (
        jb.sensors.Reaction("lower", component=0),
        jb.sensors.ForcePlate("base", component=0),
    ):
        with pytest.raises(jb.JaxbodyError, match="BAD_OPTION") as refused:
            jb.frequency_response(
                lin,
                [1.0],
                {"shake": jb.BaseMotion("base", "x")},
                {"force": sensor},
                loss_factor=0.1,
            )
        assert type(sensor).__name__ in str(refused.value) and "LoadCell" in str(refused.value)


@pytest.mark.long
def test_a_fit_takes_a_mass_from_a_hinge():
    """A hinge force is proportional to the mass of a pendulum, of which its motion
    knows nothing."""
    rod = jb.Body(mass=2.0, inertia=[0, 0, 0] + 1e-3 * np.ones(3), com=[0, 0, -0.6])
    model = jb.Model(
        bodies={"rod": rod}, joints={"rod": jb.Hinge("world", axis=[0, 1, 0])}, gravity=[0, 0, -G]
    )
    times, start = np.linspace(0, 0.5, 26), jb.State(jnp.array([0.7]), jnp.array([0.0]))
    sensors = {"hinge": jb.sensors.Reaction("rod")}
    measured = jb.measure(jb.simulate(model, times, initial=start), sensors)
    run = jb.Experiment(
        times, sensors=sensors, measured=measured, initial=start, noise={"hinge": [0.01, 0.01]}
    )
    with warnings.catch_warnings():
        warnings.simplefilter(
            "error", RuntimeWarning
        )  # the force across the plane of motion is zero throughout: it is correlated with nothing
        result = jb.fit(jb.replace(model, {"rod.mass": 1.7}), {"run": run}, free=["rod.mass"])
    np.testing.assert_allclose(result.model["rod"].mass, 2.0, rtol=1e-7)


@pytest.mark.long
def test_a_reaction_on_a_support_is_what_a_force_plate_reads_in_world_axes(chain):
    """The base is turned by 0.3 rad about y; the moment about another point of it is M - r x F."""
    turned = jb.replace(chain, {"base.orientation": [np.cos(0.15), 0, np.sin(0.15), 0]})
    r = np.array([0.1, -0.2, 0.3])
    sensors = {
        "plate": jb.sensors.ForcePlate("base"),
        "force": jb.sensors.Reaction("base"),
        "about r": jb.sensors.Reaction("base", r),
    }
    read = {
        name: np.asarray(x)[-1]
        for name, x in jb.measure(jb.simulate(turned, [0.0, 0.3]), sensors).items()
    }
    R = rigs.turned([np.cos(0.15), 0, np.sin(0.15), 0])
    F, M = R @ read["plate"][:3], R @ read["plate"][3:]
    np.testing.assert_allclose(read["force"], [*F, *M], rtol=0, atol=1e-12)
    np.testing.assert_allclose(read["about r"], [*F, *(M - np.cross(R @ r, F))], rtol=0, atol=1e-12)


@pytest.mark.long
@pytest.mark.parametrize(
    ("sensor", "code", "words"),
    [
        (jb.sensors.Reaction("nobody"), "UNKNOWN_NAME", "nobody upper lower"),
        (jb.sensors.Reaction("box"), "NO_JOINT", "box free joint LoadCell"),
        (jb.sensors.Reaction("upper", component=6), "BAD_COMPONENT", "component 6 upper"),
    ],
)
def test_a_reaction_of_no_joint_is_refused(chain, sensor, code, words):
    bodies = {
        "box": jb.Body(mass=1.0, inertia=[1, 1, 1]),
        **{name: chain[name] for name in ("upper", "lower")},
    }
    model = jb.Model(
        bodies=bodies,
        supports={"base": jb.Support()},
        joints={name: chain.joint(name) for name in ("upper", "lower")},
    )
    with pytest.warns(jb.JaxbodyWarning, match="UNATTACHED"):
        trajectory = jb.simulate(model, [0.0, 0.1])
    with pytest.raises(jb.JaxbodyError) as refused:
        jb.measure(trajectory, {"joint": sensor})
    assert refused.value.code == code and all(
        word in str(refused.value) for word in words.split()
    ), str(refused.value)
