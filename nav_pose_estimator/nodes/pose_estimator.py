"""pose_estimator: attitude filter, navigator and learner in one process, connected by direct calls."""

from collections.abc import Sequence
from dataclasses import replace
from functools import partial

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.solutions import AttitudeSolution, NavSolution, PredictedDrift, Status
from nav_pose_estimator.nodes.navigator_node import NavigatorNode
from nav_pose_estimator.ros import spin, wording
from nav_pose_estimator.ros.model_keeper import ModelKeeper
from nav_pose_estimator.ros.outputs import AttitudeOutput, LearnerOutput
from nav_pose_estimator.ros.training import Trainer


class PoseEstimatorNode(NavigatorNode):
    """The composed estimator, with the same engine as replay."""

    published = (NavSolution, AttitudeSolution, PredictedDrift)

    def __init__(self) -> None:
        trainer = Trainer()
        super().__init__("pose_estimator", partial(PoseEstimator, train=trainer.submit))
        self._attitude = AttitudeOutput(self, self.parameters)
        self._learned, aid = LearnerOutput(self, self.parameters), self.engine.outage_aid
        model = self.parameters.ros.model
        self.model_keeper = None if aid is None else ModelKeeper(self, aid, trainer, model, self.say)
        self.continue_flight()
        self.get_logger().info("ready")

    def describe(self, status: Status) -> wording.Description:
        """Level, sentence and facts, including those of the learner."""
        level, sentence, facts = super().describe(status)
        keeper, aid = self.model_keeper, self.engine.outage_aid
        if keeper is None:
            return level, sentence, facts
        learner = replace(status, waiting_for=aid.learner.state.reason, values=aid.status())
        return level, sentence, facts + wording.learner_facts(learner, keeper.training, keeper.history)[1:]

    def destroy_node(self) -> None:
        """Destroy the node after ending a running training."""
        if self.model_keeper is not None:
            self.model_keeper.stop()
        super().destroy_node()

    def publish(self, solution: AttitudeSolution | NavSolution | PredictedDrift) -> None:
        """Publish an attitude, a navigation solution or a prediction on its topics."""
        if isinstance(solution, PredictedDrift):
            self._learned.publish(solution)
        elif isinstance(solution, AttitudeSolution):
            self._attitude.publish(solution)
        else:
            super().publish(solution)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the node; return the exit code."""
    return spin.run(PoseEstimatorNode, arguments)
