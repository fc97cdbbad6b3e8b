"""Statistics of the simulated sensors: what the model promises is what comes out."""

from dataclasses import replace

import numpy as np
import pytest

from nav_pose_estimator.core.earth.atmosphere import pressure_height, water_height
from nav_pose_estimator.core.earth.ellipsoid import gravity
from nav_pose_estimator.core.numerics.rotation import euler_from_quat_many, quat_rotate_many
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, MagSample, PressureSample, SatelliteCount
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.sim import sensors
from nav_pose_estimator.sim.imu_grades import IMU_GRADES, ImuGrade, calibrated, imu_grade
from nav_pose_estimator.sim.noise import gauss_markov, random_walk, stream, white_noise
from nav_pose_estimator.sim.scenarios import HOME, START_NS
from nav_pose_estimator.sim.sensors import Barometer, DepthGauge, Gnss, Magnetometer
from nav_pose_estimator.sim.trajectories import Truth, sample_times, truth_of_motion
from nav_pose_estimator.sim.vehicles import motions


@pytest.fixture(scope="module")
def rest() -> Truth:
    """Half an hour on the ground."""
    return truth_of_motion(motions.at_rest(0.05, -0.1, 0.8), sample_times(1800.0, 100.0), HOME)


@pytest.fixture(scope="module")
def tumble() -> Truth:
    """A minute of aerobatics."""
    return truth_of_motion(motions.closed_curve(), sample_times(60.0, 200.0), HOME)


def allan_deviation(values: np.ndarray, count: int) -> np.ndarray:
    """Allan deviation (k,) over averages of ``count`` values (N, k)."""
    means = values[: len(values) // count * count].reshape(-1, count, values.shape[1]).mean(axis=1)
    return np.sqrt(0.5 * np.mean(np.diff(means, axis=0) ** 2, axis=0))


@pytest.mark.parametrize("name", ["icm42688", "bmi088", "mpu6000"])
def test_noise_densities_are_recovered(rest: Truth, name: str) -> None:
    grade = replace(imu_grade(name), gyro_bias_sd=0.0, accel_bias_sd=0.0)
    block = sensors.imu(rest, grade, stream(1, "imu"), START_NS).block
    # White noise of density N has the Allan deviation N / sqrt(tau); the resolution adds a little.
    for values, density in ((block.gyro, grade.gyro_noise), (block.accel, grade.accel_noise)):
        np.testing.assert_allclose(allan_deviation(values, 100), density, rtol=0.1)


def test_bias_instability_is_recovered(rest: Truth) -> None:
    grade = ImuGrade("bias only", gyro_bias_sd=1e-3, gyro_bias_tau=5.0, accel_bias_sd=0.02, accel_bias_tau=10.0)
    data = sensors.imu(rest, grade, stream(2, "imu"), START_NS)
    np.testing.assert_allclose(data.gyro_bias.std(axis=0), 1e-3, rtol=0.15)
    np.testing.assert_allclose(data.accel_bias.std(axis=0), 0.02, rtol=0.2)
    np.testing.assert_allclose(data.block.gyro - rest.gyro, data.gyro_bias, atol=1e-15)
    np.testing.assert_allclose(data.block.accel - rest.accel, data.accel_bias, atol=1e-14)


def test_gauss_markov_correlation() -> None:
    x = gauss_markov(np.random.default_rng(0), 200_000, 0.1, 2.0, 3.0, axes=1)[:, 0]
    assert np.std(x) == pytest.approx(2.0, rel=0.05)
    for lag in (10, 30, 60):
        assert np.mean(x[lag:] * x[:-lag]) == pytest.approx(4.0 * np.exp(-lag * 0.1 / 3.0), abs=0.25)
    starts = [gauss_markov(np.random.default_rng(i), 1, 0.1, 2.0, 3.0)[0] for i in range(2000)]
    assert np.std(starts) == pytest.approx(2.0, rel=0.05)  # stationary from the first value on


def test_random_walk_and_white_noise_densities() -> None:
    rng = np.random.default_rng(1)
    ends = [random_walk(rng, 101, 0.5, 0.3, axes=1)[-1, 0] for _ in range(3000)]
    assert np.std(ends) == pytest.approx(0.3 * np.sqrt(50.0), rel=0.05)
    angles = [np.sum(white_noise(rng, 200, 0.01, 0.02, axes=1)) * 0.01 for _ in range(3000)]
    assert np.std(angles) == pytest.approx(0.02 * np.sqrt(2.0), rel=0.05)


def test_scale_and_misalignment_are_in_the_data(tumble: Truth) -> None:
    grade = ImuGrade("skewed", gyro_matrix_sd=0.01, accel_matrix_sd=0.02)
    data = sensors.imu(tumble, grade, stream(3, "imu"), START_NS)
    found = np.linalg.lstsq(tumble.gyro, data.block.gyro, rcond=None)[0].T - np.eye(3)
    np.testing.assert_allclose(found, data.gyro_matrix, atol=1e-10)
    np.testing.assert_allclose(data.block.accel, tumble.accel @ (np.eye(3) + data.accel_matrix).T, atol=1e-12)
    assert 0.002 < np.std(data.gyro_matrix) < 0.03


def test_turn_on_biases_vary_from_run_to_run_by_their_deviation(tumble: Truth) -> None:
    grade = imu_grade("bmi088")
    short = truth_of_motion(motions.at_rest(), sample_times(1.0, 10.0), HOME)
    runs = [sensors.imu(short, grade, stream(i, "imu"), START_NS) for i in range(400)]
    assert np.std([run.gyro_bias[0] for run in runs]) == pytest.approx(grade.gyro_turn_on_sd, rel=0.08)
    assert np.std([run.accel_bias[0] for run in runs]) == pytest.approx(grade.accel_turn_on_sd, rel=0.08)
    better = calibrated(grade)
    runs = [sensors.imu(short, better, stream(i, "imu"), START_NS) for i in range(100)]
    assert np.std([run.gyro_bias[0] for run in runs]) < 0.1 * grade.gyro_turn_on_sd


def test_warming_moves_the_bias(rest: Truth) -> None:
    grade = ImuGrade("cold", accel_per_kelvin=0.002, warm_up=20.0, warm_up_tau=100.0)
    bias = sensors.imu(rest, grade, stream(4, "imu"), START_NS).accel_bias
    assert np.abs(bias[0]).max() == 0.0
    one_tau = np.searchsorted(rest.t, 100.0)
    np.testing.assert_allclose(bias[one_tau] / bias[-1], 1.0 - np.exp(-1.0), rtol=1e-3)


def test_resolution_and_the_perfect_imu(tumble: Truth) -> None:
    grade = IMU_GRADES["icm42688"]
    block = sensors.imu(tumble, grade, stream(5, "imu"), START_NS).block
    steps = block.gyro / grade.gyro_resolution
    np.testing.assert_allclose(steps, np.round(steps), atol=1e-3)
    perfect = sensors.imu(tumble, IMU_GRADES["perfect"], stream(5, "imu"), START_NS).block
    np.testing.assert_array_equal(perfect.gyro, tumble.gyro)
    np.testing.assert_array_equal(perfect.accel, tumble.accel)
    assert perfect.stamps_ns[0] == START_NS
    assert (np.diff(perfect.stamps_ns) == 5_000_000).all()


def test_unknown_grade_names_the_nearest() -> None:
    with pytest.raises(UserError, match="did you mean 'icm42688'"):
        imu_grade("icm4288")


def offsets(truth: Truth, stream_of_samples: list, latency: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """East-North-Up errors (N, 3) of the fixes and velocities against the truth at their time of validity."""
    fixes = [timed.sample for timed in stream_of_samples if isinstance(timed.sample, GnssFix)]
    speeds = [timed.sample for timed in stream_of_samples if isinstance(timed.sample, GnssVelocity)]
    at = truth.at((np.array([fix.stamp_ns for fix in fixes]) - START_NS) * 1e-9 - latency)
    lat, lon, alt = np.array([(fix.lat, fix.lon, fix.alt) for fix in fixes]).T
    measured = replace(at, lat=lat, lon=lon, alt=alt)
    return measured.position_enu(HOME) - at.position_enu(HOME), np.array([v.vel_enu for v in speeds]) - at.v_n


def test_gnss_errors_have_the_promised_spread_and_correlation(rest: Truth) -> None:
    model = Gnss(position_tau=4.0, satellites_sd=0.0)
    position, velocity = offsets(rest, sensors.gnss(rest, model, stream(1, "gnss"), START_NS))
    total = np.hypot(model.position_sd, model.position_noise)
    np.testing.assert_allclose(position.std(axis=0), total, rtol=0.1)
    np.testing.assert_allclose(velocity.std(axis=0), model.velocity_noise, rtol=0.05)
    lag = 20  # 4 s: one correlation time
    correlation = np.mean(position[lag:] * position[:-lag], axis=0)
    np.testing.assert_allclose(correlation, np.square(model.position_sd) * np.exp(-1.0), rtol=0.35)


def test_gnss_says_how_accurate_it_is(rest: Truth) -> None:
    out = sensors.gnss(rest, Gnss(satellites_sd=0.0), stream(1, "gnss"), START_NS)
    fix = next(timed.sample for timed in out if isinstance(timed.sample, GnssFix))
    np.testing.assert_allclose(np.sqrt(np.diag(fix.cov_enu)), np.hypot((0.5, 0.5, 0.9), (0.25, 0.25, 0.4)))
    silent = sensors.gnss(rest, Gnss(accuracy=False, velocity=False), stream(1, "gnss"), START_NS)
    assert {type(timed.sample) for timed in silent} == {GnssFix, SatelliteCount}
    assert all(timed.sample.cov_enu is None for timed in silent if isinstance(timed.sample, GnssFix))


def test_gnss_speaks_in_the_order_of_mavros_and_arrives_after_its_stamp(rest: Truth) -> None:
    out = sensors.gnss(rest, Gnss(transport=0.02), stream(1, "gnss"), START_NS)
    assert [type(timed.sample) for timed in out[:3]] == [GnssFix, GnssVelocity, SatelliteCount]
    assert out[2].sample.stamp_ns is None
    assert out[0].arrival_ns - out[0].sample.stamp_ns == 20_000_000
    assert out[0].arrival_ns < out[1].arrival_ns < out[2].arrival_ns < out[3].arrival_ns


def test_gnss_latency_and_lever_arm(tumble: Truth) -> None:
    none = (0.0, 0.0, 0.0)
    clean = Gnss(position_sd=none, position_noise=none, velocity_noise=none, latency=0.25, lever_arm=(0.3, -0.2, 0.5))
    out = sensors.gnss(tumble, clean, stream(1, "gnss"), START_NS)
    position, velocity = offsets(tumble, out, latency=0.25)
    fixes = [timed.sample for timed in out if isinstance(timed.sample, GnssFix)]
    at = tumble.at((np.array([fix.stamp_ns for fix in fixes]) - START_NS) * 1e-9 - 0.25)
    np.testing.assert_allclose(position, quat_rotate_many(at.q_nb, clean.lever_arm), atol=1e-4)
    step = tumble.at(at.t + 0.0025), tumble.at(at.t - 0.0025)
    arms = [quat_rotate_many(one.q_nb, clean.lever_arm) for one in step]
    np.testing.assert_allclose(velocity, (arms[0] - arms[1]) / 0.005, atol=0.03)


def test_satellites_wander_drop_and_take_the_fix_with_them(rest: Truth) -> None:
    out = sensors.gnss(rest, Gnss(drops=((100.0, 50.0, 3), (300.0, 20.0, 0))), stream(1, "gnss"), START_NS)

    def during(kind: type, start: float, end: float) -> list:
        return [s.sample for s in out if isinstance(s.sample, kind) and start < (s.arrival_ns - START_NS) * 1e-9 < end]

    assert len({count.count for count in during(SatelliteCount, 500.0, 1800.0)}) > 3
    assert {count.count for count in during(SatelliteCount, 100.2, 150.0)} == {3}
    assert all(fix.status == 0 for fix in during(GnssFix, 100.2, 150.0))
    poor = during(GnssFix, 100.2, 150.0)[0].cov_enu[0, 0]
    assert poor > 4.0 * during(GnssFix, 0.0, 100.0)[0].cov_enu[0, 0] * 0.8
    lost = during(GnssFix, 300.2, 320.0)
    assert all(fix.status == -1 and np.isnan(fix.lat) for fix in lost)
    assert not during(GnssVelocity, 300.2, 320.0)


def test_magnetometer_points_north_but_for_its_errors(rest: Truth) -> None:
    exact = Magnetometer(noise=0.0, hard_iron_sd=0.0, soft_iron_sd=0.0, heading_sd=0.0, declination=0.1)
    samples = [timed.sample for timed in sensors.magnetometer(rest, exact, stream(1, "mag"), START_NS)]
    field_n = quat_rotate_many(rest.q_nb[0], np.array([sample.field for sample in samples]))
    np.testing.assert_allclose(np.arctan2(field_n[:, 0], field_n[:, 1]), 0.1, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(field_n, axis=1), exact.strength)
    assert field_n[0, 2] < 0.0  # it dips on the northern hemisphere
    assert isinstance(samples[0], MagSample)

    real = sensors.magnetometer(rest, replace(exact, noise=0.3e-6, heading_sd=0.05), stream(2, "mag"), START_NS)
    field = np.array([timed.sample.field for timed in real])
    np.testing.assert_allclose(field.std(axis=0), 0.3e-6, rtol=0.05)
    heading = []
    for i in range(100):
        out = sensors.magnetometer(rest.at(rest.t[:200]), replace(exact, heading_sd=0.05), stream(i, "mag"), START_NS)
        east, north, _ = quat_rotate_many(rest.q_nb[0], np.array(out[0].sample.field))
        heading.append(np.arctan2(east, north) - 0.1)
    assert np.std(heading) == pytest.approx(0.05, rel=0.3)


def test_magnetic_disturbance_comes_and_goes(rest: Truth) -> None:
    model = Magnetometer(noise=0.0, disturbances=((100.0, 10.0, (20e-6, 0.0, 0.0)),))
    out = sensors.magnetometer(rest, model, stream(1, "mag"), START_NS)
    t = (np.array([timed.sample.stamp_ns for timed in out]) - START_NS) * 1e-9
    field = np.array([timed.sample.field for timed in out])
    disturbed = np.linalg.norm(field - field[0], axis=1) > 1e-6
    assert disturbed[(t > 100.0) & (t < 110.0)].all()
    assert not disturbed[(t < 100.0) | (t >= 110.0)].any()


def test_barometer_drifts_but_follows_the_height(tumble: Truth, rest: Truth) -> None:
    steady = Barometer(noise=0.0, drift=0.0, offset_sd=0.0, resolution=0.0, rate=50.0)
    out = sensors.barometer(tumble, steady, stream(1, "baro"), START_NS)
    t = (np.array([timed.sample.stamp_ns for timed in out]) - START_NS) * 1e-9
    heights = [pressure_height(timed.sample.pressure) for timed in out]
    np.testing.assert_allclose(heights, tumble.at(t).alt, atol=1e-6)
    ends = []
    for i in range(100):
        out = sensors.barometer(rest, Barometer(noise=0.0, rate=1.0), stream(i, "baro"), START_NS)
        ends.append(out[-1].sample.pressure - out[0].sample.pressure)
    assert np.std(ends) == pytest.approx(0.3 * np.sqrt(1800.0), rel=0.25)
    assert isinstance(out[0].sample, PressureSample)
    assert out[0].sample.variance == 0.0


def test_depth_gauge_measures_the_depth_below_where_the_motion_begins(tumble: Truth, rest: Truth) -> None:
    steady = DepthGauge(noise=0.0, drift=0.0, offset_sd=0.0, rate=50.0)
    out = sensors.depth_gauge(tumble, steady, stream(1, "depth_gauge"), START_NS)
    t = (np.array([timed.sample.stamp_ns for timed in out]) - START_NS) * 1e-9
    strength = gravity(tumble.lat[0], tumble.alt[0])
    heights = [water_height(timed.sample.pressure, steady.density, strength) for timed in out]
    np.testing.assert_allclose(heights, tumble.at(t).alt - tumble.alt[0], atol=1e-6)
    gauge = DepthGauge(drift=0.0)
    means = [np.mean([timed.sample.pressure for timed in sensors.depth_gauge(rest, gauge, stream(i, "d"), START_NS)])
             for i in range(40)]  # fmt: skip
    assert np.std(means) == pytest.approx(gauge.offset_sd, rel=0.3)


def test_attitude_of_the_truth_is_in_ros_axes(rest: Truth) -> None:
    np.testing.assert_allclose(euler_from_quat_many(rest.q_nb[0]), (0.05, -0.1, 0.8), atol=1e-12)
