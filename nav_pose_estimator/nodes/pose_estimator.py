"""pose_estimator: attitude filter, navigator and learner in one process, with direct calls between them."""

from collections.abc import Sequence

from nav_pose_estimator.engine.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.solutions import AttitudeSolution, NavSolution
from nav_pose_estimator.ros import inputs, spin
from nav_pose_estimator.ros.estimator_node import EstimatorNode
from nav_pose_estimator.ros.outputs import AttitudeOutput, NavigationOutput


class PoseEstimatorNode(EstimatorNode):
    """The composed estimator: the engine that replay runs, fed from topics."""

    def __init__(self) -> None:
        super().__init__("pose_estimator", PoseEstimator)
        self._attitude = AttitudeOutput(self, self.parameters)
        self._navigation = NavigationOutput(self, self.parameters)
        self.listen_imu(inputs.imu_input(self.parameters.ros.input))
        for source in inputs.navigator_inputs(self.parameters):
            self.listen(source, needed=source.topic == "gps/fix")
        self.offer_gnss_switch()
        self.get_logger().info("ready")

    def publish(self, solution: AttitudeSolution | NavSolution) -> None:
        """Attitude and navigation on their topics."""
        if isinstance(solution, AttitudeSolution):
            self._attitude.publish(solution)
            return
        self._navigation.publish_origin(solution.stamp_ns, self.engine.origin)
        self._navigation.publish(solution)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return spin.run(PoseEstimatorNode, arguments)
