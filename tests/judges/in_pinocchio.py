"""A model in Pinocchio: its kinematics, mass matrix and bias forces there, with the forces of
elements by NumPy.

Supports are massless bodies that move freely, whose coordinates, speeds and accelerations are
prescribed, so that the forces which that takes are the reactions on them.
"""

import elementary_joints as joints
import force_laws
import numpy as np
import pinocchio as pin
import rigs

import jaxbody as jb

WORLD_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
KINDS = {"move": pin.JointModelPrismaticUnaligned, "turn": pin.JointModelRevoluteUnaligned}


def placed(place):
    return pin.SE3(rigs.turned(place[1]), np.asarray(place[0], float))


class Judge:
    """The same bodies, joints and elements; `put` sets the state."""

    def __init__(self, model):
        self.model, self.pin, self.joints, self.ids = model, pin.Model(), {}, {"world": 0}
        self.carried = joints.frames(model)
        self.pin.gravity = pin.Motion(np.concatenate([model.gravity, np.zeros(3)]))
        # of each frame: the last of its joints, and its place on that
        ends = {"world": (0, pin.SE3.Identity())}
        for one in self.carried:
            last, at = ends[one.parent]
            self.joints[one.name], place = [], placed(one.place)
            for step in one.steps:
                kind = (
                    pin.JointModelSpherical()
                    if step.kind == "ball"
                    else KINDS[step.kind](step.axis)
                )
                last = self.pin.addJoint(
                    last,
                    kind,
                    at * pin.SE3(np.eye(3), step.at),
                    f"{one.name} {len(self.joints[one.name])}",
                )
                self.joints[one.name].append(last)
                at = pin.SE3(np.eye(3), -step.at)
            ends[one.name] = last, at * place
            if one.name in model.layout.bodies:
                body = model[one.name]
                self.pin.appendBodyToJoint(
                    last,
                    pin.Inertia(float(body.mass), np.array(body.com), np.array(body.inertia)),
                    at * place,
                )
        for one in self.carried:
            frame = pin.Frame(
                one.name, ends[one.name][0], 0, ends[one.name][1], pin.FrameType.OP_FRAME
            )
            self.ids[one.name] = self.pin.addFrame(frame, False)
        self.data = self.pin.createData()
        self.elements = [model[name] for name in model.element_names]
        self.rest = {name: placed(joints.reference(model, name)) for name in self.ids}

    def put(self, state, moving=None):
        """Take on a state of the model; `moving`: {support: its `imposed` motion at that time}."""
        moving = {name: joints.AT_REST for name in self.model.layout.supports} | (moving or {})
        q, v, a = np.zeros(self.pin.nq), np.zeros(self.pin.nv), np.zeros(self.pin.nv)
        turn, held = np.eye(self.pin.nv), np.zeros(self.pin.nv, bool)
        order: dict[str, list[int]] = {}
        supports = {name: at for name, (at, _) in moving.items()}
        for one in self.carried:
            values, speeds = joints.coordinates(self.model, one, state, supports)
            changes = (
                [*moving[one.name][1][0], moving[one.name][1][1]]
                if one.name in moving
                else [0 * np.asarray(x) for x in speeds]
            )
            for number, value, speed, change in zip(
                self.joints[one.name], values, speeds, changes, strict=True
            ):
                joint = self.pin.joints[number]
                at, rows = (
                    slice(joint.idx_q, joint.idx_q + joint.nq),
                    slice(joint.idx_v, joint.idx_v + joint.nv),
                )
                if joint.nv == 3:
                    # the angular velocity is in axes of the child
                    turn[rows, rows] = rigs.turned(value).T
                    value = np.roll(value, -1)
                q[at], v[rows], a[rows] = (
                    value,
                    turn[rows, rows] @ np.atleast_1d(speed),
                    turn[rows, rows] @ np.atleast_1d(change),
                )
                held[rows] = one.name in moving
                order.setdefault(one.name, []).extend(range(joint.idx_v, joint.idx_v + joint.nv))
        self.a, self.turn = a, turn
        self.rows = np.array(
            [row for name in self.model.layout.bodies for row in order.get(name, [])], int
        )
        self.support_rows = np.array(
            [row for name in self.model.layout.supports for row in order[name]], int
        )
        return self.move(q, v)

    def move(self, q, v):
        """Take on coordinates and speeds of Pinocchio; the frames then have the accelerations that
        all joints leave at zero."""
        self.q, self.v = q, v
        pin.computeJointJacobians(self.pin, self.data, q)
        pin.forwardKinematics(self.pin, self.data, q, v, np.zeros(self.pin.nv))
        pin.updateFramePlacements(self.pin, self.data)
        return self

    def pose(self, name):
        return self.data.oMf[self.ids[name]]

    def twist(self, name):
        """Velocity of the origin and angular velocity, in world axes."""
        return pin.getFrameVelocity(self.pin, self.data, self.ids[name], WORLD_AXES).vector

    def jacobian(self, name):
        return pin.getFrameJacobian(self.pin, self.data, self.ids[name], WORLD_AXES)

    def bias(self, name):
        """The derivative of the twist where all accelerations of joints are zero."""
        return pin.getFrameClassicalAcceleration(
            self.pin, self.data, self.ids[name], WORLD_AXES
        ).vector

    def at(self, name, point):
        """The matrix that makes the velocity of a point of a frame from its twist."""
        return np.hstack([np.eye(3), -pin.skew(self.pose(name).rotation @ np.asarray(point))])

    def line(self, element):
        """Length and direction of the line from a to b, its rate, and for each frame the row of the
        rate per unit twist."""
        (A, a), (B, b) = zip(element.between, (element.a, element.b), strict=True)
        d = self.pose(B).act(np.array(b)) - self.pose(A).act(np.array(a))
        L = np.linalg.norm(d)
        u = d / L
        rows = {A: -u @ self.at(A, a), B: u @ self.at(B, b)}
        return L, u, sum(row @ self.twist(name) for name, row in rows.items()), rows

    def element_wrenches(self, element):
        """(frame, force and moment about its origin) of an element."""
        if isinstance(element, jb.Spring | jb.SpringDamper):
            L, _, rate, rows = self.line(element)
            e = L - float(element.free_length)
            if isinstance(element, jb.Spring):
                tension = float(element.stiffness) * e + float(element.damping) * rate
            else:
                tension = force_laws.force(element.spring, e) + force_laws.force(
                    element.damper, rate
                )
            return [(name, -tension * row) for name, row in rows.items()]
        if isinstance(element, jb.Bushing):
            A, B = element.between
            X_A, X_B = (
                self.pose(name) * placed((p, q))
                for name, p, q in (
                    (A, element.a, element.orientation),
                    (B, element.b, element.orientation_b),
                )
            )
            X = X_A.actInv(X_B)
            slope = pin.Jlog6(X)
            twists = [pin.Motion(self.twist(n)) for n in (A, B)]
            of_B, of_A = (
                pin.SE3(X_B.rotation.T, np.zeros(3)).act(
                    self.moved(t, X_B.translation - self.pose(n).translation)
                )
                for n, t in ((B, twists[1]), (A, twists[0]))
            )
            lever = pin.SE3(np.eye(3), np.zeros(3))
            relative = (of_B - lever.act(of_A)).vector
            K, C = (
                np.array(x) if np.ndim(x) == 2 else np.diag([*np.asarray(x), 0, 0, 0])
                for x in (element.stiffness, element.damping)
            )
            # at the frame of B, in its axes
            on_B = -slope.T @ (K @ pin.log6(X).vector + C @ (slope @ relative))
            F, M = X_B.rotation @ on_B[:3], X_B.rotation @ on_B[3:]
            return [
                (
                    n,
                    sign
                    * np.concatenate(
                        [F, M + np.cross(X_B.translation - self.pose(n).translation, F)]
                    ),
                )
                for n, sign in ((B, 1), (A, -1))
            ]
        if isinstance(element, jb.Torsion):
            A, B = element.between
            X_A, X_B = self.pose(A), self.pose(B)
            R = (
                rigs.turned(element.orientation).T
                @ X_A.rotation.T
                @ X_B.rotation
                @ rigs.turned(element.orientation_b)
            )
            n = np.asarray(element.axis)
            w = pin.log3(R)  # a turn about n alone
            assert np.allclose(np.cross(w, n), 0, atol=1e-9)
            axis = X_A.rotation @ rigs.turned(element.orientation) @ n
            rate = axis @ (self.twist(B) - self.twist(A))[3:]
            moment = force_laws.force(
                element.spring, w @ n - float(element.free_angle)
            ) + force_laws.force(element.damper, rate)
            on_B = np.concatenate([np.zeros(3), -moment * axis])
            return [(B, on_B), (A, -on_B)]
        if isinstance(element, jb.AntiRollBar):
            left, right, car = element.between
            axis = self.pose(car).rotation @ np.asarray(element.axis)
            d = self.pose(left).act(np.array(element.a)) - self.pose(right).act(np.array(element.b))
            rows = {left: axis @ self.at(left, element.a), right: -axis @ self.at(right, element.b)}
            rows[car] = np.concatenate([np.zeros(3), np.cross(axis, d)])
            rate = sum(row @ self.twist(name) for name, row in rows.items())
            force = force_laws.force(element.spring, axis @ d) + force_laws.force(
                element.damper, rate
            )
            return [(name, -force * row) for name, row in rows.items()]
        assert isinstance(element, jb.Inerter)
        return [("world", np.zeros(6))]

    @staticmethod
    def moved(twist, arm):
        """A twist in world axes, of another point of the same body."""
        return pin.Motion(twist.linear + np.cross(twist.angular, arm), twist.angular)

    def equations(self):
        """M and h of M v' + h = 0, in Pinocchio's speeds, elements included."""
        M = pin.crba(self.pin, self.data, self.q)
        M = np.triu(M) + np.triu(M, 1).T
        h = pin.nonLinearEffects(self.pin, self.data, self.q, self.v)
        self.move(self.q, self.v)
        for element in self.elements:
            h = h - sum(
                self.jacobian(name).T @ wrench for name, wrench in self.element_wrenches(element)
            )
            if isinstance(element, jb.Inerter):
                L, u, rate, rows = self.line(element)
                J = sum(row @ self.jacobian(name) for name, row in rows.items())
                relative = [
                    self.at(n, p) @ self.twist(n)
                    for n, p in zip(element.between, (element.a, element.b), strict=True)
                ]
                centripetal = self.acceleration_of_point(element, 1) - self.acceleration_of_point(
                    element, 0
                )
                relative = relative[1] - relative[0]
                b = float(element.inertance)
                M = M + b * np.outer(J, J)
                h = h + b * J * (u @ centripetal + (relative @ relative - rate**2) / L)
        return M, h

    def acceleration_of_point(self, element, end):
        """Of an end of an element, where all accelerations of joints are zero."""
        name, p = element.between[end], (element.a, element.b)[end]
        if name == "world":
            return np.zeros(3)
        arm, w = self.pose(name).rotation @ np.asarray(p), self.twist(name)[3:]
        return self.at(name, p) @ self.bias(name) + np.cross(w, np.cross(w, arm))

    def accelerations(self):
        """v' of the model in its own speeds, and the force and moment on each support."""
        M, h = self.equations()
        b, s = self.rows, self.support_rows
        a = self.a.copy()
        a[b] = np.linalg.solve(M[np.ix_(b, b)], -h[b] - M[np.ix_(b, s)] @ a[s])
        needed = (self.turn.T @ (M @ a + h))[s].reshape(-1, 2, 3)
        return (self.turn.T @ a)[b], -needed[:, 0], -needed[:, 1]

    def mass_matrix(self):
        """M in the speeds of the model."""
        M, b = self.equations()[0], self.rows
        turn = self.turn[np.ix_(b, b)]
        return turn.T @ M[np.ix_(b, b)] @ turn
