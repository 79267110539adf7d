"""Equilibria from poor starts, messages where there is none, and the matrices of small motions
against their definitions."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
from rigs import max_difference

import jaxbody as jb
from jaxbody import Status
from jaxbody.mechanics.closed_loops import acceleration
from jaxbody.mechanics.equilibrium_solvers import eigenvalue_signs
from jaxbody.model.joints.kinematics import Coordinates

SIZE = 0.54  # of the plate: the corner farthest from O
STIFFEST = 320.0
RNG = np.random.default_rng(20)


def turn(phi):
    """The unit quaternion of a rotation vector."""
    angle = np.linalg.norm(phi)
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * phi / angle])


def directions(count):
    n = RNG.normal(size=(count, 3))
    return n / np.linalg.norm(n, axis=1, keepdims=True)


def largest_residual(result):
    """Of forces over stiffness x size and moments over stiffness x size^2."""
    return np.abs(
        np.asarray(result.residual) / (STIFFEST * SIZE * np.array([1, 1, 1, SIZE, SIZE, SIZE]))
    ).max()


@pytest.fixture(scope="module")
def plate():
    return rigs.plate()


@pytest.fixture(scope="module")
def hanging(plate):
    result = jb.equilibrium(plate)
    assert result.ok
    assert result.stable
    return result


@pytest.mark.usefixtures("batches")
def test_poor_starts_end_in_the_stable_equilibrium(plate, hanging):
    count = 200
    places = SIZE * RNG.uniform(0, 1, (count, 1)) * directions(count)
    turns = RNG.uniform(0, 1, (count, 1)) * directions(count)
    q = jnp.array([[*p, *turn(phi)] for p, phi in zip(places, turns, strict=True)])
    result = jax.vmap(lambda q: jb.equilibrium(plate, start=jb.State(q, jnp.zeros(6))))(q)
    print(
        "poor starts",
        largest_residual(result),
        int(result.steps.max()),
        max_difference(result.energy, np.full(count, hanging.energy)),
    )
    result.raise_if_failed()
    assert largest_residual(result) < 1e-10
    assert max_difference(result.state.q[:, :3], np.tile(hanging.state.q[:3], (count, 1))) < 1e-10
    assert (
        max_difference(
            rigs.turned(result.state.q[:, 3:]),
            np.tile(rigs.turned(hanging.state.q[3:]), (count, 1, 1)),
        )
        < 1e-10
    )


@jax.jit
@jax.vmap
def lowest_stiffness(model, q):
    """The smallest eigenvalue of the Hessian of V, rotations by exponentials of the test's own,
    over the largest."""

    def energy(x):
        angle = x[3:]
        # the half turn, exact to second order
        small = jnp.concatenate([jnp.array([1 - angle @ angle / 8]), angle / 2])
        w, v, a, b = small[0], small[1:], q[3], q[4:]
        product = jnp.concatenate([jnp.array([w * a - v @ b]), w * b + a * v + jnp.cross(v, b)])
        return jb.potential_energy(
            model, jb.State(jnp.concatenate([q[:3] + x[:3], product]), jnp.zeros(6))
        )

    values = jnp.linalg.eigvalsh(jax.hessian(energy)(jnp.zeros(6)))
    return values[0] / values[-1]


@pytest.mark.long
@pytest.mark.usefixtures("batches")
def test_no_model_ends_in_an_unstable_equilibrium_with_status_ok(plate):
    """Random springs, some compressed, on bodies of random weight, from reference poses far from
    an equilibrium."""
    count = 200
    ends = ("a", "b")
    points = {
        f"s{i}.{end}": np.stack(
            [RNG.normal(size=3) * (0.4 if end == "a" else 0.8) for _ in range(count)]
        )
        for i in range(5)
        for end in ends
    }
    values = points | {
        "*.stiffness": 10 ** RNG.uniform(1, 3, (count, 5)),
        "*.free_length": RNG.uniform(0, 1.5, (count, 5)),
        "plate.com": 0.2 * RNG.normal(size=(count, 3)),
        "gravity": 10 ** RNG.uniform(-1, 1.5, (count, 1)) * directions(count),
    }
    models = jax.vmap(lambda values: jb.replace(plate, values))(
        {name: jnp.array(value) for name, value in values.items()}
    )
    start = jax.vmap(lambda phi: jb.State(jnp.concatenate([jnp.zeros(3), phi]), jnp.zeros(6)))(
        jnp.array([turn(phi) for phi in directions(count)])
    )
    result = jax.vmap(lambda model, q: jb.equilibrium(model, start=jb.State(q, jnp.zeros(6))))(
        models, start.q
    )
    lowest = np.asarray(lowest_stiffness(models, result.state.q))
    ok = np.asarray(result.ok)
    print(
        "random models",
        ok.sum(),
        "of",
        count,
        "ok, lowest",
        lowest[ok].min(),
        "others",
        np.asarray(result.status)[~ok],
        lowest[~ok],
    )
    assert (lowest[ok] > 0).all()
    assert ok.sum() > 0.97 * count
    assert (np.asarray(result.stable) == ok).all()


def test_moving_everything_moves_the_equilibrium_along(plate, hanging):
    base = jb.Support(position=[3.0, -2.0, 5.0], orientation=turn(np.array([0.7, -1.1, 0.4])))
    Q, p = rigs.turned(base.orientation), np.asarray(base.position)
    moved = rigs.plate(
        base=base, position=p, orientation=base.orientation, gravity=Q @ [0, 0, -9.81]
    )
    result = jb.equilibrium(moved)
    assert result.ok
    assert max_difference(result.state.q[:3], p + Q @ hanging.state.q[:3]) < 1e-12
    assert (
        max_difference(rigs.turned(result.state.q[3:]), Q @ rigs.turned(hanging.state.q[3:]))
        < 1e-12
    )
    for name, elongation in hanging.elongations.items():
        assert abs(result.elongations[name] - elongation) < 1e-12
    one, other = jb.linearize(plate, hanging), jb.linearize(moved, result)
    T = np.kron(np.eye(2), Q)
    for letter in ("M", "C", "K", "M_tilde", "C_tilde", "K_tilde", "M_bb", "C_bb", "K_bb"):
        before, after = np.asarray(getattr(one, letter)), np.asarray(getattr(other, letter))
        assert max_difference(after, T @ before @ T.T) <= 1e-12 * np.abs(before).max(), letter
    assert max_difference(jb.modes(other).frequency / jb.modes(one).frequency, np.ones(6)) < 1e-12


def skew(v):
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def spring_stiffness(u, L, s, k, r_A):
    """(38) and (39) of the paper, elastic and geometric parts: what V'' and what V' of the
    elongation stand before."""
    U = np.concatenate([u, np.cross(r_A, u)])
    R = skew(r_A)
    second = np.block([[np.eye(3), R.T], [R, R @ R.T]])
    third = np.zeros((6, 6))
    third[3:, 3:] = R @ skew(u) + skew(u) @ R
    return k * np.outer(U, U), k * s / L * (second - np.outer(U, U)) - k * s / 2 * third


@pytest.mark.long
def test_stiffness_splits_into_elastic_geometric_and_gravity_parts_by_element(plate, hanging):
    """At the equilibrium and away from it, against the paper's formulas."""
    away = jb.State(jnp.array([0.1, -0.2, 0.05, *turn(np.array([0.3, -0.5, 0.8]))]), jnp.zeros(6))
    for state in (hanging.state, away):
        lin = jb.linearize(plate, state)
        scale = 1e-12 * np.abs(lin.K).max()
        p, R = np.asarray(state.q[:3]), rigs.turned(state.q[3:])
        elastic, geometric = lin.K_elastic_by_element, lin.K_geometric_by_element
        assert list(elastic) == list(geometric) == [f"s{i}" for i in range(5)]
        for name in elastic:
            spring = plate[name]
            r_A = R @ spring.a
            AB = np.asarray(spring.b) - p - r_A
            L = np.linalg.norm(AB)
            parts = spring_stiffness(
                AB / L, L, L - float(spring.free_length), float(spring.stiffness), r_A
            )
            assert max_difference(elastic[name], parts[0]) < scale
            assert max_difference(geometric[name], parts[1]) < scale
        r_C, u = R @ plate["plate"].com, np.array([0, 0, -1])
        by_weight = np.zeros((6, 6))
        by_weight[3:, 3:] = -(6.0 * 9.81 / 2) * (skew(r_C) @ skew(u) + skew(u) @ skew(r_C))
        assert max_difference(lin.K_gravity, by_weight) < scale
        assert max_difference(lin.K_elastic, sum(elastic.values())) < scale
        assert max_difference(lin.K_elastic + lin.K_geometric + lin.K_gravity, lin.K) < scale


# An arm on a hinge of the base, a box, a bushing between them


@pytest.fixture(scope="module")
def rig():
    return rigs.rig(mount=rigs.MOUNT)


def assert_second_derivatives(model, state):
    """M, C and K of a linearization are those of T, R and V."""
    n, nxi = model.layout.nv, model.layout.nxi

    @jax.jit
    def definition(model, state):
        def potential(x):
            return jb.potential_energy(
                model,
                jb.State(Coordinates(model).retract(state.q, x[:n]), state.v),
                xi=x[n:].reshape(-1, 6),
            )

        def kinetic(x):
            return jb.kinetic_energy(model, jb.State(state.q, x[:n]), xi_dot=x[n:].reshape(-1, 6))

        def rayleigh(x):
            return jb.dissipation(model, jb.State(state.q, x[:n]), xi_dot=x[n:].reshape(-1, 6))

        still, moving = jnp.zeros(n + nxi), jnp.concatenate([state.v, jnp.zeros(nxi)])
        return (
            jax.hessian(kinetic)(moving),
            jax.hessian(rayleigh)(moving),
            jax.hessian(potential)(still),
        )

    lin = jb.linearize(model, state)
    for letter, whole in zip("MCK", definition(model, state), strict=True):
        for block, expected in (
            ("", whole[:n, :n]),
            ("_tilde", -whole[:n, n:]),
            ("_bb", whole[n:, n:]),
        ):
            result = getattr(lin, letter + block)
            print(letter + block, max_difference(result, expected) / np.abs(expected).max())
            assert max_difference(result, expected) < 1e-12 * np.abs(expected).max(), letter + block
            assert np.abs(result).max() > 0
    split = lin.K_elastic + lin.K_geometric + lin.K_gravity
    assert max_difference(split, lin.K) < 1e-12 * np.abs(lin.K).max()
    return lin


@pytest.mark.long
def test_matrices_are_second_derivatives_of_the_energies_at_any_state(rig):
    q = Coordinates(rig).retract(rig.reference.q, jnp.array([0.1, -0.05, 0.2, 0.6, -0.9, 0.4, 0.5]))
    lin = assert_second_derivatives(rig, jb.State(q, jnp.array(RNG.normal(size=rig.layout.nv))))
    assert set(lin.K_elastic_by_element) == {"s0", "s1", "s2", "s3", "s4", "mount"}


@pytest.mark.long
def test_matrices_of_an_arm_on_a_bushing_are_second_derivatives_of_its_energies():
    """The same for one body on a hinge, at a large rotation from the axes of its mount, with a
    spring to the world."""
    p = rigs.PARAMETERS
    mount = {**rigs.MOUNT, "orientation": rigs.unit(rigs.MOUNT["orientation"])}
    model = jb.Model(
        bodies={
            "arm": jb.Body(
                mass=0.8, inertia=p["inertia"][1], com=p["com"][1], position=[0.1, -0.1, -0.2]
            )
        },
        supports={
            "base": jb.Support(position=p["position"], orientation=rigs.unit(p["orientation"]))
        },
        joints={"arm": jb.Hinge("base", axis=p["axis"], at=p["at"])},
        elements={
            "mount": jb.Bushing(("arm", [0.3, 0.0, 0.3]), ("base", [0.1, 0.05, -0.1]), **mount),
            "stay": jb.Spring(
                ("arm", [0.2, 0.1, 0.0]),
                ("world", [1.0, 0.5, 0.2]),
                stiffness=60.0,
                free_length=0.4,
                damping=2.0,
            ),
        },
        gravity=p["gravity"],
    )
    assert_second_derivatives(model, jb.State(jnp.array([0.7]), jnp.array([-1.1])))


class Parabola(jb.inputs.Motion):
    """Xi(t) = xi + t xi' + t^2/2 xi''."""

    terms: tuple[jax.Array, jax.Array, jax.Array]

    def __call__(self, t):
        xi, rate, second = self.terms
        return xi + t * rate + t**2 / 2 * second


@pytest.mark.long
def test_matrices_are_the_derivatives_of_the_equations_of_motion(rig):
    """M Delta'' + C Delta' + K Delta = K~ Xi + C~ Xi' + M~ Xi'' about the equilibrium."""
    result = jb.equilibrium(rig)
    assert result.ok
    lin = jb.linearize(rig, result)
    n = rig.layout.nv

    @jax.jit
    @jax.jacfwd
    def slopes(x, model, state):
        delta, v, *terms = jnp.split(x, [n, 2 * n, 2 * n + 6, 2 * n + 12])
        moved = jb.State(Coordinates(model).retract(state.q, delta), v)
        return acceleration(model, moved, 0.0, (Parabola(tuple(terms)),))

    S = np.split(
        np.asarray(lin.M @ slopes(jnp.zeros(2 * n + 18), rig, result.state)),
        [n, 2 * n, 2 * n + 6, 2 * n + 12],
        axis=1,
    )
    for slope, expected in zip(
        S, (-lin.K, -lin.C, lin.K_tilde, lin.C_tilde, lin.M_tilde), strict=True
    ):
        print("equations of motion", max_difference(slope, expected) / np.abs(expected).max())
        assert max_difference(slope, expected) < 1e-12 * np.abs(expected).max()


# Closed forms


def pendulum(*, upright=False, mass=1.3, length=0.4, gravity=9.81):
    up = 1 if upright else -1
    bob = jb.Body(mass=mass, inertia=[0.02, 0.03, 0.04], com=[0, 0, up * length])
    return jb.Model(
        bodies={"bob": bob},
        joints={"bob": jb.Hinge("world", axis=[0, 1, 0])},
        gravity=[0, 0, -gravity],
    )


def test_pendulum_has_the_frequency_of_the_textbook():
    model = pendulum()
    result = jb.equilibrium(model)
    assert result.ok
    lin = jb.linearize(model, result)
    assert abs(lin.K_gravity[0, 0] / (1.3 * 9.81 * 0.4) - 1) < 1e-12
    assert max_difference(lin.K, lin.K_gravity) < 1e-12
    exact = np.sqrt(1.3 * 9.81 * 0.4 / (0.03 + 1.3 * 0.4**2)) / (2 * np.pi)
    assert abs(jb.modes(lin).frequency[0] / exact - 1) < 1e-12


def test_an_inverted_pendulum_started_upright_is_unstable():
    model = pendulum(upright=True)
    with pytest.warns(jb.JaxbodyWarning, match="1 negative eigenvalue") as caught:
        result = jb.equilibrium(model)
    assert [w.message.code for w in caught] == ["UNSTABLE"]
    assert (int(result.status), bool(result.ok), bool(result.stable), int(result.negative)) == (
        Status.UNSTABLE,
        False,
        False,
        1,
    )
    assert result.state.q[0] == 0
    with pytest.raises(jb.JaxbodyError, match="unstable"):
        result.raise_if_failed()
    with pytest.warns(jb.JaxbodyWarning, match="UNSTABLE"):
        modes = jb.modes(jb.linearize(model, result))
    assert np.isnan(modes.frequency[0])
    assert modes.eigenvalues[0] < 0


def test_pendulum_started_off_the_upright_falls():
    result = jb.equilibrium(pendulum(upright=True), start=jb.State(jnp.array([1e-3]), jnp.zeros(1)))
    assert result.ok
    assert abs(result.state.q[0] - np.pi) < 1e-12


def bead(*, mass=0.4, stiffness=500.0, free_length=0.7, angle=0.0, to=1.0):
    """A bead on a guide through the middle of a string along x; the guide at an angle to the normal
    of the string."""
    ends = {
        f"half {x:+d}": jb.Spring(
            ("bead", [0, 0, 0]),
            ("world", [x * to, 0, 0]),
            stiffness=stiffness,
            free_length=free_length,
        )
        for x in (1, -1)
    }
    joints = {"bead": jb.Guide("world", axis=[np.sin(angle), np.cos(angle), 0])}
    return jb.Model(
        bodies={"bead": jb.Body(mass=mass, inertia=[1, 1, 1])}, joints=joints, elements=ends
    )


@pytest.mark.parametrize("angle", [0.0, 0.6])
def test_bead_on_a_tensioned_string_has_the_frequency_of_the_textbook(angle):
    model = bead(angle=angle)
    lin = jb.linearize(model, model.reference)
    tension = 500.0 * 0.3
    elastic, geometric = 2 * 500.0 * np.sin(angle) ** 2, 2 * tension * np.cos(angle) ** 2
    assert abs(lin.K_elastic[0, 0] - elastic) < 1e-12 * lin.K[0, 0]
    assert abs(lin.K_geometric[0, 0] - geometric) < 1e-12 * lin.K[0, 0]
    assert (
        abs(jb.modes(lin).frequency[0] / (np.sqrt((elastic + geometric) / 0.4) / (2 * np.pi)) - 1)
        < 1e-12
    )


# Messages where there is no stable equilibrium


def test_body_on_one_spring_sags_by_its_weight_and_is_free_to_turn():
    body = jb.Body(mass=2.0, inertia=[0.1, 0.2, 0.3], com=[0, 0, -0.3], position=[0, 0, -0.6])
    model = rigs.hung(body, stiffness=400.0, free_length=0.5, gravity=[0, 0, -9.81])
    with pytest.warns(jb.JaxbodyWarning) as caught:
        result = jb.equilibrium(model)
    assert [w.message.code for w in caught] == ["SINGULAR_K"]
    assert "'body' free to turn about z" in str(caught[0].message)
    assert "free to turn about x" not in str(caught[0].message)
    assert int(result.status) == Status.SINGULAR_K
    assert bool(result.stable)
    assert abs(result.elongations["spring"] - 2 * 9.81 / 400) < 1e-12


def on_a_line(plate, below):
    """The plate with all its springs on its x axis, its weight that far below."""
    x = np.array([0.4, 0.4, -0.4, -0.4, 0.0])
    b = np.array(
        [[0.4, 0.8, 0.6], [0.4, -0.8, 0.6], [-0.4, 0.8, 0.6], [-0.4, -0.8, 0.6], [0, 0, -1.0]]
    )
    places = {f"s{i}.a": np.array([x[i], 0, 0]) for i in range(5)} | {
        f"s{i}.b": b[i] for i in range(5)
    }
    return jb.replace(
        plate,
        {
            **places,
            "*.stiffness": 300.0,
            "*.free_length": 0.9,
            "plate.com": [0, 0, -below],
            "*.mass": 6.0,
        },
    )


def test_plate_on_a_line_of_springs_is_free_to_turn_about_the_line(plate):
    with pytest.warns(jb.JaxbodyWarning) as caught:
        result = jb.equilibrium(on_a_line(plate, 0.0))
    assert [w.message.code for w in caught] == ["SINGULAR_K"]
    assert str(caught[0].message).count("'plate' free to") == 1
    assert "'plate' free to turn about x" in str(caught[0].message)
    assert int(result.status) == Status.SINGULAR_K
    with pytest.warns(jb.JaxbodyWarning, match="1 mode of zero frequency"):
        modes = jb.modes(jb.linearize(result.model, result))
    assert modes.frequency[0] == 0
    assert (modes.frequency[1:] > 0).all()


@pytest.mark.parametrize(
    ("below", "status"), [(1e-12, Status.SINGULAR_K), (1e-6, Status.OK), (-1e-6, Status.UNSTABLE)]
)
def test_nearly_singular_stiffness_is_reported_before_it_is_inaccurate(plate, below, status):
    """The weight hardly resists the turn: 6 kg 9.81 m/s2 below = K, against some 1e3 N/m of
    the springs."""
    model = on_a_line(plate, below)
    if status == Status.OK:
        assert jb.equilibrium(model).ok
        return
    with pytest.warns(jb.JaxbodyWarning) as caught:
        result = jb.equilibrium(model)
    assert int(result.status) == status
    assert caught[0].message.code == status.name


def test_an_unattached_body_has_no_equilibrium():
    bodies = {
        name: jb.Body(mass=1.0, inertia=[1, 1, 1], position=[i, 0, 0])
        for i, name in enumerate(("tank", "pump", "engine"))
    }
    elements = {
        "pipe": jb.Spring(("tank", [0, 0, 0]), ("pump", [0, 0, 0]), stiffness=1.0),
        "mount": jb.Bushing(("engine", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=[1, 1, 1]),
    }
    with pytest.raises(jb.JaxbodyError, match=r"'tank'.*no path") as error:
        jb.equilibrium(jb.Model(bodies=bodies, elements=elements))
    assert [(p.code, p.value) for p in error.value.problems] == [
        ("UNATTACHED", "tank"),
        ("UNATTACHED", "pump"),
    ]


def test_a_search_with_too_few_steps_reports_its_residual(plate):
    start = jb.State(jnp.array([0.3, 0.2, -0.3, *turn(np.array([0.5, 0.5, -0.4]))]), jnp.zeros(6))
    with pytest.warns(
        jb.JaxbodyWarning, match=r"after 3 steps the largest residual is .* N.* in 'plate' \("
    ) as caught:
        result = jb.equilibrium(plate, start=start, max_steps=3)
    assert [w.message.code for w in caught] == ["NOT_CONVERGED"]
    assert (int(result.status), bool(result.ok), bool(result.stable)) == (
        Status.NOT_CONVERGED,
        False,
        False,
    )
    with pytest.warns(jb.JaxbodyWarning, match="NOT_CONVERGED"):
        assert int(jb.modes(jb.linearize(plate, result)).status) == Status.NOT_CONVERGED


@pytest.mark.long
def test_derivative_through_a_failed_or_singular_equilibrium_is_nan():
    """A bead on a guide under its weight; with an unstressed string across the guide it is free
    to move."""

    def place(stiffness, free_length, gravity, max_steps):
        model = jb.replace(
            bead(),
            {
                "*.stiffness": stiffness,
                "*.free_length": free_length,
                "gravity": jnp.stack([0.0, gravity, 0.0]),
            },
        )
        result = jb.equilibrium(model, max_steps=max_steps)
        lin = jb.linearize(model, result)
        return result.state.q[0], (result.state.q[0], result.status, lin.K[0, 0])

    def frequency(*args):
        return place(*args)[1][2]

    @eqx.filter_jit
    def slopes(*args):
        return jax.grad(place, (0, 1, 2), has_aux=True)(*args), jax.jvp(
            lambda *x: frequency(*x, args[3]), args[:3], (1.0, 0.0, 0.0)
        )[1]

    (reverse, (q, status, K)), forward = slopes(500.0, 0.7, 9.81 / 2, jnp.array(200))
    assert int(status) == Status.OK
    L = np.hypot(1, q)
    # the force balance that the search must have met
    exact = 2 * 500 * (1 - 0.7 / L) * q - 0.4 * 9.81 / 2
    assert abs(exact) < 1e-10
    assert max_difference(K, 2 * 500 * (1 - 0.7 / L**3)) < 1e-9
    assert max_difference(reverse[0], -2 * (1 - 0.7 / L) * q / K) < 1e-12
    assert np.isfinite(forward)
    for args, code in (
        ((500.0, 0.7, 9.81, jnp.array(1)), Status.NOT_CONVERGED),
        ((500.0, 1.0, 0.0, jnp.array(200)), Status.SINGULAR_K),
    ):
        (reverse, (_, status, _)), forward = slopes(*args)
        assert int(status) == code
        assert np.isnan(reverse).all()
        assert np.isnan(forward)


@pytest.mark.long
def test_an_equilibrium_of_another_model_is_not_linearized(plate, hanging):
    """Of other bodies it is refused; of the same model with other numbers it is STALE, where they
    matter at rest: damping and stiffness without tension do not."""
    with pytest.raises(
        jb.JaxbodyError, match=r"linearize.at: is of a model with other bodies.*OTHER_MODEL"
    ):
        jb.linearize(bead(), hanging)
    for changed in (
        {"s0.stiffness": 1.01 * plate["s0"].stiffness},
        {"plate.mass": 6.1},
        {"gravity": [0, 0, -9.8]},
    ):
        with pytest.warns(
            jb.JaxbodyWarning, match=r"the state is not an equilibrium of this model.*again.*STALE"
        ):
            lin = jb.linearize(jb.replace(plate, changed), hanging)
        assert int(lin.status) == Status.STALE
    with pytest.warns(jb.JaxbodyWarning, match="STALE"):
        assert int(jb.modes(lin).status) == Status.STALE
    assert int(jb.linearize(jb.replace(plate, {"*.damping": 7.0}), hanging).status) == 0
    masses = jnp.array([6.0, 6.1])
    statuses = jax.jit(
        jax.vmap(lambda m: jb.linearize(jb.replace(plate, {"plate.mass": m}), hanging).status)
    )(masses)
    assert statuses.tolist() == [0, Status.STALE]


@pytest.mark.parametrize(
    ("eigenvalues", "negative", "singular"),
    [
        ([1, 2, 3], 0, False),
        ([0, 0, 0], 0, True),
        ([1, 0, 2], 0, True),
        ([-1, 2, 3], 1, False),
        ([-1, -2, 0], 2, True),
        ([1, 1, 1e-12], 0, True),
        ([1, 1, -1e-12], 0, True),
        ([1, 1, 1e-8], 0, False),
        ([1, 1, -1e-8], 1, False),
        ([-5, -5, -5], 3, False),
    ],
)
def test_signs_of_a_stiffness_are_those_of_its_eigenvalues(eigenvalues, negative, singular):
    Q = np.linalg.qr(np.random.default_rng(1).normal(size=(3, 3)))[0]
    for K in (np.diag(eigenvalues), Q * eigenvalues @ Q.T):
        assert tuple(map(int, eigenvalue_signs(jnp.asarray((K + K.T) / 2, float)))) == (
            negative,
            singular,
        )


def test_a_model_in_which_nothing_moves_has_forces_at_rest_and_no_vibrations():
    """Weight of 2 kg and its moment about the support, 0.5 m beside it."""
    body = jb.Body(mass=2.0, inertia=[1, 1, 1], position=[0.5, 0, 0])
    model = jb.Model(
        bodies={"box": body},
        supports={"table": jb.Support()},
        joints={"box": jb.Fixed("table")},
        gravity=[0, -9.81, 0],
    )
    eq = jb.equilibrium(model)
    assert eq.ok and eq.residual.shape == (0,)
    np.testing.assert_allclose(eq.on_supports[0], [0, -2 * 9.81, 0, 0, 0, -9.81], atol=1e-12)
    assert float(
        jax.grad(lambda model: jb.equilibrium(model).on_supports[0, 1])(model)["box"].mass
    ) == pytest.approx(-9.81)
    for function in (
        jb.linearize,
        jb.vibration.linearize_spin,
        lambda model, state: jb.simulate(model, [0.0, 1.0], initial=state),
    ):
        with pytest.raises(jb.JaxbodyError, match=r"no body that can move.*NOTHING_MOVES"):
            function(model, eq.state)


def failing(function, x):
    """The function, its derivatives in both modes, and all of them compiled, at x; where the search
    fails outside jit it warns."""
    both = jax.jacfwd(function), jax.jacrev(function)
    return [*(of(x) for of in both), *(jax.jit(of)(x) for of in (function, *both))]


@pytest.mark.nan
@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_what_a_search_did_not_find_is_nan_while_traced():
    """A mass of -300 kg, too few steps, a load beyond the limit point of an arch; outside jit the
    last state remains, with a warning."""
    spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=981.0, free_length=1.0)
    slider = {
        "bodies": {"mass": jb.Body(2.0, [1, 1, 1])},
        "joints": {"mass": jb.Guide("world", axis="y")},
        "gravity": [0, -9.81, 0],
    }
    model = jb.Model(**slider, elements={"spring": spring})
    heavy = jax.jit(lambda m: jb.equilibrium(jb.replace(model, {"mass.mass": m})))(-300.0)
    assert heavy.status == Status.NOT_CONVERGED
    assert heavy.report().startswith("NOT_CONVERGED: ")
    for x in (
        heavy.state.q,
        heavy.state.v,
        heavy.energy,
        heavy.elongations["spring"],
        heavy.forces["spring"],
    ):
        assert np.isnan(x).all()
    for part in (lambda eq: eq.state.q, lambda eq: eq.energy, lambda eq: eq.forces["spring"]):
        few = lambda m, part=part: part(  # noqa: E731
            jb.equilibrium(jb.replace(model, {"mass.mass": m}), max_steps=0)
        )
        assert all(np.isnan(x).all() for x in failing(few, 2.0))
    assert float(jb.equilibrium(model, max_steps=0).state.q[0]) == 0.0  # where it ended

    ends = {
        name: jb.Spring(
            ("top", [0, 0, 0]), ("world", [x, 0, 0]), stiffness=100.0, free_length=1.04**0.5
        )
        for name, x in [("a", 1), ("b", -1)]
    }
    top = {
        "bodies": {"top": jb.Body(1e-6, [1, 1, 1], position=[0, 0.2, 0])},
        "joints": {"top": jb.Guide("world", axis="y")},
    }
    arch = jb.Model(**top, elements=ends)
    pushed = lambda F: {("push"): jb.Force("top", force=jnp.array([0.0, -1.0, 0.0]) * F)}  # noqa: E731
    assert all(
        np.isnan(x).all()
        for x in failing(lambda F: jb.equilibrium(arch, loads=pushed(F)).state.q, 10.0)
    )
    kept = jb.equilibrium(arch, loads=pushed(10.0))
    assert kept.status == Status.LIMIT_POINT
    assert kept.state.q[0] < -0.05


@pytest.mark.nan
@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_a_case_that_cannot_be_carried_is_nan_while_traced_and_leaves_the_others_alone():
    model = jb.Model(
        bodies={"top": jb.Body(1e-6, [1, 1, 1], position=[0, 0.2, 0])},
        joints={"top": jb.Guide("world", axis="y")},
        elements={
            n: jb.Spring(
                ("top", [0, 0, 0]), ("world", [x, 0, 0]), stiffness=100.0, free_length=1.04**0.5
            )
            for n, x in [("a", 1), ("b", -1)]
        },
    )

    def heights(F):
        cases = {
            str(part): jb.LoadCase(
                loads={"push": jb.Force("top", force=jnp.array([0, -part, 0]) * F)}
            )
            for part in (1.0, 0.01)
        }
        return jb.load_cases(model, cases).displacements["top"][:, 1]

    h = 1e-4
    assert np.isfinite(heights(10.0)).all()
    difference = (heights(10.0 + h)[1] - heights(10.0 - h)[1]) / (2 * h)
    for slope in (
        jax.jacfwd(heights)(10.0),
        jax.jacrev(heights)(10.0),
        jax.jit(jax.jacfwd(heights))(10.0),
        jax.jit(jax.jacrev(heights))(10.0),
    ):
        assert np.isnan(slope[0])
        np.testing.assert_allclose(slope[1], difference, rtol=1e-7)
    np.testing.assert_array_equal(np.isnan(jax.jit(heights)(10.0)), [True, False])


@pytest.mark.nan
@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
def test_a_preload_that_balances_nothing_is_nan_while_traced():
    spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=981.0, free_length=1.0)
    model = jb.Model(
        bodies={"mass": jb.Body(2.0, [1, 1, 1])}, elements={"spring": spring}, gravity=[0, -9.81, 0]
    )

    def length(g):
        return jb.preload(
            jb.replace(model, {"gravity": jnp.array([0.0, -9.81, 0.0]).at[0].set(g)})
        ).values

    np.testing.assert_allclose(length(5.0), [0.98])  # as before, with the residual of the warning
    assert all(np.isnan(x).all() for x in failing(length, 5.0))
    assert all(np.isfinite(x).all() for x in failing(length, 0.0))


def test_what_looks_like_wrong_geometry_is_named_beside_an_ok_status():
    """A pendulum of 0.5 m that is drawn sideways: its end is sqrt 2 times that away, turned by
    90 degrees. Mounts drawn apart or turned."""
    bob = jb.Body(2.0, [0.1, 0.1, 0.1], com=[0.5, 0, 0])
    turned = jb.Bushing(
        ("bob", [0, 0, 0]),
        ("world", [0, 0, 0]),
        stiffness=np.diag([0, 0, 0, 0, 1e-3, 0]),
        orientation_b=jb.EulerAngles("Y", [0.2]),
    )
    aslant = jb.Torsion(
        "bob", "world", axis="y", damper=1.0, orientation_b=jb.EulerAngles("X", [0.3])
    )
    parts = {
        "bodies": {"bob": bob},
        "joints": {"bob": jb.Hinge("world", axis="y")},
        "gravity": [0, 0, -9.81],
    }
    eq = jb.equilibrium(jb.Model(**parts, elements={"turned": turned, "aslant": aslant}))
    assert eq.ok and eq.remarks == [
        "bushing 'turned' is drawn turned by 11.5 degrees between its ends",
        "torsion 'aslant' has axes that are drawn turned by 17.2 degrees between its ends",
        "the equilibrium is far from the drawn pose: 'bob' is 0.707 m and 90 degrees from it",
    ]
    assert all(said in str(eq) for said in eq.remarks)
    away = jb.Bushing(("bob", [0.5, 0, 0]), ("world", [0.5, 0, 0.25]), stiffness=[1e4, 1e4, 1e4])
    assert (
        jb.equilibrium(jb.Model(**parts, elements={"away": away})).remarks[0]
        == "bushing 'away' is drawn 0.25 m apart"
    )
    held = jb.equilibrium(
        jb.Model(
            **parts,
            elements={"spring": jb.Torsion("bob", "world", axis="y", spring=1e3, free_angle=0.2)},
        )
    )
    assert held.remarks == []  # a preload is no fault


def test_where_a_body_is_drawn_leaves_derivatives_as_they_are():
    """d(height)/dg = -m/k of a mass at its drawn place, where the distance from there has
    no derivative."""

    def height(g):
        spring = jb.Spring(("m", [0, 0, 0]), ("world", [0, 0, 1]), stiffness=50.0, free_length=1.0)
        model = jb.Model(
            bodies={"m": jb.Body(2.0, [1, 1, 1])},
            joints={"m": jb.Guide("world", axis="z")},
            elements={"s": spring},
        )
        return jb.equilibrium(
            jb.replace(model, {"gravity": jnp.stack([0 * g, 0 * g, -g])})
        ).state.q[0]

    np.testing.assert_allclose(jax.grad(height)(0.0), -2 / 50, rtol=1e-12)
