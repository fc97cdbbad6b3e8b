"""Forced outages: reading the options, taking GNSS out, the proof, and the measures of drift."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from nav_pose_estimator.core.earth.ellipsoid import enu_to_lla
from nav_pose_estimator.core.filter.layout import OUT_COLUMNS, OUT_POS, OUT_QUAT, OUT_VAR
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, MagSample, SatelliteCount
from nav_pose_estimator.engine.solutions import Mode, NavBlock
from nav_pose_estimator.offline.flights.flight_window import flight_window, outage_starts
from nav_pose_estimator.offline.flights.outage_errors import NO_ESTIMATE, NO_REFERENCE, judge
from nav_pose_estimator.offline.flights.outages import (
    BadOutage,
    GnssLeak,
    GnssRemoval,
    Outage,
    OutageProof,
    check_separate,
    parse_outage,
    parse_outage_every,
    periodic,
)
from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.flights.survey import GnssColumns
from nav_pose_estimator.offline.flights.tracks import Reference, Track, TrackRecorder, displacement_enu, gnss_reference

EPOCH = 1_000 * 10**9
ORIGIN = (math.radians(48.0), math.radians(11.0), 500.0)


def ns(seconds: float) -> int:
    return EPOCH + round(seconds * 1e9)


# --- options -----------------------------------------------------------------------------------------------------


def test_options_are_read():
    assert parse_outage("90:30") == Outage(90.0, 30.0)
    assert parse_outage("0:2.5").end == 2.5
    assert parse_outage_every("120:60") == (120.0, 60.0)


@pytest.mark.parametrize(
    "text", ["", "90", "90:", ":30", "a:b", "90:30:10", "90:0", "90:-5", "-1:30", "nan:3", "9:inf"]
)
def test_senseless_outages_are_one_sentence(text):
    with pytest.raises(BadOutage) as caught:
        parse_outage(text)
    assert "--outage" in str(caught.value)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("text", ["30:30", "20:30", "x", "0:1"])
def test_a_period_must_leave_time_to_recover(text):
    with pytest.raises(BadOutage):
        parse_outage_every(text)


def test_overlapping_outages_are_refused_and_others_sorted():
    assert check_separate([Outage(50, 10), Outage(10, 10)]) == [Outage(10, 10), Outage(50, 10)]
    with pytest.raises(BadOutage, match="overlap"):
        check_separate([Outage(10, 10), Outage(19, 5)])


def test_periodic_outages_are_over_before_the_end():
    assert [o.start for o in periodic(5.0, 30.0, first=160.0, end=200.0)] == [160.0, 165.0, 170.0]
    assert periodic(5.0, 30.0, first=160.0, end=189.0) == []


# --- removal and proof ---------------------------------------------------------------------------------------------


def stream(delay: float, count_first: bool, seconds: int = 20, gnss_hz: int = 5):
    """A second of flight has 50 IMU samples; each fix arrives ``delay`` after it was valid, with its count."""
    events = []
    for i in range(seconds * 50):
        stamp = ns(i / 50)
        events.append((i / 50, 1, ImuBlock(np.array([stamp]), np.zeros((1, 3)), np.zeros((1, 3)))))
    for i in range(seconds * gnss_hz):
        stamp = ns(i / gnss_hz + delay)
        arrival = i / gnss_hz + delay
        fix = GnssFix(stamp, *ORIGIN)
        others = [GnssVelocity(stamp, (1.0, 0.0, 0.0)), SatelliteCount(None, 9)]
        order = [others[1], fix, others[0]] if count_first else [fix, *others]
        events += [(arrival, 2 + k, item) for k, item in enumerate(order)]
    return [item for _, _, item in sorted(events, key=lambda e: e[:2])]


@pytest.mark.parametrize("delay", [0.0, 0.11, 0.4, -0.1])
@pytest.mark.parametrize("count_first", [False, True])
def test_no_gnss_of_an_outage_passes_and_the_proof_agrees(delay, count_first):
    outages = [Outage(5.0, 3.0), Outage(12.0, 4.0)]
    removal, proof = GnssRemoval(outages, EPOCH, delay), OutageProof(outages, EPOCH, delay)
    kept = list(removal.filter(stream(delay, count_first)))
    for sample in kept:
        proof.check(sample)
    valid = [(s.stamp_ns - EPOCH) * 1e-9 - delay for s in kept if isinstance(s, GnssFix)]
    everything = [i / 5 for i in range(100)]
    expected = [t for t in everything if not any(o.start - 1e-6 <= t < o.end - 1e-6 for o in outages)]
    np.testing.assert_allclose(valid, expected, atol=1e-6)
    assert sum(isinstance(s, ImuBlock) for s in kept) == 1000
    assert proof.seen == sum(isinstance(s, (GnssFix, GnssVelocity, SatelliteCount)) for s in kept)
    assert proof.closest_ns is not None
    assert set(removal.removed) == {GnssFix, GnssVelocity, SatelliteCount}


@pytest.mark.parametrize("kind", [GnssFix, GnssVelocity, SatelliteCount])
def test_the_proof_catches_each_kind_of_leak(kind):
    sample = {
        GnssFix: GnssFix(ns(10.3), *ORIGIN),
        GnssVelocity: GnssVelocity(ns(10.3), (0.0, 0.0, 0.0)),
        SatelliteCount: SatelliteCount(ns(10.3), 9),
    }[kind]
    proof = OutageProof([Outage(10.0, 5.0)], EPOCH, 0.2)
    with pytest.raises(GnssLeak, match=kind.__name__):
        proof.check(sample)


def test_a_headerless_count_inside_an_outage_is_a_leak():
    proof = OutageProof([Outage(10.0, 5.0)], EPOCH, 0.0)
    proof.check(MagSample(ns(11.0), (0.0, 0.0, 0.0)))
    with pytest.raises(GnssLeak):
        proof.check(SatelliteCount(None, 9))


@settings(max_examples=150, deadline=None)
@given(
    start=st.floats(0.0, 15.0),
    length=st.floats(0.1, 10.0),
    delay=st.floats(-0.5, 0.9),
    count_first=st.booleans(),
    gnss_hz=st.sampled_from([1, 4, 10]),
)
def test_whatever_the_outage_nothing_leaks(start, length, delay, count_first, gnss_hz):
    outages = [Outage(start, length)]
    removal, proof = GnssRemoval(outages, EPOCH, delay), OutageProof(outages, EPOCH, delay)
    for sample in removal.filter(stream(delay, count_first, gnss_hz=gnss_hz)):
        proof.check(sample)


# --- measures --------------------------------------------------------------------------------------------------------


def lla(enu: np.ndarray) -> np.ndarray:
    return np.stack(enu_to_lla(enu, *ORIGIN), axis=-1)


def drifting_track(rate_hz: float = 50.0, seconds: float = 40.0) -> Track:
    """The truth stands at the origin; from t = 10 s on the estimate runs East with 2 m/s and up with 0.5 m/s."""
    t = np.arange(int(seconds * rate_hz)) / rate_hz
    away = np.maximum(t - 10.0, 0.0)
    rows = np.zeros((len(t), OUT_COLUMNS))
    rows[:, OUT_POS : OUT_POS + 3] = lla(np.stack([2.0 * away, 0.0 * t, 0.5 * away], axis=1))
    rows[:, OUT_QUAT] = 1.0
    rows[:, OUT_VAR + 6] = 9.0
    rows[:, OUT_VAR + 7] = 16.0
    return Track(t, rows)


def at_rest(times: np.ndarray) -> Reference:
    velocity = np.tile([3.0, 4.0, 0.0], (len(times), 1))
    return Reference("GNSS", times, np.tile(ORIGIN, (len(times), 1)), velocity)


def test_errors_of_a_known_drift_are_those_computed_by_hand():
    """Fixes at 5 Hz. Outage 10 s to 20 s: the fixes of the last 1.05 s are at 19.0, 19.2, ... 19.8 s."""
    times = np.arange(0.0, 40.0, 0.2)
    errors = judge(Outage(10.0, 10.0), times, at_rest(times), drifting_track())
    last = 2.0 * (np.array([19.0, 19.2, 19.4, 19.6, 19.8]) - 10.0)
    every = 2.0 * (times[(times >= 10.0 - 1e-9) & (times < 20.0 - 1e-9)] - 10.0)
    assert errors.status == "ok"
    assert errors.end_error_m == pytest.approx(last.mean(), rel=1e-4)  # 18.8 m
    assert errors.end_error_m == pytest.approx(18.8, rel=1e-4)
    assert errors.end_vertical_m == pytest.approx(4.7, rel=1e-3)
    assert errors.rms_error_m == pytest.approx(math.sqrt(np.mean(every**2)), rel=1e-4)
    assert errors.max_error_m == pytest.approx(19.6, rel=1e-4)
    assert errors.end_sigma_m == pytest.approx(5.0)
    assert errors.travelled_m == pytest.approx(50.0, rel=1e-6)


def test_at_one_hertz_the_last_fix_alone_counts():
    times = np.arange(0.5, 40.0, 1.0)
    errors = judge(Outage(10.0, 10.0), times, at_rest(times), drifting_track())
    assert errors.end_error_m == pytest.approx(2.0 * 9.5, rel=1e-4)


def test_the_way_travelled_looks_past_unknown_velocities_beside_the_outage():
    """GIVEN a speed that grows evenly, unknown beside the outage THEN it is interpolated over the gaps."""
    t = np.arange(0.0, 40.0)
    velocity = np.column_stack([t, 0.0 * t, 0.0 * t])
    velocity[[9, 10, 21, 22]] = np.nan
    reference = Reference("GNSS", t, np.tile(ORIGIN, (len(t), 1)), velocity)
    assert reference.travelled(10.5, 20.5) == pytest.approx((20.5**2 - 10.5**2) / 2.0)


def test_an_antenna_away_from_the_imu_is_judged_where_it_is():
    times = np.arange(0.0, 40.0, 0.2)
    errors = judge(Outage(1.0, 5.0), times, at_rest(times), drifting_track(), lever=np.array([3.0, 4.0, 0.0]))
    assert errors.end_error_m == pytest.approx(5.0, rel=1e-4)


def test_without_fixes_or_without_an_estimate_the_status_says_so():
    times = np.arange(0.0, 12.0, 0.2)
    assert judge(Outage(10.0, 10.0), times, at_rest(times), drifting_track()).status == NO_REFERENCE
    nothing = Track(np.empty(0), np.empty((0, OUT_COLUMNS)))
    assert judge(Outage(1.0, 5.0), times, at_rest(times), nothing).status == NO_ESTIMATE


def test_latency_is_removed_from_the_withheld_fixes():
    fixes = [GnssFix(ns(t + 0.3), *ORIGIN) for t in (1.0, 2.0, 3.0)] + [GnssFix(ns(9.0), math.nan, 0.0, 0.0)]
    velocities = [GnssVelocity(ns(t + 0.3), (t, 0.0, 0.0)) for t in (1.0, 2.0)]
    reference = gnss_reference(GnssColumns.of([*fixes, *velocities]), EPOCH, 0.3)
    np.testing.assert_allclose(reference.t, [1.0, 2.0, 3.0])
    np.testing.assert_allclose(reference.velocity[:2, 0], [1.0, 2.0])
    assert np.isnan(reference.velocity[2]).all()


def test_displacements_agree_with_the_exact_form():
    enu = np.array([[120.0, -80.0, 15.0], [-300.0, 500.0, -40.0]])
    np.testing.assert_allclose(displacement_enu(lla(enu), np.array(ORIGIN)), enu, atol=0.1)


def test_the_recorder_keeps_at_most_its_rate_whatever_the_blocks():
    rows = np.arange(1000.0)[:, None] * np.ones(OUT_COLUMNS)
    stamps = EPOCH + np.arange(1000) * 2_500_000
    kept = []
    for sizes in ([1000], [1] * 1000, [7] * 142 + [6]):
        recorder = TrackRecorder(EPOCH, rate_hz=50.0)
        done = 0
        for size in sizes:
            part = slice(done, done + size)
            recorder.add(NavBlock(stamps[part], rows[part], Mode.AIDED, 0, np.zeros(3)))
            done += size
        kept.append(recorder.track())
    assert len(kept[0]) == 125
    for track in kept[1:]:
        np.testing.assert_array_equal(track.rows, kept[0].rows)


# --- where a benchmark puts its outages -----------------------------------------------------------------------------


def test_starts_follow_the_rule():
    long = outage_starts((10.0, 400.0), [10.0, 60.0], every=5.0, first=None)
    assert long[10.0][0].start == 170.0
    assert long[60.0][-1].end <= 400.0
    assert len(long[10.0]) == 45
    short = outage_starts((10.0, 116.0), [30.0, 60.0], every=5.0, first=None)
    assert [o.start for o in short[30.0]] == [70.0, 75.0, 80.0, 85.0]
    assert short[60.0] == []
    assert outage_starts((10.0, 400.0), [10.0], every=5.0, first=30.0)[10.0][0].start == 40.0


def test_the_flight_window_comes_from_the_sidecar_else_from_motion(tmp_path):
    t = np.arange(0, 60, 0.01)
    shaking = np.where((t > 20) & (t < 50), np.sin(300.0 * t), 0.0)
    accel = np.column_stack([0 * t, 0 * t, 9.81 + 2.0 * shaking])
    block = ImuBlock(ns(0.0) + np.round(t * 1e9).astype(np.int64), np.zeros_like(accel), accel)
    recording = Recording(tmp_path / "x_bag", [block], EPOCH, 60.0)
    assert flight_window(recording) == pytest.approx((20.0, 50.0), abs=1.01)
    recording.sidecar = {"flight_window_s": [1015.0, 1045.0], "bag": {"stamp_offset_s": 0}}
    assert flight_window(recording) == pytest.approx((15.0, 45.0))
