"""Random shocks after quiet: ready models at rest in equilibrium, then a bump, a pulse or a few
samples of force, and their motion by short constant steps.

The reference starts just before the shock, so that it cannot pass over it. Its steps end at the
kinks of the input; where that jumps, one run ends before the jump and the next starts after it.
"""

from __future__ import annotations

import warnings
from dataclasses import dataclass, field
from itertools import pairwise
from typing import Any

import diffrax
import equinox as eqx
import jax.numpy as jnp
import numpy as np
from random_drops import log_uniform

import jaxbody as jb

LIMIT = 1e-5  # of the largest response
# samples, and intervals of splines: the same in all cases of a kind
UNIFORM, UNEVEN, COEFFICIENTS = 2001, 401, 400
RINGING = 16  # samples over which a cubic spline through a bump dies down beside it
EACH = 33  # samples of a piece of the reference
COMPARED = 120
SOLVERS = ("default", "Tsit5", "PIDController", "Kvaerno5")
MOTIONS = ("sampled", "half sine", "sawtooth", "triangle", "trapezoid", "spline", "function")
FORCES = ("hold", "linear", "cubic", "function of force")
PULSES = {
    "half sine": jb.inputs.HalfSine,
    "sawtooth": jb.inputs.Sawtooth,
    "triangle": jb.inputs.Triangle,
    "trapezoid": jb.inputs.Trapezoid,
}


def _engine(rng):
    return jb.presets.engine_on_mounts(mass=139.5 * rng.uniform(0.8, 1.25))


def _quarter(rng):
    return jb.presets.quarter_car(
        sprung=375 * rng.uniform(0.7, 1.3),
        damping=rng.uniform(500, 2500),
        tyre_damping=rng.uniform(0, 100),
    )


def _half(rng):
    return jb.presets.half_car(
        mass=1000 * rng.uniform(0.7, 1.3), front_damping=rng.uniform(500, 2500), rear_damping=1500.0
    )


def _full(rng):
    return jb.presets.full_car(mass=1100 * rng.uniform(0.8, 1.2))


def _table(rng):
    return jb.presets.isolated_table(
        mass=200 * rng.uniform(0.7, 1.3), damping=rng.uniform(20, 200, 3)
    )


def _stewart(rng):
    return jb.presets.stewart_table(mass=50 * rng.uniform(0.7, 1.3), damping=rng.uniform(10, 100))


PRESETS = {  # model, the support that is shaken, the body that is pushed, the shortest period [s]
    "engine_on_mounts": (_engine, "frame", "engine", 0.03),
    "quarter_car": (_quarter, "road", "body", 0.1),
    "half_car": (_half, "front", "body", 0.6),
    "full_car": (_full, "road fl", "car", 0.08),
    "isolated_table": (_table, "floor", "table", 0.1),
    "stewart_table": (_stewart, "base", "table", 0.1),
}


SMALL = ("quarter_car", "half_car", "engine_on_mounts")  # with solvers that take long to compile


def spread(case: int, among: tuple[str, ...] = tuple(PRESETS)) -> dict[str, Any]:
    """The arguments of `random_shock` for one of many: of each twenty four by Tsit5, four by a
    PIDController, one by Kvaerno5."""
    rng, i = np.random.default_rng([44, case]), case % 20
    solver = SOLVERS[1] if i < 4 else SOLVERS[2] if i < 8 else SOLVERS[3] if i == 8 else SOLVERS[0]
    fit = among if solver == "default" else SMALL[:2] if solver == "Kvaerno5" else SMALL
    presets = [name for name in fit if name in among] or list(among)
    return {
        "preset": str(rng.choice(presets)),
        "given": str(rng.choice(MOTIONS + FORCES)),
        "solver": solver,
    }


@dataclass
class Shock:
    """One case: what `jb.simulate` gets, and the pieces (start, end, longest step) of the
    reference, apart where the input jumps."""

    preset: str
    given: str
    solver: str
    quiet: float
    duration: float
    # it starts from the equilibrium, zero up to rounding; otherwise from the reference pose, which
    # is the same
    settled: bool = False
    model: Any = None
    motion: dict = field(default_factory=dict)
    loads: dict = field(default_factory=dict)
    pieces: list = field(default_factory=list)

    def __str__(self):
        solver = "" if self.solver == "default" else f", {self.solver}"
        start = "equilibrium" if self.settled else "reference pose"
        return (
            f"{self.preset}, {self.given}{solver}, {self.duration:.4g} s after {self.quiet:.4g} "
            f"s, from the {start}"
        )


def random_shock(
    seed: int,
    preset: str | None = None,
    given: str | None = None,
    solver: str = "default",
    layout: str | None = None,
    longest: float = 100.0,
) -> Shock:
    """Shocks of 1 ms to 1 s after quiet of 0 to `longest` seconds. `layout`: records of `uniform`
    or `uneven` time stamps; None takes uniform ones where they resolve the shock."""
    rng = np.random.default_rng([42, seed])
    preset = preset or list(PRESETS)[rng.integers(len(PRESETS))]
    given = given or (MOTIONS + FORCES)[rng.integers(len(MOTIONS + FORCES))]
    make, support, body, period = PRESETS[preset]
    model = make(rng)
    quiet = (0.0, log_uniform(rng, 0.01, longest), rng.uniform(0, longest))[
        rng.choice(3, p=[0.1, 0.45, 0.45])
    ]
    duration = log_uniform(rng, 1e-3, 1.0)
    # records whose step is a tenth of the shock or shorter
    if given == "spline" or layout == "uniform":
        quiet = min(
            quiet,
            duration * (0.1 * (COEFFICIENTS if given == "spline" else UNIFORM) - 2)
            - max(0.5, 6 * period),
        )
        if quiet < 0:
            quiet, duration = 0.0, max(duration, 0.03)
    after = max(0.5, 6 * period)
    stop = quiet + duration + after
    axis = (
        rng.normal(size=3)
        if preset in ("engine_on_mounts", "isolated_table", "stewart_table")
        else np.array([0, 0, 1.0])
    )
    axis /= np.linalg.norm(axis)
    speed = log_uniform(rng, 0.1, 1.0)  # change of velocity by a pulse [m/s]
    force = axis * speed * float(model[body].mass) / duration
    height = rng.uniform(0.005, 0.02)
    shock = Shock(preset, given, solver, quiet, duration, bool(rng.random() < 0.5), model)
    fine = min(0.02 * period, 2e-3)
    tail = (quiet + duration, stop, fine)

    def record(points):
        """Time stamps with at least this many within the shock, and the places of its first
        and last."""
        even = stop / (UNIFORM - 1)
        if (layout or "uniform") == "uniform" and duration >= points * even:
            times = np.linspace(0, stop, UNIFORM)
            first, last = (
                int(np.ceil(quiet / even - 1e-9)),
                int(np.floor((quiet + duration) / even + 1e-9)),
            )
        else:
            inner = duration / 40
            around = quiet + inner * np.arange(-2 * RINGING, 40 + 2 * RINGING + 1)
            around = around[(around >= -1e-12) & (around <= stop)]
            before = np.linspace(0, max(around[0], 0), 60)[:-1] if around[0] > 1e-9 else np.zeros(0)
            times = np.concatenate([before, around])
            times = np.concatenate(
                [times, np.linspace(times[-1], stop, UNEVEN - len(times) + 1)[1:]]
            )
            times[0] = 0.0
            first = int(np.argmin(abs(times - quiet)))
            last = first + 40
        return times, first, last

    def window(times, first, last, beside):
        """From a sample before the shock to one after it, in steps that end at all
        samples between."""
        a, b = max(first - beside, 0), min(last + beside, len(times) - 1)
        step = np.diff(times[a : b + 1]).max()
        n = int(np.ceil(step / min(fine, duration / 40)))
        return times[a], times[b], step / n

    def bump(times, first, last):
        s = (np.arange(len(times)) - first) / (last - first)
        return np.where((s > 0) & (s < 1), 0.5 - 0.5 * np.cos(2 * np.pi * s), 0.0)

    if given == "sampled":
        times, first, last = record(10)
        x = height * bump(times, first, last)
        with warnings.catch_warnings():
            # BASE_JUMP, which a shock after quiet is
            warnings.simplefilter("ignore", jb.JaxbodyWarning)
            shock.motion = {support: jb.Sampled(times, translation=x[:, None] * axis)}
        a, b, step = window(times, first, last, RINGING)
        shock.pieces = [(a, b, step), (b, stop, fine)]
    elif given in PULSES:
        pulse = PULSES[given](2 * speed / duration, duration, quiet)
        shock.motion = {support: pulse.motion(axis)}
        shock.pieces = [
            (quiet, quiet + duration, duration / max(40, 20 * np.ceil(duration / fine / 20))),
            tail,
        ]
    elif given == "spline":
        spline = jb.inputs.Spline(
            0.0, stop, interval=stop / COEFFICIENTS * (1 + 1e-9), along=[axis]
        )
        interval = stop / COEFFICIENTS
        first = int(np.ceil(quiet / interval))  # the coefficient i acts from knot i - 3 to i + 1
        count = max(int(duration / interval) - 3, 1)
        values = np.zeros((COEFFICIENTS + 3, 1))
        values[first + 3 : first + 3 + count, 0] = (
            height * np.sin(np.pi * (np.arange(count) + 1) / (count + 1)) ** 2
        )
        shock.motion = {support: eqx.tree_at(lambda s: s.values, spline, jnp.asarray(values))}
        a, b = first * interval, (first + count + 3) * interval
        shock.pieces = [
            (a, b, interval / np.ceil(interval / min(fine, duration / 40))),
            (b, stop, fine),
        ]
    elif given == "function":
        direction = np.concatenate([axis, np.zeros(3)])
        shock.motion = {support: lambda t: height * _smooth((t - quiet) / duration) * direction}
        shock.pieces = [(quiet, quiet + duration, min(fine, duration / 100)), tail]
    elif given == "function of force":
        shock.loads = {
            "push": jb.Force(body, force=lambda t: _smooth((t - quiet) / duration) * force)
        }
        shock.pieces = [(quiet, quiet + duration, min(fine, duration / 100)), tail]
    else:
        times, first, last = record(10 if given != "hold" else 6)
        if given == "hold":
            levels = np.zeros(len(times))
            edges = np.unique(np.linspace(first, last, 6).round().astype(int))
            for i, (a, b) in enumerate(pairwise(edges)):
                levels[a:b] = (1.0, -0.5, 1.5, 0.7, -1.0)[i]
            jumps = times[edges]
            shock.pieces = [(a, b, min(fine, (b - a) / 20)) for a, b in pairwise(jumps)]
            shock.pieces.append((jumps[-1], stop, fine))
        else:
            levels = (
                bump(times, first, last)
                if given == "cubic"
                else bump(times, first, last) * rng.uniform(0.5, 1.5, len(times))
            )
            a, b, step = window(times, first, last, RINGING if given == "cubic" else 1)
            shock.pieces = [(a, b, step), (b, stop, fine)]
        shock.loads = {
            "push": jb.Force(
                body, force=jb.signals.Samples(times, levels[:, None] * force, kind=given)
            )
        }
    return shock


def _smooth(s):
    """A bump from 0 to 1, all of whose derivatives are continuous, zero outside."""
    inside = (s > 0) & (s < 1)
    x = jnp.where(inside, s, 0.5)
    return jnp.where(inside, jnp.exp(4 - 1 / (x * (1 - x))), 0.0)


def reference(shock: Shock, initial, finer: float = 1.0):
    """Times and state (times, q and v), by constant steps from the first piece on."""
    state, kept = initial, []
    jump = 1e-12 * shock.pieces[-1][1]
    for a, b, step in shock.pieces:
        if b - a <= 2 * jump:  # the record ends with the shock
            continue
        times = np.linspace(a + jump, b - jump, EACH)
        while times[0] + (times[-1] - times[0]) < times[-1]:
            # else a run ends before its last sample, by rounding, which is then NaN
            times[-1] = np.nextafter(times[-1], 0)
        steps = np.ceil((b - a) / step * (1 - 1e-9))
        run = jb.simulate(
            shock.model,
            times,
            motion=shock.motion,
            loads=shock.loads,
            initial=state,
            stepsize_controller=diffrax.ConstantStepSize(),
            dt0=jnp.array((times[-1] - times[0]) / (steps * finer)),
            progress=False,
        )
        assert run.ok, (shock, run.report())
        q, v = np.asarray(run.state.q), np.asarray(run.state.v)
        state = jb.State(q=q[-1], v=v[-1])
        kept.append((times, q, v))
    return tuple(np.concatenate(x) for x in zip(*kept, strict=True))


def differences(q, v, q1, v1, start):
    """The largest of positions and of velocities, relative to the largest response of each."""
    parts = (q - q1, q1 - np.asarray(start.q)), (v - v1, v1 - np.asarray(start.v))
    return max(
        float(np.abs(change).max() / np.abs(response).max())
        if np.isfinite(change).all()
        else np.inf
        for change, response in parts
    )


def options_of(solver: str, tolerances=(1e-9, 1e-12)):
    if solver == "PIDController":
        return {
            "stepsize_controller": diffrax.PIDController(rtol=tolerances[0], atol=tolerances[1])
        }
    return {} if solver == "default" else {"solver": getattr(diffrax, solver)()}


def judged(shock: Shock, check: bool = False):
    """Error of a simulation from the beginning of the quiet on, relative to the largest response,
    and whether it is `right`, `wrong`, `said` (it warned) or `ended`; with `check` also the
    difference between the reference and one of half the steps."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", jb.JaxbodyWarning)
        start = jb.equilibrium(shock.model).state if shock.settled else shock.model.reference
        times, q1, v1 = reference(shock, start)
        accuracy = np.nan
        if check:
            _, q2, v2 = reference(shock, start, finer=2.0)
            accuracy = differences(q1, v1, q2, v2, start)
    quiet = (
        np.linspace(0, shock.pieces[0][0], 9)[:-1] if shock.pieces[0][0] > 1e-6 else np.array([0.0])
    )
    room = COMPARED - len(quiet)
    at = np.unique(np.linspace(0, len(times) - 1, room).round().astype(int))
    at = at[times[at] > quiet[-1] + 1e-9]
    at = at[np.append(True, np.diff(times[at]) > 1e-9)]
    sampled = np.concatenate([quiet, times[at]])
    filling = (
        np.linspace(quiet[-1], times[at[0]], COMPARED - len(sampled) + 2)[1:-1]
        if len(quiet) > 1
        else np.zeros(0)
    )
    more = times[-1] * (
        1 + 1e-9 * np.arange(1, COMPARED - len(sampled) - len(filling) + 1) / COMPARED
    )
    more = (
        sampled[-1]
        - (sampled[-1] - sampled[-2])
        * np.linspace(0, 1, COMPARED - len(sampled) - len(filling) + 2)[1:-1]
        if len(more)
        else more
    )
    ts = np.sort(np.concatenate([sampled, filling, more]))
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        run = jb.simulate(
            shock.model,
            ts,
            motion=shock.motion,
            loads=shock.loads,
            initial=start,
            progress=False,
            **options_of(shock.solver),
        )
    q, v = np.asarray(run.state.q), np.asarray(run.state.v)
    rows = np.searchsorted(ts, times[at])
    error = differences(q[rows], v[rows], q1[at], v1[at], start)
    codes = sorted({w.message.code for w in caught if isinstance(w.message, jb.JaxbodyWarning)})
    status = jb.Status(int(run.status)).name
    verdict = (
        "ended" if status != "OK" else "said" if codes else "right" if error <= LIMIT else "wrong"
    )
    steps = int(run.statistics["num_accepted_steps"]) + int(run.statistics["num_rejected_steps"])
    return {
        "verdict": verdict,
        "error": error,
        "status": status,
        "codes": codes,
        "steps": steps,
        "judge": accuracy,
    }
