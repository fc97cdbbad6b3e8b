"""sins_node: strapdown navigator and Kalman filter with the GNSS gate; odometry/filtered."""

from collections.abc import Sequence
from functools import partial

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.navigator.modes import LEVELLING
from nav_pose_estimator.engine.outage.methods.method import TrainingJob
from nav_pose_estimator.engine.solutions import NavSolution
from nav_pose_estimator.ros import inputs, services, spin
from nav_pose_estimator.ros.autopilot.link import autopilot_link
from nav_pose_estimator.ros.continuation.state_keeper import StateKeeper
from nav_pose_estimator.ros.estimator_node import EstimatorNode
from nav_pose_estimator.ros.outputs import NavigationOutput


def _leave_to_anfis_node(job: TrainingJob) -> None:
    """Training is the work of anfis_node; without it the navigator goes by the regimes of the flight alone."""


class SinsNode(EstimatorNode):
    """Works alone; an attitude on imu/data helps it to level, predicted errors on outage/velocity_error to coast."""

    def __init__(self) -> None:
        super().__init__("sins_node", partial(PoseEstimator, attitude=False, train=_leave_to_anfis_node))
        self._output = NavigationOutput(self, self.parameters)
        self._autopilot = autopilot_link(self, self.parameters)
        self.listen(inputs.imu(self.parameters), needed=True)
        for source in inputs.of_navigator(self.parameters):
            self.listen(self._autopilot.screened(source), needed=source.topic == "gps/fix")
        # wanted only until the filter runs
        self.listen(inputs.ATTITUDE, choose=lambda data: self.engine.mode in LEVELLING)
        self.listen(inputs.PREDICTION)
        services.offer_gnss(self)
        services.offer_coordinates(self)
        self._keeper = StateKeeper(self, self.engine, self.parameters.ros.state)
        self.get_logger().info("ready")

    def spare(self, flag: bool) -> None:
        """Rehearsals rest."""
        if self.engine.outage_aid is not None:
            self.engine.outage_aid.state.rests = flag

    def publish(self, solution: NavSolution) -> None:
        """Everything that the navigator knows."""
        self._output.publish_origin(solution.stamp_ns, self.engine.origin)
        self._output.publish(solution)
        self._autopilot.publish(solution)
        self._keeper.note(solution.stamp_ns)

    def destroy_node(self) -> None:
        """Also leave the state behind."""
        self._keeper.stop()
        super().destroy_node()


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return spin.run(SinsNode, arguments)
