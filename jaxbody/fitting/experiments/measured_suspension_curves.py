"""Measured curves of a suspension for fits: angles and positions of a wheel over its travel and
steering."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxbody.core.arrays import Array, Float, concrete, device_array, float_array
from jaxbody.core.errors import Problems, unknown
from jaxbody.fitting.experiments.measurements import (
    Measurement,
    NumberChannel,
    check_rows,
    noise_of,
)
from jaxbody.suspension.alignment_curves import curve_names, curve_unit, suspension_curves
from jaxbody.suspension.wheels import Wheel


class MeasuredCurves(Measurement):
    """Measured curves of a suspension for a fit, as recorded by a kinematics test rig.

    Args:
        wheel: the wheel, in the frame of its body.
        drive: {name: wheel, sensor or "rack.q"}: the quantities that the rig prescribes, as in
            `suspension_curves`; a wheel stands for the rise of its center.
        over: {name: values (n,), or one number}: values of these quantities in each row, as changes
            from the design position [m or rad].
        measured: {curve: (n,)} in SI units, angles in rad, by the names of `suspension_curves`:
            "toe", "camber", "wheel x"; NaN for rows to leave out. None: a plan of those in `noise`.
        noise: standard deviations {curve: one number or one for each row}; by default estimated
            from the residuals.

    In a fit of a suspension, moved hard points also move this wheel. A trial that cannot reach
    every row is a rejected step.

    Errors, all at once: NO_DATA, BAD_SHAPE, NON_FINITE, ALL_NAN, BAD_NOISE, UNKNOWN_NAME, and those
    of `suspension_curves`.

    >>> corner = jb.suspension.double_wishbone()
    >>> rig = jb.fitting.MeasuredCurves(
    ...     corner.wheel,
    ...     drive={"travel": corner.wheel, "rack": "rack.q"},
    ...     over={"travel": [-0.05, 0.05], "rack": 0.0},
    ...     measured={"toe": jnp.deg2rad(jnp.array([-0.98, 0.44]))},
    ...     noise={"toe": 1e-4},
    ... )
    >>> list(rig.channels)
    ['toe']
    """

    wheel: Wheel
    driven: dict[str, Any]
    # (name, path) of each drive; the path is None for sensors and wheels, which are in `driven`
    order: tuple[tuple[str, str | None], ...] = eqx.field(static=True)
    over: dict[str, Float[Array, "n"]]
    measured: dict[str, Float[Array, "n"]]
    noise: dict[str, Float[Array, "..."]] | None

    def __init__(
        self,
        wheel: Wheel,
        *,
        drive: Mapping[str, Any],
        over: Mapping[str, Any],
        measured: Mapping[str, Any] | None = None,
        noise=None,
    ):
        with Problems() as problems:
            arrays = {
                name: float_array(x, f"MeasuredCurves.measured['{name}']")
                for name, x in (measured or {}).items()
            }
            if not arrays and not noise:
                problems.add(
                    "NO_DATA", "MeasuredCurves.measured", "is empty", limit="at least one curve"
                )
            shape = (max((np.size(x) for x in over.values()), default=0),)
            for name, array in arrays.items():
                check_rows(
                    array,
                    shape,
                    f"MeasuredCurves.measured['{name}']",
                    problems,
                    missing="rows to leave out",
                    limit=f"{shape}, a number for each row of over",
                )
            known = arrays or {name: np.zeros(shape) for name in noise or {}}
            self.noise = noise_of(noise or {}, known, "MeasuredCurves.noise", problems) or None
        self.wheel = wheel
        self.driven = {
            name: jax.tree.map(device_array, by)
            for name, by in drive.items()
            if not isinstance(by, str)
        }
        self.order = tuple(
            (name, by if isinstance(by, str) else None) for name, by in drive.items()
        )
        self.over = {
            name: device_array(np.broadcast_to(x, shape) if concrete(x) is not None else x)
            for name, x in over.items()
        }
        self.measured = {name: device_array(array) for name, array in arrays.items()}

    @property
    def channels(self):
        return {name: NumberChannel(unit=curve_unit(name)) for name in self.names}

    def named(self):
        return {
            name: sensor for name, sensor in self.driven.items() if not isinstance(sensor, Wheel)
        }

    def on(self, before, after):
        def moved(wheel: Wheel) -> Wheel:
            for old, new in zip(before.wheels, after.wheels, strict=True):
                if wheel.on == old.on and (wheel.kingpin is None) == (old.kingpin is None):
                    # the wheels of an axle point to opposite sides
                    same = jnp.sum(wheel.axis * old.axis) > 0
                    wheel = jax.tree.map(
                        lambda now, old, new, same=same: now + jnp.where(same, new - old, 0.0),
                        wheel,
                        old,
                        new,
                    )
            return wheel

        is_wheel = lambda x: isinstance(x, Wheel)  # noqa: E731
        return jax.tree.map(lambda x: moved(x) if is_wheel(x) else x, self, is_leaf=is_wheel)

    @property
    def drive(self) -> dict[str, Any]:
        return {name: self.driven[name] if path is None else path for name, path in self.order}

    def check(self, model, where):
        with Problems() as problems:
            names = (
                problems.gather(
                    lambda: curve_names(model, self.drive, self.over, self.wheel, where)
                )
                or ()
            )
            missing = [name for name in self.names if names and name not in names]
            problems.collected += [unknown(name, f"{where}.measured", names) for name in missing]

    def _curves(self, model: Any):
        return suspension_curves(model, drive=self.drive, over=self.over, wheel=self.wheel)

    def readings(self, model, integration, lin):
        curves = self._curves(model)
        return {name: curves[name] for name in self.names}

    def explain(self, model, integration):
        return self._curves(model).report()

    def axis(self, channel):
        name, _ = self.order[0]
        return name, self.over[name], "m"

    def place(self, row):
        values = [(name, float(self.over[name][row])) for name, _ in self.order]
        return ", ".join(f"{name} = {value:.6g}" for name, value in values), values[0][1]
