"""Complaints 13 to 15: frames and mountings, covariances that say nothing, an origin that is latched too soon."""

import math
from dataclasses import replace

import numpy as np
import pytest

import small_bags
from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.imu.mounting import rotation_from_rpy
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import GnssFix, ImuBlock, MagSample
from nav_pose_estimator.engine.solutions import AttitudeBlock, Event
from nav_pose_estimator.engine.world_frame import attitude_in
from nav_pose_estimator.ros.messages import convert
from nav_pose_estimator.sim.faults import Shift
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import find_scenario, generate
from nav_pose_estimator.sim.sensors import Magnetometer
from nav_pose_estimator.sim.vehicles import motions
from nav_pose_estimator.sim.vehicles.models import Prescribed
from told import flight, tell

MOUNTINGS = [(0, 0, 0), (180, 0, 0), (0, 90, 0), (0, -90, 0), (90, 0, 0), (0, 0, 90)]  # roll, pitch, yaw of the sensor
HEADINGS = [0.0, 90.0, 180.0, -90.0]  # REP-103: counter-clockwise from East


def standing(yaw_deg: float) -> Recording:
    """Six seconds of a vehicle that stands level, its compass free of its usual errors."""
    good = Magnetometer(hard_iron_sd=0.0, soft_iron_sd=0.0, heading_sd=0.0, declination=0.0)
    vehicle = Prescribed(motions.at_rest(0.0, 0.0, math.radians(yaw_deg)))
    return generate(replace(find_scenario("at_rest"), vehicle=vehicle, magnetometer=good), 6.0, 1, imu_rate=50.0)


def as_mounted(recording: Recording, C_bs: np.ndarray) -> list:
    """What the sensor, turned in the body, would have published."""
    samples = []
    for sample in recording.samples():
        if isinstance(sample, ImuBlock):
            sample = ImuBlock(sample.stamps_ns, sample.gyro @ C_bs, sample.accel @ C_bs)
        elif isinstance(sample, MagSample):
            sample = replace(sample, field=tuple((np.array(sample.field) @ C_bs).tolist()))
        samples.append(sample)
    return samples


@pytest.mark.parametrize("mounting", MOUNTINGS, ids=str)
@pytest.mark.parametrize("heading", HEADINGS)
def test_pain_13_every_heading_with_every_mounting(heading: float, mounting: tuple[int, int, int]) -> None:
    """GIVEN an IMU turned in the vehicle WHEN its mounting is set THEN level is level, and yaw counts from East."""
    rpy = tuple(math.radians(angle) for angle in mounting)
    engine = PoseEstimator(update(Parameters(), {"imu.mounting_rpy": rpy, "aids.declination": 0.0}))
    outputs = [o for s in as_mounted(standing(heading), rotation_from_rpy(rpy)) for o in engine.feed(s)]
    q = [o for o in outputs if isinstance(o, AttitudeBlock)][-1].q_nb[-1]
    nose, up = column(q, 0), column(q, 2)
    assert math.degrees(math.acos(min(up[2], 1.0))) < 1.0
    yaw = math.degrees(math.atan2(nose[1], nose[0]))
    assert abs(math.remainder(yaw - heading, 360.0)) < 5.0


def column(q: np.ndarray, axis: int) -> np.ndarray:
    w, x, y, z = q.tolist()
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )[:, axis]


@pytest.mark.parametrize(("frame", "nose"), [("enu", (0, 1, 0)), ("ned", (1, 0, 0)), ("nwu", (1, 0, 0))])
def test_pain_13_the_same_attitude_in_other_frames(frame: str, nose: tuple[int, int, int]) -> None:
    """GIVEN a level vehicle that looks North THEN its nose points along the axis that the frame calls North."""
    looking_north = np.array([math.sqrt(0.5), 0.0, 0.0, math.sqrt(0.5)])
    q, _ = attitude_in(frame, looking_north, np.eye(3))
    np.testing.assert_allclose(column(q, 0), nose, atol=1e-12)


# --- 14 --------------------------------------------------------------------------------------------------------------
def with_covariance(values: list[float], kind: int) -> GnssFix:
    message = small_bags.fix(10**9)
    message.position_covariance[:] = values
    message.position_covariance_type = kind
    return convert.nav_sat_fix(message)[0]


@pytest.mark.parametrize(
    ("values", "kind", "knows"),
    [
        ([9.0, 0, 0, 0, 9.0, 0, 0, 0, 16.0], 2, True),
        ([0.0] * 9, 2, False),
        ([0.0] * 9, 0, False),
        ([-1.0] + [0.0] * 8, 2, False),
        ([1.7976931348623157e308, 0, 0, 0, 1.7976931348623157e308, 0, 0, 0, 1.0], 2, False),
        ([math.nan] * 9, 2, False),
    ],
    ids=["known", "zeros", "unknown", "minus one", "1.8e308", "NaN"],
)
def test_pain_14_a_covariance_is_known_or_not_and_never_invented(values: list[float], kind: int, knows: bool) -> None:
    """GIVEN what drivers write WHEN it says something THEN that is R, else R is the value of the parameters."""
    fix = with_covariance(values, kind)
    assert (fix.cov_enu is not None) == knows
    spoken = tell(
        flight(duration=60.0), samples=saying(fix.cov_enu), gnss__position_correlation=0.0, gnss__delay_sd=0.0
    )
    silent = tell(flight(duration=60.0), samples=saying(None), gnss__position_correlation=0.0, gnss__delay_sd=0.0)
    assert np.isfinite(spoken.error).all()
    if knows:
        assert spoken.sigma[-1] > 1.3 * silent.sigma[-1]
    else:
        assert spoken.sigma[-1] == silent.sigma[-1]


def saying(cov: np.ndarray | None) -> list:
    """The flight with the same covariance in every fix."""
    samples = flight(duration=60.0).samples()
    return [replace(s, cov_enu=cov) if isinstance(s, GnssFix) else s for s in samples]


def test_pain_14_an_imu_message_that_measured_nothing_is_not_used() -> None:
    message = small_bags.imu(10**9)
    message.linear_acceleration_covariance[0] = -1.0
    (event,) = convert.imu(message)
    assert isinstance(event, Event)
    assert event.name == "imu.rejected.absent"


# --- 15 --------------------------------------------------------------------------------------------------------------
def spoiled_start(seconds: float, **changes: object) -> list:
    """The flight with other fixes at its beginning."""
    recording, out = flight(duration=60.0), []
    for sample in recording.with_faults(Shift(GnssFix, 0.0, seconds, (2000.0, 0.0, 300.0))).samples():
        if isinstance(sample, GnssFix) and sample.stamp_ns < recording.start_ns + seconds * 1e9:
            sample = replace(sample, **changes)
        out.append(sample)
    return out


@pytest.mark.parametrize(
    "changes",
    [
        {"status": -1},
        {"status": -1, "lat": math.nan, "lon": math.nan},
        {"status": -1, "lat": 0.0, "lon": 0.0},
        {"cov_enu": np.diag([2500.0, 2500.0, 1e4])},
        {"lat": math.inf},
    ],
    ids=["no fix", "NaN", "null island", "inaccurate", "infinite"],
)
def test_pain_15_the_origin_waits_for_good_fixes(changes: dict) -> None:
    """GIVEN a receiver whose first fixes are bad or none WHEN they get good THEN the origin is where the vehicle is."""
    recording = flight(duration=60.0)
    told = tell(recording, samples=spoiled_start(8.0, **changes))
    assert told.estimator.origin is not None
    start = lla_to_enu(*told.estimator.origin, *recording.origin)
    assert np.hypot(*start[:2]) < 5.0
    assert told.t[0] > 7.5  # waited
    assert told.off.max() < 8.0
