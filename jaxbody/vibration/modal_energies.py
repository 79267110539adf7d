"""Shares in the energy of each mode, in percent: kinetic by body and direction, strain by element,
dissipation by damper."""

from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from equinox import field

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Float, Int, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Problems
from jaxbody.core.results import Labeled, Result, dataset, warn_if_failed
from jaxbody.mechanics.hessians import Configuration, configuration_at, element_derivatives
from jaxbody.mechanics.internal_coordinates import inner_rows
from jaxbody.model.joints.frame_tables import inertial_tables, of_table
from jaxbody.model.joints.kinematics import Coordinates
from jaxbody.model.models import Model
from jaxbody.numerics.eigenproblems import ZERO, averaged, natural, refused_in_clusters
from jaxbody.vibration.linearizations import Linearization, check_system
from jaxbody.vibration.mode_names import AXES, direction_names, mark_note, mode_names, upward_axis
from jaxbody.vibration.natural_modes import modes_of, without_inner_rows

LEAST_LOSS = 1e-12  # relative to the largest loss of a mode, below which a mode has no dissipation
SEPARATION = 1e-8  # relative, of coinciding modes: above rounding, below the tolerance of clusters
MOST_MODES = 12  # in a table


class ModeEnergies(Labeled, Result):
    """Shares of the energies of each mode in percent, a column for each mode, by ascending
    frequency. Modes of coinciding frequencies each have the mean over the space of their shapes.

    `kinetic` {body: (6, n)}: translation of the center of mass and rotation, in world axes;
    `inertia` {name: (n,)}: of elements with inertia, such as inerters, and of coordinates of
    elements with mass, such as the fluid of a mount; the sum of both is 100. `strain` {element:
    (n,)}: V''(e) de de; with `other_strain`, {"tension", "gravity", "loads", "no potential"}, the
    contributions of tension, weights, loads and force elements to K, the sum is 100 (NaN for a mode
    of zero frequency). `dissipation` {element: (n,)}: the sum is 100, or 0 without dissipation;
    that of force elements is not part of it. `velocities` (bodies,
    6, n): velocities of the centers of mass and angular velocities, along the shape. `names`: each
    mode by the body and direction with most of the bodies' kinetic energy."""

    index = "mode"
    frequency: Float[Array, "n"]
    kinetic_shares: Float[Array, "nb 6 n"]
    inertia_shares: Float[Array, "ni n"]
    strain_shares: Float[Array, "ne n"]
    other_shares: Float[Array, "4 n"]
    dissipation_shares: Float[Array, "ne n"]
    velocities: Float[Array, "nb 6 n"]
    cluster: Int[Array, "n"]
    status: Int[Array, ""]
    model: Model
    directions: tuple[str, ...] = field(static=True)

    @property
    def kinetic(self) -> dict[str, Float[Array, "6 n"]]:
        return {
            name: self.kinetic_shares[..., i, :, :]
            for i, name in enumerate(self.model.layout.bodies)
        }

    @property
    def inertia(self) -> dict[str, Float[Array, "n"]]:
        layout = self.model.layout
        names = (
            *(name for table in inertial_tables(self.model) for name in table.names),
            *layout.inner[: len(layout.inertial)],
        )
        return {name: self.inertia_shares[..., i, :] for i, name in enumerate(names)}

    @property
    def owners(self) -> tuple[str, ...]:
        """The names of elements and of the user's own energies, in the order of strain and
        dissipation."""
        return self.model.owner_names

    @property
    def strain(self) -> dict[str, Float[Array, "n"]]:
        return {name: self.strain_shares[..., i, :] for i, name in enumerate(self.owners)}

    @property
    def other_strain(self) -> dict[str, Float[Array, "n"]]:
        return {name: self.other_shares[..., i, :] for i, name in enumerate(OTHERS)}

    @property
    def dissipation(self) -> dict[str, Float[Array, "n"]]:
        return {name: self.dissipation_shares[..., i, :] for i, name in enumerate(self.owners)}

    @property
    def rows(self) -> tuple[str, ...]:
        """Body and direction of each row of kinetic energy."""
        return tuple(
            f"{body} {direction}"
            for body in self.model.layout.bodies
            for direction in self.directions
        )

    @property
    def names(self) -> tuple[str, ...]:
        """Names of the modes: the body and direction with most of the kinetic energy, without that
        of inerters, and its share; several bodies if they share it, in phase or in opposition; or
        the coordinate of an element with mass, if its share is larger. "~" marks frequencies that
        nearly coincide."""
        shares, layout = np.asarray(self.kinetic_shares), self.model.layout
        inner = {
            name: np.asarray(self.inertia[name]) for name in layout.inner[: len(layout.inertial)]
        }
        if self.inertia:
            total = shares.sum((0, 1)) + sum(inner.values())
            shares, inner = (
                100 * shares / total,
                {name: 100 * x / total for name, x in inner.items()},
            )
        return mode_names(
            layout.bodies,
            self.directions,
            shares,
            self.velocities,
            self.cluster,
            self.frequency,
            inner,
        )

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset: shares [%] by mode, body and direction, element."""
        variables = {
            "frequency": (("mode",), self.frequency, "Hz"),
            "kinetic": (("body", "direction", "mode"), self.kinetic_shares, "%"),
            "strain": (("element", "mode"), self.strain_shares, "%"),
            "other_strain": (("other", "mode"), self.other_shares, "%"),
            "dissipation": (("element", "mode"), self.dissipation_shares, "%"),
            "status": ((), self.status, ""),
        }
        coordinates = {
            "mode": list(range(1, 1 + np.shape(self.frequency)[-1])),
            "body": list(self.model.layout.bodies),
            "direction": list(self.directions),
            "element": list(self.owners),
            "other": list(OTHERS),
        }
        if self.inertia:
            variables["inertia"] = (("inertial_element", "mode"), self.inertia_shares, "%")
            coordinates["inertial_element"] = list(self.inertia)
        return dataset(variables, coordinates, "energies of modes")

    def _tables(self) -> list[tables.PrintedTable]:
        count = self.frequency.shape[-1]
        if self.frequency.ndim > 1 or not is_concrete(self.frequency) or count > MOST_MODES:
            return [
                tables.PrintedTable(
                    "Energies of modes [%]",
                    ("", ""),
                    [("kinetic", self.kinetic_shares), ("strain", self.strain_shares)],
                )
            ]
        heads = tuple(f"{f:.4g} Hz" for f in self.frequency)
        parts = {
            "Kinetic energy [%]": dict(
                zip(self.rows, self.kinetic_shares.reshape(-1, count), strict=True)
            )
            | self.inertia,
            "Strain energy [%]": self.strain
            | {name: x for name, x in self.other_strain.items() if np.abs(x).max() > 1e-6},
            "Dissipation [%]": {name: x for name, x in self.dissipation.items() if np.any(x > 0)},
        }
        shown = [
            tables.PrintedTable(
                title,
                ("", *heads),
                [
                    (name, *(f"{round(float(x), 2) + 0.0:.2f}" for x in row))
                    for name, row in rows.items()
                    if not np.max(np.abs(row)) < 0.005
                ],
            )
            for title, rows in parts.items()
            if rows
        ]
        names = [f"{i + 1}: {name}" for i, name in enumerate(self.names)]
        forces = self.model.force_names
        without = f"no potential: {', '.join(forces)}, whose damping is left out" * bool(forces)
        notes = [*names, without, self.failure, mark_note(self.names)]
        shown[-1].note = "; ".join(filter(None, notes))
        return shown


OTHERS = ("tension", "gravity", "loads", "no potential")


def mode_energies(
    lin: Linearization,
    *,
    forward: str | None = None,
    up: str | None = None,
    stiffness: str = "relaxed",
    allow_float32: bool = False,
) -> ModeEnergies:
    """Compute the shares of bodies, elements and dampers in the energies of each natural mode [%],
    in the order of `modes(lin)`.

        kinetic      100 v_i (M v)_i/(phi' M phi)     v: velocities of a body along phi, of its
                                                      center of mass and angular
        inertia      100 de' T'' de/(phi' M phi)      de: change of an element's deformation
                                                      along phi, or of its coordinates with mass
        strain       100 de' V'' de/(phi' K phi)
        dissipation  100 de' R'' de/(phi' C phi)

    Args:
        lin: `linearize(model, equilibrium(model))`; the modes are computed from it.
        forward: the forward world axis, such as "x", for the names fore-aft, lateral, roll and
            pitch; by default these motions are named by their axes.
        up: the upward world axis, such as "z", for the names bounce and yaw; by default the axis
            opposite to gravity, if gravity is along a world axis.
        stiffness: stiffness of elements with memory, as in `modes`.
        allow_float32: True to compute in float32; by default that is an error.

    Where frequencies coincide, energies are averaged over the space of the shapes, because this
    average has derivatives and single shapes do not. Errors: WRONG_KIND, BAD_DIRECTION, FLOAT32
    unless `allow_float32`; warns as `modes` does.

    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     elements={
    ...         "s": jb.Spring(
    ...             ("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=50.0, free_length=1.0
    ...         )
    ...     },
    ... )
    >>> jb.vibration.mode_energies(jb.linearize(model, jb.equilibrium(model)), up="y").names
    ('mass bounce 100 %',)
    """
    check_system(lin, "mode_energies", allow_float32=allow_float32)
    directions = _directions(lin.model, forward, up)
    lin = without_inner_rows(lin, stiffness, "mode_energies")
    return warn_if_failed(ModeEnergies(*_energies(lin), model=lin.model, directions=directions))


def _directions(model: Model, forward: str | None, up: str | None) -> tuple[str, ...]:
    """Return the names of three translations and three rotations. Error: BAD_DIRECTION."""
    with Problems() as problems:
        for name, axis in (("forward", forward), ("up", up)):
            if axis is not None and axis not in AXES:
                problems.add(
                    "BAD_DIRECTION",
                    f"mode_energies.{name}",
                    f"is {axis!r}",
                    value=axis,
                    limit="x, y or z",
                    hint="Give one of the world axes.",
                )
        up = up or upward_axis(model)
        if forward is not None and up is None:
            problems.add(
                "BAD_DIRECTION",
                "mode_energies.up",
                "is missing, and gravity is not along an axis",
                hint="Give it, for example up='z'.",
            )
        if forward is not None and forward == up:
            problems.add(
                "BAD_DIRECTION",
                "mode_energies.forward",
                "is upwards",
                value=forward,
                limit="another axis than `up`",
            )
    return direction_names(model, forward, up)


@program
def _energies(lin: Linearization) -> tuple[Array, ...]:
    frequency, shapes, _, values, cluster, status = modes_of(lin)

    def share(part, whole, least):
        """Return part/whole in percent, averaged over clusters; zero where the whole is zero."""
        nonzero = jnp.broadcast_to(jnp.abs(whole) > least, part.shape)
        return (
            100
            * averaged(part, cluster)
            / jnp.where(nonzero, averaged(whole, cluster), 1.0)
            * nonzero.astype(part.dtype)
        )

    basis, nf, nv = lin.basis, len(lin.independent), lin.model.layout.nv
    whole = lin.expanded(shapes)
    moving = basis.velocities @ whole
    kinetic = moving * (basis.momenta @ whole)
    at = configuration_at(Coordinates(lin.held), lin.state.q, lin.state.v)
    elements = element_derivatives(at)
    changes = [x.J[..., :nv] @ whole[:nv] for x in elements]
    none = jnp.zeros((0, len(values)), shapes.dtype)
    inertial = jnp.concatenate([none, *_kinetic_energies(lin, whole[:nv])])
    elastic, loss = (
        jnp.concatenate(
            [none, *(jnp.sum(de * (H @ de), 1) for de, H in zip(changes, second, strict=True))]
        )
        for second in ([x.stiffness for x in elements], [x.damping for x in elements])
    )
    if len(whole) > nv:
        of_inner, (more_elastic, more_loss) = _energies_of_inner(at, whole)
        inertial, elastic, loss = (
            jnp.concatenate([inertial, of_inner]),
            elastic + more_elastic,
            loss + more_loss,
        )
    moved = jnp.sum(kinetic, (0, 1)) + jnp.sum(inertial, 0)
    gravity, loads, forces, tension = (
        jnp.sum(shapes[:nf] * (K @ shapes[:nf]), 0)
        for K in (
            lin.K_gravity,
            lin.K_loads,
            replace(lin, loads=()).K_loads,
            lin.K_closures + (lin.K_geometric if lin.model.forces and lin.model.elements else 0.0),
        )
    )
    strain, dissipated = jnp.sum(shapes * (lin.K @ shapes), 0), jnp.sum(loss, 0)
    loads, rest = loads - forces, strain - jnp.sum(elastic, 0) - gravity - loads + forces
    others = [tension, gravity, loads, rest - tension]  # with states of forces that follow
    others = jnp.stack(others if lin.model.forces else [rest, gravity, loads, forces])
    velocities = refused_in_clusters(moving.reshape(-1, len(values)), cluster).reshape(moving.shape)
    top = jnp.max(jnp.abs(values), initial=0.0)
    stiff = jnp.where(jnp.abs(values) > ZERO * top, 1.0, jnp.nan)[None]
    return (
        frequency,
        share(kinetic, moved, 0.0),
        share(inertial, moved, 0.0),
        share(elastic, strain, 0.0) * stiff,
        share(others, strain, 0.0) * stiff,
        share(loss, dissipated, LEAST_LOSS * jnp.max(jnp.abs(dissipated), initial=0.0)),
        velocities,
        cluster,
        status,
    )


def _energies_of_inner(at: Configuration, whole: Float[Array, "n m"]):
    """Return twice the kinetic energy of each coordinate of elements with mass along these shapes,
    and the contributions of the coordinates to V and R of all elements."""
    layout, rows = at.model.layout, inner_rows(at)
    x, y = whole[: layout.nv], whole[layout.nv :]
    k, n = len(y), layout.nv
    owners = [block.owner for block in layout.blocks for _ in block.states]
    names = at.model.owner_names
    of_elements = np.array(
        [[owners[i] == name for i in layout.inertial] for name in names], whole.dtype
    )
    added = [
        of_elements @ (y * (2 * H_yx[:k, :n] @ x + H_yy[:k, :k] @ y))
        for H_yx, H_yy in ((rows.K_yx, rows.K_yy), (rows.C_yx, rows.C_yy))
    ]
    return y * (rows.M_yy[:k, :k] @ y), added


def _kinetic_energies(
    lin: Linearization, shapes: Float[Array, "nv m"]
) -> list[Float[Array, "ne m"]]:
    """Return twice the kinetic energies of the elements with inertia along these shapes, one array
    for each table."""
    coordinates, tables = Coordinates(lin.held), inertial_tables(lin.held)

    def energies(v):
        frames = coordinates.at_rest(lin.state.q, v)
        return [
            2 * of_table(lin.held, frames, table, lambda s, *F: s.kinetic_energy(*s.rates(*F)))
            for table in tables
        ]

    return jax.vmap(energies, 1, 1)(shapes) if tables else []


def kinetic_shares(lin: Linearization) -> Float[Array, "m n"]:
    """Return shares, of sum 1, of bodies and directions (6 for each body) in the bodies' kinetic
    energy in each mode. Coinciding modes are separated along the coordinates by small increases of
    the diagonal of K, up to SEPARATION, different for each coordinate."""
    lin = lin.condensed
    increase = (
        SEPARATION * jnp.linspace(0.0, 1.0, len(lin.K)) * jax.lax.stop_gradient(jnp.diagonal(lin.K))
    )
    shapes = lin.expanded(natural(lin.K + jnp.diag(increase), lin.M)[1])
    basis = lin.basis
    kinetic = (basis.velocities @ shapes) * (basis.momenta @ shapes)
    kinetic = kinetic.reshape(-1, kinetic.shape[-1])
    if not (inertial_tables(lin.model) or lin.inner):
        return kinetic  # whose sum is phi' M phi = 1
    return kinetic / jnp.sum(kinetic, 0)[None]
