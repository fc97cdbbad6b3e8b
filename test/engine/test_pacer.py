"""Observations are thinned out to a period, and a single wrong stamp does not end them."""

import pytest

from nav_pose_estimator.engine.sensors.sensor import Pacer


def passed(times: list[float]) -> list[float]:
    """Those of ``times`` [s] that pass with a period of half a second."""
    pacer = Pacer()
    return [t for t in times if pacer.passes(t, 0.5)]


def test_closer_and_reordered_observations_are_left_out() -> None:
    assert passed([0.0, 0.2, 0.5, 0.4, 0.9, 1.0]) == [0.0, 0.5, 1.0]


@pytest.mark.parametrize("ahead", [5.0, 86400.0])
def test_a_stamp_of_tomorrow_does_not_end_the_observations(ahead: float) -> None:
    """GIVEN one sample whose stamp is far ahead WHEN the next ones come in time THEN they pass as before."""
    assert passed([0.0, ahead, 0.5, 0.7, 1.0]) == [0.0, ahead, 0.5, 1.0]
