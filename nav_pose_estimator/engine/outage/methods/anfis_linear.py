"""The network with one rule: ridge regression, the least that can be learned."""

from nav_pose_estimator.engine.outage.methods.anfis import Anfis, NetworkTraining
from nav_pose_estimator.engine.outage.methods.method import Array, TrainingJob, TrainingPlan


class AnfisLinear(Anfis):
    """As ``anfis``, but never more than one rule."""

    name = "anfis_linear"
    summary = "the network with one rule"

    def job(self, epochs: Array, plan: TrainingPlan) -> TrainingJob:
        """Train one rule."""
        return NetworkTraining(epochs, (1,))
