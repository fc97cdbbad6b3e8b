"""The learner behind topics: the engine of anfis_node. Odometry in, predicted velocity errors out."""

from collections.abc import Callable
from typing import Any

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuSample, Prior, VelocityError
from nav_pose_estimator.engine.solutions import Event, Level, Mode, NavSolution, Status
from nav_pose_estimator.ros.navigator_watch import NavigatorWatch, OdometrySample

_LONGEST_STEP = 2.0  # s: predictions further apart do not belong to one outage


class OutageModel:
    """Feeds ``learner`` (``engine.outage_learner``) with what the navigator publishes.

    Priors of the velocity become velocity errors, for which there is a topic; priors of the position are counted.
    """

    def __init__(self, parameters: Parameters, make_learner: Callable[[Parameters], Any]) -> None:
        self.learner = make_learner(parameters)
        self.watch = NavigatorWatch(parameters)
        self.position_error = np.zeros(2)  # m, East and North: the predicted velocity errors of this outage, summed up
        self.is_training = False
        self._last: VelocityError | None = None

    def feed(self, sample: ImuSample | OdometrySample) -> list[VelocityError | Event]:
        """What follows from one sample."""
        if isinstance(sample, ImuSample):
            return list(self.watch.imu(sample))
        solution = self.watch.odometry(sample)
        if solution is None:
            return []
        outputs = [_as_velocity_error(item, solution) for item in self.learner.feed(solution)]
        for output in outputs:
            if isinstance(output, VelocityError):
                self._add_up(output)
        if not self.watch.denied:
            self.position_error, self._last = np.zeros(2), None
        return outputs

    def _add_up(self, error: VelocityError) -> None:
        last, self._last = self._last, error
        if last is not None and 0 < error.stamp_ns - last.stamp_ns <= _LONGEST_STEP * 1e9:
            mean = 0.5 * (np.array(last.dv_en) + np.array(error.dv_en))
            self.position_error = self.position_error + mean * (error.stamp_ns - last.stamp_ns) * 1e-9

    @property
    def mode(self) -> Mode:
        """WAITING_IMU without data, ALIGNING while the model is not good enough, AIDED when it is."""
        if self.watch.waiting_for:
            return Mode.WAITING_IMU
        return Mode.ALIGNING if self.learner.reason else Mode.AIDED

    def status(self) -> Status:
        """Why the model is not used (``waiting_for``) and its scores (``values``)."""
        waiting = f"waiting for {self.watch.waiting_for}" if self.watch.waiting_for else self.learner.reason
        return Status(
            stamp_ns=0,
            mode=self.mode,
            waiting_for=waiting,
            seconds_coasting=0.0,
            horizontal_sd=np.nan,
            horizontal_sd_in_30_s=np.nan,
            gnss_refusal="",
            satellites=None,
            counters={},
            values={name: float(value) for name, value in self.learner.scores().items()},
        )

    def reset(self, stamp_ns: int, reason: str) -> list[Event]:
        """Forget the flight; the learner decides what of its model outlives it."""
        self.watch.reset()
        self.learner.reset()
        self.position_error, self._last = np.zeros(2), None
        return [Event(stamp_ns, "outage.reset", Level.WARN, f"the learner starts again: {reason}")]

    def warm_up(self) -> None:
        """The learner compiles in its training process; nothing here waits for a compiler."""

    def set_parameters(self, parameters: Parameters) -> None:
        """Nothing of the learner can change in flight."""


def _as_velocity_error(item: VelocityError | Prior | Event, solution: NavSolution) -> VelocityError | Event:
    """``item`` as something that has a topic."""
    if not isinstance(item, Prior):
        return item
    if item.kind != "horizontal_velocity":
        return Event(item.stamp_ns, "outage.unsent.position")
    east, north = (float(v - p) for v, p in zip(solution.vel_n[:2], item.value, strict=True))
    return VelocityError(item.stamp_ns, (east, north), np.array(item.cov, float))
