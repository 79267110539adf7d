"""The second job: three boxes held apart by fourteen spring-dampers under tension, eight to the
shaking base and six between them."""

import numpy as np
from job import Job

# ties, -1 the base; points on the first body and on the second; stiffness; free length
SPRINGS = [
    (0, -1, [-0.13, 0.13, -0.09], [-0.5, -0.15, -0.4], 1500, 0.495),
    (0, -1, [0.11, 0.08, 0.06], [0.1, 0.0, 0.1], 1300, 0.697),
    (0, -1, [-0.11, -0.09, 0.04], [-0.6, -1.4, 0.3], 900, 0.458),
    (1, -1, [0.13, 0.1, -0.13], [0.5, -0.1, -0.4], 1600, 0.465),
    (1, -1, [-0.08, 0.1, 0.12], [0.2, 0.05, 0.3], 1200, 0.625),
    (1, -1, [0.09, -0.1, -0.07], [0.6, -1.35, -0.3], 800, 0.354),
    (2, -1, [0.02, 0.14, 0.13], [0.0, -0.2, 0.75], 1900, 0.567),
    (2, -1, [-0.02, -0.11, 0.15], [-0.1, -1.6, 0.8], 900, 0.365),
    (0, 1, [0.16, 0.06, 0.06], [-0.14, 0.09, 0.07], 700, 0.385),
    (0, 1, [0.13, -0.1, -0.07], [-0.13, -0.1, -0.04], 800, 0.412),
    (1, 2, [-0.02, 0.1, 0.16], [0.05, 0.13, -0.08], 600, 0.44),
    (1, 2, [0.1, -0.08, 0.1], [0.16, 0.02, 0.02], 750, 0.552),
    (2, 0, [-0.17, -0.04, -0.05], [-0.07, 0.09, 0.15], 650, 0.443),
    (2, 0, [-0.01, -0.13, -0.13], [0.09, -0.1, 0.09], 850, 0.394),
]
ONE, OTHER, A, B, STIFFNESS, FREE_LENGTH = (
    np.array(column) for column in zip(*SPRINGS, strict=True)
)

JOB = Job(
    name="three",
    mass=np.array([8.0, 6.0, 7.0]),
    inertia=np.array([[0.10, 0.16, 0.20], [0.09, 0.11, 0.15], [0.12, 0.14, 0.18]]),
    position=np.array([[0.09, 0.11, 0.21], [0.75, 0.18, 0.12], [0.39, -0.08, 0.7]]),
    base=np.array([0.4, 0.9, 0.2]),
    ties=np.stack([ONE, OTHER], 1),
    a=A,
    b=B,
    stiffness=1.0 * STIFFNESS,
    true_stiffness=STIFFNESS
    * np.array([1.1, 0.95, 1.05, 0.9, 1.02, 0.97, 1.08, 0.93, 1.04, 0.96, 1.06, 0.92, 1.03, 0.98]),
    free_length=FREE_LENGTH,
    damping=5.0,
    steps=4,
    steps_per_second=250,
    saves_per_long_step=2,
)
