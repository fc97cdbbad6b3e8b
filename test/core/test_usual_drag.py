"""The usual rotor drag: where it comes from, and how a flight takes its place."""

import numpy as np
import pytest

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.usual import Drag, Shown
from nav_pose_estimator.core.motion.usual_drag import expected_noise, fit_drag, with_usual_drag

USUAL = Drag(rate=0.2, rate_spread=0.05, noise=2.0)
WIND = np.array([2.0, -1.0])


def flown(seconds: float, rate: float, speed: float, seed: int = 4) -> np.ndarray:
    """Level epochs at about ``speed`` [m/s] in slowly changing directions, with drag of ``rate`` [1/s] in a wind."""
    random = np.random.default_rng(seed)
    count = round(seconds / me.PERIOD)
    t = me.PERIOD * np.arange(1, count + 1)
    epochs = np.zeros((count, me.COLUMNS))
    yaw, course = 0.05 * t, 0.3 * t
    cos, sin, nothing, one = np.cos(yaw), np.sin(yaw), np.zeros(count), np.ones(count)
    C = np.array([[cos, -sin, nothing], [sin, cos, nothing], [nothing, nothing, one]]).transpose(2, 0, 1)
    velocity = speed * np.column_stack([np.cos(course), np.sin(course), nothing]) + random.normal(0.0, 0.2, (count, 3))
    epochs[:, me.TIME], epochs[:, me.ATTITUDE : me.BODY_VELOCITY] = t, C.reshape(count, 9)
    epochs[:, me.VELOCITY : me.VELOCITY + 3] = velocity
    epochs[:, me.BODY_VELOCITY : me.BODY_VELOCITY + 3] = np.einsum("nij,ni->nj", C, velocity)
    air = np.einsum("nij,ni->nj", C[:, :2], velocity[:, :2] - WIND)
    epochs[:, me.FORCE : me.FORCE + 3] = -rate * air + random.normal(0.0, 0.05, (count, 3))
    epochs[:, me.FORCE + 2] += 9.8
    return epochs


def test_a_flight_that_only_hovered_has_the_drag_of_others() -> None:
    """GIVEN half a minute of hovering WHEN asked for the law THEN 1 / D is the usual one within its spread, and so is
    the noise: small residuals of a hover promise nothing of travelling."""
    model = with_usual_drag(flown(30.0, 0.2, 0.2), USUAL)
    np.testing.assert_allclose(model.network.gain, 5.0, atol=1.25)
    assert expected_noise(model, flown(60.0, 0.2, 8.0)) > 2.0 * USUAL.noise**2


def test_a_flight_that_travelled_has_its_own() -> None:
    """GIVEN five minutes at 8 m/s with twice the usual drag WHEN asked THEN drag and wind are those of the flight."""
    epochs = flown(300.0, 0.4, 8.0)
    model = with_usual_drag(epochs, USUAL)
    np.testing.assert_allclose(model.network.gain, 2.5, rtol=0.05)
    np.testing.assert_allclose(model.wind_mean, WIND, atol=0.2)
    assert expected_noise(model, epochs) < 0.2 * 2.0 * USUAL.noise**2


def test_every_airframe_counts_once() -> None:
    """GIVEN airframes with 0.1 and, twice, 0.3 1/s WHEN fitted THEN their mean is 0.2 with a spread of 0.1; a single
    airframe tells no spread, and what is known from elsewhere stands."""
    gentle = Shown((flown(60.0, 0.1, 5.0),))
    rough = Shown((flown(60.0, 0.3, 5.0), flown(60.0, 0.3, 5.0, seed=5)))
    drag = fit_drag([gentle, rough])
    assert (drag.rate, drag.rate_spread) == (pytest.approx(0.2, rel=0.05), pytest.approx(0.1, rel=0.1))
    assert fit_drag([gentle]) == fit_drag([])
