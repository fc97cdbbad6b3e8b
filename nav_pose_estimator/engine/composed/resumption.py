"""What an estimator leaves to the next process, and how that one begins with it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import numpy as np

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.core.motion.wind import unseen
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.continuation.saved_state import SavedState
from nav_pose_estimator.engine.continuation.warm_start import WarmStart
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator.filter_run import FilterRun
from nav_pose_estimator.engine.outage import rehearsal_arrays
from nav_pose_estimator.engine.outage.learner import OutageLearner
from nav_pose_estimator.engine.outage.model_file import check_bounds
from nav_pose_estimator.engine.outage.rehearsals import Rehearsals
from nav_pose_estimator.engine.samples import MagSample, PressureSample
from nav_pose_estimator.engine.sensors.barometer import Barometer
from nav_pose_estimator.engine.sensors.magnetometer import Magnetometer
from nav_pose_estimator.engine.solutions import Level
from nav_pose_estimator.errors import UserError

_MODEL, _REHEARSALS = "model.", "rehearsals."  # beginnings of the names of their arrays
_SURE_HEADING = 0.35  # rad: a wider one is nothing to go on with
_NOISE_LIFE = 3600.0  # s: by then batteries, payload or propellers may be others


def state_of(run: FilterRun) -> SavedState | None:
    """The present state of ``run``; None while the filter does not run."""
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
        error_shares=run.noise.error_shares,
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
    """``run``, which has seen nothing yet, with the state ``saved`` taken over at its first IMU sample.

    The origin goes on whatever its age: same vehicle, same map. The noise that was identified is that of IMU, receiver
    and airframe, and no factor is below one: for an hour it is better than none. The rest ages within a minute.
    """
    gap = 1e-9 * (stamp_ns - saved.stamp_ns)
    warm, noise = WarmStart(saved, -gap, run.parameters), NoiseIdentification()
    if 0.0 < gap <= _NOISE_LIFE:
        noise.imu_variance, noise.gnss_variance = saved.imu_variance, saved.gnss_variance
        noise.trials, noise.error_shares = saved.trials, saved.error_shares
    origin = run.origin if run.origin_is_fixed else saved.origin
    twin = FilterRun(run.parameters, run.journal, origin, run.gnss.reception.enabled, None, noise)
    twin.origin_is_fixed, twin.imu_physics = run.origin_is_fixed, run.imu_physics
    twin.start_up.warm_start = warm
    twin.gnss.position.resets = saved.resets + 1
    if warm.is_fresh:
        _go_on(twin, saved)
        text = f"a state from {gap:.1f} s ago was found: origin and noise are kept"
        if not saved.is_sound:
            text += "; it was in doubt itself, so attitude and position are found again"
        run.journal.say(stamp_ns, "resume.begun", Level.INFO, text)
    elif gap > 0.0:
        kept = "origin and noise are kept" if gap <= _NOISE_LIFE else "its origin is kept, and nothing else"
        text = f"a state from {gap:.0f} s ago was found, too old to continue from: {kept}"
        run.journal.say(stamp_ns, "resume.origin", Level.INFO, text)
    else:
        text = (
            f"the saved state is {-gap:.1f} s younger than the IMU: another clock, or another run; its origin is kept"
        )
        run.journal.say(stamp_ns, "resume.origin", Level.WARN, text)
    return twin


def _go_on(twin: FilterRun, saved: SavedState) -> None:
    """What only a state of less than a minute ago can tell."""
    twin.timeline.shift = np.array(saved.correction_enu)
    twin.gnss.reception.gate.state.open = saved.gate_is_open
    for kind, offset in ((MagSample, saved.compass_offset), (PressureSample, saved.baro_offset)):
        sensor = twin.aids[kind]
        if isinstance(sensor, (Magnetometer, Barometer)) and math.isfinite(offset):
            sensor.begin_with(offset)


def arrays_of(estimator: PoseEstimator) -> dict[str, np.ndarray] | None:
    """What the next process can go on with, as named arrays; None while nothing is known.

    The state of the navigator, the outage model and what rehearsals have shown.
    """
    state = state_of(estimator.sins.run)
    if state is None:
        return None
    arrays, aid = state.arrays(), estimator.outage_aid
    if aid is not None and aid.learner.state.model is not None:
        arrays.update({_MODEL + name: value for name, value in aid.learner.arrays().items()})
    if aid is not None and aid.rehearsals.count:
        shown = rehearsal_arrays.arrays_of(aid.rehearsals.state)
        arrays.update({_REHEARSALS + name: value for name, value in shown.items()})
    return arrays


def resume(estimator: PoseEstimator, arrays: Mapping[str, np.ndarray]) -> None:
    """Let an estimator that has seen nothing go on from ``arrays``, if its first IMU sample allows that.

    ``UserError`` where they are not what ``arrays_of`` gave, or beyond what a vehicle can do.
    """
    saved = SavedState.of(arrays)
    model, shown = (_named(arrays, beginning) for beginning in (_MODEL, _REHEARSALS))
    check_bounds("the saved state", model)
    if shown:
        rehearsal_arrays.take_over(Rehearsals().state, shown)  # refused now, not in flight

    def begin(run: FilterRun, stamp_ns: int) -> FilterRun:
        twin, gap = resumed(saved, run, stamp_ns), 1e-9 * (stamp_ns - saved.stamp_ns)
        warm, aid = twin.start_up.warm_start, estimator.outage_aid
        if aid is not None and warm is not None and warm.is_fresh:
            if model:
                _load_model(aid.learner, _with_older_wind(model, gap), run.journal, stamp_ns)
            if shown:
                rehearsal_arrays.take_over(aid.rehearsals.state, shown)
        return twin

    estimator.sins.resume = begin


def _named(arrays: Mapping[str, np.ndarray], beginning: str) -> dict[str, np.ndarray]:
    """Those whose names begin so, without the beginning."""
    return {name.removeprefix(beginning): value for name, value in arrays.items() if name.startswith(beginning)}


def _with_older_wind(model: Mapping[str, np.ndarray], seconds: float) -> Mapping[str, np.ndarray]:
    """``model`` with its wind ``seconds`` later, of which nobody has seen anything."""
    if not all(name in model for name in ("wind", "wind_cov", "wind_spread")):
        return model  # of a method that knows no wind
    wind, cov = unseen(model["wind"], model["wind_cov"], float(model["wind_spread"]), seconds)
    return {**model, "wind": wind, "wind_cov": cov}


def _load_model(learner: OutageLearner, model: Mapping[str, np.ndarray], journal: Journal, stamp_ns: int) -> None:
    try:
        learner.load(model)
    except UserError as error:  # of another learner.method
        journal.say(stamp_ns, "resume.model.refused", Level.INFO, f"the saved outage model is not used: {error}")
