"""Reference results of T2 and T4 from SciPy: the gradient by complex steps, frequencies by Newton's
method and an eigenvalue solver."""

from dataclasses import replace

import numpy as np
import scipy.linalg
from job import Job


def gradient(job: Job) -> np.ndarray:
    """Of the sum of squares to the target's path, for all stiffnesses; complex numbers pass through
    the equations of motion."""
    target, result = job.solution(job.true_stiffness, rtol=1e-10), []
    for i in range(len(job.stiffness)):
        step = 1e-30j * np.eye(len(job.stiffness))[i]
        path = job.solution(job.stiffness + step, rtol=1e-10)
        result.append(np.sum((path - target) ** 2).imag / 1e-30)
    return np.array(result)


def frequencies(job: Job, stiffnesses: np.ndarray) -> np.ndarray:
    """Natural frequencies [Hz] about the equilibrium of each set of stiffnesses."""
    still = replace(job, shake=0.0, turn=0.0, damping=0.0)
    inertia = np.concatenate([np.repeat(job.mass[:, None], 3, 1), job.inertia], 1)

    def force(k, y):
        """Generalized force at rest, turns in body axes."""
        return (inertia * still.rate(0.0, y, k).reshape(-1, 13)[:, 7:]).ravel()

    def moved(y, step):
        """Displaced by the first three of each body's six numbers, turned by the rest, to
        first order."""
        y, step = y.reshape(-1, 13) + 0 * step.sum(), step.reshape(-1, 6)
        (w, *v), half = y[:, 3:7].T, step[:, 3:].T / 2
        turn = [-np.sum(v * half, 0), *(w * half + np.cross(np.transpose(v), half.T).T)]
        y[:, 3:7] += np.transpose(turn)
        y[:, :3] += step[:, :3]
        return y.ravel()

    def stiffness(k, y):
        steps = 1e-30j * np.eye(inertia.size)
        return -np.stack([force(k, moved(y, step)).imag / 1e-30 for step in steps], 1)

    result = []
    for k in stiffnesses:
        y = job.start
        for _ in range(12):
            y = moved(y, np.linalg.solve(stiffness(k, y), force(k, y))).reshape(-1, 13)
            y[:, 3:7] /= np.linalg.norm(y[:, 3:7], axis=1, keepdims=True)
            y = y.ravel()
        assert np.abs(force(k, y)).max() < 1e-9
        K = stiffness(k, y)
        result.append(
            np.sqrt(scipy.linalg.eigh((K + K.T) / 2, np.diag(inertia.ravel()), eigvals_only=True))
            / (2 * np.pi)
        )
    return np.array(result)
