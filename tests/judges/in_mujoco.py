"""A model in MuJoCo: springs and inerters are its tendons, torsion springs its joints', laws with
memory its actuators with states.

Supports are bodies that move freely, or swing by themselves: of 1e10 kg on springs of their own, so
that they move as imposed and dampers see their velocity.
"""

import elementary_joints as joints
import mujoco
import numpy as np
import rigs

import jaxbody as jb

mujoco.set_mju_user_warning(lambda text: None)  # else it writes a file into the folder at work
HEAVY = 1e10  # kg and kg m2
KINDS = {
    "move": mujoco.mjtJoint.mjJNT_SLIDE,
    "turn": mujoco.mjtJoint.mjJNT_HINGE,
    "ball": mujoco.mjtJoint.mjJNT_BALL,
}
SIX = np.array(((0, 0), (1, 1), (2, 2), (0, 1), (0, 2), (1, 2))).T


def linear(like, coefficient):
    """A stiffness or damping as MuJoCo has them: since version 4 the first of
    several coefficients."""
    row = np.zeros(np.shape(like))
    row[(0,) * row.ndim] = float(coefficient)
    return row if row.ndim else float(coefficient)


class Judge:
    """The same bodies, joints and elements. `swinging`: {support: Harmonic} whose supports swing,
    along x, y, z and about z, from where they are at time 0, with phases of 0."""

    def __init__(self, model, *, swinging=None, step=2e-4):
        self.model, self.carried, self.swinging = model, joints.frames(model), swinging or {}
        spec = mujoco.MjSpec()
        spec.compiler.degree = False
        spec.option.integrator, spec.option.timestep = mujoco.mjtIntegrator.mjINT_RK4, step
        spec.option.gravity = np.array(model.gravity)
        spec.option.disableflags |= mujoco.mjtDisableBit.mjDSBL_CONTACT
        self.nodes = {"world": spec.worldbody}
        for one in self.carried:
            self.add(one)
        self.laws, self.sites = [], 0  # of actuators
        for name in model.element_names:
            self.element(spec, name, model[name])
        self.mj = spec.compile()
        self.data = mujoco.MjData(self.mj)

    def add(self, one):
        p, q = one.place
        node = self.nodes[one.name] = self.nodes[one.parent].add_body(name=one.name, pos=p, quat=q)
        mass, com, inertia, steps = 1.0, np.zeros(3), np.eye(3), one.steps
        swing = self.swinging.get(one.name)
        if one.name in self.model.layout.bodies:
            body = self.model[one.name]
            mass, com, inertia = float(body.mass), np.array(body.com), np.array(body.inertia)
        elif swing is not None:
            mass, inertia, node.gravcomp = HEAVY, HEAVY * np.eye(3), 1.0
            steps = [*steps[:3], joints.Step("turn", p, np.array([0, 0, 1.0]))]
        node.mass, node.ipos, node.fullinertia, node.explicitinertial = (
            mass,
            com,
            inertia[*SIX],
            True,
        )
        for i, step in enumerate(steps):
            R = rigs.turned(q).T
            joint = node.add_joint(
                name=f"{one.name} {i}", type=KINDS[step.kind], pos=R @ (step.at - p)
            )
            if step.kind != "ball":
                joint.axis = R @ step.axis
            if swing is not None:
                rate = 2 * np.pi * (np.ones(6) * np.asarray(swing.frequency))[[0, 1, 2, 5][i]]
                joint.stiffness = linear(joint.stiffness, HEAVY * rate**2)

    def element(self, spec, name, element):
        if isinstance(element, jb.Torsion):  # about the hinge of its second body
            joint = next(joint for joint in self.nodes[element.between[1]].joints)
            joint.stiffness = linear(joint.stiffness, element.spring.coefficient)
            joint.damping = linear(joint.damping, element.damper.coefficient)
            joint.springref = float(element.free_angle)
            return
        tendon = spec.add_tendon(name=name)
        for frame, point in zip(element.between, (element.a, element.b), strict=True):
            self.sites += 1
            site = self.nodes[frame].add_site(name=f"site {self.sites}", pos=np.array(point))
            tendon.wrap_site(site.name)
        if isinstance(element, jb.Inerter):
            tendon.armature = float(element.inertance)
            tendon.springlength = [0, 0]
            return
        assert isinstance(element, jb.Spring | jb.SpringDamper)
        l0 = float(element.free_length)
        tendon.springlength = [l0, l0]
        if isinstance(element, jb.Spring):
            tendon.stiffness, tendon.damping = (
                linear(tendon.stiffness, element.stiffness),
                linear(tendon.damping, element.damping),
            )
            return
        tendon.damping = linear(tendon.damping, element.damper.coefficient)
        for term in element.spring.terms:
            if isinstance(term, jb.laws.Linear):
                tendon.stiffness = linear(tendon.stiffness, term.coefficient)
            else:
                self.memory(spec, name, term, l0)

    def memory(self, spec, name, law, l0):
        """An actuator along a tendon, which pushes with gain z + bias where the law pulls."""
        acts = spec.add_actuator(
            name=f"{name} {len(self.laws)}",
            trntype=mujoco.mjtTrn.mjTRN_TENDON,
            target=name,
            actdim=1,
        )
        acts.dyntype, acts.gaintype = mujoco.mjtDyn.mjDYN_USER, mujoco.mjtGain.mjGAIN_FIXED
        acts.biastype = mujoco.mjtBias.mjBIAS_AFFINE
        if isinstance(law, jb.laws.Maxwell):
            k = float(law.stiffness)
            acts.gainprm[0], acts.biasprm[:2] = k, [k * l0, -k]
        elif isinstance(law, jb.laws.LuGre):
            acts.gainprm[0], acts.biastype = -float(law.stiffness), mujoco.mjtBias.mjBIAS_USER
        else:
            acts.gainprm[0] = -1.0
        self.laws.append((name, law, l0))

    def rate(self, m, d, i):
        """z' of the i-th law."""
        _, law, l0 = self.laws[i]
        e, e_dot, z = d.actuator_length[i] - l0, d.actuator_velocity[i], d.act[i]
        if isinstance(law, jb.laws.Maxwell):
            return (e - z) / float(law.relaxation_time)
        if isinstance(law, jb.laws.BoucWen):
            losses = float(law.gamma) * abs(e_dot) * z + float(law.delta) * e_dot * abs(z)
            return float(law.alpha) * e_dot - float(law.beta) * losses  # n = 1
        if isinstance(law, jb.laws.Dahl):
            return float(law.stiffness) * e_dot * (1 - z * np.sign(e_dot) / float(law.level))
        level, static = float(law.level), float(law.static_level)
        g = level + (static - level) * np.exp(-((e_dot / float(law.velocity)) ** 2))
        return e_dot - float(law.stiffness) * abs(e_dot) * z / g

    def bias(self, m, d, i):
        """What LuGre's force has beside that of its bristles."""
        law = self.laws[i][1]
        return -(
            float(law.damping) * self.rate(m, d, i) + float(law.viscosity) * d.actuator_velocity[i]
        )

    def __enter__(self):
        mujoco.set_mjcb_act_dyn(self.rate)
        mujoco.set_mjcb_act_bias(self.bias)
        return self

    def __exit__(self, *_):
        mujoco.set_mjcb_act_dyn(None)
        mujoco.set_mjcb_act_bias(None)

    def put(self, state, moving=None):
        """Take on a state; `moving`: {support: its `imposed` motion}, for supports that do
        not swing."""
        moving = {name: joints.AT_REST for name in self.model.layout.supports} | (moving or {})
        m, d = self.mj, self.data
        mujoco.mj_resetData(m, d)
        self.turn, self.a, order = np.eye(m.nv), np.zeros(m.nv), {}
        supports = {name: at for name, (at, _) in moving.items()}
        for one in self.carried:
            if one.name in self.swinging:
                motion = self.swinging[one.name]
                d.qpos[[m.joint(f"{one.name} {i}").qposadr[0] for i in range(4)]] = [
                    *motion.translation,
                    motion.rotation[2],
                ]
                continue
            values, speeds = joints.coordinates(self.model, one, state, supports)
            changes = (
                [*moving[one.name][1][0], moving[one.name][1][1]]
                if one.name in moving
                else [0 * np.asarray(x) for x in speeds]
            )
            for i, (value, speed, change) in enumerate(zip(values, speeds, changes, strict=True)):
                number = m.joint(f"{one.name} {i}").id
                at, first, n = m.jnt_qposadr[number], m.jnt_dofadr[number], np.size(speed)
                rows, size = slice(first, first + n), np.size(value)
                # it counts from the reference pose, in axes of the body, as do the speeds
                if n == 3:
                    rest = one.place[1]
                    self.turn[rows, rows] = (rigs.turned(value) @ rigs.turned(rest)).T
                    value = joints.multiplied(
                        rest * joints.CONJUGATE, joints.multiplied(value, rest)
                    )
                d.qpos[at : at + size] = value
                d.qvel[rows] = self.turn[rows, rows] @ np.atleast_1d(speed)
                self.a[rows] = self.turn[rows, rows] @ np.atleast_1d(change)
                order.setdefault(one.name, []).extend(range(first, first + n))
        for name in dict.fromkeys(name for name, *_ in self.laws):
            mine = [i for i, (its, *_) in enumerate(self.laws) if its == name]
            d.act[mine] = state.z[self.model.layout.z_slices[name]]
        self.rows = np.array(
            [row for name in self.model.layout.bodies for row in order.get(name, [])], int
        )
        self.support_rows = np.array(
            [row for name in self.model.layout.supports for row in order.get(name, [])], int
        )
        mujoco.mj_forward(m, d)
        return self

    def accelerations(self):
        """v' of the model in its own speeds, with the supports accelerated as they are imposed."""
        m, d = self.mj, self.data
        M = np.zeros((m.nv, m.nv))
        for row, unit in zip(M, np.eye(m.nv), strict=True):
            mujoco.mj_mulM(m, d, row, unit)
        h = d.qfrc_bias - d.qfrc_passive - d.qfrc_actuator
        b, s, a = self.rows, self.support_rows, self.a.copy()
        a[b] = np.linalg.solve(M[np.ix_(b, b)], -h[b] - M[np.ix_(b, s)] @ a[s])
        return (self.turn.T @ a)[b]

    def state_rates(self):
        """z', in the order of the laws."""
        return self.data.act_dot.copy()

    def path(self, times):
        """{body: (positions, rotation matrices)} at times, from where it is, and the states of
        the laws."""
        poses, states = {name: [] for name in self.model.layout.bodies}, []
        for i, t in enumerate(times):
            for _ in range(round((t - (times[i - 1] if i else times[0])) / self.mj.opt.timestep)):
                mujoco.mj_step(self.mj, self.data)
            mujoco.mj_forward(self.mj, self.data)
            for name, found in poses.items():
                body = self.data.body(name)
                found.append((body.xpos.copy(), body.xmat.reshape(3, 3).copy()))
            states.append(self.data.act.copy())
        return {
            name: tuple(map(np.array, zip(*found, strict=True))) for name, found in poses.items()
        }, np.array(states)
