"""Parameters of the outage learning."""

from dataclasses import dataclass

from nav_pose_estimator.engine.outage.methods.registry import estimators
from nav_pose_estimator.engine.parameters.schema import param


def _describe_methods() -> str:
    return "; ".join(f"{name}: {method.summary}" for name, method in estimators().items())


@dataclass(frozen=True)
class LearnerParameters:
    """What helps the navigator through an outage."""

    enabled: bool = param(True, "", "Learn from the flight while GNSS is good and help the navigator without it")
    method: str = param("best", "", _describe_methods, choices=lambda: tuple(estimators()))
    window: float = param(600.0, "s", "How much of the most recent flight the network is trained on", 60.0, 600.0)
    period: float = param(30.0, "s", "Time between two trainings", 5.0, 600.0)
    rules: int = param(2, "", "Largest number of rules tried; more than one is used only where clearly better", 1, 8)
