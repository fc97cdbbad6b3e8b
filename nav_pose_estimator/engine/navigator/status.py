"""Status of the navigator for the operator."""

from __future__ import annotations

import math

from nav_pose_estimator.core.filter.kalman import horizontal_sd, predicted_horizontal_sd
from nav_pose_estimator.core.filter.layout import PHI
from nav_pose_estimator.engine.continuation.warm_start import WIDEST_HEADING
from nav_pose_estimator.engine.navigator.filter_run import FilterRun
from nav_pose_estimator.engine.navigator.split_filter import MOTION
from nav_pose_estimator.engine.samples import BodyVelocity, PressureSample
from nav_pose_estimator.engine.sensors.barometer import Barometer
from nav_pose_estimator.engine.sensors.body_velocity import BodyVelocitySensor
from nav_pose_estimator.engine.solutions import Status

_OUTLOOK = 30.0  # s: horizon of the predicted standard deviation
_MANY = 50  # rejected IMU samples after which the status names the likely unit
_HELPERS = {
    "body_velocity": "the body velocity",
    "airspeed": "the airspeed",
    "zero_velocity": "the vehicle standing still",
    MOTION.name: "what this flight has shown of the motion",  # learned regimes and air velocity
}


def horizontal_deviation(run: FilterRun) -> float:
    """Horizontal standard deviation of the position [m]; infinite while the filter does not run."""
    return float(horizontal_sd(run.settled.P)) if run.timeline.running else math.inf


def status_of(run: FilterRun) -> Status:
    """Status of a run of the filter."""
    t, sd, later, reception = 0.0, horizontal_deviation(run), math.inf, run.gnss.reception
    if run.timeline.running:
        whole = run.settled
        t, later = whole.time, predicted_horizontal_sd(whole.nav, whole.P, whole.constants, _OUTLOOK)
    values = {"alignment.restarts": float(run.start_up.aligner.restarts), **run.gnss.figures()}
    values.update(run.noise.figures() | run.imu_physics.figures())
    for aid in run.aids.values():
        values.update(aid.figures())
    return Status(
        stamp_ns=run.clock.stamp(t),
        mode=run.modes.mode,
        waiting_for=_waiting_for(run),
        seconds_coasting=run.modes.seconds_unaided(t, run.aiding),
        held_by=" and ".join(_HELPERS.get(name, name.replace("_", " ")) for name in run.aiding.holding(t)),
        horizontal_sd=sd,
        horizontal_sd_in_30_s=later,
        gnss_refusal=reception.refusal,
        satellites=reception.satellites,
        counters=dict(run.journal.counters),
        values=values,
        doubt=run.gnss.position.doubt(t)
        or run.imu_physics.doubt
        or run.gyro_watch.reason
        or run.gyro_watch.compass_reason
        or _unseen(run)
        or _unknown_heading(run)
        or _heights(run)
        or _body_velocity(run)
        or reception.velocity_scatter.reason,
    )


def _unseen(run: FilterRun) -> str:
    """Clause for a gap in the IMU data during an outage; empty without one, or after a fix."""
    if not run.unseen:
        return ""
    what = "the velocity is" if run.pose_given else "position and velocity are"
    return f"no sensor observed {run.unseen:.1f} s of the motion without GNSS: {what} less certain"


def _heights(run: FilterRun) -> str:
    """That barometer and GNSS tell different heights, one clause; empty where they do not."""
    barometer = run.aids[PressureSample]
    return barometer.contradiction if isinstance(barometer, Barometer) else ""


def _body_velocity(run: FilterRun) -> str:
    """That a body velocity has changed without a force, one clause; empty where it has not."""
    sensor = run.aids[BodyVelocity]
    return sensor.reason if isinstance(sensor, BodyVelocitySensor) else ""


def _unknown_heading(run: FilterRun) -> str:
    """Clause for an unknown heading after a restart in flight; empty where it is known."""
    sd = math.sqrt(run.settled.P[PHI + 2, PHI + 2]) if run.timeline.running else 0.0
    if sd <= WIDEST_HEADING:
        return ""
    return f"the heading is known to only {math.degrees(sd):.0f} deg until the vehicle speeds up, brakes or turns"


def _waiting_for(run: FilterRun) -> str:
    """What the navigator is waiting for, or why it must not be trusted, one sentence; empty where nothing is wrong."""
    refusal = run.imu_physics.refusal
    if run.timeline.running:
        return run.modes.distrust_reason or refusal
    if not run.imu_physics.knows_anything and run.journal.counters["imu.rejected.force"] > _MANY:
        limit = run.parameters.imu.max_force
        unit = "probably in cm/s^2, mg or raw counts"
        return f"IMU samples are refused, their specific force is above {limit:g} m/s^2: {unit}."
    if not run.imu_physics.knows_anything and run.journal.counters["imu.rejected.rate"] > _MANY:
        limit = run.parameters.imu.max_rate
        return f"IMU samples are refused, their angular rate is above {limit:g} rad/s: probably in deg/s."
    return refusal or run.start_up.waiting_for(run.gnss.reception.refusal)
