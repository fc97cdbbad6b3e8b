"""Base classes of the navigator's sensors: from a sample to an observation, and its linearisation for the filter."""

from __future__ import annotations

from collections import deque
from typing import Any, ClassVar, Self

import numpy as np

from nav_pose_estimator.core.filter.blocks import Block, GaussMarkov
from nav_pose_estimator.core.filter.measurement_noise import MODELS, NoiseModel
from nav_pose_estimator.core.numerics.snapshot import snapshot
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import GATED, Decision, FilterView, Kind, Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.sensors.aiding import Aiding

_LONGEST_REPLAY = 10.0  # s: the largest navigator.memory
Linearised = tuple[np.ndarray, np.ndarray, np.ndarray]
"""z (m,), estimate minus measurement; H (m, n) on the error state; R (m, m), the noise that the sensor states."""


class Sensor:
    """Base of a sensor: one kind of observation. Only ``fusion`` corrects the filter.

    A new sensor is a subclass in its own file and a line in ``aids.AIDS``. It may keep learned quantities in
    attributes, which are copied with the filter.
    """

    kind: ClassVar[Kind]
    vertical_only: ClassVar[bool] = False
    """Whether it is one row of height that corrects only height and vertical velocity (``vertical_channel``)."""
    all_or_nothing: ClassVar[bool] = False
    """Whether unlikely observations are rejected instead of inflated."""
    bounds_drift: ClassVar[bool] = False
    """Whether it bounds the drift without GNSS."""

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal) -> None:
        self._journal, self._aiding = journal, aiding
        self.noise: NoiseModel = MODELS[self.noise_model(parameters)]()
        self._noises: deque[tuple[tuple[float, int, int], NoiseModel]] = (
            deque()
        )  # copies of ``noise`` from before the last observations
        self.set_parameters(parameters)

    def set_parameters(self, parameters: Parameters) -> None:
        """Take new noises and periods; learned quantities stay."""
        raise NotImplementedError

    @classmethod
    def noise_model(cls, parameters: Parameters) -> str:
        """Name of its noise model in ``measurement_noise.MODELS``, from a parameter where the sensor has one."""
        return "fixed"

    def noise_ahead_of(self, o: Observation) -> NoiseModel:
        """``noise`` as it was before ``o``; where the past is replayed, what it learned since is undone first.

        The result thus depends neither on when an observation arrives nor on how often the past is replayed.
        """
        while self._noises and self._noises[-1][0] >= o.key:
            self.noise = self._noises.pop()[1]
        while self._noises and self._noises[0][0][0] < o.t - _LONGEST_REPLAY:
            self._noises.popleft()
        self._noises.append((o.key, snapshot(self.noise)))
        return self.noise

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """Decide how to use ``o``; called once, when the filter ``f`` first reaches its time."""
        return GATED

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """(z, H, R) of ``o`` at the state of ``f``, with the reference of its decision."""
        raise NotImplementedError

    def note(self, o: Observation, f: FilterView, z: np.ndarray, status: int, nis: float) -> None:
        """Receive the outcome (statuses of ``kalman.gated_correct``) once; ``f`` is already corrected."""
        self._journal.count(f"{self.kind.name}.{('rejected', 'used', 'inflated')[status]}")
        if status and self.bounds_drift:
            self._aiding.bound_drift(o.t, self.kind.name)

    def settle(self, o: Observation, f: FilterView) -> None:
        """Called each time after ``o`` has been applied or left out."""


class Aid(Sensor):
    """Base of a sensor other than GNSS: one sample gives one observation, or none."""

    sample: ClassVar[type]
    family: ClassVar[str]
    """First word of its counters (``mag.rejected.value``)."""

    blocks: ClassVar[dict[Block, GaussMarkov]] = {}
    """Blocks of states that the filter is extended by at its first observation, with their process models."""
    first_sd: dict[Block, float | tuple[float, ...]]
    """Their initial deviations, one for all states of a block or one each; a block without an entry is not added."""

    def observe(self, sample: Any, t: float) -> Observation | None:
        """The observation of a sample stamped ``t`` [s]; None where it is not due, or rejected and counted."""
        raise NotImplementedError

    def bounds_at(self, t: float) -> bool:
        """Whether it measures the velocity at ``t`` [s] better than a learned prediction."""
        return False

    def compare_anew(self) -> None:
        """Discard everything learned by comparison with the navigator, because its heading was wrong."""
        self.noise = type(self.noise)()
        self._noises.clear()

    def take_over(self, before: Self) -> None:
        """Continue after a gap in the IMU data with learned quantities of ``before`` that no saved state holds."""

    def figures(self) -> dict[str, float]:
        """Values of the navigator's status, with keys that begin with its family."""
        return {}

    def _refuse(self, why: str = "value") -> None:
        self._journal.count(f"{self.family}.rejected.{why}")


class Pacer:
    """Limits the rate of observations to one per ``period`` [s]: closer ones have correlated errors and add little."""

    _JITTER = 1e-6  # s: tolerance of the period
    _BACK = 1.0  # s: an observation this much older than the last one shows that the stamp of the last was wrong

    def __init__(self) -> None:
        self._last = -np.inf

    def passes(self, t: float, period: float) -> bool:
        """Whether an observation at ``t`` [s] is due; it then is the last one."""
        if -self._BACK <= t - self._last < period - self._JITTER:
            return False
        self._last = t
        return True


CORRELATION = 5.0  # s
"""Correlation time of the errors of magnetic headings and barometric heights."""


def shared_error(period: float) -> float:
    """Factor on the variance of observations every ``period`` [s] with errors correlated over ``CORRELATION``."""
    return 1.0 + CORRELATION / max(period, 0.1)
