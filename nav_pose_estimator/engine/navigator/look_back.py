"""Evaluation of the IMU data of each second: rest, noise of the sensors, and plausibility against GNSS and physics."""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.alignment.rest import Stillness
from nav_pose_estimator.core.earth.ellipsoid import step_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import noise_identification
from nav_pose_estimator.core.filter.blocks import GYRO_MATRIX
from nav_pose_estimator.core.numerics.imu_checks import first_after
from nav_pose_estimator.engine.imu import physics
from nav_pose_estimator.engine.imu.doubt import Doubt
from nav_pose_estimator.engine.navigator import heading_trial
from nav_pose_estimator.engine.navigator.filter_run import FilterRun
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.navigator.split_filter import SplitFilter
from nav_pose_estimator.engine.samples import BodyVelocity, MagSample
from nav_pose_estimator.engine.sensors.body_velocity import BodyVelocitySensor
from nav_pose_estimator.engine.sensors.gyroscope.watch import Second
from nav_pose_estimator.engine.sensors.magnetometer import Magnetometer
from nav_pose_estimator.engine.solutions import Level

_GROUNDED = 1.0  # m/s
_OFF_FOR = 4.0  # s over which the median innovation of positions is taken
_OFF_SDS, _OFF = 2.4, 3.6
"""Deviations of a fix, and metres, by which that median must exceed chance; recorded flights: 3.1 m, 4.5 m in loops."""
_SURE_SDS = 2.0  # horizontal deviations by which the navigator must have moved away from a repeated position
_GNSS_ENDS = 515.0  # m/s, 1000 knots: faster vehicles get no fix from receivers that may be exported (MTCR)
_LATELY = 2.0  # s: velocities of this time judge how much a second shows of the gyroscope
_ROWS = 1.5 * noise_identification.PERIOD  # s: the last second began with the row before it


def look_back(run: FilterRun, t: float) -> None:
    """Evaluate the second before the IMU row at ``t`` [s], the first one of a new second, before that row is processed.

    Only what has arrived by then counts, and the results stay when the past is replayed.
    """
    end = math.floor(t / Stillness.PERIOD) * Stillness.PERIOD
    run.second_due = end + Stillness.PERIOD
    run.past.second(run)
    if run.timeline.running:
        _look_at_motion(run)
    _look_at_imu(run, t, end)
    if run.timeline.running:
        _magnetometer(run).turns.second(round(end), run.imu_physics.motion.angles)


def _magnetometer(run: FilterRun) -> Magnetometer:
    sensor = run.aids[MagSample]
    assert isinstance(sensor, Magnetometer)
    return sensor


def _look_at_motion(run: FilterRun) -> None:
    whole, t = run.timeline.filter, run.timeline.filter.time
    is_aided = run.aiding.gnss_is_good(t)
    rows = run.timeline.rows_since(t - _ROWS)
    mean_rate = run.stillness.add(rows[first_after(rows, t - Stillness.PERIOD) :])
    rests = mean_rate is not None
    _watch_for_a_pull(run, rows, is_aided)
    run.gnss.position.monitors.second(t, rests)
    run.gnss.reception.velocity_scatter.second(run.clock.stamp(t))
    if is_aided:
        _doubt_the_position(run, t)
    # to the IMU a smooth cruise looks like rest
    if not rests or math.hypot(*whole.nav[at.VEL : at.VEL + 2].tolist()) > _GROUNDED:
        _doubt_repeated_fixes(run, t, is_aided)
    _doubt_the_body_velocity(run, t, is_aided)
    _watch_the_gyroscope(run, t, is_aided)
    if run.parameters.imu.learn_noise:
        _identify_noise(run, rows, is_aided, rests)
    if mean_rate is not None and run.parameters.aids.zero_velocity:
        run.observe(run.rest.observe(mean_rate, whole.view, run.clock.stamp(t)))


def _watch_the_gyroscope(run: FilterRun, t: float, is_aided: bool) -> None:
    """Check the gyroscope's scale with the filter's own estimate of it, and release its prior where it is wrong."""
    whole, watch = run.timeline.filter, run.gyro_watch
    if not GYRO_MATRIX.is_in(whole.constants):
        return
    motion, reception = run.imu_physics.motion, run.gnss.reception
    # velocities that are late, noisy or in wrong axes, and heavy vibration, are no evidence against the gyroscope
    is_late, is_noisy = motion.latency.is_probable, reception.velocity_scatter.is_on
    misled = is_late or is_noisy or motion.shakes or reception.velocities.doubted
    if misled or not is_aided or whole.branches is not None:
        watch.evidence.skip()
        return
    own, stamp_ns = GYRO_MATRIX.states(whole.constants), run.clock.stamp(t)
    nis = run.gnss.velocity.doubt.largest_nis(t - _LATELY)
    bias = whole.nav[at.GYRO_BIAS : at.GYRO_BIAS + 3]
    turns = _magnetometer(run).turns
    suspected = motion.suspects or turns.is_mirrored
    m, P = whole.nav[GYRO_MATRIX.estimates], whole.P[own, own]
    walk = float(whole.constants[GYRO_MATRIX.psd].max())
    seen = Second(m, P, bias, nis, walk, suspected, motion.imu_agrees, turns.differs)
    if watch.second(seen, run.journal, stamp_ns):
        run.observe(run.gyro_matrix.observe(watch.evidence, t, stamp_ns))
    motion.filter_contradicts = watch.contradicts


def _watch_for_a_pull(run: FilterRun, rows: np.ndarray, is_aided: bool) -> None:
    """Check whether the fixes move without a measured force (a drag-off); only an aided filter can tell.

    ``rows`` (N, 7): of the IMU since the last second or longer, here and below.
    """
    whole, pull = run.timeline.filter, run.gnss.position.pull
    if whole.branches is not None or not is_aided:
        pull.interrupt()
        return
    pull.second(whole.view, rows, run.gnss.position.lever, run.clock.stamp(whole.time))


def _doubt_the_position(run: FilterRun, t: float) -> None:
    """Widen the position by a lasting offset of the fixes: velocities drag the filter, or the fixes are dragged."""
    off = run.gnss.position.record.lasting(_OFF_FOR)
    if off > max(_OFF_SDS * run.parameters.gnss.position_sd, _OFF):
        run.observe(run.imu_doubt.observe(Doubt(0.0, 0.0, position=off), t, run.clock.stamp(t)))


def _doubt_repeated_fixes(run: FilterRun, t: float, is_aided: bool) -> None:
    """Find a stuck receiver by a navigator that moves away from a position which repeats to the last digit.

    The filter has been drawn to that position, so the last seconds are computed again without it. A fast vehicle leaves
    it so quickly that the fixes are refused, and would be taken for a return to another place some seconds later.
    """
    reception, whole = run.gnss.reception, run.timeline.filter
    count = reception.repeats.count(t, reception.velocities)
    if not count or (reception.velocities.is_zero and not is_aided):
        return
    if is_aided:
        moved = run.gnss.position.record.change(count)
    else:
        east, north, _ = step_enu(whole.nav[at.LAT : at.VEL], reception.repeats.place)
        moved = math.hypot(east, north)
    sure = moved > _SURE_SDS * math.sqrt(float(whole.P[at.DPOS, at.DPOS] + whole.P[at.DPOS + 1, at.DPOS + 1]))
    if sure and reception.repeats.find_stuck(moved, reception.rounding.step):
        text = f"GNSS repeats a position to the last digit while the vehicle has moved {moved:.0f} m: it is stuck"
        run.journal.say(run.clock.stamp(t), "gnss.stuck", Level.WARN, text, moved_m=moved)
        reception.velocities.misled = True


def _doubt_the_body_velocity(run: FilterRun, t: float, is_aided: bool) -> None:
    """Widen the covariance in an outage by what the errors of a body velocity may have caused in a second."""
    sensor = run.aids[BodyVelocity]
    assert isinstance(sensor, BodyVelocitySensor)
    if is_aided:
        sensor.doubt.end()
        return
    holds = t - run.aiding.bounded_by.get(sensor.kind.name, -math.inf) < Stillness.PERIOD
    velocity = complex(*run.timeline.filter.nav[at.VEL : at.VEL + 2].tolist()) if holds else 0j
    doubt = sensor.doubt.second(velocity, sensor.possible_error)
    if doubt is not None:
        run.observe(run.imu_doubt.observe(doubt, t, run.clock.stamp(t)))


def _identify_noise(run: FilterRun, rows: np.ndarray, is_aided: bool, rests: bool) -> None:
    whole = run.timeline.filter
    if not is_aided or whole.branches is not None:
        run.noise.interrupt()
        return
    # rest is told from a smooth cruise by the speed; on the ground, with motors off, there is no vibration to identify
    if rests and math.hypot(*whole.nav[at.VEL : at.VEL + 3].tolist()) < _GROUNDED:
        run.noise.interrupt()
        return
    changed = run.noise.note(whole.nav, whole.P, whole.constants, rows)
    gnss = run.gnss
    if gnss.reception.lasting is not None:
        gnss.reception.lasting.second()
        for shares, sensor in ((run.noise.position, gnss.position), (run.noise.velocity, gnss.velocity)):
            shares.note(sensor.record.take())
        changed = True
    if changed:
        run.renew_constants()


def _look_at_imu(run: FilterRun, t: float, end: float) -> None:
    """Check that the rows of the second up to ``end`` [s] are physically possible IMU data.

    Impossible data corrupt attitude and biases permanently, so the filter restarts and waits. Without GNSS a restart
    would end the solution; it continues as EXPIRED instead, with growing variances, until GNSS is back.
    """
    rows, stamp_ns = run.timeline.rows_since(end - physics.REACH), run.clock.stamp(t)
    bias = run.timeline.filter.nav[at.GYRO_BIAS : at.GYRO_BIAS + 3] if run.timeline.running else None
    if run.timeline.running:
        run.imu_physics.heading.attitude(round(end), run.timeline.filter.nav[at.QUAT : at.GYRO_BIAS].copy())
    before = _shown_by(run.imu_physics)
    is_aided = run.aiding.gnss_is_good(run.now)
    is_doubted = bool(run.gyro_watch.reason)
    doubt = run.imu_physics.look(end, rows, bias, run.journal, stamp_ns, is_aided, is_doubted)
    if run.timeline.running:
        doubt = _doubt_the_speed(run, doubt, is_aided)
    run.gnss.reception.velocities.imu_evidence(
        run.imu_physics.imu_agrees, run.imu_physics.as_received_reduction, stamp_ns
    )
    if run.timeline.running and is_aided:
        motion = run.imu_physics.motion
        agreement, monitors = motion.agreement, run.gnss.position.monitors
        is_noisy = run.gnss.reception.velocity_scatter.is_on  # what the last velocities before that showed was noise
        is_contradicted = agreement.is_contradicted and not is_noisy
        monitors.other_motion.second(is_contradicted, agreement.apart, agreement.share, stamp_ns)
        delay, is_least = 0.0 if is_noisy else motion.latency.delay, motion.latency.is_least
        monitors.latency.found(delay, run.parameters.gnss.delay, stamp_ns, is_least)
    if run.imu_physics.heading.error and run.timeline.running:
        _turn_heading(run, stamp_ns)
    if run.timeline.running and _shown_by(run.imu_physics) != before:
        run.renew_constants()
    refusal = run.imu_physics.refusal
    if refusal or doubt is not None:
        run.gnss.position.pull.interrupt()
    if not run.timeline.running:
        if refusal:
            run.start_up = run.start_up.afresh(run.parameters)
    elif run.modes.mode not in DENIED or t - run.aiding.fix_offered < run.aiding.lost_after:
        run.imu_failure = refusal or (_diverged(run.timeline.filter) if is_aided else "")
        if doubt is not None and doubt.lasting:
            run.observe(run.imu_doubt.observe(doubt, run.timeline.filter.time, stamp_ns))
    else:
        _doubt_unaided(run, doubt, refusal)


def _shown_by(imu: physics.ImuPhysics) -> tuple[float, ...]:
    """What the comparisons of the IMU contribute to the filter's constants."""
    return imu.vibration.force_noise, imu.vibration.rate_noise, imu.motion.latency.windows


def _turn_heading(run: FilterRun, stamp_ns: int) -> None:
    """Try another heading where IMU and GNSS show a large heading error, unless they are in doubt themselves."""
    doubted = run.gnss.reception.velocities.doubted or run.imu_physics.doubt
    good = run.aiding.gnss_is_good(run.now) and not doubted
    if good and run.timeline.filter.branches is None:
        heading_trial.turn(run, run.imu_physics.heading, stamp_ns)
    run.imu_physics.heading.forget()


def _doubt_the_speed(run: FilterRun, doubt: Doubt | None, is_aided: bool) -> Doubt | None:
    """``doubt``, enlarged where the unaided speed exceeds what the vehicle has reached before."""
    whole, usual = run.timeline.filter, run.imu_physics.speed
    speed = math.hypot(*whole.nav[at.VEL : at.VEL + 2].tolist())
    if is_aided:
        usual.aided(speed)
        return doubt
    sd = math.sqrt(float(whole.P[at.DVEL, at.DVEL] + whole.P[at.DVEL + 1, at.DVEL + 1]))
    more = usual.unaided(speed, sd, run.modes.seconds_unaided(whole.time, run.aiding))
    return doubt if more is None else more if doubt is None else doubt.with_one_more(more)


def _doubt_unaided(run: FilterRun, doubt: Doubt | None, refusal: str) -> None:
    """Without GNSS: enlarge the covariance by the ``doubt`` about the IMU, or declare the solution unusable."""
    whole = run.timeline.filter
    stamp_ns = run.clock.stamp(whole.time)
    if doubt is not None:
        run.observe(run.imu_doubt.observe(doubt, whole.time, stamp_ns))
    reason = refusal or _too_fast(whole.nav, run.parameters.gnss.reacquisition.max_speed)
    if run.gnss.reception.velocities.position_fault:
        reason = f"The positions of GNSS were wrong: {run.gnss.reception.velocities.position_fault}."
    run.modes.distrust(reason, run.journal, stamp_ns)


def _diverged(whole: SplitFilter) -> str:
    """A sentence for the user where an aided filter has left all that GNSS can show it, else empty."""
    if not whole.P.diagonal().min() >= 0.0:
        return "A variance of the filter is negative: the solution has diverged."
    return _too_fast(whole.nav, _GNSS_ENDS)


def _too_fast(nav: np.ndarray, fastest: float) -> str:
    """A sentence for the user where the navigator's own speed exceeds ``fastest`` [m/s], else empty."""
    speed = math.hypot(nav[at.VEL], nav[at.VEL + 1])
    if speed <= fastest:
        return ""
    return f"The navigator's own speed is {speed:.0f} m/s, which the vehicle cannot reach: the solution has diverged."
