"""attitude_node: orientation from gyroscope, accelerometer and magnetometer; imu/data."""

from collections.abc import Sequence
from dataclasses import replace

from nav_msgs.msg import Odometry
from sensor_msgs.msg import NavSatFix
from std_msgs.msg import Bool

from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.samples import GnssFix, NavigatorVelocity
from nav_pose_estimator.engine.sensors.magnetic.declination import located
from nav_pose_estimator.engine.solutions import AttitudeSolution, Event, Level, Status
from nav_pose_estimator.ros import inputs, qos, spin, wording
from nav_pose_estimator.ros.estimator_node import EstimatorNode
from nav_pose_estimator.ros.messages.cdr import peek_stamp_ns
from nav_pose_estimator.ros.messages.convert import Converted, nav_sat_fix, odometry_velocity
from nav_pose_estimator.ros.outputs import AttitudeOutput
from nav_pose_estimator.ros.pace import Pace

_VELOCITY_RATE = 10.0  # Hz: how often the navigator's velocity is looked at


class AttitudeNode(EstimatorNode):
    """Works alone; with the navigator's odometry or a body velocity it also separates acceleration from gravity."""

    def __init__(self) -> None:
        super().__init__("attitude_node", AttitudeEngine)
        self._output = AttitudeOutput(self, self.parameters)
        self._denied = True  # until the navigator says that GNSS aids it
        self._velocity_pace = Pace(_VELOCITY_RATE)
        self.listen(inputs.imu(self.parameters), needed=True)
        self.listen(inputs.magnetometer(self.parameters))
        self.listen(inputs.body_velocity(self.parameters))
        odometry = replace(inputs.ODOMETRY, adapter=self._velocity)
        self.listen(odometry, choose=lambda data: self._velocity_pace.is_due(peek_stamp_ns(data)))
        qos.subscribe(self, Bool, "gnss/denied", self._on_denied, qos.latched())
        if self.parameters.aids.declination_from_model:
            qos.subscribe(self, NavSatFix, "sins_node/origin", self._on_origin, qos.latched())
        self.get_logger().info("ready")

    def describe(self, status: Status) -> wording.Description:
        """As in every node, but modes are those of the attitude filter."""
        return wording.level_of(status), wording.sentence(status, wording.ATTITUDE_MEANINGS), wording.facts(status)

    def publish(self, solution: AttitudeSolution) -> None:
        """imu/data."""
        self._output.publish(solution)

    def _velocity(self, message: Odometry) -> Converted:
        return tuple(
            replace(item, valid=item.valid and not self._denied) if isinstance(item, NavigatorVelocity) else item
            for item in odometry_velocity(message)
        )

    def _on_denied(self, message: Bool) -> None:
        self._denied = message.data

    def _on_origin(self, message: NavSatFix) -> None:
        """The first trusted position of sins_node gives the declination; remap the name for another navigator."""
        for sample in nav_sat_fix(message):
            if isinstance(sample, GnssFix):
                self.engine.set_declination(located(self.parameters, sample, self._tell).aids.declination)

    def _tell(self, stamp_ns: int, name: str, level: Level, text: str) -> None:
        self.logbook.note(Event(stamp_ns, name, level, text))


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return spin.run(AttitudeNode, arguments)
