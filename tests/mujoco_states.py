"""States of a model in MuJoCo's coordinates, and its energies there; tests of MJCF share them."""

import mujoco
import numpy as np
import rigs

import jaxbody as jb

mujoco.set_mju_user_warning(lambda text: None)  # else it writes a file into the folder at work


def put(model, state, m):
    """MuJoCo's data with this state. It turns free bodies and balls with speeds about their own
    axes, and a ball's quaternion counts from the body's orientation in the file."""
    d = mujoco.MjData(m)
    numbers = bodies(model, m)
    for body in model.layout.bodies:
        q, v = state.q[model.layout.q_slices[body]], np.array(state.v[model.layout.v_slices[body]])
        joint, number = model.joint(body), numbers[body]
        if not len(v):
            continue
        if isinstance(joint, jb.Free):
            v[3:] = rigs.turned(q[3:]).T @ v[3:]
        if isinstance(joint, jb.Ball):
            rest = m.body_quat[number]
            q = multiplied(rest * [1, -1, -1, -1], multiplied(q, rest))
            v = rigs.turned(rest).T @ (rigs.turned(state.q[model.layout.q_slices[body]]).T @ v)
        first = m.body_jntadr[number]
        here, of = m.jnt_qposadr[first], m.jnt_dofadr[first]
        d.qpos[here : here + len(q)] = q + (0 if len(q) > len(v) else m.qpos0[here : here + len(q)])
        d.qvel[of : of + len(v)] = v
    mujoco.mj_forward(m, d)
    return d


def bodies(model, m):
    """The numbers of the bodies; those without a name in the file have one of their own here, in
    the same order."""
    named = {m.body(i).name: i for i in range(m.nbody) if m.body(i).name}
    unnamed = iter(i for i in range(m.nbody) if not m.body(i).name and m.body_jntnum[i])
    return {body: named.get(body) or next(unnamed, 0) for body in model.layout.bodies}


def multiplied(p, q):
    """The product of two quaternions."""
    result = np.zeros(4)
    mujoco.mju_mulQuat(result, np.asarray(p, float), np.asarray(q, float))
    return result


def energies(m, d):
    """T without the inertia of motors, V of gravity and springs [J], and R of dampers [W]."""
    mujoco.mj_energyPos(m, d)
    mujoco.mj_energyVel(m, d)
    T = d.energy[1] - 0.5 * d.qvel @ (m.dof_armature * d.qvel)
    return np.array([T, d.energy[0], -0.5 * d.qvel @ d.qfrc_damper])


def energies_here(model, state):
    """T, V [J] and R [W]."""
    return np.array(
        [
            float(energy(model, state))
            for energy in (jb.kinetic_energy, jb.potential_energy, jb.dissipation)
        ]
    )


def random_states(model, count, rng, size=0.3):
    """The reference state and some around it, with speeds."""
    reference = model.reference
    yield jb.State(reference.q, rng.normal(size=model.layout.nv))
    for _ in range(count - 1):
        q = jb.joints.retract(model, reference.q, size * rng.normal(size=model.layout.nv))
        yield jb.State(q, rng.normal(size=model.layout.nv))


def reordered(state, model, other):
    """A state of a model for another with the same bodies in another order."""
    q, v = (
        (x, getattr(model.layout, slices))
        for x, slices in ((state.q, "q_slices"), (state.v, "v_slices"))
    )
    return jb.State(
        *(
            np.concatenate([x[..., slices[body]] for body in other.layout.bodies], -1)
            for x, slices in (q, v)
        )
    )
