"""The reference job: one plate on five spring-dampers under a shaking base, in NumPy and as a model, with SciPy's solution.

State y = position (3), unit quaternion wxyz (4), world velocity (3), body angular velocity (3). SI units.
"""

import numpy as np
from scipy.integrate import solve_ivp

import jaxbody as jb

L, MASS, INERTIA, G, DAMPING = 0.1, 10.0, np.array([0.3, 0.9, 1.2]), 9.81, 5.0
ON_PLATE = np.array([[-3 * L, L, 0], [3 * L, L, 0], [0, -L, 0.05], [0, 0, 0.1], [0.1, 0, -0.1]])
ON_BASE = np.array([[-5 * L, 3 * L, 0], [5 * L, 3 * L, 0], [0, -3 * L, 0.05], [0, 0, 0.6], [0.1, 0, -0.6]])  # world, base at rest
BASE = np.array([0, -0.4, 0])
STIFFNESS = np.array([MASS * G / L, MASS * G / L, 2000.0, 2000.0, 2000.0])
TRUE_STIFFNESS = STIFFNESS * np.array([1.1, 0.95, 1.05, 0.9, 1.02])
FREE_LENGTH = np.linalg.norm(ON_BASE - ON_PLATE, axis=1) - np.array([L * np.sqrt(2) / 2] * 2 + [0, 0, 0])
FREQUENCY, SHAKE, TURN = 3.0, 0.01, 0.02  # the base moves by SHAKE along x and turns by TURN about z
TIMES = np.linspace(0, 10, 1001)


def several_stiffnesses(n: int) -> np.ndarray:
    """n sets of stiffnesses, within 15 percent."""
    return STIFFNESS * (1 + 0.3 * (np.random.RandomState(0).rand(n, 5) - 0.5))


def model(copies: int = 1) -> jb.Model:
    """The plate; each spring parted into `copies` equal ones that act together."""
    elements = {
        f"spring {i} {n}": jb.Spring(
            ("plate", ON_PLATE[i]), ("base", ON_BASE[i] - BASE), stiffness=STIFFNESS[i] / copies, free_length=FREE_LENGTH[i],
            damping=DAMPING / copies,
        )
        for i in range(5)
        for n in range(copies)
    }  # fmt: skip
    bodies, supports = {"plate": jb.Body(mass=MASS, inertia=INERTIA)}, {"base": jb.Support(position=BASE)}
    return jb.Model(bodies=bodies, supports=supports, elements=elements, gravity=[0, -G, 0])


def motion() -> dict[str, jb.Motion]:
    return {"base": jb.Harmonic(frequency=FREQUENCY, translation=[SHAKE, 0, 0], rotation=[0, 0, TURN])}


def solution(stiffness: np.ndarray, times: np.ndarray = TIMES, rtol: float = 1e-12) -> np.ndarray:
    """Position and quaternion at `times`, (n, 7), from rest, by SciPy's DOP853."""
    start = np.eye(1, 13, 3)[0]
    found = solve_ivp(rate, (times[0], times[-1]), start, args=(stiffness,), method="DOP853", rtol=rtol, atol=rtol / 10, t_eval=times)
    return found.y.T[:, :7]


def error(q: np.ndarray, reference: np.ndarray) -> float:
    """The largest difference of positions and of twice the quaternions."""
    return float((np.abs(q[..., :7] - reference[..., :7]) * [1, 1, 1, 2, 2, 2, 2]).max())


def rate(t: float, y: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
    x, q, v, w = y[:3], y[3:7], y[7:10], y[10:]
    R = _matrix(q)
    arm = ON_PLATE @ R.T
    base, base_velocity = _base(t)
    d = base - x - arm
    length = np.sqrt((d * d).sum(1))
    rate_of_length = (d * (base_velocity - v - np.cross(R @ w, arm))).sum(1) / length
    force = ((stiffness * (length - FREE_LENGTH) + DAMPING * rate_of_length) / length)[:, None] * d
    moment = R.T @ np.cross(arm, force).sum(0)
    qw, qx, qy, qz = q
    wx, wy, wz = w
    q_rate = 0.5 * np.array(
        [-qx * wx - qy * wy - qz * wz, qw * wx + qy * wz - qz * wy, qw * wy + qz * wx - qx * wz, qw * wz + qx * wy - qy * wx]
    )
    return np.concatenate([v, q_rate, force.sum(0) / MASS - [0, G, 0], (moment - np.cross(w, INERTIA * w)) / INERTIA])


def _base(t: float) -> tuple[np.ndarray, np.ndarray]:
    """Where the springs' ends on the base are, and their velocities."""
    omega = 2 * np.pi * FREQUENCY
    c, s = np.cos(omega * t), np.sin(omega * t)
    angle, angle_rate = TURN * c, -TURN * omega * s
    arm = ON_BASE - BASE
    turned = np.stack(
        [np.cos(angle) * arm[:, 0] - np.sin(angle) * arm[:, 1], np.sin(angle) * arm[:, 0] + np.cos(angle) * arm[:, 1], arm[:, 2]], 1
    )
    velocity = np.cross([0, 0, angle_rate], turned)
    return BASE + turned + [SHAKE * c, 0, 0], velocity + [-SHAKE * omega * s, 0, 0]


def _matrix(q: np.ndarray) -> np.ndarray:
    w, x, y, z = q
    s = 2 / (q @ q)
    return np.array([
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ])  # fmt: skip
