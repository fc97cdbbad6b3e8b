"""Test doubles of learners: jobs with a given outcome, and a model with constant output."""

import os
import time
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.errors import UserError


@dataclass(frozen=True)
class Job:
    """Job that returns its number and its process id, or fails, dies or takes long."""

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
class State:
    """Of a learner."""

    reason: str = "nothing has been learned yet"
    trainings: int = 0


@dataclass
class Learner:
    """The part of the interface of ``OutageLearner`` that a node needs."""

    weight: float = 0.0
    state: State = field(default_factory=State)
    next_job: Job | None = None

    def warm_up(self) -> None:
        """There is nothing to compile."""

    def job(self) -> Job | None:
        return self.next_job

    def arrays(self) -> dict[str, np.ndarray]:
        return {"weight": np.array(self.weight)}

    def load(self, state: dict[str, np.ndarray]) -> None:
        if "weight" not in state:
            raise UserError("the file holds no weight")
        self.weight = float(state["weight"])

    def scores(self) -> dict[str, float]:
        return {"validation error": 1.0 / (1.0 + self.weight)}


@dataclass
class Pupil:
    """Owner of a learner, which receives results."""

    learner: Learner = field(default_factory=Learner)
    results: list[tuple[int, int]] = field(default_factory=list)

    def accept(self, result: tuple[int, int]) -> None:
        self.results.append(result)
        self.learner.weight, self.learner.state.reason = float(result[0]), ""
        self.learner.state.trainings += 1


@dataclass
class StillAir:
    """A model that always predicts rest in still air."""

    noise: np.ndarray = field(default_factory=lambda: np.array([0.04, 0.09, 0.16]))
    hover_noise: np.ndarray = field(default_factory=lambda: np.ones(3))
    wind_mean: np.ndarray = field(default_factory=lambda: np.zeros(2))
    wind: np.ndarray = field(default_factory=lambda: np.zeros(2))
    wind_cov: np.ndarray = field(default_factory=lambda: np.zeros((2, 2)))
    wind_spread: float = 0.0

    def predict(self, epoch: np.ndarray) -> tuple[np.ndarray, float]:
        return np.zeros(3), 1.0

    def follow(self, epoch: np.ndarray) -> "StillAir":
        return self
