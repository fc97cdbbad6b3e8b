"""Start-up alignment on exact motion with noise, and on real flights."""

import json
import math
from dataclasses import dataclass, replace

import numpy as np
import pytest

from filter_start import plain_constants
from nav_pose_estimator.core.alignment.aligner import Aligner, AlignmentSettings
from nav_pose_estimator.core.alignment.heading_hypotheses import HeadingHypotheses
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.numerics.rotation import (
    euler_from_quat,
    quat_from_euler,
    quat_from_rotvec,
    quat_multiply,
    quat_multiply_many,
    quat_rotate_many,
    quat_to_matrix,
    rotvec_from_quat_many,
    wrap_angle,
)
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.sim.trajectories import Kinematics, Origin, sample_times, truth_of_motion
from nav_pose_estimator.sim.vehicles.motions import HarmonicMotion, Harmonics, at_rest, coordinated_acceleration

ORIGIN = Origin(math.radians(47.4), math.radians(8.5), 450.0)
FIELD_N = np.array([0.7e-6, 21.6e-6, -42.7e-6])  # declination 1.9 deg
DECLINATION = math.atan2(FIELD_N[0], FIELD_N[1])
GYRO_BIAS = np.array([0.006, -0.004, 0.003])
ACCEL_BIAS = np.array([0.08, -0.05, 0.06])
WEAVE = HarmonicMotion(
    position=(
        Harmonics(0.0, 2.0, (12.0, 3.0), (0.5, 1.1), (0.0, 1.0)),
        Harmonics(0.0, -1.0, (10.0, 2.0), (0.6, 1.3), (0.7, 0.0)),
        Harmonics(0.0, 0.0, (1.5,), (0.4,), (0.0,)),
    ),
    attitude=(
        Harmonics(0.02, 0.0, (0.1,), (0.7,), (0.3,)),
        Harmonics(-0.03, 0.0, (0.1,), (0.6,), (0.0,)),
        Harmonics(0.5, 0.05, (0.3,), (0.3,), (0.0,)),
    ),
)


def settings(**changes):
    parameters = Parameters()
    shared = {name: getattr(parameters.alignment, name) for name in AlignmentSettings.shared()}
    own = {"gyro_noise": 3e-4, "accel_noise": 0.01, "declination": DECLINATION, "lever_arm": (0.0, 0.0, 0.0)}
    return AlignmentSettings(**{**shared, **own, **changes})


def facing(motion, yaw):
    """The same motion, turned about Up."""
    turn = quat_from_rotvec(np.array([0.0, 0.0, yaw]))
    C = quat_to_matrix(turn)

    def turned(t):
        k = motion(t)
        return Kinematics(k.v_t @ C.T, k.a_t @ C.T, quat_multiply_many(turn, k.q_tb), k.w_tb_b)

    return turned


@dataclass
class Story:
    """A motion with its sensors; ``tell`` feeds an aligner in order of arrival and stops at a full result."""

    motion: object
    duration: float
    rate: float = 100.0
    seed: int = 1
    delay: float = 0.0
    vibration: float = 0.0  # m/s^2
    field_n: np.ndarray | None = None
    mag_offset: np.ndarray | tuple = (0.0, 0.0, 0.0)
    gnss_from: float = 0.0
    velocity: str = "full"  # full, horizontal, none

    def __post_init__(self):
        rng = np.random.default_rng(self.seed)
        self.truth = truth_of_motion(self.motion, sample_times(self.duration, self.rate), ORIGIN)
        shape = self.truth.gyro.shape
        self.gyro = self.truth.gyro + GYRO_BIAS + rng.normal(0.0, 2e-4 * math.sqrt(self.rate), shape)
        self.accel = self.truth.accel + ACCEL_BIAS + rng.normal(0.0, 5e-3 * math.sqrt(self.rate), shape)
        self.accel += rng.normal(0.0, 1.0, shape) * self.vibration
        fixes = np.arange(0.1, self.duration, 0.2)
        self.fixes = self.truth.at(fixes[fixes >= self.gnss_from])
        n = len(self.fixes)
        self.velocities = self.fixes.v_n + rng.normal(0.0, (0.1, 0.1, 0.15), (n, 3))
        scatter = rng.normal(0.0, (0.7, 0.7, 1.0), (n, 3)) / 6.378e6
        self.lat = self.fixes.lat + scatter[:, 1]
        self.lon = self.fixes.lon + scatter[:, 0] / math.cos(ORIGIN.lat)

    def events(self):
        out = [(t, 0, i) for i, t in enumerate(self.truth.t)]
        out += [(t + self.delay + 1e-4, 1, i) for i, t in enumerate(self.fixes.t)]
        if self.field_n is not None:
            out += [(t + 2e-4, 2, i) for i, t in enumerate(self.truth.t) if i % 10 == 0]
        return sorted(out)

    def tell(self, aligner):
        """Returns (result or None, time of arrival)."""
        field_b = None
        if self.field_n is not None:
            q_bn = self.truth.q_nb * (1.0, -1.0, -1.0, -1.0)
            field_b = quat_rotate_many(q_bn, np.tile(self.field_n, (len(self.truth), 1))) + self.mag_offset
        for t, kind, i in self.events():
            if kind == 0:
                aligner.imu(t, self.gyro[i], self.accel[i])
            elif kind == 1:
                self._tell_fix(aligner, i)
            else:
                aligner.compass.add(t, field_b[i])
            result = aligner.result()
            if result is not None and result.has_position:
                return result, t
        return aligner.result(), self.duration

    def _tell_fix(self, aligner, i):
        velocity = {"full": self.velocities[i], "horizontal": (*self.velocities[i, :2], math.nan), "none": None}
        f = self.fixes
        aligner.gnss(f.t[i], self.lat[i], self.lon[i], f.alt[i], velocity[self.velocity], 1.5, 0.1)

    def error(self, result):
        """Attitude error (3,) about n [rad] at the result's time."""
        truth = self.truth.at(np.array([result.t])).q_nb[0]
        return rotvec_from_quat_many(quat_multiply(result.nav[at.QUAT : at.QUAT + 4], truth * (1.0, -1.0, -1.0, -1.0)))


def assert_honest(story, result, sigmas=4.0):
    """The errors lie within ``sigmas`` of the result's own covariance, and the covariance is one."""
    error = story.error(result)
    sd = np.sqrt(np.diag(result.P))
    assert np.all(np.abs(error) < sigmas * sd[at.PHI : at.PHI + 3]), (np.degrees(error), np.degrees(sd[:3]))
    truth = story.truth.at(np.array([result.t]))
    assert np.all(np.abs(result.nav[at.VEL : at.VEL + 3] - truth.v_n[0]) < sigmas * sd[at.DVEL : at.DVEL + 3])
    bias = result.nav[at.GYRO_BIAS : at.GYRO_BIAS + 3] - GYRO_BIAS
    assert np.all(np.abs(bias) < sigmas * sd[at.D_GYRO_BIAS : at.D_GYRO_BIAS + 3])
    np.testing.assert_array_equal(result.P, result.P.T)
    assert np.linalg.eigvalsh(result.P).min() > 0.0
    assert result.t == result.nav[at.TIME]


# --- at rest -------------------------------------------------------------------------------------------------------
@pytest.mark.parametrize(("roll", "pitch", "yaw"), [(0.0, 0.0, 0.0), (0.1, -0.15, 2.0), (-0.2, 0.1, -3.0)])
def test_at_rest_with_magnetometer_it_takes_one_window(roll, pitch, yaw):
    """GIVEN a vehicle at rest with IMU, GNSS and magnetometer THEN it is aligned after the static window."""
    story = Story(at_rest(roll, pitch, yaw), 5.0, field_n=FIELD_N)
    result, t = story.tell(Aligner(settings()))
    assert t < 2.7
    assert_honest(story, result)
    assert abs(story.error(result)[2]) < math.radians(2.0)
    assert np.abs(result.nav[at.GYRO_BIAS : at.GYRO_BIAS + 3] - GYRO_BIAS).max() < 8e-4
    assert result.method == "at rest, magnetic heading"


def test_without_gnss_the_attitude_comes_first_and_the_position_later():
    """GIVEN no GNSS for the first 8 s THEN the attitude is known before, and the fix completes it."""
    story = Story(at_rest(0.1, 0.0, 1.0), 10.0, field_n=FIELD_N, gnss_from=8.0)
    aligner = Aligner(settings())
    early = replace(story, duration=7.0, gnss_from=8.0).tell(aligner)[0]
    assert early is not None
    assert not early.has_position
    assert "GNSS fix" in aligner.waiting_for()
    result, t = story.tell(Aligner(settings()))
    assert result.has_position
    assert 8.0 < t < 8.5


@pytest.mark.parametrize("field", [FIELD_N * 1e6, FIELD_N * (1, 1, -1)], ids=["wrong unit", "wrong dip"])
def test_an_implausible_magnetometer_is_not_believed_and_the_reason_is_told(field):
    aligner = Aligner(settings())
    result, _ = Story(at_rest(), 6.0, field_n=field).tell(aligner)
    assert result is None
    assert "magnetic" in aligner.waiting_for()
    assert "motion" in aligner.waiting_for()


def test_at_rest_without_magnetometer_no_heading_is_invented():
    """GIVEN 60 s at rest without magnetometer THEN there is no result, only a request for motion."""
    aligner = Aligner(settings())
    assert Story(at_rest(), 60.0, rate=50.0).tell(aligner)[0] is None
    assert "needs motion" in aligner.waiting_for()


def test_a_large_gyroscope_offset_at_rest_is_learned_not_taken_for_a_turn():
    """GIVEN an uncalibrated gyroscope with 20 deg/s of offset at rest THEN the offset is found in one window."""
    offset = np.radians((-9.0, -3.0, 17.0))
    story = Story(at_rest(0.05, 0.0, 1.0), 5.0, field_n=FIELD_N)
    story.gyro += offset
    result, t = story.tell(Aligner(settings()))
    assert t < 2.7
    np.testing.assert_allclose(result.nav[at.GYRO_BIAS : at.GYRO_BIAS + 3], GYRO_BIAS + offset, atol=8e-4)


def test_a_receiver_that_reports_motion_at_rest_starts_nothing():
    """GIVEN a vehicle at rest WHEN a receiver just switched on reports 3 m/s THEN no heading is made of it."""
    story = Story(at_rest(), 20.0)
    story.velocities += np.outer(2.0 + np.sin(story.fixes.t), (3.0, 2.0, 0.0))
    aligner = Aligner(settings())
    assert story.tell(aligner)[0] is None
    assert "GNSS reports motion" in aligner.waiting_for()


def test_each_missing_thing_is_told():
    aligner = Aligner(settings())
    assert "IMU" in aligner.waiting_for()
    aligner.imu(0.0, (0.0, 0.0, 0.0), (0.0, 0.0, 9.8))
    assert "GNSS fix" in aligner.waiting_for()


# --- first motion --------------------------------------------------------------------------------------------------
@pytest.mark.compiled
@pytest.mark.parametrize("yaw", [0.0, 1.3, -2.2, 3.1])
def test_heading_comes_from_the_first_motion_after_a_rest(yaw):
    """GIVEN 8 s at rest without magnetometer WHEN the vehicle accelerates THEN the heading is found within seconds."""
    motion = facing(coordinated_acceleration(math.radians(20.0), start=8.0, length=4.0), yaw)
    story = Story(motion, 25.0, delay=0.2, seed=int(10 * yaw) % 7)
    result, t = story.tell(Aligner(settings()))
    assert t < 14.0
    assert_honest(story, result)
    assert result.method.startswith("at rest, heading from")
    assert abs(story.error(result)[2]) < math.radians(25.0)


@pytest.mark.compiled
@pytest.mark.parametrize(
    "circumstances",
    [
        {},
        {"delay": 0.35},
        {"rate": 50.0, "vibration": 0.8},
        {"rate": 120.0, "vibration": 2.5, "delay": 0.1},
        {"velocity": "horizontal"},
        {"field_n": FIELD_N},
    ],
    ids=["plain", "late fixes", "50 Hz", "strong vibration", "no vertical velocity", "magnetometer"],
)
@pytest.mark.parametrize("yaw", [0.4, 2.6, -1.7])
def test_in_motion_the_heading_is_found_by_hypotheses(yaw, circumstances):
    """GIVEN a flight that starts in the air THEN heading, tilt and velocity are found, with an honest sigma."""
    story = Story(facing(WEAVE, yaw), 30.0, seed=5, **circumstances)
    result, t = story.tell(Aligner(settings()))
    assert t < 15.0
    assert result.t <= t
    assert_honest(story, result)
    assert math.sqrt(result.P[2, 2]) < 1.5 * settings().heading_sd
    assert abs(story.error(result)[2]) < math.radians(25.0)


def test_in_motion_without_compiled_kernels_too():
    """The one test in motion that also runs with kernels in plain Python."""
    story = Story(facing(WEAVE, 1.0), 8.0, rate=50.0, seed=2)
    result, _ = story.tell(Aligner(settings(hypotheses=6, heading_sd=0.3)))
    assert_honest(story, result)


@pytest.mark.compiled
def test_positions_alone_give_the_heading_too():
    story = Story(facing(WEAVE, 1.0), 60.0, velocity="none")
    result, t = story.tell(Aligner(settings()))
    assert t < 60.0
    assert_honest(story, result)


@pytest.mark.compiled
@pytest.mark.parametrize("offset", [(30e-6, 0, 0), (-40e-6, 10e-6, 0)])
def test_an_uncalibrated_magnetometer_does_not_win_against_motion(offset):
    """GIVEN a magnetometer whose hard iron exceeds the field WHEN the vehicle moves THEN motion decides."""
    story = Story(facing(WEAVE, 2.0), 40.0, field_n=FIELD_N, mag_offset=np.array(offset))
    result, _ = story.tell(Aligner(settings()))
    assert_honest(story, result)
    assert abs(story.error(result)[2]) < math.radians(25.0)


@pytest.mark.compiled
def test_a_hover_without_magnetometer_gives_no_heading():
    """GIVEN a vibrating hover THEN 30 s of GNSS noise do not make a heading."""
    hover = HarmonicMotion(attitude=(Harmonics(0.0, 0.0, (0.03,), (4.0,), (0.0,)), Harmonics(), Harmonics(0.7)))
    aligner = Aligner(settings())
    assert Story(hover, 30.0, vibration=1.0).tell(aligner)[0] is None
    assert "speed up" in aligner.waiting_for()


@pytest.mark.compiled
def test_headings_are_as_good_as_they_claim():
    """Over 24 seeded flights: no more than one sigma RMS; less, because real GNSS errors last from fix to fix."""
    ratios, tilts = [], []
    for seed in range(24):
        story = Story(facing(WEAVE, 0.7 * seed), 30.0, rate=50.0, seed=seed)
        result, _ = story.tell(Aligner(settings()))
        error, sd = story.error(result), np.sqrt(np.diag(result.P))
        ratios.append(error[2] / sd[2])
        tilts.extend(error[:2] / sd[:2])
    assert 0.1 < np.sqrt(np.mean(np.square(ratios))) < 1.0
    assert 0.1 < np.sqrt(np.mean(np.square(tilts))) < 1.2


# --- hypotheses ----------------------------------------------------------------------------------------------------
def bank(count=8, prior=None):
    nav, P = np.zeros(at.NAV_SIZE), np.diag(np.linspace(0.01, 0.15, 15) ** 2)
    nav[at.QUAT : at.QUAT + 4] = quat_from_euler(0.1, -0.05, 0.0)
    nav[at.LAT : at.ALT + 1] = ORIGIN
    return HeadingHypotheses(nav, P, count, plain_constants(), np.zeros(3), prior)


def test_hypotheses_cover_the_circle():
    b = bank()
    assert b.weights == pytest.approx(np.full(8, 1 / 8))
    assert b.heading()[1] > math.radians(90.0)
    yaws = sorted(euler_from_quat(nav[at.QUAT : at.QUAT + 4])[2] for nav in b.navs)
    np.testing.assert_allclose(np.diff(yaws), math.pi / 4, atol=1e-12)


def test_merging_two_hypotheses_gives_mean_and_spread():
    """Two headings a quarter apart with weights 3 : 1 merge at a quarter of the way, with the spread between them."""
    weights = np.full(8, 1e-9)
    weights[2], weights[3] = 0.75, 0.25
    nav, P = bank(prior=np.log(weights)).merged()
    yaw = euler_from_quat(nav[at.QUAT : at.QUAT + 4])[2]
    assert yaw == pytest.approx(math.pi / 4 * 2.25, abs=1e-3)
    spread = 0.75 * 0.25 * (math.pi / 4) ** 2
    assert P[2, 2] == pytest.approx((math.pi / 8) ** 2 + spread, rel=1e-3)
    assert euler_from_quat(nav[at.QUAT : at.QUAT + 4])[:2] == pytest.approx((0.1, -0.05), abs=1e-3)


# --- real flights --------------------------------------------------------------------------------------------------
FLIGHTS = (
    "x8_testlog2",
    "px4_flow",
    "quad106",
    "quadflow",
    "p4rtk_dot1",
    "p4rtk_dot2",
    "p4rtk_dot4",
    "p4rtk_dot7",
    "px4_quad_0107",
)
NO_REFERENCE = ("px4_quad_0107",)  # its attitude in the log is constant


def align_flight(folder, name, with_mag, begin):
    """Feed a flight from ``begin`` s before take-off; returns (result, seconds after take-off, reference yaw)."""
    data = np.load(folder / "flights" / f"{name}.npz")
    about = json.loads((folder / "flights" / f"{name}.json").read_text())
    take_off, delay = about["flight_window_s"][0], about["gnss_latency_est_s"]
    start = max(data["t_imu"][0], take_off - begin)
    events = []
    for kind, key in enumerate(("t_imu", "t_gnss", "t_mag")):
        if key in data and (key != "t_mag" or with_mag):
            times = data[key]
            events += [(times[i], kind, i) for i in np.flatnonzero((times >= start) & (times < take_off + 60.0))]
    arrays = {key: data[key] for key in ("gyro", "accel", "lat_deg", "lon_deg", "alt_m", "vel_enu")}
    mag = data.get("mag")
    aligner = Aligner(settings(gyro_noise=2e-4, accel_noise=3e-3, declination=0.0))
    for t, kind, i in sorted(events):
        if kind == 0:
            aligner.imu(t - start, arrays["gyro"][i], arrays["accel"][i])
        elif kind == 1:
            lat, lon = math.radians(arrays["lat_deg"][i]), math.radians(arrays["lon_deg"][i])
            aligner.gnss(t - start - delay, lat, lon, arrays["alt_m"][i], arrays["vel_enu"][i], 2.0, 0.2)
        else:
            aligner.compass.add(t - start, mag[i])
        result = aligner.result()
        if result is not None and result.has_position:
            row = np.searchsorted(data["t_ref"], result.t + start)
            reference = euler_from_quat(np.ascontiguousarray(data["q_ref"][min(row, len(data["q_ref"]) - 1)]))
            return result, t - take_off, reference
    return None, math.inf, aligner.waiting_for()


@pytest.mark.compiled
@pytest.mark.parametrize("begin", [20.0, -3.0], ids=["before take-off", "in the air"])
@pytest.mark.parametrize("with_mag", [True, False], ids=["mag", "no mag"])
@pytest.mark.parametrize("name", FLIGHTS)
def test_real_flights_align_within_a_minute(shared_data, name, with_mag, begin):
    """GIVEN a real flight THEN 60 s after take-off it is aligned; heading and tilt agree with the autopilot's."""
    result, t, reference = align_flight(shared_data, name, with_mag, begin)
    assert result is not None, reference
    assert t < 60.0
    if name in NO_REFERENCE:
        return
    roll, pitch, yaw = euler_from_quat(result.nav[at.QUAT : at.QUAT + 4])
    assert abs(wrap_angle(yaw - reference[2])) < max(math.radians(15.0), 2.5 * math.sqrt(result.P[2, 2]))
    assert abs(wrap_angle(roll - reference[0])) < math.radians(5.0)
    assert abs(wrap_angle(pitch - reference[1])) < math.radians(5.0)
