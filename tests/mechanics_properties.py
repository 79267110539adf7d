"""Properties that every model has, each as a number with a limit, over random models
of `random_mechanics`.

Dissipation, potential forces, action and reaction, invariance, stiffness, modes, responses,
statuses. A value is relative to the largest number of its kind in the model; wrong statuses and
numbers that are not finite are counted.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import rigs
from random_mechanics import PLAIN, View, turn_of

import jaxbody as jb
from jaxbody.lagrange import kinetic, potential
from jaxbody.mechanics.closed_loops import dynamics_of
from jaxbody.model.element_states import holding
from jaxbody.model.joints.frame_tables import each_element, wrenches
from jaxbody.model.joints.kinematics import Chart, Coordinates
from jaxbody.model.models import scale_of, size_of

POINTS, STEP, LINES = 128, 1e-5, 5  # of a loop, of differences, of a response
TINY = 1e-300
LIMITS = {
    "T3 no damper gives power": 1e-14,
    "T4 no work around a closed loop": 1e-10,
    "T5 forces of elements are in balance": 1e-13,
    "T9 forces do not depend on the place and turn of the whole": 1e-13,
    "T9 accelerations turn with the whole": 1e-10,
    "T9 frequencies do not depend on place and turn": 1e-12,
    "T10 energies in other units": 1e-13,
    "T10 accelerations in other units": 1e-10,
    "T10 frequencies in other units": 1e-12,
    "T12 energies in another order": 1e-14,
    "T12 frequencies in another order": 1e-12,
    "T14 q and -q": 0.0,
    "T22 stability is the sign of the smallest eigenvalue (wrong)": 0.0,
    "T23 K is symmetric": 1e-14,
    "T24 K is the difference of the gradient": 1e-8,
    "T29 K u = w2 M u": 1e-12,
    "T29 shapes are orthonormal in M": 1e-12,
    "T32 response is reciprocal": 1e-12,
    "T33 response is B (K + i w C - w2 M)^-1 B'": 1e-10,
    "T33 sum over modes": 1e-10,
    "T34 no negative power": 1e-12,
    "T53 numbers that are not finite and not announced": 0.0,
    "R1 rest called ok: force left over": 1e-9,
    "R1 rest called ok with K not positive (wrong)": 0.0,
}


def in_state(model, state):
    """The model with its laws with memory as in the state, and its frames there."""
    coordinates = Coordinates(model)
    return holding(model, state.z), coordinates.frames(
        state.q, state.v, coordinates.supports.at_rest()
    )


def without_closures(model):
    """The tree of a model."""
    if model.closures:
        model = eqx.tree_at(lambda m: m.closures, model, ())
        object.__setattr__(model, "independent", tuple(range(model.layout.nv)))
    return model


def forces(model, state):
    """T, V, the force of each element, v', and what does not depend on the choice of q."""
    held, frames = in_state(model, state)
    tensions = each_element(held, frames, lambda s, *F: s.force(*F))
    stiff = each_element(
        held,
        frames,
        lambda s, *F: jnp.max(jnp.abs(s.tangent(s.deformation(*(f.pose() for f in F))))),
    )
    v_dot = dynamics_of(held, ()).acceleration(jnp.zeros(()), state.q, state.v)
    return {
        "T": kinetic(model, frames),
        "V": potential(held, frames),
        "force": jnp.concatenate([jnp.ravel(x) for x in tensions]),
        "stiffest": jnp.max(jnp.concatenate([jnp.ravel(x) for x in stiff])),
        "size": size_of(model),
        "v_dot": v_dot,
    }


def near(model, state, around):
    """Numbers of a random state, and of a loop through it."""
    held, frames = in_state(model, state)
    names = model.layout.frames
    size = size_of(model)
    ends = [
        [names.index(name) for name in end]
        for table in model.elements
        for end in zip(*table.links, strict=True)
    ]
    acting = [
        w for per_end in each_element(held, frames, lambda s, *F: s.wrenches(*F)) for w in per_end
    ]
    # force and moment about the world's origin of each element, and their sizes summed
    left, total, i = [], jnp.zeros(2), 0
    for table in model.elements:
        n = len(table.links[0])
        F, M = (jnp.stack([acting[i + j][k] for j in range(n)]) for k in (0, 1))
        p = jnp.stack([frames.p[np.array(ends[i + j])] for j in range(n)])
        arm = jnp.linalg.norm(p, axis=-1) + size
        left.append(
            jnp.array([jnp.max(jnp.abs(F.sum(0))), jnp.max(jnp.abs((M + jnp.cross(p, F)).sum(0)))])
        )
        size_of_F = jnp.linalg.norm(F, axis=-1)
        total = total + jnp.array(
            [jnp.sum(size_of_F), jnp.sum(arm * size_of_F + jnp.linalg.norm(M, axis=-1))]
        )
        i += n
    balance = jnp.max(jnp.stack(left) / (total + TINY)[None])
    power = jnp.concatenate(
        [jnp.ravel(x) for x in each_element(held, frames, lambda s, *F: s.lost_power(*F))]
    )
    chart, scale = Chart(model), scale_of(model, size)

    def energy(delta):
        there = jb.State(chart.retract(state.q, delta), state.v, state.z)
        return potential(held, in_state(model, there)[1])

    E = jnp.diag(scale) * STEP * size
    gradient = jax.grad(energy)
    K_by_differences = jax.vmap(lambda d: gradient(d) - gradient(-d))(E) / (2 * STEP * size)
    K = jb.linearize(without_closures(model), state).K[: len(scale), : len(scale)]

    def along(s):
        a, b = around * size * scale
        q = chart.retract(state.q, a * jnp.sin(2 * jnp.pi * s) + b * (jnp.cos(2 * jnp.pi * s) - 1))
        f = Coordinates(model).at_rest(q)
        return (f.p, f.R), f

    def work(s):
        (_, R), (p_dot, R_dot), f = jax.jvp(along, (s,), (jnp.ones_like(s),), has_aux=True)
        W = R_dot @ jnp.swapaxes(R, -1, -2)
        w = jnp.stack([W[:, 2, 1], W[:, 0, 2], W[:, 1, 0]], -1)
        F, M = wrenches(held, f)
        return jnp.sum(F * p_dot + M * w), jnp.sum(jnp.abs(F * p_dot) + jnp.abs(M * w))

    works, sizes = jax.lax.map(work, jnp.arange(POINTS) / POINTS)
    return {
        "power": jnp.min(power), "powers": jnp.max(jnp.abs(power)), "balance": balance,
        "loop": jnp.abs(jnp.mean(works)), "works": jnp.max(sizes), "K": K * scale[:, None] * scale,
        "K_by_differences": K_by_differences * scale[None, :],
    }  # fmt: skip


def rest(model, points, fractions):
    """Equilibrium, modes and responses there."""
    eq = jb.equilibrium(model)
    lin = jb.linearize(model, eq).condensed
    found = jb.modes(lin)
    scale = lin.scale
    body = model.layout.bodies[-1]
    ports = {f"p{i}": (body, p, a) for i, (p, a) in enumerate(zip(points, "xyz", strict=True))}
    f = fractions * jnp.nanmax(jnp.where(jnp.isfinite(found.frequency), found.frequency, 0.0))
    inputs = {n: jb.PointForce(b, p, direction=a) for n, (b, p, a) in ports.items()}
    outputs = {n: jb.Position(b, p, axis=a) for n, (b, p, a) in ports.items()}
    direct, modal = (
        jb.frequency_response(lin, f, inputs, outputs, method=how).values
        for how in ("direct", "modal")
    )
    chart = Chart(model)

    def places(delta):
        q = chart.retract(eq.state.q, delta)
        frames = Coordinates(model).at_rest(q)
        row = frames[model.layout.frame(body)]
        return jnp.stack([row.p + row.R @ p for p in points])[jnp.arange(3), jnp.arange(3)]

    B = jax.jacfwd(places)(jnp.zeros(model.layout.nv))
    B = B if lin.dependent is None else B @ lin.dependent.N
    size = size_of(model)
    return {
        "status": eq.status,
        "stable": eq.stable,
        "left": eq.residual * scale_of(model, size),
        "size": size,
        "state": eq.state.q,
        "K": lin.K * scale[:, None] * scale,
        "M": lin.M * scale[:, None] * scale,
        "C": lin.C * scale[:, None] * scale,
        "B": B * scale,
        "frequency": found.frequency,
        "eigenvalues": found.eigenvalues,
        "shapes": found.shapes,
        "mode status": found.status,
        "unit": scale,
        "H": direct,
        "modal": modal,
        "f": f,
    }


def stacked(items):
    return jax.tree.map(lambda *x: jnp.stack(x), *items)


class Program:
    """A function of a model, compiled once for a structure and a batch of models."""

    def __init__(self, function):
        self.compiled = jb.jit(jax.vmap(function))  # compiling is the cost

    def __call__(self, *arguments):
        return {name: np.asarray(x) for name, x in self.compiled(*map(stacked, arguments)).items()}


class Programs:
    def __init__(self):
        self.forces, self.near, self.rest = Program(forces), Program(near), Program(rest)


def relative(a, b, scale=0.0):
    """The largest difference of each model, relative to its largest number or a scale."""
    n = len(a)
    a, b = np.reshape(a, (n, -1)), np.reshape(b, (n, -1))
    largest = np.maximum(np.maximum(np.abs(a), np.abs(b)).max(1), scale)
    return np.abs(a - b).max(1) / np.maximum(largest, TINY)


def smooth(structure):
    return not any(kind in ("rope", "stop") for kind, *_ in structure.elements)


def remembers(structure):
    return any(kind in ("maxwell", "bouc wen") for kind, *_ in structure.elements)


def views(structure, seed):
    rng = structure.rng(seed, "view")
    moved = View(turn=tuple(turn_of(rng)), move=tuple(structure.size(seed) * rng.normal(size=3)))
    scaled = View(*10 ** rng.uniform(-3, 3, 3))
    return moved, scaled


def turned_back(structure, model, v_dot, view):
    """Accelerations of free bodies in the axes before all was turned."""
    R, v_dot = rigs.turned(view.turn).T, np.array(v_dot)
    for name, kind in zip(structure.bodies, structure.joints, strict=True):
        if kind == "free":
            rows = model.layout.v_slices[name]
            v_dot[rows] = np.concatenate([R @ v_dot[rows][:3], R @ v_dot[rows][3:]])
    return v_dot


def at_random_states(structure, seeds, programs):
    """Properties away from equilibria."""
    models = [structure.model(seed) for seed in seeds]
    states = [structure.state(seed, model) for seed, model in zip(seeds, models, strict=True)]
    around = [
        0.05 * structure.rng(seed, "loop").normal(size=(2, models[0].layout.nv)) for seed in seeds
    ]
    plain, local = programs.forces(models, states), programs.near(models, states, around)
    found = {
        "T3 no damper gives power": np.maximum(0.0, -local["power"])
        / np.maximum(local["powers"], TINY),
        "T5 forces of elements are in balance": local["balance"],
        "T23 K is symmetric": relative(local["K"], np.swapaxes(local["K"], 1, 2)),
    }
    if smooth(structure):
        found["T4 no work around a closed loop"] = local["loop"] / np.maximum(local["works"], TINY)
        if not remembers(structure):
            found["T24 K is the difference of the gradient"] = relative(
                local["K"], local["K_by_differences"]
            )
    moved, scaled = zip(*(views(structure, seed) for seed in seeds), strict=True)
    for name, view in (("moved", moved), ("scaled", scaled)):
        there = [structure.model(seed, v) for seed, v in zip(seeds, view, strict=True)]
        other = programs.forces(
            there, [structure.state(s, m, v) for s, m, v in zip(seeds, there, view, strict=True)]
        )
        if name == "moved":
            scale = plain["stiffest"]  # forces of a stretch of the size of the model
            found["T9 forces do not depend on the place and turn of the whole"] = relative(
                plain["force"], other["force"], scale * np.minimum(plain["size"], 1.0)
            )
            back = [
                turned_back(structure, m, a, v)
                for m, a, v in zip(there, other["v_dot"], view, strict=True)
            ]
            found["T9 accelerations turn with the whole"] = relative(plain["v_dot"], np.array(back))
        else:
            energy = np.array([v.unit(2, 1, -2) for v in view])
            found["T10 energies in other units"] = np.maximum(
                relative(plain["T"] * energy, other["T"]), relative(plain["V"] * energy, other["V"])
            )
            unit = [np.where(models[0].layout.turns, 1.0, v.length) / v.time**2 for v in view]
            found["T10 accelerations in other units"] = relative(
                plain["v_dot"] * unit, other["v_dot"]
            )
    flipped = programs.forces(
        models, [flip(model, state) for model, state in zip(models, states, strict=True)]
    )
    found["T14 q and -q"] = np.max(
        [relative(plain[name], flipped[name]) for name in ("T", "V", "force", "v_dot")], axis=0
    )
    bad = [
        ~np.isfinite(np.reshape(x, (len(seeds), -1))).all(1)
        for part in (plain, local)
        for x in part.values()
    ]
    found["T53 numbers that are not finite and not announced"] = np.sum(bad, axis=0)
    return found


def flip(model, state):
    """The same state with all quaternions negative."""
    q = np.array(state.q)
    for block in model.layout.joints:
        if block.nq > block.nv:
            q[model.layout.q_slices[block.owner]][-4:] *= -1
    return jb.State(q, state.v, state.z)


def ill_conditioned(M, C, K):
    """By how much the condition of a mass matrix with a diagonal of 1 is beyond 1e3, and the poles
    are further than 1e4 apart: rounding changes frequencies and shapes in proportion to the first,
    and a sum over modes to both."""
    if not all(np.isfinite(X).all() for X in (M, C, K)):
        return 1.0, 1.0
    unit = 1 / np.sqrt(np.diag(M))
    poles = np.abs(
        np.linalg.eigvals(
            np.block([[0 * M, np.eye(len(M))], [-np.linalg.solve(M, K), -np.linalg.solve(M, C)]])
        )
    )
    return max(1.0, np.linalg.cond(M * unit[:, None] * unit) / 1e3), max(
        1.0, np.max(poles) / max(np.min(poles), TINY) / 1e4
    )


def at_rest(structure, seeds, programs):
    """Properties of equilibria, -1 where one does not apply, and the statuses of the searches."""
    fractions = [np.array([0.0, 0.03, 0.31, 0.77, 1.9])] * len(seeds)

    def solved(view):
        points = [
            structure.size(s) * structure.rng(s, "ports").normal(size=(3, 3)) * v.length
            for s, v in zip(seeds, view, strict=True)
        ]
        return programs.rest(
            [structure.model(s, v) for s, v in zip(seeds, view, strict=True)], points, fractions
        )

    views_of = [views(structure, seed) for seed in seeds]
    plain, moved, scaled = (
        solved([PLAIN] * len(seeds)),
        solved([v for v, _ in views_of]),
        solved([v for _, v in views_of]),
    )
    ok = plain["status"] == 0
    good = ok & (plain["mode status"] == 0)
    beyond, apart = np.transpose(
        [ill_conditioned(*x) for x in zip(plain["M"], plain["C"], plain["K"], strict=True)]
    )
    found = {}

    def enter(name, applies, values):
        found[name] = np.where(applies, values, -1.0)

    least = np.array(
        [
            np.linalg.eigvalsh(K)[0] / np.abs(K).max() if np.isfinite(K).all() else np.nan
            for K in plain["K"]
        ]
    )
    decided = (np.abs(least) > 1e-12) & np.isin(plain["status"], (0, int(jb.Status.UNSTABLE)))
    enter(
        "T22 stability is the sign of the smallest eigenvalue (wrong)",
        decided,
        plain["stable"] != (least > 0),
    )
    enter("R1 rest called ok with K not positive (wrong)", ok, ~(least > 0))
    largest = np.abs(plain["K"]).max((1, 2)) * plain["size"]
    enter("R1 rest called ok: force left over", ok, np.abs(plain["left"]).max(1) / largest)
    silent = [~np.isfinite(np.reshape(x, (len(seeds), -1))).all(1) for x in plain.values()]
    enter("T53 numbers that are not finite and not announced", good, np.sum(silent, axis=0))
    time = np.array([view.time for _, view in views_of])[:, None]
    for name, other, frequency in (
        ("T9 frequencies do not depend on place and turn", moved, moved["frequency"]),
        ("T10 frequencies in other units", scaled, scaled["frequency"] * time),
    ):
        difference = relative(plain["frequency"], frequency)
        # else another of several rests was found
        same = good & (other["status"] == 0) & (other["mode status"] == 0) & (difference < 1e-6)
        enter(name, same, difference / beyond)
    if not structure.closed:
        u, w2 = plain["shapes"] / plain["unit"][:, :, None], plain["eigenvalues"]
        left = plain["K"] @ u - plain["M"] @ u * w2[:, None, :]
        size = np.abs(plain["K"]).max((1, 2)) * np.abs(u).max((1, 2))
        enter("T29 K u = w2 M u", good, np.abs(left).max((1, 2)) / size)
        difference = np.swapaxes(u, 1, 2) @ plain["M"] @ u - np.eye(u.shape[2])
        enter("T29 shapes are orthonormal in M", good, np.abs(difference).max((1, 2)) / beyond)
    H, modal = np.moveaxis(plain["H"], -1, 1), np.moveaxis(plain["modal"], -1, 1)
    enter("T32 response is reciprocal", good, per_line(H, np.swapaxes(H, 2, 3)))
    enter("T33 sum over modes", good, per_line(H, modal) / beyond / apart)
    w = 2 * np.pi * plain["f"][:, :, None, None]
    if not remembers(structure):
        D = plain["K"][:, None] + 1j * w * plain["C"][:, None] - w**2 * plain["M"][:, None]
        D, B = np.where(good[:, None, None, None], D, np.eye(D.shape[-1])), plain["B"][:, None]
        expected = B @ np.linalg.solve(D, np.swapaxes(B, 2, 3) + 0 * D[..., :1, :1])
        enter("T33 response is B (K + i w C - w2 M)^-1 B'", good, per_line(H, expected))
    mobility = np.where(good[:, None, None, None], 1j * w * H, 0)
    power = np.linalg.eigvalsh((mobility + np.conj(np.swapaxes(mobility, 2, 3))) / 2)[..., 0]
    enter(
        "T34 no negative power",
        good,
        np.max(np.maximum(0, -power) / np.maximum(np.abs(mobility).max((2, 3)), TINY), axis=1),
    )
    return found, plain["status"]


def per_line(a, b):
    """The largest difference of a line, relative to its largest number."""
    size = np.maximum(np.abs(a).max((2, 3)), TINY)
    return np.max(np.abs(a - b).max((2, 3)) / size, axis=1)


def reordered(structure, seeds, programs):
    """Properties of models whose parts are named in another order."""
    other = View(reverse=True)
    models = [[structure.model(seed, view) for seed in seeds] for view in (PLAIN, other)]
    states = [
        [structure.state(seed, model) for seed, model in zip(seeds, ms, strict=True)]
        for ms in models
    ]
    one, two = (programs.forces(m, s) for m, s in zip(models, states, strict=True))
    found = {
        "T12 energies in another order": np.maximum(
            relative(one["T"], two["T"]), relative(one["V"], two["V"])
        )
    }
    points = [structure.size(s) * structure.rng(s, "ports").normal(size=(3, 3)) for s in seeds]
    fractions = [np.array([0.0, 0.03, 0.31, 0.77, 1.9])] * len(seeds)
    one, two = (programs.rest(m, points, fractions) for m in models)
    difference = relative(one["frequency"], two["frequency"])
    same = (one["status"] == 0) & (two["status"] == 0) & (difference < 1e-6)
    beyond = np.array(
        [ill_conditioned(*x)[0] for x in zip(one["M"], one["C"], one["K"], strict=True)]
    )
    found["T12 frequencies in another order"] = np.where(same, difference / beyond, -1.0)
    return found
