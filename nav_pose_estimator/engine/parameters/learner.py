"""Parameters of the outage learning."""

from dataclasses import dataclass

from nav_pose_estimator.core.motion.airframe import FADES, WORTH
from nav_pose_estimator.core.motion.vehicle_class import CLASSES, UNKNOWN
from nav_pose_estimator.engine.outage.methods.registry import estimators
from nav_pose_estimator.engine.parameters.schema import param


def _describe_methods() -> str:
    return "; ".join(f"{name}: {method.summary}" for name, method in estimators().items())


@dataclass(frozen=True)
class LearnerParameters:
    """The learning that aids the navigator during an outage."""

    enabled: bool = param(True, "", "Learn from the flight while GNSS is good and help the navigator without it")
    method: str = param("best", "", _describe_methods, choices=lambda: tuple(estimators()))
    window: float = param(600.0, "s", "Length of the most recent flight that the network is trained on", 60.0, 600.0)
    period: float = param(30.0, "s", "Time between two trainings", 5.0, 600.0)
    vehicle_class: str = param(
        UNKNOWN,
        "",
        "Class of the vehicle, if known; a fixed wing is never taken to hover",
        choices=(UNKNOWN, *CLASSES),
    )
    airframe: str = param("", "", "File made by train: what past flights show of this vehicle; empty: none")
    airframe_seconds: float = param(
        WORTH, "s", "How much flight the file is worth at the start; three times as much if of one aircraft", 0.0, 600.0
    )
    airframe_fades: float = param(
        FADES, "s", "Motion of this flight after which the file is not used any more", 1.0, 1e4
    )
    prior: str = param("", "", "File made by train prior: how vehicles usually move; empty: that of the package")
    rules: int = param(2, "", "Largest number of rules tried; more than one is used only where clearly better", 1, 8)
