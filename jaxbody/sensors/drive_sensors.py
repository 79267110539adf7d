"""Sensors of drives: the command that an actuator or controlled damper gets, and its force."""

import equinox as eqx
import jax.numpy as jnp

from jaxbody.core.arguments import plain
from jaxbody.model.forces.controllers import followed_at_once
from jaxbody.model.inputs.port_inputs import unknown_drive
from jaxbody.model.joints.frame_tables import commands, ends_at, reads_accelerations
from jaxbody.sensors.sensors import Sensor


class DriveSensor(Sensor):
    """The base class of sensors of drives."""

    on: str = eqx.field(static=True, converter=plain)
    shape, unit = (), "N"

    @property
    def names(self):
        return ()

    def problem(self, model, where):
        return unknown_drive(self.on, model, where)

    def needs_accelerations(self, model):
        return reads_accelerations(model)

    def follows_commands(self, model) -> bool:
        return True


class DriveCommand(DriveSensor):
    """The command [N] of a drive: its own and that of its controller.

    >>> jb.sensors.DriveCommand("actuator").unit
    'N'
    """

    def reading(self, model, frames):
        return model[self.on].command + commands(model, frames).get(self.on, jnp.zeros(()))


class DriveForce(DriveSensor):
    """The force [N] with which a drive pushes its two points apart.

    >>> jb.sensors.DriveForce("actuator").unit
    'N'
    """

    def needs_accelerations(self, model):
        return False

    def follows_commands(self, model):
        return self.on in followed_at_once(model)

    def reading(self, model, frames):
        drive, given = model[self.on], commands(model, frames, rates=False)
        u, ends = given.get(self.on, 0.0), ends_at(model, frames, drive)
        return drive.force(drive.seen(model, frames, ends, u, rates=False))[0]
