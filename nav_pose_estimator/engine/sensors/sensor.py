"""What every sensor of the navigator has in common: from a sample to an observation, and from there into the filter."""

from __future__ import annotations

from collections import deque
from typing import Any, ClassVar, Self

import numpy as np

from nav_pose_estimator.core.filter.blocks import Block, Wander
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
    """One kind of observation. It knows samples, parameters and counters; only ``fusion`` corrects the filter.

    A new sensor is a subclass in its own file and a line in ``aids.AIDS``. It may keep what it learns in
    attributes: they are copied with the filter.
    """

    kind: ClassVar[Kind]
    vertical_only: ClassVar[bool] = False
    """One row of height that corrects height and vertical velocity alone (``core.filter.vertical_channel``)."""
    all_or_nothing: ClassVar[bool] = False
    """Unlikely observations are refused instead of counting for less."""
    bounds_drift: ClassVar[bool] = False
    """Whether it keeps the drift within bounds while GNSS is away."""

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal) -> None:
        self._journal, self._aiding = journal, aiding
        self.noise: NoiseModel = MODELS[self.noise_model(parameters)]()
        self._noises: deque[tuple[tuple[float, int, int], NoiseModel]] = (
            deque()
        )  # as they stood ahead of the last observations
        self.set_parameters(parameters)

    def set_parameters(self, parameters: Parameters) -> None:
        """New noises and periods; what was learned stays."""
        raise NotImplementedError

    @classmethod
    def noise_model(cls, parameters: Parameters) -> str:
        """The one of ``measurement_noise.MODELS`` that it goes by; a sensor with a parameter for that answers by it."""
        return "fixed"

    def noise_ahead_of(self, o: Observation) -> NoiseModel:
        """``noise`` as it stood before ``o``: where the past is replayed, what it learned since is forgotten first.

        So it is the same whenever an observation arrives, and however often the time line has gone back.
        """
        while self._noises and self._noises[-1][0] >= o.key:
            self.noise = self._noises.pop()[1]
        while self._noises and self._noises[0][0][0] < o.t - _LONGEST_REPLAY:
            self._noises.popleft()
        self._noises.append((o.key, snapshot(self.noise)))
        return self.noise

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """What to do with ``o``: asked once, when the filter ``f`` first reaches its time."""
        return GATED

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """The observation at the state of ``f``, with the reference that was decided on."""
        raise NotImplementedError

    def note(self, o: Observation, f: FilterView, z: np.ndarray, status: int, nis: float) -> None:
        """Receive the outcome (statuses of ``kalman.gated_correct``) once; ``f`` is already corrected."""
        self._journal.count(f"{self.kind.name}.{('rejected', 'used', 'inflated')[status]}")
        if status and self.bounds_drift:
            self._aiding.bound_drift(o.t, self.kind.name)

    def settle(self, o: Observation, f: FilterView) -> None:
        """Called each time that ``o`` has acted or was left out."""


class Aid(Sensor):
    """A sensor besides GNSS: one sample gives one observation, or none."""

    sample: ClassVar[type]
    family: ClassVar[str]
    """Of its counters on arrival (``mag.rejected.value``)."""

    blocks: ClassVar[dict[Block, Wander]] = {}
    """States that the filter is given with its first observation, and how they change."""
    first_sd: dict[Block, float | tuple[float, ...]]
    """Their deviations then, one for all states of a block or one for each; a block without is not asked for."""

    def observe(self, sample: Any, t: float) -> Observation | None:
        """The observation of a sample stamped ``t`` [s]; None where it is not due, or refused and counted."""
        raise NotImplementedError

    def bounds_at(self, t: float) -> bool:
        """Whether it measures the velocity at ``t`` [s] better than anything that was learned could tell it."""
        return False

    def compare_anew(self) -> None:
        """The navigator's heading was wrong: what was found out by comparison with it is worth nothing."""
        self.noise = type(self.noise)()
        self._noises.clear()

    def take_over(self, before: Self) -> None:
        """Go on after a gap in the IMU data with what the same sensor has shown ``before`` and no saved state tells."""

    def figures(self) -> dict[str, float]:
        """What it shows in the navigator's status, by names that begin with its family."""
        return {}

    def _refuse(self, why: str = "value") -> None:
        self._journal.count(f"{self.family}.rejected.{why}")


class Pacer:
    """Lets observations pass at most every ``period`` [s]: closer ones share their errors and add no information."""

    _JITTER = 1e-6  # s

    def __init__(self) -> None:
        self._last = -np.inf

    def passes(self, t: float, period: float) -> bool:
        """Whether an observation at ``t`` [s] is due; it then is the last one."""
        if t - self._last < period - self._JITTER:
            return False
        self._last = t
        return True


CORRELATION = 5.0  # s
"""Magnetic headings and barometric heights closer than this share their error."""


def shared_error(period: float) -> float:
    """Factor on the variance of observations every ``period`` [s] whose errors last for ``CORRELATION``."""
    return 1.0 + CORRELATION / max(period, 0.1)
