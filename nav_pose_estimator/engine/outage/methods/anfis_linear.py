"""The network with a single rule: ridge regression, the simplest learned law."""

from nav_pose_estimator.engine.outage.methods.anfis import Anfis
from nav_pose_estimator.engine.outage.methods.method import TrainingPlan


class AnfisLinear(Anfis):
    """``anfis`` with one rule."""

    name = "anfis_linear"
    summary = "the network with one rule"

    def rules(self, plan: TrainingPlan) -> tuple[int, ...]:
        """One."""
        return (1,)
