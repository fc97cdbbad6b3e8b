"""Attitude engine: both filters in motion, at rest, in trouble, and equal however the samples come."""

import math

import numpy as np
import pytest

from nav_pose_estimator import estimate_attitude
from nav_pose_estimator.core.attitude import two_stage
from nav_pose_estimator.core.numerics.rotation import (
    quat_conjugate_many,
    quat_from_euler,
    quat_multiply_many,
    quat_rotate_many,
    quat_to_matrix,
)
from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.imu.mounting import axes_matrix
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import (
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    MagSample,
    NavigatorVelocity,
    SatelliteCount,
)
from nav_pose_estimator.engine.solutions import AttitudeSolution, Event
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.sim.scenarios import generate

METHODS = ("complementary", "two_stage")
FIELD_N = np.array([0.0, 20e-6, -40e-6])
RATE = 100


def engine(method: str = "complementary", **changes: object) -> AttitudeEngine:
    return AttitudeEngine(update(Parameters(), {"attitude.filter": method, **changes}))


def at_rest(q, seconds: float, seed: int = 1, bias=(0.0, 0.0, 0.0), noise: float = 0.02) -> ImuBlock:
    rng = np.random.default_rng(seed)
    n = int(seconds * RATE)
    stamps = 1_000_000_000 + (np.arange(n) * 1_000_000_000) // RATE
    force = quat_to_matrix(np.asarray(q)).T @ [0.0, 0.0, 9.81]
    return ImuBlock(stamps, rng.normal(bias, 0.001, (n, 3)), rng.normal(force, noise, (n, 3)))


def tilt_deg(q_est, q_ref) -> np.ndarray:
    dq = quat_multiply_many(np.atleast_2d(q_est), quat_conjugate_many(np.atleast_2d(q_ref)))
    return np.degrees(2.0 * np.arcsin(np.clip(np.hypot(dq[:, 1], dq[:, 2]), 0.0, 1.0)))


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("angles", [(0.0, 0.0, 0.0), (0.5, -0.4, 1.0), (-1.2, 0.3, 3.0), (3.0, 0.2, -2.0)])
def test_at_rest_it_levels_and_takes_the_heading_from_the_field(method: str, angles) -> None:
    truth = quat_from_euler(*angles)
    block = at_rest(truth, 20.0)
    mag = np.tile(quat_to_matrix(truth).T @ FIELD_N, (len(block), 1))
    t = (block.stamps_ns - block.stamps_ns[0]) * 1e-9
    q = estimate_attitude(t, block.gyro, block.accel, mag, method=method)
    dq = quat_multiply_many(q[-1:], quat_conjugate_many(truth[np.newaxis]))
    assert 2.0 * math.degrees(math.acos(min(abs(dq[0, 0]), 1.0))) < 1.0


@pytest.mark.parametrize("method", METHODS)
def test_gyroscope_bias_is_learned_at_rest(method: str) -> None:
    """GIVEN a bias of 0.5 deg/s WHEN the vehicle rests for 20 s THEN it is found within 3 sigma of a hundredth."""
    bias = np.radians([0.5, -0.3, 0.4])
    subject = engine(method)
    (block,) = subject.feed(at_rest((1.0, 0.0, 0.0, 0.0), 20.0, bias=bias))
    np.testing.assert_allclose(block.gyro_bias[-1], bias, atol=3e-4)


@pytest.mark.parametrize("method", METHODS)
def test_blocks_and_single_samples_are_equal_bit_for_bit(method: str) -> None:
    flight = generate("multirotor_light", duration=12.0, seed=3, imu_rate=RATE)
    whole, single = engine(method), engine(method)
    blocks = [o for s in flight.samples() for o in whole.feed(s) if hasattr(o, "tilt_sd")]
    rows = [o for s in flight.samples(blocks=False) for o in single.feed(s) if isinstance(o, AttitudeSolution)]
    np.testing.assert_array_equal(np.concatenate([b.q_nb for b in blocks]), [r.q_nb for r in rows])


@pytest.mark.parametrize("method", METHODS)
def test_a_snapshot_is_a_point_of_return(method: str) -> None:
    block = at_rest(quat_from_euler(0.2, 0.1, 0.0), 10.0)
    halves = [ImuBlock(block.stamps_ns[i], block.gyro[i], block.accel[i]) for i in (slice(0, 500), slice(500, None))]
    subject = engine(method)
    subject.feed(halves[0])
    kept = subject.snapshot()
    first = subject.feed(halves[1])[-1].q_nb
    subject.restore(kept)
    np.testing.assert_array_equal(subject.feed(halves[1])[-1].q_nb, first)


@pytest.mark.parametrize(
    ("mounting", "convention"), [((0, 0, 0), "frd"), ((math.pi, 0, 0), "flu"), ((0.3, -1.2, 2.0), "flu")]
)
@pytest.mark.parametrize("yaw", [0.0, 1.5, 3.0, -1.5])
def test_mountings_and_headings(mounting, convention: str, yaw: float) -> None:
    """GIVEN any mounting WHEN it is declared THEN the attitude is that of the body."""
    parameters = update(Parameters(), {"imu.mounting_rpy": mounting, "imu.convention": convention})
    C_bs = axes_matrix(parameters.imu)
    truth = quat_from_euler(0.1, -0.2, yaw)
    block = at_rest(truth, 8.0)
    subject = AttitudeEngine(parameters)
    field = C_bs.T @ quat_to_matrix(truth).T @ FIELD_N
    for i in range(0, len(block), 10):
        part = slice(i, i + 10)
        stamp = int(block.stamps_ns[part][-1])
        out = subject.feed(ImuBlock(block.stamps_ns[part], block.gyro[part] @ C_bs, block.accel[part] @ C_bs))
        subject.feed(MagSample(stamp, tuple(field)))
    q = next(o for o in out if hasattr(o, "q_nb")).q_nb[-1]
    dq = quat_multiply_many(q[np.newaxis], quat_conjugate_many(truth[np.newaxis]))
    assert 2.0 * math.degrees(math.acos(min(abs(dq[0, 0]), 1.0))) < 1.5


@pytest.mark.parametrize(("method", "bound_deg"), [("complementary", 1.0), ("two_stage", 1.5)])
def test_a_long_acceleration_leaves_little_tilt_when_the_navigator_helps(method: str, bound_deg: float) -> None:
    """GIVEN 15 deg of coordinated acceleration for 10 s WHEN the velocity is known THEN the tilt stays."""
    drive = generate("coordinated_acceleration", seed=4, imu_rate=RATE)
    subject, worst = engine(method), 0.0
    for sample in drive.samples():
        for out in subject.feed(sample):
            if hasattr(out, "tilt_sd"):
                truth = drive.truth.at((out.stamps_ns[-1:] - drive.start_ns) * 1e-9)
                stamp, velocity = int(out.stamps_ns[-1]), tuple(truth.v_n[0].tolist())
                subject.feed(NavigatorVelocity(stamp, velocity, True))
                if truth.t[0] > 5.0:
                    worst = max(worst, float(tilt_deg(out.q_nb[-1], truth.q_nb[0])[0]))
    assert 0.0 < worst < bound_deg


def test_larger_sway_makes_the_regulated_noise_larger() -> None:
    """The regulator of the two-stage filter moves the right way: up with the scatter, down without."""
    noises = []
    for sway in (0.1, 6.0):
        block = at_rest((1.0, 0.0, 0.0, 0.0), 60.0, noise=0.5)
        rng = np.random.default_rng(7)
        slow = np.repeat(rng.normal(0.0, sway, (60, 2)), RATE, axis=0)
        accel = block.accel + np.column_stack([slow, np.zeros(len(slow))])
        subject = engine("two_stage")
        subject.feed(ImuBlock(block.stamps_ns, block.gyro, accel))
        state = subject.snapshot()[0].state
        noises.append(float(state[two_stage.R1] / state[two_stage.R1_START]))
    assert noises[0] < noises[1]


@pytest.mark.parametrize("method", METHODS)
def test_a_magnet_brought_near_turns_the_heading_little(method: str) -> None:
    truth = quat_from_euler(0.0, 0.0, 0.7)
    block = at_rest(truth, 40.0)
    mag = np.tile(quat_to_matrix(truth).T @ FIELD_N, (len(block), 1))
    mag[2000:2500] += [60e-6, 30e-6, 0.0]
    t = (block.stamps_ns - block.stamps_ns[0]) * 1e-9
    q = estimate_attitude(t, block.gyro, block.accel, mag, method=method)
    dq = quat_multiply_many(q[2400:2499], quat_conjugate_many(np.tile(truth, (99, 1))))
    assert np.degrees(2.0 * np.abs(np.arctan2(dq[:, 3], dq[:, 0]))).max() < 10.0


@pytest.mark.parametrize("method", METHODS)
def test_damaged_samples_are_events_and_no_nan_comes_out(method: str) -> None:
    subject = engine(method)
    subject.feed(at_rest((1.0, 0.0, 0.0, 0.0), 3.0))
    bad = [
        ImuSample(5_000_000_000, (math.nan, 0.0, 0.0), (0.0, 0.0, 9.8)),
        ImuSample(0, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)),
        ImuSample(3_000_000_000, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8)),
    ]
    names = [o.name for s in bad for o in subject.feed(s) if isinstance(o, Event)]
    assert names == ["imu.rejected.nan", "imu.rejected.zero_stamp", "imu.rejected.backward"]
    (good,) = subject.feed(ImuSample(4_000_000_000, (0.0, 0.0, 0.1), (0.0, 0.0, 9.8)))
    assert np.isfinite([*good.q_nb, *good.cov_n.ravel()]).all()


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("absurd", "event"),
    [
        (MagSample(3_995_000_000, (1e308, 0.0, -4e-5)), "mag.rejected.value"),
        (NavigatorVelocity(3_995_000_000, (0.0, 1e308, 0.0)), "navigator_velocity.rejected.nan"),
        (
            NavigatorVelocity(3_995_000_000, (0.0, 0.0, 0.0), q_nb=(1e200, 0.0, 0.0, 0.0)),
            "navigator_velocity.rejected.nan",
        ),
    ],
)
def test_a_finite_but_absurd_sample_does_not_poison_the_filter(method: str, absurd, event: str) -> None:
    subject = engine(method)
    subject.feed(at_rest((1.0, 0.0, 0.0, 0.0), 3.0))
    subject.feed(MagSample(3_990_000_000, (0.0, 2e-5, -4e-5)))
    subject.feed(NavigatorVelocity(3_990_000_000, (0.0, 0.0, 0.0), q_nb=(1.0, 0.0, 0.0, 0.0)))
    assert [o.name for o in subject.feed(absurd) if isinstance(o, Event)] == [event]
    block = at_rest((1.0, 0.0, 0.0, 0.0), 2.0)
    (after,) = subject.feed(ImuBlock(block.stamps_ns + 3_000_000_000, block.gyro, block.accel))
    assert np.isfinite(after.q_nb).all()


@pytest.mark.parametrize("method", METHODS)
def test_a_field_of_another_clock_is_told(method: str) -> None:
    """GIVEN a magnetometer whose stamps count from its start WHEN it is refused THEN a sentence says by how much."""
    subject = engine(method)
    subject.feed(at_rest((1.0, 0.0, 0.0, 0.0), 3.0))
    (event,) = subject.feed(MagSample(1_000_000_000, (0.0, 2e-5, -4e-5)))
    assert event.name == "mag.rejected.stale"
    assert "-3.0 s from the IMU's time" in event.text


@pytest.mark.parametrize("method", METHODS)
def test_an_absurd_field_in_an_array_is_left_out(method: str) -> None:
    block = at_rest((1.0, 0.0, 0.0, 0.0), 3.0)
    t = (block.stamps_ns - block.stamps_ns[0]) * 1e-9
    mag = np.tile(FIELD_N, (len(t), 1))
    mag[100:103] = [[1e308, 0.0, 0.0], [math.inf, 0.0, 0.0], [0.0, -math.inf, 0.0]]
    absent = mag.copy()
    absent[100:103] = math.nan
    found = estimate_attitude(t, block.gyro, block.accel, mag, method=method)
    np.testing.assert_array_equal(found, estimate_attitude(t, block.gyro, block.accel, absent, method=method))


def test_a_coasting_navigator_goes_on_helping() -> None:
    """GIVEN a fixed wing in turns WHEN GNSS is gone for 60 s THEN the filter's tilt stays below 2 deg."""
    flight = generate("fixed_wing", duration=200.0, seed=1, imu="icm42688_calibrated", imu_rate=RATE)
    estimator, now, worst = PoseEstimator(update(Parameters(), {"learner.enabled": False})), 0.0, 0.0
    for sample in flight.samples():
        if isinstance(sample, ImuBlock):
            now = (int(sample.stamps_ns[-1]) - flight.start_ns) * 1e-9
        elif now > 140.0 and isinstance(sample, (GnssFix, GnssVelocity, SatelliteCount)):
            continue
        for out in estimator.feed(sample):
            if hasattr(out, "tilt_sd") and now > 145.0:
                truth = flight.truth.at((out.stamps_ns[-1:] - flight.start_ns) * 1e-9)
                worst = max(worst, float(tilt_deg(out.q_nb[-1], truth.q_nb[0])[0]))
    assert 0.0 < worst < 2.0


def test_a_stuck_sensor_is_noticed() -> None:
    stamps = 1_000_000_000 + np.arange(1000) * 10_000_000
    frozen = ImuBlock(stamps, np.full((1000, 3), 0.01), np.tile([0.0, 0.0, 9.8], (1000, 1)))
    assert any(isinstance(o, Event) and o.name == "imu.stuck" for o in engine().feed(frozen))


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        ({"accel": np.zeros((9, 3))}, "accel"),
        ({"method": "madgwick"}, "madgwick"),
        ({"params": {"attitude.no_such": 1.0}}, "no_such"),
    ],
)
def test_wrong_use_of_estimate_attitude_is_one_sentence(arguments, word: str) -> None:
    good = {"t": np.arange(10) * 0.01, "gyro": np.zeros((10, 3)), "accel": np.tile([0.0, 0.0, 9.8], (10, 1))}
    with pytest.raises(UserError, match=word):
        estimate_attitude(**{**good, **arguments})


def test_gravity_is_turned_by_the_estimate() -> None:
    truth = quat_from_euler(0.4, 0.2, 0.0)
    block = at_rest(truth, 5.0)
    q = estimate_attitude((block.stamps_ns - block.stamps_ns[0]) * 1e-9, block.gyro, block.accel)
    up = quat_rotate_many(q[-1:], block.accel.mean(axis=0)[np.newaxis])[0]
    np.testing.assert_allclose(up / np.linalg.norm(up), [0.0, 0.0, 1.0], atol=0.01)
