"""Exudyn on the same models: bushings, and the rest of closed loops by its conditions
with multipliers."""

import jax.numpy as jnp
import numpy as np
import pytest

import jaxbody as jb
from jaxbody.geometry import rotations
from jaxbody.model.joints.frame_tables import frames_of
from jaxbody.suspension.presets import presets

exudyn = pytest.importorskip("exudyn", reason="needs exudyn: pip install 'jaxbody[judges]'")

import in_exudyn  # noqa: E402
import judged_models  # noqa: E402
from car_in_exudyn import Car  # noqa: E402

SIX = [
    np.diag([*k, *turn])
    for k, turn in zip(
        presets.MOUNT_STIFFNESS,
        np.array([[800.0, 500, 300], [200, 900, 400], [600, 300, 700]]),
        strict=True,
    )
]
START = np.array([0.01, -0.008, 0.012, 0.05, -0.04, 0.06])  # displacement and rotation vector


def engine(damping):
    """On three bushings of six stiffnesses."""
    inertia = {"mass": 139.5, "inertia": presets.ENGINE}
    return jb.Model(
        bodies={"engine": jb.Body(**inertia)},
        elements={
            f"mount {i}": jb.Bushing(("engine", p), ("world", p), stiffness=k, damping=damping * k)
            for i, (p, k) in enumerate(zip(presets.MOUNTS, SIX, strict=True), 1)
        },
    )


def by_exudyn(damping, end, scale, intrinsic=True):
    """Natural frequencies, and where the engine is at `end` after a release at scale
    times START."""
    from exudyn.rigidBodyUtilities import RigidBodyInertia
    from exudyn.utilities import MarkerBodyRigid, RigidBodySpringDamper

    system = exudyn.SystemContainer().AddSystem()
    inertia = RigidBodyInertia(mass=139.5, inertiaTensor=presets.ENGINE, com=[0, 0, 0])
    body = system.CreateRigidBody(
        inertia=inertia, nodeType=exudyn.NodeType.RotationRotationVector, returnDict=True,
        referencePosition=[0, 0, 0], initialDisplacement=list(scale * START[:3]),
        initialRotationMatrix=rotations.exp(jnp.asarray(scale * START[3:])).tolist(),
    )  # fmt: skip
    ground = system.CreateGround()
    for p, k in zip(presets.MOUNTS, SIX, strict=True):
        markers = [
            system.AddMarker(MarkerBodyRigid(bodyNumber=b, localPosition=p))
            for b in (body["bodyNumber"], ground)
        ]
        system.AddObject(
            RigidBodySpringDamper(
                markerNumbers=markers,
                stiffness=k,
                damping=damping * k,
                useIntrinsicFormulation=intrinsic,
            )
        )
    system.Assemble()
    values, _ = system.ComputeODE2Eigenvalues()
    settings = exudyn.SimulationSettings()
    settings.timeIntegration.endTime = end
    settings.timeIntegration.numberOfSteps = 4000
    settings.timeIntegration.verboseMode = 0
    settings.solution.file.write = False
    system.SolveDynamic(settings, solverType=exudyn.DynamicSolverType.RK44)
    place = system.GetNodeOutput(body["nodeNumber"], exudyn.OutputVariableType.Position)
    R = system.GetNodeOutput(body["nodeNumber"], exudyn.OutputVariableType.RotationMatrix).reshape(
        3, 3
    )
    return np.sqrt(values) / (2 * np.pi), place, R


def test_frequencies():
    frequency, *_ = by_exudyn(0.0, 1e-3, 0.0, intrinsic=False)
    model = engine(0.0)
    np.testing.assert_allclose(
        jb.modes(jb.linearize(model, model.reference)).frequency, frequency, rtol=1e-7
    )


def test_motion_to_second_order_in_the_deformation():
    """Damped, released and let swing for 0.3 s. Exudyn applies K e, e the logarithm of the relative
    pose, at a frame midway; ours is the gradient of e' K e/2. The two agree to first order, so ten
    times less motion differs a hundred times less."""
    model, apart = engine(1e-3), []
    for scale in (0.1, 0.01):
        start = jb.State(jb.joints.retract(model, model.reference.q, scale * START), jnp.zeros(6))
        pose = jb.simulate(model, [0.0, 0.15, 0.3], initial=start, rtol=1e-11).poses["engine"]
        _, place, R = by_exudyn(1e-3, 0.3, scale)
        apart.append(max(abs(pose.p[-1] - place).max(), abs(pose.R[-1] - R).max()))
        assert apart[-1] <= 1e-2 * scale * abs(scale * START).max()
    assert apart[1] <= apart[0] / 90


@pytest.mark.long
@pytest.mark.parametrize(
    "name", ["strut_corner", "clamped_frame"]
)  # its tangent lacks the stiffness due to forces, and diverges for others
def test_rests_of_closed_loops(name, rng):
    """From near the rest, where no loop is closed: its solver holds every joint by conditions."""
    model = judged_models.MODELS[name]()
    eq = jb.equilibrium(model)

    def poses(q):
        frames = frames_of(model, jb.State(q, eq.state.v))
        rows = {name: model.layout.frame(name) for name in model.layout.bodies}
        return {
            name: (np.asarray(frames.p[row]), np.asarray(frames.R[row]))
            for name, row in rows.items()
        }

    near = poses(jb.joints.retract(model, eq.state.q, 0.01 * rng.normal(size=model.layout.nv)))
    found = in_exudyn.Judge(model, near).rest()
    for name, expected in poses(eq.state.q).items():
        for ours, theirs in zip(expected, found[name], strict=True):
            np.testing.assert_allclose(ours, theirs, atol=1e-9)


@pytest.mark.long
def test_a_car_on_double_wishbones_goes_over_a_kerb():
    """It rests as it is drawn, and half a second later hub and car are where Exudyn's
    generalized-alpha method has them: its error falls to a quarter with steps of half the length,
    so that two runs give the limit."""
    model, end = jb.suspension.car_on_double_wishbones(anti_roll=(1e-6, 1e-6)).model, 0.5
    still, _ = Car(model, {}).motion(0.1, 100)
    np.testing.assert_allclose(still, [0, 0, 0.5, 1.2, 0, 0], atol=1e-12)
    half, whole = (
        Car(model, {"fl": lambda t: 0.02 * np.clip(t / 0.05, 0, 1)}).motion(end, steps)[0]
        for steps in (1000, 2000)
    )
    motion = {"road fl": lambda t: 0.02 * jnp.clip(t / 0.05, 0, 1) * np.array([0, 0, 1.0, 0, 0, 0])}
    run = jb.simulate(model, [0.0, end], motion=motion)
    found = np.concatenate([np.asarray(run.poses[name].p[-1]) for name in ("car", "fl upright")])
    assert found[2] - 0.5 > 2e-3 and found[5] > 1e-2
    np.testing.assert_allclose(found, (4 * whole - half) / 3, atol=1e-6)
