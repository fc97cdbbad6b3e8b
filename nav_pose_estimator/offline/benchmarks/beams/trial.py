"""One loss of GNSS: the final error, the rejected beams, and the consistency of the filter."""

from __future__ import annotations

import math
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, replace

import numpy as np

from nav_pose_estimator.core.beams.judge import LOST, USED
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import (
    BeamVelocitySample,
    GnssFix,
    GnssVelocity,
    ImuBlock,
    Sample,
    SatelliteCount,
    stamp_of,
)
from nav_pose_estimator.offline.benchmarks.alignment.cases import start_deviations
from nav_pose_estimator.offline.benchmarks.alignment.trial import begin, look
from nav_pose_estimator.offline.benchmarks.beams.cases import Case
from nav_pose_estimator.offline.benchmarks.beams.methods import METHODS, Watched, prepared
from nav_pose_estimator.sim import beam_faults
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate

_GNSS = (GnssFix, GnssVelocity, SatelliteCount)
_START_SD, _START_VELOCITY_SD = (0.2, 0.2, 2.0), 0.1  # deg about East, North, Up; m/s
_EVERY = 1.0  # s between two evaluations of the errors
_LARGE = 5.0  # standard deviations of a beam from which an error should be rejected
_SETTLED = 2.0  # s after a total loss from which on the velocity is judged again
_JUDGED = [at.DVEL, at.DVEL + 1, at.DPOS, at.DPOS + 1]  # horizontal: what the beams hold


@dataclass(frozen=True)
class Trial:
    """Result of one loss of GNSS. Fractions are NaN where there were no beams."""

    case: str
    fault: str
    method: str
    seed: int
    end_error_m: float  # horizontal
    travelled_m: float
    percent: float  # of the distance travelled
    velocity_rms: float  # m/s, 3-D, outside total loss
    heading_deg: float  # error at the end
    mounting_deg: float  # error of the mounting yaw at the end
    nees: float  # horizontal velocity and position, per degree of freedom, mean over time
    refused_healthy: float  # share
    refused_faulty: float  # share of the errors above five deviations


def run_seed(
    case: Case,
    seed: int,
    faults: tuple[str, ...],
    methods: tuple[str, ...],
    length: float,
    mounting: float = 0.0,
    change: Parameters | None = None,
) -> list[Trial]:
    """All ``methods`` and ``faults`` on the same motion and sensors, ``length`` [s] without GNSS.

    ``mounting`` [rad]: rotation of the sensor about its z axis that is unknown to the estimator. Each method processes
    the time with GNSS once; every fault is then run with a copy of the estimator.
    """
    recording = generate(case.scenario_for(length, mounting), seed=seed, imu=case.grade)
    begin_ns = recording.start_ns + round(case.aided * 1e9)
    recording = without_gnss(recording, begin_ns)
    trials = []
    for method in methods:
        engine = prepared(SinsEngine(METHODS[method].parameters(case.parameters(change))), method)
        fly_with_gnss(engine, case, recording, begin_ns)
        for fault in faults:
            plan = beam_faults.plan(fault, case.stretch(length), seed)
            trial = _Outage(case, recording, recording.with_faults(*plan), begin_ns, deepcopy(engine), mounting)
            trials.append(trial.run(fault, method))
    return trials


def fly_with_gnss(engine: SinsEngine, case: Case, recording: Recording, end_ns: int) -> None:
    """Feed all samples before ``end_ns``, after a start with known standard deviations instead of an alignment."""
    assert case.scenario.gnss is not None
    sd = start_deviations(_START_SD, _START_VELOCITY_SD, case.grade, case.scenario.gnss)
    for sample in recording.samples():
        stamp = stamp_of(sample)
        if stamp is not None and stamp >= end_ns:
            return
        if isinstance(sample, ImuBlock) and not engine.run.timeline.running:
            sample = begin(engine, recording, sample, sd)
        engine.feed(sample)


def without_gnss(recording: Recording, begin_ns: int) -> Recording:
    """The recording without GNSS from ``begin_ns`` on; a satellite count belongs to the fix before it."""
    kept, is_over = [], False
    for timed in recording.others:
        is_gnss = isinstance(timed.sample, _GNSS)
        stamp = stamp_of(timed.sample)
        is_over = is_over or (is_gnss and stamp is not None and stamp >= begin_ns)
        if not (is_gnss and is_over):
            kept.append(timed)
    return replace(recording, others=kept)


def _after(recording: Recording, begin_ns: int) -> Iterator[Sample]:
    """Samples that arrive from ``begin_ns`` on."""
    began = False
    for sample in recording.samples():
        stamp = stamp_of(sample)
        began = began or (stamp is not None and stamp >= begin_ns)
        if began:
            yield sample


class _Outage:
    """One engine through one recording without GNSS."""

    def __init__(
        self, case: Case, clean: Recording, faulty: Recording, begin_ns: int, engine: SinsEngine, mounting: float
    ) -> None:
        self._case, self._engine, self._mounting = case, engine, mounting
        self._clean, self._faulty, self._begin_ns = clean, faulty, begin_ns

    def run(self, fault: str, method: str) -> Trial:
        """Run the outage and evaluate it."""
        judge = METHODS[method].judge_of(self._engine)
        errors = self._errors(judge)
        truth = self._clean.truth
        flown = truth.t > self._case.aided
        travelled = float(np.hypot(*truth.v_n[flown, :2].T).sum() * truth.dt)
        end = float(np.hypot(*errors[-1, 1 + at.DPOS : 3 + at.DPOS]))
        figures = self._engine.status().values
        healthy, wrong = self._refused(judge)
        return Trial(
            self._case.name,
            fault,
            method,
            self._clean.seed,
            end_error_m=end,
            travelled_m=travelled,
            percent=100.0 * end / travelled,
            velocity_rms=self._velocity_rms(errors),
            heading_deg=math.degrees(errors[-1, 1 + at.PHI + 2]),
            mounting_deg=figures.get("beams.mounting_yaw_deg", math.nan) - math.degrees(self._mounting),
            nees=float(np.mean(errors[:, -1])),
            refused_healthy=healthy,
            refused_faulty=wrong,
        )

    def _errors(self, judge: Watched) -> np.ndarray:
        """Rows (N, 11): time [s], errors of attitude, velocity, position (9), NEES per degree of freedom.

        The verdicts of ``judge`` are cleared before the first message of the outage.
        """
        rows: list[np.ndarray] = []
        due, is_first = self._case.aided, True
        for sample in _after(self._faulty, self._begin_ns):
            if is_first and isinstance(sample, BeamVelocitySample):
                judge.verdicts.clear()
                is_first = False
            self._engine.feed(sample)
            if isinstance(sample, ImuBlock) and self._engine.run.now >= due:
                rows.append(look(self._engine, self._clean.truth, _JUDGED))
                due = self._engine.run.now + _EVERY
        return np.array(rows)

    def _velocity_rms(self, errors: np.ndarray) -> float:
        """RMS of the velocity error [m/s] while at least one beam is available, except shortly after a total loss."""
        messages = self._messages(self._faulty)
        lost = [_seconds(self._faulty, s) for s in messages if not np.isfinite(s.velocities).any()]
        gap = errors[:, 0][:, None] - np.array(lost)[None, :]
        judged = ~((gap > -1.0) & (gap < _SETTLED)).any(axis=1)
        squared = np.square(errors[judged][:, 1 + at.DVEL : 4 + at.DVEL]).sum(axis=1)
        return float(np.sqrt(squared.mean())) if len(squared) else math.nan

    def _messages(self, recording: Recording) -> list[BeamVelocitySample]:
        samples = [timed.sample for timed in recording.others]
        return [s for s in samples if isinstance(s, BeamVelocitySample) and s.stamp_ns >= self._begin_ns]

    def _refused(self, judge: Watched) -> tuple[float, float]:
        """Fractions of the healthy and of the clearly wrong beam velocities that were rejected."""
        pairs = zip(self._messages(self._clean), self._messages(self._faulty), strict=True)
        wrong = [b.velocities - a.velocities for a, b in pairs if np.isfinite(b.velocities).any()]
        count = min(len(wrong), len(judge.verdicts))
        if count < len(wrong) - 2:  # the last one may still be on its way
            return math.nan, math.nan
        error, verdict = np.array(wrong[:count]), np.array(judge.verdicts[:count])
        refused = (verdict != USED) & (verdict != LOST)
        large = np.abs(error) > _LARGE * self._case.doppler.noise
        return _share(refused[error == 0.0]), _share(refused[large])


def _seconds(recording: Recording, sample: BeamVelocitySample) -> float:
    return (sample.stamp_ns - recording.start_ns) * 1e-9


def _share(chosen: np.ndarray) -> float:
    return float(chosen.mean()) if chosen.size else math.nan
