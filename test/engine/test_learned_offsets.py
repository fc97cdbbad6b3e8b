"""What magnetometer and barometer learn while GNSS shows heading and height."""

import math

import numpy as np

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.barometer import Barometer
from nav_pose_estimator.engine.sensors.magnetometer import Magnetometer


def test_an_offset_that_passes_half_a_turn_stays_an_angle() -> None:
    """GIVEN a heading error near 180 deg WHEN it passes it slowly THEN the offset follows and does not exceed it."""
    sensor = Magnetometer(Parameters(), Aiding(patience=3.0), Journal())
    for k, turned in enumerate(np.linspace(math.radians(170.0), math.radians(190.0), 6000)):
        error = math.remainder(float(turned), math.tau)
        sensor.learn(Observation(0.1 * k, 0, sensor.kind, (0.0, 2e-5, -4e-5)), error, (1.0, 0.0, 0.0, 0.0))
        assert abs(sensor._offset) <= math.pi
        assert abs(math.remainder(error - sensor._offset, math.tau)) < math.radians(5.0)
    assert sensor._offset < 0.0


def test_a_sensor_without_a_shortest_period_learns_its_offset() -> None:
    """GIVEN periods of 0, so that every sample counts, WHEN the offset has been 0 once and is constant from then on
    THEN most of it is learned within a minute."""
    parameters = update(Parameters(), {"aids.barometer_period": 0.0, "aids.magnetometer_period": 0.0})
    barometer = Barometer(parameters, Aiding(patience=3.0), Journal())
    compass = Magnetometer(parameters, Aiding(patience=3.0), Journal())
    for k in range(6000):
        t, is_later = 0.01 * k, float(k > 0)
        barometer.learn(Observation(t, 0, barometer.kind, 300.0 + 20.0 * is_later), 300.0, 1.0)
        compass.learn(Observation(t, 0, compass.kind, (0.0, 2e-5, -4e-5)), 0.2 * is_later, (1.0, 0.0, 0.0, 0.0))
    assert 15.0 < barometer.offset <= 20.0
    assert 0.15 < compass.offset <= 0.2
