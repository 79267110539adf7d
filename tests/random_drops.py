"""Random drops on contacts, bump stops and within clearances, and their motion phase by phase, with
every event at its own time.

A drop has one coordinate: the penetration d of the lower stop, -height at the start. Its force is
polynomial in d and d' on each phase (flight, engagement, full stiffness, a contact that would
pull), so that a Taylor series of high order gives the motion to rounding, and roots of this
polynomial the events. Nothing of jaxbody is used in `exact`.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field

import jax.numpy as jnp
import numpy as np
from scipy.optimize import brentq

import jaxbody as jb

G = 9.81
KINDS = ("contact", "stop", "gap")
# of turning points, of the height, and of energies that rise, of the energy of the fall
LIMIT = 1e-6
RTOL = 1e-9
SAMPLES = 320
ORDER = 30  # of the Taylor series
TURNS = 6
POINT = [1e-3, 1e-3, 1e-3]


@dataclass(frozen=True)
class Drop:
    """A `contact`: a body above it, whose damper acts only while it touches; a `stop`: a bump stop
    beside a damper and half of the time a soft spring; a `gap`: a body within a clearance between
    two stops, dropped or thrown up."""

    kind: str
    mass: float
    stiffness: float
    height: float  # above the lower stop
    engagement: float
    damping: float
    # soft spring beside the stop [N/m], whose force is zero `gap` above the stop
    spring: float = 0.0
    gap: float = 0.0
    clearance: float = np.inf
    speed: float = 0.0  # upward at the start
    room: float = 1.0  # from the deepest point on to where the ends of the stop meet, in heights

    def __str__(self):
        numbers = {
            name: value
            for name, value in vars(self).items()
            if name != "kind" and value != 0 and value != np.inf
        }
        return f"{self.kind}, " + ", ".join(
            f"{name} {value:.4g}" for name, value in numbers.items()
        )


def log_uniform(rng, low, high):
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def random_drop(seed: int, kind: str | None = None) -> Drop:
    """With masses of 1e-2 to 1e4 kg, stiffnesses of 1e2 to 1e9 N/m and heights of 1e-3 to 10 m;
    half have dampers. Stops that would sink by more than the height under the weight are drawn
    again: they are springs."""
    rng = np.random.default_rng([41, seed])
    kind = kind or KINDS[seed % len(KINDS)]
    while True:
        m, k, h = (
            log_uniform(rng, 1e-2, 1e4),
            log_uniform(rng, 1e2, 1e9),
            log_uniform(rng, 1e-3, 10.0),
        )
        if m * G / k <= h:
            break
    w = 1e-3 if rng.random() < 0.5 else log_uniform(rng, 1e-5, 1e-2)
    damped = rng.random() < 0.5
    ratio = log_uniform(rng, 0.01, 1.0)
    fall = np.sqrt(2 * h / G)
    if kind == "contact":
        return Drop(
            kind,
            m,
            k,
            h,
            w,
            float(damped * 2 * ratio * np.sqrt(k * m)),
            room=log_uniform(rng, 0.05, 2.0),
        )
    c = float(damped * ratio * min(2 * np.sqrt(k * m), m / fall))  # it acts in flight, too
    if kind == "stop":
        gap = h * log_uniform(rng, 0.1, 2.0)
        spring = log_uniform(rng, 1e-4, 0.5) * m * G / (h + gap) * (rng.random() < 0.5)
        return Drop(kind, m, k, h, w, c, spring=spring, gap=gap, room=log_uniform(rng, 0.05, 2.0))
    above = h * log_uniform(rng, 0.1, 1.0)  # up to the upper stop
    speed = float(np.sqrt(2 * G * above * rng.uniform(1.5, 4.0)))
    return Drop(
        kind,
        m,
        k,
        h,
        w,
        c,
        gap=h * rng.uniform(0.2, 1.0),
        clearance=h + above,
        speed=speed if rng.random() < 0.5 else 0.0,
    )


# The motion, phase by phase


@dataclass
class Motion:
    """Pieces (t, h, side, coefficients) of y(t): the penetration of the lower stop (side 0) or of
    the upper one (side 1)."""

    drop: Drop
    pieces: list = field(default_factory=list)
    turns: list = field(default_factory=list)  # (time, d)
    touches: list = field(default_factory=list)  # (first time, last time) of each contact

    @property
    def end(self):
        return self.pieces[-1][0] + self.pieces[-1][1]

    def at(self, times):
        """d and its rate."""
        starts = np.array([piece[0] for piece in self.pieces])
        out = np.empty((len(times), 2))
        for n, t in enumerate(times):
            start, _, side, c = self.pieces[
                max(int(np.searchsorted(starts, t, side="right")) - 1, 0)
            ]
            y, v = _value(c, t - start), _rate(c, t - start)
            out[n] = (y, v) if side == 0 else (-self.drop.clearance - y, -v)
        return out


def _value(c, t):
    return np.polynomial.polynomial.polyval(t, c)


def _rate(c, t):
    return np.polynomial.polynomial.polyval(t, c[1:] * np.arange(1, len(c)))


def _series(y, v, a0, a1, a2, b0, b1):
    """Taylor coefficients of y'' = a0 + a1 y + a2 y^2 + (b0 + b1 y) y'."""
    c = np.zeros(ORDER + 1)
    c[0], c[1] = y, v
    numbers = np.arange(1, ORDER + 1)
    for n in range(ORDER - 1):
        rates = c[1 : n + 2] * numbers[: n + 1]
        right = a1 * c[n] + b0 * rates[n] + (a0 if n == 0 else 0.0)
        right += a2 * np.dot(c[: n + 1], c[n::-1]) + b1 * np.dot(c[: n + 1], rates[::-1])
        c[n + 2] = right / ((n + 1) * (n + 2))
    return c


def _length(c, longest):
    """The step over which the last terms stay at rounding."""
    h = longest
    for n in (ORDER - 1, ORDER):
        if c[n] != 0:
            h = min(h, max((1e-17 * abs(c[i] / c[n])) ** (1 / (n - i)) for i in range(3)))
    return h


def _field(drop, side, phase):
    m, k, w, c = drop.mass, drop.stiffness, drop.engagement, drop.damping
    touching = drop.kind == "contact"
    a0 = G - drop.spring * drop.gap / m if side == 0 else -G
    a1, a2, b0, b1 = -drop.spring / m, 0.0, 0.0 if touching else -c / m, 0.0
    if phase == "engaging":
        a2 -= k / (2 * w * m)
        b1 -= c / (w * m) if touching else 0.0
    if phase == "deep":
        a0 += k * w / (2 * m)
        a1 -= k / m
        b0 -= c / m if touching else 0.0
    return a0, a1, a2, b0, b1


def _events(drop, side, phase):
    """Of a phase: (weights of y, y' and 1, direction of the crossing, next side and phase)."""
    k, w, c = drop.stiffness, drop.engagement, drop.damping
    # force of the contact over c_e/c: it never pulls
    pull = {"engaging": (k / 2, c, 0.0), "deep": (k, c, -k * w / 2)}
    clamps = drop.kind == "contact" and c > 0
    leave, rise, fall = (
        ((1.0, 0.0, 0.0), -1, side, "flight"),
        ((1.0, 0.0, -w), 1),
        ((1.0, 0.0, -w), -1),
    )
    if phase == "flight":
        return [((1.0, 0.0, 0.0), 1, side, "engaging")] + (
            [((1.0, 0.0, drop.clearance), -1, 1 - side, "engaging")]
            if np.isfinite(drop.clearance)
            else []
        )
    if phase == "engaging":
        return [leave, (*rise, side, "deep")] + (
            [(pull[phase], -1, side, "loose engaging")] if clamps else []
        )
    if phase == "deep":
        return [(*fall, side, "engaging")] + (
            [(pull[phase], -1, side, "loose deep")] if clamps else []
        )
    if phase == "loose engaging":
        return [leave, (pull["engaging"], 1, side, "engaging"), (*rise, side, "loose deep")]
    return [(*fall, side, "loose engaging"), (pull["deep"], 1, side, "deep")]


def exact(drop: Drop, turns: int = TURNS) -> Motion:
    """The motion until this many turning points, or until a damped body has stayed on its stop for
    many periods."""
    out, side, phase, t, y, v = Motion(drop), 0, "flight", 0.0, -drop.height, -drop.speed
    omega = np.sqrt(drop.stiffness / drop.mass)
    touching, longest = 0.0, 20 * np.sqrt(2 * drop.height / G) + 40 / omega
    while len(out.turns) < turns and (drop.damping == 0 or touching < 60 / omega) and t < longest:
        c = _series(y, v, *_field(drop, side, phase))
        h = _length(c, longest - t)
        if phase != "flight":
            h = min(h, 0.5 / omega)
        elif drop.spring:
            h = min(h, np.sqrt(drop.mass / drop.spring))
        event, direction = None, np.sign(v) or np.sign(c[2])
        # v is monotone over so short a step, or the step is a parabola
        if _rate(c, h) * direction < 0:
            low = 0.0
            if v == 0 or np.sign(_rate(c, 1e-9 * h)) != direction:
                low = 1e-9 * h
            h, event = brentq(lambda x, c=c: _rate(c, x), low, h, xtol=1e-300, rtol=1e-15), "turn"
        for (of_y, of_v, constant), sense, *after in _events(drop, side, phase):

            def crossing(x, c=c, of_y=of_y, of_v=of_v, constant=constant, sense=sense):
                return sense * (
                    of_y * _value(c, x) + (of_v * _rate(c, x) if of_v else 0.0) + constant
                )

            points = h * np.linspace(0, 1, 9)
            values = [crossing(x) for x in points]
            for i in range(8):
                if values[i + 1] > 0 and (values[i] < 0 or (values[i] == 0 and i > 0)):
                    h, event = (
                        brentq(crossing, points[i], points[i + 1], xtol=1e-300, rtol=1e-15),
                        (of_y, of_v, constant, after),
                    )
                    break
        out.pieces.append((t, h, side, c))
        y, v = _value(c, h), _rate(c, h)
        t += h
        if phase != "flight":
            touching += h
        if event == "turn":
            v = 0.0
            out.turns.append((t, y if side == 0 else -drop.clearance - y))
        elif event is not None:
            of_y, of_v, constant, (next_side, next_phase) = event
            if phase == "flight":
                out.touches.append([t, t])
                touching = 0.0
            if next_phase == "flight":
                out.touches[-1][1] = t
            if of_v == 0:
                y = -constant if side == next_side else 0.0
            v = v if side == next_side else -v
            side, phase = next_side, next_phase
    if phase != "flight":
        out.touches[-1][1] = t
    return out


def energy(drop: Drop, d, v):
    """Kinetic and potential, from the laws as they are documented."""

    def stop(x):
        w = drop.engagement
        return drop.stiffness * np.where(
            x <= 0, 0.0, np.where(x < w, x**3 / (6 * w), x**2 / 2 - x * w / 2 + w**2 / 6)
        )

    upper = stop(-d - drop.clearance) if np.isfinite(drop.clearance) else 0.0
    return (
        0.5 * drop.mass * v**2
        + stop(d)
        + upper
        + 0.5 * drop.spring * (d + drop.gap) ** 2
        - drop.mass * G * d
    )


# The same by jaxbody


def model_of(drop: Drop, deepest: float):
    """Bodies on a guide along z above the world's origin; numbers alone differ between drops of
    a kind."""
    room = 2 * max(deepest, 0.0) + drop.room * drop.height
    ends, touch = (("body", [0, 0, 0]), ("world", [0, 0, 0])), room
    law = {"stiffness": drop.stiffness, "engagement": drop.engagement}
    if drop.kind == "contact":
        element = jb.Contact(*ends, distance=touch, damping=drop.damping, **law)
    else:
        stop = jb.laws.BumpStop(gap=drop.gap, **law)
        if drop.kind == "stop":
            spring = jb.laws.Linear(drop.spring) + stop
        else:
            spring = stop + jb.laws.BumpStop(gap=drop.clearance - drop.gap, extension=True, **law)
        element = jb.SpringDamper(
            *ends, spring=spring, damper=drop.damping, free_length=touch + drop.gap
        )
    return jb.Model(
        bodies={"body": jb.Body(drop.mass, inertia=POINT, position=[0, 0, touch + drop.height])},
        joints={"body": jb.Guide("world", axis=[0, 0, 1])},
        elements={"stop": element},
        gravity=[0, 0, -G],
    )


def sample_times(motion: Motion):
    """The turning points, ten times in each contact, and others, equally many for each drop; and
    the places of the turning points."""
    turns = [t for t, _ in motion.turns]
    within = [t for a, b in motion.touches for t in np.linspace(a, b, 12)[1:-1]]
    special = np.unique([0.0, motion.end, *turns, *within])
    grid = np.linspace(0, motion.end, SAMPLES + 2)[1:-1]
    clear = np.abs(grid[:, None] - special[None]).min(1) > 1e-9 * motion.end
    grid = grid[clear]
    chosen = grid[np.linspace(0, len(grid) - 1, SAMPLES - len(special)).round().astype(int)]
    times = np.sort(np.concatenate([special, chosen]))
    return times, np.searchsorted(times, turns)


def judged(drop: Drop, rtol: float = RTOL, **options):
    """What a simulation of this drop is worth: largest errors relative to their limits, statuses,
    steps, and the accuracy of the judge."""
    motion = exact(drop)
    times, at = sample_times(motion)
    reference = motion.at(times)
    deepest = reference[:, 0].max()
    model = model_of(drop, deepest)
    start = jb.State(q=np.zeros(1), v=np.array([drop.speed]))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)  # the status says as much
        run = jb.simulate(
            model, times, initial=start, rtol=jnp.array(rtol), progress=False, **options
        )
    d, v = -drop.height - np.asarray(run.state.q)[:, 0], -np.asarray(run.state.v)[:, 0]
    scale = drop.mass * G * drop.height + 0.5 * drop.mass * drop.speed**2
    height = drop.height if np.isinf(drop.clearance) else drop.clearance

    def rise(E):
        rises = E - np.minimum.accumulate(E)
        return float("nan") if np.isnan(E).any() else float(rises.max() / scale)

    turns = np.array([x for _, x in motion.turns])
    own = energy(drop, *motion.at(times[::4]).T)
    return {
        "status": jb.Status(int(run.status)).name,
        "turning points": float(np.max(np.abs(d[at] - turns), initial=0.0) / height)
        if np.isfinite(d[at]).all()
        else float("nan"),
        "own energy": rise(np.asarray(run.energies["total"])),
        "energy": rise(energy(drop, d, v)),
        "steps": int(run.statistics["num_accepted_steps"])
        + int(run.statistics["num_rejected_steps"]),
        "turns": len(turns),
        "judge": float(np.ptp(own) / scale) if drop.damping == 0 else rise(own),
    }


def faults(result) -> list[str]:
    """What is wrong with it, [] if nothing."""
    wrong = [] if result["status"] == "OK" else [result["status"]]
    return wrong + [
        f"{name} {result[name]:.1e}"
        for name in ("turning points", "own energy", "energy")
        if not result[name] <= LIMIT
    ]
