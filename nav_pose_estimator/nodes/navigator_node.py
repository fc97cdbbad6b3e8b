"""What sins_node and pose_estimator have in common: the navigator's inputs, outputs, services and saved state."""

from collections.abc import Callable
from typing import Any

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.solutions import NavSolution
from nav_pose_estimator.ros import inputs, services
from nav_pose_estimator.ros.autopilot.link import autopilot_link
from nav_pose_estimator.ros.continuation.state_keeper import StateKeeper
from nav_pose_estimator.ros.estimator_node import EstimatorNode
from nav_pose_estimator.ros.outputs import NavigationOutput


class NavigatorNode(EstimatorNode):
    """A node around a ``PoseEstimator``. Subclasses call ``continue_flight`` when all else has been set up."""

    def __init__(self, name: str, make_engine: Callable[[Parameters], Any]) -> None:
        super().__init__(name, make_engine)
        self._navigation = NavigationOutput(self, self.parameters)
        self._autopilot = autopilot_link(self, self.parameters)
        self.listen(inputs.imu(self.parameters), needed=True)
        for source in inputs.of_navigator(self.parameters):
            self.listen(self._autopilot.screened(source), needed=source.topic == "gps/fix")
        services.offer_gnss(self)
        services.offer_coordinates(self)

    def continue_flight(self) -> None:
        """Go on from the state on disk, where there is one, and keep it from now on."""
        self._state_keeper = StateKeeper(self, self.engine, self.parameters.ros.state)

    def publish(self, solution: NavSolution) -> None:
        """Everything that the navigator knows."""
        self._navigation.publish_origin(solution.stamp_ns, self.engine.origin)
        self._navigation.publish(solution)
        self._autopilot.publish(solution)
        self._state_keeper.note(solution.stamp_ns)

    def spare(self, flag: bool) -> None:
        """Rehearsals rest."""
        if self.engine.outage_aid is not None:
            self.engine.outage_aid.state.rests = flag

    def destroy_node(self) -> None:
        """Also leave the state behind."""
        self._state_keeper.stop()
        super().destroy_node()
