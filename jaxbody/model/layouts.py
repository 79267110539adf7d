"""Layout of the coordinates: a row of blocks, one for each owner of coordinates, with names,
slices, units and descriptions."""

from dataclasses import dataclass
from functools import cached_property
from typing import Any

import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float
from jaxbody.geometry import rotations
from jaxbody.model.states import State

WORLD = "world"
MOVES = ("move along x", "move along y", "move along z")
TURNS = ("turn about x", "turn about y", "turn about z")


@dataclass(frozen=True)
class CoordinateBlock:
    """The coordinates of one owner, which is the joint of a body or an element with memory: nq
    numbers in q, nv in v, nz in z. The scale of a motion in m is the size of the model, that of any
    other motion 1. The values at rest depend on the parameters of the owner."""

    owner: str
    kind: type[Any]  # the owner's class
    motions: tuple[str, ...]  # a description of each speed
    q_units: tuple[str, ...]
    v_units: tuple[str, ...]
    quaternion: bool = False  # whether the last four numbers of q are a quaternion
    states: tuple[str, ...] = ()  # a description of each state in z
    z_units: tuple[str, ...] = ()
    # role of each state: a coordinate with a row in M, C and K, "massless" or "inertial"; the
    # "rate" of an inertial coordinate; "hysteretic"; or "first order", that of a force element
    roles: tuple[str, ...] = ()
    arguments: tuple[str, ...] = ()  # the unit of the deformation that each state follows

    @property
    def nq(self) -> int:
        return len(self.q_units)

    @property
    def nv(self) -> int:
        return len(self.v_units)

    @property
    def nz(self) -> int:
        return len(self.states)


@dataclass(frozen=True)
class Layout:
    """The static part of a model: its frames and coordinates, in the order of the names given by
    the user."""

    bodies: tuple[str, ...]
    supports: tuple[str, ...]
    parents: tuple[str, ...]
    # of the joints, in the order of the bodies, then of elements, in the order of their tables
    blocks: tuple[CoordinateBlock, ...]

    @cached_property
    def _hash(self) -> int:
        return hash((self.bodies, self.supports, self.parents, self.blocks))

    def __hash__(self) -> int:  # kept, because every call of a compiled program hashes the layout
        return self._hash

    @cached_property
    def frames(self) -> tuple[str, ...]:
        """All frames, in the order of their rows: world, supports, bodies."""
        return (WORLD, *self.supports, *self.bodies)

    def frame(self, name: str) -> int:
        return self.frames.index(name)

    @cached_property
    def first_body(self) -> int:
        return 1 + len(self.supports)

    @property
    def joints(self) -> tuple[CoordinateBlock, ...]:
        """The blocks of the joints of the bodies."""
        return self.blocks[: len(self.bodies)]

    @cached_property
    def with_rows(self) -> tuple[CoordinateBlock, ...]:
        """The blocks of the joints, and those of elements with numbers in q and v."""
        return self.joints + tuple(block for block in self.blocks[len(self.bodies) :] if block.nv)

    @cached_property
    def q_slices(self) -> dict[str, slice]:
        return self._slices([block.nq for block in self.blocks])

    @cached_property
    def v_slices(self) -> dict[str, slice]:
        return self._slices([block.nv for block in self.blocks])

    @cached_property
    def z_slices(self) -> dict[str, slice]:
        return self._slices([block.nz for block in self.blocks])

    def _slices(self, widths: list[int]) -> dict[str, slice]:
        ends = np.cumsum([0, *widths]).tolist()
        return {
            block.owner: slice(i, j)
            for block, i, j in zip(self.blocks, ends[:-1], ends[1:], strict=True)
        }

    @cached_property
    def nq(self) -> int:
        return len(self.q_units)

    @cached_property
    def nv(self) -> int:
        return len(self.v_units)

    @cached_property
    def nz(self) -> int:
        return sum(block.nz for block in self.blocks)

    @cached_property
    def nxi(self) -> int:
        return 6 * len(self.supports)

    def block(self, owner: str) -> CoordinateBlock:
        """Return the block of an owner, such as that of a body's joint."""
        return next(block for block in self.blocks if block.owner == owner)

    @cached_property
    def coordinate_places(self) -> dict[str, tuple[int, int]]:
        """Indices of the coordinates that are displacements or angles: {"rack.q": (index in q,
        index in v)}; the key is "nut.q.1" if a joint has several."""
        return {
            f"{block.owner}.q" if block.nq == 1 else f"{block.owner}.q.{i}": (
                self.q_slices[block.owner].start + i,
                self.v_slices[block.owner].start + i,
            )
            for block in self.blocks
            for i, unit in enumerate(block.q_units)
            if unit
        }

    # From states to vectors and back

    def pack(self, state: State) -> Float[Array, "ny"]:
        """Join q, v and z of a state in one vector."""
        return jnp.concatenate([state.q, state.v, state.z])

    def unpack(self, y: Float[Array, "ny"]) -> State:
        """Return the state of a vector (q, v, z), with normalized quaternions."""
        q, v, z = self.split(y)
        return State(self.normalized(q), v, z)

    def split(self, y: Float[Array, "ny"]) -> tuple[Array, Array, Array]:
        """Split a vector (q, v, z) into q, v and z."""
        return y[: self.nq], y[self.nq : self.nq + self.nv], y[self.nq + self.nv :]

    def normalized(self, q: Float[Array, "nq"]) -> Float[Array, "nq"]:
        """Return q with its quaternions normalized."""
        parts = [q[self.q_slices[block.owner]] for block in self.with_rows]
        normal = [
            jnp.concatenate([part[:-4], rotations.normalize(part[-4:])])
            if block.quaternion
            else part
            for block, part in zip(self.with_rows, parts, strict=True)
        ]
        return jnp.concatenate(normal)

    def rows_of(self, owners: tuple[str, ...], x: Array, slices: dict[str, slice]) -> Array:
        """Return the numbers of some owners of one kind from a vector with these slices, one row
        for each owner."""
        rows = [range(slices[name].start, slices[name].stop) for name in owners]
        return x[np.array(rows, dtype=int)]

    def joined(self, pieces: list[tuple[tuple[str, ...], Array]]) -> Array:
        """Join the rows of groups of owners, [(owners, rows)], in the order of the blocks with
        numbers in q and v."""
        order = tuple(block.owner for block in self.with_rows)
        if len(pieces) == 1 and pieces[0][0] == order:
            return pieces[0][1].reshape(-1, *pieces[0][1].shape[2:])
        rows = {name: part[i] for owners, part in pieces for i, name in enumerate(owners)}
        return jnp.concatenate([rows[name] for name in order])

    # Descriptions

    @cached_property
    def motions(self) -> tuple[tuple[str, str], ...]:
        """Owner and motion of each speed: ("plate", "turn about z")."""
        return tuple((block.owner, motion) for block in self.blocks for motion in block.motions)

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """A description of each speed (and each component of Delta)."""
        return tuple(f"{name} {motion}" for name, motion in self.motions)

    @cached_property
    def coordinate_units(self) -> tuple[str, ...]:
        """Unit of each of the `coordinates`."""
        return tuple(unit.removesuffix("/s") for unit in self.v_units)

    def values_by_coordinate(self, q: Any) -> np.ndarray:
        """Return q (..., nq) by `coordinates`, in NumPy: the rotation vector [rad] in place of each
        quaternion."""
        values = []
        for block in self.blocks:
            own = q[..., self.q_slices[block.owner]]
            if block.quaternion:
                own, turn = np.split(own, [-4], -1)
                turn = np.where(turn[..., :1] < 0, -turn, turn)
                half = np.arctan2(np.linalg.norm(turn[..., 1:], axis=-1), turn[..., 0])
                own = np.concatenate(
                    [own, 2 * turn[..., 1:] / np.sinc(half / np.pi)[..., None]], -1
                )
            values.append(own)
        return np.concatenate([*values, q[..., :0]], -1)

    @cached_property
    def base_coordinates(self) -> tuple[str, ...]:
        return tuple(f"{name} {motion}" for name in self.supports for motion in MOVES + TURNS)

    @cached_property
    def q_units(self) -> tuple[str, ...]:
        return tuple(unit for block in self.blocks for unit in block.q_units)

    @cached_property
    def v_units(self) -> tuple[str, ...]:
        return tuple(unit for block in self.blocks for unit in block.v_units)

    @cached_property
    def turns(self) -> np.ndarray:
        """Array (nv,): True for speeds in rad/s."""
        return np.array([unit != "m/s" for unit in self.v_units], dtype=bool)

    @cached_property
    def angular(self) -> np.ndarray:
        """Array (nq,): True for angles and for the four numbers of a quaternion, which describe
        three rotations."""
        return np.array([unit != "m" for unit in self.q_units], dtype=bool)

    @cached_property
    def states(self) -> tuple[str, ...]:
        """A description of each state in z: "engine mount A, branch 2"."""
        return tuple(f"{block.owner}, {state}" for block in self.blocks for state in block.states)

    @cached_property
    def z_units(self) -> tuple[str, ...]:
        return tuple(unit for block in self.blocks for unit in block.z_units)

    def _places(self, role: str) -> np.ndarray:
        """Return the indices in z of the states with this role."""
        return np.flatnonzero([role == one for block in self.blocks for one in block.roles])

    @cached_property
    def massless(self) -> np.ndarray:
        """Indices in z of massless coordinates."""
        return self._places("massless")

    @cached_property
    def inertial(self) -> np.ndarray:
        """Indices in z of coordinates with mass."""
        return self._places("inertial")

    @cached_property
    def first_order(self) -> np.ndarray:
        """Indices in z of the states of force elements, the last ones."""
        return self._places("first order")

    @cached_property
    def inner_rates(self) -> np.ndarray:
        """Indices in z of the rates of coordinates with mass."""
        return self._places("rate")

    @cached_property
    def inner_places(self) -> np.ndarray:
        """Indices in z of the coordinates of elements, in the order of their rows in M, C and K:
        those with mass, massless ones, and the states of force elements."""
        return np.concatenate([self.inertial, self.massless, self.first_order])

    @cached_property
    def follows_angles(self) -> np.ndarray:
        """Array (nz,): True for states that follow an angle."""
        return np.array(
            [unit == "rad" for block in self.blocks for unit in block.arguments], dtype=bool
        )

    @cached_property
    def inner(self) -> tuple[str, ...]:
        """Descriptions of the coordinates of elements, in the order of their rows in M, C and K."""
        return tuple(self.states[i] for i in self.inner_places)

    @cached_property
    def with_mass(self) -> tuple[str, ...]:
        """A description of each speed, and of each coordinate of elements with mass: the rows
        of modes."""
        return self.coordinates + self.inner[: len(self.inertial)]

    # The tree of the joints

    @cached_property
    def chains(self) -> dict[str, tuple[str, ...]]:
        """For each frame its name, then the names of the frames that carry it by joints: {"hand":
        ("hand", "arm", "base")}."""
        parent = dict(zip(self.bodies, self.parents, strict=True))

        def chain(name: str) -> tuple[str, ...]:
            return (name, *chain(parent[name])) if name in parent else (name,)

        return {name: chain(name) for name in self.frames}

    @cached_property
    def depths(self) -> dict[str, int]:
        """The number of joints between a body and the joint on the world or a support."""
        return {name: len(self.chains[name]) - 2 for name in self.bodies}

    @cached_property
    def carries(self) -> np.ndarray:
        """Matrix (frames, frames): 1 where the first frame carries the second by joints or is
        the same."""
        mask = np.zeros((len(self.frames), len(self.frames)))
        for row, chain in enumerate(self.chains.values()):
            mask[[self.frame(name) for name in chain], row] = 1
        return mask

    @cached_property
    def movers(self) -> np.ndarray:
        """For each speed, then for each of the six coordinates of each support, the row of the
        first frame that it moves."""
        return np.array(
            [self.frame(name) for name, _ in self.motions] + [1 + i // 6 for i in range(self.nxi)],
            dtype=int,
        )

    def moving(self, *, base: bool) -> np.ndarray:
        """Return the rows of the frames that move: bodies, then, with `base`, supports."""
        return np.r_[self.first_body : len(self.frames), 1 : self.first_body if base else 1]
