"""Attitude filter: what it learns of compass and accelerometer while GNSS is there, and what it needs no GNSS for."""

import math
from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.core.attitude import layout as at
from nav_pose_estimator.core.numerics.rotation import (
    euler_from_quat_many,
    quat_conjugate_many,
    quat_from_euler,
    quat_multiply_many,
    quat_rotate_many,
    wrap_angle_many,
)
from nav_pose_estimator.engine.attitude.engine import AttitudeEngine
from nav_pose_estimator.engine.attitude.recorded import feed_recorded
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import BodyVelocity, ImuBlock, MagSample, NavigatorVelocity
from nav_pose_estimator.engine.solutions import AttitudeBlock, Event
from nav_pose_estimator.sim.scenarios import generate

METHODS = ("complementary", "two_stage")
RATE = 100
FIELD_N = np.array([0.0, 20e-6, -40e-6])
LEVEL = (1.0, 0.0, 0.0, 0.0)


QUIET = {"attitude.wander": 5e-4, "attitude.bias_walk": 1e-5}  # what a calm vehicle's IMU is worth, if one says so


def engine(method: str = "complementary", **changes: float) -> AttitudeEngine:
    return AttitudeEngine(update(Parameters(), {"attitude.filter": method, **changes}))


def motion(roll, pitch, yaw, seed: int = 1) -> tuple[ImuBlock, np.ndarray]:
    """IMU samples of angles (N,) [rad] in place, and the attitudes (N, 4)."""
    q = np.array([quat_from_euler(*angles) for angles in zip(roll, pitch, yaw, strict=True)])
    step = quat_multiply_many(quat_conjugate_many(q[:-1]), q[1:])
    gyro = 2.0 * RATE * np.vstack([step[:1, 1:], step[:, 1:]])
    force = quat_rotate_many(quat_conjugate_many(q), np.tile([0.0, 0.0, 9.81], (len(q), 1)))
    noise = np.random.default_rng(seed)
    stamps = 1_000_000_000 + np.arange(len(q)) * (1_000_000_000 // RATE)
    return ImuBlock(stamps, gyro + noise.normal(0.0, 1e-3, gyro.shape), force + noise.normal(0.0, 0.02, gyro.shape)), q


def heading_deg(q_est: np.ndarray, q_ref: np.ndarray) -> np.ndarray:
    return np.degrees(wrap_angle_many(euler_from_quat_many(q_est)[:, 2] - euler_from_quat_many(q_ref)[:, 2]))


@pytest.mark.parametrize(("method", "bound_deg"), [("complementary", 3.0), ("two_stage", 8.0)])
def test_a_wide_smooth_circle_is_not_taken_for_rest(method: str, bound_deg: float) -> None:
    """GIVEN 20 s of rest WHEN it turns by 69 deg in a minute, as quiet as before THEN that is no gyroscope bias."""
    subject, level = engine(method), np.zeros(80 * RATE)
    yaw = np.concatenate([np.zeros(20 * RATE), 0.02 * np.arange(60 * RATE) / RATE])
    block, q = motion(level, level, yaw)
    (out,) = subject.feed(block)
    assert abs(out.gyro_bias[-1, 2]) < 0.002
    assert abs(heading_deg(out.q_nb[-1:], q[-1:])[0] - heading_deg(out.q_nb[:1], q[:1])[0]) < bound_deg


@pytest.mark.parametrize("method", METHODS)
def test_a_large_bias_at_power_on_is_learned(method: str) -> None:
    """GIVEN 2.6 deg/s of bias, within attitude.max_bias WHEN it rests for 20 s THEN most of it is found."""
    block, _ = motion(*np.zeros((3, 20 * RATE)))
    block.gyro[:, 2] += 0.045
    (out,) = engine(method).feed(block)
    assert out.gyro_bias[-1, 2] == pytest.approx(0.045, abs=0.002)


def test_steady_acceleration_after_rest_does_not_tilt() -> None:
    """GIVEN 20 s of rest WHEN it accelerates smoothly by 1 m/s^2 for 10 s THEN 1.5 deg of tilt at most, not 6."""
    block, _ = motion(*np.zeros((3, 30 * RATE)))
    block.accel[20 * RATE :, 0] += 1.0
    (out,) = engine(**QUIET).feed(block)
    assert np.abs(np.degrees(euler_from_quat_many(out.q_nb)[-1, :2])).max() < 1.5


@pytest.mark.parametrize("method", METHODS)
def test_the_delay_of_the_magnetometer_is_found_in_turns(method: str) -> None:
    """GIVEN a magnetometer 20 ms late WHEN it rolls and pitches THEN the delay is found to 3 ms."""
    t = np.arange(60 * RATE) / RATE
    block, q = motion(0.8 * np.sin(4.0 * t), 0.5 * np.sin(3.1 * t), 0.7 + np.sin(0.5 * t))
    field = quat_rotate_many(quat_conjugate_many(q), np.tile(FIELD_N, (len(q), 1)))
    late = np.vstack([np.repeat(field[:1], 2, axis=0), field[:-2]])
    subject = engine(method)
    feed_recorded(subject, block, late)
    assert subject.snapshot()[0].state[at.MAG_DELAY] == pytest.approx(0.020, abs=0.003)


def waving(seconds: float) -> tuple[ImuBlock, np.ndarray, np.ndarray]:
    """IMU samples of a vehicle that turns about all axes, its attitudes (N, 4), and the Earth's field in b (N, 3)."""
    t = np.arange(int(seconds * RATE)) / RATE
    block, q = motion(0.6 * np.sin(1.1 * t), 0.5 * np.sin(0.9 * t), 0.7 + 1.5 * np.sin(0.5 * t))
    noise = np.random.default_rng(2).normal(0.0, 3e-7, (len(t), 3))
    return block, q, quat_rotate_many(quat_conjugate_many(q), np.tile(FIELD_N, (len(t), 1))) + noise


MAGNET = np.array([4e-6, -6e-6, 15e-6])  # in b; together 37 % of the field


@pytest.mark.parametrize("attached", [0, 20])
@pytest.mark.parametrize(("method", "bound_deg"), [("complementary", 4.0), ("two_stage", 6.0)])
def test_a_magnet_on_the_vehicle_is_found_and_taken_out(method: str, bound_deg: float, attached: int) -> None:
    """GIVEN a magnet from the start or from 20 s on, gone after 40 s WHEN it turns THEN it is known, then forgotten."""
    block, q, field = waving(60.0)
    field[attached * RATE : 40 * RATE] += MAGNET
    subject = engine(method)
    rows = feed_recorded(subject, block.part(0, 40 * RATE), field[: 40 * RATE])
    state = subject.snapshot()[0].state
    assert state[at.IRON_USED : at.IRON_USED + 3] == pytest.approx(MAGNET, abs=1.5e-6)
    assert np.abs(heading_deg(rows.q_nb[30 * RATE :], q[30 * RATE : 40 * RATE])).max() < bound_deg
    rows = feed_recorded(subject, block.part(40 * RATE, 60 * RATE), field[40 * RATE :])
    assert not subject.snapshot()[0].state[at.IRON_USED : at.IRON_USED + 3].any()
    assert np.abs(heading_deg(rows.q_nb[10 * RATE :], q[50 * RATE :])).max() < bound_deg


@pytest.mark.parametrize("method", METHODS)
def test_a_field_that_differs_from_place_to_place_is_no_magnet_on_the_vehicle(method: str) -> None:
    """GIVEN a field that wanders by a third as the vehicle moves about WHEN it turns THEN nothing is taken out."""
    block, q, field = waving(60.0)
    t = np.arange(len(q)) / RATE
    place = 1e-5 * np.column_stack([np.sin(0.7 * t), np.cos(0.45 * t), np.sin(1.3 * t)])
    field += quat_rotate_many(quat_conjugate_many(q), place)
    subject = engine(method)
    for second in range(60):
        feed_recorded(subject, block.part(second * RATE, (second + 1) * RATE), field[second * RATE :][:RATE])
        assert not subject.snapshot()[0].state[at.IRON_USED : at.IRON_USED + 3].any()


def standing(seconds: float, navigator: NavigatorVelocity | None, subject: AttitudeEngine, **errors) -> np.ndarray:
    """Attitude at the end of more ``seconds`` at rest, level and nose to the East, told of ``navigator`` at 4 Hz."""
    memory = subject.snapshot()[0]
    begin = 1_000_000_000 if memory.last_ns is None else memory.last_ns + 10_000_000
    block, _ = motion(*np.zeros((3, int(seconds * RATE))), seed=begin % 97)
    block = ImuBlock(block.stamps_ns - block.stamps_ns[0] + begin, block.gyro, block.accel + errors.get("force", 0.0))
    for i in range(0, len(block), 25):
        (out,) = [o for o in subject.feed(block.part(i, i + 25)) if isinstance(o, AttitudeBlock)]
        stamp = int(out.stamps_ns[-1])
        if "field" in errors:
            subject.feed(MagSample(stamp, errors["field"]))
        if navigator is not None:
            subject.feed(NavigatorVelocity(stamp, *_rest_of(navigator)))
    return out.q_nb[-1:]


def _rest_of(v: NavigatorVelocity) -> tuple:
    return v.vel_enu, v.valid, v.q_nb, v.drifting, v.heading_sd, v.tilt_sd


AIDED = NavigatorVelocity(0, (0.0, 0.0, 0.0), True, LEVEL, False, 0.02, 0.003)
COASTING = NavigatorVelocity(0, (0.0, 0.0, 0.0), True, LEVEL, True, 0.02, 0.003)
TURNED = tuple((20e-6 * np.array([math.sin(0.3), math.cos(0.3), -2.0])).tolist())  # a compass mounted 17 deg off


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize("method", METHODS)
def test_a_heading_from_gnss_corrects_the_compass_for_later(method: str, sign: float) -> None:
    """GIVEN a compass 17 deg off WHEN the navigator knew the heading and is gone THEN it stays right for 2 minutes.

    A quaternion and its negative are the same attitude.
    """
    subject = engine(method)
    standing(30.0, None, subject, field=TURNED)
    standing(60.0, replace(AIDED, q_nb=(sign, 0.0, 0.0, 0.0)), subject, field=TURNED)
    end = standing(120.0, None, subject, field=TURNED)
    assert abs(heading_deg(end, np.array([LEVEL]))[0]) < 1.0


@pytest.mark.parametrize("method", METHODS)
def test_nothing_is_learned_from_a_navigator_without_gnss(method: str) -> None:
    subject = engine(method)
    end = standing(60.0, COASTING, subject, field=TURNED, force=(0.2, 0.0, 0.0))
    assert abs(heading_deg(end, np.array([LEVEL]))[0]) == pytest.approx(
        math.degrees(0.3), abs=3.0
    )  # 1 deg of tilt, dip
    state = subject.snapshot()[0].state
    assert state[at.COMPASS_OFFSET] == 0.0
    assert not state[at.FORCE_BIAS : at.FORCE_BIAS + 3].any()


@pytest.mark.parametrize("method", METHODS)
def test_the_level_from_gnss_reveals_the_accelerometer_bias(method: str) -> None:
    """GIVEN 0.2 m/s^2 of bias, 1.2 deg of tilt WHEN a navigator knew the level and is gone THEN 0.3 deg are left."""
    subject = engine(method)
    standing(240.0, AIDED, subject, force=(0.2, 0.0, 0.0))
    end = standing(60.0, None, subject, force=(0.2, 0.0, 0.0))
    assert np.abs(np.degrees(euler_from_quat_many(end)[0, :2])).max() < 0.3


def drive(wheels: bool) -> np.ndarray:
    """RMSE of roll and pitch [deg] of the filter alone on a road, from 60 s on."""
    flight, blocks = generate("road_vehicle_wheels", 200.0, 11, "icm42688_calibrated", RATE), []
    subject = engine(**QUIET)
    for sample in flight.samples():
        if isinstance(sample, (ImuBlock, MagSample)) or (wheels and isinstance(sample, BodyVelocity)):
            blocks += [o for o in subject.feed(sample) if isinstance(o, AttitudeBlock)]
    stamps, q = (np.concatenate([getattr(b, name) for b in blocks]) for name in ("stamps_ns", "q_nb"))
    truth = flight.truth.at((stamps - flight.start_ns) * 1e-9)
    late = truth.t > 60.0
    error = np.degrees(wrap_angle_many(euler_from_quat_many(q[late]) - euler_from_quat_many(truth.q_nb[late])))
    return np.sqrt(np.mean(error[:, :2] ** 2, axis=0))


def test_on_a_road_the_filter_alone_keeps_level_and_wheels_make_it_better() -> None:
    """GIVEN a car that never had GNSS WHEN it drives for 200 s THEN 1.5 deg hold, and 0.5 deg with its wheels."""
    without, with_wheels = drive(False), drive(True)
    assert without.max() < 1.5
    assert with_wheels.max() < 0.5
    assert with_wheels.sum() < without.sum()


@pytest.mark.parametrize("velocity", [(5.0, math.nan, 0.0), (math.inf, 0.0, 0.0), (1e4, 0.0, 0.0)])
def test_an_incomplete_body_velocity_is_an_event_and_changes_nothing(velocity) -> None:
    subject = engine()
    standing(2.0, None, subject)
    before = subject.snapshot()[0].state.copy()
    (event,) = subject.feed(BodyVelocity(3_000_000_000, velocity))
    assert isinstance(event, Event)
    assert event.name == "attitude.body_velocity.incomplete"
    np.testing.assert_array_equal(subject.snapshot()[0].state, before)


def test_a_body_velocity_that_goes_back_is_an_event() -> None:
    subject = engine()
    standing(2.0, None, subject)
    assert subject.feed(BodyVelocity(3_000_000_000, (1.0, 0.0, 0.0))) == []
    (event,) = subject.feed(BodyVelocity(3_000_000_000, (1.0, 0.0, 0.0)))
    assert event.name == "attitude.body_velocity.stamp"
