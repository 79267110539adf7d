"""Whether the numbers of a model and its records are of a size that their units make likely: millimeters for meters leave their traces."""

from __future__ import annotations

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxbody.core import tables
from jaxbody.core.compile_options import jit_unoptimized
from jaxbody.core.errors import Status, warn
from jaxbody.core.results import Result
from jaxbody.mechanics.energies import potential_energy
from jaxbody.mechanics.kinematics import retract
from jaxbody.models.models import Model
from jaxbody.models.preconditions import check_precision
from jaxbody.models.sizes import size_of
from jaxbody.models.states import State
from jaxbody.vibrations.linearizations import linearize

GYRATION = (0.02, 5.0)  # of the extent of what is attached
FREQUENCIES = (0.01, 1e5)  # Hz
SAG = (1e-9, 1.0)  # of the model's size
EARTH = (9.7, 9.9)  # m/s2
STEPS = (1e-6, 0.5)  # of the period of the first mode
NOTHING = 1e-9  # of the largest eigenvalue


class Plausibility(Result):
    """What `plausibility` saw: `numbers` {what: (value, unit, usual range)} and `words` on those outside."""

    status: Int[Array, ""]
    numbers: dict[str, tuple[float, str, str]] = eqx.field(static=True)
    words: tuple[str, ...] = eqx.field(static=True)

    def _tables(self) -> list[tables.PrintedTable]:
        rows = [(what, value, unit, usual) for what, (value, unit, usual) in self.numbers.items()]
        return [tables.PrintedTable("Plausibility", ("", "value", "", "usual"), rows, "\n".join(self.words) or "nothing to remark")]


def plausibility(model: Model, experiments: dict[str, Any] | None = None) -> Plausibility:
    """Numbers that a wrong unit moves far away, seen at the reference pose: radii of gyration against the points of attachment, of bodies that may turn
    (kg mm2, or an inertia about another point); the first natural frequency and the sag under gravity (N/mm, mm); gravity itself; the
    sampling step of `experiments` against the first frequency (ms).

    Warns GYRATION, FREQUENCY, SAG, GRAVITY (neither none nor 9.7 to 9.9 m/s2), TIME_UNIT. Errors: FLOAT32 and X64_CHANGED as elsewhere.

    >>> model = Model(bodies={"mass": Body(mass=2.0, inertia=[1, 1, 1])}, joints={"mass": Guide("world", axis=[0, 1, 0])},
    ...               elements={"s": Spring(("mass", [0, 0, 0]), ("world", [0, 1, 0]), stiffness=800.0, free_length=1.0)}, gravity=[0, -9.81, 0])
    >>> plausibility(model).words
    ()
    """
    check_precision("plausibility", model)
    numbers: dict[str, tuple[float, str, str]] = {}
    words: list[tuple[str, str]] = []

    def note(code: str, what: str, value: float, unit: str, usual: tuple[float, float], remark: str) -> None:
        numbers[what] = (value, unit, f"{usual[0]:g} to {usual[1]:g}")
        if not usual[0] <= value <= usual[1]:
            words.append((code, f"{what} is {value:.4g} {unit}".rstrip() + f", not {usual[0]:g} to {usual[1]:g}: {remark}"))

    for name, ratio in _gyrations(model).items():
        remark = "is the inertia in kg m2, about the centre of mass, and the points in meters?"
        note("GYRATION", f"radius of gyration of '{name}' over its extent", ratio, "", GYRATION, remark)
    first, sag = (float(x) for x in _scales(model, *_stiff(model)))
    if np.isfinite(first):
        remark = "are stiffnesses in N/m and masses in kg?"
        note("FREQUENCY", "first natural frequency", first, "Hz", FREQUENCIES, remark)
    g = float(np.linalg.norm(model.gravity))
    if g:
        note("GRAVITY", "gravity", g, "m/s2", EARTH, "is it in m/s2?")
    if np.isfinite(sag) and sag:
        note("SAG", "sag under gravity over the size of the model", sag, "", SAG, "are stiffnesses in N/m, points in meters?")
    for name, run in (experiments or {}).items():
        if np.isfinite(first) and len(np.atleast_1d(getattr(run, "times", ()))) > 1:
            share = first * float(np.median(np.diff(run.times)))
            note("TIME_UNIT", f"step of '{name}' over the first period", share, "", STEPS, "are its times in seconds?")
    for code, told in words:
        warn(code, told)
    return Plausibility(jnp.asarray(Status.OK), numbers, tuple(told for _, told in words))


def _gyrations(model: Model) -> dict[str, float]:
    """sqrt(largest moment/mass) over the farthest point of attachment from the centre of mass, of bodies that may turn."""
    found = {}
    for name, kind in zip(model.layout.bodies, model.layout.kinds, strict=True):
        body = model[name]
        reach = [0.0]
        for table in model.elements:
            for i, link in enumerate(table.links):
                points = [np.asarray(end[i]) for end, on in zip(table.rows.points, link, strict=True) if on == name]
                reach += [float(np.linalg.norm(point - body.com)) for point in points]
        if any(kind.turns) and max(reach) > 0:
            found[name] = float(np.sqrt(np.linalg.eigvalsh(body.inertia)[-1] / body.mass) / max(reach))
    return found


def first_frequency(model: Model) -> float:
    """The first natural frequency [Hz] at the reference pose; NaN where nothing resists."""
    return float(_scales(model, *_stiff(model))[0])


def _stiff(model: Model) -> tuple[Array, Array]:
    lin = linearize(model, model.reference)
    return lin.M, lin.K


@jit_unoptimized
def _scales(model: Model, M: Float[Array, "n n"], K: Float[Array, "n n"]) -> tuple[Array, Array]:
    """The first natural frequency that is not zero [Hz], of |eigenvalues|, and the largest static displacement under gravity of the modes that resist
    it, over the size; NaN where nothing resists."""
    state = model.reference
    weightless = eqx.tree_at(lambda m: m.gravity, model, jnp.zeros_like(model.gravity))

    def weight(delta):
        moved = State(retract(model, state.q, delta), state.v)
        return potential_energy(model, moved) - potential_energy(weightless, moved)

    force = -jax.grad(weight)(jnp.zeros(M.shape[0]))
    L = jnp.linalg.cholesky(M)
    reduced = jax.scipy.linalg.solve_triangular(L, jax.scipy.linalg.solve_triangular(L, K, lower=True).T, lower=True)
    squares, vectors = jnp.linalg.eigh((reduced + reduced.T) / 2)
    there = jnp.abs(squares) > NOTHING * jnp.max(jnp.abs(squares))
    first = jnp.sqrt(jnp.min(jnp.where(there, jnp.abs(squares), jnp.inf))) / (2 * jnp.pi)
    modal = vectors.T @ jax.scipy.linalg.solve_triangular(L, force, lower=True)
    moved = jax.scipy.linalg.solve_triangular(L.T, vectors @ jnp.where(there, modal / jnp.where(there, squares, 1.0), 0.0), lower=False)
    lengths = jnp.where(model.layout.turns, 0.0, jnp.abs(moved))
    return jnp.where(jnp.any(there), first, jnp.nan), jnp.where(jnp.any(there), jnp.max(lengths) / size_of(model), jnp.nan)
