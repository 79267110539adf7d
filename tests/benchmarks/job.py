"""A job of the benchmarks: free bodies on spring-dampers under a shaking base, as tables, as a
model, and in NumPy with SciPy's solution.

State y, body by body: position (3), unit quaternion wxyz (4), world velocity (3), body angular
velocity (3). SI units. The base moves by `shake` cos(2 pi frequency t) along x and turns by `turn`
cos(2 pi frequency t) about z; centers of mass are the bodies' origins.
"""

from dataclasses import dataclass

import numpy as np
from scipy.integrate import solve_ivp

G = 9.81
TIMES = np.linspace(0, 10, 1001)


@dataclass(frozen=True)
class Job:
    """mass (nb,), principal moments (nb, 3) and places (nb, 3) of the bodies; of each spring the
    bodies it ties, -1 for the base, and the points on them, in their frames."""

    name: str
    mass: np.ndarray
    inertia: np.ndarray
    position: np.ndarray
    base: np.ndarray
    ties: np.ndarray
    a: np.ndarray
    b: np.ndarray
    stiffness: np.ndarray
    true_stiffness: np.ndarray
    free_length: np.ndarray
    damping: float
    frequency: float = 3.0
    shake: float = 0.01
    turn: float = 0.02
    # of the C program, for each save of T1 and T2: as many as the errors allowed need
    steps: int = 1
    steps_per_second: int = 100  # of the C program in T3
    saves_per_long_step: int = 10  # of its DOP853
    newton: int = 5  # its steps from the reference pose to the equilibrium

    @property
    def start(self) -> np.ndarray:
        """At rest in the reference pose."""
        n = len(self.mass)
        return np.concatenate(
            [self.position, np.tile([1.0, 0, 0, 0], (n, 1)), np.zeros((n, 6))], 1
        ).ravel()

    def several_stiffnesses(self, n: int) -> np.ndarray:
        """n sets of stiffnesses, within 15 percent."""
        return self.stiffness * (
            1 + 0.3 * (np.random.RandomState(0).rand(n, len(self.stiffness)) - 0.5)
        )

    def model(self, copies: int = 1):
        """As a jaxbody model; each spring parted into `copies` equal ones that act together."""
        import jaxbody as jb

        names = [f"body {i}" for i in range(len(self.mass))] + ["base"]
        elements = {
            f"spring {i} {n}": jb.Spring(
                (names[one], self.a[i]),
                (names[other], self.b[i]),
                stiffness=self.stiffness[i] / copies,
                free_length=self.free_length[i],
                damping=self.damping / copies,
            )
            for i, (one, other) in enumerate(self.ties)
            for n in range(copies)
        }
        bodies = {
            name: jb.Body(mass=m, inertia=J, position=p)
            for name, m, J, p in zip(
                names[:-1], self.mass, self.inertia, self.position, strict=True
            )
        }
        return jb.Model(
            bodies=bodies,
            supports={"base": jb.Support(position=self.base)},
            elements=elements,
            gravity=[0, -G, 0],
        )

    def motion(self) -> dict:
        import jaxbody as jb

        return {
            "base": jb.Harmonic(
                frequency=self.frequency, translation=[self.shake, 0, 0], rotation=[0, 0, self.turn]
            )
        }

    def solution(
        self, stiffness: np.ndarray, times: np.ndarray = TIMES, rtol: float = 1e-12
    ) -> np.ndarray:
        """Positions and quaternions at `times`, (n, nb 7), from rest, by SciPy's DOP853."""
        options = dict(method="DOP853", rtol=rtol, atol=rtol / 10, t_eval=times)
        return self.places(
            solve_ivp(
                self.rate,
                (times[0], times[-1]),
                self.start + 0 * stiffness.sum(),
                args=(stiffness,),
                **options,
            ).y.T
        )

    def places(self, y: np.ndarray) -> np.ndarray:
        """Positions and quaternions of a state."""
        return y.reshape(*y.shape[:-1], -1, 13)[..., :7].reshape(*y.shape[:-1], -1)

    def error(self, q: np.ndarray, reference: np.ndarray) -> float:
        """The largest difference of positions and of twice the quaternions."""
        return float((np.abs(q - reference) * np.tile([1, 1, 1, 2, 2, 2, 2], len(self.mass))).max())

    def rate(self, t: float, y: np.ndarray, stiffness: np.ndarray) -> np.ndarray:
        """dy/dt."""
        x, q, v, w = np.split(y.reshape(-1, 13), [3, 7, 10], 1)
        R = matrices(q)
        place, shaken, turned, turning = self.base_at(t)
        one, other = self.ties.T
        frames = [
            np.concatenate(pair)
            for pair in ((x, place[None]), (R, turned[None]), (v, shaken[None]))
        ]
        spins = np.concatenate([np.einsum("nij,nj->ni", R, w), [[0, 0, turning]]])
        arms, points, speeds = [], [], []
        for frame, point in ((one, self.a), (other, self.b)):
            arm = np.einsum("nij,nj->ni", frames[1][frame], point)
            arms.append(arm)
            points.append(frames[0][frame] + arm)
            speeds.append(frames[2][frame] + cross(spins[frame], arm))
        d = points[1] - points[0]
        length = np.sqrt((d * d).sum(1))
        rate_of_length = (d * (speeds[1] - speeds[0])).sum(1) / length
        force = (
            (stiffness * (length - self.free_length) + self.damping * rate_of_length) / length
        )[:, None] * d
        F, M = np.zeros((2, len(x) + 1, 3), force.dtype)  # complex numbers pass
        for frame, sign, arm in ((one, 1, arms[0]), (other, -1, arms[1])):
            np.add.at(F, frame, sign * force)
            np.add.at(M, frame, sign * cross(arm, force))
        moment = np.einsum("nji,nj->ni", R, M[:-1])
        q_rate = 0.5 * np.concatenate(
            [-(q[:, 1:] * w).sum(1, keepdims=True), q[:, :1] * w + cross(q[:, 1:], w)], 1
        )
        v_rate = F[:-1] / self.mass[:, None] - [0, G, 0]
        w_rate = (moment - cross(w, self.inertia * w)) / self.inertia
        return np.concatenate([v, q_rate, v_rate, w_rate], 1).ravel()

    def base_at(self, t: float):
        """Place, velocity, orientation and angular velocity about z of the base."""
        omega = 2 * np.pi * self.frequency
        c, s = np.cos(omega * t), np.sin(omega * t)
        C, S = np.cos(self.turn * c), np.sin(self.turn * c)
        turned = np.array([[C, -S, 0], [S, C, 0], [0, 0, 1]])
        return (
            self.base + [self.shake * c, 0, 0],
            np.array([-self.shake * omega * s, 0, 0]),
            turned,
            -self.turn * omega * s,
        )


def cross(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """a x b; np.cross takes ten times as long."""
    return a[:, [1, 2, 0]] * b[:, [2, 0, 1]] - a[:, [2, 0, 1]] * b[:, [1, 2, 0]]


def matrices(q: np.ndarray) -> np.ndarray:
    """Rotation matrices of quaternions of any length."""
    w, x, y, z = q.T
    s = 2 / (q * q).sum(1)
    rows = [
        [1 - s * (y * y + z * z), s * (x * y - w * z), s * (x * z + w * y)],
        [s * (x * y + w * z), 1 - s * (x * x + z * z), s * (y * z - w * x)],
        [s * (x * z - w * y), s * (y * z + w * x), 1 - s * (x * x + y * y)],
    ]
    return np.moveaxis(np.array(rows), 2, 0)
