"""What an estimator leaves to the next process, and how that one begins with it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.continuation import warm_start
from nav_pose_estimator.engine.continuation.saved_state import SavedState
from nav_pose_estimator.engine.continuation.warm_start import WarmStart
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator.filter_run import FilterRun
from nav_pose_estimator.engine.outage.learner import OutageLearner
from nav_pose_estimator.engine.outage.model_file import check_bounds
from nav_pose_estimator.engine.samples import MagSample, PressureSample
from nav_pose_estimator.engine.sensors.barometer import Barometer
from nav_pose_estimator.engine.sensors.magnetometer import Magnetometer
from nav_pose_estimator.engine.solutions import Level
from nav_pose_estimator.errors import UserError

_MODEL = "model."  # beginning of the names of its arrays
_SURE_HEADING = 0.35  # rad: a wider one is nothing to go on with


def state_of(run: FilterRun) -> SavedState | None:
    """The run as it stands; None while the filter does not run."""
    if not run.timeline.running or run.origin is None:
        return None
    whole, t = run.settled, run.now
    east, north, up = run.timeline.shift.tolist()
    nav, base = whole.nav, slice(at.BASE_STATES)
    gate = run.gnss.reception.gate.state
    magnetometer, barometer = run.aids[MagSample], run.aids[PressureSample]
    assert isinstance(magnetometer, Magnetometer)
    assert isinstance(barometer, Barometer)
    return SavedState(
        stamp_ns=run.clock.stamp(t),
        origin=run.origin,
        position=tuple(nav[at.LAT : at.VEL].tolist()),
        velocity=tuple(nav[at.VEL : at.QUAT].tolist()),
        q_nb=tuple(nav[at.QUAT : at.GYRO_BIAS].tolist()),
        gyro_bias=tuple(nav[at.GYRO_BIAS : at.ACCEL_BIAS].tolist()),
        accel_bias=tuple(nav[at.ACCEL_BIAS : at.ACCEL_BIAS + 3].tolist()),
        cov=whole.P[base, base].copy(),
        unaided=max(t - run.aiding.fix_used, 0.0),
        correction_enu=(east, north, up),
        resets=run.gnss.position.resets,
        imu_variance=run.noise.imu_variance,
        gnss_variance=run.noise.gnss_variance,
        trials=run.noise.trials,
        compass_offset=magnetometer.offset,
        baro_offset=barometer.offset,
        gate_is_open=gate.open or gate.inactive,
        is_sound=_is_sound(run, t),
    )


def _is_sound(run: FilterRun, t: float) -> bool:
    """Whether the next process may go on with attitude and position."""
    doubts = (run.modes.distrust_reason, run.gnss.position.doubt(t), run.imu_physics.refusal, run.despair)
    heading_sd = math.sqrt(run.settled.P[at.PHI + 2, at.PHI + 2])
    return not any(doubts) and heading_sd < _SURE_HEADING  # one on trial is on trial again


def resumed(saved: SavedState, run: FilterRun, stamp_ns: int) -> FilterRun:
    """What ``run``, which has seen nothing, is with ``saved`` at its first IMU sample; itself where that is no use."""
    gap = 1e-9 * (stamp_ns - saved.stamp_ns)
    name, why = warm_start.refusal(saved, gap)
    if why:
        run.journal.say(stamp_ns, f"resume.refused.{name}", Level.WARN, f"the saved state is not used: {why}")
        return run
    noise = NoiseIdentification()
    noise.imu_variance, noise.gnss_variance = saved.imu_variance, saved.gnss_variance
    noise.trials = saved.trials
    origin = run.origin if run.origin_is_fixed else saved.origin
    twin = FilterRun(run.parameters, run.journal, origin, run.gnss.reception.enabled, None, noise)
    twin.origin_is_fixed, twin.imu_physics = run.origin_is_fixed, run.imu_physics
    twin.start_up.warm_start = WarmStart(saved, -gap, run.parameters)
    twin.timeline.shift = np.array(saved.correction_enu)
    twin.gnss.position.resets = saved.resets + 1
    twin.gnss.reception.gate.state.open = saved.gate_is_open
    for kind, offset in ((MagSample, saved.compass_offset), (PressureSample, saved.baro_offset)):
        sensor = twin.aids[kind]
        if isinstance(sensor, (Magnetometer, Barometer)) and math.isfinite(offset):
            sensor.begin_with(offset)
    text = f"a state of {gap:.1f} s before is there: origin and noise are kept"
    run.journal.say(stamp_ns, "resume.begun", Level.INFO, text)
    return twin


def arrays_of(estimator: PoseEstimator) -> dict[str, np.ndarray] | None:
    """What the next process can go on with, as named arrays: state and outage model; None while nothing is known."""
    state = state_of(estimator.sins.run)
    if state is None:
        return None
    arrays, aid = state.arrays(), estimator.outage_aid
    if aid is not None and aid.learner.state.model is not None:
        arrays.update({_MODEL + name: value for name, value in aid.learner.arrays().items()})
    return arrays


def resume(estimator: PoseEstimator, arrays: Mapping[str, np.ndarray]) -> None:
    """Let an estimator that has seen nothing go on from ``arrays``, if its first IMU sample allows that.

    ``UserError`` where they are not what ``arrays_of`` gave, or beyond what a vehicle can do.
    """
    saved = SavedState.of(arrays)
    model = {name.removeprefix(_MODEL): value for name, value in arrays.items() if name.startswith(_MODEL)}
    check_bounds("the saved state", model)

    def begin(run: FilterRun, stamp_ns: int) -> FilterRun:
        twin = resumed(saved, run, stamp_ns)
        if twin is not run and model and estimator.outage_aid is not None:
            _load_model(estimator.outage_aid.learner, model, run.journal, stamp_ns)
        return twin

    estimator.sins.resume = begin


def _load_model(learner: OutageLearner, model: Mapping[str, np.ndarray], journal: Journal, stamp_ns: int) -> None:
    try:
        learner.load(model)
    except UserError as error:  # of another learner.method
        journal.say(stamp_ns, "resume.model.refused", Level.INFO, f"the saved outage model is not used: {error}")
