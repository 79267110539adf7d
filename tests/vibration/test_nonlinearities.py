"""Backbones against exact periods, periodic motions by shooting in SciPy, other coordinates, and
modes without a backbone."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import rigs
from rigs import max_difference
from scipy.integrate import quad, solve_ivp
from scipy.optimize import brentq
from scipy.spatial.transform import Rotation
from scipy.special import ellipk

import jaxbody as jb
from jaxbody import Status


def backbones(model):
    return jb.vibration.backbone_curves(jb.linearize(model, jb.equilibrium(model)))


def extrapolated(values):
    """The limit at a = 0 of values at a, a/2, a/4 ..., which go as a power series of a^2."""
    values = np.asarray(values)
    for order in range(1, len(values)):
        values = (4.0**order * values[1:] - values[:-1]) / (4.0**order - 1)
    return values[0]


def curvature(frequency, amplitude, levels):
    """(w(a)/w(0) - 1)/a^2 at a -> 0 from exact frequencies at a few amplitudes; also w(0)
    is extrapolated."""
    a = amplitude / 2.0 ** np.arange(levels)
    w = np.array([frequency(x) for x in a])
    return extrapolated((w[:-1] - w[1:]) / (a[:-1] ** 2 - a[1:] ** 2)) / extrapolated(w)


# One degree of freedom: exact periods


def test_a_pendulum_has_the_slope_of_the_elliptic_integral():
    """w = w0 pi/(2 K(sin^2(a/2))), which begins 1 - a^2/16."""
    bob = jb.Body(mass=1.3, inertia=[0.02, 0.03, 0.04], com=[0, 0, -0.4])
    result = backbones(
        jb.Model(
            bodies={"bob": bob},
            joints={"bob": jb.Hinge("world", axis=[0, 1, 0])},
            gravity=[0, 0, -9.81],
        )
    )
    exact = curvature(lambda a: np.pi / (2 * ellipk(np.sin(a / 2) ** 2)), 0.4, levels=4)
    print("pendulum", result.curvature[0] / exact - 1, result.curvature[0] * -16 - 1)
    assert abs(result.curvature[0] / exact - 1) < 1e-8  # what the extrapolation leaves
    assert abs(result.curvature[0] * -16 - 1) < 1e-13
    weight = 1.3 * 9.81 * 0.4
    assert (
        max_difference(
            [result.stiffness[0], result.third[0], result.fourth[0]], [weight, 0, -weight]
        )
        < 1e-13 * weight
    )
    assert abs(result.force_within(5.0)[0] / np.sqrt(6 * 0.05) - 1) < 1e-13  # sin a = a (1 - a^2/6)
    assert abs(result.frequency_within(5.0)[0] / np.sqrt(16 * 0.05) - 1) < 1e-13
    assert abs(result.at(0.1)[0] / result.frequency[0] - (1 - 0.01 / 16)) < 1e-13


def bead(l0, angle):
    """A bead on a guide through the middle of a string of two halves along x; the guide at an angle
    to the normal of the string."""
    joints = {"bead": jb.Guide("world", axis=[np.sin(angle), np.cos(angle), 0])}
    ends = {
        f"half {x:+d}": jb.Spring(
            ("bead", [0, 0, 0]), ("world", [x, 0, 0]), stiffness=500.0, free_length=free
        )
        for x, free in zip((1, -1), l0, strict=True)
    }
    return jb.Model(
        bodies={"bead": jb.Body(mass=0.4, inertia=[1, 1, 1])}, joints=joints, elements=ends
    )


@pytest.mark.long
@pytest.mark.parametrize(("l0", "angle"), [((0.7, 0.7), 0.0), ((0.7, 0.8), 0.6)])
def test_a_bead_on_a_string_has_the_slope_of_the_energy_integral(l0, angle):
    """T = 2 integral of dq/sqrt(2 (E - V)/m) between turning points q1, q2;
    E - V = (q - q1)(q2 - q) V[q1, q2, q], a divided difference.

    V = k/2 sum (L - l0)^2, and those of L follow from those of its square, q^2 -+ 2 q
    sin(angle) + 1, without small differences."""
    halves = list(zip((1, -1), l0, strict=True))

    def length(side, x):
        return np.sqrt(x**2 + 1 - 2 * side * x * np.sin(angle))

    def first(side, x, y):
        return (x + y - 2 * side * np.sin(angle)) / (length(side, x) + length(side, y))

    def slope(x, y):
        return sum(
            250.0 * first(side, x, y) * (length(side, x) + length(side, y) - 2 * free)
            for side, free in halves
        )

    def second(x, y, z):
        return sum(
            250.0
            * (
                1
                - 2
                * free
                * (1 - first(side, x, y) * first(side, y, z))
                / (length(side, x) + length(side, z))
            )
            for side, free in halves
        )

    def frequency(a):
        middle = brentq(lambda x: slope(x - a, x + a), -0.3, 0.3, xtol=1e-16)

        def speed(u):
            return 1 / np.sqrt(2 * second(middle - a, middle + a * np.sin(u), middle + a) / 0.4)

        return np.pi / quad(speed, -np.pi / 2, np.pi / 2, epsabs=0, epsrel=1e-13)[0]

    result = backbones(bead(l0, angle))
    exact = curvature(frequency, 0.08, levels=4)
    print("bead", result.curvature[0] / exact - 1, result.third[0])
    assert abs(frequency(1e-6) / (2 * np.pi) / result.frequency[0] - 1) < 1e-10
    assert abs(result.curvature[0] / exact - 1) < 1e-7  # what the extrapolation leaves
    assert (abs(result.third[0]) > 1) == (angle > 0)


class Law(jb.Element):
    """V = sum k_i x_i^2/2 + alpha x^3/3 + beta x^4/4 + c x^2 y + r (x - y)^2/2 + s (x - y)^3/3 of
    the place (x, y, z) of a body."""

    k: jax.Array
    rest: jax.Array

    def __init__(self, k, alpha=0.0, beta=0.0, c=0.0, r=0.0, s=0.0):
        self.between, self.a, self.b = ("c", "world"), jnp.zeros(3), jnp.zeros(3)
        self.k, self.rest = jnp.array(k, float), jnp.array([alpha / 3, beta / 4, c, r / 2, s / 3])

    def deformation(self, A, B):
        return A.p

    def energy(self, e):
        x, y, _ = e
        return jnp.sum(self.k * e**2) / 2 + jnp.sum(
            self.rest * jnp.stack([x**3, x**4, x**2 * y, (x - y) ** 2, (x - y) ** 3])
        )

    def dissipation(self, e, e_dot):
        return jnp.zeros(())


# of the place along x, y and z, which three guides on each other carry
MASS = np.array([3.0, 2.0, 1.0])


def places(*args, **laws):
    bodies = {name: jb.Body(mass=1.0, inertia=[1, 1, 1]) for name in "abc"}
    parents = {"a": "world", "b": "a", "c": "b"}
    joints = {
        name: jb.Guide(parent, axis=axis)
        for (name, parent), axis in zip(parents.items(), np.eye(3), strict=True)
    }
    model = jb.Model(bodies=bodies, joints=joints, elements={"law": Law(*args, **laws)})
    return jb.linearize(model, model.reference)


def test_duffing_has_the_slope_of_the_elliptic_integral():
    """w(a) = pi sqrt(w^2 + b a^2)/(2 K(m)), m = b a^2/(2 (w^2 + b a^2)), for x'' + w^2
    x + b x^3 = 0."""

    def duffing(a, square=1.5, b=2.0):
        return (
            np.pi * np.sqrt(square + b * a**2) / (2 * ellipk(b * a**2 / (2 * (square + b * a**2))))
        )

    exact = curvature(duffing, 0.2, levels=5)
    result = jb.vibration.backbone_curves(places(MASS * [1.5, 10.0, 70.0], beta=2.0 * MASS[0]))
    print("Duffing", result.curvature[0] / exact - 1)
    assert abs(result.curvature[0] / exact - 1) < 1e-8  # what the extrapolation leaves
    assert max_difference(result.curvature, [3 * 2.0 / (8 * 1.5), 0, 0]) < 1e-13
    assert (
        np.isinf(result.frequency_within(5.0)[1:]).all()
        and np.isinf(result.force_within(5.0)[1:]).all()
    )


def test_quadratic_terms_of_the_textbook():
    """x'' + w^2 x + alpha x^2 + beta x^3 = 0, and what a mode y, driven by x^2, adds: y0 = -c/(2
    k), y2 = -c/(2 (k - 4 w^2 m)) per a^2, x'' + w^2 x + 2 c x y/m = 0."""
    result = jb.vibration.backbone_curves(
        places(MASS * [2.25, 10.0, 70.0], alpha=1.7 * MASS[0], beta=0.6 * MASS[0])
    )
    assert (
        abs(result.curvature[0] / (3 * 0.6 / (8 * 2.25) - 5 * 1.7**2 / (12 * 2.25**2)) - 1) < 1e-13
    )
    assert max_difference(result.drift[:, 0], [-1.7 / (2 * 2.25), 0, 0]) < 1e-13
    assert max_difference(result.second_harmonic[:, 0], [1.7 / (6 * 2.25), 0, 0]) < 1e-13
    a = result.force_within(3.0)[0]
    assert abs((1.7 * a + 0.6 * a**2) / 2.25 - 0.03) < 1e-13
    for k, c in (10.0, 3.0), (8.9, 3.0):
        result = jb.vibration.backbone_curves(places(MASS * [2.25, k, 70.0], c=c))
        mean, double = -c / (2 * k * MASS[1]), -c / (2 * (k - 9) * MASS[1])
        assert abs(result.curvature[0] / (c * (mean + double / 2) / (2.25 * MASS[0])) - 1) < 1e-12
        assert max_difference(
            [result.drift[1, 0], result.second_harmonic[1, 0]], [mean, double]
        ) < 1e-12 * abs(double)


# Several degrees of freedom: periodic motions by shooting


def periodic(system, mode, w, i, a):
    """The frequency of a motion between two points of rest whose coordinates i are 2 a apart; shape
    `mode` and w begin the search.

    Unknown are the first point of rest and half the period; there the speeds must vanish."""
    n = len(mode)

    def equations(unknown):
        start = system.at_rest(unknown[:n])
        end = solve_ivp(
            system.rate, (0, unknown[n]), start, method="DOP853", rtol=1e-13, atol=1e-15
        ).y[:, -1]
        return np.append(system.speeds(end), unknown[i] - system.coordinates(end)[i] - 2 * a)

    unknown = np.append(a * mode, np.pi / w)
    size = np.append(a * np.ones(n), np.pi / w)
    J = np.stack(
        [(equations(unknown + h) - equations(unknown - h)) / 2e-3 for h in 1e-3 * np.diag(size)], 1
    )
    for _ in range(10):
        change = np.linalg.solve(J, equations(unknown))
        unknown = unknown - size * change
        if np.abs(change).max() < 1e-12:
            break
    return np.pi / unknown[n]


def check_against_periodic_motions(system, result, mode):
    """To 1e-5 of what the potential along a straight line alone gives: the extrapolation's, and
    1e-13/a^2 of the integration."""
    w, shape, i = (
        2 * np.pi * float(result.frequency[mode]),
        np.asarray(result.shapes[:, mode]),
        int(result.largest[mode]),
    )
    exact = curvature(lambda a: periodic(system, shape, w, i, a), 0.04, levels=4)
    line = float(result.fourth[mode] / (16 * result.stiffness[mode]))
    print(
        type(system).__name__,
        mode,
        exact,
        "error",
        result.curvature[mode] - exact,
        "along a line",
        line,
    )
    assert abs(result.curvature[mode] - exact) < 1e-5 * abs(line)
    # what the other modes and the inertia add is there to be tested
    assert abs(line - exact) > 0.08 * abs(line)


class Cart:
    """A pendulum on a cart that a spring, oblique and relaxed, ties to a wall; x and h, the bob at
    (x - r sin h, -r cos h)."""

    m, bob, r, J, k, g = 1.5, 0.7, 0.45, 0.02, 60.0, 9.81
    end = np.array([0.5, 0.3])

    def model(self, joint=None, closures=None):
        """The bob hangs on a hinge, or on another joint and closures."""
        bodies = {
            "cart": jb.Body(mass=self.m, inertia=[1, 1, 1]),
            "bob": jb.Body(mass=self.bob, inertia=[0.01, self.J, 0.01], com=[0, 0, -self.r]),
        }
        ends = ("cart", [0, 0, 0]), ("world", [self.end[0], 0, self.end[1]])
        return jb.Model(
            bodies=bodies,
            joints={
                "cart": jb.Guide("world", axis=[1, 0, 0]),
                "bob": joint or jb.Hinge("cart", axis=[0, 1, 0]),
            },
            closures=closures or {},
            elements={
                "spring": jb.Spring(*ends, stiffness=self.k, free_length=np.hypot(*self.end))
            },
            gravity=[0, 0, -self.g],
        )

    def rate(self, t, y):
        """(m + b) x'' - b r (cos h h'' - sin h h'^2) = -dV/dx,
        -b r cos h x'' + (J + b r^2) h'' = -b g r sin h"""
        x, h, x_dot, h_dot = y
        across, up = self.end - [x, 0]
        pull = self.k * (1 - np.hypot(*self.end) / np.hypot(across, up)) * across
        c = -self.bob * self.r * np.cos(h)
        M = [[self.m + self.bob, c], [c, self.J + self.bob * self.r**2]]
        sine = self.bob * self.r * np.sin(h)
        return np.append(
            [x_dot, h_dot], np.linalg.solve(M, [pull - sine * h_dot**2, -self.g * sine])
        )

    def at_rest(self, x):
        return np.append(x, [0, 0])

    def coordinates(self, y):
        return y[:2]

    def speeds(self, y):
        return y[2:]


@pytest.mark.long
@pytest.mark.parametrize("mode", [0, 1])
def test_a_pendulum_on_a_cart_has_the_slope_of_its_periodic_motions(mode):
    """Its kinetic energy depends on the angle, its spring has a quadratic term, and both couple
    the modes."""
    check_against_periodic_motions(Cart(), backbones(Cart().model()), mode)


# Closures: the independent coordinates on the curved paths that they leave


def trammel(length=0.45, masses=(0.8, 1.3)):
    """A bob that a rod holds at its length from a fixed point, on a carriage along x that guides it
    along z."""
    return jb.Model(
        bodies={
            name: jb.Body(mass=m, inertia=[1, 1, 1])
            for name, m in zip(("carriage", "bob"), masses, strict=True)
        },
        joints={"carriage": jb.Guide("world", axis="x"), "bob": jb.Guide("carriage", axis="z")},
        closures={"rod": jb.closures.Rod(("world", [0, 0, length]), ("bob", [0, 0, 0]))},
        gravity=[0, 0, -9.81],
    )


@pytest.mark.long
def test_a_bob_on_a_rod_that_guides_hold_has_the_slope_of_its_exact_period():
    """T = (m + M cos^2) L^2 h'^2/2, V = -m g L cos h of the bob m and the carriage M; the amplitude
    is that of x = L sin h."""
    L, (M, m), g = 0.45, (0.8, 1.3), 9.81
    result = backbones(trammel(L, (M, m)))
    assert result.coordinates == ("carriage move along its guide",)

    def frequency(a):
        h = np.arcsin(a / L)

        # dt/ds with sin(angle/2) = sin(h/2) sin(s), where cos(angle) - cos(h) = 2
        # sin^2(h/2) cos^2(s)
        def slowness(s):
            half = np.sin(h / 2) * np.sin(s)
            angle = 2 * np.arcsin(half)
            return np.sqrt((m + M * np.cos(angle) ** 2) * L / (m * g * (1 - half**2)))

        return np.pi / 2 / quad(slowness, 0, np.pi / 2, epsabs=0, epsrel=1e-13)[0]

    assert abs(float(result.frequency[0]) * 2 * np.pi / frequency(1e-4) - 1) < 1e-7
    exact = curvature(frequency, 0.1, levels=5)
    assert abs(float(result.curvature[0]) / exact - 1) < 1e-8  # what the extrapolation leaves


@pytest.mark.long
def test_the_slope_of_a_bob_on_a_rod_has_derivatives_in_both_modes():
    model = trammel()
    rigs.check_derivatives(
        lambda x: backbones(jb.replace(model, {"carriage.mass": x[0]})).curvature[0],
        jnp.array([0.8]),
    )


@pytest.mark.long
def test_a_pendulum_that_a_pin_closes_bends_as_on_its_hinge():
    """Both modes, by the amplitude of the cart."""
    pin = jb.closures.Hinge(("cart", [0, 0, 0]), ("bob", [0, 0, 0]), axis="y")
    closed = Cart().model(jb.joints.Planar("world", first="z", second="x"), {"pin": pin})
    tree, loop = backbones(Cart().model()), backbones(closed)
    np.testing.assert_allclose(loop.frequency, tree.frequency, rtol=1e-11)
    per_cart = [
        x.curvature / x.shapes[i] ** 2
        for x, i in ((tree, 0), (loop, list(loop.coordinates).index("cart move along its guide")))
    ]
    np.testing.assert_allclose(per_cart[1], per_cart[0], rtol=1e-9)


class Plate:
    """The free plate of the other tests, by Newton and Euler about its center of mass: y = (C, R,
    C', w), all in world axes."""

    def __init__(self, eq):
        model = eq.model
        rows, body = model.elements[0].rows, model.bodies.rows
        self.a, self.b, self.k, self.l0 = (
            np.asarray(x) for x in (rows.a, rows.b, rows.stiffness, rows.free_length)
        )
        self.m, self.c, self.I = (
            float(body.mass[0]),
            np.asarray(body.com[0]),
            np.asarray(body.inertia[0]),
        )
        self.p0, self.R0 = np.asarray(eq.state.q[:3]), rigs.turned(eq.state.q[3:])

    def rate(self, t, y):
        C, R, v, w = y[:3], y[3:12].reshape(3, 3), y[12:15], y[15:]
        arms = (self.a - self.c) @ R.T
        d = self.b - C - arms
        pulls = (self.k * (1 - self.l0 / np.sqrt((d * d).sum(1))))[:, None] * d
        I = R @ self.I @ R.T
        w_dot = np.linalg.solve(I, np.cross(arms, pulls).sum(0) - np.cross(w, I @ w))
        return np.concatenate(
            [v, np.cross(w, R.T).T.ravel(), pulls.sum(0) / self.m - [0, 0, 9.81], w_dot]
        )

    def at_rest(self, x):
        R = Rotation.from_rotvec(x[3:]).as_matrix() @ self.R0
        return np.concatenate([self.p0 + x[:3] + R @ self.c, R.ravel(), np.zeros(6)])

    def coordinates(self, y):
        R = y[3:12].reshape(3, 3)
        return np.concatenate(
            [y[:3] - R @ self.c - self.p0, Rotation.from_matrix(R @ self.R0.T).as_rotvec()]
        )

    def speeds(self, y):
        return y[12:]


@pytest.fixture(scope="module")
def hanging():
    return jb.equilibrium(rigs.plate())


@pytest.mark.long
@pytest.mark.parametrize("mode", [2, 4])
def test_a_free_body_on_springs_has_the_slope_of_its_periodic_motions(hanging, mode):
    check_against_periodic_motions(
        Plate(hanging), jb.vibration.backbone_curves(jb.linearize(hanging.model, hanging)), mode
    )


def test_the_coefficient_does_not_depend_on_the_coordinates(hanging):
    """Another reference point and other body axes: other charts, in which the mean, second harmonic
    and straight lines differ."""
    one = jb.vibration.backbone_curves(jb.linearize(hanging.model, hanging))
    r, turn = np.array([0.3, -0.2, 0.25]), Rotation.from_rotvec([0.4, -0.8, 1.1])
    Q, body, springs = turn.as_matrix(), hanging.model["plate"], hanging.model.elements[0].rows
    moved = jb.Body(
        mass=body.mass,
        inertia=Q.T @ body.inertia @ Q,
        com=Q.T @ (body.com - r),
        position=r,
        orientation=np.roll(turn.as_quat(), 1),
    )
    names = hanging.model.elements[0].names
    elements = {
        name: jb.Spring(
            ("plate", Q.T @ (springs.a[i] - r)),
            ("base", springs.b[i]),
            stiffness=springs.stiffness[i],
            free_length=springs.free_length[i],
        )
        for i, name in enumerate(names)
    }
    other = backbones(
        jb.Model(
            bodies={"plate": moved},
            supports={"base": jb.Support()},
            elements=elements,
            gravity=[0, 0, -9.81],
        )
    )
    arm = rigs.turned(hanging.state.q[3:]) @ r
    shapes = np.array(one.shapes)
    shapes[:3] += np.cross(shapes[3:].T, arm).T
    unit = shapes[np.asarray(other.largest), np.arange(6)]
    assert max_difference(other.shapes, shapes / unit) < 1e-8
    print(
        "coordinates",
        max_difference(other.curvature * unit**2 / one.curvature, np.ones(6)),
        other.fourth * unit**4 / one.fourth,
    )
    assert (
        max_difference(other.curvature * unit**2 / one.curvature, np.ones(6)) < 1e-8
    )  # two modes are 0.1 % apart: 1e-12 of the search, amplified
    assert max_difference(other.fourth * unit**4 / one.fourth, np.ones(6)) > 0.01


# What is said where a mode has no backbone of its own


@pytest.mark.long
@pytest.mark.parametrize(
    ("k", "laws", "status"),
    [
        # y could answer the second harmonic of x, but nothing drives it
        ((1.0, 4.0, 9.0), {}, ("OK", "OK", "OK")),
        ((1.0, 4.0, 9.0), {"c": 0.1}, ("INTERNAL_RESONANCE", "OK", "OK")),
        ((1.0, 4.0, 4.0), {"beta": 1.0}, ("OK", "INTERNAL_RESONANCE", "INTERNAL_RESONANCE")),
        ((1.0, 3.0, 0.0), {"beta": 1.0}, ("SINGULAR_K", "OK", "OK")),
        ((1.0, 0.0, 9.0), {"c": 0.1}, ("SINGULAR_K", "SINGULAR_K", "OK")),  # x pushes y away
        ((1.0, 3.0, -1.0), {"beta": 1.0}, ("UNSTABLE", "OK", "OK")),
    ],
)
def test_a_mode_that_does_not_move_alone_has_no_backbone(k, laws, status):
    lin = places(MASS * k, **laws)
    codes = {Status[name] for name in status if name != "OK"}
    if codes:
        with pytest.warns(jb.JaxbodyWarning, match=codes.pop().name) as caught:
            result = jb.vibration.backbone_curves(lin)
        assert len(caught) == 1
    else:
        result = jb.vibration.backbone_curves(lin)
    assert [Status(int(code)).name for code in result.status] == list(status)
    assert np.isnan(result.curvature).tolist() == [name != "OK" for name in status]
    assert all(name in str(result) for name in status if name != "OK")
    if "beta" in laws:
        x = list(np.sqrt(np.sort(k))).index(1.0) if min(k) >= 0 else 1
        assert abs(result.curvature[x] - 3 / (8 * MASS[0])) < 1e-13


def test_masses_that_nothing_holds_have_the_backbone_of_their_distance():
    """d = x - y, mass m1 m2/(m1 + m2): 5 s^2/(12 r^2) of d; y, the lighter, moves by m1/(m1 + m2)
    of it."""
    with pytest.warns(jb.JaxbodyWarning, match="SINGULAR_K"):
        result = jb.vibration.backbone_curves(places([0, 0, 50.0], r=2.0, s=0.7))
    assert [Status(int(code)).name for code in result.status] == ["SINGULAR_K", "OK", "OK"]
    assert int(result.largest[1]) == 1
    assert abs(result.curvature[1] / (-5 * 0.7**2 / (12 * 2.0**2) * (1 + 2 / 3) ** 2) - 1) < 1e-12


@pytest.mark.long
def test_where_there_is_no_equilibrium_nothing_is_reported():
    model = Cart().model()
    with pytest.warns(jb.JaxbodyWarning, match="2 NOT_CONVERGED"):
        result = jb.vibration.backbone_curves(
            jb.linearize(model, jb.State(jnp.array([0.0, 0.01]), jnp.zeros(2)))
        )
    assert np.isnan(result.curvature).all()
    with pytest.raises(jb.JaxbodyError, match=r"failed samples \[0, 1\]"):
        result.raise_if_failed()


# Derivatives, printing


@pytest.mark.long
def test_derivatives_are_those_of_differences():
    """Through the equilibrium, which the spring's free length moves."""
    model = Cart().model()

    @jax.jit
    def with_slope(x, x_dot):
        def result(x):
            return backbones(
                jb.replace(
                    model,
                    {
                        "spring.stiffness": 60.0 * x[0],
                        "bob.mass": 0.7 * x[1],
                        "spring.free_length": 0.6 * x[2],
                    },
                )
            )

        return jax.jvp(lambda x: result(x).curvature, (x,), (x_dot,))

    x = jnp.array([1.0, 1.1, 0.95])
    for unit in np.eye(3):
        slope = with_slope(x, unit)[1]
        exact = extrapolated(
            [
                (with_slope(x + h * unit, unit)[0] - with_slope(x - h * unit, unit)[0]) / (2 * h)
                for h in (2e-3, 1e-3)
            ]
        )
        print("derivatives", max_difference(slope, exact) / np.abs(exact).max())
        # a step of 1e-3, to the fourth power after extrapolation
        assert max_difference(slope, exact) < 1e-8 * np.abs(exact).max()


@pytest.mark.long
def test_a_mode_alone_has_derivatives_where_others_coincide():
    """In reverse mode; of 3 beta/(8 k m) with m = 3 k."""
    lin = places(MASS * [1.0, 4.0, 4.0], beta=1.0)
    slope = jax.jit(
        jax.grad(
            lambda k: jb.vibration.backbone_curves(
                jb.linearize(jb.replace(lin.model, {"law.k": k}), lin.state)
            ).curvature[0]
        )
    )(jnp.array(MASS * [1.0, 4.0, 4.0]))
    assert max_difference(slope, [-3 / 8 / MASS[0] ** 2, 0, 0]) < 1e-13


@pytest.mark.long
def test_it_prints_amplitudes_in_meters_and_radians_and_is_exported(hanging):
    result = jb.vibration.backbone_curves(jb.linearize(hanging.model, hanging))
    rows = repr(result).splitlines()[2:8]
    print(result)
    for mode, (name, unit) in {
        0: ("plate move along x", "m"),
        4: ("plate turn about x", "rad"),
    }.items():
        assert name in rows[mode]
        assert f"{result.curvature[mode]:+.4g} /{unit}2" in rows[mode]
        assert f"up to {result.force_within(5.0)[mode]:.3g} {unit}" in rows[mode]
        assert f"up to {result.frequency_within(5.0)[mode]:.3g} {unit}" in rows[mode]
    made = result.to_xarray()
    np.testing.assert_array_equal(made["curvature"].sel(mode=1), result.curvature[0])
    np.testing.assert_array_equal(
        made["shape"].sel(coordinate="plate turn about z"), result.shapes[5]
    )
    assert made["largest"].sel(mode=5).item() == "plate turn about x"
