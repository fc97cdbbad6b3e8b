"""sins_node: strapdown navigator with Kalman filter and GNSS gate, published on odometry/filtered."""

from collections.abc import Sequence
from functools import partial

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.navigator.modes import LEVELLING
from nav_pose_estimator.engine.outage.methods.method import TrainingJob
from nav_pose_estimator.nodes.navigator_node import NavigatorNode
from nav_pose_estimator.ros import inputs, spin


def _leave_to_anfis_node(job: TrainingJob) -> None:
    """Discard ``job``: anfis_node does the training. Without it, coasting uses only the regimes of the flight."""


class SinsNode(NavigatorNode):
    """Works alone. An attitude on imu/data supports levelling, and predictions on outage/velocity_error coasting."""

    def __init__(self) -> None:
        super().__init__("sins_node", partial(PoseEstimator, attitude=False, train=_leave_to_anfis_node))
        # the attitude is only needed until the filter runs
        self.listen(inputs.ATTITUDE, choose=lambda data: self.engine.mode in LEVELLING)
        self.listen(inputs.PREDICTION)
        self.continue_flight()
        self.get_logger().info("ready")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return spin.run(SinsNode, arguments)
