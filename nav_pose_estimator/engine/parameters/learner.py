"""Parameters of the outage learning."""

from dataclasses import dataclass

from nav_pose_estimator.core.motion.vehicle_class import CLASSES, UNKNOWN
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
    vehicle_class: str = param(
        UNKNOWN,
        "",
        "What the vehicle is, where known; a fixed wing is never taken to hover",
        choices=(UNKNOWN, *CLASSES),
    )
    airframe: str = param("", "", "File by train: what flights of the past say of this one; empty for none")
    airframe_seconds: float = param(
        30.0, "s", "How much flight the archive of the file is worth at the start", 0.0, 600.0
    )
    airframe_fades: float = param(150.0, "s", "Motion of this flight after which the archive is not used", 1.0, 1e4)
    prior: str = param("", "", "File by train prior: how vehicles usually move; empty for the one of the package")
    rules: int = param(2, "", "Largest number of rules tried; more than one is used only where clearly better", 1, 8)
