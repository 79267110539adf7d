"""The formulas of Stanescu and Mihalcea (13th IFToMM World Congress, 2011, A14_316) in NumPy, each
with its equation number.

They use nothing from the library. Arrays may have leading axes. Names: `O`, `R` the reference point
and orientation of a frame, `r_A`, `r_B`, `r_C` points in body axes in section 2 and 3 of the paper,
in world axes at equilibrium in section 4.
"""

import numpy as np

H = 1e-30  # complex step: derivatives without differences


def skew(v):
    """[v], with [v] w = v x w."""
    v = np.asarray(v)
    x, y, z = v[..., 0], v[..., 1], v[..., 2]
    o = np.zeros_like(x)
    return np.stack(
        [np.stack([o, -z, y], -1), np.stack([z, o, -x], -1), np.stack([-y, x, o], -1)], -2
    )


def times(A, b):
    """A b."""
    return np.einsum("...ij,...j->...i", A, b)


def transposed(A):
    return np.swapaxes(A, -1, -2)


def scalar(x):
    """A scalar that multiplies matrices."""
    return np.asarray(x)[..., None, None]


def outer(a, b):
    return a[..., :, None] * b[..., None, :]


def blocks(a, b, c, d):
    """[[a, b], [c, d]] of 3 x 3 blocks."""
    shape = np.broadcast_shapes(a.shape, b.shape, c.shape, d.shape)
    a, b, c, d = (np.broadcast_to(x, shape) for x in (a, b, c, d))
    return np.concatenate([np.concatenate([a, b], -1), np.concatenate([c, d], -1)], -2)


I, ZERO = np.eye(3), np.zeros((3, 3))


# Sections 2 and 3: the exact motion, q = (O, psi, theta, phi)


def turn(axis, angle):
    """The matrix of a turn about one coordinate axis."""
    n = skew(np.eye(3)[axis])
    return I + scalar(np.sin(angle)) * n + scalar(1 - np.cos(angle)) * (n @ n)


def rotation(angles):
    """(1) R = [psi][theta][phi], about the moving axes x, y, z; singular at theta = 90 degrees."""
    psi, theta, phi = (angles[..., i] for i in range(3))
    return turn(0, psi) @ turn(1, theta) @ turn(2, phi)


def rates_to_angular_velocity(angles):
    """(2), (3) Q with body-frame angular velocity w = Q (psi', theta', phi'): its columns are the
    three axes seen from the body."""
    theta, phi = angles[..., 1], angles[..., 2]
    after_theta = transposed(turn(2, phi))
    after_psi = after_theta @ transposed(turn(1, theta))
    return np.stack(
        [
            after_psi[..., :, 0],
            after_theta[..., :, 1],
            np.broadcast_to(I[2], after_psi[..., 2].shape),
        ],
        -1,
    )


def mass_matrix(body, q):
    """(10), (11) M(q) = [[m I, R S' Q], [Q' S R', Q' J_O Q]], S = m [r_C]; T = 1/2 q'' M q'."""
    m, r_C, J_O = body["m"], body["r_C"], body["J_O"]
    R, Q, S = rotation(q[..., 3:]), rates_to_angular_velocity(q[..., 3:]), m * skew(r_C)
    return blocks(m * I, R @ S.T @ Q, transposed(Q) @ S @ transposed(R), transposed(Q) @ J_O @ Q)


def inertia_forces(body, q, q_dot):
    """(16)-(19) F~_q = -Mdot q' + d(1/2 q'' M q')/dq."""
    M_dot = mass_matrix(body, q + 1j * H * q_dot).imag / H
    slopes = [
        0.5 * np.einsum("...i,...ij,...j", q_dot, mass_matrix(body, q + 1j * H * e).imag / H, q_dot)
        for e in np.eye(6)
    ]
    return -times(M_dot, q_dot) + np.stack(slopes, -1)


def spring_point(O, R, r_A):
    """(22)-(25) A = O + R r_A."""
    return O + times(R, r_A)


def spring_force(k, l0, A, B):
    """(20), (21) on the body that A is on: k (|AB| - l0)/|AB| (B - A)."""
    AB = B - A
    length = np.sqrt(np.sum(AB * AB, -1, keepdims=True))
    return k * (length - l0) / length * AB


def spring_potential(k, l0, A, B):
    """(27), (28) V = k/2 (|AB| - l0)^2."""
    return k / 2 * (np.sqrt(np.sum((B - A) ** 2, -1)) - l0) ** 2


def generalized_force(q, r_A, force):
    """(26) of a force at r_A for (O, psi, theta, phi): [I; Q' [r_A] R'] force."""
    R, Q = rotation(q[..., 3:]), rates_to_angular_velocity(q[..., 3:])
    return np.concatenate([force, times(transposed(Q) @ skew(r_A) @ transposed(R), force)], -1)


def accelerations(bodies, springs, gravity, q, q_dot, base):
    """(12)-(19), (29): M q'' = F_q + F~_q for each body; springs are ((frame, point), (frame,
    point), k, l0), base gives (O, R) of the frames that are moved. A dictionary of q''."""
    frames = base | {name: (x[..., :3], rotation(x[..., 3:])) for name, x in q.items()}
    total = {
        name: generalized_force(q[name], body["r_C"], body["m"] * gravity + 0 * q[name][..., :3])
        for name, body in bodies.items()
    }
    for (one, r_A), (other, r_B), k, l0 in springs:
        force = spring_force(
            k, l0, spring_point(*frames[one], r_A), spring_point(*frames[other], r_B)
        )
        for name, r, f in ((one, r_A, force), (other, r_B, -force)):
            if name in bodies:
                total[name] = total[name] + generalized_force(q[name], r, f)
    return {
        name: np.linalg.solve(
            mass_matrix(body, q[name]),
            (total[name] + inertia_forces(body, q[name], q_dot[name]))[..., None],
        )[..., 0]
        for name, body in bodies.items()
    }


def world_velocity(q, q_dot):
    """(velocity of O, angular velocity R Q (psi', theta', phi')), world axes."""
    return np.concatenate(
        [
            q_dot[..., :3],
            times(rotation(q[..., 3:]) @ rates_to_angular_velocity(q[..., 3:]), q_dot[..., 3:]),
        ],
        -1,
    )


def world_acceleration(q, q_dot, q_ddot):
    """The derivative of `world_velocity` along the motion."""
    return world_velocity(q + 1j * H * q_dot, q_dot + 1j * H * q_ddot).imag / H


# Section 4: small oscillations; u, r_A, r_B, r_C along world axes at equilibrium


def U_of(u, r):
    """(33), (43), (37) (u, r x u)."""
    return np.concatenate([u, np.cross(r, u)], -1)


def K_1(k, s, L, U):
    """(38) k (1 - s/L) U U'."""
    return scalar(k * (1 - s / L)) * outer(U, U)


def K_2(k, s, L, r_A):
    """(k s/L) [[I, [r_A]'], [[r_A], [r_A][r_A]']]."""
    X = skew(r_A)
    return scalar(k * s / L) * blocks(I, transposed(X), X, X @ transposed(X))


def K_3(k, s, r_A, u):
    """-(k s/2) [[0, 0], [0, [r_A][u] + [u][r_A]]]."""
    return -scalar(k * s / 2) * blocks(ZERO, ZERO, ZERO, skew(r_A) @ skew(u) + skew(u) @ skew(r_A))


def K_AB(k, s, L, u, r_A):
    """(39) K(1) + K(2) + K(3)."""
    return K_1(k, s, L, U_of(u, r_A)) + K_2(k, s, L, r_A) + K_3(k, s, r_A, u)


def K_C(m, g, r_C, u_C):
    """(40) -(m g/2) [[0, 0], [0, [r_C][u_C] + [u_C][r_C]]]."""
    return K_3(m, g, r_C, u_C)


def mass_at_rest(m, r_C, J_O):
    """(42) [[m I, m [r_C]'], [m [r_C], J_O]]."""
    X = scalar(m) * skew(r_C)
    return blocks(scalar(m) * I, transposed(X), X, J_O)


def K_tilde_1(k, s, L, U, U_tilde):
    """(46) k (1 - s/L) U U~'."""
    return scalar(k * (1 - s / L)) * outer(U, U_tilde)


def K_tilde_2(k, s, L, r_A, r_B):
    """(47) (k s/L) [[I, [r_B]'], [[r_A], [r_A][r_B]']]."""
    X, Y = skew(r_A), skew(r_B)
    return scalar(k * s / L) * blocks(I, transposed(Y), X, X @ transposed(Y))


def K_tilde_AB(k, s, L, u, r_A, r_B):
    """(48) K~(1) + K~(2)."""
    return K_tilde_1(k, s, L, U_of(u, r_A), U_of(u, r_B)) + K_tilde_2(k, s, L, r_A, r_B)


def displacement(D, r):
    """(53), (61) delta + theta x r + 1/2 theta x (theta x r)."""
    turned = np.cross(D[..., 3:], r)
    return D[..., :3] + turned + np.cross(D[..., 3:], turned) / 2


def displacement_slopes(D, r):
    """(56) rows dD_A/ddelta_i = e_i and dD_A/dtheta_i = e_i x r + 1/2 (e_i x (theta x r) + theta x
    (e_i x r))."""
    theta = D[..., 3:]
    rows = [np.broadcast_to(e, r.shape) for e in I]
    for e in I:
        rows.append(
            np.cross(e, r) + (np.cross(e, np.cross(theta, r)) + np.cross(theta, np.cross(e, r))) / 2
        )
    return np.stack(rows, -2)


def deformed_length(L, u, D_AB):
    """(51) |A'B'| = |L u - D_AB|, D_AB = D_A - D_B (30)."""
    return np.linalg.norm(L[..., None] * u - D_AB, axis=-1)


def potential_series(k, s, L, u, D_AB):
    """(52) k/2 (s^2 - 2 s u.D_AB + (s/L) D_AB.D_AB + (1 - s/L) (u.D_AB)^2)."""
    along = np.sum(u * D_AB, -1)
    return k / 2 * (s**2 - 2 * s * along + s / L * np.sum(D_AB * D_AB, -1) + (1 - s / L) * along**2)


def gravity_potential(m, g, u_C, D_C):
    """(60) -m g u_C . D_C."""
    return -m * g * np.sum(u_C * D_C, -1)


# Section 7: the plate


def plate_points(l):
    """A, B, C, D, E, F and O0, world axes at O."""
    points = dict(
        A=(-3, 1, 0),
        B=(-5, 3, 0),
        C=(3, 1, 0),
        D=(5, 3, 0),
        E=(0, -1, 0),
        F=(0, -3, 0),
        O0=(0, -4, 0),
    )
    return {name: l * np.array(p, float) for name, p in points.items()}


def plate_U(l):
    """(68), (71), (74) U and U~ of the three springs."""
    c = np.sqrt(2) / 2
    U = {
        "AB": c * np.array([-1, 1, 0, 0, 0, -2 * l]),
        "CD": c * np.array([1, 1, 0, 0, 0, 2 * l]),
        "EF": np.array([0, -1.0, 0, 0, 0, 0]),
    }
    U_tilde = {
        "AB": c * np.array([-1, 1, 0, 0, 0, 2 * l]),
        "CD": c * np.array([1, 1, 0, 0, 0, -2 * l]),
        "EF": U["EF"],
    }
    return U, U_tilde


def plate_K_tilde_2(k, l):
    """(70), (73) K~(2) of AB and of CD."""
    AB = (k / 4) * np.array(
        [
            [1, 0, 0, 0, 0, -7 * l],
            [0, 1, 0, 0, 0, -5 * l],
            [0, 0, 1, 7 * l, 5 * l, 0],
            [0, 0, l, 7 * l**2, 5 * l**2, 0],
            [0, 0, 3 * l, 21 * l**2, 15 * l**2, 0],
            [-l, -3 * l, 0, 0, 0, 22 * l**2],
        ]
    )
    CD = AB.copy()
    for i, j in ((2, 6), (3, 5), (4, 5), (5, 3), (5, 4), (6, 2)):
        CD[i - 1, j - 1] *= -1
    return AB, CD


def plate_K_tilde(k, kt, l):
    """(77)."""
    return (k / 4) * np.array(
        [
            [5, 0, 0, 0, 0, -20 * l],
            [0, 5 + 4 * kt / k, 0, 0, 0, 0],
            [0, 0, 2, 14 * l, 0, 0],
            [0, 0, 2 * l, 14 * l**2, 0, 0],
            [0, 0, 0, 0, 30 * l**2, 0],
            [4 * l, 0, 0, 0, 0, 32 * l**2],
        ]
    )


def plate_excitation(k, l, xi0, phi0):
    """(79), the amplitude of F^e under (78)."""
    return (k / 4) * np.array([5 * xi0 - 20 * l * phi0, 0, 0, 0, 0, 4 * l * xi0 + 32 * l**2 * phi0])


def plate_K(k, kt, l):
    """K of the plate: not in the paper, from (38)-(41)."""
    return (k / 4) * np.array(
        [
            [5, 0, 0, 0, 0, 4 * l],
            [0, 5 + 4 * kt / k, 0, 0, 0, 0],
            [0, 0, 2, 2 * l, 0, 0],
            [0, 0, 2 * l, 6 * l**2, 0, 0],
            [0, 0, 0, 0, 30 * l**2, 0],
            [4 * l, 0, 0, 0, 0, 48 * l**2],
        ]
    )
