"""Joints of MJCF: one or several of a body as a joint, and their springs and dampers as torsions and bushings."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from jaxbody.core.errors import JaxbodyError, Problem
from jaxbody.elements.bushings import Bushing
from jaxbody.elements.elements import Element
from jaxbody.elements.torsions import Torsion
from jaxbody.interchange.mjcf_geometry import ORIGIN, Place, about, from_z_to, product
from jaxbody.joints.composite_joints import Composite
from jaxbody.joints.elementary_joints import Ball, Guide, Hinge
from jaxbody.models.joints import Free, Joint
from jaxbody.models.layouts import WORLD

STEPS = {"slide": "move", "hinge": "turn"}
SEVERAL = "springs and dampers of several joints of one body that turns"
LARGE_TURNS = "damping of ball joints at large turns, where it is that of the rotation vector"


@dataclass(frozen=True, eq=False)
class JointOfBody:
    """A joint as the file states it: its kind (slide, hinge, ball or free), and in the axes of its body its point and axis; `relaxed`: the
    displacement or angle from the pose in the file at which its spring exerts no force."""

    name: str
    where: str
    kind: str
    at: np.ndarray
    axis: np.ndarray
    stiffness: float
    damping: float
    relaxed: float

    def motion_to_relaxed(self) -> Place:
        """The motion from the pose in the file to where its spring exerts no force."""
        if self.kind == "slide":
            return Place(self.relaxed * self.axis, ORIGIN.q)
        turn = Place(np.zeros(3), about(self.axis, self.relaxed if self.kind == "hinge" else 0.0))
        return Place(self.at - turn.point(self.at), turn.q)


def joint_of(joints: list[JointOfBody], parent: str, on_parent: Place) -> Joint:
    """The joint that carries a body, in the parent's frame. Error: WRONG_KIND."""
    first = joints[0]
    if len(joints) == 1 and first.kind == "free":
        if parent != WORLD:
            raise JaxbodyError(Problem("WRONG_KIND", first.where, f"is free on '{parent}'", parent, WORLD, "A free body has no parent."))
        return Free()
    at = [on_parent.point(joint.at) for joint in joints]
    if len(joints) == 1 and first.kind == "ball":
        return Ball(parent, at=at[0] if first.at.any() else None)
    axes = [on_parent.R @ joint.axis for joint in joints]
    if len(joints) > 1:
        for joint in joints:
            if joint.kind not in STEPS:
                message = f"is a {joint.kind} joint, one of several of its body"
                hint = "Put a body with a small mass between them."
                raise JaxbodyError(Problem("WRONG_KIND", joint.where, message, joint.kind, ", ".join(STEPS), hint))
        return Composite(parent, [STEPS[joint.kind] for joint in joints], directions=axes, points=at)
    if first.kind == "slide":
        return Guide(parent, axis=axes[0])
    return Hinge(parent, axis=axes[0], at=at[0] if first.at.any() else None)


def spring_of(joint: JointOfBody, joints: list[JointOfBody], body: str, parent: str, on_parent: Place) -> Element | str:
    """The spring and damper of one of a body's joints, or why there is none.

    A turn is read from the poses if it is the body's only one, a slide if the body does not turn: from the displacement d on the parent,
    q_i = n*_i . d, where n*_i . n_j is 1 for i = j, else 0.
    """
    at = (parent, on_parent.point(joint.at)), (body, joint.at)
    turns = [other for other in joints if other.kind != "slide"]
    if joint.kind == "free":
        return "springs and dampers of free joints"
    if joint.kind == "ball":
        k, c = (np.diag([0, 0, 0, x, x, x]) for x in (joint.stiffness, joint.damping))
        return Bushing(*at, stiffness=k, damping=c, orientation=on_parent.q)
    if joint.kind == "hinge":
        laws = {"spring": joint.stiffness or None, "damper": joint.damping or None}
        return Torsion(*at, axis=joint.axis, free_angle=joint.relaxed, orientation=on_parent.q, **laws) if len(turns) == 1 else SEVERAL
    if turns:
        return SEVERAL
    along = np.linalg.pinv(np.stack([other.axis for other in joints]))[:, joints.index(joint)]
    q = from_z_to(along)
    k, c = (np.array([0, 0, x * (along @ along)]) for x in (joint.stiffness, joint.damping))
    relaxed = parent, on_parent.point(joint.at + joint.relaxed * joint.axis)
    return Bushing(relaxed, at[1], stiffness=k, damping=c, orientation=product(on_parent.q, q), orientation_b=q)
