"""``calibrate``: what was done to a simulated magnetometer is found, and what a recording cannot show is told."""

import math
from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.engine.imu.mounting import Mounting
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.imu import ImuParameters
from nav_pose_estimator.engine.samples import ImuBlock, MagSample
from nav_pose_estimator.engine.sensors.magnetic.field_calibration import FieldCalibration
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.calibration.field_fit import FieldFit, fit_field
from nav_pose_estimator.offline.calibration.field_pairs import field_pairs
from nav_pose_estimator.offline.calibration.parameter_file import check
from nav_pose_estimator.offline.calibration.rests import accelerometer_errors, find_rests
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.simulated_bag import write_recording
from nav_pose_estimator.sim.faults import Stop
from told import flight, silence, tell
from wrong_compass import MIRRORED, turned, with_compass

pytestmark = pytest.mark.compiled
IRON = (30e-6, -20e-6, 10e-6)
SOFT = np.array([[1.1, 0.05, 0.0], [0.05, 0.9, 0.03], [0.0, 0.03, 1.0]])
CASES = {
    "hard iron": (np.eye(3), IRON),
    "soft iron": (SOFT, (0.0, 0.0, 0.0)),
    "turned by 90 deg": (np.array(turned(90.0)), IRON),
    "turned by 30 deg": (np.array(turned(30.0)), IRON),
    "mirrored": (np.array(MIRRORED), IRON),
    "upside down with soft iron": (SOFT @ np.diag([1.0, -1.0, -1.0]), IRON),
}


def base():
    return flight("multirotor_outage", 90.0)


def recorded(simulated) -> Recording:
    samples = list(simulated.samples())
    return Recording(Path("flight"), samples, simulated.start_ns, 90.0)


def fitted(simulated) -> FieldFit:
    recording = recorded(simulated)
    return fit_field(field_pairs(recording, find_rests(recording.imu).gyro_bias))


@pytest.mark.parametrize("name", CASES)
def test_what_was_done_to_the_field_is_found(name):
    """Bounds: hard iron 1 uT, a field's direction 2 deg; the simulated sensor itself is off by 0.4 uT and 1 %."""
    matrix, iron = CASES[name]
    fit = fitted(with_compass(base(), matrix, iron))
    assert fit.sees_iron.all()
    assert fit.sees_shape
    assert fit.sees_mounting
    # the simulated sensor's own hard iron, 0.4 uT, comes on top
    assert np.abs(fit.hard_iron - 1e6 * np.array(iron)).max() < 1.5
    mended = fit.rotation @ fit.soft_iron @ matrix
    mended /= np.cbrt(np.linalg.det(mended))
    assert np.abs(mended - np.eye(3)).max() < math.radians(2.0) + 0.03  # the simulated soft iron: 1 % an element
    assert fit.after_deg < 1.0 < fit.before_deg


def test_what_a_driver_mirrors_is_mirrored_back_by_soft_iron():
    fit = fitted(with_compass(base(), MIRRORED))
    assert fit.is_mirror
    assert np.linalg.det(fit.soft_iron) < 0.0 < np.linalg.det(fit.rotation)


def test_the_written_file_gives_the_baseline_in_replay(tmp_path, capsys):
    # GIVEN a flight with iron and a turned magnetometer, calibrated from itself
    wrong = with_compass(base(), turned(90.0), (40e-6, 0.0, 0.0))
    write_recording(tmp_path / "flight", wrong)
    assert main(["calibrate", str(tmp_path / "flight"), "--out", str(tmp_path / "mag.yaml")]) == 0
    assert "agrees with the gyroscope" in capsys.readouterr().out
    text = (tmp_path / "mag.yaml").read_text()
    assert text.startswith("# Magnetometer calibration")
    assert "Standard deviations" in text
    # WHEN it is flown with the file
    p = load_parameters(tmp_path / "mag.yaml")
    mended = tell(
        wrong,
        *silence(60.0, 20.0),
        attitude__hard_iron=p.attitude.hard_iron,
        attitude__soft_iron=p.attitude.soft_iron,
        aids__magnetometer_rpy=p.aids.magnetometer_rpy,
    )
    # THEN it is as with a good compass
    usual = tell(base(), *silence(60.0, 20.0))
    inside = usual.between(79.0, 79.9)
    assert mended.when("mag.heading") == []
    assert mended.off[inside].mean() == pytest.approx(usual.off[inside].mean(), abs=1.0)


def test_columns_and_single_fields_are_calibrated_to_the_same_bits():
    p = load_parameters(None)
    assert p == Parameters()
    changed = FieldCalibration(
        Parameters(
            attitude=type(p.attitude)(hard_iron=IRON, soft_iron=tuple(SOFT.ravel().tolist())),
            aids=type(p.aids)(magnetometer_rpy=(0.1, -0.2, 1.5)),
        )
    )
    fields = np.random.default_rng(1).normal(0.0, 4e-5, (50, 3))
    columns = np.column_stack(changed.in_body(tuple(fields.T)))
    assert np.array_equal(columns, [changed.in_body(tuple(row)) for row in fields.tolist()])


# --- misuse ----------------------------------------------------------------------------------------------------------


def test_too_little_rotation_is_one_sentence(tmp_path, capsys):
    write_recording(tmp_path / "rest", flight("hover", 30.0).with_faults())
    assert main(["calibrate", str(tmp_path / "rest"), "--out", str(tmp_path / "mag.yaml")]) == 2
    error = capsys.readouterr().err
    assert "too little rotation" in error
    assert error.count("\n") == 1
    assert not (tmp_path / "mag.yaml").exists()


def test_a_recording_without_magnetometer_is_one_sentence(tmp_path, capsys):
    write_recording(tmp_path / "flight", flight("multirotor_outage", 20.0).with_faults(Stop(MagSample)))
    assert main(["calibrate", str(tmp_path / "flight"), "--out", str(tmp_path / "mag.yaml")]) == 2
    assert "has no magnetometer" in capsys.readouterr().err


def test_a_file_that_exists_is_not_replaced(tmp_path, capsys):
    (tmp_path / "mag.yaml").write_text("mine")
    assert main(["calibrate", "nowhere", "--out", str(tmp_path / "mag.yaml")]) == 2
    assert "exists already" in capsys.readouterr().err
    assert (tmp_path / "mag.yaml").read_text() == "mine"


@pytest.mark.parametrize("out", ["flight", "flight/metadata.yaml"])
def test_a_recording_is_not_replaced_by_its_calibration(tmp_path, capsys, out):
    write_recording(tmp_path / "flight", flight("hover", 10.0).with_faults())
    before = (tmp_path / "flight" / "metadata.yaml").read_bytes()
    assert main(["calibrate", str(tmp_path / "flight"), "--out", str(tmp_path / out), "--force"]) == 2
    assert "is part of the recording" in capsys.readouterr().err
    assert (tmp_path / "flight" / "metadata.yaml").read_bytes() == before


def test_gauss_is_named(tmp_path, capsys):
    write_recording(tmp_path / "flight", with_compass(base(), 1e4 * np.eye(3)))
    assert main(["calibrate", str(tmp_path / "flight"), "--out", str(tmp_path / "mag.yaml")]) == 2
    assert "is in gauss" in capsys.readouterr().err


def test_a_field_of_another_vehicle_does_not_turn_with_the_gyroscope():
    from nav_pose_estimator.offline.calibration.parameter_file import parameter_file

    recording = recorded(base())
    rests = find_rests(recording.imu)
    pairs = field_pairs(recording, rests.gyro_bias)
    rng = np.random.default_rng(2)
    shuffled = type(pairs)(rng.permutation(pairs.before), rng.permutation(pairs.after), pairs.turn, pairs.down)
    noisy = type(pairs)(
        shuffled.before + rng.normal(0, 30, (len(pairs), 3)),
        shuffled.after + rng.normal(0, 30, (len(pairs), 3)),
        pairs.turn,
        pairs.down,
    )
    with pytest.raises(UserError, match="does not turn with the gyroscope"):
        parameter_file(fit_field(noisy), noisy, rests, [recording])


# --- the IMU at rest -------------------------------------------------------------------------------------------------


def test_six_sides_show_bias_and_scale_of_the_accelerometer():
    bias, scale = np.array([0.1, -0.2, 0.05]), np.array([0.01, -0.02, 0.005])
    rng, gyro_bias, rate = np.random.default_rng(3), np.array([0.01, -0.02, 0.005]), 100
    directions = np.vstack((np.eye(3), -np.eye(3)))
    true = np.repeat(9.80665 * directions, 4 * rate, axis=0)
    accel = (1.0 + scale) * true + bias + rng.normal(0.0, 0.05, true.shape)
    gyro = gyro_bias + rng.normal(0.0, 0.002, true.shape)
    rests = find_rests(ImuBlock(np.arange(len(true), dtype=np.int64) * 10_000_000, gyro, accel))
    assert rests.gyro_bias == pytest.approx(gyro_bias, abs=1e-3)
    found = accelerometer_errors(rests.sides())
    assert found[0] == pytest.approx(bias, abs=0.02)
    assert found[1] == pytest.approx(scale, abs=0.002)
    mends = Mounting(ImuParameters(accel_bias=tuple(found[0]), accel_scale=tuple(found[1])))
    assert mends.force(tuple(accel[0])) == pytest.approx(true[0], abs=0.2)
    assert mends.force(tuple(accel[:400].mean(axis=0))) == pytest.approx(true[0], abs=0.02)


def test_a_magnetometer_that_is_too_slow_is_told():
    whole, fields = recorded(base()), 0
    samples = []
    for sample in whole.samples:
        fields += isinstance(sample, MagSample)
        if not isinstance(sample, MagSample) or fields % 20 == 0:
            samples.append(sample)
    pairs = field_pairs(Recording(Path("slow"), samples, whole.epoch_ns, 90.0), None)
    with pytest.raises(UserError, match=r"slow: only 0 pairs of fields .* the magnetometer at 5 Hz or more"):
        check(pairs, [Path("slow")])


def test_fewer_sides_show_nothing_of_the_accelerometer():
    rests = find_rests(recorded(base()).imu)
    assert rests.gyro_bias is not None
    assert accelerometer_errors(rests.sides()) is None
