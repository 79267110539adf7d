"""Layout of the coordinates: a row of blocks, one for each owner of coordinates, with names,
slices, units and descriptions."""

from __future__ import annotations

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
    """The coordinates of one owner, the joint of a body or an element with memory: nq numbers in q,
    nv in v, nz in z. A motion in m is small compared with the size of the model, any other compared
    with 1. The value at rest is a function of the owner's parameters, and so the owner's."""

    owner: str
    kind: type[Any]  # the owner's class
    motions: tuple[str, ...]  # a description of each speed
    q_units: tuple[str, ...]
    v_units: tuple[str, ...]
    quaternion: bool = False  # whether the last four numbers of q are one
    states: tuple[str, ...] = ()  # a description of each state in z
    z_units: tuple[str, ...] = ()
    # "massless" or "inertial", a coordinate with a row in M, C and K; "rate" of one with
    # mass; "hysteretic"
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
    # those of the joints, in the order of the bodies, then those of elements, in that of
    # their tables
    blocks: tuple[CoordinateBlock, ...]

    @cached_property
    def _hash(self) -> int:
        return hash((self.bodies, self.supports, self.parents, self.blocks))

    def __hash__(self) -> int:  # once for each layout: every call of a compiled program asks for it
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
        """The coordinates of an owner, such as a body's joint."""
        return next(block for block in self.blocks if block.owner == owner)

    @cached_property
    def coordinate_places(self) -> dict[str, tuple[int, int]]:
        """{"rack.q": place in q, place in v} of the coordinates that are displacements or angles;
        "nut.q.1" where a joint has several."""
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
        """(q, v, z) as one vector."""
        return jnp.concatenate([state.q, state.v, state.z])

    def unpack(self, y: Float[Array, "ny"]) -> State:
        """The state of (q, v, z), with normalized quaternions."""
        q, v, z = self.split(y)
        return State(self.normalized(q), v, z)

    def split(self, y: Float[Array, "ny"]) -> tuple[Array, Array, Array]:
        """q, v and z of (q, v, z)."""
        return y[: self.nq], y[self.nq : self.nq + self.nv], y[self.nq + self.nv :]

    def normalized(self, q: Float[Array, "nq"]) -> Float[Array, "nq"]:
        """q with its quaternions normalized."""
        parts = [q[self.q_slices[block.owner]] for block in self.with_rows]
        normal = [
            jnp.concatenate([part[:-4], rotations.normalize(part[-4:])])
            if block.quaternion
            else part
            for block, part in zip(self.with_rows, parts, strict=True)
        ]
        return jnp.concatenate(normal)

    def rows_of(self, owners: tuple[str, ...], x: Array, slices: dict[str, slice]) -> Array:
        """The numbers of some owners of one kind, a row for each, from a vector with
        these slices."""
        return x[np.array([np.r_[slices[name]] for name in owners], dtype=int)]

    def joined(self, pieces: list[tuple[tuple[str, ...], Array]]) -> Array:
        """The rows of all owners with rows in q and v, given for some at a time, in the order of
        the blocks."""
        order = tuple(block.owner for block in self.with_rows)
        if len(pieces) == 1 and pieces[0][0] == order:
            return pieces[0][1].reshape(-1, *pieces[0][1].shape[2:])
        rows = {name: part[i] for owners, part in pieces for i, name in enumerate(owners)}
        return jnp.concatenate([rows[name] for name in order])

    # Descriptions

    @cached_property
    def motions(self) -> tuple[tuple[str, str], ...]:
        """For each speed its owner and motion: ("plate", "turn about z")."""
        return tuple((block.owner, motion) for block in self.blocks for motion in block.motions)

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """A description of each speed (and each component of Delta)."""
        return tuple(f"{name} {motion}" for name, motion in self.motions)

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
        """(nv,): True for speeds in rad/s."""
        return np.array([unit != "m/s" for unit in self.v_units], dtype=bool)

    @cached_property
    def angular(self) -> np.ndarray:
        """(nq,): True for angles and for the four numbers of a quaternion, which describe
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
        """The places in z of states of this role."""
        return np.flatnonzero([role == one for block in self.blocks for one in block.roles])

    @cached_property
    def massless(self) -> np.ndarray:
        """The places in z of massless coordinates."""
        return self._places("massless")

    @cached_property
    def inertial(self) -> np.ndarray:
        """The places in z of coordinates with mass."""
        return self._places("inertial")

    @cached_property
    def inner_rates(self) -> np.ndarray:
        """The places in z of the rates of coordinates with mass."""
        return self._places("rate")

    @cached_property
    def inner_places(self) -> np.ndarray:
        """The places in z of the coordinates of elements in the order of their rows: those with
        mass, then massless ones."""
        return np.concatenate([self.inertial, self.massless])

    @cached_property
    def follows_angles(self) -> np.ndarray:
        """(nz,): True for states that follow an angle."""
        return np.array(
            [unit == "rad" for block in self.blocks for unit in block.arguments], dtype=bool
        )

    @cached_property
    def inner(self) -> tuple[str, ...]:
        """A description of each coordinate of elements, in the order of their rows."""
        return tuple(self.states[i] for i in self.inner_places)

    @cached_property
    def with_mass(self) -> tuple[str, ...]:
        """A description of each speed, and of each coordinate of elements with mass: the rows
        of modes."""
        return self.coordinates + self.inner[: len(self.inertial)]

    # The tree of the joints

    @cached_property
    def chains(self) -> dict[str, tuple[str, ...]]:
        """Each frame, then the frames that carry it by joints: {"hand": ("hand",
        "arm", "base")}."""
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
        """(frames, frames): 1 where the first frame carries the second by joints, or is it."""
        mask = np.zeros((len(self.frames), len(self.frames)))
        for row, chain in enumerate(self.chains.values()):
            mask[[self.frame(name) for name in chain], row] = 1
        return mask

    @cached_property
    def movers(self) -> np.ndarray:
        """For each speed, then for each of the six numbers of each support, the row of the first
        frame that it moves."""
        return np.array(
            [self.frame(name) for name, _ in self.motions] + [1 + i // 6 for i in range(self.nxi)],
            dtype=int,
        )

    def moving(self, *, base: bool) -> np.ndarray:
        """The rows of the frames that move: bodies, then, with `base`, supports."""
        return np.r_[self.first_body : len(self.frames), 1 : self.first_body if base else 1]
