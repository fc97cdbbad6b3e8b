"""The flight with a Doppler log that two files of scenarios change."""

import pytest

from beam_flight import Flown, beam_flight
from beamed import with_beams
from nav_pose_estimator.sim.recording import Recording


@pytest.fixture(scope="session")
def flight() -> Recording:
    """A drone above water, to be flown with or without beams."""
    return beam_flight()


@pytest.fixture(scope="session")
def without(flight: Recording) -> Flown:
    """Its outage without beams."""
    return Flown(flight, flight.samples())


@pytest.fixture(scope="session")
def sound(flight: Recording) -> Flown:
    """Its outage with four sound beams."""
    return Flown(flight, with_beams(flight))
