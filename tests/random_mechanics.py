"""Random models for properties of the mechanics: structures, and for each as many models as wanted
that share compiled programs.

A structure fixes the bodies, joints, elements, laws and closures; a seed draws the numbers of a
model. The same seed gives the same model in other units, moved and turned as a whole, or with its
parts named in another order.
"""

import dataclasses
import zlib

import numpy as np
import rigs

import jaxbody as jb

SPECIAL = ("zero rotation", "planar", "collinear", "no free length")
SHAPES, SYMMETRIC, BUSHINGS, CLOSED = 13, 4, 10, (6, 12)
JOINTS = (
    "free",
    "free",
    "free on base",
    "ball",
    "hinge",
    "guide",
    "composite",
    "heave pitch",
    "fixed",
)
ELEMENTS = (
    "spring",
    "spring",
    "spring",
    "bushing",
    "hardening",
    "rope",
    "stop",
    "digressive",
    "torsion",
    "inerter",
    "maxwell",
    "bouc wen",
)
IDENTITY = np.array([1.0, 0, 0, 0])


def turn_of(rng, angle=None):
    """A random turn, or one by a given angle about a random axis."""
    if angle is None:
        q = rng.normal(size=4)
        return q / np.linalg.norm(q)
    n = rng.normal(size=3)
    return np.concatenate([[np.cos(angle / 2)], np.sin(angle / 2) * n / np.linalg.norm(n)])


def times(p, q):
    """The product of two quaternions."""
    (w, x), (v, y) = (p[0], p[1:]), (q[0], q[1:])
    return np.concatenate([[w * v - x @ y], w * y + v * x + np.cross(x, y)])


def inverse(q):
    return q * [1, -1, -1, -1]


@dataclasses.dataclass(frozen=True)
class View:
    """How a model is seen: the meter, kilogram and second in the units used, and the pose of the
    old origin."""

    length: float = 1.0
    mass: float = 1.0
    time: float = 1.0
    turn: tuple[float, ...] = (1.0, 0, 0, 0)
    move: tuple[float, ...] = (0.0, 0, 0)
    reverse: bool = False

    def unit(self, length=0, mass=0, time=0):
        return self.length**length * self.mass**mass * self.time**time

    def point(self, p):
        """A place of the world."""
        return (rigs.turned(self.turn) @ p + self.move) * self.length

    def turned(self, q):
        return times(np.array(self.turn), q)


PLAIN = View()


class Structure:
    """One of SHAPES shapes, which its compiled programs depend on, in one of four kinds of numbers:
    parameters over two and over six decades, and special layouts with either. One shape is a body
    on springs of fourfold symmetry, one has bushings alone, two closures."""

    def __init__(self, number):
        self.number, self.shape, kind = number, number // 4 % SHAPES, number % 4
        rng = np.random.default_rng([29, self.shape])
        self.closed, self.wide = self.shape in CLOSED, kind % 2 == 1
        self.special = SPECIAL[(self.shape + number) % len(SPECIAL)] if kind > 1 else ""
        if self.shape == SYMMETRIC:
            self.special = "symmetric"
        n = 1 if self.special == "symmetric" else max(1 + self.shape % 6, 2 * self.closed)
        self.bodies = [f"b{i}" for i in range(n)]
        self.joints, self.parents = [], []
        for i in range(n):
            joint = (
                "free"
                if self.shape % 3 == 0 or self.shape == SYMMETRIC
                else JOINTS[rng.integers(len(JOINTS))]
            )
            if self.closed and i < 2:
                joint = ("hinge", "ball")[i]
            if i == 0 and joint == "fixed":
                joint = "hinge"
            parent = (
                "base"
                if i == 0
                else "b0"
                if i == 1 and self.closed
                else self.bodies[rng.integers(i)]
            )
            self.joints.append(joint)
            self.parents.append({"free": "world", "free on base": "base"}.get(joint, parent))
        self.elements = [
            ("spring", name, "base") for name in self.bodies for _ in range(6 if n == 1 else 4)
        ]  # each body holds by enough
        # half of them have springs and bushings alone
        kinds = ELEMENTS if self.shape % 2 else ELEMENTS[:4]
        while len(self.elements) < min(25, 4 * n + 3 + self.shape):
            a, b = rng.permutation(["base", *self.bodies])[:2]
            self.elements.append((kinds[rng.integers(len(kinds))], str(a), str(b)))
        if self.shape == BUSHINGS:
            self.elements = [("bushing", a, b) for _, a, b in self.elements]
        if self.special == "symmetric":
            self.elements = [("spring", "b0", "base")] * 8

    def rng(self, seed, what):
        """Random numbers of one thing, whatever the order in which things are made."""
        return np.random.default_rng([self.number, seed, zlib.crc32(what.encode())])

    def log_uniform(self, rng):
        return 10 ** (rng.uniform(-3, 3) if self.wide else rng.uniform(-1, 1))

    def places(self, seed):
        """Position and orientation of the base and of each body, in SI units."""
        size, found = self.size(seed), {}
        for name in ("base", *self.bodies):
            rng = self.rng(seed, name)
            p, q = size * rng.normal(size=3), turn_of(rng)
            if self.special in ("zero rotation", "symmetric", "planar"):
                q = IDENTITY
            if self.special == "planar":
                p = p * [1, 1, 0]
            if self.special == "symmetric":
                p = 0 * p
            found[name] = p, q
        return found

    def size(self, seed):
        """The length of the model [m], over two decades."""
        return 10 ** self.rng(seed, "size").uniform(-1, 1)

    def body(self, seed, name, view):
        rng, size, (p, q) = (
            self.rng(seed, f"{name} inertia"),
            self.size(seed),
            self.places(seed)[name],
        )
        mass = self.log_uniform(rng)
        points, weights = size * rng.normal(size=(rng.integers(4, 9), 3)), rng.uniform(0.2, 1, 8)
        weights = weights[: len(points)] / weights[: len(points)].sum()
        points = points - weights @ points
        J = np.einsum("n,ni,nj->ij", weights, points, points)
        com = 0.3 * size * rng.normal(size=3)
        if self.special == "symmetric":
            J, com = np.diag([1.0, 1, 2]) * size**2, 0 * com
        inertia = mass * (np.trace(J) * np.eye(3) - J)
        return jb.Body(
            mass=mass * view.unit(mass=1), inertia=inertia * view.unit(2, 1), com=com * view.length,
            position=view.point(p), orientation=view.turned(q),
        )  # fmt: skip

    def joint(self, seed, i, view):
        rng, kind, parent, size = (
            self.rng(seed, f"joint {i}"),
            self.joints[i],
            self.parents[i],
            self.size(seed),
        )
        if kind == "free":
            return jb.Free()
        if kind == "free on base":
            return jb.Free("base")
        axis, at = rng.normal(size=3), size * view.length * rng.normal(size=3)
        if kind == "ball":
            return jb.Ball(parent, at=at)
        if kind == "hinge":
            return jb.Hinge(parent, axis=axis, at=at)
        if kind == "guide":
            return jb.Guide(parent, axis=axis)
        if kind == "heave pitch":
            return jb.joints.HeavePitch(parent)
        if kind == "fixed":
            return jb.Fixed(parent)
        lines = size * view.length * rng.normal(size=(2, 3))
        return jb.joints.Composite(
            parent, ["move", "turn"], directions=rng.normal(size=(2, 3)), points=lines
        )

    def element(self, seed, i, view):
        """Free lengths are about the distance of the ends in the reference pose; bushings are
        nearly relaxed there."""
        rng, size, (kind, a, b), places = (
            self.rng(seed, f"element {i}"),
            self.size(seed),
            self.elements[i],
            self.places(seed),
        )
        ends = [size * rng.normal(size=3) * (2.0 if name == "base" else 0.5) for name in (a, b)]
        if self.special == "collinear":
            ends = [size * np.array([1.0, 0.2, 0.1]) * rng.normal() for _ in range(2)]
        if self.special == "planar":
            ends = [end * [1, 1, 0] for end in ends]
        if self.special == "symmetric":
            angle = np.pi / 2 * (i % 4)
            out = np.array([np.cos(angle), np.sin(angle), (-1.0) ** (i // 4)])
            ends = [0.5 * size * out, 1.5 * size * out]
        p, q = ([places[name][j] for name in (a, b)] for j in (0, 1))
        line = np.linalg.norm(
            p[1] + rigs.turned(q[1]) @ ends[1] - p[0] - rigs.turned(q[0]) @ ends[0]
        )
        k, loss = self.log_uniform(rng) * 1e3, 10 ** rng.uniform(-3, -1)
        if self.special == "symmetric":
            k, loss = 1e3, 1e-2
        length = 0.0 if self.special == "no free length" else line * rng.uniform(0.7, 1.0)
        if self.special == "symmetric":
            length = 0.9 * line
        between = [(name, end * view.length) for name, end in zip((a, b), ends, strict=True)]
        N_m, N_s_m = view.unit(0, 1, -2), view.unit(0, 1, -1)
        if kind == "spring":
            return jb.Spring(
                *between,
                stiffness=k * N_m,
                free_length=length * view.length,
                damping=loss * k * N_s_m,
            )
        if kind == "bushing":
            A = rng.normal(size=(6, 6))
            arm = size * view.length
            scale = np.array([1, 1, 1, arm, arm, arm])
            K = k * scale[:, None] * (A @ A.T / 6 + np.eye(6)) * scale
            orientation = IDENTITY if self.special == "zero rotation" else turn_of(rng)
            meeting = times(
                times(inverse(q[1]), q[0]), times(orientation, turn_of(rng, rng.uniform(0, 0.5)))
            )
            meet = rigs.turned(q[1]).T @ (
                p[0] + rigs.turned(q[0]) @ ends[0] + 0.1 * size * rng.normal(size=3) - p[1]
            )
            return jb.Bushing(
                between[0],
                (b, meet * view.length),
                stiffness=K * N_m,
                damping=loss * K * N_s_m,
                orientation=orientation,
                orientation_b=IDENTITY if self.special == "zero rotation" else meeting,
            )
        if kind == "inerter":
            return jb.Inerter(*between, inertance=self.log_uniform(rng) * view.unit(mass=1))
        if kind == "torsion":
            about = {
                "spring": k * size**2 * view.unit(2, 1, -2),
                "damper": loss * k * size**2 * view.unit(2, 1, -1),
            }
            meeting = times(inverse(q[1]), q[0])
            return jb.Torsion(
                a, b, axis=rng.normal(size=3), free_angle=0.1, orientation_b=meeting, **about
            )
        laws = jb.laws
        law, damper = {
            "hardening": lambda: (
                laws.Polynomial(
                    k * np.array([1, 0.3 / line, 1 / line**2]) * N_m / view.length ** np.arange(3.0)
                ),
                None,
            ),
            "rope": lambda: (laws.TensionOnly(k * N_m), None),
            "stop": lambda: (
                laws.Linear(k * N_m)
                + laws.Stop(
                    gap=0.05 * line * view.length,
                    stiffness=9 * k * N_m,
                    engagement=0.1 * line * view.length,
                ),
                None,
            ),
            "digressive": lambda: (
                laws.Linear(k * N_m),
                laws.Digressive(
                    slow=loss * k * N_s_m,
                    fast=0.1 * loss * k * N_s_m,
                    knee=0.3 * line * view.unit(1, 0, -1),
                ),
            ),
            "maxwell": lambda: (
                laws.Linear(k * N_m)
                + laws.Maxwell(
                    stiffness=2 * k * N_m, relaxation_time=10 ** rng.uniform(-2, 0) * view.time
                ),
                None,
            ),
            "bouc wen": lambda: (
                laws.Linear(k * N_m)
                + laws.BoucWen(alpha=k * N_m, beta=3 / (line * view.length), gamma=0.8, delta=-0.3),
                loss * k * N_s_m,
            ),
        }[kind]()
        return jb.SpringDamper(
            *between, spring=law, damper=damper, free_length=length * view.length
        )

    def model(self, seed, view=PLAIN):
        rng, g = self.rng(seed, "gravity"), np.zeros(3)
        if self.special != "symmetric" and rng.uniform() < 0.7:
            g = 9.81 * (v := rng.normal(size=3)) / np.linalg.norm(v)
        p, q = self.places(seed)["base"]
        order = -1 if view.reverse else 1
        closures = {}
        if self.closed:
            ends = self.closing(seed, view)
            closures = {"loop": jb.closures.Rod(*ends)}
        model = jb.Model(
            bodies={name: self.body(seed, name, view) for name in self.bodies[::order]},
            supports={"base": jb.Support(view.point(p), view.turned(q))},
            joints={
                name: self.joint(seed, i, view) for i, name in list(enumerate(self.bodies))[::order]
            },
            elements={
                f"e{i}": self.element(seed, i, view) for i in range(len(self.elements))[::order]
            },
            closures=closures,
            gravity=rigs.turned(view.turn) @ g * view.unit(1, 0, -2),
        )
        if closures:  # all models of a structure share a program, which depends on this choice
            object.__setattr__(model, "independent", tuple(range(model.layout.nv - 1)))
        return model

    def closing(self, seed, view):
        """The ends of a rod from the second body to the base, four sizes long."""
        rng, size, places = self.rng(seed, "closure"), self.size(seed), self.places(seed)
        on_body = 0.5 * size * rng.normal(size=3)
        p, R = places["b1"][0], rigs.turned(places["b1"][1])
        far = p + R @ on_body + 4 * size * (v := rng.normal(size=3)) / np.linalg.norm(v)
        on_base = rigs.turned(places["base"][1]).T @ (far - places["base"][0])
        return ("b1", on_body * view.length), ("base", on_base * view.length)

    def state(self, seed, model, view=PLAIN, angle=0.3):
        """Displaced from the reference and moving, a meter per second and size of the model."""
        size, q, v = self.size(seed), model.reference.q, np.zeros(model.layout.nv)
        delta = np.zeros_like(v)
        for i, name in enumerate(self.bodies):
            rng, rows = self.rng(seed, f"state {i}"), model.layout.v_slices[name]
            n = rows.stop - rows.start
            turns = model.layout.turns[rows]
            move, speed = rng.normal(size=(2, n))
            if self.joints[i] == "free":
                R = rigs.turned(view.turn)
                move, speed = (np.concatenate([R @ x[:3], R @ x[3:]]) for x in (move, speed))
            delta[rows] = move * np.where(turns, angle, 0.2 * size * view.length)
            v[rows] = speed * np.where(turns, 1.0, size * view.length) / view.time
        return jb.State(jb.joints.retract(model, q, delta), v, model.reference.z)
