"""Estimation of the GNSS latency: the shift of the stamps that minimises the filter's velocity innovations.

Only data before the first outage are used. The filter runs once for each trial latency over the same data with shifted
GNSS stamps, so that the prediction horizon is the same for all trials and the minimum is not biased.
"""

import math
from collections.abc import Iterable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.filter.layout import OUT_COLUMNS, OUT_POS, OUT_T, OUT_VEL
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuBlock,
    MagSample,
    PressureSample,
    Sample,
    SatelliteCount,
    known_stamp,
)
from nav_pose_estimator.engine.solutions import NavBlock
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.flights.interleaving import interleaved
from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.flights.tracks import displacement_enu

COARSE = np.arange(-0.1, 0.601, 0.1)  # s: latencies of the coarse search
COARSE_WINDOW, WINDOW = 150.0, 600.0  # s of data for the coarse search and for the final estimate
RESOLUTION = 0.004  # s: tolerance of the minimisation
MIN_DATA = 20.0  # s of data that are needed
SETTLE = 15.0  # s after the start of the filter in which innovations do not count
CORRELATION = 2.0  # s: correlation time of the innovations
MOVING, LASTING, MOST = 2.0, 50, 0.6  # m/s, fixes: the vehicle moves from where this part of so many is faster
BESIDE = 0.1  # s: how far from the best latency the rise of the innovations is measured
FRESH = 0.1  # s: a fix that is farther ahead of the solution is not compared with it
FEW = 20  # innovations: with no more than these there is no estimate
RUN_UP_NS = 40 * 10**9  # data before the motion, for the filter to start on
WEAK = 0.02  # s: standard deviation above which the minimum is weak
COMPASS_NS = 200_000_000  # interval to which magnetometer samples are decimated
AUTO = "auto"
PRIOR, PRIOR_SOURCE = "gnss_latency_prior_s", "gnss_latency_prior_from"
"""Keys in the sidecar of a flight log: the autopilot's parameter of the latency [s], and its name."""
PRIOR_SD = 0.06  # s: estimates differ from that parameter by up to a tenth of a second


@dataclass(frozen=True)
class Latency:
    """``delay`` [s]: stamp minus time of validity. ``rise``: relative growth of the innovations 0.1 s beside it."""

    delay: float
    rise: float
    trials: np.ndarray  # (K,) s
    innovations: np.ndarray  # (K,) RMS, m/s (m where the bag has no GNSS velocity)
    seconds: float  # of data used

    @property
    def sd(self) -> float:
        """Standard deviation of the estimate [s] by the curvature of the likelihood of Gaussian innovations."""
        information = 2.0 * self.seconds / CORRELATION * self.rise
        return BESIDE / math.sqrt(information) if information > 0.0 else math.inf

    @property
    def weak(self) -> bool:
        """Whether the data hardly distinguish between latencies."""
        return not self.sd <= WEAK


def estimate(recording: Recording, parameters: Parameters, until: float = math.inf) -> Latency:
    """Estimate the latency from data before ``until`` [s]. Raises ``UserError`` where there is too little of it."""
    from scipy.optimize import minimize_scalar  # late: most commands know the latency, and it takes long to load

    search = _Stream(recording, parameters, until, COARSE_WINDOW)
    coarse = min(COARSE.tolist(), key=search.innovation_rms)
    stream = _Stream(recording, parameters, until, WINDOW)
    cost: dict[float, float] = {}

    def trial(delay: float) -> float:
        delay = round(float(delay), 4)
        if delay not in cost:
            cost[delay] = stream.innovation_rms(delay)
        return cost[delay]

    if not math.isfinite(trial(coarse)):
        raise UserError("the latency cannot be estimated: the filter had too few fixes before the first outage")
    found = minimize_scalar(
        trial, bounds=(coarse - BESIDE, coarse + BESIDE), method="bounded", options={"xatol": RESOLUTION}
    )
    best = round(float(found.x), 4)
    rise = 0.5 * (trial(best - BESIDE) + trial(best + BESIDE)) / max(trial(best), 1e-9) - 1.0
    trials = np.array(sorted(cost))
    return Latency(best, rise, trials, np.array([cost[t] for t in trials.tolist()]), stream.seconds)


def velocity_innovations(recording: Recording, parameters: Parameters, delay: float, until: float) -> float:
    """RMS of the horizontal innovations [m/s] before ``until`` [s] with fixes ``delay`` [s] old; infinite if it fails.

    Raises ``UserError`` where there is too little data.
    """
    return _Stream(recording, parameters, until, COARSE_WINDOW).innovation_rms(delay)


def describe(latency: Latency) -> str:
    """Sentence about the estimate."""
    text = f"GNSS latency {latency.delay:.3f} s from {latency.seconds:.0f} s of data"
    if not latency.weak:
        return f"{text} (deviation {latency.sd:.3f} s)"
    return (
        f"{text}: weak minimum (deviation {latency.sd:.2f} s); "
        "fly with more acceleration, or trust the receiver's data sheet"
    )


def choose(
    recording: Recording,
    parameters: Parameters,
    option: str | None,
    config: Path | None,
    until: float,
    search: bool = False,
) -> tuple[Parameters, str]:
    """Parameters with the latency to use, and a sentence about its source.

    ``option`` is the user's choice: seconds, ``auto`` (from the data before ``until`` [s]) or None. With None the
    latency is that of the configuration file, else of NAME.json beside the bag, else, with ``search``, it is estimated
    from the data. If that fails, or without ``search``, it is that of ``parameters``.
    """
    own = f"{parameters.gnss.delay:g} s"
    if option is None and config is not None and parameters.gnss.delay != Parameters().gnss.delay:
        return parameters, f"GNSS latency {own} (from {config.name})"
    prior, known = recording.sidecar.get(PRIOR), recording.sidecar.get("gnss_latency_est_s")
    if option is None and isinstance(prior, (int, float)):
        how = f"GNSS latency {prior:g} s ({_source(recording)}; --gnss-delay auto estimates it)"
        return _with(parameters, prior), how
    if option is None and isinstance(known, (int, float)):
        return _with(parameters, known), f"GNSS latency {known:g} s (from {recording.name}.json)"
    if option is None and not search:
        return parameters, f"GNSS latency {own} (default; --gnss-delay auto estimates it)"
    if option is None or option == AUTO:
        try:
            return _estimated(recording, parameters, until)
        except UserError as error:
            if option == AUTO:
                raise
            return parameters, f"GNSS latency {own} (default: {error})"
    try:
        delay = float(option)
    except ValueError:
        raise UserError(f"--gnss-delay {option!r}: write seconds, or auto") from None
    return _with(parameters, delay), f"GNSS latency {delay:g} s (as given)"


def _with(parameters: Parameters, delay: float) -> Parameters:
    return update(parameters, {"gnss.delay": float(delay)})


def _estimated(recording: Recording, parameters: Parameters, until: float) -> tuple[Parameters, str]:
    """The estimate, combined with the autopilot's parameter by their variances if a log contains one."""
    prior = recording.sidecar.get(PRIOR)
    if not isinstance(prior, (int, float)):
        found = estimate(recording, parameters, until)
        return update(parameters, {"gnss.delay": found.delay}), describe(found)
    says = f"{prior:g} s by {_source(recording)}"
    try:
        found = estimate(recording, parameters, until)
    except UserError as error:
        return update(parameters, {"gnss.delay": float(prior)}), f"GNSS latency {says} ({error})"
    weight = PRIOR_SD**2 / (PRIOR_SD**2 + found.sd**2)  # zero for an estimate of infinite deviation
    delay = round(prior + weight * (found.delay - prior), 4)
    data = f"{found.delay:.3f} s from {found.seconds:.0f} s of data (deviation {found.sd:.3f} s)"
    return update(parameters, {"gnss.delay": delay}), f"GNSS latency {delay:.3f} s: {data}, {says}"


def _source(recording: Recording) -> str:
    return f"{recording.sidecar.get(PRIOR_SOURCE, 'a parameter')} of the autopilot"


class _Stream:
    """The data in arrays, so that a trial only has to merge them."""

    def __init__(self, recording: Recording, parameters: Parameters, until: float, window: float) -> None:
        # detection of rests is switched off, because it would make the cost discontinuous
        self._parameters = update(parameters, {"gnss.delay": 0.0, "aids.zero_velocity": False})
        limit = recording.epoch_ns + round(min(until, recording.duration + 1.0) * 1e9)
        start = self._start(recording, limit)
        limit = min(limit, start + round(window * 1e9))
        blocks = [s for s in recording.samples if isinstance(s, ImuBlock) and len(s)]
        stamps = np.concatenate([b.stamps_ns for b in blocks])
        good = (stamps >= start) & (stamps < limit) & (np.maximum.accumulate(stamps) == stamps)
        self._imu = ImuBlock(
            stamps[good],
            np.concatenate([b.gyro for b in blocks])[good],
            np.concatenate([b.accel for b in blocks])[good],
        )
        self._others = _useful(recording.samples, start, limit)
        self.seconds = float(stamps[good][-1] - stamps[good][0]) * 1e-9 if good.any() else 0.0
        if self.seconds < MIN_DATA or not any(isinstance(s, GnssFix) for s in self._others):
            raise UserError("the latency cannot be estimated: less than 20 s of fixes come before the first outage")
        self._with_velocity = any(isinstance(s, GnssVelocity) for s in self._others)

    @staticmethod
    def _start(recording: Recording, limit: int) -> int:
        """Begin of the data [ns], shortly before the vehicle moves: at rest the latency is not observable."""
        early = [v for v in recording.velocities if v.stamp_ns < limit]
        if not early:
            return recording.epoch_ns
        moving = np.array([math.hypot(*v.vel_enu[:2]) > MOVING for v in early])
        # a receiver on the ground may have single jumps, so that most of the next fixes must be moving
        lasting = np.convolve(moving, np.ones(LASTING), "full")[LASTING - 1 :] > MOST * LASTING
        first = int(np.argmax(lasting)) if lasting.any() else 0
        return max(recording.epoch_ns, early[first].stamp_ns - RUN_UP_NS)

    def innovation_rms(self, delay: float) -> float:
        """RMS of the horizontal innovations with the fixes moved by ``delay`` [s]; infinite if the filter fails."""
        engine = SinsEngine(self._parameters)
        judged = GnssVelocity if self._with_velocity else GnssFix
        errors: list[float] = []
        rows, last_ns, first_ns = np.empty((0, OUT_COLUMNS)), 0, 0
        for sample in self._merged(round(delay * 1e9)):
            if isinstance(sample, judged) and len(rows) == 2 and last_ns > first_ns + round(SETTLE * 1e9):
                ahead = (sample.stamp_ns - last_ns) * 1e-9
                if ahead < FRESH:
                    errors.append(_innovation(sample, rows, ahead))
            for output in engine.feed(sample):
                if isinstance(output, NavBlock):
                    rows = np.vstack([rows[-1:], output.rows[-2:]])[-2:]
                    last_ns = int(output.stamps_ns[-1])
                    first_ns = first_ns or last_ns
        return math.sqrt(np.mean(np.square(errors))) if len(errors) > FEW else math.inf

    def _merged(self, delay_ns: int) -> list[Sample]:
        """All samples in order of time, GNSS at its time of validity."""
        moved = [_moved(s, delay_ns) for s in self._others]
        moved.sort(key=known_stamp)
        return interleaved(self._imu, moved, np.searchsorted(self._imu.stamps_ns, list(map(known_stamp, moved))))


def _useful(samples: Iterable[Sample], start: int, limit: int) -> list[Sample]:
    """Samples that affect the horizontal velocity, with decimated magnetometer samples, so that IMU blocks are long."""
    out: list[Sample] = []
    next_mag = 0
    for sample in samples:
        if (
            isinstance(sample, (ImuBlock, PressureSample))
            or not sample.stamp_ns
            or not start <= sample.stamp_ns < limit
        ):
            continue
        if isinstance(sample, MagSample):
            if sample.stamp_ns < next_mag:
                continue
            next_mag = sample.stamp_ns + COMPASS_NS
        out.append(sample)
    return out


def _moved(sample: Sample, delay_ns: int) -> Sample:
    if isinstance(sample, (GnssFix, GnssVelocity, SatelliteCount)):
        return replace(sample, stamp_ns=known_stamp(sample) - delay_ns)
    return sample


def _innovation(sample: GnssFix | GnssVelocity, rows: np.ndarray, ahead: float) -> float:
    """Horizontal innovation with the prediction extrapolated by ``ahead`` [s] from the last two rows."""
    last, slope = rows[-1], (rows[-1] - rows[-2]) / max(rows[-1][OUT_T] - rows[-2][OUT_T], 1e-3)
    if isinstance(sample, GnssVelocity):
        predicted = (last + ahead * slope)[OUT_VEL : OUT_VEL + 2]
        return math.hypot(sample.vel_enu[0] - predicted[0], sample.vel_enu[1] - predicted[1])
    predicted = (last + ahead * slope)[OUT_POS : OUT_POS + 3]
    east, north, _ = displacement_enu(np.array([sample.lat, sample.lon, sample.alt]), predicted).tolist()
    return math.hypot(east, north)
