"""How late the fixes are: the shift of their stamps under which the filter's velocity innovations are smallest.

Only data from before the first outage are used. The filter runs once for each trial latency over the same data with the
GNSS stamps moved, so that the prediction horizon is the same for all of them and the minimum is not biased.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.layout import OUT_POS, OUT_T, OUT_VEL
from nav_pose_estimator.engine.parameter_schema import update
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, Sample, SatelliteCount
from nav_pose_estimator.engine.sins import SinsEngine
from nav_pose_estimator.engine.solutions import NavBlock
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.recording import Recording
from nav_pose_estimator.offline.tracks import displacement_enu

COARSE = np.arange(-0.1, 0.601, 0.05)
FINE = 0.01  # s
WINDOW = 240.0  # s of data are enough
MIN_DATA = 20.0  # s
SETTLE = 15.0  # s after the start of the filter in which innovations do not count
WEAK = 0.03  # relative rise of the innovations 0.1 s beside the minimum below which it is weak
AUTO = "auto"


@dataclass(frozen=True)
class Latency:
    """``delay`` [s]: stamp minus time of validity. ``rise``: relative growth of the innovations 0.1 s beside it."""

    delay: float
    rise: float
    trials: np.ndarray  # (K,) s
    innovations: np.ndarray  # (K,) RMS
    seconds: float  # of data used

    @property
    def weak(self) -> bool:
        """True when the data hardly tell one latency from another."""
        return not self.rise >= WEAK


def estimate(recording: Recording, parameters: Parameters, until: float = math.inf) -> Latency:
    """Estimate the latency from data before ``until`` [s]. Raises ``UserError`` where there is too little of it."""
    stream = _Stream(recording, parameters, until)
    cost: dict[float, float] = {}

    def trial(delay: float) -> float:
        delay = round(delay, 4)
        if delay not in cost:
            cost[delay] = stream.innovation_rms(delay)
        return cost[delay]

    best = _refine(trial, float(min(COARSE, key=trial)))
    here = trial(best)
    if not math.isfinite(here):
        raise UserError("the latency cannot be estimated: the filter did not start on the data before the first outage")
    rise = min(trial(best - 0.1), trial(best + 0.1)) / max(here, 1e-9) - 1.0
    trials = np.array(sorted(cost))
    return Latency(best, rise, trials, np.array([cost[t] for t in trials]), stream.seconds)


def _refine(trial: Callable[[float], float], coarse: float) -> float:
    """The minimum near ``coarse``: fine steps, then the vertex of the parabola through the best three."""
    grid = [coarse + i * FINE for i in range(-4, 5)]
    values = [trial(delay) for delay in grid]
    i = int(np.argmin(values))
    if not 0 < i < len(grid) - 1:
        return grid[i]
    low, mid, high = values[i - 1 : i + 2]
    bend = low - 2.0 * mid + high
    return grid[i] + (0.5 * FINE * (low - high) / bend if bend > 0.0 else 0.0)


def describe(latency: Latency) -> str:
    """The estimate in words."""
    text = f"GNSS latency {latency.delay:.3f} s from {latency.seconds:.0f} s of data"
    if latency.weak:
        return (
            f"{text}: weak minimum (0.1 s beside it the innovations grow by only {100.0 * latency.rise:.1f} %); "
            "fly with more acceleration, or trust the receiver's data sheet"
        )
    return f"{text} (0.1 s beside it the innovations grow by {100.0 * latency.rise:.0f} %)"


def choose(
    recording: Recording, parameters: Parameters, option: str | None, config: Path | None, until: float
) -> tuple[Parameters, str]:
    """Parameters with the latency to use, and one sentence that says where it is from.

    ``option`` is what the user gave: seconds, ``auto`` (from the data) or None: then a configuration file decides, else
    NAME.json beside the bag.
    """
    if option is None and config is not None:
        return parameters, f"GNSS latency {parameters.gnss.delay:g} s (from {config.name} or default)"
    if option == AUTO:
        found = estimate(recording, parameters, until)
        return update(parameters, {"gnss.delay": found.delay}), describe(found)
    if option is None:
        known = recording.sidecar.get("gnss_latency_est_s")
        if isinstance(known, (int, float)):
            how = f"GNSS latency {known:g} s (from {recording.name}.json)"
            return update(parameters, {"gnss.delay": float(known)}), how
        return parameters, f"GNSS latency {parameters.gnss.delay:g} s (default; --gnss-delay auto estimates it)"
    try:
        delay = float(option)
    except ValueError:
        raise UserError(f"--gnss-delay {option!r}: write seconds, or auto") from None
    return update(parameters, {"gnss.delay": delay}), f"GNSS latency {delay:g} s (as given)"


class _Stream:
    """The data in arrays, so that a trial only merges them anew."""

    def __init__(self, recording: Recording, parameters: Parameters, until: float) -> None:
        self._parameters = update(parameters, {"gnss.delay": 0.0})
        limit = recording.epoch_ns + round(min(until, recording.duration + 1.0, 1e9) * 1e9)
        start = self._start(recording, limit)
        limit = min(limit, start + round(WINDOW * 1e9))
        blocks = [s for s in recording.samples if isinstance(s, ImuBlock) and len(s)]
        stamps = np.concatenate([b.stamps_ns for b in blocks])
        good = (stamps >= start) & (stamps < limit) & (np.maximum.accumulate(stamps) == stamps)
        self._imu = ImuBlock(
            stamps[good],
            np.concatenate([b.gyro for b in blocks])[good],
            np.concatenate([b.accel for b in blocks])[good],
        )
        self._others = [
            s for s in recording.samples if not isinstance(s, ImuBlock) and s.stamp_ns and start <= s.stamp_ns < limit
        ]
        self.seconds = (limit - start) * 1e-9 if math.isfinite(until) else len(self._imu) and self._span()
        self.seconds = min(self.seconds, self._span())
        if self.seconds < MIN_DATA or not any(isinstance(s, GnssFix) for s in self._others):
            raise UserError(
                "the latency cannot be estimated: there are less than 20 s of fixes before the first outage"
            )
        self._with_velocity = any(isinstance(s, GnssVelocity) for s in self._others)

    @staticmethod
    def _start(recording: Recording, limit: int) -> int:
        """A little before the vehicle begins to move: standing still tells nothing of the latency."""
        moving = [v.stamp_ns for v in recording.velocities if math.hypot(*v.vel_enu[:2]) > 2.0 and v.stamp_ns < limit]
        return max(recording.epoch_ns, (moving[0] if moving else 0) - round(40e9))

    def _span(self) -> float:
        return float(self._imu.stamps_ns[-1] - self._imu.stamps_ns[0]) * 1e-9 if len(self._imu) else 0.0

    def innovation_rms(self, delay: float) -> float:
        """RMS of the horizontal innovations with the fixes moved by ``delay`` [s]; infinite if the filter fails."""
        engine = SinsEngine(self._parameters)
        errors, began, before = [], math.inf, None
        for sample in self._merged(round(delay * 1e9)):
            if isinstance(sample, GnssVelocity if self._with_velocity else GnssFix) and before is not None:
                t = (sample.stamp_ns - before[0]) * 1e-9
                if before[2] > began + SETTLE and t < 0.1:
                    errors.append(_innovation(sample, before[1], t))
            for output in engine.feed(sample):
                if isinstance(output, NavBlock) and len(output.rows) > 1:
                    before = (int(output.stamps_ns[-1]), output.rows[-2:], float(output.stamps_ns[-1]) * 1e-9)
                    began = min(began, before[2])
        return math.sqrt(np.mean(np.square(errors))) if len(errors) > 20 else math.inf

    def _merged(self, delay_ns: int) -> list[Sample]:
        """All samples in order of time, GNSS at its time of validity."""
        moved = [_moved(s, delay_ns) for s in self._others]
        moved.sort(key=lambda s: s.stamp_ns)
        cuts = np.searchsorted(self._imu.stamps_ns, [s.stamp_ns for s in moved])
        out: list[Sample] = []
        done, imu = 0, self._imu
        for cut, sample in zip(cuts.tolist(), moved, strict=True):
            if cut > done:
                out.append(ImuBlock(imu.stamps_ns[done:cut], imu.gyro[done:cut], imu.accel[done:cut]))
                done = cut
            out.append(sample)
        return out


def _moved(sample: Sample, delay_ns: int) -> Sample:
    if isinstance(sample, (GnssFix, GnssVelocity, SatelliteCount)):
        return replace(sample, stamp_ns=sample.stamp_ns - delay_ns)
    return sample


def _innovation(sample: GnssFix | GnssVelocity, rows: np.ndarray, ahead: float) -> float:
    """Horizontal difference to the prediction, carried ``ahead`` seconds on from the last two rows."""
    last, slope = rows[-1], (rows[-1] - rows[-2]) / max(rows[-1][OUT_T] - rows[-2][OUT_T], 1e-3)
    if isinstance(sample, GnssVelocity):
        predicted = (last + ahead * slope)[OUT_VEL : OUT_VEL + 2]
        return math.hypot(sample.vel_enu[0] - predicted[0], sample.vel_enu[1] - predicted[1])
    predicted = (last + ahead * slope)[OUT_POS : OUT_POS + 3]
    east, north, _ = displacement_enu(np.array([sample.lat, sample.lon, sample.alt]), predicted).tolist()
    return math.hypot(east, north)
