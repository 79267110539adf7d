"""What `jaxbody.sensors` offers, written by `python tests/stubs.py`."""

from jaxbody.sensors.drive_sensors import DriveCommand as DriveCommand
from jaxbody.sensors.drive_sensors import DriveForce as DriveForce
from jaxbody.sensors.gauges import Displacement as Displacement
from jaxbody.sensors.gauges import LaserDistance as LaserDistance
from jaxbody.sensors.gauges import LaserVibrometer as LaserVibrometer
from jaxbody.sensors.gauges import StringPotentiometer as StringPotentiometer
from jaxbody.sensors.instruments import Accelerometer as Accelerometer
from jaxbody.sensors.instruments import BodyPose as BodyPose
from jaxbody.sensors.instruments import Elongation as Elongation
from jaxbody.sensors.instruments import ForcePlate as ForcePlate
from jaxbody.sensors.instruments import Gyro as Gyro
from jaxbody.sensors.instruments import Inclinometer as Inclinometer
from jaxbody.sensors.instruments import JointAngle as JointAngle
from jaxbody.sensors.instruments import LoadCell as LoadCell
from jaxbody.sensors.instruments import Orientation as Orientation
from jaxbody.sensors.instruments import Reaction as Reaction
from jaxbody.sensors.kinematic_sensors import Acceleration as Acceleration
from jaxbody.sensors.kinematic_sensors import AngularAcceleration as AngularAcceleration
from jaxbody.sensors.kinematic_sensors import AngularVelocity as AngularVelocity
from jaxbody.sensors.kinematic_sensors import Position as Position
from jaxbody.sensors.kinematic_sensors import Rotation as Rotation
from jaxbody.sensors.kinematic_sensors import Velocity as Velocity
from jaxbody.sensors.sensors import Sensor as Sensor
