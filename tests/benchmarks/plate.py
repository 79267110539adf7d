"""The reference job: one plate (10 kg) on five spring-dampers under a shaking base, hung from two
of them."""

import numpy as np
from job import Job

L, MASS, G = 0.1, 10.0, 9.81
ON_PLATE = np.array([[-3 * L, L, 0], [3 * L, L, 0], [0, -L, 0.05], [0, 0, 0.1], [0.1, 0, -0.1]])
ON_BASE = np.array(
    [[-5 * L, 3 * L, 0], [5 * L, 3 * L, 0], [0, -3 * L, 0.05], [0, 0, 0.6], [0.1, 0, -0.6]]
)  # world, base at rest
BASE = np.array([0, -0.4, 0])
STIFFNESS = np.array([MASS * G / L, MASS * G / L, 2000.0, 2000.0, 2000.0])

JOB = Job(
    name="plate",
    mass=np.array([MASS]),
    inertia=np.array([[0.3, 0.9, 1.2]]),
    position=np.zeros((1, 3)),
    base=BASE,
    ties=np.array([(0, -1)] * 5),
    a=ON_PLATE,
    b=ON_BASE - BASE,
    stiffness=STIFFNESS,
    true_stiffness=STIFFNESS * np.array([1.1, 0.95, 1.05, 0.9, 1.02]),
    free_length=np.linalg.norm(ON_BASE - ON_PLATE, axis=1)
    - np.array([L * np.sqrt(2) / 2] * 2 + [0, 0, 0]),
    damping=5.0,
)
