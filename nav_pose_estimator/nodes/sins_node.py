"""sins_node: strapdown navigator and Kalman filter with the GNSS gate; odometry/filtered."""

from collections.abc import Sequence

from rclpy.serialization import deserialize_message
from sensor_msgs.msg import Imu

from nav_pose_estimator.engine.sins import SinsEngine
from nav_pose_estimator.engine.solutions import Mode, NavSolution
from nav_pose_estimator.ros import inputs, qos, spin
from nav_pose_estimator.ros.convert import Converted, imu_attitude
from nav_pose_estimator.ros.estimator_node import EstimatorNode
from nav_pose_estimator.ros.outputs import NavigationOutput

_LEVELLING = (Mode.WAITING_IMU, Mode.ALIGNING, Mode.NO_ORIGIN)


class SinsNode(EstimatorNode):
    """Works alone; an attitude on imu/data helps it to level."""

    def __init__(self) -> None:
        super().__init__("sins_node", SinsEngine)
        self._output = NavigationOutput(self, self.parameters)
        self.listen_imu(inputs.imu_input(self.parameters.ros.input))
        for source in inputs.navigator_inputs(self.parameters):
            self.listen(source, needed=source.topic == "gps/fix")
        watch = self.watch("imu/data", needed=False)
        qos.subscribe(
            self,
            Imu,
            "imu/data",
            lambda data: self.receive(watch, self._attitude, data),
            qos.sensor(self.parameters.ros.input.queue),
            raw=True,
        )
        self.offer_gnss_switch()
        self.get_logger().info("ready")

    def publish(self, solution: NavSolution) -> None:
        """Everything that the navigator knows."""
        self._output.publish_origin(solution.stamp_ns, self.engine.origin)
        self._output.publish(solution)

    def _attitude(self, data: bytes) -> Converted:
        """Wanted only until the filter runs: at hundreds of hertz the rest is not even read."""
        return imu_attitude(deserialize_message(data, Imu)) if self.engine.mode in _LEVELLING else ()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return spin.run(SinsNode, arguments)
