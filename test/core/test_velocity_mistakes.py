"""Mistakes of velocities one by one, late ones, and climbs."""

import cmath
import math

import pytest

from nav_pose_estimator.core.gnss.climb_check import DOWN, OTHER, SILENT, ClimbCheck, take_height
from nav_pose_estimator.core.gnss.velocity_check import VelocityCheck
from nav_pose_estimator.core.gnss.velocity_mistakes import LINEAR, UNIT

EARTH, LAT, PERIOD = 6.371e6, 0.8, 0.2


def fly(check: VelocityCheck, wrong, seconds: float = 40.0, late: float = 0.0, period: float = PERIOD) -> VelocityCheck:
    """A winding path at 6 m/s; ``wrong`` gives the received velocity."""

    def place(t: float) -> complex:
        return complex(60.0 * math.sin(0.1 * t), 40.0 * math.sin(0.13 * t + 0.5))

    for k in range(round(seconds / period)):
        t = k * period
        true = (place(t - late + 0.05) - place(t - late - 0.05)) / 0.1
        received = wrong(true)
        check.velocity(t, received.real, received.imag, 0.1)
        here = place(t)
        check.fix(t, LAT + here.imag / EARTH, here.real / (EARTH * math.cos(LAT)), 10.0)
    return check


def received_with(mistake):
    """What a receiver with this mistake says: the inverse of ``undo``."""
    if mistake.kind == UNIT:
        return lambda v: v / mistake.a
    return lambda v: (v / mistake.a) if mistake.a else (v / mistake.b).conjugate()


@pytest.mark.parametrize("mistake", LINEAR, ids=lambda one: one.name)
def test_every_mistake_is_told_from_all_others_and_undone(mistake) -> None:
    """GIVEN a path with turns THEN the mistake is named, certain, and what it hides comes back to a twentieth."""
    check = fly(VelocityCheck(), received_with(mistake))
    assert (check.fault, check.name) == (mistake.kind, mistake.name)
    assert check.certain
    hidden = received_with(mistake)(3.0 + 4.0j)
    assert abs(complex(*check.corrected(hidden.real, hidden.imag)) - (3.0 + 4.0j)) < 0.25


def test_any_angle_is_found_and_undone() -> None:
    check = fly(VelocityCheck(), lambda v: v * cmath.rect(1.0, 0.6))
    assert check.name == "turned by 34 deg"
    assert check.certain


def test_body_axes_are_never_undone() -> None:
    """GIVEN a speed along the nose THEN the axes are the vehicle's own, and no angle is taken for theirs."""
    check = fly(VelocityCheck(), lambda v: complex(abs(v), 0.01))
    assert (check.fault, check.name) == ("turned", "body")
    assert not check.certain


def test_velocities_that_agree_again_are_believed_again() -> None:
    check = VelocityCheck()
    fly(check, lambda v: v.conjugate(), 20.0)
    assert check.fault
    check.forget_time()
    fly(check, lambda v: v, 40.0)
    assert not check.fault


@pytest.mark.parametrize("late", [0.0, 0.2, 0.75, 1.0, 1.5])
def test_a_delay_is_found_to_a_quarter_of_a_second(late: float) -> None:
    """GIVEN velocities of some time ago THEN the delay is found; a fifth of a second is nothing strange."""
    check = fly(VelocityCheck(), lambda v: v, 60.0, late=late)
    assert check.late.delay == (late if late > 0.5 else 0.0)
    assert not check.fault


def test_a_delay_is_found_at_a_high_rate() -> None:
    """GIVEN 50 velocities a second, more than there is room for at first THEN the delay is found as well."""
    check = fly(VelocityCheck(), lambda v: v, 60.0, late=1.0, period=0.02)
    assert check.late.delay == 1.0
    assert not check.fault


def climb(check: ClimbCheck, alt: float, up: float, baro: float | None) -> ClimbCheck:
    """A minute up and down at 1.5 m/s: height times ``alt``, velocity times ``up``, barometer times ``baro``."""
    for k in range(300):
        t = k * PERIOD
        rate = 1.5 if t % 20.0 < 10.0 else -1.5
        height = 15.0 - abs(t % 20.0 - 10.0) * 1.5
        check.baro = math.nan if baro is None else 400.0 + baro * height
        check.velocity(1.0, 1.0, up * rate)
        check.conclude(take_height(check.state, t, alt * height, up * rate, 0.0, check.baro), alt * height)
    return check


@pytest.mark.parametrize(
    ("alt", "up", "baro", "fault", "height_fault"),
    [
        (1.0, 1.0, 1.0, "", ""),
        (1.0, 1.0, None, "", ""),
        (1.0, -1.0, 1.0, DOWN, ""),
        (1.0, -1.0, None, DOWN, ""),
        (1.0, 0.0, 1.0, SILENT, ""),
        (1.0, 2.0, 1.0, OTHER, ""),
        (1.0, 2.0, None, "", ""),
        (3.28, 1.0, 1.0, "", "in feet"),
        (-1.0, 1.0, 1.0, "", "positive down"),
    ],
)
def test_the_barometer_tells_whom_to_blame(alt, up, baro, fault, height_fault) -> None:
    """GIVEN climbs of which height, vertical velocity and barometer tell THEN the odd one out is wrong."""
    check = climb(ClimbCheck(), alt, up, baro)
    assert (check.fault, check.height_fault) == (fault, height_fault)
