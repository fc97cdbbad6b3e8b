"""Coasting on simulated flights: the stated deviation covers the drift, and what widens it at a loss."""

import math

import numpy as np
import pytest

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.jit import COMPILED
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, PressureSample, SatelliteCount
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate

GNSS = (GnssFix, GnssVelocity, SatelliteCount)
STARTS, LENGTH, LONG = (100.0, 120.0, 140.0), 30.0, 170.0
pytestmark = pytest.mark.skipif(not COMPILED, reason="minutes of flight need compiled kernels")


def fly(recording: Recording, until: float, engine: SinsEngine, after: float = -1.0, gnss: bool = True) -> float:
    """Feed the samples between two times [s]; returns the time reached."""
    now = 0.0
    for sample in recording.samples():
        stamp = sample.stamps_ns[-1] if isinstance(sample, ImuBlock) else sample.stamp_ns
        now = now if stamp is None else (int(stamp) - recording.start_ns) * 1e-9
        if now > until:
            return now
        if now > after and (gnss or not isinstance(sample, GNSS)):
            engine.feed(sample)
    return now


def horizontal_error(recording: Recording, engine: SinsEngine, t: float) -> float:
    truth, nav = recording.truth, engine.run.settled.nav.copy()
    t = min(t, float(nav[at.TIME]) + float(truth.t[0]))
    return float(np.hypot(*recording.error_enu(t, nav[at.LAT : at.VEL])[:2]))


@pytest.mark.parametrize(("grade", "seed"), [("icm42688", 1), ("bmi088", 2), ("mpu6000", 3), ("mpu6000", 5)])
def test_the_deviation_covers_the_drift_of_every_grade(grade, seed):
    """GIVEN an IMU of any grade WHEN GNSS is lost for 30 s, three times THEN no drift exceeds three deviations."""
    recording = generate("stop_and_go", duration=LONG, seed=seed, imu=grade, imu_rate=100.0)
    aided, reached, ratios = SinsEngine(), -1.0, []
    for begin in STARTS:
        fly(recording, begin, aided, after=reached)
        reached = begin
        coasting = aided.snapshot()
        fly(recording, begin + LENGTH, coasting, after=begin, gnss=False)
        sd = coasting.status().horizontal_sd
        ratios.append(horizontal_error(recording, coasting, begin + LENGTH) / sd)
    assert max(ratios) < 3.0
    assert max(ratios) > 0.05  # a deviation of kilometres would be no statement


def deviation_after_a_loss(nis: float) -> tuple[float, float]:
    """Horizontal deviation just before and 2 s after a loss at which the innovations stand at ``nis``."""
    recording = generate("multirotor_light", duration=80.0, seed=2, imu_rate=100.0)
    engine = SinsEngine()
    fly(recording, 70.0, engine)
    assert engine.mode is Mode.AIDED
    before = engine.status().horizontal_sd
    engine.run.gnss.velocity.record.mean = nis
    fly(recording, 72.5, engine, after=70.0, gnss=False)
    assert engine.mode is not Mode.AIDED
    return before, engine.status().horizontal_sd


def test_innovations_that_were_too_large_widen_the_deviation_at_a_loss():
    """GIVEN innovations four times their expected square WHEN GNSS is lost THEN the deviation is twice as large."""
    _, calm = deviation_after_a_loss(0.5)
    _, wild = deviation_after_a_loss(4.0)
    assert wild / calm == pytest.approx(2.0, rel=0.05)


def test_a_barometer_holds_the_height_and_leaves_the_horizontal_alone():
    """GIVEN an outage WHEN the barometer goes on THEN the height stays, and the horizontal track is that without it."""
    recording = generate("multirotor_light", duration=130.0, seed=4, imu_rate=100.0)
    found = []
    for barometer in (True, False):
        engine = SinsEngine(update(Parameters(), {"aids.barometer": barometer}))
        fly(recording, 90.0, engine)
        fly(recording, 120.0, engine, after=90.0, gnss=False)
        found.append((engine.run.settled.nav.copy(), math.sqrt(engine.run.timeline.filter.P[at.DPOS + 2, at.DPOS + 2])))
    (held, held_sd), (free, free_sd) = found
    assert held_sd < 0.7 * free_sd
    # only through the gravity of another height, which is small
    apart = np.hypot(*lla_to_enu(*held[at.LAT : at.VEL], *free[at.LAT : at.VEL])[:2])
    assert apart < 0.5
    assert any(isinstance(sample, PressureSample) for sample in recording.samples())


def test_what_holds_the_drift_is_named_for_as_long_as_it_does():
    """GIVEN two kinds of observations WHEN one stops THEN after three seconds only the other holds the drift."""
    aiding = Aiding(patience=1.0)
    aiding.bound_drift(10.0, "airspeed")
    aiding.bound_drift(12.5, "zero_velocity")
    assert aiding.holding(12.6) == ["airspeed", "zero_velocity"]
    assert aiding.holding(13.1) == ["zero_velocity"]
