"""Changes of a body velocity that the IMU did not measure, and the position error that they may cause."""

import numpy as np
import pytest

from nav_pose_estimator.engine.sensors.velocity_doubt import VelocityDoubt

NOTHING = np.zeros(2)


def after(changes: list[float], innovation: float = 0.1, is_refused: bool = False) -> VelocityDoubt:
    """The doubt after updates at 10 Hz that changed the East velocity by ``changes`` [m/s]."""
    doubt = VelocityDoubt()
    for k, change in enumerate(changes):
        doubt.update(0.1 * k, np.array([change, 0.0]), 0.0, innovation, is_refused=is_refused)
    return doubt


def position_sd(doubt: VelocityDoubt, velocities: list[complex], possible: float) -> float:
    """Deviation of the position [m] on each axis after a second with each velocity [m/s]."""
    added = [doubt.second(velocity, possible) for velocity in velocities]
    return float(np.sqrt(sum(one.position**2 for one in added if one is not None)))


def test_noise_is_no_change() -> None:
    """GIVEN updates to and fro THEN there is no doubt, and nothing is added to the position."""
    doubt = after([0.05, -0.05] * 50)
    assert doubt.jump == 0.0
    assert doubt.second(0j, 0.0) is None


def test_a_change_that_adds_up_in_seconds_is_one() -> None:
    """GIVEN a velocity that pulls the filter by 1 m/s THEN that is the jump, and the position error grows linearly."""
    doubt = after([0.1] * 10)
    assert doubt.jump == pytest.approx(0.9, abs=0.15)
    assert position_sd(doubt, [0j] * 10, 0.0) == pytest.approx(10.0 * doubt.jump)


def test_it_makes_velocity_and_tilt_uncertain_once() -> None:
    """GIVEN a jump THEN its first second widens velocity and tilt, and the next one the position alone."""
    doubt = after([0.1] * 10)
    first, second = doubt.second(0j, 0.0), doubt.second(0j, 0.0)
    assert first is not None
    assert second is not None
    assert first.speed == pytest.approx(doubt.jump)
    assert first.tilt > 0.0
    assert second.speed == second.tilt == 0.0


def test_a_sensor_as_noisy_as_ever_is_not_accused() -> None:
    """GIVEN innovations of 1 m/s all the time THEN a change of 1 m/s is their noise."""
    assert after([0.0] * 50 + [0.1] * 10, innovation=1.0).jump == 0.0


def test_refusals_in_a_row_are_a_contradiction() -> None:
    """GIVEN a second in which every velocity is refused THEN the doubt begins, once."""
    doubt = VelocityDoubt()
    doubt.update(0.0, NOTHING, 0.0, 0.1, is_refused=False)
    told = [doubt.update(0.1 * k, NOTHING, 0.0, 5.0, is_refused=True) for k in range(1, 20)]
    assert sum(told) == 1
    assert doubt.jump > 0.0


def test_one_refusal_after_a_pause_is_an_outlier() -> None:
    """GIVEN a sensor that was silent for a minute WHEN its first velocity is refused THEN that is no doubt."""
    doubt = after([0.0] * 20)
    assert not doubt.update(60.0, NOTHING, 0.0, 5.0, is_refused=True)
    assert not doubt.update(60.1, NOTHING, 0.0, 0.1, is_refused=False)
    assert doubt.jump == 0.0


def test_a_correction_that_the_filter_expected_is_no_change() -> None:
    """GIVEN a velocity that has become uncertain by 1 m/s WHEN the sensor returns and corrects it by 1 m/s THEN there
    is no doubt; a correction by 4 m/s begins one."""
    assert not after([0.0] * 20).update(60.0, np.array([1.0, 0.0]), 1.0, 1.0, is_refused=False)
    assert after([0.0] * 20).update(60.0, np.array([4.0, 0.0]), 1.0, 4.0, is_refused=False)


def test_it_ends_with_gnss() -> None:
    """GIVEN a doubt WHEN GNSS is good again THEN it ends."""
    doubt = after([0.1] * 10)
    doubt.end()
    assert doubt.jump == 0.0
    assert doubt.second(0j, 0.0) is None


def test_an_unknown_scale_costs_a_share_of_the_displacement() -> None:
    """GIVEN an error of half the velocity WHEN the vehicle moves by 40 m THEN that adds up to 20 m; a motion to and fro
    adds up to what its largest displacement does."""
    assert position_sd(VelocityDoubt(), [10.0 + 0j] * 4, 0.5) == pytest.approx(20.0)
    assert position_sd(VelocityDoubt(), [10.0 + 0j, -10.0 + 0j] * 20, 0.5) == pytest.approx(5.0)
