"""Layout of the coordinates: which belong to which joint, with names, slices, units and descriptions."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from jaxbody.models.joints import Free, Joint

WORLD = "world"


@dataclass(frozen=True)
class Layout:
    """The static part of a model: its frames and coordinates, in the order of the names given by the user."""

    bodies: tuple[str, ...]
    supports: tuple[str, ...]
    kinds: tuple[type[Joint], ...]  # of each body's joint, in the order of bodies
    parents: tuple[str, ...]

    @cached_property
    def frames(self) -> tuple[str, ...]:
        """All frames, in the order of their rows: world, supports, bodies."""
        return (WORLD, *self.supports, *self.bodies)

    def frame(self, name: str) -> int:
        return self.frames.index(name)

    @cached_property
    def first_body(self) -> int:
        return 1 + len(self.supports)

    @cached_property
    def q_slices(self) -> dict[str, slice]:
        ends = np.cumsum([0] + [kind.nq for kind in self.kinds])
        return {name: slice(int(i), int(j)) for name, i, j in zip(self.bodies, ends[:-1], ends[1:], strict=True)}

    @cached_property
    def v_slices(self) -> dict[str, slice]:
        ends = np.cumsum([0] + [kind.nv for kind in self.kinds])
        return {name: slice(int(i), int(j)) for name, i, j in zip(self.bodies, ends[:-1], ends[1:], strict=True)}

    @cached_property
    def nq(self) -> int:
        return sum(kind.nq for kind in self.kinds)

    @cached_property
    def nv(self) -> int:
        return sum(kind.nv for kind in self.kinds)

    @cached_property
    def nxi(self) -> int:
        return 6 * len(self.supports)

    @cached_property
    def floating(self) -> bool:
        """True when every body is free on the world: the mass matrix is then constant in body axes."""
        return all(kind is Free for kind in self.kinds) and set(self.parents) <= {WORLD}

    @cached_property
    def depths(self) -> dict[str, int]:
        """The number of joints between a body and the joint on the world or a support."""
        parent = dict(zip(self.bodies, self.parents, strict=True))

        def depth(name: str) -> int:
            return 0 if name not in parent else 1 + depth(parent[name])

        return {name: depth(name) for name in self.bodies}

    @cached_property
    def carries(self) -> np.ndarray:
        """(nb, nv): 1 where a speed of a body's own joint, or of a joint below it, moves the body."""
        parent = dict(zip(self.bodies, self.parents, strict=True))
        mask = np.zeros((len(self.bodies), self.nv))
        for i, name in enumerate(self.bodies):
            while name in parent:
                mask[i, self.v_slices[name]] = 1
                name = parent[name]
        return mask

    @cached_property
    def roots(self) -> np.ndarray:
        """For each body the frame row of the support (or world) at the root of its tree."""
        parent = dict(zip(self.bodies, self.parents, strict=True))

        def root(name: str) -> str:
            return root(parent[name]) if name in parent else name

        return np.array([self.frame(root(name)) for name in self.bodies], dtype=int)

    @cached_property
    def motions(self) -> tuple[tuple[str, str], ...]:
        """For each speed its body and motion: ("plate", "turn about z")."""
        return tuple((name, motion) for name, kind in zip(self.bodies, self.kinds, strict=True) for motion in kind.motions)

    @cached_property
    def coordinates(self) -> tuple[str, ...]:
        """A description of each speed (and each component of Delta)."""
        return tuple(f"{name} {motion}" for name, motion in self.motions)

    @cached_property
    def base_coordinates(self) -> tuple[str, ...]:
        return tuple(f"{name} {motion}" for name in self.supports for motion in Free.motions)

    @cached_property
    def turns(self) -> np.ndarray:
        """(nv,): True for speeds in rad/s."""
        return np.array([turn for kind in self.kinds for turn in kind.turns], dtype=bool)

    @cached_property
    def angular(self) -> np.ndarray:
        """(nq,): True for angles and for the four numbers of a quaternion, which describe three rotations."""
        return np.array([turn for kind in self.kinds for turn in (*kind.turns, *[True] * (kind.nq - kind.nv))], dtype=bool)
