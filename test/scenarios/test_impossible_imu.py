"""An IMU that cannot be one: refused before it aligns a navigator, noticed in flight, doubted while GNSS is away."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.core.numerics.rotation import quat_conjugate_many, quat_rotate_many
from nav_pose_estimator.engine.samples import ImuBlock, Sample
from nav_pose_estimator.engine.solutions import Mode
from nav_pose_estimator.sim.recording import Recording
from told import GNSS, Told, flight, silence, tell

pytestmark = pytest.mark.compiled
SECONDS, MANOEUVRED = 60.0, 45.0  # of the flight: its length, when it has turned and braked
G, DEGREES = 9.80665, 180.0 / np.pi
SAME = np.eye(3)
FRD = np.diag([1.0, -1.0, -1.0])
SWAPPED_YZ = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
TURNED = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0], [0.0, 0.0, 1.0]])

Change = Callable[[ImuBlock], ImuBlock]


def read_as(gyro: np.ndarray = SAME, accel: np.ndarray = SAME) -> Change:
    """What an IMU publishes whose rates and forces come out of these matrices (3, 3)."""
    return lambda block: ImuBlock(block.stamps_ns, block.gyro @ gyro.T, block.accel @ accel.T)


def spoilt(recording: Recording, change: Change, start: float = 0.0, length: float = np.inf) -> Iterator[Sample]:
    """The samples of a recording, with the IMU changed from ``start`` for ``length`` [s]."""
    first, last = recording.start_ns + start * 1e9, recording.start_ns + (start + length) * 1e9
    for sample in recording.samples():
        if not isinstance(sample, ImuBlock):
            yield sample
            continue
        inside = (sample.stamps_ns >= first) & (sample.stamps_ns < last)
        changed = change(sample) if inside.any() else sample
        gyro, accel = (np.where(inside[:, None], getattr(changed, n), getattr(sample, n)) for n in ("gyro", "accel"))
        yield ImuBlock(sample.stamps_ns, gyro, accel)


def fly(change: Change, start: float = 0.0, length: float = np.inf, name: str = "multirotor_light", **settings) -> Told:
    recording = flight(name, SECONDS)
    return tell(recording, samples=spoilt(recording, change, start, length), learner__enabled=False, **settings)


def without_gravity(recording: Recording) -> Change:
    truth = recording.truth

    def change(block: ImuBlock) -> ImuBlock:
        nearest = np.searchsorted(truth.t, (block.stamps_ns - recording.start_ns) * 1e-9).clip(0, len(truth.t) - 1)
        up = np.tile([0.0, 0.0, G], (len(block), 1))
        return ImuBlock(
            block.stamps_ns, block.gyro, block.accel - quat_rotate_many(quat_conjugate_many(truth.q_nb[nearest]), up)
        )

    return change


def assert_never_aligned(told: Told, name: str, *words: str) -> None:
    status = told.estimator.status()
    assert status.mode is Mode.ALIGNING
    assert not len(told.t)
    assert told.count(name) == 1
    for word in words:
        assert word in status.waiting_for
    assert status.waiting_for.count(". ") == 0, "one sentence"


# --- before the start ------------------------------------------------------------------------------------------------


def test_an_accelerometer_in_g_does_not_align() -> None:
    """GIVEN specific force in g WHEN the vehicle starts THEN it stays ALIGNING and says what it read and why."""
    told = fly(read_as(accel=SAME / G))
    assert_never_aligned(told, "imu.implausible.in_g", "0.98 m/s^2", "probably in g")


def test_an_accelerometer_in_g_with_frd_axes_does_not_align() -> None:
    """GIVEN g and FRD axes WHEN the vehicle starts THEN the unit, which is wrong for sure, is named."""
    assert_never_aligned(fly(read_as(FRD, FRD / G)), "imu.implausible.in_g", "probably in g")


def test_an_accelerometer_with_half_the_range_does_not_align() -> None:
    """GIVEN forces twice as large as they are WHEN the vehicle rests THEN the measured factor is named."""
    told = fly(read_as(accel=2.0 * SAME))
    assert told.event("imu.implausible.force_scale").text.count("1.97 times") == 1
    assert told.estimator.status().mode is Mode.ALIGNING


@pytest.mark.parametrize("unit", [100.0, 1000.0 / G], ids=["cm/s^2", "milli-g"])
def test_a_unit_whose_values_no_imu_reaches_is_named(unit: float) -> None:
    """GIVEN cm/s^2, mg or counts WHEN every sample is refused THEN the status says so, and what it read."""
    told = fly(read_as(accel=unit * SAME))
    assert told.estimator.status().mode in (Mode.WAITING_IMU, Mode.ALIGNING)
    assert "cm/s^2, mg or raw counts" in told.estimator.status().waiting_for


def test_an_inverted_accelerometer_does_not_align() -> None:
    """GIVEN an accelerometer of inverted sign WHEN the vehicle starts at rest THEN it is not levelled on its back."""
    assert_never_aligned(fly(read_as(accel=-SAME)), "imu.implausible.upside_down", "-9.4", "inverted")


def test_an_inverted_accelerometer_is_found_when_the_recording_starts_in_the_air() -> None:
    """GIVEN an inverted accelerometer WHEN the vehicle already flies THEN no pose is called good after ten seconds."""
    told = fly(read_as(accel=-SAME), name="start_in_air")
    assert Mode.AIDED not in told.modes_between(10.0, SECONDS)
    assert "inverted" in told.estimator.status().waiting_for


def test_a_driver_that_removes_gravity_does_not_align() -> None:
    """GIVEN acceleration without gravity WHEN the vehicle starts THEN it never aligns and names the cause."""
    recording = flight("multirotor_light", SECONDS)
    told = fly(without_gravity(recording))
    assert not len(told.t)
    assert "removes gravity" in told.event("imu.implausible.no_gravity").text


def test_half_a_message_does_not_align() -> None:
    """GIVEN messages with one half of an IMU WHEN the vehicle starts THEN it says that both halves are needed."""
    assert_never_aligned(
        fly(read_as(accel=0.0 * SAME)), "imu.implausible.no_accelerometer", "exactly zero", "two topics"
    )
    assert_never_aligned(fly(read_as(gyro=0.0 * SAME)), "imu.implausible.no_gyroscope", "gyroscope", "two topics")


# --- in motion -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("gyro", "words"),
    [
        (DEGREES * SAME, "deg/s"),
        (-DEGREES * SAME, "deg/s"),
        (-SAME, "sign is probably inverted"),
        (FRD, "different axes"),
        (SWAPPED_YZ, "different axes"),
        (TURNED, "different axes"),
    ],
    ids=["deg/s", "deg/s and inverted", "inverted", "FRD", "y and z swapped", "turned by 90 deg"],
)
@pytest.mark.parametrize("name", ["multirotor_light", "start_in_air"])
def test_a_gyroscope_that_tells_another_motion_is_refused(gyro: np.ndarray, words: str, name: str) -> None:
    """GIVEN a gyroscope of wrong unit, sign or axes WHEN the vehicle turns and brakes for two minutes
    THEN it is noticed, no pose is called good from then on, and the sentence names what is probably wrong."""
    recording = flight(name, 120.0)
    told = tell(recording, samples=spoilt(recording, read_as(gyro)), learner__enabled=False)
    assert words in told.event("imu.implausible.motion").text
    assert Mode.AIDED not in told.modes_between(told.when("imu.implausible.motion")[0] + 0.1, 120.0)
    assert told.estimator.status().mode is Mode.ALIGNING


def test_a_dead_axis_is_refused() -> None:
    """GIVEN a gyroscope whose y axis reads zero WHEN the vehicle moves about the other axes THEN it is named."""
    recording = flight("closed_curve", SECONDS)
    told = tell(recording, samples=spoilt(recording, read_as(np.diag([1.0, 0.0, 1.0]))), learner__enabled=False)
    assert "gyroscope's y axis" in told.event("imu.implausible.dead_axis").text
    assert told.estimator.status().mode is Mode.ALIGNING


def test_two_imus_on_one_topic_are_noticed() -> None:
    """GIVEN a second IMU, turned by 90 degrees, between the samples of the first WHEN the vehicle flies
    THEN it is noticed, and no pose is called good any more."""

    def interleaved(block: ImuBlock) -> ImuBlock:
        odd = (np.arange(len(block)) + (block.stamps_ns[0] // 10_000_000)) % 2 == 1
        other = read_as(TURNED, TURNED)(block)
        return replace(
            block,
            gyro=np.where(odd[:, None], other.gyro, block.gyro),
            accel=np.where(odd[:, None], other.accel, block.accel),
        )

    told = fly(interleaved)
    assert "two IMUs" in told.event("imu.implausible.two_imus").text
    assert Mode.AIDED not in told.modes_between(MANOEUVRED, SECONDS)


@pytest.mark.parametrize("blocks", [1, 7, 64])
def test_the_size_of_blocks_decides_nothing(blocks: int) -> None:
    """GIVEN a gyroscope in deg/s WHEN the samples come in blocks of another size THEN all events are the same."""
    recording = flight("multirotor_light", SECONDS)

    def cut() -> Iterator[Sample]:
        for sample in spoilt(recording, read_as(DEGREES * SAME)):
            if isinstance(sample, ImuBlock) and blocks == 1:
                yield from sample.samples()
            elif isinstance(sample, ImuBlock):
                yield from (sample.part(i, i + blocks) for i in range(0, len(sample), blocks))
            else:
                yield sample

    whole = fly(read_as(DEGREES * SAME))
    parts = tell(recording, samples=cut(), learner__enabled=False)
    assert [(e.stamp_ns, e.name, e.text) for e in parts.events] == [(e.stamp_ns, e.name, e.text) for e in whole.events]


# --- in flight -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("change", "event"),
    [
        (read_as(accel=SAME / G), "imu.implausible.in_g"),
        (read_as(accel=0.0 * SAME), "imu.implausible.no_accelerometer"),
        (read_as(DEGREES * SAME), "imu.implausible.motion"),
    ],
    ids=["g", "zeros", "deg/s"],
)
def test_an_imu_that_changes_in_flight_is_left_and_taken_again(change: Change, event: str) -> None:
    """GIVEN an aligned navigator WHEN unit or values of the IMU change for fifteen seconds
    THEN it is not AIDED within twelve, says why, and is AIDED again when physics holds."""
    recording = flight("multirotor_light", 120.0)
    told = tell(recording, samples=spoilt(recording, change, 25.0, 15.0), learner__enabled=False)
    assert told.modes_between(5.0, 25.0) == {Mode.AIDED}
    assert 25.0 < told.when(event)[0] < 37.0
    assert Mode.AIDED not in told.modes_between(37.0, 40.0)
    assert told.when("imu.implausible.ended")
    assert told.estimator.status().mode is Mode.AIDED
    assert told.off[-1] < 5.0


@pytest.mark.parametrize(
    ("change", "length"),
    [
        (lambda b: ImuBlock(b.stamps_ns, b.gyro + 20.0, b.accel + 100.0), 0.3),
        (read_as(0.0 * SAME, 0.0 * SAME), 2.6),
        (lambda b: ImuBlock(b.stamps_ns, 0.0 * b.gyro + 0.3, b.accel), 10.0),
    ],
    ids=["a spike", "zeros", "a frozen gyroscope"],
)
def test_a_damaged_imu_in_an_outage_is_no_secret(change: Change, length: float) -> None:
    """GIVEN an outage of 30 s WHEN the IMU is struck, dead or frozen in it
    THEN the truth stays within three sigma or the solution says that it has expired."""
    recording = flight("multirotor_light", 120.0)
    quiet = recording.with_faults(*silence(40.0, 30.0))
    told = tell(recording, samples=spoilt(quiet, change, 50.0, length), learner__enabled=False)
    away = told.between(53.0, 69.0)
    expired = np.array([mode is Mode.EXPIRED for mode in told.modes])
    assert np.all((told.off < 3.0 * told.sigma) | expired, where=away)
    assert told.count("imu_doubt.used") > 0
    assert told.estimator.status().mode is Mode.AIDED


def test_a_speed_that_the_vehicle_cannot_fly_expires() -> None:
    """GIVEN an outage WHEN the navigator's own speed becomes more than the vehicle flies
    THEN it is EXPIRED until GNSS is back, and the status says why."""
    recording = flight("multirotor_light", 90.0)
    quiet = recording.with_faults(*silence(40.0, 50.0))
    push = lambda b: ImuBlock(b.stamps_ns, b.gyro, b.accel + np.array([20.0, 0.0, 0.0]))  # noqa: E731
    told = tell(recording, samples=spoilt(quiet, push, 45.0, 10.0), learner__enabled=False)
    assert told.modes_between(60.0, 89.0) == {Mode.EXPIRED}
    assert "cannot reach" in told.estimator.status().waiting_for


# --- no false alarm --------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["fixed_wing", "coning", "closed_curve", "road_vehicle", "start_in_air", "hover"])
def test_a_good_imu_is_left_in_peace(name: str) -> None:
    """GIVEN a good IMU WHEN it flies, drives, cones or loops THEN nothing is found, and vibration is shown."""
    told = tell(flight(name, SECONDS), learner__enabled=False)
    assert told.count("imu.implausible") == told.count("imu_doubt") == 0
    values = told.estimator.status().values
    assert 0.0 < values["imu.vibration_m_s2"] < 1.0
    assert values["imu.mean_force_m_s2"] > 3.0


def test_degrees_are_named_without_gnss():
    """GIVEN a gyroscope in deg/s and no GNSS WHEN the vehicle flies THEN the unit is named, a sound one is not."""
    recording = flight("multirotor_light", SECONDS)

    def alone(change: Change) -> Told:
        samples = (sample for sample in spoilt(recording, change) if not isinstance(sample, GNSS))
        return tell(recording, samples=samples, learner__enabled=False)

    assert "deg/s instead of rad/s" in alone(read_as(DEGREES * SAME)).event("imu.implausible.degrees").text
    assert alone(read_as()).when("imu.implausible") == []
