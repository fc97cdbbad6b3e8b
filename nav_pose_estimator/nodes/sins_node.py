"""sins_node: strapdown navigator and Kalman filter with the GNSS gate; odometry/filtered."""

from collections.abc import Sequence
from functools import partial

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.navigator.modes import LEVELLING
from nav_pose_estimator.engine.outage.methods.method import TrainingJob
from nav_pose_estimator.nodes.navigator_node import NavigatorNode
from nav_pose_estimator.ros import inputs, spin


def _leave_to_anfis_node(job: TrainingJob) -> None:
    """Training is the work of anfis_node; without it the navigator goes by the regimes of the flight alone."""


class SinsNode(NavigatorNode):
    """Works alone; an attitude on imu/data helps it to level, predicted errors on outage/velocity_error to coast."""

    def __init__(self) -> None:
        super().__init__("sins_node", partial(PoseEstimator, attitude=False, train=_leave_to_anfis_node))
        # wanted only until the filter runs
        self.listen(inputs.ATTITUDE, choose=lambda data: self.engine.mode in LEVELLING)
        self.listen(inputs.PREDICTION)
        self.continue_flight()
        self.get_logger().info("ready")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return spin.run(SinsNode, arguments)
