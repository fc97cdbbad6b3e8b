"""A learner that learns nothing, with the face of the real one: for tests of what stands around it."""

import os
import time
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import Prior, VelocityError
from nav_pose_estimator.engine.solutions import Mode, NavSolution
from nav_pose_estimator.errors import UserError


@dataclass(frozen=True)
class Job:
    """Gives back its number; or fails, dies or takes long."""

    number: int
    how: str = "well"

    def run(self) -> tuple[int, int]:
        if self.how == "fails":
            raise ZeroDivisionError("division\nby zero")
        if self.how == "dies":
            os._exit(3)
        if self.how == "hangs":
            time.sleep(3600.0)
        return self.number, os.getpid()


@dataclass
class FakeLearner:
    """Predicts a constant error while GNSS is denied, once it has been trained."""

    parameters: Parameters
    weight: float = 0.0
    jobs: list[Job] = field(default_factory=list)
    seen: list[NavSolution] = field(default_factory=list)
    results: list[tuple[int, int]] = field(default_factory=list)

    def feed(self, output: NavSolution) -> list[VelocityError | Prior]:
        self.seen.append(output)
        if output.mode is Mode.AIDED or self.reason:
            return []
        return [
            VelocityError(output.stamp_ns, (self.weight, -self.weight), np.diag([0.04, 0.09])),
            Prior(output.stamp_ns, "horizontal_position", (0.8, 0.1), np.eye(2)),
        ]

    def training_job(self) -> Job | None:
        return self.jobs.pop(0) if self.jobs else None

    def accept(self, result: tuple[int, int]) -> None:
        self.results.append(result)
        self.weight = float(result[0])

    def state(self) -> dict[str, np.ndarray]:
        return {"weight": np.array(self.weight)}

    def load(self, state: dict[str, np.ndarray]) -> None:
        if "weight" not in state:
            raise UserError("the file holds no weight")
        self.weight = float(state["weight"])

    def scores(self) -> dict[str, float]:
        return {"validation error": 1.0 / (1.0 + self.weight)}

    @property
    def reason(self) -> str:
        return "" if self.weight else "nothing has been learned yet"

    def reset(self) -> None:
        self.seen.clear()

    def copy(self) -> "FakeLearner":
        return FakeLearner(self.parameters, self.weight)
