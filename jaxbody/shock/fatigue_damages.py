"""Fatigue damage by Miner's sum: from spectral densities, and from records by counting
rainflow cycles.

With an S-N curve N(S) = N0 (S0/S)^k of ranges S, moments m_j = int f^j S(f) df of the density, and
E[Z^k] of Z = S/(2 sqrt(m_0)),

    damage = T rate (2 sqrt(m_0)/S0)^k E[Z^k]/N0

    narrow band   rate sqrt(m_2/m_0), upward zero crossings; E[Z^k] = 2^(k/2) Gamma(1 + k/2)
    Dirlik        rate sqrt(m_4/m_2), peaks;
                  E[Z^k] = D1 Q^k Gamma(1 + k) + 2^(k/2) Gamma(1 + k/2) (D2 |R|^k + D3)
    rainflow      of a record, sum of counts over N(S)

Source: T. Dirlik, Application of computers in fatigue analysis, thesis, University of Warwick
(1985); ASTM E1049-85 (2017), 5.4.4.
"""

from typing import Any

import jax
import jax.numpy as jnp
import jax.scipy.special
import numpy as np
from equinox import Module, field

from jaxbody.core import tables, units
from jaxbody.core.arguments import check_one_of, checked_dict, positive_number
from jaxbody.core.arrays import Array, Float, Int, device_array, is_concrete
from jaxbody.core.compilation.compile_options import program
from jaxbody.core.errors import JaxbodyError, Problem, Problems, Status, import_extra, unknown
from jaxbody.core.results import OfOutputs, warn_if_failed
from jaxbody.records.records import Record
from jaxbody.shock.peak_factors import moments
from jaxbody.vibration.random_responses import RandomResponse

RANGES = {"range": 1.0, "amplitude": 2.0}  # ratio of a range to the level that a curve states


class SNCurve(Module):
    """An S-N curve: N(S) = cycles (level/S)^exponent cycles of the range S until failure.

    Args:
        exponent: k, such as 3 for welds or 5 to 10 for machined parts and rubber
        cycles: N0, the number of cycles until failure at the range S0
        level: S0 [unit]
        unit: unit of S0, which is that of the output or channel, such as "MPa", "N" or "mm"
        of: whether S0 is a "range", from valley to peak (default), or an "amplitude", half of it

    Errors: NO_UNIT, UNKNOWN_UNIT, BAD_NUMBER, BAD_OPTION.

    >>> weld = jb.shock.SNCurve(3.0, cycles=2e6, level=71.0, unit="MPa")
    >>> round(float(weld.endured(142e6)))
    250000
    """

    exponent: Float[Array, ""]
    cycles: Float[Array, ""]
    level: Float[Array, ""]  # of ranges, in SI units
    unit: str = field(static=True)  # SI

    def __init__(self, exponent, *, cycles, level, unit: str | None = None, of: str = "range"):
        with Problems() as problems:
            given = {"exponent": exponent, "cycles": cycles, "level": level}
            numbers = [
                positive_number(value, f"SNCurve.{name}", problems) for name, value in given.items()
            ]
            check_one_of(of, RANGES, "BAD_OPTION", "SNCurve.of", problems)
            if unit is None:
                problems.add(
                    "NO_UNIT",
                    "SNCurve.unit",
                    "is missing",
                    limit='such as "MPa", "N" or "mm"',
                    hint='Write unit="MPa", or the unit of the output.',
                )
            stated = (
                None if unit is None else problems.gather(lambda: units.parse(unit, "SNCurve.unit"))
            )
        assert stated is not None
        self.exponent, self.cycles, level = map(device_array, numbers)
        self.level, self.unit = level * (stated.factor * RANGES[of]), stated.si

    def endured(self, ranges: Any) -> Float[Array, "*n"]:
        """Return the number of cycles until failure at these ranges [SI unit]."""
        return self.cycles * (self.level / jnp.asarray(ranges)) ** self.exponent


class FatigueDamage(OfOutputs):
    """Fatigue damage of outputs by Miner's rule. `damage` of each output in `duration` [s]; an
    output fails when its damage reaches 1, after `life` [s]. `damage["anchor"]` is the damage of
    one output. `cycles`: number of cycles in the duration, counted or expected; `range` [unit]: the
    constant range that does the same damage in as many cycles."""

    index, main, word = "output", "damage", "damage"
    damage: Float[Array, "ny"]
    life: Float[Array, "ny"]
    cycles: Float[Array, "ny"]
    range: Float[Array, "ny"]
    duration: Float[Array, ""]
    status: Int[Array, ""]
    method: str = field(static=True)

    def to_xarray(self) -> Any:
        """Return an xarray.Dataset of all numbers by output."""
        units = {"damage": "", "life": "s", "cycles": "", "range": "unit"}
        return self.labeled(
            f"fatigue damage, {self.method}",
            {name: (("output",), getattr(self, name), unit) for name, unit in units.items()},
        )

    @tables.summarized("Fatigue damage", 1, damage="damage")
    def _tables(self) -> list[tables.PrintedTable]:
        columns = {
            "output": self.outputs,
            "damage": self.damage,
            "life [h]": np.asarray(self.life) / 3600,
            "cycles": self.cycles,
            "equivalent range": self.range,
            "unit": self.units,
        }
        return [
            tables.PrintedTable(
                f"Fatigue damage in {tables.number(self.duration)} s, {self.method}",
                tuple(columns),
                [*zip(*columns.values(), strict=True)],
                self.failure,
            )
        ]


def fatigue_damage(
    source: RandomResponse | Record | dict[str, Any],
    curves: dict[str, SNCurve],
    *,
    duration: Any = None,
    method: str | None = None,
) -> FatigueDamage:
    """Compute the fatigue damage of outputs of a random response, or of channels of a record.

    The damage of a response is differentiable with respect to the model, the spectra and the
    curves. Counting of rainflow cycles has no derivative. Half cycles count half.

    Args:
        source: a result of `random_response`, whose band contains all frequencies that contribute
            to the damage, a Record, or {channel: (values, unit)} of the whole duration, such as
            {"anchor": (run.forces["anchor"], "N")} of a simulation.
        curves: {output or channel: SNCurve}; the unit of a curve is that of the output, so that a
            force has a curve of forces; a gain of the sensor converts a force to a stress.
        duration: duration [s] of the response, or of a record that is repeated; default for a
            record its own duration.
        method: for a response "Dirlik" (default) or "narrow band", which is exact in the limit of
            a narrow band and otherwise too large; for a record "rainflow".

    Errors, all at once: WRONG_KIND, UNKNOWN_NAME, BAD_UNIT, BAD_NUMBER, BAD_OPTION, GAPS, TRACED
    for values inside jit or grad, MISSING_EXTRA for the package rainflow, pip install
    'jaxbody[fatigue]'; warns NONFINITE.

    >>> car = jb.presets.quarter_car(damping=1500.0)
    >>> ride = jb.random_response(
    ...     jb.linearize(car, car.reference),
    ...     jb.vibration.Band(0.1, 50.0),
    ...     {"road": jb.BaseMotion("road", "z")},
    ...     {"spring": jb.sensors.LoadCell("suspension")},
    ...     {"road": jb.vibration.RoadRoughness.iso("C").at_speed(20.0)},
    ... )
    >>> curve = jb.shock.SNCurve(5.0, cycles=1e6, level=4.0, unit="kN")
    >>> damage = jb.shock.fatigue_damage(ride, {"spring": curve}, duration=3600.0)
    >>> bool(
    ...     damage["spring"]
    ...     < jb.shock.fatigue_damage(
    ...         ride, {"spring": curve}, duration=3600.0, method="narrow band"
    ...     )["spring"]
    ... )
    True
    """
    source = _as_record(source, duration) if isinstance(source, dict) else source
    counted = isinstance(source, Record)
    if not counted and not isinstance(source, RandomResponse):
        raise JaxbodyError(
            Problem(
                "WRONG_KIND",
                "fatigue_damage.source",
                f"is a {type(source).__name__}",
                source,
                "a RandomResponse or a Record",
                "Give the result of random_response, or "
                'jb.Record(times, {"anchor": (values, "N")}).',
            )
        )
    method = method or ("rainflow" if counted else "Dirlik")
    with Problems() as problems:
        check_one_of(
            method,
            ("rainflow",) if counted else ("Dirlik", "narrow band"),
            "BAD_OPTION",
            "fatigue_damage.method",
            problems,
        )
        if not counted and duration is None:
            problems.add(
                "BAD_NUMBER", "fatigue_damage.duration", "is missing", limit="seconds, > 0"
            )
        T = (
            None
            if duration is None
            else positive_number(duration, "fatigue_damage.duration", problems)
        )
        given = checked_dict(curves, "fatigue_damage.curves", "output: SNCurve", problems)
        stated = source.units if counted else dict(zip(source.outputs, source.units, strict=True))
        _check_curves(given, stated, counted, problems)
    if isinstance(source, Record):
        arrays = _counted(source, given, T)
    else:
        rows = np.array([source.outputs.index(name) for name in given], int)
        arrays = _expected(source, rows, tuple(given.values()), device_array(T), method)
    units = tuple(stated[name] for name in given)
    return warn_if_failed(FatigueDamage(*arrays, method, outputs=tuple(given), units=units))  # pyright: ignore[reportCallIssue]


def _as_record(channels: dict[str, Any], duration: Any) -> Record:
    """Return channels {name: (values, unit)} of a known duration [s] as a record. Errors: TRACED,
    BAD_NUMBER and those of Record."""
    if not is_concrete(channels):
        raise JaxbodyError(
            Problem(
                "TRACED",
                "fatigue_damage.source",
                "is traced: counting of rainflow cycles has no derivative",
                hint="Count outside of jit and grad, or take the damage of a RandomResponse by "
                "Dirlik's method, which has derivatives.",
            )
        )
    with Problems() as problems:
        T = positive_number(duration, "fatigue_damage.duration", problems)
        first = next(iter(channels.values()), None)
        n = len(first[0]) if isinstance(first, tuple) and np.ndim(first[0]) else 0
        if T is None or n < 2:
            problems.add(
                "NO_DATA",
                "fatigue_damage.source",
                "has no samples",
                value=channels,
                limit="{channel: (values, unit)}",
            )
    return Record(np.linspace(0.0, float(np.asarray(T)), n), channels)


def _check_curves(
    given: dict[str, Any], stated: dict[str, str], counted: bool, problems: Problems
) -> None:
    """Check that each output with a curve exists and has the unit of its curve. `stated`: {output:
    unit}; `counted`: whether the outputs are channels of a record."""
    if not given and not problems.collected:
        problems.add(
            "WRONG_KIND",
            "fatigue_damage.curves",
            "is empty",
            limit="{output: SNCurve}",
            hint="Give a curve.",
        )
    for name, curve in given.items():
        where = f"fatigue_damage.curves[{name!r}]"
        if name not in stated:
            problems.collected.append(unknown(name, "fatigue_damage.curves", tuple(stated)))
        elif not isinstance(curve, SNCurve):
            problems.add(
                "WRONG_KIND",
                where,
                f"is a {type(curve).__name__}",
                value=curve,
                limit="an SNCurve",
                hint="Write SNCurve(...).",
            )
        elif curve.unit != stated[name]:
            problems.add(
                "BAD_UNIT",
                where,
                f"is of {curve.unit}, but the output is in {stated[name]}",
                value=curve.unit,
                limit=stated[name],
                hint="State the curve in this quantity, or give the sensor a gain, such as "
                "1/area for a stress.",
            )


@program
def _expected(
    response: RandomResponse,
    rows: Any,
    curves: tuple[SNCurve, ...],
    T: Float[Array, ""],
    method: str,
) -> tuple[Any, ...]:
    """Return damage, life, cycles, equivalent range, duration and status of outputs of a response,
    by the moments of f [Hz]. `rows`: indices of the outputs."""
    each = zip((0, 1, 2, 4), moments(response, 0, 1, 2, 4), strict=True)
    m0, m1, m2, m4 = ((x / (2 * jnp.pi) ** j)[..., rows] for j, x in each)
    k, cycles, level = (
        jnp.stack([getattr(curve, name) for curve in curves])
        for name in ("exponent", "cycles", "level")
    )
    rate = jnp.sqrt(m2 / m0) if method == "narrow band" else jnp.sqrt(m4 / m2)
    power = rayleigh(k) if method == "narrow band" else dirlik(m0, m1, m2, m4, k)
    count = T * rate
    damage = count * (2 * jnp.sqrt(m0) / level) ** k * power / cycles
    status = jnp.where(
        (response.status == Status.OK) & ~jnp.isfinite(damage).all(),
        Status.NONFINITE.value,
        response.status,
    )
    return damage, T / damage, count, level * (cycles * damage / count) ** (1 / k), T, status


def rayleigh(k: Float[Array, "*n"]) -> Float[Array, "*n"]:
    """Return E[Z^k] of a narrow band."""
    return 2 ** (k / 2) * jnp.exp(jax.scipy.special.gammaln(1 + k / 2))


def dirlik(m0, m1, m2, m4, k) -> Float[Array, "*n"]:
    """Return E[Z^k] of Dirlik's density of rainflow ranges: an exponential, a Rayleigh density with
    the parameter R, and the Rayleigh density of a narrow band. Arguments: moments m_0, m_1, m_2,
    m_4 and exponent k."""
    x, g = m1 / m0 * jnp.sqrt(m2 / m4), m2 / jnp.sqrt(m0 * m4)
    D1 = 2 * (x - g**2) / (1 + g**2)
    R = (g - x - D1**2) / (1 - g - D1 + D1**2)
    D2 = (1 - g - D1 + D1**2) / (1 - R)
    D3 = 1 - D1 - D2
    Q = 1.25 * (g - D3 - D2 * R) / D1
    return D1 * jnp.abs(Q) ** k * jnp.exp(jax.scipy.special.gammaln(1 + k)) + rayleigh(k) * (
        D2 * jnp.abs(R) ** k + D3
    )


def _counted(record: Record, curves: dict[str, SNCurve], duration: Any) -> tuple[Any, ...]:
    """Return the same numbers as `_expected` for channels of a record, by rainflow counting.
    `duration` [s]; None: that of the record."""
    rainflow = import_extra("rainflow", "fatigue_damage")
    with Problems() as problems:
        for name in curves:
            x = record[name]
            if x.ndim != 1:
                problems.add(
                    "BAD_SHAPE",
                    f"Record['{name}']",
                    f"has {x.shape[1]} columns",
                    value=x.shape,
                    limit="one column",
                    hint="Make each a channel.",
                )
            elif np.isnan(x).any():
                problems.add(
                    "GAPS",
                    f"Record['{name}']",
                    "has gaps",
                    value=x.shape,
                    limit="one column",
                    hint="Fill them, or take a part without gaps.",
                )
    length = float(record.times[-1] - record.times[0])
    T = length if duration is None else duration
    times, rows = float(np.asarray(T)) / length, []
    for name, curve in curves.items():
        ranges, _, counts, _, _ = (
            np.array(list(rainflow.extract_cycles(record[name])), float).reshape(-1, 5).T
        )
        used = ranges > 0
        cycles = times * counts.sum()
        damage = times * float(np.sum(counts[used] / np.asarray(curve.endured(ranges[used]))))
        k, level, base = (float(x) for x in (curve.exponent, curve.level, curve.cycles))
        rows.append(
            (
                damage,
                T / damage if damage else np.inf,
                cycles,
                level * (base * damage / max(cycles, 1e-300)) ** (1 / k),
            )
        )
    columns = (jnp.asarray(column, float) for column in zip(*rows, strict=True))
    return *columns, device_array(T), jnp.array(Status.OK.value)
