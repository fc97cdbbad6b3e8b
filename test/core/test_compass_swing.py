"""The compass swing: coefficients of known errors, and the causes that follow from them."""

import cmath

import numpy as np
import pytest

from nav_pose_estimator.core.attitude.compass_swing import CompassSwing

A, B, C = 0.9 * cmath.rect(1.0, 0.2), 0.1 - 0.05j, 0.3 + 0.2j


def swung(a: complex, b: complex, c: complex, turn: float = 2.0 * np.pi) -> CompassSwing:
    swing = CompassSwing(100.0)
    for angle in np.linspace(0.0, turn, 60):
        north = cmath.rect(1.0, angle)
        swing.add(north, a * north + b * north.conjugate() + c, 0.5)
    return swing


def test_coefficients_of_a_circle_are_those_it_was_made_of():
    assert swung(A, B, C).coefficients() == pytest.approx((A, B, C))


def test_a_short_turn_tells_nothing():
    swing = swung(A, B, C, turn=0.5)
    assert swing.coefficients() is None
    assert swing.cause() == ""


@pytest.mark.parametrize(
    ("a", "b", "c", "cause"),
    [
        (0.1, 1.0, 0.0, "swapped or inverted"),
        (1.0, 0.0, 1.5, "hard iron of about 1.5 times"),
        (1j, 0.0, 0.0, "turned by about -90 deg"),
        (1.0, 0.1, 0.1, "comes and goes"),
    ],
)
def test_causes(a, b, c, cause):
    assert cause in swung(a, b, c).cause()


def test_old_swings_are_forgotten():
    swing = CompassSwing(20.0)
    for c in (3.0, 0.0):
        for angle in np.linspace(0.0, 12.0 * np.pi, 600):
            north = cmath.rect(1.0, angle)
            swing.add(north, north + c, 0.5)
    assert abs(swing.coefficients()[2]) < 1e-3
