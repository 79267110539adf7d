"""Energy, stiffness and its derivatives against the same formulas in fifty digits, down to the
smallest rotations."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

mp = pytest.importorskip("mpmath", reason="needs mpmath: pip install 'jaxbody[judges]'").mp
mp.dps = 60

import jaxbody as jb  # noqa: E402
from jaxbody.lagrange import potential  # noqa: E402
from jaxbody.model.joints.kinematics import Chart, Coordinates  # noqa: E402


def exact(x):
    return np.vectorize(mp.mpf, otypes=[object])(np.asarray(x, float))


def skew(a):
    x, y, z = a
    zero = mp.mpf(0)
    return np.array([[zero, -z, y], [z, zero, -x], [-y, x, zero]], object)


def norm(a):
    return mp.sqrt(sum(x * x for x in a))


def exp(phi):
    """Rodrigues' formula."""
    angle, S = norm(phi), skew(phi)
    if angle == 0:
        return exact(np.eye(3))
    return exact(np.eye(3)) + S * (mp.sin(angle) / angle) + S @ S * ((1 - mp.cos(angle)) / angle**2)


def log(R):
    """Of a turn by less than half a turn."""
    w = np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]], object) / 2
    sine = norm(w)
    return w if sine == 0 else w * (mp.atan2(sine, (R[0, 0] + R[1, 1] + R[2, 2] - 1) / 2) / sine)


def matrix(q):
    w, *e = q / norm(q)
    S = skew(e)
    return exact(np.eye(3)) + 2 * w * S + 2 * S @ S


def translation_of_log(phi, p):
    """J^-1(phi) p, J the left Jacobian of SO(3)."""
    angle, S = norm(phi), skew(phi)
    if angle == 0:
        return p
    half = angle / 2
    return p - S @ p / 2 + S @ (S @ p) * ((1 - half * mp.cos(half) / mp.sin(half)) / angle**2)


def energy(model, numbers, q, delta):
    """V of a free body on springs and bushings from the world, displaced by delta."""
    p, R = q[:3] + delta[:3], exp(delta[3:]) @ matrix(q[3:])
    V = -numbers["mass"] * sum(numbers["gravity"] * (p + R @ numbers["com"]))
    for name in model.element_names:
        element = model[name]
        a, b, k = numbers[f"{name}.a"], numbers[f"{name}.b"], numbers[f"{name}.stiffness"]
        if isinstance(element, jb.Spring):
            V += k * (norm(b - p - R @ a) - numbers[f"{name}.free_length"]) ** 2 / 2
            continue
        R_A, R_B = (
            R @ matrix(numbers[f"{name}.orientation"]),
            matrix(numbers[f"{name}.orientation_b"]),
        )
        phi = log(R_A.T @ R_B)
        e = np.concatenate([translation_of_log(phi, R_A.T @ (b - p - R @ a)), phi])
        V += e @ k @ e / 2
    return V


def numbers_of(model):
    """All numbers, exactly as they are in the model."""
    body = model["body"]
    found = {
        "mass": exact(body.mass)[()],
        "com": exact(body.com),
        "inertia": exact(body.inertia),
        "gravity": exact(model.gravity),
    }
    for name in model.element_names:
        for field in ("a", "b", "stiffness", "free_length", "orientation", "orientation_b"):
            if hasattr(model[name], field):
                x = exact(getattr(model[name], field))
                found[f"{name}.{field}"] = x if x.ndim else x[()]
    return found


def turn(rng):
    """By less than a quarter."""
    q = np.array([2.5, 0, 0, 0]) + rng.uniform(-1, 1, 4)
    return q / np.linalg.norm(q)


def suspended(rng, together=False):
    """A body on four springs and two bushings; `together`: with the frames of the
    bushings aligned."""

    def bushing():
        A = rng.normal(size=(6, 6))
        away = {} if together else {"orientation": turn(rng), "orientation_b": turn(rng)}
        where = 0.3 * rng.normal(size=3)
        return jb.Bushing(
            ("body", where),
            ("world", where + 0.05 * rng.normal(size=3)),
            stiffness=100 * (A @ A.T + np.eye(6)),
            **away,
        )

    springs = {
        f"s{i}": jb.Spring(
            ("body", 0.3 * rng.normal(size=3)),
            ("world", rng.normal(size=3)),
            stiffness=10 ** rng.uniform(0, 3),
            free_length=0.5,
        )
        for i in range(4)
    }
    body = jb.Body(
        mass=3.0,
        inertia=[0.2, 0.3, 0.4],
        com=0.1 * rng.normal(size=3),
        orientation=[1, 0, 0, 0] if together else turn(rng),
    )
    return jb.Model(
        bodies={"body": body},
        elements=springs | {"m0": bushing(), "m1": bushing()},
        gravity=[0.3, -0.2, -9.7],
    )


def stiffness(model, numbers, q, digits=15):
    """K by second differences, which are exact to 1e-30."""
    h = mp.mpf(10) ** -digits
    E = exact(np.eye(6)) * h
    V = functools.cache(lambda i, j, s, t: energy(model, numbers, q, s * E[i] + t * E[j]))
    K = np.zeros((6, 6), object)
    for i in range(6):
        for j in range(i + 1):
            K[i, j] = K[j, i] = (
                V(i, j, 1, 1) - V(i, j, 1, -1) - V(i, j, -1, 1) + V(i, j, -1, -1)
            ) / (4 * h * h)
    return K


@jb.jit
def stiffness_and_slope(model, change, q):
    """K, and its derivative where all numbers of elements and the center of mass grow in proportion
    to `change`."""

    def K(t):
        rows = [(m, name) for m in range(len(model.elements)) for name in ("a", "stiffness")]
        moved = eqx.tree_at(
            lambda m: [getattr(m.elements[i].rows, name) for i, name in rows] + [m.bodies.rows.com],
            model,
            [getattr(model.elements[i].rows, name) * (1 + change * t) for i, name in rows]
            + [model.bodies.rows.com * (1 + change * t)],
        )
        return jb.linearize(moved, jb.State(q, jnp.zeros(6))).K

    return jax.jvp(K, (jnp.zeros(()),), (jnp.ones(()),))


@pytest.mark.long
@pytest.mark.parametrize("seed", range(3))
def test_stiffness_and_its_derivative(seed):
    rng = np.random.default_rng(seed)
    model = suspended(rng)
    q = np.array(jb.joints.retract(model, model.reference.q, 0.1 * rng.normal(size=6)))
    K, slope = stiffness_and_slope(model, 0.7, q)
    numbers, h = numbers_of(model), mp.mpf(10) ** -9
    np.testing.assert_allclose(
        K, stiffness(model, numbers, exact(q)).astype(float), rtol=0, atol=1e-12 * np.abs(K).max()
    )

    def at(t):
        moved = {
            k: x * (1 + mp.mpf(0.7) * t)
            if k == "com" or k.split(".")[-1] in ("a", "stiffness")
            else x
            for k, x in numbers.items()
        }
        return stiffness(model, moved, exact(q), digits=12)

    expected = ((at(h) - at(-h)) / (2 * h)).astype(float)
    np.testing.assert_allclose(slope, expected, rtol=0, atol=1e-10 * np.abs(slope).max())


KINDS = [
    *("mass", "com", "inertia", "gravity", "s0.a", "s0.b", "s0.stiffness", "s0.free_length"),
    *("m0.a", "m0.b", "m0.stiffness", "m0.orientation", "m0.orientation_b"),
]


def frequency(model, numbers, q):
    """The lowest one about the equilibrium, which Newton's method finds from a state nearby."""
    h = mp.mpf(10) ** -20
    for _ in range(2):  # errors of 1e-12, 1e-24 and, by the accuracy of g, 1e-36
        V = [[energy(model, numbers, q, s * h * e) for s in (1, -1)] for e in exact(np.eye(6))]
        K, g = (
            mp.matrix(stiffness(model, numbers, q).tolist()),
            mp.matrix([(up - down) / (2 * h) for up, down in V]),
        )
        step = np.array(list(mp.lu_solve(K, -g)), object)
        q = np.concatenate([q[:3] + step[:3], quaternion(exp(step[3:]) @ matrix(q[3:]))])
    K, R, m = mp.matrix(stiffness(model, numbers, q).tolist()), matrix(q[3:]), numbers["mass"]
    c, eye = R @ numbers["com"], exact(np.eye(3))
    about_O = R @ numbers["inertia"] @ R.T - m * skew(c) @ skew(c)
    M = mp.matrix(np.block([[m * eye, -m * skew(c)], [m * skew(c), about_O]]).tolist())
    L = mp.cholesky(M) ** -1
    return mp.sqrt(min(mp.eigsy(L * K * L.T, eigvals_only=True))) / (2 * mp.pi)


def quaternion(R):
    """Of a turn by less than half a turn."""
    w = mp.sqrt(1 + R[0, 0] + R[1, 1] + R[2, 2]) / 2
    return np.array(
        [
            w,
            *(
                np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]], object)
                / (4 * w)
            ),
        ],
        object,
    )


@pytest.mark.long
def test_derivatives_of_a_frequency_by_every_kind_of_number(rng):
    """Forward and reverse mode through equilibrium, stiffness and eigenvalue; the differences are
    exact to 1e-20."""
    model, h = suspended(rng), mp.mpf(10) ** -12
    paths = {kind: kind if "." in kind or kind == "gravity" else f"body.{kind}" for kind in KINDS}
    values = jb.parameter_paths(model)
    directions = {
        kind: rng.normal(size=values[path].shape) * np.abs(values[path]).max()
        for kind, path in paths.items()
    }
    directions |= {kind: x + x.T for kind, x in directions.items() if x.ndim == 2}

    def first(t):
        moved = {
            path: values[path] + t[i] * directions[kind]
            for i, (kind, path) in enumerate(paths.items())
        }
        changed = jb.replace(model, moved)
        return jb.modes(jb.linearize(changed, jb.equilibrium(changed))).frequency[0]

    t = jnp.zeros(len(KINDS))
    numbers, q = numbers_of(model), exact(jb.equilibrium(model).state.q)
    np.testing.assert_allclose(first(t), float(frequency(model, numbers, q)), rtol=1e-13)
    expected = []
    for kind in KINDS:
        up, down = (
            frequency(model, numbers | {kind: numbers[kind] + s * h * exact(directions[kind])}, q)
            for s in (1, -1)
        )
        expected.append(float((up - down) / (2 * h)))
    for derivative in (jax.jacfwd, jax.grad):
        np.testing.assert_allclose(derivative(first)(t), expected, rtol=1e-11, err_msg=str(KINDS))


ANGLES = [0.0, *10.0 ** np.arange(-16, 0, 1.25)]
LIMITS = (1e-14, 1e-13, 1e-12, 1e-10)


@jb.jit
def slopes_along(model, q, direction):
    """The first four derivatives of V along a direction."""

    def V(s):
        return potential(model, Coordinates(model).at_rest(Chart(model).retract(q, s * direction)))

    found = []
    for _ in range(4):
        V = (lambda f: lambda s: jax.jvp(f, (s,), (jnp.ones(()),))[1])(V)
        found.append(V(jnp.zeros(())))
    return jnp.stack(found)


@pytest.mark.long
def test_small_rotations(rng):
    """Rotations from none to a tenth of a radian away from where two bushings are relaxed; the
    first to fourth derivatives of V."""
    model = suspended(rng, together=True)
    numbers, axis, direction = numbers_of(model), rng.normal(size=3), rng.normal(size=6)
    axis = axis / np.linalg.norm(axis)
    for angle in ANGLES:
        q = np.array(
            jb.joints.retract(model, model.reference.q, np.concatenate([np.zeros(3), angle * axis]))
        )
        found = np.array(slopes_along(model, q, direction))
        f = lambda s, q=q: energy(model, numbers, exact(q), s * exact(direction))  # noqa: E731
        for order, limit in enumerate(LIMITS, 1):
            expected = float(differences(f, order))
            assert abs(found[order - 1] - expected) <= limit * np.abs(found[: order + 1]).max(), (
                angle,
                order,
            )


def differences(f, order):
    """The derivative of an order at 0 by central differences, exact to 1e-15 of the next
    but one."""
    weights = {1: (-1, 0, 1), 2: (1, -2, 1), 3: (-1, 2, 0, -2, 1), 4: (1, -4, 6, -4, 1)}[order]
    n, h = len(weights) // 2, mp.mpf(10) ** -8
    return sum(w * f(i * h) for i, w in zip(range(-n, n + 1), weights, strict=True)) / (
        h**order * (2 if order % 2 else 1)
    )
