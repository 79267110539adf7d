"""One run of a rig: when it was sampled, how its base moved, where it started, which sensors read what."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxbody.arrays import concrete, device_array, float_array
from jaxbody.errors import JaxbodyError, Problems, is_concrete, warn
from jaxbody.models import Model, State
from jaxbody.motions import Motion, as_motion, check_times
from jaxbody.sensors import Sensor, check_sensors
from jaxbody.simulations import check_run, motions_of

MANY_MISSING = 0.2


class Experiment(eqx.Module):
    """What was done and what was measured.

    times [s] (nt,); motion {support: motion}; initial, the state at times[0] (the reference pose at rest without one);
    sensors {name: sensor}; measured {name: (nt, ...)}, NaN where a sample is missing; noise, standard deviations, one number or one for
    each sensor, estimated from the residuals where they are not given.

    Errors, all at once: times as in `simulate`, BAD_SHAPE, NO_DATA, ALL_NAN of a channel, BAD_NOISE, UNKNOWN_NAME, WRONG_KIND; warns MISSING above 20 %.
    """

    times: Float[Array, "nt"]
    motion: dict[str, Motion]
    initial: State | None
    sensors: dict[str, Sensor]
    measured: dict[str, Float[Array, "nt *r"]]
    noise: dict[str, Float[Array, ""]] | None

    def __init__(
        self,
        times,
        *,
        sensors: dict[str, Sensor],
        measured: dict[str, Any],
        motion: dict[str, Any] | None = None,
        initial: State | None = None,
        noise: float | dict[str, Any] | None = None,
    ):
        problems = Problems()
        checked = check_times(times, problems, "Experiment.times", minimum=2)
        if not sensors:
            problems.add("NO_DATA", "Experiment.sensors", "is empty", limit="at least one sensor")
        for name in sensors.keys() ^ measured.keys():
            which = "measured" if name in sensors else "sensors"
            problems.add(
                "UNKNOWN_NAME",
                f"Experiment.{which}",
                f"lacks '{name}'",
                value=name,
                hint="Every sensor needs its measured array, under the same name.",
            )
        arrays = {}
        for name in sensors.keys() & measured.keys():
            arrays[name] = _samples(name, sensors[name], measured[name], checked, problems)
        levels = noise if isinstance(noise, dict) or noise is None else dict.fromkeys(sensors, noise)
        for name, level in (levels or {}).items():
            known = concrete(float_array(level))
            if name not in sensors or (known is not None and (known.ndim or not np.isfinite(known) or known <= 0)):
                problems.add(
                    "BAD_NOISE",
                    f"Experiment.noise['{name}']",
                    f"is {level}",
                    value=level,
                    limit="> 0, finite, one for each sensor",
                    hint="Leave noise out to have it estimated.",
                )
        clash = [name for name in sensors if name in (motion or {}) or name == "initial"]
        if clash:
            problems.add(
                "DUPLICATE_NAME",
                f"Experiment.sensors['{clash[0]}']",
                "is also a support or reserved",
                value=clash[0],
                hint="Paths need different names.",
            )
        problems.raise_if_any()
        self.times = device_array(checked)  # pyright: ignore[reportArgumentType]
        self.motion = {name: as_motion(m) for name, m in (motion or {}).items()}
        self.initial, self.sensors = initial, dict(sensors)
        self.measured = {name: device_array(a) for name, a in arrays.items()}
        self.noise = None if levels is None else {name: device_array(float_array(level)) for name, level in levels.items()}

    def named(self) -> dict[str, Any]:
        """What of it has a name in paths: the initial state, the motions, the sensors."""
        return {**({} if self.initial is None else {"initial": {"q": self.initial.q, "v": self.initial.v}}), **self.motion, **self.sensors}

    def check(self, model: Model, where: str) -> None:
        """It fits the model."""
        try:
            check_run(model, self.times, motions_of(model, self.motion), self.initial)
            check_sensors(self.sensors, model, "sensors")
        except JaxbodyError as error:
            raise JaxbodyError(*(_under(where, problem) for problem in error.problems)) from None


def _under(where: str, problem):
    return type(problem)(problem.code, f"{where}.{problem.where}", problem.message, problem.value, problem.limit, problem.hint)


def _samples(name: str, sensor: Sensor, value: Any, times, problems: Problems):
    where = f"Experiment.measured['{name}']"
    if not isinstance(sensor, Sensor):
        problems.add(
            "WRONG_KIND", f"Experiment.sensors['{name}']", f"is a {type(sensor).__name__}", value=sensor, limit="a sensor such as Position"
        )
        return None
    array = float_array(value, where)
    if times is None:
        return array
    shape = (len(times), *sensor.shape)
    if array.size == 0:
        problems.add("NO_DATA", where, "is empty", value=array.shape, limit=str(shape))
    elif array.shape != shape:
        hint = (
            "It looks transposed: give measured.T."
            if array.T.shape == shape
            else f"One row per time; a {type(sensor).__name__} has {sensor.shape or 'one number'}."
        )
        problems.add("BAD_SHAPE", where, f"has shape {array.shape}", value=array.shape, limit=str(shape), hint=hint)
    elif is_concrete(array):
        missing = np.isnan(np.asarray(array)).reshape(len(times), -1)
        if np.isinf(np.asarray(array)).any():
            problems.add("NON_FINITE", where, "has infinite values", limit="finite, or NaN where a sample is missing")
        for channel in np.flatnonzero(missing.all(0)):
            problems.add(
                "ALL_NAN",
                where,
                f"has no sample at all in component {channel}",
                value=int(channel),
                hint="Leave the sensor out, or use one that reads what you have.",
            )
        share = missing.mean()
        if MANY_MISSING < share < 1:
            warn("MISSING", f"{where} lacks {100 * share:.0f} % of its samples")
    return array


def shared_structure(experiments: dict[str, Experiment]) -> list[list[str]]:
    """Names of experiments of equal structure and shapes, which can run side by side."""

    groups: dict[Any, list[str]] = {}
    for name, experiment in experiments.items():
        leaves, treedef = jax.tree.flatten(experiment)
        groups.setdefault((treedef, tuple(jnp.shape(leaf) for leaf in leaves)), []).append(name)
    return list(groups.values())
