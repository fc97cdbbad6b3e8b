"""One alignment: a simulated recording in the navigator, and the errors relative to the truth."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.alignment.types import Alignment
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.blocks import state_count
from nav_pose_estimator.core.filter.error_state import error_between, inject
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import ImuBlock
from nav_pose_estimator.offline.benchmarks.alignment.cases import Case, start_deviations
from nav_pose_estimator.offline.benchmarks.outage.statistics import rms
from nav_pose_estimator.sim.noise import stream
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate
from nav_pose_estimator.sim.sensors import Gnss
from nav_pose_estimator.sim.trajectories import Truth

ARC_MINUTES = 5.0
_EVERY = 1.0  # s between two looks at the errors
_KINEMATIC = list(range(at.DVEL, at.DPOS + 3))  # velocity and position


@dataclass(frozen=True)
class Trial:
    """Result of one alignment. Times are from the start [s], infinite if the error did not settle below the limit."""

    case: str
    condition: str
    method: str
    seed: int
    to_1_deg_s: float
    to_5_arcmin_s: float
    heading_rms_deg: float  # of the second half, as the following
    tilt_rms_deg: float
    final_heading_deg: float
    position_rms_m: float  # horizontal
    nees: float  # of velocity and position per degree of freedom: 1 is consistent
    factor: float  # largest R over the stated one, of position and velocity, at the end
    t: tuple[float, ...]
    heading_deg: tuple[float, ...]  # error at ``t``


def run_trials(case: Case, condition: str, seed: int, methods: tuple[str, ...], change: Parameters) -> list[Trial]:
    """All ``methods`` on the same data. ``change``: parameters that the case does not set itself."""
    recording = generate(case.scenario_for(condition), seed=seed, imu=case.grade)
    gnss = case.scenario_for("white").gnss
    assert gnss is not None
    trials = []
    for method in methods:
        engine = SinsEngine(case.parameters(method, change))
        trials.append(_judge(recording, _errors(engine, recording, case, gnss), engine, (case.name, condition, method)))
    return trials


def _errors(engine: SinsEngine, recording: Recording, case: Case, gnss: Gnss) -> np.ndarray:
    """Rows (N, 11): time [s], errors of attitude, velocity, position (9), NEES per degree of freedom; once a second.

    The start is given once: a navigator that gives up aligns by itself.
    """
    rows: list[np.ndarray] = []
    due, has_begun = 0.0, case.misalignment_sd is None
    for sample in recording.samples():
        if isinstance(sample, ImuBlock):
            if case.misalignment_sd is not None and not has_begun:
                sd = start_deviations(case.misalignment_sd, case.velocity_sd, case.grade, gnss)
                sample, has_begun = begin(engine, recording, sample, sd, case.misalignment), True
            engine.feed(sample)
            if engine.run.timeline.running and engine.run.now >= due:
                rows.append(look(engine, recording.truth, _KINEMATIC))
                due = engine.run.now + _EVERY
        else:
            engine.feed(sample)
    return np.array(rows).reshape(-1, 11)


def begin(
    engine: SinsEngine,
    recording: Recording,
    block: ImuBlock,
    sd: np.ndarray,
    misalignment: tuple[float, float, float] | None = None,
) -> ImuBlock:
    """Start at the first sample of ``block`` from the truth with random errors ``sd`` (15,), or ``misalignment`` [deg].

    Returns the samples that remain to be fed.
    """
    first = next(block.samples())
    engine.feed(first)
    nav = true_nav(recording.truth, 0)
    nav[at.PREV_RATE : at.PREV_RATE + 3], nav[at.PREV_FORCE : at.PREV_FORCE + 3] = first.gyro, first.accel
    constants = engine.run.timeline.filter.constants
    error = np.zeros(state_count(constants))  # biases and optional states start at zero, so their errors are the IMU's
    drawn = stream(recording.seed, "start").standard_normal(at.BASE_STATES) * sd
    error[: at.D_GYRO_BIAS] = drawn[: at.D_GYRO_BIAS]
    if misalignment is not None:
        error[: at.DVEL] = np.radians(misalignment)
    inject(nav, constants, -error)
    engine.run.begin(Alignment(0.0, nav, np.diag(sd**2), "given"))
    return block.part(1, len(block))


def true_nav(truth: Truth, row: int) -> np.ndarray:
    """The nominal state of a navigator without errors at a row of ``truth``."""
    nav = np.zeros(at.NAV_SIZE)
    nav[at.LAT : at.VEL] = truth.lat[row], truth.lon[row], truth.alt[row]
    nav[at.VEL : at.QUAT] = truth.v_n[row]
    nav[at.QUAT : at.GYRO_BIAS] = truth.q_nb[row]
    nav[at.TIME] = truth.t[row]
    return nav


def look(engine: SinsEngine, truth: Truth, judged: list[int]) -> np.ndarray:
    """A row (11,): time [s], errors of attitude, velocity, position (9), NEES per degree of freedom of ``judged``.

    ``judged``: the states whose errors are held against their covariance.
    """
    estimate, t = engine.run.settled, engine.run.now
    true = true_nav(truth, round((t - truth.t[0]) / truth.dt))
    error = error_between(true, estimate.nav, estimate.constants)
    states = error[judged]
    nees = float(states @ np.linalg.solve(estimate.P[np.ix_(judged, judged)], states)) / len(states)
    return np.r_[t, error[: at.DPOS + 3], nees]


def _judge(recording: Recording, errors: np.ndarray, engine: SinsEngine, names: tuple[str, str, str]) -> Trial:
    t, heading = errors[:, 0], np.degrees(errors[:, 1 + at.PHI + 2])
    later = errors[t >= 0.5 * recording.truth.t[-1]]
    values = engine.status().values
    return Trial(
        *names,
        recording.seed,
        to_1_deg_s=_settled(t, heading, 1.0),
        to_5_arcmin_s=_settled(t, heading, ARC_MINUTES / 60.0),
        heading_rms_deg=math.degrees(rms(later[:, 1 + at.PHI + 2])),
        tilt_rms_deg=math.degrees(rms(np.hypot(later[:, 1 + at.PHI], later[:, 2 + at.PHI]))),
        final_heading_deg=float(heading[-1]) if len(heading) else math.nan,
        position_rms_m=rms(np.hypot(later[:, 1 + at.DPOS], later[:, 2 + at.DPOS])),
        nees=float(np.mean(later[:, -1])) if len(later) else math.nan,
        factor=max(values["gnss.noise.position_factor"], values["gnss.noise.velocity_factor"]),
        t=tuple(t.tolist()),
        heading_deg=tuple(heading.tolist()),
    )


def _settled(t: np.ndarray, error: np.ndarray, limit: float) -> float:
    """Time from which on ``error`` stays below ``limit``; infinite if it does not."""
    outside = np.flatnonzero(np.abs(error) >= limit)
    first = outside[-1] + 1 if len(outside) else 0
    return float(t[first]) if first < len(t) else math.inf
