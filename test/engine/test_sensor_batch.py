"""Long blocks over the samples of other sensors: the same numbers as sample by sample."""

import numpy as np
import pytest

from nav_pose_estimator.core.filter.layout import OUT_COLUMNS
from nav_pose_estimator.engine.composed import sensor_batch
from nav_pose_estimator.engine.composed.exchange import ExchangeClock
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.composed.sensor_batch import SensorBatch
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import (
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    ImuBlock,
    MagSample,
    PressureSample,
    joined,
)
from nav_pose_estimator.engine.solutions import (
    AttitudeBlock,
    AttitudeSolution,
    Event,
    NavBlock,
    NavSolution,
    PredictedDrift,
)
from nav_pose_estimator.offline.benchmarks.speed.plain_flight import samples
from pieces import one_by_one

SECONDS, LOSS = 75.0, 40.5
START = 10**18


def flight(delay: float, is_at_row: bool = False) -> list:
    """Rest, a run-up, circles with magnetometer and barometer; GNSS is lost on the way. The barometer's samples have
    the stamps of the IMU samples before, or are a little later than those of the magnetometer. In the first case there
    is also a wheel speed twice a second, which has the stamp of one of the barometer's samples and arrives before that
    IMU sample."""
    out: list = []
    for sample in samples(SECONDS, 100.0, delay=delay):
        if isinstance(sample, (GnssFix, GnssVelocity)) and LOSS < (sample.stamp_ns - START) * 1e-9 < SECONDS - 12.0:
            continue
        if isinstance(sample, MagSample) and is_at_row:
            stamp_ns = sample.stamp_ns - 100_000
            follows_imu = isinstance(out[-1], ImuBlock) and out[-1].stamps_ns[-1] == stamp_ns
            if follows_imu and stamp_ns > START + (LOSS + 5.0) * 1e9 and stamp_ns // 10**8 % 5 == 1:
                out.insert(-1, BodyVelocity(stamp_ns, (10.0, 0.0, 0.0)))
            out.append(PressureSample(stamp_ns, 95_461.0))
        out.append(sample)
        if isinstance(sample, MagSample) and not is_at_row:
            out.append(PressureSample(sample.stamp_ns + 1000, 95_461.0))
    return out


def told(outputs: list) -> dict[str, list]:
    """What is said at every sample, however it is packed."""
    said: dict[str, list] = {"rows": [], "modes": [], "attitude": [], "events": [], "errors": []}
    for output in outputs:
        if isinstance(output, NavBlock):
            said["rows"] += [[*row, *output.correction_enu] for row in output.rows.tolist()]
            said["modes"] += [(output.mode, output.reset_count)] * len(output.rows)
        elif isinstance(output, NavSolution):
            said["rows"].append([*output.values[:OUT_COLUMNS].tolist(), *output.correction_enu])
            said["modes"].append((output.mode, output.reset_count))
        elif isinstance(output, AttitudeBlock):
            said["attitude"] += output.q_nb.tolist()
        elif isinstance(output, AttitudeSolution):
            said["attitude"].append(output.q_nb.tolist())
        elif isinstance(output, Event):
            said["events"].append((output.stamp_ns, output.name, output.text))
        elif isinstance(output, PredictedDrift):
            said["errors"].append((output.stamp_ns, output.dv_n, output.dp_n))
    return said


@pytest.mark.parametrize(
    ("delay", "method", "is_at_row"), [(0.0, "best", False), (0.23, "best", True), (0.0, "coast", True)]
)
def test_a_flight_in_long_blocks_is_the_flight_sample_by_sample(delay: float, method: str, is_at_row: bool) -> None:
    """GIVEN a flight with an outage, its fixes punctual or late WHEN it is fed at once and sample by sample
    THEN solutions, corrections, modes and events with their stamps are the same, bit for bit, in far fewer pieces;
    and so is what has been learned from."""
    given = {"gnss.delay": delay, "learner.method": method, "aids.body_velocity": method == "coast"}
    parameters = update(Parameters(), given)
    whole, single = PoseEstimator(parameters), PoseEstimator(parameters)
    at_once = whole.feed_all(flight(delay, is_at_row))
    apart = [output for sample in one_by_one(flight(delay, is_at_row)) for output in single.feed(sample)]
    expected, given = told(apart), told(at_once)
    assert len({mode for mode, _ in given["modes"]}) > 1
    for name, values in expected.items():
        assert given[name] == values, name
    assert whole.status().counters == single.status().counters
    if method != "coast":
        learned, expected_learned = (one.outage_aid.learner.state.memory.last(1e3) for one in (whole, single))
        assert len(learned) > 50
        np.testing.assert_array_equal(learned, expected_learned)
    assert sum(isinstance(o, NavBlock) for o in at_once) < 0.6 * sum(
        isinstance(s, ImuBlock) for s in flight(delay, is_at_row)
    )


@pytest.mark.compiled
def test_a_gap_gives_the_same_at_once_and_sample_by_sample() -> None:
    """GIVEN an aided flight with 1.5 s without IMU data WHEN it is fed at once and sample by sample THEN the solutions,
    also those after the new alignment, are the same."""
    given: list = []
    for sample in samples(57.0, 100.0):
        if isinstance(sample, ImuBlock):
            begin, end = sample.stamps_ns.searchsorted([START + 53_440_000_001, START + 54_940_000_000])
            given += [part for part in (sample.part(0, begin), sample.part(end, None)) if len(part)]
        else:
            given.append(sample)
    parameters = update(Parameters(), {"learner.method": "coast"})
    whole, single = PoseEstimator(parameters), PoseEstimator(parameters)
    rows = told(whole.feed_all(given))["rows"]
    assert rows == told([output for sample in one_by_one(given) for output in single.feed(sample)])["rows"]
    assert whole.status().counters["imu.gap"] == 1


def test_the_navigator_flies_ahead_up_to_a_gap_at_most() -> None:
    """GIVEN IMU samples with a gap WHEN the navigator flies ahead by four exchanges THEN it stops behind every fourth
    one, and behind the first sample after the gap."""
    clock, imu = ExchangeClock(), joined([block(0, 1100), block(1600, 2100)])
    assert list(clock.pieces(imu, 4)) == [(0, 1), (1, 101), (101, 112), (112, 152), (152, 162)]
    clock.is_due(imu)
    assert list(clock.pieces(block(2110, 2990), 4)) == [(0, 89)]


def block(first_ms: int, last_ms: int, step_ms: int = 10) -> ImuBlock:
    stamps = START + 10**6 * np.arange(first_ms, last_ms + 1, step_ms)
    return ImuBlock(stamps, np.zeros((len(stamps), 3)), np.zeros((len(stamps), 3)))


def mag(ms: float) -> MagSample:
    return MagSample(START + round(1e6 * ms), (0.0, 2e-5, -4e-5))


@pytest.mark.parametrize(
    ("samples", "length"),
    [
        ([block(0, 90), mag(91.0), block(100, 190), mag(191.0)], 4),
        ([block(0, 90), mag(90.0), block(100, 190)], 3),  # of the time of the row before: it acts behind that row
        ([block(0, 90), mag(100.0), block(100, 100), mag(100.0)], 3),  # one ahead of that row, one behind it
        ([block(0, 90), mag(85.0), block(100, 190)], 1),  # late
        ([block(0, 90), mag(700.0), block(100, 190)], 1),  # far ahead
        ([block(0, 90), mag(91.0), block(400, 490)], 2),  # a gap
        ([block(0, 90), mag(91.0), block(80, 190)], 2),  # a clock set back
        ([block(0, 90), block(100, 600, 250)], 1),  # a gap inside
        ([block(0, 590), mag(591.0), block(600, 1190)], 2),  # too long
        ([block(0, 90), GnssFix(START + 91 * 10**6, 0.8, 0.2, 300.0), block(100, 190)], 1),
        ([mag(91.0), block(100, 190)], 1),
    ],
)
def test_what_goes_together(samples: list, length: int) -> None:
    assert sensor_batch.length(samples, 0) == length


def test_an_observation_that_waits_for_its_time_ends_a_batch_at_another_of_that_time() -> None:
    """GIVEN an observation that the navigator already has WHEN a sample of the same time arrives behind the IMU sample
    of that time THEN the batch ends before it, for the first one acts ahead of that IMU sample."""
    samples = [block(0, 90), mag(90.0), block(100, 190)]
    assert sensor_batch.length(samples, 0, [START + 90 * 10**6]) == 1
    assert sensor_batch.length(samples, 0, [START + 91 * 10**6]) == 3


def test_a_batch_knows_where_everything_arrived() -> None:
    parts = [block(0, 20), mag(21.0), block(30, 30), mag(31.0), mag(32.0), block(40, 50), mag(51.0)]
    batch = SensorBatch.of(parts)
    assert batch.imu.stamps_ns.tolist() == block(0, 50).stamps_ns.tolist()
    assert batch.early(0, 4) == [(3, parts[1])]
    assert batch.early(3, 6) == [(0, parts[1]), (1, parts[3]), (1, parts[4])]
    assert batch.after == [parts[6]]
