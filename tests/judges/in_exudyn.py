"""A model in Exudyn: every body moves freely there, joints and closures of a model alike are
conditions with multipliers."""

import exudyn
import numpy as np
import rigs
from exudyn.rigidBodyUtilities import RigidBodyInertia
from exudyn.utilities import GenericJoint, MarkerBodyRigid

import jaxbody as jb

FREE = {  # of three moves and three turns in axes whose third is that of the joint: which are held
    jb.Hinge: (1, 1, 1, 1, 1, 0),
    jb.Ball: (1, 1, 1, 0, 0, 0),
    jb.Guide: (1, 1, 0, 1, 1, 1),
    jb.closures.Ball: (1, 1, 1, 0, 0, 0),
    jb.closures.Guide: (1, 1, 0, 1, 1, 1),
    jb.closures.Inline: (1, 1, 0, 0, 0, 0),
    jb.closures.Weld: (1, 1, 1, 1, 1, 1),
}


def in_axes(direction):
    """Axes whose third is a direction."""
    n = np.asarray(direction, float) / np.linalg.norm(direction)
    t = np.linalg.svd(n[None])[2][1]
    return np.array([t, np.cross(n, t), n]).T


class Judge:
    """The same bodies, joints, closures and springs, the supports at rest; `start`: {body:
    (position, rotation matrix)}."""

    def __init__(self, model, start):
        self.model, self.container = model, exudyn.SystemContainer()
        self.system = self.container.AddSystem()
        ground = self.system.CreateGround()
        self.places = {"world": (np.zeros(3), np.eye(3))} | {
            name: (np.asarray(model[name].position), rigs.turned(model[name].orientation))
            for name in model.layout.frames[1:]
        }
        self.bodies = dict.fromkeys(("world", *model.layout.supports), ground)
        self.nodes = {}
        for name in model.layout.bodies:
            body, (p, R) = model[name], self.places[name]
            c = np.array(body.com)
            about_O = np.array(body.inertia) + float(body.mass) * (
                c @ c * np.eye(3) - np.outer(c, c)
            )
            made = self.system.CreateRigidBody(
                inertia=RigidBodyInertia(mass=float(body.mass), inertiaTensor=about_O, com=c),
                nodeType=exudyn.NodeType.RotationEulerParameters,
                referencePosition=list(p),
                referenceRotationMatrix=R,
                initialDisplacement=list(start[name][0] - p),
                initialRotationMatrix=start[name][1] @ R.T,
                gravity=list(np.array(model.gravity)),
                returnDict=True,
            )
            self.bodies[name], self.nodes[name] = made["bodyNumber"], made["nodeNumber"]
        for name, parent in zip(model.layout.bodies, model.layout.parents, strict=True):
            self.joint(name, parent, model.joint(name))
        for name in model.closure_names:
            self.closure(model[name])
        for name in model.element_names:
            self.spring(model[name])
        self.system.Assemble()

    def in_world(self, frame, point):
        p, R = self.places[frame]
        return p + R @ np.asarray(point)

    def in_own(self, frame, place):
        """A point of the reference pose in the axes of the body there; those of supports are the
        world's, as they are at rest."""
        if frame not in self.nodes:
            return np.asarray(place, float)
        p, R = self.places[frame]
        return R.T @ (place - p)

    def turned(self, frame):
        return self.places[frame][1] if frame in self.nodes else np.eye(3)

    def joint(self, body, parent, joint):
        if isinstance(joint, jb.Free):
            return
        place = self.places[body][0] if joint.at is None else self.in_world(parent, joint.at)
        axis = (
            np.array([0, 0, 1.0])
            if isinstance(joint, jb.Ball)
            else self.places[parent][1] @ np.asarray(joint.axis)
        )
        self.condition(type(joint), (parent, place), (body, place), axis)

    def closure(self, closure):
        (A, B), a, b = closure.between, np.asarray(closure.a), np.asarray(closure.b)
        a, b = self.in_world(A, a), self.in_world(B, b)
        if isinstance(closure, jb.closures.Rod):
            length = np.linalg.norm(b - a) if closure.length is None else closure.length
            self.system.CreateDistanceConstraint(
                bodyNumbers=[self.bodies[A], self.bodies[B]],
                localPosition0=list(self.in_own(A, a)),
                localPosition1=list(self.in_own(B, b)),
                distance=float(length),
            )
            return
        axis = self.places[A][1] @ np.asarray(getattr(closure, "axis", [0, 0, 1.0]))
        self.condition(type(closure), (A, a), (B, b), axis)

    def condition(self, kind, one, other, axis):
        markers = [
            self.system.AddMarker(
                MarkerBodyRigid(
                    bodyNumber=self.bodies[name], localPosition=list(self.in_own(name, place))
                )
            )
            for name, place in (one, other)
        ]
        axes = [self.turned(name).T @ in_axes(axis) for name, _ in (one, other)]
        self.system.AddObject(
            GenericJoint(
                markerNumbers=markers,
                constrainedAxes=list(FREE[kind]),
                rotationMarker0=axes[0],
                rotationMarker1=axes[1],
            )
        )

    def spring(self, spring):
        (A, B), ends = spring.between, (spring.a, spring.b)
        points = [
            list(self.in_own(name, self.in_world(name, p)))
            for name, p in zip((A, B), ends, strict=True)
        ]
        self.system.CreateSpringDamper(
            bodyNumbers=[self.bodies[A], self.bodies[B]],
            localPosition0=points[0],
            localPosition1=points[1],
            referenceLength=float(spring.free_length),
            stiffness=float(spring.stiffness),
            damping=float(spring.damping),
        )

    def rest(self):
        """{body: (position, rotation matrix)} where its static solver ends."""
        settings = exudyn.SimulationSettings()
        settings.staticSolver.numberOfLoadSteps = 1
        # its tangent leaves out the stiffness due to the forces of conditions
        settings.staticSolver.newton.maxIterations = 500
        settings.staticSolver.newton.relativeTolerance = 1e-11
        settings.staticSolver.newton.absoluteTolerance = 1e-10
        settings.staticSolver.verboseMode = 0
        settings.solution.file.write = False
        self.system.SolveStatic(settings)
        kinds = exudyn.OutputVariableType.Position, exudyn.OutputVariableType.RotationMatrix
        found = {
            name: [np.array(self.system.GetNodeOutput(node, kind)) for kind in kinds]
            for name, node in self.nodes.items()
        }
        return {name: (p, R.reshape(3, 3)) for name, (p, R) in found.items()}
