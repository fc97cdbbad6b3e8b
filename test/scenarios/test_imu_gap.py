"""The IMU is silent in flight, in the same process: the navigator goes on from its own state, honestly vague."""

import math
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import pytest

from beamed import with_beams
from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import ImuBlock, Sample, SetPose, stamp_of
from nav_pose_estimator.engine.solutions import Event, Mode, NavBlock
from nav_pose_estimator.offline.flights.recording import load
from pieces import one_by_one
from told import GNSS, Told, flight, silence, tell

pytestmark = pytest.mark.compiled
LOST, GAP, BACK, END = 60.0, 70.0, 105.0, 115.0  # s: GNSS is away from 60 to 105 s
UNAIDED = {Mode.COASTING, Mode.DEAD_RECKONING, Mode.EXPIRED}
Gaps = tuple[tuple[float, float], ...]
"""Begin and length [s]."""


def cut(samples: Iterable[Sample], start_ns: int, gaps: Gaps) -> Iterator[Sample]:
    """``samples`` without the IMU's in ``gaps``."""
    for sample in samples:
        if not isinstance(sample, ImuBlock):
            yield sample
            continue
        t = (sample.stamps_ns - start_ns) * 1e-9
        kept = np.flatnonzero(~np.any([(begin < t) & (t < begin + length) for begin, length in gaps], axis=0))
        for piece in np.split(kept, np.flatnonzero(np.diff(kept) > 1) + 1):
            if len(piece):
                yield sample.part(int(piece[0]), int(piece[-1]) + 1)


def fly(name: str, *gaps: tuple[float, float], outage: tuple[float, float] = (LOST, BACK), **overrides) -> Told:
    recording = flight(name, END)
    samples = recording.with_faults(*silence(outage[0], outage[1] - outage[0])).samples()
    return tell(recording, samples=cut(samples, recording.start_ns, gaps), **{"learner__enabled": False, **overrides})


def is_honest(told: Told, start: float, end: float) -> bool:
    """Whether every error is within three sigma, and there are errors."""
    rows = told.between(start, end)
    return bool(rows.any() and (told.off[rows] < 3.0 * told.sigma[rows]).all())


@pytest.mark.parametrize(
    ("name", "length"),
    [
        *((name, length) for name in ("hover", "laps", "stop_and_go", "fixed_wing") for length in (3.0, 10.0)),
        ("closed_curve", 3.0),
        ("laps", 1.1),
        ("fixed_wing", 30.0),
    ],
)
def test_in_an_outage_it_goes_on_and_sigma_covers_what_nobody_saw(name: str, length: float) -> None:
    """GIVEN GNSS away, a craft that hovers, turns, dashes or cruises WHEN the IMU is silent THEN seconds later it goes
    on, unaided, every error is within three sigma, and GNSS is taken again when it returns."""
    told = fly(name, (GAP, length))
    again = told.t[told.t > GAP + length][0]
    assert again < GAP + length + 4.0
    assert told.modes_between(again, BACK) <= UNAIDED
    assert is_honest(told, again, BACK)
    assert told.sigma[told.t >= again][0] > 3.0 * length  # it does not claim to have seen anything
    assert told.modes[-1] is Mode.AIDED
    assert told.off[-1] < 3.0
    assert told.when("resume.begun") == pytest.approx([GAP + length], abs=0.05)
    assert not told.when("reset")


def test_the_status_says_so_until_a_fix_has_come() -> None:
    told = fly("laps", (GAP, 3.0), outage=(LOST, math.inf))
    assert "no sensor observed" in told.estimator.status().doubt
    assert not fly("laps", (GAP, 3.0)).estimator.status().doubt


def test_a_pose_from_outside_leaves_only_the_velocity_in_doubt() -> None:
    """GIVEN a gap that no sensor observed WHEN an operator sets the pose THEN the status no longer doubts the position."""
    told = fly("laps", (GAP, 3.0), outage=(LOST, math.inf))
    engine = told.estimator
    assert "position and velocity are less certain" in engine.status().doubt
    position = tuple(told.last.position_enu.tolist())
    engine.feed(SetPose(told.last.stamp_ns, position, tuple(told.last.q_nb.tolist())))
    assert "no sensor observed" in engine.status().doubt
    assert "the velocity is less certain" in engine.status().doubt


def test_what_the_flight_has_shown_of_its_speed_still_helps() -> None:
    """GIVEN a craft that has learned how fast it flies WHEN it goes on after a gap THEN that bounds its drift, and
    nothing that takes a known velocity for granted is used."""
    alone, helped = fly("stop_and_go", (GAP, 3.0)), fly("stop_and_go", (GAP, 3.0), learner__enabled=True)
    last = alone.between(BACK - 1.0, BACK)
    assert is_honest(helped, GAP + 3.0, BACK)
    assert helped.sigma[helped.between(BACK - 1.0, BACK)].max() < 0.3 * alone.sigma[last].max()
    assert helped.count("outage.evidence.unseen") > 40


def test_beams_that_have_proved_themselves_hold_the_drift() -> None:
    """GIVEN a Doppler log that GNSS has verified WHEN it goes on after a gap without GNSS THEN the beams are used."""
    recording = flight("laps", END)
    beamed = with_beams(recording.with_faults(*silence(LOST, END - LOST)))
    told = tell(recording, samples=cut(beamed, recording.start_ns, ((GAP, 3.0),)), learner__enabled=False)
    last = told.between(END - 1.0, END)
    assert is_honest(told, GAP + 3.0, END)
    assert told.sigma[last].max() < 100.0
    assert told.modes_between(END - 1.0, END) == {Mode.COASTING}


def test_outside_an_outage_it_waits_for_a_fix_and_is_aided_again() -> None:
    told = fly("laps", (GAP, 3.0), outage=(END, END))
    again = told.t[told.t > GAP + 3.0][0]
    assert again < GAP + 6.0
    assert told.modes_between(again, END) == {Mode.AIDED}
    assert is_honest(told, again, END)
    assert told.off[told.between(again, END)].max() < 12.0


def test_a_gap_that_begins_with_the_outage_waits_for_a_fix_in_vain() -> None:
    """GIVEN GNSS lost as the IMU falls silent WHEN the IMU is back THEN no fix comes, and it goes on without."""
    told = fly("stop_and_go", (LOST, 3.0))
    again = told.t[told.t > LOST + 3.0][0]
    assert again < LOST + 6.5
    assert told.modes_between(again, BACK) <= UNAIDED
    assert is_honest(told, again, BACK)


@pytest.mark.parametrize("pause", [0.4, 6.0], ids=["before it has gone on", "after"])
def test_a_second_gap_adds_to_the_first(pause: float) -> None:
    """GIVEN a gap WHEN a second one follows THEN it goes on from the last state that there was."""
    one, two = fly("laps", (GAP, 3.0)), fly("laps", (GAP, 3.0), (GAP + 3.0 + pause, 3.0))
    again = two.t[two.t > GAP + 6.0 + pause][0]
    assert again < GAP + 8.0 + pause
    assert is_honest(two, again, BACK)
    assert two.sigma[two.t >= again][0] > 1.5 * one.sigma[one.t > GAP + 3.0][0]
    assert two.modes[-1] is Mode.AIDED


def test_after_a_minute_nothing_can_be_said() -> None:
    """GIVEN an IMU silent for more than a minute without GNSS THEN it says why it is silent, until GNSS is back."""
    told = fly("stop_and_go", (30.0, 61.0), outage=(25.0, 93.0))
    (event,) = [event for event in told.events if event.name == "reset"]
    assert "position is unknown without GNSS" in event.text
    assert not told.between(91.0, 93.0).any()
    assert told.modes[-1] is Mode.AIDED
    assert told.off[-1] < 5.0


@pytest.mark.parametrize("poison", ["state", "IMU"])
def test_a_poisoned_state_is_not_gone_on_from(poison: str) -> None:
    """GIVEN a state that holds NaN, or that an impossible IMU has made WHEN the IMU is silent THEN attitude and
    position are found anew: without GNSS it stays silent."""
    recording = flight("laps", END)
    spoiled = recording.with_faults(*silence(LOST, math.inf))
    engine, blocks, events, seen = SinsEngine(), [], [], 0
    for sample in cut(spoiled.samples(), recording.start_ns, ((GAP, 3.0),)):
        seen = stamp_of(sample) or seen
        for output in engine.feed(sample):
            (events if isinstance(output, Event) else blocks).append(output)
        if recording.start_ns + (GAP - 0.1) * 1e9 < seen < recording.start_ns + (GAP + 0.1) * 1e9:
            if poison == "IMU":
                engine.run.modes.distrust_reason = "The IMU is not plausible."
            else:
                engine.run.timeline.filter.nav[at.VEL] = math.nan
    after = recording.start_ns + (GAP + 1.0) * 1e9
    assert not [block for block in blocks if block.stamps_ns[-1] > after]
    told = [event.text for event in events if event.name in ("reset", "resume.begun") and event.stamp_ns > after]
    assert len(told) == 1
    assert ("starts again" if poison == "state" else "that state was in doubt") in told[0]


def test_sample_by_sample_it_is_the_same_pose() -> None:
    recording = flight("laps", END)
    samples = list(cut(recording.with_faults(*silence(65.0, 30.0)).samples(), recording.start_ns, ((GAP, 3.0),)))
    whole = tell(recording, samples=samples, learner__enabled=False)
    single = tell(recording, samples=one_by_one(samples), learner__enabled=False)
    np.testing.assert_array_equal(whole.t, single.t)
    np.testing.assert_array_equal(whole.position, single.position)
    np.testing.assert_array_equal(whole.sigma, single.sigma)


# --- recorded flights ------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("name", "lost"), [("quad106", 265.0), ("px4_search", 80.0)])
@pytest.mark.parametrize("length", [3.0, 10.0])
def test_recorded_flights_stay_within_sigma(shared_data: Path, name: str, lost: float, length: float) -> None:
    """GIVEN a recorded flight from a minute before an outage WHEN a gap is cut into its IMU THEN it goes on within four
    seconds, and every fix that was withheld lies within three sigma."""
    recording = load(shared_data / "flights" / f"{name}_bag")
    delay = float(recording.sidecar["gnss_latency_est_s"])
    engine = PoseEstimator(update(Parameters(), {"gnss.delay": delay, "learner.enabled": False}))
    gap, end = lost + 8.0, lost + 28.0 + length
    blocks, now = [], -math.inf
    for sample in cut(recording.samples, recording.epoch_ns, ((gap, length),)):
        now = ((stamp_of(sample) or 0) - recording.epoch_ns) * 1e-9
        if lost - 60.0 < now < end and not (isinstance(sample, GNSS) and now > lost):
            blocks += [output for output in engine.feed(sample) if isinstance(output, NavBlock)]
    stamps, rows = (np.concatenate(parts) for parts in zip(*((b.stamps_ns, b.rows) for b in blocks), strict=True))
    t, reference = (stamps - recording.epoch_ns) * 1e-9, recording.reference(delay)
    again = t[t > gap + length][0]
    assert again < gap + length + 4.0
    fixes = (reference.t > again) & (reference.t < t[-1])
    solutions = rows[np.searchsorted(t, reference.t[fixes])]
    assert len(solutions) > 15
    for row, place in zip(solutions, reference.position[fixes], strict=True):
        sigma = math.sqrt(row[at.OUT_VAR + at.DPOS] + row[at.OUT_VAR + at.DPOS + 1])
        assert math.hypot(*lla_to_enu(*row[at.OUT_POS : at.OUT_VEL], *place)[:2]) < 3.0 * sigma
