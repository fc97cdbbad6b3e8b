"""Complaints 9 and 11: what is said of fixes that were taken or refused; fixes that come late. 10, 12: test/ros."""

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.faults import Delay, Shift
from told import flight, tell

pytestmark = pytest.mark.compiled
SPIKES = tuple(Shift(GnssFix, start, 0.19, (9.0, -12.0, 0.0)) for start in (60.0, 80.0, 100.0))
LONG = "gnss__reacquisition__sigmas"


def test_pain_09_a_spike_of_15_m_that_is_refused_shows() -> None:
    """GIVEN an accurate receiver WHEN three fixes are 15 m off THEN three are refused, counted, and told."""
    told = tell(flight(), *SPIKES, gnss__position_correlation=0.0)
    values = told.estimator.status().values
    assert told.count("gnss.rejected.innovation") == 3
    assert told.event("gnss.rejected.innovation").text
    assert values["gnss.gate_radius_m"] < 15.0
    assert told.off[told.between(60.0, 120.0)].max() < 3.0


def test_pain_09_a_spike_of_15_m_that_is_taken_shows_as_well() -> None:
    """GIVEN a gate so wide that it cannot fire WHEN fixes are 15 m off THEN its radius and the NIS say so."""
    wide = {"gnss__position_correlation": 0.0, LONG: 20.0, "navigator__reject_probability": 0.9999999999999}
    calm, spiked = tell(flight(), **wide), tell(flight(), *SPIKES, **wide)
    values = spiked.estimator.status().values
    assert values["gnss.gate_radius_m"] > 15.0
    assert spiked.count("gnss.rejected.innovation") == 0
    touched = spiked.count("gnss.inflated.position") + spiked.count("gnss.rejected.position_innovation")
    assert touched >= 3
    before = calm.estimator.status().values["nis.gnss_position.p99"]
    assert values["nis.gnss_position.p99"] > 3.0 * before


@pytest.mark.parametrize("delay", [0.1, 0.3, 0.7])
def test_pain_11_a_late_fix_acts_at_its_own_time(delay: float) -> None:
    """GIVEN fixes and velocities that arrive late with true stamps
    THEN the state at the end is that of the same fixes on time."""
    late = (Delay(GnssFix, 20.0, 90.0, delay), Delay(GnssVelocity, 20.0, 90.0, delay))
    punctual, delayed = tell(flight()), tell(flight(), *late)
    a, b = punctual.estimator.sins.run.settled.nav.copy(), delayed.estimator.sins.run.settled.nav.copy()
    np.testing.assert_allclose(b, a, rtol=0.0, atol=1e-9)
    assert delayed.modes[-1] is Mode.AIDED
    assert delayed.count("gnss_position.rejected.late") == 0


def test_pain_11_a_known_latency_of_the_driver_is_taken_out() -> None:
    """GIVEN fixes stamped 0.25 s after they were valid WHEN gnss.delay says so THEN the track is better for it."""
    recording = flight("gnss_latency")
    blind, told = tell(recording), tell(recording, gnss__delay=0.25)
    late, better = (np.median(one.off[one.between(60.0, 120.0)]) for one in (blind, told))
    assert better < 0.7 * late
