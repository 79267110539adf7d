"""Plausibility checks: quantities that a wrong unit changes by orders of magnitude, such as
millimeters for meters; connected frames that are drawn apart; equilibria far from the drawn
pose."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core import tables
from jaxbody.core.arrays import Array, Int
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import Status, warn
from jaxbody.core.results import Result
from jaxbody.core.units import EARTH, GRAVITY
from jaxbody.lagrange import potential_energy
from jaxbody.mechanics.equilibria import equilibrium_of
from jaxbody.model.forces.controllers import sampled_names
from jaxbody.model.joints.kinematics import retract
from jaxbody.model.models import Model, drawn_apart, size_of
from jaxbody.model.preconditions import check_precision, unattached
from jaxbody.model.states import State
from jaxbody.numerics.eigenproblems import natural
from jaxbody.suspension.suspensions import Suspension
from jaxbody.vibration.linearizations import Linearization, linearize

# usual ranges
GYRATION = (0.02, 5.0)  # radius of gyration over the distance of the farthest attachment point
FREQUENCIES = (0.01, 1e5)  # first natural frequency [Hz]
SAG = (1e-9, 1.0)  # displacement under gravity over the size of the model
# SAG for the first mode of a model without gravity, which may be perpendicular to gravity
SOFT = (1e-9, 5.0)
DENSITY = (0.01, 1e5)  # mass of all bodies over the cube of the size of the model [kg/m3]
STEPS = (1e-6, 0.5)  # sampling step over the period of the first mode

MOST_STEPS = 200  # largest number of steps of the search for the equilibrium
ZERO = 1e-9  # eigenvalue relative to the largest that counts as zero


class Plausibility(Result):
    """Result of `plausibility`: `numbers` {quantity: (value, unit, usual range)}, and `words`,
    remarks on quantities outside their range."""

    status: Int[Array, ""]
    numbers: dict[str, tuple[float, str, str]] = eqx.field(static=True)
    words: tuple[str, ...] = eqx.field(static=True)

    def _tables(self) -> list[tables.PrintedTable]:
        return [
            tables.PrintedTable(
                "Plausibility",
                ("", "value", "unit", "usual"),
                [(quantity, *number) for quantity, number in self.numbers.items()],
                "\n".join(self.words) or "no remarks",
            )
        ]


def plausibility(
    model: Model | Suspension, experiments: dict[str, Any] | None = None
) -> Plausibility:
    """Compare quantities that a wrong unit changes by orders of magnitude with their usual ranges,
    at the reference pose or, with closures, at the nearest configuration that fulfills them.

    These are the radius of gyration of each body that can rotate, relative to its farthest
    attachment point (detects kg mm2, or an inertia about another point); the mass of all bodies
    over the cube of the size of the model (mm, g, t); the first natural frequency f and the sag
    under gravity (N/mm, mm), for a model without gravity the sag along its first mode under
    g = 9.81 m/s2, g/(2 pi f)^2; gravity itself; and the sampling step of `experiments` relative to
    the first natural period (ms).

    Also reported are mounts whose two frames are drawn more than a twentieth of the size apart, or
    turned by more than 5 degrees; torsions whose axes differ at the two ends; and an equilibrium
    more than 0.3 of the size or 30 degrees from the drawn pose, as for a pendulum that is drawn
    sideways.

    Warns GYRATION, DENSITY, FREQUENCY, SAG, GRAVITY (neither zero nor 9.7 to 9.9 m/s2), TIME_UNIT,
    DRAWN_APART, FAR_FROM_DRAWN, FLOAT32. Errors: X64_CHANGED.

    >>> spring = jb.Spring(
    ...     ("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=800.0, free_length=1.0
    ... )
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=2.0, inertia=[1, 1, 1])},
    ...     joints={"mass": jb.Guide("world", axis=[0, 1, 0])},
    ...     elements={"s": spring},
    ...     gravity=[0, -9.81, 0],
    ... )
    >>> jb.fitting.plausibility(model).words
    ()
    """
    model = model.model if isinstance(model, Suspension) else model
    check_precision("plausibility", model)
    numbers: dict[str, tuple[float, str, str]] = {}
    words: list[tuple[str, str]] = []

    def note(
        code: str, quantity: str, value: float, unit: str, usual: tuple[float, float], remark: str
    ) -> None:
        low, high = usual
        numbers[quantity] = (value, unit, f"{low:g} to {high:g}")
        if not low <= value <= high:
            stated = f"{quantity} is {value:.4g} {unit}".rstrip()
            around = f"{low:g} to {high:g} {unit}".rstrip()
            words.append((code, f"{stated}, not {around}: {remark}"))

    for name, ratio in _gyration_ratios(model).items():
        note(
            "GYRATION",
            f"radius of gyration of '{name}' over its extent",
            ratio,
            "",
            GYRATION,
            "is the inertia in kg m2, about the center of mass, and are the points in meters?",
        )
    size = float(size_of(model))
    note(
        "DENSITY",
        "mass over the cube of the size of the model",
        float(np.sum(model.bodies.rows.mass)) / size**3,
        "kg/m3",
        DENSITY,
        "are masses in kg and points in meters?",
    )
    first, sag = _scales_at_reference(model)
    if np.isfinite(first):
        note(
            "FREQUENCY",
            "first natural frequency",
            first,
            "Hz",
            FREQUENCIES,
            "are stiffnesses in N/m and masses in kg?",
        )
    g = float(np.linalg.norm(model.gravity))
    if g:
        note("GRAVITY", "gravity", g, "m/s2", EARTH, "is it in m/s2?")
    remark = "are stiffnesses in N/m and points in meters?"
    if np.isfinite(sag) and sag:
        note("SAG", "sag under gravity over the size of the model", sag, "", SAG, remark)
    if not g and first > 0:
        soft = GRAVITY / (2 * np.pi * first) ** 2 / size
        quantity = "sag along the first mode, were there gravity, over the size of the model"
        note("SAG", quantity, soft, "", SOFT, remark)
    for name, run in (experiments or {}).items():
        if np.isfinite(first) and len(np.atleast_1d(getattr(run, "times", ()))) > 1:
            note(
                "TIME_UNIT",
                f"step of '{name}' over the first period",
                first * float(np.median(np.diff(run.times))),
                "",
                STEPS,
                "are its times in seconds?",
            )
    words += [("DRAWN_APART", message) for message in drawn_apart(model)]
    if model.layout.nv and not unattached(model):
        far = equilibrium_of(model, None, MOST_STEPS, None).far
        words += [("FAR_FROM_DRAWN", message) for message in far]
    for code, message in words:
        warn(code, message)
    return Plausibility(jnp.asarray(Status.OK), numbers, tuple(message for _, message in words))


def _gyration_ratios(model: Model) -> dict[str, float]:
    """Return {body: sqrt(largest moment/mass) over the distance from its center of mass to its
    farthest attachment point} for bodies that can rotate."""
    ratios = {}
    for name in model.layout.bodies:
        body = model[name]
        reach = [0.0]
        for table in model.attached:
            for i, link in enumerate(table.links):
                points = [
                    np.asarray(end[i])
                    for end, on in zip(table.rows.points, link, strict=True)
                    if on == name
                ]
                reach += [float(np.linalg.norm(point - body.com)) for point in points]
        if model.layout.turns[model.layout.v_slices[name]].any() and max(reach) > 0:
            ratios[name] = float(
                np.sqrt(np.linalg.eigvalsh(body.inertia)[-1] / body.mass) / max(reach)
            )
    return ratios


def first_frequency(model: Model) -> float:
    """Return the lowest nonzero natural frequency [Hz] at the reference pose; NaN without
    stiffness."""
    return _scales_at_reference(model)[0]


def _scales_at_reference(model: Model) -> tuple[float, float]:
    """Return what `_scales` does; NaN for sampled controllers, which no linear system has."""
    if sampled_names(model):
        return np.nan, np.nan
    first, sag = _scales(linearize(model, model.reference))
    return float(first), float(sag)


@program
def _scales(lin: Linearization) -> tuple[Array, Array]:
    """Return the lowest nonzero natural frequency [Hz], from |eigenvalues|, and the largest static
    displacement under gravity of modes with stiffness, relative to the size of the model; NaN
    without stiffness."""
    model, state, (M, K) = lin.model, lin.state, lin.quasistatic
    moves = lin.expanded(jnp.eye(len(M), dtype=M.dtype))
    weightless = eqx.tree_at(lambda m: m.gravity, model, jnp.zeros_like(model.gravity))

    def weight(delta):
        moved = State(retract(model, state.q, moves @ delta), state.v, state.z)
        return potential_energy(model, moved) - potential_energy(weightless, moved)

    force = -jax.grad(weight)(jnp.zeros(M.shape[0]))
    squares, shapes = natural(K, M)
    stiff = jnp.abs(squares) > ZERO * jnp.max(jnp.abs(squares))
    first = jnp.sqrt(jnp.min(jnp.where(stiff, jnp.abs(squares), jnp.inf))) / (2 * jnp.pi)
    moved = shapes @ jnp.where(stiff, shapes.T @ force / jnp.where(stiff, squares, 1.0), 0.0)
    lengths = jnp.where(model.layout.turns, 0.0, jnp.abs(moves @ moved))
    return jnp.where(jnp.any(stiff), first, jnp.nan), jnp.where(
        jnp.any(stiff), jnp.max(lengths) / size_of(model), jnp.nan
    )
