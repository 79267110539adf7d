"""Compliant joints: a model in which some joints and closures are bushings at the same place, so
that one drawing serves for ideal and for compliant joints.

A bushing has the stiffness of the compliance in axes of the joint: z along its axis, x across it,
where it has one; else the axes of its parent. It is relaxed in the reference pose if the closure is
fulfilled there.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, is_concrete
from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.geometry import closures, rotations
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.vectors import cross, dot
from jaxbody.model.elements.bushings import Bushing
from jaxbody.model.elements.elements import Element
from jaxbody.model.elements.springs import Spring
from jaxbody.model.joints.combined_joints import Cylindrical
from jaxbody.model.joints.joints import Ball, Fixed, Guide, Hinge, Joint
from jaxbody.model.models import Model, pose_at_reference

JOINTS = (Ball, Hinge, Guide, Cylindrical, Fixed)
CLOSURES = (closures.Ball, closures.Hinge, closures.Guide, closures.Weld, closures.Rod)


@dataclass(frozen=True)
class Compliance:
    """The stiffness and damping of a joint, for `compliant`.

    Args:
        stiffness: for a rod, its stiffness [N/m]; for others, the stiffness along x, y and z, one
            number or three [N/m], or along and about these axes, six numbers or a 6 x 6 matrix
            [N/m, N m/rad], as for a Bushing
        damping: in the same form [N s/m, N m s/rad]; None: no damping

    >>> radial, axial, tilting = 8e6, 4e5, 900.0
    >>> jb.suspension.Compliance(
    ...     stiffness=[radial, radial, axial, tilting, tilting, 0.0]
    ... ).damping is None  # free to turn about its axis z
    True
    """

    stiffness: Any
    damping: Any = None


def compliant(model: Model, compliances: Mapping[str, Compliance]) -> Model:
    """Return the model in which these joints and closures are bushings, and rods are springs, at
    the same place. Its parameters have derivatives with respect to those of the given model. With
    increasing stiffness it approaches the model with ideal joints.

    A closure keeps its name, as an element. The joint of a body becomes the element "<body> joint",
    and the body is free; bodies that it carries stay attached to it. Directions in which the ideal
    joint moves are free only if the stiffness there is 0, as about z of a hinge or along z of a
    guide. A search for an equilibrium far from the drawn pose should start from the equilibrium of
    the model with ideal joints.

    Args:
        model: the model with ideal joints
        compliances: {name of a body, for its joint, or of a closure: compliance}

    Errors: UNKNOWN_NAME, WRONG_KIND for joints and closures that cannot be a bushing (Ball, Hinge,
    Guide, Cylindrical, Fixed and Weld can be one, and Rod becomes a spring), and those of a
    Bushing.

    >>> corner = jb.suspension.double_wishbone()
    >>> rubber = jb.suspension.Compliance(stiffness=[8e6, 8e6, 4e5, 900.0, 900.0, 0.0])
    >>> elastic = jb.suspension.compliant(
    ...     corner.model,
    ...     {"lower arm": rubber, "upper ball": jb.suspension.Compliance(stiffness=3e7)},
    ... )
    >>> elastic.element_names, elastic.closure_names
    (('spring', 'lower arm joint', 'upper ball'), ('tie rod',))
    """
    parts = model.parts()
    joints, elements, closing = parts["joints"], parts["elements"], parts["closures"]
    with Problems() as problems:
        for name, compliance in compliances.items():
            where = f"compliant['{name}']"
            if name in closing:
                elements[name] = problems.gather(
                    partial(_of_closure, model, closing.pop(name), compliance, where)
                )
            elif name in joints:
                elements[f"{name} joint"] = problems.gather(
                    partial(_of_joint, model, name, joints.pop(name), compliance, where)
                )
            else:
                problems.collected.append(
                    unknown(name, where, (*model.layout.bodies, *model.closure_names))
                )
    return Model(**parts)


def _of_joint(model: Model, body: str, joint: Joint, compliance: Compliance, where: str) -> Element:
    _check_kind(joint, JOINTS, where)
    A, B = pose_at_reference(model, joint.parent), pose_at_reference(model, body)
    on_B = jnp.zeros(3, B.p.dtype) if joint.at is None else B.inverse().point(A.point(joint.at))
    on_A = A.inverse().point(B.p) if joint.at is None else joint.at
    return _bushing(
        (joint.parent, on_A), (body, on_B), A, B, getattr(joint, "axis", None), compliance
    )


def _of_closure(
    model: Model, closure: closures.Closure, compliance: Compliance, where: str
) -> Element:
    _check_kind(closure, CLOSURES, where)
    a, b = zip(closure.between, closure.points, strict=True)
    A, B = (pose_at_reference(model, name) for name in closure.between)
    if not isinstance(closure, closures.Rod):
        return _bushing(a, b, A, B, getattr(closure, "axis", None), compliance)
    d = B.point(closure.b) - A.point(closure.a)
    length = jnp.sqrt(dot(d, d)) if closure.length is None else closure.length
    return Spring(
        a,
        b,
        stiffness=compliance.stiffness,
        damping=0.0 if compliance.damping is None else compliance.damping,
        free_length=length,
    )


def _check_kind(part: Any, kinds: tuple[type, ...], where: str) -> None:
    """Check that a joint or closure is one that can be a bushing. Error: WRONG_KIND."""
    if not isinstance(part, kinds):
        raise JaxbodyError(
            Problem(
                "WRONG_KIND",
                where,
                f"is a {type(part).__name__}",
                type(part),
                ", ".join(kind.__name__ for kind in kinds),
                "Give it elements of your own.",
            )
        )


def _bushing(a: Any, b: Any, A: Pose, B: Pose, axis: Any, compliance: Compliance) -> Bushing:
    """Return the bushing between points a and b of two frames, with the same axes at both ends in
    the reference pose."""
    on_A = jnp.eye(3, dtype=A.R.dtype) if axis is None else _along(jnp.asarray(axis))
    turns = rotations.from_matrix(on_A), rotations.from_matrix(B.R.T @ A.R @ on_A)
    k = _coefficients(compliance.stiffness)
    return Bushing(
        a,
        b,
        stiffness=k,
        damping=None
        if compliance.damping is None
        else _coefficients(compliance.damping, np.shape(k)),
        orientation=turns[0],
        orientation_b=turns[1],
    )


def _along(n: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Return axes with z along n and x across it, nearest to the axis that is farthest from n."""
    farthest = jnp.eye(3, dtype=n.dtype)[jnp.argmin(jnp.abs(n))]
    x = farthest - n * dot(n, farthest)
    x = x / jnp.sqrt(dot(x, x))
    return jnp.stack([x, cross(n, x), n], -1)


def _coefficients(value: Any, shape: tuple[int, ...] = ()) -> Any:
    """Return three numbers or a 6 x 6 matrix from one, three, six or 36 numbers, in the form of a
    stiffness of this shape."""
    xp: Any = np if is_concrete(value) else jnp
    value = xp.asarray(value)
    value = xp.ones(3) * value if value.shape == () else value
    value = xp.diag(value) if value.shape == (6,) else value
    return (
        xp.diag(xp.concatenate([value, xp.zeros(3)]))
        if shape == (6, 6) and value.shape == (3,)
        else value
    )
