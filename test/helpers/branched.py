"""A filter on its own time line in an outage, with evidence about the motion of the vehicle."""

from typing import Any

import numpy as np
import pytest

from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.kalman import correct
from nav_pose_estimator.core.filter.noise_identification import NoiseIdentification
from nav_pose_estimator.engine.navigator import filter_setup
from nav_pose_estimator.engine.navigator.split_filter import MOTION
from nav_pose_estimator.engine.navigator.timeline import Timeline
from nav_pose_estimator.engine.observation import FilterView, Kind, Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import Hypothesis, MotionEvidence

RATE, GRAVITY = 50, 9.80665
LAT, LON, ALT = 0.8, 0.2, 300.0
PERIOD = 0.5
NORTH = Kind("north")
POSITION, VELOCITY = Kind("position", 0, whole=True), Kind("velocity", 1, whole=True)


def apply(o: Observation, f: FilterView) -> None:
    """A position, a velocity over ground, or the velocity North alone."""
    if o.kind is POSITION:
        z, H = measurements.gnss_position(f.nav, len(f.P), *o.measured, np.zeros(3))
    elif o.kind is VELOCITY:
        z, H = measurements.gnss_velocity(f.nav, len(f.P), np.array(o.measured), np.zeros(3))
    else:
        z, H = measurements.horizontal_velocity(f.nav, len(f.P), f.nav[at.VEL], *o.measured)
        z, H = z[1:], np.ascontiguousarray(H[1:])
    correct(*f, z, H, 0.1 * np.eye(len(z)))


def observation(t: float, kind: Kind, measured: Any) -> Observation:
    """Observation whose stamp is its time of validity."""
    return Observation(t, round(t * 1e9), kind, measured)


def started(speed: float = 0.0, accel_error: float = 0.02, size: int = at.BASE_STATES, sampling: str = "mean"):
    """A level filter, nose East, at ``speed`` East; its accelerometer bias is known to ``accel_error``."""
    parameters = update(Parameters(), {"imu.sampling": sampling, "navigator.gyro_matrix_states": size > at.BASE_STATES})
    timeline = Timeline(filter_setup.constants(parameters, NoiseIdentification()), apply, 1.5)
    nav = np.zeros(at.NAV_SIZE)
    nav[at.LAT : at.VEL], nav[at.VEL], nav[at.QUAT] = (LAT, LON, ALT), speed, 1.0
    sd = np.full(size, 1e-4)
    sd[at.PHI : at.DVEL], sd[at.DVEL : at.DPOS], sd[at.DPOS : at.D_GYRO_BIAS] = 2e-3, 0.1, 0.5
    sd[at.D_ACCEL_BIAS : at.BASE_STATES] = accel_error
    timeline.start(nav, np.diag(sd**2))
    return timeline


def imu_rows(seconds: float, acceleration=lambda t: 0.0, error: float = 0.0, seed: int = 3) -> np.ndarray:
    """IMU rows of a level vehicle that accelerates East; the accelerometer reads ``error`` too much."""
    random = np.random.default_rng(seed)
    rows = np.zeros((int(seconds * RATE), at.IMU_COLUMNS))
    rows[:, 0] = (1 + np.arange(len(rows))) / RATE
    rows[:, 1:4] = random.normal(0.0, 1e-3, (len(rows), 3))
    rows[:, 4:] = random.normal([0.0, 0.0, GRAVITY], 0.02, (len(rows), 3))
    rows[:, 4] += error + np.array([acceleration(t) for t in rows[:, 0]])
    return rows


def evidence(timeline: Timeline, air: float | None = None, activity: float = 0.0, likely: float = 0.5):
    """Hover: 0.3 m/s; travel: 5 m/s, and an air velocity along x where there is one.

    ``activity`` is what the network's inputs say for travelling (log likelihood ratio); ``likely`` a priori of travel.
    """
    C = np.eye(3)
    velocity = tuple(timeline.filter.nav[at.VEL : at.VEL + 3].tolist())
    noise = None if air is None else (0.2, 0.2, 0.2)
    wide = None if air is None else (1.0, 1.0, 1.0)
    travel = Hypothesis("travel", likely, 25.0 * 4.0, noise, activity)
    hover = Hypothesis("hover", 1.0 - likely, 0.09 * 8.0, wide, 0.0)
    moved = None if air is None else (air, 0.0, 0.0)
    return MotionEvidence(
        round(timeline.filter.time * 1e9), PERIOD, C, velocity, velocity, moved, (travel, hover), 20.0, wind_tau=40.0
    )


def fly(timeline: Timeline, rows: np.ndarray, told=lambda t: {}, until: float = np.inf) -> np.ndarray:
    """Feed IMU rows with evidence every half second; returns (t, weight of travel) (N, 2)."""
    weights = []
    for chunk in np.split(rows, range(RATE // 2, len(rows), RATE // 2)):
        timeline.advance(chunk)
        if timeline.filter.time > until:
            break
        timeline.observe(observation(timeline.filter.time, MOTION, evidence(timeline, **told(timeline.filter.time))))
        timeline.settle()
        assert timeline.filter.branches is not None
        assert timeline.filter.branches.weights.sum() == pytest.approx(1.0, abs=1e-12)
        assert (timeline.filter.branches.weights >= 0.9e-4).all()
        weights.append((timeline.filter.time, timeline.filter.branches.weights[0]))
    return np.array(weights)


def east(timeline: Timeline) -> float:
    """Metres East of the start."""
    return float((timeline.filter.nav[at.LON] - LON) * 6.388e6 * np.cos(LAT))
