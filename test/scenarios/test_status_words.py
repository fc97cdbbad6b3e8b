"""What the navigator says of itself in the moments when a pilot looks: in the air, after a restart, at a return."""

import numpy as np
import pytest

from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.samples import GnssFix, ImuBlock, Sample
from nav_pose_estimator.engine.solutions import Event, Level, Mode
from nav_pose_estimator.ros.logbook import Logbook
from nav_pose_estimator.sim.scenarios import generate

pytestmark = pytest.mark.compiled


def test_aligning_in_flight_it_does_not_say_that_no_fix_has_arrived():
    """GIVEN a vehicle that is in the air from the first second WHEN its fixes help to align
    THEN the status says what is missing, and not that there is no fix."""
    engine, said = SinsEngine(), []
    for sample in generate("alignment_in_air", duration=20.0, seed=3, imu_rate=100.0).samples():
        engine.feed(sample)
        if isinstance(sample, GnssFix) and engine.mode is Mode.ALIGNING:
            said.append((engine.status(), engine.journal.counters["gnss.gate.opened"] > 0))
    used = [status for status, is_open in said if is_open]
    assert len(used) > 5, "the alignment takes seconds"
    assert all(status.gnss_refusal == "" and "no fix" not in status.waiting_for for status in used)
    assert "heading" in used[-1].waiting_for


def without(samples: list[Sample], gaps: tuple[tuple[int, int], ...]) -> list[Sample]:
    """IMU samples whose stamps lie in one of ``gaps`` are left out."""

    def stays(sample: Sample) -> bool:
        return not (isinstance(sample, ImuBlock) and any(a <= sample.stamps_ns[0] < b for a, b in gaps))

    return [sample for sample in samples if stays(sample)]


def test_every_gap_is_told():
    """GIVEN an IMU that falls silent three times WHEN the navigator goes on from its state THEN it says why."""
    flight = generate("hover", duration=30.0, seed=3, imu_rate=50.0)
    gaps = tuple((flight.start_ns + s * 10**9, flight.start_ns + (s + 2) * 10**9) for s in (8, 14, 20))
    engine = SinsEngine()
    outputs = [output for sample in without(list(flight.samples()), gaps) for output in engine.feed(sample)]
    told = [o.text for o in outputs if isinstance(o, Event) and o.name == "resume.begun"]
    assert len(told) == 3
    assert all("no IMU data for 2." in text for text in told), told


class Lines:
    """A logger that keeps what it is told."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self.error = self.warning = self.info = self.debug = self.lines.append


@pytest.mark.parametrize("name", ["gnss.reacquired.expected", "gnss.reset.contradiction"])
def test_the_log_tells_every_return(name):
    """GIVEN a flight with four outages WHEN GNSS returns THEN the log has four lines: it is what a pilot waits for."""
    lines = Lines()
    book = Logbook(lines)
    for metres in np.arange(4.0):
        book.note(Event(1, name, Level.INFO, f"GNSS is back: {metres:.1f} m"))
    assert lines.lines == [f"GNSS is back: {metres:.1f} m" for metres in np.arange(4.0)]
