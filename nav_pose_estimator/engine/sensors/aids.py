"""List of the sensors other than GNSS. A new one is a file beside this one and a line here."""

from nav_pose_estimator.engine.sensors.airspeed import AirspeedSensor
from nav_pose_estimator.engine.sensors.barometer import Barometer, DepthSensor
from nav_pose_estimator.engine.sensors.beam_velocity import BeamVelocitySensor
from nav_pose_estimator.engine.sensors.body_velocity import BodyVelocitySensor
from nav_pose_estimator.engine.sensors.composed_position import ComposedPositionSensor
from nav_pose_estimator.engine.sensors.ground_range import GroundRange
from nav_pose_estimator.engine.sensors.magnetometer import Magnetometer
from nav_pose_estimator.engine.sensors.sensor import Aid

AIDS: tuple[type[Aid], ...] = (
    Magnetometer,
    Barometer,
    DepthSensor,
    BodyVelocitySensor,
    BeamVelocitySensor,
    AirspeedSensor,
    GroundRange,
    ComposedPositionSensor,
)
