"""Rehearsals: what the copies get to see, how they are judged, and what three of them decide."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle
from types import SimpleNamespace

import numpy as np
import pytest

from flown import Flight
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.observation import FilterView
from nav_pose_estimator.engine.outage import rehearsal
from nav_pose_estimator.engine.outage.aid import OutageAid
from nav_pose_estimator.engine.outage.epochs import EpochCollector
from nav_pose_estimator.engine.outage.filter_bank import COAST, FilterBank, without_gnss
from nav_pose_estimator.engine.outage.methods.air_velocity_guide import AirVelocityGuide
from nav_pose_estimator.engine.outage.methods.method import Flight as FlightSoFar
from nav_pose_estimator.engine.outage.methods.registry import estimators
from nav_pose_estimator.engine.outage.rehearsals import Rehearsals, at_its_end
from nav_pose_estimator.engine.parameters.learner import LearnerParameters
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    MagSample,
    SatelliteCount,
    SetPose,
)
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.scenarios import generate

SECOND = 10**9
GUIDE = estimators()["best"].ways(FlightSoFar(Flight(seconds=40.0).epochs()))["regimes"]


class Navigator:
    """Stands for the navigator: the filters of its copies drift North by so many metres a second, coasting first."""

    def __init__(self, drifts: list[float]) -> None:
        self.mode = Mode.AIDED
        self.seen: list = []
        self.copies: list[Navigator] = []
        self.names: tuple[str, ...] = ()
        self.drifts, self._elapsed = drifts, 0.0

    def snapshot(self) -> "Navigator":
        twin = type(self)(self.drifts)
        twin.names, twin._elapsed = self.names, self._elapsed
        self.copies.append(twin)
        return twin

    def feed(self, sample) -> list:
        self.seen.append(sample)
        self._elapsed += 0.01 * (len(sample) if isinstance(sample, ImuBlock) else 1)
        return []

    def view(self, drift: float) -> FilterView:
        """States 10 m after half a minute, and nothing while aided."""
        nav, P = np.zeros(at.NAV_SIZE), np.zeros((at.BASE_STATES, at.BASE_STATES))
        nav[at.LAT] = 0.8 + drift * self._elapsed / 6.367e6
        P[at.DPOS, at.DPOS] = (self._elapsed / 3.0) ** 2
        return FilterView(nav, P, np.zeros(0))

    @property
    def run(self) -> SimpleNamespace:
        timeline = SimpleNamespace(running=True, settle=lambda: None, filter=Filters(self))
        gnss = SimpleNamespace(offset=np.zeros(2))
        return SimpleNamespace(settled=self.view(0.0), timeline=timeline, gnss=gnss, unseen=0.0)


class Filters(FilterBank):
    """The filters of a copy."""

    def __init__(self, navigator: Navigator) -> None:
        self.navigator, self.was_restarted = navigator, False
        branches = SimpleNamespace(names=("travel", "hover"), probability=lambda name: 0.25)
        self.ways = {name: SimpleNamespace(branches=branches) for name in navigator.names}

    def views(self) -> Iterator[tuple[str, FilterView]]:
        for name, drift in zip(self.navigator.names, cycle(self.navigator.drifts), strict=False):
            yield name, self.navigator.view(drift)


@pytest.fixture(autouse=True)
def _copies_of_the_stand_in(monkeypatch) -> None:
    def copied(sins):
        return sins.snapshot() if isinstance(sins, Navigator) else without_gnss(sins)

    monkeypatch.setattr(rehearsal, "without_gnss", copied)


def fly(rehearsals: Rehearsals, navigator: Navigator, start: float, end: float, ways=("network",)) -> None:
    """100 IMU samples a second, half a second at a time, with a rehearsal whenever one is due."""
    navigator.names = (COAST, *ways)
    for stamp in range(round(start * SECOND), round(end * SECOND), SECOND // 2):
        for n in range(50):
            rehearsals.feed(ImuSample(stamp + n * SECOND // 100, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)))
        if rehearsals.is_due(stamp + SECOND // 2, navigator):
            rehearsals.start(stamp + SECOND // 2, navigator, EpochCollector(), dict.fromkeys(ways, GUIDE))


def rehearsed(drifts: list[float], count: int, ways=("network",)) -> Rehearsals:
    rehearsals = Rehearsals()
    fly(rehearsals, Navigator(drifts), 1000.0, 1000.0 + 60.0 * count, ways)
    assert rehearsals.count == min(count, 6)
    return rehearsals


def test_a_rehearsal_lasts_half_a_minute_and_comes_every_minute() -> None:
    """GIVEN copies that drift 2 and 1 m/s WHEN three minutes go by THEN three rehearsals found 60 and 30 m."""
    rehearsals = rehearsed([2.0, 1.0], 3)
    assert rehearsals.rms(COAST) == pytest.approx(60.0, rel=0.02)
    assert rehearsals.rms("network") == pytest.approx(30.0, rel=0.02)
    assert rehearsals.rms("regimes") is None


def test_it_needs_three_rehearsals_to_reject() -> None:
    """GIVEN a way that is twice as bad as its rival WHEN rehearsed THEN it is refused from the third time on."""
    assert [rehearsed([1.0, 2.0], n).is_worse("network", COAST, 1.1) for n in (1, 2, 3, 4)] == [
        False,
        False,
        True,
        True,
    ]


def test_worse_means_by_more_than_the_ratio() -> None:
    rehearsals = rehearsed([1.0, 2.0], 3)
    assert rehearsals.is_worse("network", COAST, 1.9)
    assert not rehearsals.is_worse("network", COAST, 2.1)
    assert not rehearsals.is_worse(COAST, "network", 1.0)


def test_only_rehearsals_that_both_flew_count() -> None:
    """GIVEN a way that came up late WHEN compared THEN only what both flew decides."""
    rehearsals, navigator = Rehearsals(), Navigator([1.0, 1.0])
    fly(rehearsals, navigator, 1000.0, 1120.0, ("regimes",))
    later = Navigator([1.0, 1.0, 9.0])
    fly(rehearsals, later, 1120.0, 1240.0, ("regimes", "network"))
    assert not rehearsals.is_worse("network", "regimes", 1.1)
    fly(rehearsals, later, 1240.0, 1300.0, ("regimes", "network"))
    assert rehearsals.is_worse("network", "regimes", 1.1)


def test_a_filter_that_errs_less_than_it_states_is_believed_more() -> None:
    """GIVEN a filter that states 10 m after half a minute WHEN it errs by 10 m THEN its covariance stays; by 3 m, it
    shrinks as more rehearsals show it, but never to nothing; by 30 m, it is not for rehearsals to say."""
    assert Rehearsals().drift_variance == 1.0
    assert rehearsed([1.0 / 3.0], 4).drift_variance == pytest.approx(1.0, abs=0.05)
    little = [rehearsed([0.1], count).drift_variance for count in (1, 3, 6)]
    assert 1.0 > little[0] > little[1] > little[2] > 0.1
    assert rehearsed([0.0], 6).drift_variance >= 0.05
    assert rehearsed([1.0], 4).drift_variance == 1.0


def test_what_the_stated_deviation_lacks_is_found(monkeypatch) -> None:
    """GIVEN a filter that states 10 m after half a minute WHEN a way errs by 30 m THEN its spread makes up for that as
    more rehearsals show it; a way that errs by 3 m needs none, and what was added already is not found again."""
    one, six = (rehearsed([0.1, 1.0], count).spread() for count in (1, 6))
    assert one[COAST] == six[COAST] == 0.0
    lacking = 30.0**2 - 10.0**2
    assert 2.0 * 30.0 * one["network"] == pytest.approx(lacking / 3.0, rel=0.05)  # the stated one is worth two
    assert 2.0 * 30.0 * six["network"] == pytest.approx(lacking * 6.0 / 8.0, rel=0.05)
    # all that the filter states comes from this
    monkeypatch.setattr(rehearsal, "spread_psd", lambda guide, hovers: 100.0 / 60.0)
    assert 2.0 * 30.0 * rehearsed([1.0, 1.0], 6).spread()["network"] == pytest.approx(900.0 * 6.0 / 8.0, rel=0.05)


class Moving(Navigator):
    """At 4 m/s, of which its copies give hovering 25 %."""

    speed = 4.0

    def view(self, drift: float) -> FilterView:
        view = super().view(drift)
        view.nav[at.VEL] = self.speed
        return view


def test_motion_that_is_taken_for_hovering_is_counted(monkeypatch) -> None:
    """GIVEN a vehicle at 4 m/s WHEN a rehearsal gives hovering 25 % THEN a quarter of the motion was missed; at rest
    nothing is counted."""
    rehearsals = Rehearsals()
    fly(rehearsals, Moving([0.0, 0.0]), 1000.0, 1060.0)
    decisions = rehearsals.decisions
    assert decisions.travelled == pytest.approx(30.0 * 8.0, rel=0.05)  # half of 16 m^2/s^2 for half a minute
    assert decisions.missed == pytest.approx(0.25 * decisions.travelled)
    assert rehearsals.scores()["rehearsal.missed"] == pytest.approx(0.25)
    monkeypatch.setattr(Moving, "speed", 0.5)
    fly(rehearsals, Moving([0.0, 0.0]), 1060.0, 1120.0)
    assert rehearsals.decisions == decisions


def test_what_a_traveller_lacked_is_no_doubt_of_a_hover(monkeypatch) -> None:
    """GIVEN a way that errs by 30 m with 10 m stated WHEN the vehicle travelled THEN a hover needs no spread for it;
    WHEN it hovered THEN it does."""
    rehearsals = Rehearsals()
    fly(rehearsals, Moving([0.1, 1.0]), 1000.0, 1060.0)
    assert rehearsals.spread()["network"] > 1.0
    assert rehearsals.spread(hovering=True) == {}
    monkeypatch.setattr(Moving, "speed", 0.5)
    fly(rehearsals, Moving([0.1, 1.0]), 1060.0, 1120.0)
    assert rehearsals.spread(hovering=True)["network"] > 1.0


def test_a_rehearsal_at_its_end_shows_the_same() -> None:
    """GIVEN copies that drift WHEN one process flies them as data arrive and another at the end THEN both know the
    same."""
    arriving, at_once = Rehearsals(), Rehearsals(elsewhere=at_its_end)
    for rehearsals in (arriving, at_once):
        fly(rehearsals, Navigator([2.0, 1.0]), 1000.0, 1180.0)
    assert arriving.count == 3
    assert at_once.scores() == arriving.scores()
    assert at_once.spread() == arriving.spread()


def test_old_rehearsals_are_forgotten() -> None:
    """GIVEN a way that did badly WHEN it does well in six rehearsals since THEN it is used again."""
    rehearsals = rehearsed([1.0, 50.0], 3)
    assert rehearsals.is_worse("network", COAST, 1.1)
    fly(rehearsals, Navigator([2.0, 1.0]), 1180.0, 1180.0 + 6 * 60.0)
    assert not rehearsals.is_worse("network", COAST, 1.0)


def test_nothing_from_gnss_reaches_the_copies() -> None:
    """GIVEN a rehearsal WHEN samples of every kind come THEN the copy sees IMU and magnetometer only."""
    rehearsals, navigator = Rehearsals(), Navigator([1.0, 1.0])
    fly(rehearsals, navigator, 1000.0, 1001.0)
    stamp = 1001 * SECOND
    for sample in (
        GnssFix(stamp, 0.8, 0.2, 300.0),
        GnssVelocity(stamp, (0.0, 0.0, 0.0)),
        SatelliteCount(stamp, 12),
        SetPose(stamp, (0.0, 0.0, 0.0), (1.0, 0.0, 0.0, 0.0)),
        ImuSample(stamp + 1, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)),
        MagSample(stamp + 2, (0.0, 2e-5, 0.0)),
    ):
        rehearsals.feed(sample)
    rehearsals.is_due(stamp + SECOND // 2, navigator)  # the copy flies up to here
    (copy,) = navigator.copies
    assert {type(sample) for sample in copy.seen} == {ImuBlock, MagSample}
    # what is no IMU sample waits ahead of the block; it acts at its own time all the same
    assert isinstance(copy.seen[-2], MagSample)
    assert copy.seen[-1].stamps_ns[-1] == stamp + 1


def test_an_outage_ends_a_rehearsal_without_a_judgement() -> None:
    """GIVEN a rehearsal WHEN GNSS is really lost THEN nothing is judged, and the next begins when it is back."""
    rehearsals, navigator = Rehearsals(), Navigator([1.0, 1.0])
    fly(rehearsals, navigator, 1000.0, 1015.0)
    navigator.mode = Mode.COASTING
    fly(rehearsals, navigator, 1015.0, 1090.0)
    assert rehearsals.count == 0
    assert len(navigator.copies) == 1
    navigator.mode = Mode.AIDED
    fly(rehearsals, navigator, 1090.0, 1125.0)
    assert rehearsals.count == 1


def test_a_gap_in_the_imu_data_ends_a_rehearsal() -> None:
    """GIVEN a rehearsal WHEN a gap makes the copy align again THEN it is not judged: that was no drift."""
    rehearsals, navigator = Rehearsals(), Navigator([1.0, 1.0])
    fly(rehearsals, navigator, 1000.0, 1010.0)
    navigator.copies[0].mode = Mode.ALIGNING
    fly(rehearsals, navigator, 1010.0, 1055.0)
    assert rehearsals.count == 0
    fly(rehearsals, navigator, 1055.0, 1100.0)
    assert rehearsals.count == 1


def test_a_clock_that_went_back_does_not_stop_the_rehearsals() -> None:
    rehearsals = rehearsed([1.0, 1.0], 1)
    fly(rehearsals, Navigator([1.0, 1.0]), 10.0, 100.0)
    assert rehearsals.count >= 2


def test_a_copy_goes_on_with_a_rehearsal_of_its_own() -> None:
    rehearsals, navigator = Rehearsals(), Navigator([1.0, 2.0])
    fly(rehearsals, navigator, 1000.0, 1015.0)
    twin = rehearsals.copy()
    fly(twin, navigator, 1015.0, 1031.5)
    assert (rehearsals.count, twin.count) == (0, 1)


# --- the choice ------------------------------------------------------------------------------------------------------


def aid_with(rms: dict[str, float], rehearsals: int = 3, method: str = "best") -> OutageAid:
    """An aid that knows a flight and a model, and that rehearsed with these errors [m]."""
    aid = OutageAid(replace(LearnerParameters(), method=method, rules=1))
    for one in Flight(seconds=100.0, hover=0.3).epochs():
        job = aid.learner.learn(one)
        if job is not None:
            aid.accept(job.run())
    for _ in range(rehearsals):
        aid.rehearsals.state.squares.append({name: value**2 for name, value in rms.items()})
    return aid


@pytest.mark.parametrize(
    ("rms", "rehearsals", "chosen"),
    [
        ({COAST: 30.0, "regimes": 20.0, "network": 10.0}, 3, "network"),
        ({COAST: 30.0, "regimes": 10.0, "network": 20.0}, 3, "regimes"),
        ({COAST: 30.0, "regimes": 10.0, "network": 14.0}, 3, "network"),  # that is what chance makes of three
        ({COAST: 30.0, "regimes": 20.0, "network": 18.0, "alone": 9.0}, 3, "alone"),
        ({COAST: 30.0, "regimes": 20.0, "network": 9.5, "alone": 9.0}, 3, "network"),  # a draw, too
        ({COAST: 1.0, "regimes": 10.0, "network": 20.0}, 3, None),  # both did far worse than nothing
        ({COAST: 1.0, "regimes": 10.0, "network": 20.0}, 2, "network"),  # chance, so far
    ],
)
def test_best_is_what_did_best_in_rehearsal(rms, rehearsals: int, chosen: str | None) -> None:
    """GIVEN rehearsals WHEN GNSS is lost THEN the way that did better is taken, and none that did far worse than
    coasting: no regret."""
    guide = aid_with(rms, rehearsals).choose()
    name = None if guide is None else "regimes" if guide.is_usual else "network"
    if type(guide) is AirVelocityGuide:
        name = "alone"
    assert name == chosen


def test_a_method_that_was_asked_for_is_not_second_guessed() -> None:
    guide = aid_with({COAST: 1.0, "network": 50.0}, method="anfis_linear").choose()
    assert isinstance(guide, AirVelocityGuide)
    assert guide.model is not None


def test_without_enough_flight_nothing_is_known() -> None:
    aid = OutageAid(LearnerParameters())
    for one in Flight(seconds=3.0).epochs():
        aid.learner.learn(one)
    assert aid.choose() is None
    for one in Flight(seconds=15.0).epochs():
        aid.learner.learn(one)
    assert aid.choose() is not None  # how vehicles move is known before the flight


def test_the_status_tells_the_rehearsals() -> None:
    status = aid_with({COAST: 30.0, "regimes": 20.0, "network": 10.0}).status()
    assert status["rehearsal.count"] == 3.0
    assert status["rehearsal.rms_30_s.network"] == pytest.approx(10.0)
    assert status["learner.flight_s"] == 100.0


def test_a_reset_forgets_the_flight_and_keeps_the_model() -> None:
    aid = aid_with({COAST: 1.0, "network": 50.0})
    model = aid.learner.state.model
    aid.reset()
    assert aid.learner.state.model is model is not None
    assert aid.rehearsals.count == 0
    assert aid.learner.state.memory.seconds == 0.0


@pytest.mark.compiled
def test_a_computer_that_cannot_keep_up_flies_none() -> None:
    """GIVEN a rehearsal that runs WHEN the node leaves out work THEN it is broken off and none begins until there is
    time for one again."""
    recording, engine = generate("multirotor_light", duration=120.0, seed=2, imu_rate=50.0), PoseEstimator()
    flown: dict[str, list[bool]] = {"before": [], "resting": [], "after": []}
    for sample in recording.samples():
        engine.feed(sample)
        if isinstance(sample, ImuBlock):
            t = (int(sample.stamps_ns[-1]) - recording.start_ns) * 1e-9
            part = "before" if t < 60.0 else "resting" if t < 100.0 else "after"
            engine.outage_aid.state.rests = part == "resting"
            flown[part].append(engine.outage_aid.rehearsals.running is not None)
    assert flown["before"][-1]
    assert not any(flown["resting"][len(flown["resting"]) // 20 :])
    assert any(flown["after"])
    assert engine.outage_aid.rehearsals.count == 0
