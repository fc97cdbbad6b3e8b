"""The heading error that a magnetometer learns while GNSS shows the heading."""

import math

import numpy as np

from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.sensors.aiding import Aiding
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
