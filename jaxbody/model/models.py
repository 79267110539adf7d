"""Models: bodies, supports, elements and joints by name, kept as arrays; their size, scales of
their coordinates for comparisons with round-off, and mounts whose ends are drawn apart."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arguments import checked_dict
from jaxbody.core.arrays import (
    Array,
    Float,
    as_numpy,
    device_array,
    functions_as_nodes,
    is_concrete,
    vector,
)
from jaxbody.core.compilation.compile_options import OPTIMIZED, QUICK, Options, program
from jaxbody.core.errors import JaxbodyError, Problem, Problems, unknown
from jaxbody.core.late_binding import handed_down
from jaxbody.geometry.closures import Closure, Coupling, as_slide
from jaxbody.geometry.fields import field, kind_of, text_of, units_of
from jaxbody.geometry.frames import Pose
from jaxbody.geometry.points_and_orientations import IDENTITY, matrix
from jaxbody.geometry.vectors import to_rank
from jaxbody.model.bodies import Body, Support, warn_of_points
from jaxbody.model.element_states import blocks_of, blocks_of_forces, end_rows
from jaxbody.model.elements.bushings import FramePair
from jaxbody.model.elements.element_checks import check_laws, check_leaves
from jaxbody.model.elements.elements import Element
from jaxbody.model.elements.torsions import Torsion
from jaxbody.model.elements.user_energies import (
    NOWHERE,
    OfFrames,
    OwnDissipation,
    OwnEnergy,
    own_functions,
    unwrapped,
)
from jaxbody.model.forces.controllers import Controller, check_drives
from jaxbody.model.forces.force_elements import ForceElement, check_force
from jaxbody.model.joints.joints import Free, Joint
from jaxbody.model.joints.kinematics import (
    Coordinates,
    coordinates_at_rest,
    jacobian,
    poses_of,
)
from jaxbody.model.laws.laws import Law
from jaxbody.model.layouts import WORLD, Layout
from jaxbody.model.model_checks import (
    check_links,
    check_movable,
    check_names,
    check_reference,
    check_slopes,
    counted,
    of_kind,
    warn_of_oddities,
)
from jaxbody.model.states import State
from jaxbody.model.storage import KindTable, tabulate, tabulate_by_structure
from jaxbody.numerics.small_systems import independent_rows

KINDS = {
    "bodies": Body,
    "supports": Support,
    "elements": (Element, ForceElement),
    "joints": Joint,
    "closures": Closure,
    "controllers": Controller,
}
OWN_FUNCTIONS = {"energies": OwnEnergy, "dissipations": OwnDissipation}
CLOSED = 1e-6  # relative to the largest distance of a point: a loop with a smaller gap is closed
DISPLACED = 0.3  # relative to that distance, or in rad: how far to go from a singular position
# relative to the largest pivot: of the coordinates with larger pivots, the last is dependent
NEARLY_LARGEST = 0.5


class Model(tables.Printed, eqx.Module):
    """Rigid bodies connected by elements and joints to each other, to `world` and to supports whose
    motion is imposed.

    Args:
        bodies: {name: body}
        supports: {name: support}
        elements: {name: element, or a ForceElement, which has no potential}
        joints: {name of the body that the joint carries: joint}; a body without a joint is free
        closures: {name: closure}, which close loops of joints: `jb.closures`
        controllers: {name: controller}, laws between sensors and actuators: `jb.control`
        gravity: [m/s2], in world axes
        energies: {name: V(frames) [J]}, each an equinox.Module, whose numbers have paths, or a
            function. `frames["body"]` is a pose with p, R and point(x), of a body, a support or
            the world
        dissipations: {name: R(frames) [W]}, likewise, of frames with v, w and velocity(x) besides

    `model["AB"]` is the element, body, support or closure of that name, `model.joint("arm")` a
    body's joint, `model.reference` the state at rest in the reference pose: as drawn (with the
    position and orientation given for each body) or, where closures are open as drawn, assembled by
    the least movement. A derivative with respect to a model is a model. All problems of an input
    are reported in one error.

    >>> model = jb.Model(
    ...     bodies={"plate": jb.Body(mass=3.0, inertia=[0.3, 0.9, 1.2])},
    ...     elements={
    ...         "AB": jb.Spring(
    ...             ("plate", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=100.0, free_length=0.8
    ...         )
    ...     },
    ... )
    >>> float(model["AB"].stiffness)
    100.0
    """

    bodies: KindTable
    supports: KindTable
    joints: tuple[KindTable, ...]
    elements: tuple[KindTable, ...]
    forces: tuple[KindTable, ...]  # of elements without a potential
    closures: tuple[KindTable, ...]
    layout: Layout = eqx.field(static=True)
    # speeds that closures leave free, in the reference pose; None if traced
    independent: tuple[int, ...] | None = eqx.field(static=True)
    gravity: Float[Array, "3"] = field("m/s2")

    def __init__(
        self,
        *,
        bodies: dict[str, Body],
        supports: dict[str, Support] | None = None,
        elements: Mapping[str, Element | ForceElement] | None = None,
        joints: dict[str, Joint] | None = None,
        closures: dict[str, Closure] | None = None,
        controllers: dict[str, Controller] | None = None,
        gravity=(0, 0, 0),
        energies: dict[str, Any] | None = None,
        dissipations: dict[str, Any] | None = None,
    ):
        given = {
            "bodies": (bodies, "name: jb.Body(...)"),
            "supports": (supports, "name: jb.Support(...)"),
            "elements": (elements, "name: jb.Spring(...)"),
            "joints": (joints, "name: jb.Hinge(...)"),
            "closures": (closures, "name: jb.closures.Ball(...)"),
            "controllers": (controllers, "name: jb.Controller(...)"),
            "energies": (energies, "name: a function of frames"),
            "dissipations": (dissipations, "name: a function of frames"),
        }
        with Problems() as problems:
            parts = {
                group: checked_dict(things, group, example, problems)
                for group, (things, example) in given.items()
            }
        # a joint has the name of its body
        check_names(problems, {group: parts[group] for group in parts if group != "joints"})
        groups = {
            group: of_kind(problems, group, parts[group], kind) for group, kind in KINDS.items()
        }
        bodies, supports, elements, joints, closures, controllers = groups.values()
        check_links(problems, bodies, supports, elements, joints, closures)
        gravity = vector(gravity, "gravity", problems)
        drawn = {WORLD: NOWHERE} | {
            name: (each.position, each.orientation) for name, each in (supports | bodies).items()
        }
        for name, element in elements.items():
            turns = (drawn.get(end, NOWHERE)[1] for end in element.between)
            elements[name] = functions_as_nodes(element).as_drawn(*turns)
            check_leaves(problems, f"elements[{name!r}]", elements[name])
        check_laws(problems, elements)
        forces = {name: x for name, x in elements.items() if isinstance(x, ForceElement)}
        elements = {name: x for name, x in elements.items() if name not in forces}
        check_drives(problems, controllers, forces)
        forces |= {name: functions_as_nodes(x) for name, x in controllers.items()}
        for group, kind in OWN_FUNCTIONS.items():
            elements |= own_functions(problems, group, kind, parts[group], drawn)
        check_reference(problems, drawn, {"elements": elements | forces, "closures": closures})
        problems.raise_if_any()
        joints = {name: joints.get(name, Free()) for name in bodies}
        parents = tuple(joint.parent for joint in joints.values())
        blocks = tuple(joint.block(name) for name, joint in joints.items())
        self.elements = tabulate_by_structure(elements)
        self.forces = tabulate_by_structure(forces)
        blocks += blocks_of(self.elements) + blocks_of_forces(self.forces)
        self.layout = Layout(tuple(bodies), tuple(supports), parents, blocks)
        depth = self.layout.depths.__getitem__
        self.bodies = tabulate(bodies)
        self.supports = tabulate(supports, Support())
        self.joints = tabulate_by_structure(
            {name: joints[name] for name in sorted(bodies, key=depth)}, depth
        )
        with Problems() as problems:
            closures = {
                name: functions_as_nodes(counted(problems, name, closure, self.layout))
                for name, closure in closures.items()
            }
            check_movable(problems, closures, self.layout)
        self.closures = tabulate_by_structure(closures)
        self.gravity = device_array(gravity)
        self.independent = None
        self.independent = independent_speeds(self)
        with Problems() as problems:
            for name, force in forces.items():
                group = "controllers" if name in controllers else "elements"
                check_force(problems, f"{group}[{name!r}]", force, self)
        warn_of_oddities(bodies, {k: x for k, x in (elements | forces).items() if x.between})
        warn_of_points(
            {
                name: body
                for name, body in bodies.items()
                if isinstance(joints[name], Free) and name not in parents
            }
        )

    @property
    def names(self) -> tuple[str, ...]:
        """All names of bodies, supports, elements, energies, dissipations and closures."""
        frames = self.layout.bodies + self.layout.supports
        forces = self.force_names + self.controller_names
        return frames + self.owner_names + forces + self.closure_names

    @property
    def element_names(self) -> tuple[str, ...]:
        return tuple(name for table in self.attached for name in table.names)

    @property
    def force_names(self) -> tuple[str, ...]:
        """The names of the elements without a potential."""
        controllers = self.controller_names
        return tuple(n for table in self.forces for n in table.names if n not in controllers)

    @property
    def controller_names(self) -> tuple[str, ...]:
        tables = [table for table in self.forces if isinstance(table.rows, Controller)]
        return tuple(name for table in tables for name in table.names)

    @property
    def energy_names(self) -> tuple[str, ...]:
        """The names of the energies and dissipations written by the user."""
        return tuple(name for table in self.elements[len(self.attached) :] for name in table.names)

    @property
    def owner_names(self) -> tuple[str, ...]:
        """The names of elements, energies and dissipations, in the order of their tables."""
        return tuple(name for table in self.elements for name in table.names)

    @property
    def attached(self) -> tuple[KindTable, ...]:
        """The tables of elements, without those of energies and dissipations written by the user,
        which come last."""
        return tuple(table for table in self.elements if not isinstance(table.rows, OfFrames))

    @property
    def closure_names(self) -> tuple[str, ...]:
        return tuple(name for table in self.closures for name in table.names)

    def __getitem__(self, name: str) -> Any:
        bodies = (self.bodies, self.supports)
        for tables_of_kind in (bodies, self.elements, self.forces, self.closures):
            for table in tables_of_kind:
                if name in table.names:
                    return unwrapped(table.row(name))
        raise JaxbodyError(unknown(name, "model[...]", self.names))

    def joint(self, body: str) -> Joint:
        """Return the joint that carries a body."""
        for table in self.joints:
            if body in table.names:
                return table.row(body)
        raise JaxbodyError(unknown(body, "model.joint(...)", self.layout.bodies))

    def parts(self) -> dict[str, Any]:
        """Return the arguments from which this model can be built again."""
        names: dict[str, Any] = {
            group: [
                n for table in self.elements if isinstance(table.rows, kind) for n in table.names
            ]
            for group, kind in OWN_FUNCTIONS.items()
        }
        names |= {
            "bodies": self.layout.bodies,
            "supports": self.layout.supports,
            "elements": self.element_names + self.force_names,
            "closures": self.closure_names,
            "controllers": self.controller_names,
        }
        parts = {group: {name: self[name] for name in each} for group, each in names.items()}
        joints = {name: self.joint(name) for name in self.layout.bodies}
        return {**parts, "joints": joints, "gravity": self.gravity}

    @property
    def reference(self) -> State:
        """The state of rest in the reference pose, with closures fulfilled and elements with memory
        relaxed."""
        refuse_batch(self, "model.reference")
        return handed_down("assembled_reference")(self) if self.closures else drawn_reference(self)

    def _tables(self) -> list[tables.PrintedTable]:
        layout = self.layout
        rows = [
            (
                name,
                layout.block(name).kind.__name__.lower(),
                parent,
                self[name].mass,
                self[name].position,
            )
            for name, parent in zip(layout.bodies, layout.parents, strict=True)
        ]
        shown = [
            tables.PrintedTable("Model", ("body", "joint", "on", "mass [kg]", "position [m]"), rows)
        ]
        forces = (table for table in self.forces if not isinstance(table.rows, Controller))
        for table in (*self.elements, *forces):
            columns, kind = self._columns(table), type(self[table.names[0]]).__name__.lower()
            own = isinstance(table.rows, OfFrames)
            kind = "function" if kind == "partial" else kind
            rows = [
                (
                    name,
                    *((", ".join(table.rows.reads),) if own else link),
                    *(_cell(self[name], column) for column in columns),
                )
                for name, link in zip(table.names, table.links, strict=True)
            ]
            heads = ("of",) if own else ("from", "to", "on")[: len(table.links[0])]
            heads = ("on",) if len(table.links[0]) == 1 else heads
            shown.append(tables.PrintedTable("", (kind, *heads, *columns.values()), rows))
        rows = [
            (n, type(t.rows).__name__.lower(), *link)
            for t in self.closures
            for n, link in zip(t.names, t.links, strict=True)
        ]
        closures = tables.PrintedTable("", ("closure", "kind", "from", "to"), rows)
        rows = [
            (n, ", ".join(x.order), ", ".join(x.drives), type(x.law).__name__, x.every)
            for n, x in ((name, self[name]) for name in self.controller_names)
        ]
        heads = ("controller", "reads", "drives", "law", "every [s]")
        controllers = tables.PrintedTable("", heads, rows)
        return [*shown, *(table for table in (closures, controllers) if table.rows)]

    def _columns(self, table: KindTable) -> dict[str, str]:
        """Return the fields of elements that are printed, with their column headings: laws, numbers
        and matrices of coefficients, but no points and directions."""
        row, heads, batch = self[table.names[0]], {}, self.gravity.ndim - 1
        for name in getattr(row, "__dataclass_fields__", ()):
            value: Any = getattr(row, name, None)
            kind = kind_of(row, name)
            shape = np.shape(value)[batch:] if hasattr(value, "ndim") else None
            if (
                isinstance(value, Law)
                or shape == ()
                or (shape and kind.domain in ("definite", "symmetric"))
            ):
                units = set(units_of(kind, shape)) if shape is not None else {""}
                heads[name] = name.replace("_", " ") + (
                    f" [{unit}]" if len(units) == 1 and (unit := units.pop()) else ""
                )
        return heads


def refuse_batch(model: Model, where: str) -> None:
    """Refuse a batch of models. Error: BAD_SHAPE."""
    if model.gravity.ndim > 1:
        raise JaxbodyError(
            Problem(
                "BAD_SHAPE",
                where,
                f"is a batch of {len(model.gravity)} models",
                np.shape(model.gravity),
                "one model",
                "Use jax.vmap; one of them is jax.tree.map(lambda x: x[0], models).",
            )
        )


def _cell(part: Any, name: str) -> Any:
    """Return a number, whose unit is in the heading, or the text of a law with its numbers and
    units."""
    value = getattr(part, name)
    return text_of(part, name) if isinstance(value, Law) else value


@program
def drawn_reference(model: Model) -> State:
    """Return the state of rest in the reference pose as drawn."""
    return Coordinates(model).reference


def pose_at_reference(model: Model, name: str) -> Pose:
    """Return the pose of a body, a support or the world in the reference pose."""
    if name == WORLD:
        dtype = model.gravity.dtype
        return Pose(jnp.zeros(3, dtype), jnp.eye(3, dtype=dtype))
    layout = model.layout
    is_support = name in layout.supports
    names, table = (
        (layout.supports, model.supports) if is_support else (layout.bodies, model.bodies)
    )
    poses, row = poses_of(table), names.index(name)
    return Pose(poses.p[row], poses.R[row])


def independent_speeds(model: Model) -> tuple[int, ...] | None:
    """Return the speeds that remain independent when those of the largest pivots follow from the
    closures: in the reference pose or, if that is drawn open and may be singular, such as with all
    links in line, in a pose displaced from it. Return None for a traced model."""
    nv = model.layout.nv
    if not model.closures:
        return tuple(range(nv))
    if not is_concrete(model):
        return None
    with jax.ensure_compile_time_eval():
        columns, open_ = _closure_slopes(model, jnp.zeros(nv, model.gravity.dtype))
        if open_ > CLOSED:
            columns, _ = _closure_slopes(
                model, DISPLACED * jnp.sin(1.0 + 2.4 * jnp.arange(nv, dtype=model.gravity.dtype))
            )
    check_slopes(model.closures, np.isfinite(columns).all(1))
    dependent = independent_rows(np.array(columns).T, enough=NEARLY_LARGEST)
    return tuple(i for i in range(nv) if i not in dependent)


@program
def _closure_slopes(
    model: Model, delta: Float[Array, "nv"]
) -> tuple[Float[Array, "n nv"], Float[Array, ""]]:
    """Return dc/dDelta of all closures, for increments in meters, in a pose displaced from the
    reference pose by `delta` in meters; and the largest |c| over the largest coordinate of a
    point."""
    layout, coordinates = model.layout, Coordinates(model)
    points = [jnp.ravel(x) for table in model.closures for x in table.rows.points]
    length = jnp.max(jnp.abs(jnp.concatenate(points)), initial=0.0)
    length = jnp.where(length > 0, length, 1.0)
    delta = delta * jnp.where(layout.turns, 1.0, length)
    q = coordinates.retract(coordinates_at_rest(model, coordinates.rest), delta)
    frames, axes = coordinates.frames_and_axes(
        q, jnp.zeros_like(delta), coordinates.supports.at_rest()
    )
    twists = jnp.concatenate(jacobian(layout, frames, *axes), -1)
    still = jnp.zeros((layout.first_body, *twists.shape[1:]), q.dtype)
    poses, twists = frames.pose(), jnp.concatenate([still, twists])
    drawn = coordinates.in_world

    def ends(table: KindTable):
        """Return the poses of both ends, their twists per unit of each speed, and the pose of the
        second end on the first as drawn."""
        if isinstance(table.rows, Coupling):
            rows = [layout.coordinate_places[path] for path in (table.rows.of, table.rows.by)]
            slides = [as_slide(jnp.broadcast_to(q[i], len(table))) for i, _ in rows]
            moving = [
                jnp.zeros((len(table), layout.nv, 6), q.dtype).at[:, j, 0].set(1.0) for _, j in rows
            ]
            return *slides, *moving, as_slide(jnp.zeros(len(table), q.dtype))
        A, B = end_rows(model, table)
        return poses[A], poses[B], twists[A], twists[B], drawn[A].inverse() @ drawn[B]

    def of(closure, A, B, twist_A, twist_B, rest):
        def gap(xi):
            return closure.gap(A.displaced(xi[0]), B.displaced(xi[1]), rest)

        zero = jnp.zeros((2, 6), q.dtype)
        slopes = jnp.einsum("nei,evi->nv", jax.jacfwd(gap)(zero), jnp.stack([twist_A, twist_B]))
        return slopes, gap(zero)

    slopes, gaps = [], []
    for table in model.closures:
        J, c = jax.vmap(of)(table.rows, *ends(table))
        turns = np.array([row.startswith("turn") for row in table.rows.rows])
        unit = jnp.where(turns, length, 1.0)
        slopes.append((J * unit[None, :, None]).reshape(-1, layout.nv))
        gaps.append((c * unit[None]).ravel())
    meters = jnp.where(layout.turns, 1 / length, 1.0)
    return (
        jnp.concatenate(slopes) * meters[None],
        jnp.max(jnp.abs(jnp.concatenate(gaps))) / length,
    )


# limits up to which a motion is not long: numbers of samples and of coordinates, duration [s]
FEW_SAMPLES, FEW_COORDINATES, SHORT = 1000, 6, 30.0
# distance, relative to the size, and angle [degrees] above which the frames of a mount differ
APART, TURNED = 0.05, 5.0


def size_of(model: Model, otherwise: Any = 1.0) -> Float[Array, ""]:
    """Return a length [m] that represents the size of a model: the largest distance of a point of
    attachment or a center of mass from the origin of its body; if that is zero, the largest
    distance from the world's origin; if that is zero too, `otherwise`."""
    # NumPy outside of compiled programs, so that nothing is compiled
    xp: Any = np if is_concrete(model) else jnp
    on_bodies, anywhere = (
        [np.zeros((1, 3), model.gravity.dtype), model.bodies.rows.com],
        [model.bodies.rows.position],
    )
    for table in (*model.elements, *model.closures):
        for end, points in enumerate(table.rows.points):
            on_body = np.array([link[end] in model.layout.bodies for link in table.links])
            on_bodies.append(xp.where(on_body[:, None], points, 0.0))
            anywhere.append(points)
    near, far = (
        xp.max(xp.sum(xp.concatenate(points) ** 2, -1)) for points in (on_bodies, anywhere)
    )
    return xp.asarray(
        xp.sqrt(xp.where(near > 0, near, xp.where(far > 0, far, otherwise**2)))
    )  # differentiable where all points lie at origins


def drawn_apart(model: Model) -> list[str]:
    """Return a description of each mount whose two frames are drawn apart or turned against each
    other, so that it pulls or twists as drawn, and of each torsion whose axes at its two ends
    differ."""
    bodies, supports = model.bodies.rows, model.supports.rows
    orientations = np.concatenate([[IDENTITY], supports.orientation, bodies.orientation])
    positions = np.concatenate([np.zeros((1, 3)), supports.position, bodies.position])
    rotations = map(matrix, orientations)
    poses = dict(zip(model.layout.frames, zip(positions, rotations, strict=True), strict=True))
    most, descriptions = APART * float(size_of(model)), []
    for table in model.elements:
        if not isinstance(table.rows, FramePair | Torsion):
            continue
        known = jax.tree.map(as_numpy, table)
        for name, ends in zip(table.names, table.links, strict=True):
            element, (p_A, R_A), (p_B, R_B) = known.row(name), *(poses[end] for end in ends)
            turn = R_A @ matrix(element.orientation) - R_B @ matrix(element.orientation_b)
            if isinstance(element, FramePair):
                what, sine = "is drawn", np.linalg.norm(turn) / 8**0.5
                apart = np.linalg.norm(p_B + R_B @ element.b - p_A - R_A @ element.a)
            else:
                what, sine = "has axes that are drawn", np.linalg.norm(turn @ element.axis) / 2
                apart = 0.0
            angle = 2 * np.rad2deg(np.arcsin(min(sine, 1.0)))
            faults = [f"{apart:.3g} m apart"] if apart > most else []
            if angle > TURNED:
                faults.append(f"turned by {angle:.3g} degrees between its ends")
            if faults:
                kind = type(element).__name__.lower()
                descriptions.append(f"{kind} '{name}' {what} {' and '.join(faults)}")
    return descriptions


def options_of_motion(model: Model, *times: Float[Array, "*nt"]) -> Options:
    """Return the compiler options for a simulation at these times [s]: OPTIMIZED for long ones;
    with closures or memory each step takes several times as long."""
    if times and (model.closures or model.layout.nz or not is_concrete(times)):
        return OPTIMIZED
    numbers = max(model.layout.nv, FEW_COORDINATES) * sum(t.size for t in times)
    many = numbers > FEW_SAMPLES * FEW_COORDINATES
    return OPTIMIZED if many or any(np.ptp(np.asarray(t)) > SHORT for t in times) else QUICK


def scale_of(model: Model, size: Float[Array, ""]) -> Float[Array, "nv"]:
    """Return Delta per scaled increment: 1 for translations, 1/size for rotations, so that all
    increments are in meters."""
    xp: Any = np if is_concrete(size) else jnp
    return xp.where(model.layout.turns, 1 / size, 1.0)


def scaled(A: Any, scale: Any) -> Any:
    """Return a matrix, or several, for scaled increments: A_ij scale_i scale_j."""
    return A * to_rank(scale[None] * scale[:, None], A.ndim)
