"""The same jobs by other installed programs: MuJoCo, Exudyn, and SciPy with a NumPy
right-hand side.

In MuJoCo and Exudyn dampers do not see the velocity of a base with an imposed motion. Here the base
is therefore a body of 1e10 kg on its own springs, whose free vibration is the imposed motion; it is
integrated with the same method as the rest.
"""

from collections.abc import Callable

import numpy as np
from job import TIMES, G, Job
from scipy.spatial.transform import Rotation

HEAVY = 1e10  # kg and kg m2
SECOND = np.array([0.0, 1.0])
# for each save: the fewest that the errors allowed need
MUJOCO_STEPS, EXUDYN_STEPS = {"plate": 3, "three": 8}, {"plate": 3, "three": 6}
# name -> (function, how many times the task it is a part of)
Peers = dict[str, tuple[Callable[[], np.ndarray], float]]
FEW = 5  # sets of the thousand in T3


def tasks(job: Job) -> tuple[Peers, list[str]]:
    """What is installed, and a word on what is not."""
    result, skipped = by_scipy(job), []
    for name, build in (("MuJoCo", by_mujoco), ("Exudyn", by_exudyn)):
        try:
            result |= build(job)
        except ImportError as error:
            skipped.append(f"{name}: {error}")
    return result, skipped


def by_scipy(job: Job) -> Peers:
    def one(stiffness, times):
        return job.solution(stiffness, times, rtol=2e-6)

    return of(job, "SciPy DOP853", one)


def of(job: Job, name: str, path: Callable) -> Peers:
    """T1, and T3 as a loop of which a few passes are timed."""
    few = job.several_stiffnesses(1000)[:: 1000 // FEW]
    return {
        f"T1 {name}": (lambda: path(job.stiffness, TIMES), 1.0),
        f"T3 {name}": (lambda: np.stack([path(k, SECOND)[-1] for k in few]), 1000 / FEW),
    }


def mujoco_model(job: Job) -> str:
    """MJCF: bodies with free joints, springs as tendons between sites, the base on a slide and a
    hinge that swing by themselves."""

    def text(x) -> str:
        return " ".join(repr(float(value)) for value in x)

    sites: list[list[str]] = [[] for _ in range(len(job.mass) + 1)]
    tendons = []
    for i, (one, other) in enumerate(job.ties):
        sites[one].append(f'<site name="a{i}" pos="{text(job.a[i])}"/>')
        sites[other].append(f'<site name="b{i}" pos="{text(job.b[i])}"/>')
        attributes = (
            f'springlength="{job.free_length[i]!r}" stiffness="{job.stiffness[i]!r}" '
            f'damping="{job.damping!r}"'
        )
        tendons.append(f'<spatial {attributes}><site site="a{i}"/><site site="b{i}"/></spatial>')
    swing = f'stiffness="{HEAVY * (2 * np.pi * job.frequency) ** 2!r}"'
    bodies = "".join(
        (
            f'<body pos="{text(p)}"><freejoint/><inertial pos="0 0 0" mass="{m!r}" '
            f'diaginertia="{text(J)}"/>{"".join(points)}</body>'
        )
        for p, m, J, points in zip(job.position, job.mass, job.inertia, sites[:-1], strict=True)
    )
    return f"""<mujoco><option integrator="RK4" gravity="0 {-G} 0"><flag contact="disable"/></option><worldbody>
        <body pos="{text(job.base)}"><joint type="slide" axis="1 0 0" {swing}/><joint type="hinge" axis="0 0 1" {swing}/>
        <inertial pos="0 0 0" mass="{HEAVY!r}" diaginertia="{text([HEAVY] * 3)}"/>{"".join(sites[-1])}</body>
        {bodies}</worldbody><tendon>{"".join(tendons)}</tendon></mujoco>""".replace(  # noqa: E501
        "np.float64(", ""
    ).replace(")", "")


def by_mujoco(job: Job) -> Peers:
    import mujoco
    from mujoco import rollout

    model = mujoco.MjModel.from_xml_string(mujoco_model(job))
    data = mujoco.MjData(model)
    model.opt.timestep = (TIMES[1] - TIMES[0]) / MUJOCO_STEPS[job.name]
    n = len(job.mass)

    def path(stiffness, times):
        model.tendon_stiffness[:] = stiffness
        mujoco.mj_resetData(model, data)
        data.qpos[:2] = job.shake, job.turn
        start = np.zeros(mujoco.mj_stateSize(model, mujoco.mjtState.mjSTATE_FULLPHYSICS))
        mujoco.mj_getState(model, data, start, mujoco.mjtState.mjSTATE_FULLPHYSICS)
        steps = round((times[-1] - times[0]) / model.opt.timestep)
        states, _ = rollout.rollout(model, data, start, nstep=steps)
        every = steps // (len(times) - 1)
        return np.vstack([job.places(job.start), states[0, every - 1 :: every, 3 : 3 + 7 * n]])

    return of(job, "MuJoCo RK4", path)


def by_exudyn(job: Job) -> Peers:
    import exudyn
    from exudyn.rigidBodyUtilities import RigidBodyInertia
    from exudyn.utilities import SensorBody

    def path(stiffness, times):
        container = exudyn.SystemContainer()
        system = container.AddSystem()

        def body(mass, moments, place, **options):
            inertia = RigidBodyInertia(mass=mass, inertiaTensor=np.diag(moments), com=[0, 0, 0])
            node = exudyn.NodeType.RotationRotationVector
            return system.CreateRigidBody(
                inertia=inertia, nodeType=node, referencePosition=list(place), **options
            )

        ground = system.CreateGround()
        bodies = [
            body(m, J, p, gravity=[0, -G, 0])
            for m, J, p in zip(job.mass, job.inertia, job.position, strict=True)
        ]
        turned = Rotation.from_rotvec([0, 0, job.turn]).as_matrix()
        base = body(
            HEAVY,
            [HEAVY] * 3,
            job.base,
            initialDisplacement=[job.shake, 0, 0],
            initialRotationMatrix=turned,
        )
        swing = HEAVY * (2 * np.pi * job.frequency) ** 2
        system.CreateCartesianSpringDamper(
            itemNumbers=[ground, base], localPosition0=list(job.base), stiffness=[swing] * 3
        )
        system.CreateTorsionalSpringDamper(
            itemNumbers=[ground, base], position=list(job.base), axis=[0, 0, 1], stiffness=swing
        )
        for (one, other), a, b, k, length in zip(
            job.ties, job.a, job.b, stiffness, job.free_length, strict=True
        ):
            system.CreateSpringDamper(
                itemNumbers=[[*bodies, base][one], [*bodies, base][other]],
                localPosition0=list(a),
                localPosition1=list(b),
                referenceLength=float(length),
                stiffness=float(k),
                damping=job.damping,
            )
        kinds = exudyn.OutputVariableType.Position, exudyn.OutputVariableType.RotationMatrix
        sensors = [
            [
                system.AddSensor(
                    SensorBody(bodyNumber=b, storeInternal=True, outputVariableType=kind)
                )
                for kind in kinds
            ]
            for b in bodies
        ]
        system.Assemble()
        settings = exudyn.SimulationSettings()
        time = settings.timeIntegration
        time.endTime, time.verboseMode = times[-1] - times[0], 0
        time.numberOfSteps = round(time.endTime / (TIMES[1] - TIMES[0]) * EXUDYN_STEPS[job.name])
        settings.solution.file.write = False
        settings.solution.sensors.writePeriod = times[1] - times[0]
        system.SolveDynamic(settings, solverType=exudyn.DynamicSolverType.RK44)
        parts = []
        for position, matrix in sensors:
            p, R = (
                np.asarray(system.GetSensorStoredData(sensor))[:, 1:]
                for sensor in (position, matrix)
            )
            quaternion = Rotation.from_matrix(R.reshape(-1, 3, 3)).as_quat(scalar_first=True)
            parts += [p, quaternion * np.sign(quaternion[:, :1])]
        return np.hstack(parts)

    return of(job, "Exudyn RK4", path)
