"""The network with one rule: ridge regression, the least that can be learned."""

from nav_pose_estimator.engine.outage.methods.anfis import Anfis
from nav_pose_estimator.engine.outage.methods.method import TrainingPlan


class AnfisLinear(Anfis):
    """As ``anfis``, but never more than one rule."""

    name = "anfis_linear"
    summary = "the network with one rule"

    def rules(self, plan: TrainingPlan) -> tuple[int, ...]:
        """One."""
        return (1,)
