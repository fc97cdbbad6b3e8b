"""Turns of the magnetometer against those of the gyroscope: a wrong sign is found without GNSS."""

import numpy as np
import pytest

from nav_pose_estimator.core.alignment.motion_history import BINS
from nav_pose_estimator.core.numerics.rotation import quat_rotate
from nav_pose_estimator.core.numerics.vectors import q_exp, q_multiply
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.magnetic.turn_check import TurnCheck
from nav_pose_estimator.engine.sensors.magnetometer import Magnetometer

FIELD = np.array([2e-5, 0.0, -4e-5])
SECONDS = 60
SAME = np.eye(3)
FRD = np.diag([1.0, -1.0, -1.0])
MIRRORED = np.diag([1.0, 1.0, -1.0])
TUMBLE, YAW = np.array([0.5, 0.4, 0.6]), np.array([0.0, 0.0, 0.6])  # rad/s: amplitudes of the rates


def checked(
    gyro: np.ndarray,
    mag: np.ndarray,
    rates: np.ndarray,
    iron: float = 0.0,
    ahead: bool = False,
    every: int = 10,
    late: int = 0,
) -> TurnCheck:
    """A minute of turning, with the matrices that rates and fields are multiplied by, and hard iron of this share.

    ``ahead``: the first field has a stamp of tomorrow; ``every`` so many bins there is one; seconds are evaluated
    ``late`` [s].
    """
    found, q, angles = TurnCheck(), (1.0, 0.0, 0.0, 0.0), {}
    if ahead:
        found.field(86400.0, tuple(FIELD))
    for k in range(1, SECONDS + 1):
        angles[k] = np.empty((BINS, 3))
        for b in range(BINS):
            t = k - 1.0 + b / BINS
            if b % every == 0:
                seen = quat_rotate(np.array([q[0], -q[1], -q[2], -q[3]]), FIELD) + iron * 4e-5 * np.array([1, 0, 0])
                found.field(t, tuple(mag @ seen))
            turn = rates * np.sin(np.array([0.31, 0.47, 0.23]) * t) / BINS
            q = q_multiply(q, q_exp(tuple(turn)))
            angles[k][b] = gyro @ turn
        found.second(k - late, angles.get)
    return found


@pytest.mark.parametrize("iron", [0.0, 0.3], ids=["clean", "hard iron"])
def test_sound_sensors_turn_alike(iron: float) -> None:
    """GIVEN sound sensors, also with hard iron of a third of the field, THEN nothing else explains their turns."""
    found = checked(SAME, SAME, TUMBLE, iron)
    assert not found.differs
    assert not found.is_mirrored


@pytest.mark.parametrize("gyro", [MIRRORED, np.diag([-1.0, 1.0, 1.0]), -SAME], ids=["z", "x", "all"])
def test_a_wrong_sign_is_that_of_the_gyroscope(gyro: np.ndarray) -> None:
    """GIVEN an inverted axis WHEN the vehicle turns about all axes THEN only the gyroscope can be wrong."""
    assert checked(gyro, SAME, TUMBLE).is_mirrored


@pytest.mark.parametrize("mag", [FRD, MIRRORED, -SAME, SAME[[1, 0, 2]]], ids=["frd", "z", "all", "exchanged"])
def test_wrong_axes_of_the_magnetometer_are_no_fault_of_the_gyroscope(mag: np.ndarray) -> None:
    """GIVEN any wrong axes or signs of the magnetometer THEN the sensors are not said to be mirrored."""
    found = checked(SAME, mag, TUMBLE)
    assert not found.is_mirrored
    assert found.differs == (abs(np.linalg.det(mag) * mag - SAME).max() > 0.0)


def test_a_turn_on_the_spot_does_not_show_which_sensor_is_wrong() -> None:
    """GIVEN an inverted z axis WHEN the vehicle only yaws THEN the sensors differ, but either may be wrong."""
    found = checked(MIRRORED, SAME, YAW)
    assert found.differs
    assert not found.is_mirrored


def test_a_stamp_of_tomorrow_does_not_end_the_check() -> None:
    """GIVEN one field with a stamp far ahead WHEN an axis is inverted THEN it is found all the same."""
    assert checked(MIRRORED, SAME, TUMBLE, ahead=True).is_mirrored


@pytest.mark.parametrize("late", [0, 1], ids=["sample by sample", "in long blocks"])
def test_fast_fields_that_arrive_before_their_second_is_evaluated(late: int) -> None:
    """GIVEN 25 fields a second WHEN those of the next second have already arrived THEN the fault is found as well."""
    assert checked(MIRRORED, SAME, TUMBLE, every=1, late=late).is_mirrored


def test_a_magnetometer_that_is_not_used_any_more_contradicts_nothing() -> None:
    """GIVEN sensors that turn differently WHEN the magnetometer is switched off THEN that is forgotten."""
    sensor = Magnetometer(Parameters(), Aiding(patience=3.0), Journal())
    sensor.turns = checked(MIRRORED, SAME, YAW)
    sensor.set_parameters(Parameters())
    assert sensor.turns.differs
    sensor.set_parameters(update(Parameters(), {"aids.magnetometer": False}))
    assert not sensor.turns.differs


def test_fields_with_gaps_show_nothing() -> None:
    """GIVEN a field every two seconds THEN there is no evidence."""
    found = TurnCheck()
    for k in range(SECONDS):
        if k % 2 == 0:
            found.field(float(k), tuple(FIELD * (1.0, -1.0, 1.0) if k % 4 else FIELD))
        found.second(k, lambda _: np.full((BINS, 3), 0.02))
    assert not found.differs
