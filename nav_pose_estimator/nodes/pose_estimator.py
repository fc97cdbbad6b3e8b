"""pose_estimator: attitude filter, navigator and learner in one process, with direct calls between them."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.solutions import AttitudeSolution, NavSolution, PredictedDrift, Status
from nav_pose_estimator.ros import inputs, services, spin, wording
from nav_pose_estimator.ros.autopilot.link import autopilot_link
from nav_pose_estimator.ros.continuation.state_keeper import StateKeeper
from nav_pose_estimator.ros.estimator_node import EstimatorNode
from nav_pose_estimator.ros.model_keeper import ModelKeeper
from nav_pose_estimator.ros.outputs import AttitudeOutput, LearnerOutput, NavigationOutput
from nav_pose_estimator.ros.training import Trainer


class PoseEstimatorNode(EstimatorNode):
    """The composed estimator: the engine that replay runs, fed from topics."""

    published = (NavSolution, AttitudeSolution, PredictedDrift)

    def __init__(self) -> None:
        trainer = Trainer()
        super().__init__("pose_estimator", partial(PoseEstimator, train=trainer.submit))
        self._attitude = AttitudeOutput(self, self.parameters)
        self._navigation = NavigationOutput(self, self.parameters)
        self._autopilot = autopilot_link(self, self.parameters)
        self.listen(inputs.imu(self.parameters), needed=True)
        for source in inputs.of_navigator(self.parameters):
            self.listen(self._autopilot.screened(source), needed=source.topic == "gps/fix")
        services.offer_gnss(self)
        services.offer_coordinates(self)
        self._learned, pupil = LearnerOutput(self, self.parameters), self.engine.outage_aid
        model = self.parameters.ros.model
        self.keeper = None if pupil is None else ModelKeeper(self, pupil, trainer, model, self.say)
        self._keeper = StateKeeper(self, self.engine, self.parameters.ros.state)
        self.get_logger().info("ready")

    def describe(self, status: Status) -> tuple[int, str, list[tuple[str, str]]]:
        """As every node, and what the learner says."""
        level, sentence, facts = super().describe(status)
        if self.keeper is None:
            return level, sentence, facts
        aid = self.engine.outage_aid
        learner = replace(status, waiting_for=aid.learner.state.reason, values=aid.status())
        return level, sentence, facts + wording.learner_facts(learner, self.keeper.training, self.keeper.history)[1:]

    def destroy_node(self) -> None:
        """Also leave the state behind, and end a training."""
        self._keeper.stop()
        if self.keeper is not None:
            self.keeper.stop()
        super().destroy_node()

    def spare(self, flag: bool) -> None:
        """Rehearsals rest."""
        if self.engine.outage_aid is not None:
            self.engine.outage_aid.state.rests = flag

    def publish(self, solution: AttitudeSolution | NavSolution | PredictedDrift) -> None:
        """Attitude, navigation and predictions on their topics."""
        if isinstance(solution, PredictedDrift):
            self._learned.publish(solution)
            return
        if isinstance(solution, AttitudeSolution):
            self._attitude.publish(solution)
            return
        self._navigation.publish_origin(solution.stamp_ns, self.engine.origin)
        self._navigation.publish(solution)
        self._autopilot.publish(solution)
        self._keeper.note(solution.stamp_ns)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; returns the exit code."""
    return spin.run(PoseEstimatorNode, arguments)
