"""Universal joints, cylindrical joints and planes: closed forms, the same joints as chains,
derivatives where angles are zero, files."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.integrate import solve_ivp

import jaxbody as jb
from jaxbody.mechanics.closed_loops import acceleration
from jaxbody.model.joints.frame_tables import frames_of

G = 9.81
jit_once = jb.jit  # compiling is the cost
BAR = jb.Body(mass=1.0, inertia=[1, 1, 1])


def test_a_mass_on_a_universal_joint_swings_by_the_equations_of_lagrange():
    """x = R_x(a) R_y(b) (0, 0, -l): T = m l^2 (b'^2 + cos^2 b a'^2)/2, V = -m g l cos a cos b."""
    l = 0.7
    bob = jb.Body(mass=2.0, com=[0, 0, -l])
    model = jb.Model(
        bodies={"bob": bob},
        joints={"bob": jb.joints.Universal("world", first="x", second="y")},
        gravity=[0, 0, -G],
    )

    def rates(t, y):
        a, b, u, w = y
        return [
            u,
            w,
            (2 * np.sin(b) * u * w - G / l * np.sin(a)) / np.cos(b),
            -np.sin(b) * np.cos(b) * u**2 - G / l * np.cos(a) * np.sin(b),
        ]

    start = [0.9, -0.5, 1.3, 2.0]
    times = np.linspace(0, 2, 21)
    exact = solve_ivp(rates, (0, 2), start, "DOP853", times, rtol=1e-12, atol=1e-12).y
    run = jb.simulate(
        model, times, initial=jb.State(np.array(start[:2]), np.array(start[2:])), rtol=1e-10
    )
    np.testing.assert_allclose(run.state.q.T, exact[:2], atol=1e-8)  # of both integrations


@pytest.mark.long
def test_a_shaft_in_a_plain_bearing_falls_along_it_and_spins_on():
    """Each motion by itself: g along the axis, and no moment about it."""
    n, m, offset, about = np.array([0.0, 0.6, 0.8]), 3.0, 0.2, 0.5
    shaft = jb.Body(mass=m, inertia=[about] * 3, com=[offset, 0, 0])
    at = jb.joints.Cylindrical("world", axis=n)
    model = jb.Model(bodies={"shaft": shaft}, joints={"shaft": at}, gravity=[0, 0, -G])
    lin = jb.linearize(model, model.reference)
    np.testing.assert_allclose(lin.M, np.diag([m, about + m * offset**2]), atol=1e-15)
    found = acceleration(model, jb.State(jnp.array([0.3, 0.4]), jnp.array([1.0, 2.0])))
    g = np.array([0.0, 0, -G])
    # of the center of mass by the angle
    across = np.cross(n, [np.cos(0.4) * offset, 0, 0] + np.sin(0.4) * np.cross(n, [offset, 0, 0]))
    np.testing.assert_allclose(found, [g @ n, m * g @ across / (about + m * offset**2)], rtol=1e-13)


@pytest.mark.long
def test_a_puck_moves_in_its_plane_as_a_rigid_body():
    """m (O'' + (phi'' z x r) - phi'^2 r) = F, (J + m r^2) phi'' + m r x O'' = r x F with F = m g at
    the center of mass."""
    m, J, c = 2.0, 0.3, np.array([0.2, 0.1])
    puck = jb.Body(mass=m, inertia=[1, 1, J], com=[*c, 0.4])
    g = np.array([1.0, -2.0])
    model = jb.Model(
        bodies={"puck": puck},
        joints={"puck": jb.joints.Planar("world", first="x", second="y")},
        gravity=[*g, -G],
    )
    angle, spin = 0.8, 3.0
    r = np.array([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]) @ c
    M = np.array([[m, 0, -m * r[1]], [0, m, m * r[0]], [-m * r[1], m * r[0], J + m * c @ c]])
    force = np.append(m * g + m * spin**2 * r, m * (r[0] * g[1] - r[1] * g[0]))
    state = jb.State(jnp.array([0.3, -0.2, angle]), jnp.array([0.5, 0.7, spin]))
    np.testing.assert_allclose(
        acceleration(model, state), np.linalg.solve(M, force), rtol=1e-13, atol=1e-14
    )


FIRST, SECOND, AT = (
    np.array([0.3, 1.0, -0.2]),
    np.array([0.9, -0.1, 0.6]),
    np.array([0.2, -0.1, 0.4]),
)
PLACES = {"puck": [0.5, 0.2, -0.3], "yoke": [1.0, 0.3, 0.2], "shaft": [1.2, 0.8, 0.3]}
JOINTS = {
    "puck": jb.joints.Planar("base", first=FIRST, second=SECOND),
    "yoke": jb.joints.Universal("puck", first=FIRST, second=SECOND, at=AT),
    "shaft": jb.joints.Cylindrical("yoke", axis=FIRST, at=AT),
}
NORMAL = np.cross(FIRST, SECOND)
CHAINS = {
    "puck": jb.joints.Composite(
        "base",
        ["move", "move", "turn"],
        directions=[FIRST, SECOND, NORMAL],
        points=[PLACES["puck"]] * 3,
    ),
    "yoke": jb.joints.Composite(
        "puck", ["turn", "turn"], directions=[FIRST, SECOND], points=[AT, AT]
    ),
    "shaft": jb.joints.Composite(
        "yoke", ["move", "turn"], directions=[FIRST, FIRST], points=[AT, AT]
    ),
}


def carried(joints):
    """Three bodies on each other and on a support, with springs."""
    at = {"com": [0.1, -0.2, 0.3], "inertia": [0.1, 0.2, 0.25]}
    ends = {
        "puck": ("base", [0.2, 1.0, 0.4]),
        "yoke": ("world", [1.0, -1.0, 0.4]),
        "shaft": ("base", [0.3, 1.0, 1.0]),
    }
    springs = {
        f"{name} spring": jb.Spring(
            (name, [0.3, 0.1, 0]), end, stiffness=200.0, free_length=0.6, damping=5.0
        )
        for name, end in ends.items()
    }
    bodies = {name: jb.Body(mass=2.0, position=place, **at) for name, place in PLACES.items()}
    return jb.Model(
        bodies=bodies,
        supports={"base": jb.Support()},
        joints=joints,
        elements=springs,
        gravity=[0.3, -0.4, -G],
    )


@pytest.mark.long
def test_they_move_as_chains_of_slides_and_hinges():
    one, other = map(carried, (JOINTS, CHAINS))
    n = one.layout.nv
    rng = np.random.default_rng(3)
    state = jb.State(jnp.asarray(rng.normal(size=n)), jnp.asarray(rng.normal(size=n)))
    np.testing.assert_allclose(acceleration(one, state), acceleration(other, state), rtol=1e-11)
    motion = {
        "base": jb.Harmonic(frequency=1.0, translation=[0.1, 0.05, 0], rotation=[0.1, 0, 0.2])
    }
    runs = [jb.simulate(model, [0.0, 0.2], initial=state, motion=motion) for model in (one, other)]
    read = [
        jb.measure(run, {name: jb.sensors.Reaction(name) for name in ("base", *PLACES)})
        for run in runs
    ]
    np.testing.assert_allclose(read[0]["base"], read[1]["base"], rtol=1e-9, atol=1e-9)
    for name in PLACES:  # moments are about the point of the joint; those of a chain about O
        forces = [np.asarray(each[name])[:, :3] for each in read]
        np.testing.assert_allclose(*forces, rtol=1e-9, atol=1e-9)
    lins = [jb.linearize(model, jb.equilibrium(model, start=state)) for model in (one, other)]
    for name in ("M", "C", "K", "M_tilde", "K_tilde"):
        np.testing.assert_allclose(
            getattr(lins[0], name), getattr(lins[1], name), rtol=1e-9, atol=1e-8
        )


@pytest.mark.long
def test_derivatives_are_exact_where_angles_are_zero_or_half_turns():
    """Of accelerations by coordinates and by the directions and points of the joints, in
    both modes."""
    model, fields = carried(JOINTS), ("puck.second", "yoke.first", "yoke.at", "shaft.axis")
    n = model.layout.nv
    v = jnp.linspace(0.5, 1.0, n)

    def f(x):
        parts = dict(zip(fields, x[n:].reshape(-1, 3), strict=True))
        return acceleration(jb.replace(model, parts), jb.State(x[:n], v)).sum()

    value, forward, reverse = (jit_once(g) for g in (f, jax.jacfwd(f), jax.grad(f)))
    h, own = 1e-5, jb.parameter_paths(model)
    for angle in (0.0, np.pi / 2, np.pi):
        start = jnp.concatenate(
            [np.where(model.layout.turns, angle, 0.0), *(own[field] for field in fields)]
        )
        scale = np.abs(forward(start)).max()
        np.testing.assert_allclose(forward(start), reverse(start), rtol=1e-10, atol=1e-10 * scale)
        differences = [
            (value(start + h * e) - value(start - h * e)) / (2 * h) for e in np.eye(len(start))
        ]
        np.testing.assert_allclose(forward(start), differences, rtol=1e-6, atol=1e-7 * scale)


@pytest.mark.long
def test_a_shaft_behind_a_universal_joint_turns_by_the_law_of_hooke():
    """tan(out) = tan(in) cos(bend), with the output turning about its own line at an angle to that
    of the input."""
    bend = np.deg2rad(35.0)
    line = np.array([np.cos(bend), np.sin(bend), 0.0])
    joints = {
        "input": jb.Hinge("world", axis="x", at=[0, 0, 0]),
        # its cross, drawn upright
        "output": jb.joints.Universal(
            "input", first="z", second=np.cross([0, 0, 1], line), at=[0, 0, 0]
        ),
    }
    bearing = jb.closures.Hinge(("world", line), ("output", line), axis=line)
    model = jb.Model(
        bodies=dict.fromkeys(joints, BAR), joints=joints, closures={"bearing": bearing}
    )
    turns = np.deg2rad([20.0, 60.0, 89.0])
    for turn in turns:
        done = jb.suspension.assemble(
            model, start=jb.State(jnp.array([turn, 0.1, -0.1]), jnp.zeros(3)), hold=["input"]
        )
        assert done.ok and done.freedoms == 1
        R = np.asarray(frames_of(model, done.state).R[model.layout.frame("output")])
        arm = R @ [0, 0, 1]  # that was upright, across the line of the output
        found = np.arctan2(arm @ np.cross(line, [0, 0, 1]), arm[2])
        np.testing.assert_allclose(
            found, np.arctan2(np.sin(turn) * np.cos(bend), np.cos(turn)), rtol=1e-11
        )


def test_bad_input():
    with pytest.raises(
        jb.JaxbodyError, match=r"Universal.second: is parallel to the first.*BAD_DIRECTION"
    ):
        jb.joints.Universal("world", first="x", second=[-2, 0, 0])
    with pytest.raises(jb.JaxbodyError, match=r"Planar.second.*ZERO_AXIS"):
        jb.joints.Planar("world", first="x", second=[0, 0, 0])
    with pytest.raises(jb.JaxbodyError, match=r"Cylindrical.axis.*BAD_DIRECTION"):
        jb.joints.Cylindrical("world", axis="w")
