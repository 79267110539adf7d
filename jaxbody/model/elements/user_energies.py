"""Energies and dissipations written by the user: functions V(frames) and R(frames) of the frames
that they read by name."""

from abc import abstractmethod
from collections.abc import Iterator, Mapping
from typing import Any, cast

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import check_returned, kind_of
from jaxbody.core.arrays import Array, Bool, Float, float_array, functions_as_nodes, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems
from jaxbody.geometry import rotations
from jaxbody.geometry.fields import field, in_domain, kind_along
from jaxbody.geometry.frames import Frame, Pose
from jaxbody.geometry.points_and_orientations import IDENTITY
from jaxbody.geometry.vectors import axial, product
from jaxbody.model.elements.element_checks import check_leaves, unknown_frame
from jaxbody.model.elements.elements import Element

DrawnAt = tuple[Any, Any]  # position and orientation (a unit quaternion) in the reference pose
WORLD = "world"
NOWHERE: DrawnAt = np.zeros(3), np.array(IDENTITY)


class OfFrames(Element):
    """The base class of OwnEnergy and OwnDissipation: an element whose deformation is the poses of
    the frames that `function` reads, 12 numbers each."""

    function: Any = field()
    reads: tuple[str, ...] = field(static=True)
    size = 12

    def __init__(self, function: Any, reads: tuple[str, ...]):
        self.function, self.reads = function, reads
        self.a = self.b = cast(Any, None)  # it has no points of attachment
        self.between = reads if len(reads) > 1 else (WORLD, *reads)

    @property
    def points(self):
        return ()

    @staticmethod
    @abstractmethod
    def seen(frame: Frame) -> Any:
        """Return the part of a frame that the function can read."""

    def deformation(self, *poses: Pose) -> Float[Array, "m"]:
        return jnp.concatenate([part for pose in poses for part in (pose.p, pose.R.ravel())])

    def of_frames(self, e: Float[Array, "m"], e_dot: Float[Array, "m"]) -> Float[Array, ""]:
        """Return the value of the function for the poses e with the rates e_dot."""
        frames = []
        for x, x_dot in zip(e.reshape(-1, 12), e_dot.reshape(-1, 12), strict=True):
            R = x[3:].reshape(3, 3)
            frames.append(Frame(x[:3], R, x_dot[:3], axial(product(x_dot[3:].reshape(3, 3), R.T))))
        named = dict(zip(self.reads, map(self.seen, frames[-len(self.reads) :]), strict=True))
        return jnp.asarray(self.function(named), e.dtype)


class OwnEnergy(OfFrames):
    """A potential energy V(frames) [J] written by the user, in `Model(energies={...})`; frames have
    p, R and point(x)."""

    @staticmethod
    def seen(frame: Frame) -> Any:
        return frame.pose()

    def energy(self, e):
        return self.of_frames(e, jnp.zeros_like(e))

    def dissipation(self, e, e_dot):
        return jnp.zeros((), e.dtype)


class OwnDissipation(OfFrames):
    """A dissipation function R(frames) [W] written by the user, in `Model(dissipations={...})`;
    frames have p, R, v, w, point(x) and velocity(x)."""

    @staticmethod
    def seen(frame: Frame) -> Any:
        return frame

    def energy(self, e):
        return jnp.zeros((), e.dtype)

    def dissipation(self, e, e_dot):
        return self.of_frames(e, e_dot)


def unwrapped(row: Any) -> Any:
    """Return the function of an energy or dissipation written by the user, and any other object
    itself."""
    return row.function if isinstance(row, OfFrames) else row


class _Reading(Mapping):
    """The frames as drawn, in a mapping that records which names are read."""

    def __init__(self, kind: type[OfFrames], drawn: dict[str, DrawnAt]):
        self.kind, self.drawn, self.read = kind, drawn, {}

    def __getitem__(self, name: str) -> Any:
        self.read[name] = None
        return self.kind.seen(_pose(self.drawn.get(name, NOWHERE)).at_rest())

    def __iter__(self) -> Iterator[str]:
        return iter(self.drawn)

    def __len__(self) -> int:
        return len(self.drawn)


def own_functions(
    problems: Problems,
    group: str,
    kind: type[OfFrames],
    given: dict[str, Any],
    drawn: dict[str, DrawnAt],
) -> dict[str, Any]:
    """Return {name: element} for functions written by the user; each function is traced once to
    find the frames that it reads.

    Errors: WRONG_KIND, NOT_A_NUMBER, NOT_TRACEABLE, FUNCTION_FAILED, BAD_SHAPE,
    UNKNOWN_BODY, NON_FINITE."""
    made = {
        name: _own(problems, f"{group}[{name!r}]", kind, function, drawn)
        for name, function in given.items()
    }
    return {name: each for name, each in made.items() if each is not None}


def _own(
    problems: Problems, where: str, kind: type[OfFrames], function: Any, drawn: dict[str, DrawnAt]
) -> OfFrames | None:
    if isinstance(function, type) or not callable(function):
        problems.add(
            "WRONG_KIND",
            where,
            f"is {kind_of(function)}",
            value=function,
            limit="a function of frames",
            hint=(
                f"Write {function.__name__}(...)."
                if isinstance(function, type)
                else "Give an equinox.Module with __call__(frames)."
            ),
        )
        return None
    faults, reading, function = Problems(), _Reading(kind, drawn), functions_as_nodes(function)
    check_leaves(faults, where, function)
    if not faults.collected:
        function = jax.tree.map(float_array, function)
        for keys, x in jax.tree_util.tree_leaves_with_path(function):
            in_domain(x, kind_along(function, keys), where + jax.tree_util.keystr(keys), faults)
        check_returned(
            lambda function, _: function(reading), function, (), where, faults, "poses by name"
        )
    names = tuple(reading.read)
    faults.collected += [
        unknown_frame(name, where, tuple(drawn), "frame") for name in names if name not in drawn
    ]
    if not faults.collected and not set(names) - {WORLD}:
        faults.add(
            "FUNCTION_FAILED",
            where,
            "reads no frame",
            value=names,
            limit="a frame or more",
            hint='Read frames["name"].',
        )
    problems.collected += faults.collected
    if faults.collected:
        return None
    element = kind(function, names)
    places = tuple(drawn[name] for name in element.between)
    if is_concrete((element, places)) and not _is_finite(element, places):
        problems.add(
            "NON_FINITE",
            where,
            "has a value or slopes that are not finite in the reference pose",
            value=names,
            limit="finite numbers",
            hint=(
                "Draw the bodies where they are, and keep what is under a root or a fraction "
                "line away from zero."
            ),
        )
    return element


def _pose(place: DrawnAt) -> Pose:
    return Pose(jnp.asarray(place[0]), rotations.matrix(jnp.asarray(place[1])))


@program
def _is_finite(element: OfFrames, places: tuple[DrawnAt, ...]) -> Bool[Array, ""]:
    """Return whether the value and its slopes are finite at rest in these places."""
    e = element.deformation(*map(_pose, places))
    results = jax.value_and_grad(
        lambda e, e_dot: element.energy(e) + element.dissipation(e, e_dot), (0, 1)
    )(e, jnp.zeros_like(e))
    return jnp.stack([jnp.isfinite(x).all() for x in jax.tree.leaves(results)]).all()
