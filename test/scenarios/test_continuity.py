"""What moves and what steps in an outage and at its end: odom and map, as docs/conventions.md says."""

import numpy as np
import pytest

from told import Told, flight, silence, tell

pytestmark = pytest.mark.compiled
LOST, FOUND, END = 100.0, 130.0, 145.0  # s


@pytest.fixture(scope="module")
def outage() -> Told:
    return tell(flight("multirotor_light", END), *silence(LOST, FOUND - LOST))


def test_the_position_in_odom_never_steps(outage):
    """GIVEN an outage of 30 s WHEN it begins, lasts and ends THEN base_link moves in odom as its velocity says."""
    odom = outage.position - outage.correction
    steps = np.linalg.norm(np.diff(odom, axis=0), axis=1)
    travelled = 0.5 * (outage.speed[1:] + outage.speed[:-1]) * np.diff(outage.t)
    flown = outage.between(50.0, END)[1:]
    assert np.abs(steps - travelled)[flown].max() < 0.05


def test_every_correction_is_in_map_against_odom(outage):
    """GIVEN the same outage THEN what steps is the correction: within it, by what is learned of the motion, and at its
    end; before GNSS was lost by no more than fixes move a position."""
    steps = np.linalg.norm(np.diff(outage.correction, axis=0), axis=1)
    aided, lost, found = (outage.between(*span)[1:] for span in ((50.0, LOST), (LOST + 2.0, FOUND), (FOUND, END)))
    assert steps[aided].max() < 1.0
    assert steps[lost].max() > 0.01
    assert steps[found].max() > steps[aided].max()
