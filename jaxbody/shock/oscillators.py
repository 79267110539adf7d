"""Peaks and histories of oscillators by a recurrence that is exact for an acceleration in straight
lines between equally spaced samples.

With x'' + 2 zeta w x' + w^2 x = -a and the pole s = -zeta w + i w sqrt(1 - zeta^2), the complex
state r' = s r - c a gives

    Im(r) = x                     c = 1/Im(s)
            x'                    c = s/Im(s)
            x'' + a               c = s^2/Im(s)

and with any other complex c a linear combination of these. Over a step h, with z = s h,

    r_{k+1} = e^z r_k - c h ((phi1 - phi2) a_k + phi2 a_{k+1}),   phi1 = (e^z - 1)/z,
    phi2 = (e^z - 1 - z)/z^2

Source: N. C. Nigam, P. C. Jennings, Bull. Seismol. Soc. Am. 59 (1969) 909, who state this
recurrence for x and x'.
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Complex, Float, concrete
from jaxbody.core.compilation.compile_options import WIDE, program_with
from jaxbody.core.errors import Problems
from jaxbody.records.records import Record
from jaxbody.records.sampling_checks import even_samples


def checked_samples(
    record: Any, unit: str, where: str, problems: Problems
) -> tuple[Any, Any] | None:
    """Return the values of a record's only channel in `unit`, or of a pair (times, values), and the
    step between samples [s]; None, with a problem added, if they are invalid. Errors: WRONG_KIND,
    WRONG_DIMENSION, GAPS, NOT_UNIFORM, BAD_SHAPE, NON_FINITE."""
    known = len(problems.collected)
    if isinstance(record, Record):
        columns = [
            x for name, x in record.channels.items() if x.ndim == 1 and record.units[name] == unit
        ]
        if len(columns) != 1:
            listed = ", ".join(f"'{name}' [{of}]" for name, of in record.units.items())
            problems.add(
                "WRONG_DIMENSION",
                where,
                f"has {len(columns)} channels of one column in {unit}: {listed}",
                value=record.units,
                limit="one",
                hint="Choose one: (record.times, record['...']).",
            )
            return None
        record = record.times, columns[0]
    if not isinstance(record, tuple) or len(record) != 2:
        problems.add(
            "WRONG_KIND",
            where,
            f"is a {type(record).__name__}",
            value=record,
            limit="a Record with one acceleration, or (times, accelerations) [s, m/s2]",
        )
        return None
    gaps = concrete(record[1]) if hasattr(record[1], "dtype") else None
    if gaps is not None and gaps.dtype.kind == "f" and (count := int(np.isnan(gaps).sum())):
        problems.add(
            "GAPS",
            where,
            f"lacks {count} samples",
            value=count,
            limit="no gaps",
            hint='Read the record with fill="spline", or take a part without gaps.',
        )
        return None
    values, step = even_samples(*record, (f"{where} times", where), problems)
    return None if values is None or len(problems.collected) > known else (values, step)


SIDES = ("maximax", "positive", "negative")
UNROLLED = 4  # steps in one pass of the loop; on a CPU faster than 1, 2, 3, 6 and 8
SMALL = 0.5  # |z| below which the functions phi are power series
TERMS = 14
ROUNDING = 1e-9  # rounding error of a time, relative to the step
REFINED = 10  # steps of Newton's method, or halvings of a bracket
# relative differences up to which peaks count as equal: by rounding; between samples, of which one
# may be nearer to its peak than the other
EXACT, BETWEEN = 1e-9, 2e-3


class Peak(NamedTuple):
    """Peaks of the sampled responses, two for each oscillator: the first sample that differs from
    the largest by at most the fraction EXACT, and the first that differs by at most BETWEEN.
    `value`, index of the `sample`, and `state`: r less `c h phi2` times the acceleration there."""

    value: Float[Array, "2 n"]
    sample: Array
    state: Complex[jax.Array, "2 n"]


def poles(frequency: Float[Array, "n"], damping: Float[Array, "n"]) -> Complex[jax.Array, "n"]:
    """Return s = w (-zeta + i sqrt(1 - zeta^2)), w = 2 pi f."""
    w = 2 * jnp.pi * frequency
    return jax.lax.complex(-damping * w, w * jnp.sqrt(1 - damping**2))


def steps(
    s: Complex[jax.Array, "n"], c: Complex[jax.Array, "n"], h: Any
) -> tuple[Complex[jax.Array, "n"], ...]:
    """Return e^z, and the factors of a_k and a_{k+1} in a step h."""
    h = jnp.asarray(h).astype(s.dtype)
    z = s * h
    small = jnp.abs(z) < SMALL
    near, far = jnp.where(small, z, jnp.zeros_like(z)), jnp.where(small, jnp.ones_like(z), z)
    first, second = jnp.zeros_like(z), jnp.zeros_like(z)
    for k in range(TERMS, 0, -1):  # by Horner's rule, sum z^(k-1)/k! and sum z^(k-1)/(k + 1)!
        first, second = 1 + first * near / (k + 1), 1 + second * near / (k + 2)
    e = jnp.exp(far)
    phi1 = jnp.where(small, first, (e - 1) / far)
    phi2 = jnp.where(small, second / 2, (e - 1 - far) / far**2)
    return jnp.exp(z), -c * h * (phi1 - phi2), -c * h * phi2


def interpolated(a: Float[Array, "nt"], parts: int) -> Float[Array, "_"]:
    """Return the acceleration with samples on the straight lines added, `parts` in each step."""
    weights = jnp.arange(parts) / parts
    return jnp.append((a[:-1, None] + jnp.diff(a)[:, None] * weights[None]).ravel(), a[-1])


@program_with(WIDE)
def peaks(
    a: Float[Array, "nt"],
    h: Any,
    s: Complex[jax.Array, "n"],
    c: Complex[jax.Array, "n"],
    side: str,
    parts: int | None,
    r0: Any,
) -> tuple[Float[Array, "n"], Complex[jax.Array, "n"]]:
    """Return the largest |Im(r)|, Im(r) or -Im(r), by `side`, of oscillators with the state r0 at
    the first sample, and r at the last sample. Peaks are those at the samples if `parts` is None,
    otherwise those of the continuous response, by Newton's method from the largest of `parts`
    points in each step."""
    if parts is None:
        peak, end = _largest(a, h, s, c, side, r0)
        return peak.value[0], end
    a = interpolated(a, parts)
    peak, end = _largest(a, h / parts, s, c, side, r0, with_state=True)
    return _first_of_equal(a, h / parts, s, c, side, peak)[0], end


def free_peaks(
    r: Complex[jax.Array, "n"], s: Complex[jax.Array, "n"], side: str
) -> Float[Array, "n"]:
    """Return the largest |Im(r e^(s t))|, Im or -Im, by `side`, for t >= 0: that at t = 0, or at
    the first two times at which Im(s r e^(s t)) = 0. Derivatives treat the time of the peak as
    constant."""
    half = jax.lax.stop_gradient(jnp.pi / s.imag)
    first = jnp.mod(-jnp.angle(jax.lax.stop_gradient(s * r)), jnp.pi) * half / jnp.pi
    best = jnp.zeros_like(half)
    for t in (jnp.zeros_like(half), first, first + half):
        y = _signed(jnp.imag(r * jnp.exp(s * t.astype(s.dtype))), side)
        best = jnp.where(y > best * (1 + EXACT), y, best)
    return best


@program_with(WIDE)
def influences(
    a: Float[Array, "nt"],
    h: Any,
    s: Complex[jax.Array, "n"],
    c: Complex[jax.Array, "n"],
    parts: int,
):
    """Return continuous peaks of |Im(r)| and their derivatives (n, nt) with respect to the samples:
    the response at the time of the peak to the hat function of each sample."""
    n, fine = len(a), interpolated(a, parts)
    peak, _ = _largest(fine, h / parts, s, c, "maximax", jnp.zeros_like(s), with_state=True)
    value, time, sign = _first_of_equal(fine, h / parts, s, c, "maximax", peak)
    whole = jnp.clip(jnp.floor(time / h), 0, n - 2)
    k, late, part = whole.astype(int), time - whole * h, time / h - whole
    e, before, after = steps(s, c, h)
    _, first, last = steps(s, c, late)  # of a_k and a(time) in the last, shorter step
    # steps from each sample to the last before the peak
    left = (k[:, None] - jnp.arange(n)[None]).astype(late.dtype)
    decayed = jnp.exp(
        s[:, None] * jnp.where(left >= 0, left * h + late[:, None], 0.0).astype(s.dtype)
    )
    none, part = jnp.zeros_like(decayed), part.astype(s.dtype)
    inner = jnp.where(left > 0, (before / e)[:, None] * decayed, none)
    inner = inner + jnp.where(
        (left >= 0) & (jnp.arange(n) > 0)[None], after[:, None] * decayed, none
    )
    here, following = (left == 0).astype(s.dtype), (left == -1).astype(s.dtype)
    inner = inner + (first + last * (1 - part))[:, None] * here + (last * part)[:, None] * following
    return value, sign[:, None] * jnp.imag(inner)


@program_with(WIDE)
def history(
    a: Float[Array, "nt"], h: Any, s: Complex[jax.Array, "n"], c: Complex[jax.Array, "m n"]
) -> Float[Array, "nt m"]:
    """Return the sums over the oscillators of Im(c r) at the samples, with r the states for the
    weight c = 1."""
    e, before, after = steps(s, jnp.ones_like(s), h)
    drive, a = e * after + before, a.astype(s.dtype)

    def step(w, now):
        return e * w + drive * now, jnp.imag(c @ (w + after * now))

    return jax.lax.scan(step, -after * a[0], a, unroll=UNROLLED)[1]


def _signed(y: Array, side: str) -> Array:
    return jnp.abs(y) if side == "maximax" else y if side == "positive" else -y


def _largest(
    a, h, s, c, side: str, r0, with_state: bool = False
) -> tuple[Peak, Complex[jax.Array, "n"]]:
    """Return the peak at the samples, with its sample and state if `with_state`, and the state r at
    the last sample."""
    e, before, after = steps(s, c, h)
    drive = e * after + before  # factor of a in the step of w = r - after a
    er, ei, dr, di, own = e.real, e.imag, drive.real, drive.imag, after.imag
    start, zero = (
        (r0.real - after.real * a[0], r0.imag - own * a[0]),
        jnp.zeros((2 if with_state else 1, *er.shape), er.dtype),
    )
    places = (jnp.zeros(zero.shape, jnp.int32), zero, zero) if with_state else ()
    margins = 1 + jnp.array([EXACT, BETWEEN], er.dtype)[: len(zero), None]

    def step(carry, now):
        re, im, best, *place = carry
        y = _signed(im + own * now[0], side)[None]
        larger = y > best * margins
        if with_state:
            larger = larger | ((y > best) & (place[0] == now[1] - 1))  # on the way up
            place = [
                jnp.where(larger, new, old)
                for new, old in zip((now[1], re[None], im[None]), place, strict=True)
            ]
        return (
            er * re - ei * im + dr * now[0],
            er * im + ei * re + di * now[0],
            jnp.where(larger, y, best),
            *place,
        ), None

    rows = (a, jnp.arange(len(a), dtype=jnp.int32)) if with_state else (a,)
    at_last, _ = jax.lax.scan(
        step, (*start, zero, *places), jax.tree.map(lambda x: x[:-1], rows), unroll=UNROLLED
    )
    (_, _, best, *place), _ = step(at_last, tuple(x[-1] for x in rows))
    end = jax.lax.complex(*at_last[:2]) + after * a[-1].astype(s.dtype)
    peak = (
        Peak(best, place[0], jax.lax.complex(place[1], place[2]))
        if with_state
        else Peak(best, jnp.zeros(0), e[None, :0])
    )
    return peak, end


def _first_of_equal(
    a, h, s, c, side: str, peak: Peak
) -> tuple[Float[Array, "n"], Float[Array, "n"], Float[Array, "n"]]:
    """Return value, time and sign of the larger of the two peaks, or of the first one where they
    are equal: with any damping the first one is larger."""
    both = jax.vmap(lambda one: _refined(a, h, s, c, side, one))(peak)
    earlier = both[0][1] >= both[0][0] * (1 - EXACT)
    return tuple(jnp.where(earlier, x[1], x[0]) for x in both)  # pyright: ignore[reportReturnType]


def _refined(
    a, h, s, c, side: str, peak: Peak
) -> tuple[Float[Array, "n"], Float[Array, "n"], Float[Array, "n"]]:
    """Return the peak of the continuous response beside the sample, its time [s], and the sign of
    the response there.

    The peak is in the step into which the response grows, where its rate is zero: by Newton's
    method, or bisection where that leaves the bracket. Derivatives treat the time of the peak
    as constant, as the derivative of a maximum does not depend on that of its time."""
    k, h = peak.sample, jnp.asarray(h, a.dtype)
    now = a[k].astype(s.dtype)
    r = peak.state + steps(s, c, h)[2] * now
    sign = jnp.where(_signed(jnp.imag(r), side) == jnp.imag(r), 1.0, -1.0)
    ahead = jnp.where(sign * jnp.imag(s * r - c * now) > 0, 1, -1)
    other, onward = jnp.clip(k + ahead, 0, len(a) - 1), ahead.astype(a.dtype)
    slope = (a[other] - a[k]).astype(s.dtype) * (onward / h).astype(s.dtype)
    whole = c * now / s + c * slope / s**2

    def at(t):
        return (r - whole) * jnp.exp(s * t) + whole + c * slope * t / s

    def closer(bracket, _):
        low, high, t = bracket
        late = t.astype(s.dtype)
        rate = s * at(late) - c * (now + slope * late)
        grows = sign * onward * jnp.imag(rate) > 0
        low, high = jnp.where(grows, t, low), jnp.where(grows, high, t)
        curvature = jnp.imag(s * rate - c * slope)
        newton = t - jnp.imag(rate) / jnp.where(curvature == 0, 1.0, curvature)
        middle = (low + high) / 2
        inside = jnp.abs(newton - middle) <= jnp.abs(high - low) / 2 + ROUNDING * h
        return (low, high, jnp.where(inside, newton, middle)), None

    zero, end = jnp.zeros_like(onward), jnp.where(other == k, 0.0, onward * h)
    t = jax.lax.scan(closer, (zero, end, end / 2), None, length=REFINED)[0][2]
    t = jax.lax.stop_gradient(t)
    return _signed(jnp.imag(at(t.astype(s.dtype))), side), k.astype(a.dtype) * h + t, sign
