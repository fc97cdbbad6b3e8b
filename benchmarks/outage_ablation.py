# ruff: noqa: E402
"""Ablation of the aiding in an outage: the outage benchmark with one part changed at a time.

    python benchmarks/outage_ablation.py BAG... [--every 20] [--lengths 30,60] [--variants "best,one rule,..."]

Every variant is a separate method, registered with those of the package; all run on the same outages. One of them is
the literal method of the patent: a network that learns the Kalman filter's position corrections (CN113777645A, claim
3), and subtracts its predictions.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse
import tempfile
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from nav_pose_estimator import Anfis as Network
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel, learn_air_velocity
from nav_pose_estimator.engine.outage.methods.anfis import Anfis
from nav_pose_estimator.engine.outage.methods.best import Best
from nav_pose_estimator.engine.outage.methods.method import (
    Advice,
    Flight,
    Guide,
    RehearsalRules,
    TrainingJob,
    TrainingPlan,
    TrainingResult,
)
from nav_pose_estimator.engine.outage.methods.registry import registered
from nav_pose_estimator.engine.samples import VelocityError
from nav_pose_estimator.engine.solutions import NavBlock, NavSolution
from nav_pose_estimator.offline.benchmarks.outage.trials import Task, run_task


@dataclass(frozen=True)
class ChangedTraining:
    """A training with one part changed: ``train`` creates the model from the epochs of ``job``."""

    job: Any
    train: Callable[[np.ndarray, tuple[int, ...]], AirVelocityModel]

    @property
    def until(self) -> float:
        return self.job.until

    def run(self) -> TrainingResult:
        return TrainingResult(self.train(self.job.epochs, self.job.rules), self.until)


class LiteralNetwork:
    """The filter's position correction of an epoch as a velocity, learned from the ten inputs of the patent."""

    rules = 4

    def __init__(self, learned: np.ndarray) -> None:
        """``learned`` (N, COLUMNS + 3): epochs and the sum of all corrections so far, ENU [m]."""
        increments = np.diff(learned[:, me.COLUMNS :], axis=0, prepend=learned[:1, me.COLUMNS :]) / me.PERIOD
        increments[np.diff(learned[:, me.TIME], prepend=-np.inf) > 1.5 * me.PERIOD] = 0.0  # after a gap
        self.network = Network(rules=4, partition="fcm", iterations=20).fit(self._inputs(learned), increments)

    def _inputs(self, some: np.ndarray) -> np.ndarray:
        yaw = np.arctan2(some[:, me.ATTITUDE + 3], some[:, me.ATTITUDE])
        return np.column_stack([some[:, me.VELOCITY : me.POSITION], np.cos(yaw), np.sin(yaw)])

    def velocity(self, one: np.ndarray) -> np.ndarray:
        """Velocity (3,) [m/s] in b: the navigator's minus the predicted error. A correction is minus the error."""
        error = -self.network.predict(self._inputs(one[None]))[0]
        return one[me.BODY_VELOCITY : me.VELOCITY] - me.attitude(one[None])[0].T @ error


class LiteralModel(AirVelocityModel):
    """The usual model with the literal network instead of its own, and without wind."""

    def predict(self, epoch: np.ndarray) -> tuple[np.ndarray, float]:
        return self.network.velocity(epoch), 1.0  # type: ignore[attr-defined]

    def follow(self, epoch: np.ndarray) -> AirVelocityModel:
        return self


class Literal(Anfis):
    """Trains on the filter's corrections instead of on the motion."""

    name = "literal"

    def columns(self, output: NavBlock | NavSolution, rows: np.ndarray) -> np.ndarray:
        return output.correction_enu

    def job(self, epochs: np.ndarray, plan: TrainingPlan) -> TrainingJob:
        return ChangedTraining(super().job(epochs, plan), self._train)

    def _train(self, learned: np.ndarray, rules: tuple[int, ...]) -> AirVelocityModel:
        model = learn_air_velocity(learned)
        network, still = LiteralNetwork(learned), np.zeros(2)
        no_wind = {"wind_mean": still, "wind": still, "wind_cov": np.zeros((2, 2)), "wind_spread": 1e-6}
        noise = {"noise": np.full(3, 0.1), "hover_noise": np.full(3, 0.1)}
        own = {"network": network, "errors": {network.rules: model.errors[1]}, **no_wind, **noise}
        return LiteralModel(**{**vars(model), **own})


class RegimesAlone(Best):
    """No network."""

    name = "regimes alone"
    trains = False


class MeanWindModel(AirVelocityModel):
    """The wind remains at its mean."""

    def follow(self, epoch: np.ndarray) -> AirVelocityModel:
        return replace(self, wind=np.zeros(2))


def without_force(some: np.ndarray) -> np.ndarray:
    """Epochs (..., COLUMNS) without specific force."""
    blind = some.copy()
    blind[..., me.FORCE : me.RATE] = 0.0
    return blind


class BlindModel(AirVelocityModel):
    """A network without specific force as input, and so without drag."""

    def predict(self, epoch: np.ndarray) -> tuple[np.ndarray, float]:
        return super().predict(without_force(epoch))

    def follow(self, epoch: np.ndarray) -> AirVelocityModel:
        return super().follow(without_force(epoch))


class Retrained(Best):
    """``best`` with another training of the network."""

    def __init__(self, name: str, train: Callable[[np.ndarray, tuple[int, ...]], AirVelocityModel]) -> None:
        self.name, self._train = name, train

    def job(self, epochs: np.ndarray, plan: TrainingPlan) -> TrainingJob:
        return ChangedTraining(super().job(epochs, plan), self._train)


def with_mean_wind(epochs: np.ndarray, rules: tuple[int, ...]) -> AirVelocityModel:
    """Changes of the wind are not tracked."""
    return MeanWindModel(**vars(learn_air_velocity(epochs, rules)))


def blind(epochs: np.ndarray, rules: tuple[int, ...]) -> AirVelocityModel:
    """The network has no specific force as input."""
    return BlindModel(**vars(learn_air_velocity(without_force(epochs), rules)))


def with_axes_alike(epochs: np.ndarray, rules: tuple[int, ...]) -> AirVelocityModel:
    """All body axes have the same weight for the wind."""
    return learn_air_velocity(epochs, rules, weigh=np.ones_like)


class StatedDrift(Best):
    """The filter's covariance is never reduced by rehearsals."""

    name = "stated drift"
    rehearsal = RehearsalRules(smallest_variance=1.0)


@dataclass(frozen=True)
class ChangedGuide:
    """A guide whose evidence has some fields changed."""

    guide: Guide
    fields: dict[str, Any]

    def advise(self, stamp_ns: int, recent: np.ndarray, external: VelocityError | None = None) -> Advice:
        advice = self.guide.advise(stamp_ns, recent, external)
        return replace(advice, samples=tuple(replace(sample, **self.fields) for sample in advice.samples))


class ChangedEvidence(Best):
    """``best`` with evidence in which ``fields`` are changed."""

    def __init__(self, name: str, **fields: float) -> None:
        self.name, self._fields = name, fields

    def ways(self, flight: Flight) -> dict[str, Guide]:
        return {name: ChangedGuide(guide, self._fields) for name, guide in super().ways(flight).items()}


CHANGED = (
    Literal(),
    RegimesAlone(),
    Retrained("no standby offset", with_mean_wind),
    Retrained("no drag", blind),
    Retrained("axes alike", with_axes_alike),
    StatedDrift(),
    ChangedEvidence("free entry", unmodelled_var=1e9),  # a hover begins for free
    ChangedEvidence("certain at once", correlation=me.PERIOD),  # every half second is independent evidence
)
VARIANTS: dict[str, tuple[str, dict[str, Any]]] = {
    "best": ("best", {}),
    "literal": ("literal", {}),
    "no prior": ("anfis", {}),  # no prior of the speed: the network alone
    "regimes alone": ("regimes alone", {}),
    "one rule": ("best", {"learner.rules": 1}),
    "four rules": ("best", {"learner.rules": 4}),
    **{method.name: (method.name, {}) for method in CHANGED[2:]},
    "velocity prior": ("velocity_prior", {}),
    "drag": ("drag", {}),
    "coast": ("coast", {}),
}
"""(method, further parameters) by name."""


def run(name: str, bags: list[Path], lengths: tuple[float, ...], every: float) -> dict[float, list[float]]:
    """End errors [m] of one variant at each length, over all bags."""
    method, parameters = VARIANTS[name]
    errors: dict[float, list[float]] = {length: [] for length in lengths}
    with registered(*CHANGED), tempfile.TemporaryDirectory() as folder:
        config = Path(folder) / "variant.yaml"
        config.write_text(yaml.safe_dump({"/**": {"ros__parameters": parameters}}), encoding="utf-8")
        for bag in bags:
            result = run_task(Task(bag, method, (), lengths, every, config=config if parameters else None))
            for (_, length), judged in result.errors.items():
                errors[length] += [one.end_error_m for one in judged if np.isfinite(one.end_error_m)]
    return errors


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("bags", nargs="+", type=Path)
    parser.add_argument("--every", type=float, default=20.0, help="seconds between outages")
    parser.add_argument("--lengths", default="30,60")
    parser.add_argument("--variants", default=",".join(VARIANTS))
    arguments = parser.parse_args()
    lengths = tuple(float(text) for text in arguments.lengths.split(","))
    print("| variant | " + " | ".join(f"{length:g} s, median / RMS (n)" for length in lengths) + " |", flush=True)
    print("|---|" + "---|" * len(lengths))
    for name in arguments.variants.split(","):
        errors = run(name, arguments.bags, lengths, arguments.every)
        cells = []
        for length in lengths:
            values = np.array(errors[length])
            cells.append(f"{np.median(values):.1f} / {np.sqrt(np.mean(values**2)):.1f} ({len(values)})")
        print(f"| {name} | " + " | ".join(cells) + " |", flush=True)


if __name__ == "__main__":
    main()
