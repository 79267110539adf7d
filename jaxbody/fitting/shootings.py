"""Multiple shooting: a long or chaotic record is cut into segments, and their initial states are
fitted together with the parameters until the segments are continuous.

    minimize 1/2 sum ((reading - measured)/noise)^2
             + 1/2 sum ((end of segment k - start of segment k+1)/(slack scale))^2

The slack decreases to SLACKS[-1]. Within a short segment the effect of a parameter error grows
little, so the cost has few minima; continuous segments are equal to one long simulation.
Source: H. G. Bock, Recent advances in parameter identification techniques for O.D.E., Progress in
Scientific Computing 2 (1983) 95.
"""

import dataclasses
import warnings
from collections.abc import Iterable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, device_array
from jaxbody.core.errors import JaxbodyError, JaxbodyWarning, Problem
from jaxbody.core.progress_lines import working
from jaxbody.fitting.experiments.experiments import Experiment, Integration
from jaxbody.fitting.experiments.measurements import (
    Measurement,
    NumberChannel,
    check_measurements,
)
from jaxbody.fitting.fit_results import Fit
from jaxbody.fitting.fitters import fit
from jaxbody.fitting.residuals import first_noise
from jaxbody.mechanics.quasi_static_states import Rest
from jaxbody.model.joints.frame_tables import completed
from jaxbody.model.joints.kinematics import frames_at_time
from jaxbody.model.models import Model
from jaxbody.model.states import State
from jaxbody.motion.simulations import motions_of
from jaxbody.motion.trajectories import Trajectory, readings

MAX_EVALUATIONS = 50  # for the initial state of a segment
# standard deviations of gaps between segments, relative to the variation of the state over
# the record
SLACKS = (
    1.0,
    0.1,
    1e-2,
    1e-4,
    1e-6,
)
# ratio of the cost of the whole record to that of the segments above which the fit of the segments
# is returned
WORSE = 1.01


class Segments(Measurement):
    """A record in `count` segments. `nodes`: initial states of the second and later segments;
    `scale`: variation of each component of the state; `slack`: standard deviation of the gaps
    between segments, relative to `scale`."""

    whole: Experiment
    nodes: State
    scale: State
    slack: Float[Array, ""]
    count: int = eqx.field(static=True)

    @property
    def measured(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        gaps = jnp.zeros(
            (self.count - 1, self.nodes.q.shape[1] + self.nodes.v.shape[1] + self.nodes.z.shape[1])
        )
        return {**self.whole.measured, "continuity": gaps}

    @property
    def noise(self):  # pyright: ignore[reportIncompatibleVariableOverride]
        return {**(self.whole.noise or {}), "continuity": self.slack}

    @property
    def channels(self):
        # gaps of the state between segments, over the scale of each component
        return {**self.whole.channels, "continuity": NumberChannel(series=False)}

    def residual(self, name, reading):
        return reading if name == "continuity" else self.whole.residual(name, reading)

    def named(self):
        return {**self.whole.named(), "nodes": self.nodes}

    def moved_rows(self, path, channel):
        """Return which rows depend on which initial states: readings depend on the initial state of
        their segment, a gap on those of the segments on both sides."""
        depend_on_past = any(
            sensor.delay is not None or sensor.lag is not None
            for sensor in self.whole.sensors.values()
        )
        if ".nodes." not in path or depend_on_past:
            return None
        nodes, ends = np.arange(1, self.count), np.arange(self.count - 1)[:, None]
        if channel == "continuity":
            return (nodes == ends) | (nodes == ends + 1)
        return self._segment_of_samples()[:, None] == nodes

    def _segment_of_samples(self) -> np.ndarray:
        starts, _ = cuts(len(self.whole.times), self.count)
        return np.searchsorted(starts, np.arange(len(self.whole.times)), side="right") - 1

    def axis(self, channel):
        return (
            ("segment", np.arange(1, self.count), "")
            if channel == "continuity"
            else self.whole.axis(channel)
        )

    def place(self, row):
        return self.whole.place(row)

    def explain(self, model, integration):
        return self.whole.explain(model, integration)

    def readings(self, model, integration: Integration, lin):
        starts, rows = cuts(len(self.whole.times), self.count)
        motions, loads = motions_of(model, self.whole.motion), tuple(self.whole.loads.values())
        first = first_state(self.whole, model)
        first = completed(model, first, frames_at_time(model, motions, self.whole.times[0], first))
        parts = jax.vmap(
            lambda times, initial: integration.trajectory(model, times, motions, loads, initial)
        )(
            self.whole.times[starts[:, None] + np.arange(rows)],
            jax.tree.map(lambda x, y: jnp.concatenate([x[None], y]), first, self.nodes),
        )
        ends = jax.tree.map(lambda x: x[np.arange(self.count - 1), np.diff(starts)], parts.state)
        gaps = jax.tree.leaves(
            jax.tree.map(
                lambda end, node, scale: (end - node) / scale[None], ends, self.nodes, self.scale
            )
        )
        owner = self._segment_of_samples()
        row = np.arange(len(owner)) - starts[owner]
        whole = Trajectory(
            times=self.whole.times,
            state=jax.tree.map(lambda x: x[owner, row], parts.state),
            status=jnp.max(parts.status),
            statistics={},
            end=jax.tree.map(lambda x: x[-1], parts.end),
            model=model,
            motions=motions,
            loads=loads,
        )
        return {**readings(whole, self.whole.sensors), "continuity": jnp.concatenate(gaps, 1)}


def cuts(samples: int, count: int) -> tuple[np.ndarray, int]:
    """Return the first sample of each segment, and the number of samples in a segment; each segment
    reaches the first sample of the next one."""
    rows = -(-(samples - 1) // count) + 1
    return np.round(np.linspace(0, samples - rows, count)).astype(int), rows


def multiple_shooting(
    model: Model,
    experiments: dict[str, Experiment],
    *,
    free: Iterable[str] | str,
    segments: int,
    **options: Any,
) -> Fit:
    """Fit long or chaotic records by multiple shooting, then fit the whole records from the result.

    Args:
        model, experiments, free: as in `fit`; the experiments are records in time.
        segments: number of segments of each record, so large that the simulated motion stays near
            the measured one within each segment.
        options: other options of `fit`.

    The initial states of the segments are fitted together with the parameters; the gaps between
    segments are reduced step by step. If the cost of the whole records is then higher, as it may be
    for chaotic motion, the fit of the segments is returned. Its gaps are about 1e-6 of the
    variation of the state, and its `experiments` are `Segments`.

    Errors: those of `fit`, BAD_NUMBER.

    >>> spring = jb.Spring(("mass", [0, 0, 0]), ("world", [0, 0, 0]), stiffness=30.0)
    >>> model = jb.Model(
    ...     bodies={"mass": jb.Body(mass=1.0, inertia=[1, 1, 1], position=[1, 0, 0])},
    ...     elements={"spring": spring},
    ...     joints={"mass": jb.Guide("world", axis=[1, 0, 0])},
    ... )
    >>> times = jnp.linspace(0, 4, 41)
    >>> track = jb.Experiment(
    ...     times,
    ...     sensors={"x": jb.Position("mass", axis=[1, 0, 0])},
    ...     measured={"x": jnp.cos(2 * jnp.pi * times)},
    ...     noise=0.01,
    ... )
    >>> round(
    ...     float(
    ...         jb.fitting.multiple_shooting(
    ...             model, {"track": track}, free="spring.stiffness", segments=4
    ...         ).estimates["spring.stiffness"]
    ...     ),
    ...     4,
    ... )
    39.4784
    """
    check_measurements(experiments, "multiple_shooting.experiments").raise_if_any()
    shortest = min((len(experiment.times) for experiment in experiments.values()), default=2)
    if not 2 <= segments < shortest:
        raise JaxbodyError(
            Problem(
                "BAD_NUMBER",
                "multiple_shooting.segments",
                f"is {segments}",
                segments,
                f"2 to {shortest - 1}",
            )
        )
    patterns = [free] if isinstance(free, str) else list(free)
    with warnings.catch_warnings(), working("multiple shooting", options.get("progress")) as line:
        warnings.simplefilter("ignore", JaxbodyWarning)  # those of intermediate fits
        line("initial states of the segments")
        joint: Any = None
        cut: dict[str, Any] = {
            name: _cut(model, name, experiment, segments, options)
            for name, experiment in experiments.items()
        }
        for slack in SLACKS:
            cut = {
                name: dataclasses.replace(each, slack=device_array(slack))
                for name, each in cut.items()
            }
            line(f"all segments, slack {slack:g}")
            joint = fit(
                model, cut, free=[*patterns, *(f"{name}.nodes.*" for name in cut)], **options
            )  # pyright: ignore[reportArgumentType]
            model, cut = joint.model, joint.experiments
    records = {name: each.whole for name, each in cut.items()}
    noise = {
        name: {channel: joint.task.noise[name][channel] for channel in each.channels}
        for name, each in records.items()
    }
    whole = fit(model, records, free=patterns, **options)
    limit = WORSE * _cost(joint, noise)
    return whole if np.isfinite(_cost(whole, noise)) and _cost(whole, noise) <= limit else joint


def first_state(experiment: Experiment, model: Model) -> State:
    """Return the initial state of an experiment: as stated, at rest, or the reference pose."""
    given = experiment.start(model, motions_of(model, experiment.motion))
    return model.reference if given is None else given


def _cost(result: Fit, noise: dict[str, dict[str, Array]]) -> float:
    """Return 1/2 r'r of the measured channels for these noise levels."""
    residuals = (
        result.experiments[run].residual(name, result.predicted[run][name])
        / result.experiments[run].channels[name].spread(level)
        for run, levels in noise.items()
        for name, level in levels.items()
    )
    return sum(0.5 * float(jnp.sum(r**2)) for r in residuals)


def _cut(
    model: Model, name: str, experiment: Experiment, count: int, options: dict[str, Any]
) -> Segments:
    """Return an experiment in segments. Each starts from the end of the one before, with its
    initial state fitted to its part of the record."""
    starts, rows = cuts(len(experiment.times), count)
    how = {
        field.name: options[field.name]
        for field in dataclasses.fields(Integration)
        if field.name in options
    }
    state = first_state(experiment, model)
    whole = eqx.tree_at(
        lambda e: (e.noise, e.initial),
        experiment,
        (first_noise({name: experiment}, absolute=False)[0][name], state),
        is_leaf=lambda x: x is None or isinstance(x, Rest),
    )
    motions: list[State] = []
    for i, following in zip(starts, [*starts[1:], starts[-1]], strict=True):
        record = {channel: x[i : i + rows] for channel, x in whole.measured.items()}
        part: Any = eqx.tree_at(
            lambda e: (e.times, e.measured, e.initial),
            whole,
            (whole.times[i : i + rows], record, state),
        )
        if i:
            part = fit(
                model,
                {name: part},
                free=f"{name}.initial.*",
                max_evaluations=MAX_EVALUATIONS,
                **how,
            ).experiments[name]
        motions.append(part.trajectory(model, Integration(**how)).state)
        state = jax.tree.map(lambda x, last=following - i: x[last], motions[-1])
    nodes = jax.tree.map(lambda *x: jnp.stack([each[0] for each in x]), *motions[1:])

    def scale(*parts):
        x = jnp.concatenate(parts)
        size = jnp.sqrt(jnp.mean((x - jnp.mean(x, 0, keepdims=True)) ** 2, 0))
        largest = jnp.max(size, initial=0.0)
        return jnp.maximum(size, 1e-3 * jnp.where(largest > 0, largest, 1.0))

    return Segments(  # pyright: ignore[reportCallIssue]
        experiment, nodes, jax.tree.map(scale, *motions), device_array(SLACKS[0]), count
    )
