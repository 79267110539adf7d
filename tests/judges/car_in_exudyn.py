"""The full car on double wishbones in Exudyn: bodies move freely, joints and closures are
conditions; anti-roll bars are left out."""

import time

import exudyn
import numpy as np
from exudyn.utilities import (
    CartesianSpringDamper,
    GenericJoint,
    MarkerBodyRigid,
    RigidBodySpringDamper,
)
from in_exudyn import Judge

import jaxbody as jb


class Car(Judge):
    """The car as it is drawn, on roads that `lift` {wheel: function of time} raises."""

    def __init__(self, model, lift):
        self.lift, self.tyres = lift, {}
        super().__init__(
            model,
            {name: (np.asarray(model[name].position), np.eye(3)) for name in model.layout.bodies},
        )

    def joint(self, body, parent, joint):
        if not isinstance(joint, jb.joints.HeavePitchRoll):
            super().joint(body, parent, joint)
            return
        own, ground = self.marker(body, [0, 0, 0]), self.marker("world", self.places[body][0])
        # it then holds y . x of the car, which pitches and then rolls
        turned = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
        self.system.AddObject(
            GenericJoint(
                markerNumbers=[ground, own],
                constrainedAxes=[1, 1, 0, 0, 0, 1],
                rotationMarker0=turned,
                rotationMarker1=turned,
            )
        )

    def marker(self, body, point):
        return self.system.AddMarker(
            MarkerBodyRigid(
                bodyNumber=self.bodies[body], localPosition=list(np.asarray(point, float))
            )
        )

    def spring(self, element):
        if isinstance(element, jb.Spring):
            super().spring(element)
        elif isinstance(element, jb.Tyre):
            # as long as it touches: k (radius - half the engagement - height of the hub)
            (hub, road), k = element.between, float(element.stiffness)
            at = self.places[hub][0] + np.asarray(element.a)
            below = float(element.radius) - float(element.engagement) / 2
            markers = [self.marker("world", [at[0], at[1], 0.0]), self.marker(hub, element.a)]
            made = CartesianSpringDamper(
                markerNumbers=markers, stiffness=[0, 0, k], damping=[0, 0, 0], offset=[0, 0, below]
            )
            self.tyres[road.removeprefix("road ")] = self.system.AddObject(made), below
        elif isinstance(element, jb.Bushing):
            (one, other), k = element.between, np.diag([*np.asarray(element.stiffness), 0, 0, 0])
            place = self.in_world(one, element.a)
            markers = [self.marker(other, self.in_own(other, place)), self.marker(one, element.a)]
            self.system.AddObject(
                RigidBodySpringDamper(markerNumbers=markers, stiffness=k, damping=np.zeros((6, 6)))
            )

    def motion(self, end, steps):
        """(place of the car, height of the hub of the wheel fl, seconds that it took) after a
        motion by the generalized-alpha method."""
        settings = exudyn.SimulationSettings()

        def before_step(system, t):
            for wheel, lift in self.lift.items():
                number, below = self.tyres[wheel]
                system.SetObjectParameter(number, "offset", [0, 0, below + float(lift(t))])
            return True

        self.system.SetPreStepUserFunction(before_step)
        settings.timeIntegration.endTime, settings.timeIntegration.numberOfSteps = end, steps
        settings.timeIntegration.verboseMode = 0
        settings.timeIntegration.generalizedAlpha.spectralRadius = 0.9
        settings.timeIntegration.newton.useModifiedNewton = True
        settings.solution.file.write = False
        settings.linearSolver.solverType = exudyn.LinearSolverType.EigenSparse
        begin = time.perf_counter()
        self.system.SolveDynamic(settings)
        spent = time.perf_counter() - begin
        position = [
            self.system.GetNodeOutput(self.nodes[name], exudyn.OutputVariableType.Position)
            for name in ("car", "fl upright")
        ]
        return np.concatenate(position), spent
