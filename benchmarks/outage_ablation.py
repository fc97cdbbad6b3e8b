# ruff: noqa: E402
"""What each part of the help in an outage is worth: the outage benchmark with one part changed at a time.

    python benchmarks/outage_ablation.py BAG... [--every 20] [--lengths 30,60] [--variants best,one_rule,...]

Every variant runs on the same outages. The literal reading of the source text is among them: a network that learns the
Kalman filter's own position corrections (CN113777645A, claim 3) and subtracts what it predicts.
"""

import os

for _name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ[_name] = "1"  # before numpy is imported

import argparse
import tempfile
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
import yaml

from nav_pose_estimator import Anfis
from nav_pose_estimator.core.motion import air_velocity as outage_learning
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion import wind
from nav_pose_estimator.core.motion.air_velocity import AirVelocityModel, inputs
from nav_pose_estimator.engine.navigator import branches
from nav_pose_estimator.engine.outage import epochs
from nav_pose_estimator.engine.outage import learner as outage_learner
from nav_pose_estimator.engine.outage import rehearsals as virtual_outages
from nav_pose_estimator.offline.benchmarks.outage.benchmark import Task, run_task


class LiteralNetwork:
    """The filter's position correction of an epoch, learned from the ten inputs of the source text; as a velocity."""

    rules = 4
    corrections: dict[float, np.ndarray]  # end of an epoch -> all corrections so far, ENU [m]

    def __init__(self, learned: np.ndarray) -> None:
        wanted = np.array([self._increment(one) for one in learned])
        self.network = Anfis(rules=4, partition="fcm", iterations=20).fit(self._inputs(learned), wanted)

    def _inputs(self, some: np.ndarray) -> np.ndarray:
        yaw = np.arctan2(some[:, me.ATTITUDE + 3], some[:, me.ATTITUDE])
        return np.column_stack([some[:, me.VELOCITY : me.POSITION], np.cos(yaw), np.sin(yaw)])

    def _increment(self, one: np.ndarray) -> np.ndarray:
        now = self.corrections.get(one[me.TIME])
        before = self.corrections.get(one[me.TIME] - me.PERIOD)
        return np.zeros(3) if now is None or before is None else (now - before) / me.PERIOD

    def velocity(self, one: np.ndarray) -> np.ndarray:
        """Velocity in b (3,): that of the navigator less the predicted error. A correction is minus the error."""
        error = -self.network.predict(self._inputs(one[None]))[0]
        return one[me.BODY_VELOCITY : me.VELOCITY] - me.attitude(one[None])[0].T @ error


def literal_model(learned: np.ndarray, rules: tuple[int, ...] = (1,)) -> AirVelocityModel:
    """The usual model with the literal network in the place of its own, and no wind."""
    model = outage_learning.learn_air_velocity(learned, (1,))
    network, still = LiteralNetwork(learned), np.zeros(2)
    literal = _LiteralModel(**{**vars(model), "network": network, "wind_mean": still, "wind": still})
    known = {"errors": {network.rules: model.errors[1]}, "wind_cov": np.zeros((2, 2)), "wind_spread": 1e-6}
    return replace(literal, noise=np.full(3, 0.1), hover_noise=np.full(3, 0.1), **known)


class _LiteralModel(AirVelocityModel):
    def predict(self, epoch: np.ndarray) -> tuple[np.ndarray, float]:
        return self.network.velocity(epoch), 1.0  # type: ignore[attr-defined]

    def follow(self, epoch: np.ndarray) -> AirVelocityModel:
        return self


@contextmanager
def literal() -> Iterator[None]:
    """Train on the filter's corrections instead of on the motion."""
    LiteralNetwork.corrections = {}
    feed = epochs.EpochCollector.feed

    def noting(self: Any, output: Any) -> Any:
        finished = feed(self, output)
        if finished is not None:
            LiteralNetwork.corrections[finished[0][me.TIME]] = output.correction_enu.copy()
        return finished

    with (
        patch.object(epochs.EpochCollector, "feed", noting),
        patch.object(outage_learner, "learn_air_velocity", literal_model),
    ):
        yield


def without_wind(self: AirVelocityModel, epoch: np.ndarray) -> AirVelocityModel:
    """No standby offset: the wind stays what it was on average."""
    return replace(self, wind=np.zeros(2))


_inputs = inputs


def without_force(some: np.ndarray) -> np.ndarray:
    """Inputs in which the network does not feel drag."""
    x = _inputs(some)
    x[:, :3] = 0.0
    return x


VARIANTS: dict[str, tuple[dict[str, Any], list[Any]]] = {
    "best": ({}, []),
    "literal": ({"method": "anfis"}, [literal]),
    "no prior": ({"method": "anfis"}, []),  # nothing is expected of the speed: the network alone
    "regimes alone": ({}, [lambda: patch.object(outage_learner, "_NETWORK_METHODS", frozenset())]),
    "one rule": ({"rules": 1}, []),
    "four rules": ({"rules": 4}, []),
    "no standby offset": ({}, [lambda: patch.object(AirVelocityModel, "follow", without_wind)]),
    "no drag": ({}, [lambda: patch.object(outage_learning, "inputs", without_force)]),
    "axes alike": ({}, [lambda: patch.object(wind, "_weights", np.ones_like)]),
    "stated drift": ({}, [lambda: patch.object(virtual_outages, "_SMALLEST_VARIANCE", 1.0)]),
    "free entry": ({}, [lambda: patch.object(branches, "_UNMODELLED", 1e9)]),
    "certain at once": ({}, [lambda: patch.object(branches, "_CORRELATION", me.PERIOD)]),
    "velocity prior": ({"method": "velocity_prior"}, []),
    "drag": ({"method": "drag"}, []),
    "coast": ({"enabled": False}, []),
}
"""Name -> (learner parameters, context managers that change one part)."""


def run(name: str, bags: list[Path], lengths: tuple[float, ...], every: float) -> dict[float, list[float]]:
    """End errors [m] of one variant at each length, over all bags."""
    settings, changes = VARIANTS[name]
    errors: dict[float, list[float]] = {length: [] for length in lengths}
    with ExitStack() as stack, tempfile.TemporaryDirectory() as folder:
        for change in changes:
            stack.enter_context(change())
        config = Path(folder) / "variant.yaml"
        parameters = {f"learner.{key}": value for key, value in settings.items() if key != "method"}
        config.write_text(yaml.safe_dump({"/**": {"ros__parameters": parameters}}), encoding="utf-8")
        method = "coast" if name == "coast" else settings.get("method", "best")
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
