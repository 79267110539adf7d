"""Experiments: the sample times, base motions, loads, initial state and sensor records of one
run."""

from dataclasses import replace
from typing import Any

import diffrax
import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arguments import check_kind, checked_dict
from jaxbody.core.arrays import (
    Array,
    Float,
    check_times,
    concrete,
    device_array,
    float_array,
    is_concrete,
    module_of,
    time_text,
)
from jaxbody.core.errors import JaxbodyError, Problems, warn
from jaxbody.core.units import parse
from jaxbody.fitting.experiments.measurements import Measurement
from jaxbody.mechanics.quasi_static_states import Rest, as_initial, initial_state_of, rest_state
from jaxbody.model.inputs.loads import Load, loads_by_name, loads_of
from jaxbody.model.inputs.motions import as_motion
from jaxbody.model.inputs.signals import Signal
from jaxbody.model.joints.kinematics import Motions
from jaxbody.model.models import Model
from jaxbody.model.states import State
from jaxbody.motion.integrations import integrate, most_steps
from jaxbody.motion.simulations import check_covered, check_run, motions_of
from jaxbody.motion.trajectories import Trajectory, readings
from jaxbody.records.records import Record
from jaxbody.records.sampling_checks import warn_of_rails
from jaxbody.sensors.sensors import Sensor, check_sensors, noise_levels

MANY_MISSING = 0.2  # share of missing samples of a record above which a warning is issued
MAX_STEPS = 10_000  # integration steps of a run of a fit; more for many samples, as in `simulate`


class Integration(eqx.Module):
    """Options of `simulate` for the runs of a fit."""

    rtol: Float[Array, ""] = eqx.field(default=1e-8, converter=device_array)
    solver: diffrax.AbstractSolver | None = None
    stepsize_controller: diffrax.AbstractStepSizeController | None = None
    dt0: Float[Array, ""] | None = eqx.field(
        default=None, converter=lambda dt: None if dt is None else device_array(dt)
    )
    # by default MAX_STEPS, or more for many samples
    max_steps: int | None = eqx.field(default=None, static=True)

    def trajectory(
        self,
        model: Model,
        times: Array,
        motions: Motions,
        loads: tuple[Load, ...],
        initial: State | None,
    ) -> Trajectory:
        return integrate(
            model,
            times,
            motions,
            loads,
            initial,
            self.rtol,
            self.solver,
            self.stepsize_controller,
            diffrax.ForwardMode(),
            self.dt0,
            self.max_steps or most_steps(len(times), MAX_STEPS),
            diffrax.NoProgressMeter(),
            "structured",
        )


class Experiment(Measurement):
    """One measured run, or a planned one.

    Args:
        times: [s] (nt,); None: the times of the record.
        sensors: {name: sensor}.
        measured: {name: array (nt, ...)} for every sensor, NaN for missing samples; or a Record,
            as returned by `read_record`, with a channel for every sensor, under the same name and
            in a unit of the same quantity; its other channels are not used. None: a planned run,
            without data.
        motion: {support: motion}; a support without an entry is at rest.
        loads: {name: load}; by default none.
        initial: the state at times[0], or "rest", the equilibrium on the supports with their
            positions and velocities at times[0], which is recomputed for every trial of a fit;
            by default the reference pose at rest.
        noise: standard deviations, one number or {sensor: one number}, for a pose two numbers, in
            meters and radians; by default estimated from the residuals.
        leave_out: duration of the initial transient [s], whose samples become NaN; by default 0.

    Errors, all at once: times as in `simulate`, T_RANGE for times that a motion does not cover,
    NO_TIME, BAD_SHAPE, NO_DATA, ALL_NAN for a channel, NON_FINITE, BAD_QUATERNION, BAD_NOISE,
    UNKNOWN_NAME, UNKNOWN_CHANNEL and WRONG_DIMENSION of a record, BAD_NAME, DUPLICATE_NAME,
    WRONG_KIND, BAD_OPTION for leave_out of a plan; warns MISSING above 20 %, DEAD, SATURATED.

    >>> height = jb.Position("mass", axis=[0, 1, 0])
    >>> jb.Experiment(
    ...     [0.0, 0.1, 0.2], sensors={"height": height}, measured={"height": [0, -0.049, -0.196]}
    ... ).measured["height"].shape
    (3,)
    >>> fall = jb.Record(
    ...     [0.0, 0.1, 0.2],
    ...     {"height": ([0, -49, -196], "mm"), "temperature": ([20.0, 20.5, 20.2], "1")},
    ... )
    >>> jb.Experiment(sensors={"height": height}, measured=fall).measured["height"].tolist()
    [0.0, -0.049, -0.196]
    """

    times: Float[Array, "nt"]
    motion: dict[str, Signal]
    loads: dict[str, Load]
    initial: State | Rest | None
    sensors: dict[str, Sensor]
    measured: dict[str, Float[Array, "nt *r"]]
    noise: dict[str, Float[Array, "*units"]] | None

    def __init__(
        self,
        times=None,
        *,
        sensors: dict[str, Sensor],
        measured: dict[str, Any] | Record | None = None,
        motion: dict[str, Any] | None = None,
        loads: dict[str, Load] | None = None,
        initial: State | str | None = None,
        noise: float | dict[str, Any] | None = None,
        leave_out: float = 0.0,
    ):
        with Problems() as problems:
            sensors = checked_dict(
                sensors, "Experiment.sensors", "name: jb.Position(...)", problems
            )
            plan = measured is None
            if isinstance(measured, Record):
                times, measured = _of_record(measured, times, sensors, problems)
            elif times is None:
                problems.add(
                    "NO_TIME",
                    "Experiment.times",
                    "are missing",
                    hint="Give them, or measured=record.",
                )
            measured = checked_dict(measured, "Experiment.measured", "name: array", problems)
            motion = checked_dict(
                motion, "Experiment.motion", "support: jb.Harmonic(...)", problems
            )
            motions = {
                name: problems.gather(
                    lambda m=m, name=name: as_motion(m, f"Experiment.motion['{name}']")
                )
                for name, m in motion.items()
            }
            loads = loads_by_name(loads, "Experiment.loads", problems)
        checked = check_times(times, problems, "Experiment.times", minimum=2)
        check_covered(
            checked,
            [(f"Experiment.motion['{name}']", m) for name, m in motions.items() if m is not None],
            problems,
        )
        if not sensors:
            problems.add("NO_DATA", "Experiment.sensors", "is empty", limit="at least one sensor")
        for name in [
            n for n in (*sensors, *measured) if (n in sensors) != (n in measured) and not plan
        ]:
            problems.add(
                "UNKNOWN_NAME",
                f"Experiment.{'measured' if name in sensors else 'sensors'}",
                f"lacks '{name}'",
                value=name,
                hint="Every sensor needs its measured array, under the same name.",
            )
        if plan and leave_out:
            problems.add(
                "BAD_OPTION",
                "Experiment.leave_out",
                "leaves out data, which a plan does not have",
                value=leave_out,
                hint="Plan the later times, with initial= the state at the first of them.",
            )
        kept = _kept(leave_out, checked, problems)
        arrays = {
            name: _samples(name, sensor, measured[name], checked, kept, problems)
            for name, sensor in sensors.items()
            if name in measured
        }
        levels = None
        if noise is not None:
            valid = {name: sensor for name, sensor in sensors.items() if isinstance(sensor, Sensor)}
            levels = noise_levels(valid, noise, "Experiment.noise", problems, zero=False)
        self.initial = as_initial(initial)
        if initial is not None:
            check_kind(
                self.initial,
                (State, Rest),
                "Experiment.initial",
                'jb.State(q, v) or "rest"',
                problems,
            )
        _check_names(motion, loads, sensors, problems)
        problems.raise_if_any()
        self.times = device_array(checked)
        self.motion = motions
        self.loads, self.sensors, self.measured = (
            {name: jax.tree.map(device_array, part) for name, part in parts.items()}
            for parts in (loads, sensors, arrays)
        )
        self.noise = (
            None
            if levels is None
            else {name: device_array(level) for name, level in levels.items()}
        )

    @property
    def channels(self):
        return self.sensors

    def start(self, model: Model, motions: Motions) -> State | None:
        """Return the state at times[0], or None for the reference pose."""
        return (
            rest_state(model, motions, self.times[0])[0]
            if isinstance(self.initial, Rest)
            else self.initial
        )

    def trajectory(self, model: Model, integration: Integration) -> Trajectory:
        """Return the simulated motion of the run."""
        motions = motions_of(model, self.motion)
        return integration.trajectory(
            model, self.times, motions, tuple(self.loads.values()), self.start(model, motions)
        )

    def readings(self, model, integration, lin):
        return readings(self.trajectory(model, integration), self.sensors)

    def residual(self, name, reading):
        measured = (
            np.asarray(self.measured[name])
            if isinstance(reading, np.ndarray)
            else self.measured[name]
        )
        return self.sensors[name].misfit(self.times, reading, measured)

    def explain(self, model, integration):
        if isinstance(self.initial, Rest):
            try:
                initial_state_of(
                    model, motions_of(model, self.motion), self.times[0], self.initial, "initial"
                )
            except JaxbodyError as error:
                return str(error)
        return self.trajectory(model, integration).report()

    def axis(self, channel):
        return "time", self.times, "s"

    def place(self, row):
        return f"t = {time_text(self.times[row], self.times)} s", float(self.times[row])

    def named(self):
        """Return the parts with names in paths: initial state, motions, loads, sensors."""
        return {
            **({} if not isinstance(self.initial, State) else {"initial": self.initial}),
            **self.motion,
            **self.loads,
            **self.sensors,
        }

    def absent(self):
        stages = {
            f"{name}.{stage}": f"Sensor '{name}' has no {stage}: construct it with {option}."
            for name, sensor in self.sensors.items()
            for stage, option in sensor.absent().items()
        }
        if isinstance(self.initial, State):
            hint = (
                "The initial state has no z: give it State(q, v, z), or the "
                ".state of an equilibrium."
            )
            return {"initial.z": hint, **stages}
        hint = (
            "The experiment begins at rest, which follows from the model: give it "
            "initial=State(q, v) for a free initial state."
            if isinstance(self.initial, Rest)
            else "The experiment has no initial state: give it initial=State(q, v), or the "
            ".state of an equilibrium."
        )
        return {**{f"initial.{part}": hint for part in "qvz"}, **stages}

    def scale_of(self, path, unit):
        """Return 1 for a gain, which may have either sign, the sampling interval for a delay, the
        rms of the record, or of the noise of a plan, for a bias or an initial value."""
        name, _, stage = path.rpartition(".")
        if name not in self.sensors or stage not in self.sensors[name].stages:
            return None
        if unit == "s":
            return (self.times[-1] - self.times[0]) / (len(self.times) - 1)
        size = (self.measured or self.noise or {}).get(name, 1.0)  # a plan has noise alone
        rms = jnp.sqrt(jnp.nanmean(jnp.square(size))) if unit else jnp.ones(())
        return jnp.where(rms > 0, rms, 1.0)

    def check(self, model: Model, where: str) -> None:
        with Problems() as problems:
            problems.gather(lambda: loads_of(self.loads, model.layout.bodies))
            motions = problems.gather(lambda: motions_of(model, self.motion))
            if not problems.collected:
                problems.gather(
                    lambda: check_run(model, self.times, motions, self.loads, self.initial)
                )
            problems.gather(lambda: check_sensors(self.sensors, model, "sensors"))
            for name in self.sensors:
                self._check_delay(name, problems)
            problems.collected = [
                replace(problem, where=f"{where}.{problem.where}") for problem in problems.collected
            ]

    def _check_delay(self, name: str, problems: Problems) -> None:
        """Check that a sensor's delay leaves a measured sample to compare with. Error:
        BAD_DELAY."""
        sensor = self.sensors[name]
        measured = self.measured.get(name)
        if sensor.delay is None or measured is None:
            return
        if not is_concrete(sensor.delay, self.times, measured):
            return
        present = self.present(name).reshape(len(self.times), -1).any(1)
        if not (np.asarray(sensor.weight(self.times)) * present).any():
            length = float(self.times[-1] - self.times[0])
            problems.add(
                "BAD_DELAY",
                f"sensors['{name}'].delay",
                f"is {float(sensor.delay):.6g} s in a record of {length:.6g} s: no measured sample "
                "is left to compare with",
                value=float(sensor.delay),
                limit=f"-{length:.6g} to {length:.6g} s",
                hint="Is it in milliseconds? Give it in seconds; it is usually a small part of the "
                "record.",
            )


def _check_names(
    motion: dict[str, Any], loads: dict[str, Any], sensors: dict[str, Any], problems: Problems
) -> None:
    """Check that paths can name each part: loads and sensors have names that differ from each other
    and from those of the motions. Errors: DUPLICATE_NAME, BAD_NAME."""
    used = {"initial": "is reserved"} | dict.fromkeys(motion, "is the name of a support too")
    for kind, names in (("loads", loads), ("sensors", sensors)):
        for name in names:
            if name in used:
                problems.add(
                    "DUPLICATE_NAME",
                    f"Experiment.{kind}['{name}']",
                    used[name],
                    value=name,
                    hint="Paths need different names.",
                )
        used |= dict.fromkeys(names, "is the name of a load too")
    for name in sensors:
        if not isinstance(name, str) or not name or set(name) & set(".*?[]"):
            problems.add(
                "BAD_NAME",
                f"Experiment.sensors[{name!r}]",
                "is not a valid name",
                value=name,
                hint="Give a text without . * ? [ ], as paths contain it.",
            )


def _of_record(
    record: Record, times: Any, sensors: dict[str, Any], problems: Problems
) -> tuple[Any, dict[str, Any]]:
    """Return the times and channels of a record for `sensors`, after checking that each channel has
    the quantity that its sensor reads, unless the sensor has a gain."""
    if times is not None:
        problems.add(
            "BAD_OPTION",
            "Experiment.times",
            "are given besides a record, which has its own",
            value=times,
            hint="Leave them out; record.part(0, 2) is a part of it.",
        )
    for name, sensor in sensors.items():
        where = f"Experiment.measured['{name}']"
        if name not in record.channels:
            problems.add(
                "UNKNOWN_CHANNEL",
                where,
                "is no channel of the record",
                value=name,
                hint=f"Name the sensor as its channel: {', '.join(record.channels)}.",
            )
        elif (
            isinstance(sensor, Sensor)
            and sensor.gain is None
            and record.units[name] not in (expected := [*map(_si, sensor.possible_units)])
        ):
            problems.add(
                "WRONG_DIMENSION",
                where,
                f"is in '{record.units[name]}'",
                value=record.units[name],
                limit=" or ".join(map(repr, expected)),
                hint="Give a sensor that reads this quantity, or a gain that converts to it.",
            )
    return record.times, {
        name: record.channels[name] for name in sensors if name in record.channels
    }


def _si(unit: str) -> str:
    """Return a sensor's unit in the spelling of a `Record`; a list of units stays unchanged."""
    return unit if "," in unit else parse(unit or "1", "unit").si


def _kept(leave_out: Any, times, problems: Problems):
    """Return which samples are used: those after the first `leave_out` seconds; None if all are."""
    duration = None if times is None or not is_concrete(times) else float(times[-1] - times[0])
    valid = (
        isinstance(leave_out, int | float | np.number)
        and not isinstance(leave_out, bool)
        and leave_out >= 0
    )
    if not valid or (duration is not None and not leave_out < duration):
        problems.add(
            "BAD_NUMBER",
            "Experiment.leave_out",
            f"is {leave_out!r:.40}",
            value=leave_out,
            limit="0 s or more"
            + ("" if duration is None else f", less than the {duration:.6g} s of the record"),
            hint="Give the duration of the initial transient in seconds.",
        )
        return None
    return None if times is None or not leave_out else times - times[0] >= leave_out * (1 - 1e-9)


def _samples(name: str, sensor: Any, value: Any, times, kept, problems: Problems):
    """Return the measured array of a sensor, with NaN for samples that are left out; errors are
    added to `problems`."""
    where = f"Experiment.measured['{name}']"
    if not isinstance(sensor, Sensor):
        problems.add(
            "WRONG_KIND",
            f"Experiment.sensors['{name}']",
            f"is a {type(sensor).__name__}",
            value=sensor,
            limit="a sensor such as Position",
        )
        return None
    array = problems.gather(lambda: float_array(value, where))
    if array is None or times is None:
        return array
    shape = (len(times), *sensor.shape)
    if array.size == 0:
        problems.add("NO_DATA", where, "is empty", value=array.shape, limit=str(shape))
    elif array.shape != shape:
        problems.add(
            "BAD_SHAPE",
            where,
            f"has shape {array.shape}",
            value=array.shape,
            limit=str(shape),
            hint="It seems to be transposed: give measured.T."
            if array.T.shape == shape
            else (
                f"Give one row for each time; a {type(sensor).__name__} has "
                f"{sensor.shape or 'one number'}."
            ),
        )
    elif isinstance(array, np.ndarray):
        missing = np.isnan(array).reshape(len(times), -1)
        if np.isinf(array).any():
            problems.add(
                "NON_FINITE",
                where,
                "has infinite values",
                limit="finite, or NaN for a missing sample",
            )
        if (problem := sensor.misread(array, where)) is not None:
            problems.collected.append(problem)
        unused = missing | ~kept[:, None] if isinstance(kept, np.ndarray) else missing
        for channel in np.flatnonzero(unused.all(0)):
            problems.add(
                "ALL_NAN",
                where,
                "has no samples" + (f" in component {channel}" if sensor.shape else ""),
                value=int(channel),
                hint="Leave out the sensor, or use one for the components that were measured.",
            )
        if (known := concrete(times)) is not None:
            rows = array.reshape(len(known), -1)
            constant = (rows == rows[:1]).all(0)
            # single components may be constant, as in plane motion
            rows = rows if constant.all() else rows[:, ~constant]
            warn_of_rails(rows, known, where, sensor.unit)
        fraction = missing.mean()
        if MANY_MISSING < fraction < 1:
            warn("MISSING", f"{where} lacks {100 * fraction:.0f} % of its samples")
    if kept is None or array.shape[:1] != kept.shape:
        return array
    xp = module_of(array, kept)
    return xp.where(kept.reshape(-1, *(1,) * (array.ndim - 1)), array, xp.nan)
