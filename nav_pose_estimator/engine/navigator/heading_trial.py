"""Heading trial: a heading from the magnetometer alone, or from before an IMU gap, is tested by the first motion.

The navigator starts with this heading at once. An aligner without magnetometer runs beside it: at the first motion its
heading hypotheses follow GNSS, and their result is compared with the heading on trial. Where the latter is far off, the
navigator continues from the aligner's state, and the magnetometer is no longer used.

The aligner alone is not sufficient evidence. In slow, smooth motion it takes a gentle turn for rest; then all its
hypotheses start from a wrong level and wrong gyroscope biases, and one of them still wins. So the navigator has to
confirm the result with the data of GNSS: its own heading has turned to the aligner's, or its NIS is larger than
expected and larger than the aligner's. Otherwise the trial continues with a fresh aligner.
"""

from __future__ import annotations

import math

import numpy as np

from nav_pose_estimator.core.alignment.carried_heading import CarriedHeading
from nav_pose_estimator.core.alignment.types import Alignment
from nav_pose_estimator.core.earth.ellipsoid import step_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.strapdown import propagate
from nav_pose_estimator.core.numerics.rotation import euler_from_quat, quat_from_euler
from nav_pose_estimator.engine.imu.heading_monitor import HeadingMonitor
from nav_pose_estimator.engine.navigator import filter_setup
from nav_pose_estimator.engine.navigator.filter_run import FilterRun
from nav_pose_estimator.engine.samples import MagSample
from nav_pose_estimator.engine.sensors.magnetometer import Magnetometer
from nav_pose_estimator.engine.solutions import Level

# rad: heading error that ends the trial. It is more than an unset declination and the hypotheses' 10 deg together; the
# filter corrects smaller errors by itself.
_FAR_OFF = 0.6
_SIGNIFICANT = 3.0  # joint standard deviations
_CONTRADICTED = 2.0  # mean NIS per row above which GNSS contradicts the navigator's heading
TURNED = "navigator.turned"
"""Event: the navigator continues with another heading, and quantities learned with the old one are void."""
_TURNED_HEADING_SD, _TURNED_TILT_SD = 0.25, 0.05  # rad: standard deviations after ``turn``
_TURNED_GYRO_SD, _TURNED_ACCEL_SD = 0.01, 0.2  # rad/s, m/s^2: the same of the biases
_PATIENCE = 5.0  # s without a fix after which the aligner restarts, so that it need not keep more IMU rows


def carry(run: FilterRun, trial: CarriedHeading, rows: np.ndarray, out: np.ndarray) -> None:
    """Propagate aligner and heading on trial over IMU ``rows`` (N, 7); ``out`` (N, OUT_COLUMNS) are the solutions.

    The heading on trial is the navigator's up to the first motion. From then on fixes correct the navigator, and the
    heading on trial is propagated by the gyroscope alone.
    """
    for row, solution in zip(rows, out, strict=True):
        run.start_up.imu(row)
        if run.start_up.aligner.is_stale(max(_PATIENCE, run.aiding.lost_after)):
            run.start_up = run.start_up.afresh(run.parameters)
        if run.start_up.aligner.bank is not None:
            trial.carry(row[at.IMU_T], solution[at.OUT_RATE : at.OUT_FORCE])
        else:
            trial.hold(row[at.IMU_T], solution[at.OUT_QUAT : at.OUT_RATE].copy())


def judge(run: FilterRun, trial: CarriedHeading, stamp_ns: int) -> None:
    """Compare the two headings once the aligner has one, after an input with the stamp ``stamp_ns``."""
    second = run.start_up.result()
    if second is None:
        return
    age = run.now - second.t
    # with velocities in wrong axes the aligner's heading would be wrong: a new one has to be found
    if age > run.parameters.navigator.memory or run.gnss.reception.velocities.doubted:
        run.start_up = run.start_up.afresh(run.parameters)
        return
    # without the states of sensors, which are added again at their next observation
    constants = filter_setup.constants(run.parameters, run.noise)
    start = filter_setup.complete_start(second, constants, run.parameters)
    nav, P = start[0].copy(), start[1].copy()
    for row in run.timeline.rows_since(run.timeline.filter.time - age):
        propagate(nav, P, constants, row)
    yaw, sd = _heading(nav, P)
    error = math.remainder(trial.yaw - yaw, 2.0 * math.pi)
    if abs(error) > _FAR_OFF and (abs(error) <= _SIGNIFICANT * sd or not _navigator_agrees(run, (yaw, sd), second.nis)):
        run.start_up = run.start_up.afresh(run.parameters)
        return
    run.trial = None
    if abs(error) > _FAR_OFF:
        for aid in run.aids.values():
            aid.compare_anew()
        if trial.from_magnetometer:
            magnetometer = run.aids[MagSample]
            assert isinstance(magnetometer, Magnetometer)
            magnetometer.reject(stamp_ns, error)
        else:
            text = f"the heading from before the gap was wrong by {math.degrees(abs(error)):.0f} deg, as motion shows"
            run.journal.say(stamp_ns, "resume.heading.wrong", Level.WARN, text, error_deg=math.degrees(error))
        _start_from(run, constants, start)


def turn(run: FilterRun, monitor: HeadingMonitor, stamp_ns: int) -> None:
    """Correct a heading that ``monitor`` has shown to be far off.

    A filter with a wrong heading has also wrong tilt and biases, which compensated for it. So roll and pitch are taken
    from the monitor as well, and the biases are reset.
    """
    whole, angle = run.settled, monitor.error
    nav, P = whole.nav.copy(), whole.P.copy()
    own = nav[at.QUAT : at.GYRO_BIAS]
    roll, pitch, _ = euler_from_quat(own if monitor.level is None else monitor.level)
    nav[at.ACCEL_BIAS : at.ACCEL_BIAS + 3] = 0.0  # as assumed in the monitor's roll and pitch
    own[:] = quat_from_euler(roll, pitch, euler_from_quat(own)[2] + angle)
    tilt = max(float(P.diagonal()[at.PHI : at.PHI + 2].max()), _TURNED_TILT_SD**2)
    for start, variances in (
        (at.PHI, [tilt, tilt, _TURNED_HEADING_SD**2]),
        (at.D_GYRO_BIAS, [_TURNED_GYRO_SD**2] * 3),
        (at.D_ACCEL_BIAS, [_TURNED_ACCEL_SD**2] * 3),
    ):
        states = slice(start, start + 3)
        P[states, :] = P[:, states] = 0.0
        P[states, states] = np.diag(variances)
    constants = filter_setup.constants(run.parameters, run.noise)
    base = P[: at.BASE_STATES, : at.BASE_STATES]  # states of sensors were wrong as well, and are added again later
    bare = Alignment(whole.time, nav, base, "turned")
    run.timeline.restart(constants, *filter_setup.complete_start(bare, constants, run.parameters))
    run.gnss.position.resets += 1
    run.gyro_watch.filter_restarts()
    run.past.forget()
    for aid in run.aids.values():
        aid.compare_anew()
    magnetometer, error = run.aids[MagSample], -angle
    assert isinstance(magnetometer, Magnetometer)
    if run.trial is not None and run.trial.from_magnetometer:
        magnetometer.reject(stamp_ns, error)
    else:
        text = f"the heading was wrong by {math.degrees(abs(error)):.0f} deg, as IMU and GNSS show: corrected"
        run.journal.say(stamp_ns, TURNED, Level.WARN, text, error_deg=math.degrees(error))
    run.trial = None


def _heading(nav: np.ndarray, P: np.ndarray) -> tuple[float, float]:
    """Yaw and its standard deviation [rad]."""
    return float(euler_from_quat(nav[at.QUAT : at.GYRO_BIAS])[2]), math.sqrt(max(P[at.PHI + 2, at.PHI + 2], 0.0))


def _navigator_agrees(run: FilterRun, heading: tuple[float, float], nis: float) -> bool:
    """Whether the navigator, which started with the heading on trial, confirms the aligner's ``heading``.

    ``heading``: the aligner's yaw and its deviation [rad]; ``nis``: its mean NIS per degree of freedom.
    """
    yaw, sd = heading
    own, own_sd = _heading(run.timeline.filter.nav, run.timeline.filter.P)
    if abs(math.remainder(own - yaw, 2.0 * math.pi)) <= _SIGNIFICANT * math.hypot(own_sd, sd):
        return True
    return run.gnss.velocity.doubt.nis > max(_CONTRADICTED, nis)


def _start_from(run: FilterRun, constants: np.ndarray, start: tuple[np.ndarray, np.ndarray]) -> None:
    """Continue from another state, valid a moment ago; the odometry does not jump."""
    run.timeline.settle()
    before = run.timeline.filter.nav[at.LAT : at.VEL].copy()
    run.timeline.restart(constants, *start)
    run.timeline.shift = run.timeline.shift + step_enu(before, run.timeline.filter.nav[at.LAT : at.VEL])
    run.gnss.position.resets += 1
    run.gyro_watch.filter_restarts()
