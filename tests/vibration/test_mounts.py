"""Which of the twelve stiffnesses of four parallel three-axis mounts the natural motions of a rigid
body determine.

The motions determine at most the 6 x 6 stiffness matrix. For mounts at the corners of a rectangle,
8 combinations of the stiffnesses are determined; for another plane quadrilateral 9; for four points
in general position all 12.
"""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb

STIFFNESS = 1e4 * np.array([[8.0, 11, 20], [9, 14, 26], [12, 10, 23], [7, 13, 18]])
RECTANGLE = [[0.4, 0.3, -0.2], [-0.4, 0.3, -0.2], [-0.4, -0.3, -0.2], [0.4, -0.3, -0.2]]
QUADRILATERAL = [[0.45, 0.3, -0.2], [-0.35, 0.37, -0.2], [-0.4, -0.2, -0.2], [0.3, -0.41, -0.2]]
GENERAL = [[0.45, 0.3, -0.2], [-0.35, 0.37, 0.15], [-0.4, -0.2, -0.3], [0.3, -0.41, 0.05]]
AMPLITUDE = 1e-6  # of the motions [m, rad]: their curvature enters with its square


def mounted(points) -> jb.Model:
    return jb.Model(
        bodies={"engine": jb.Body(mass=140.0, inertia=[8.0, 4.0, 7.0], com=[0.02, 0.01, 0.03])},
        elements={
            f"mount{i}": jb.Bushing(("engine", p), ("world", p), stiffness=k)
            for i, (p, k) in enumerate(zip(points, STIFFNESS, strict=True), 1)
        },
    )


def natural_motions(model: jb.Model, times) -> dict[str, jb.Experiment]:
    modes = jb.modes(jb.linearize(model, model.reference))
    runs, sensors = {}, {"pose": jb.sensors.BodyPose("engine")}
    for i in range(6):
        shape = modes.shapes[:, i] / jnp.abs(modes.shapes[:, i]).max()
        q = jb.joints.retract(model, model.reference.q, AMPLITUDE * shape)
        initial = jb.State(q, model.reference.v)
        measured = jb.measure(jb.simulate(model, times, initial=initial, rtol=1e-11), sensors)
        runs[f"mode{i + 1}"] = jb.Experiment(
            times, initial=initial, sensors=sensors, measured=measured
        )
    return runs


@pytest.mark.long
@pytest.mark.filterwarnings("ignore::jaxbody.JaxbodyWarning")
@pytest.mark.parametrize(
    "points, rank",
    [(RECTANGLE, 8), (QUADRILATERAL, 9), (GENERAL, 12)],
    ids=["rectangle", "plane", "general"],
)
def test_the_rank_is_that_of_the_geometry(points, rank):
    model = mounted(points)
    start = jb.replace(model, {"*.stiffness": STIFFNESS * np.array([1.1, 0.92, 1.07])})
    fit = jb.fit(
        start, natural_motions(model, np.linspace(0, 0.12, 13)), free=["*.stiffness"], rtol=1e-11
    )
    assert int(np.sum(fit.singular_values > 1e-6 * fit.singular_values[0])) == rank
    assert len(fit.unidentified) == 12 - rank
    errors = np.stack([fit.standard_errors[f"mount{i}.stiffness"] for i in range(1, 5)])
    if rank == 12:
        result = np.stack([fit.estimates[f"mount{i}.stiffness"] for i in range(1, 5)])
        np.testing.assert_allclose(result, STIFFNESS, rtol=1e-6)
        assert fit.ok and np.isfinite(errors).all()
    else:
        assert fit.status == jb.Status.NOT_IDENTIFIABLE
        assert np.isinf(errors).any(axis=1).all()
        assert all(" up" in words and " down" in words for words in fit.unidentified)
