"""Sensors: the readings of instruments on bodies, with gain, bias, delay and lag."""

from jaxbody.core.compilation.late_imports import late_names

_NAMES = {
    "drive_sensors": ("DriveCommand", "DriveForce"),
    "gauges": ("Displacement", "LaserDistance", "LaserVibrometer", "StringPotentiometer"),
    "instruments": (
        "Accelerometer",
        "BodyPose",
        "Elongation",
        "ForcePlate",
        "Gyro",
        "Inclinometer",
        "JointAngle",
        "LoadCell",
        "Orientation",
        "Reaction",
    ),
    "kinematic_sensors": (
        "Acceleration",
        "AngularAcceleration",
        "AngularVelocity",
        "Position",
        "Rotation",
        "Velocity",
    ),
    "sensors": ("Sensor",),
}
__getattr__, __dir__, __all__ = late_names("jaxbody.sensors", _NAMES)
