"""``simulate``: what the simulator made is what a bag reader gets, and wrong use ends in one sentence."""

from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, SatelliteCount
from nav_pose_estimator.offline.bags.reader import BagReader
from nav_pose_estimator.offline.bags.writer import MCAP, SQLITE3
from nav_pose_estimator.offline.command_line import main
from nav_pose_estimator.offline.flights.recording import load
from nav_pose_estimator.offline.simulated_bag import write_recording
from nav_pose_estimator.sim.faults import NotANumber, SetCount
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import START_NS, generate
from nav_pose_estimator.sim.sensors import Gnss


@pytest.fixture(scope="module")
def recording() -> Recording:
    """Twenty seconds of a quadrotor, with a hole in its satellites and an unknown count."""
    made = generate("multirotor_light", 20.0, seed=1, imu_rate=100.0)
    return made.with_faults(SetCount(start=5.0, length=1.0, count=None), NotANumber(GnssFix, 7.0, 0.5))


def without_blocks(samples) -> list:
    """Samples with the IMU taken out and put at the front, concatenated."""
    blocks, others = [], []
    for sample in samples:
        (blocks if isinstance(sample, ImuBlock) else others).append(sample)
    columns = [np.concatenate([getattr(block, name) for block in blocks]) for name in ("stamps_ns", "gyro", "accel")]
    return [*columns, others]


@pytest.mark.parametrize("storage", [MCAP, SQLITE3])
def test_samples_survive_the_bag(tmp_path: Path, recording: Recording, storage: str) -> None:
    write_recording(tmp_path / "bag", recording, storage)
    with BagReader(tmp_path / "bag") as reader:
        stamps, gyro, accel, others = without_blocks(reader.samples())
    made_stamps, made_gyro, made_accel, made_others = without_blocks(recording.samples())
    np.testing.assert_array_equal(stamps, made_stamps)
    np.testing.assert_array_equal(gyro, made_gyro)
    np.testing.assert_array_equal(accel, made_accel)
    assert [type(sample) for sample in others] == [type(sample) for sample in made_others]
    for got, made in zip(others, made_others, strict=True):
        if isinstance(made, SatelliteCount):
            assert got.count == made.count
            continue
        assert got.stamp_ns == made.stamp_ns
        if isinstance(made, GnssFix):
            np.testing.assert_allclose((got.lat, got.lon, got.alt), (made.lat, made.lon, made.alt), rtol=1e-15)
        if isinstance(made, (GnssFix, GnssVelocity)):
            np.testing.assert_allclose(got.cov_enu, made.cov_enu)
        else:
            assert got == made


def test_receiver_without_accuracy_gives_unknown_not_zero(tmp_path: Path) -> None:
    from dataclasses import replace

    from nav_pose_estimator.sim.scenarios import find_scenario

    scenario = replace(find_scenario("at_rest"), gnss=Gnss(accuracy=False))
    write_recording(tmp_path / "bag", generate(scenario, 5.0))
    with BagReader(tmp_path / "bag") as reader:
        found = [sample for sample in reader.samples() if isinstance(sample, (GnssFix, GnssVelocity))]
    assert found
    assert all(sample.cov_enu is None for sample in found)


def test_truth_of_the_bag_is_the_truth(tmp_path: Path, recording: Recording) -> None:
    write_recording(tmp_path / "bag", recording)
    loaded = load(tmp_path / "bag")
    truth = recording.truth.at(loaded.truth.t + (loaded.epoch_ns - START_NS) * 1e-9)
    np.testing.assert_allclose(loaded.truth.position[:, 0] * 6.4e6, truth.lat * 6.4e6, atol=2e-4)
    np.testing.assert_allclose(loaded.truth.position[:, 1] * 6.4e6, truth.lon * 6.4e6, atol=2e-4)
    np.testing.assert_allclose(loaded.truth.position[:, 2], truth.alt, atol=2e-4)
    np.testing.assert_allclose(loaded.truth.velocity, truth.v_n, atol=2e-4)
    np.testing.assert_allclose(np.abs(np.sum(loaded.truth.q_nb * truth.q_nb, axis=1)), 1.0, atol=1e-7)
    assert not [notice for notice in loaded.notices if "origin" in notice]


def test_command_writes_the_bag_and_says_what(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    out = tmp_path / "new" / "bag"
    arguments = ["simulate", str(out), "--scenario", "hover", "--duration", "10", "--seed", "3", "--imu", "bmi088"]
    assert main([*arguments, "--imu-rate", "50", "--truth-rate", "5"]) == 0
    assert "hover, 10 s, IMU bmi088 at 50 Hz" in capsys.readouterr().out
    loaded = load(out)
    assert loaded.imu_count == 501
    assert len(loaded.truth) == 51


def test_list(capsys: pytest.CaptureFixture) -> None:
    assert main(["simulate", "--list"]) == 0
    text = capsys.readouterr().out
    for word in ("multirotor_outage", "road_vehicle", "icm42688", "mpu6000_calibrated"):
        assert word in text


@pytest.mark.parametrize(
    ("arguments", "text"),
    [
        (["--scenario", "multirotor_outag"], "did you mean 'multirotor_outage'"),
        (["--duration", "-3"], "-3"),
        (["--duration", "soon"], "soon"),
        (["--seed", "-1"], "seed -1 is negative"),
        (["--imu", "icm42888"], "did you mean 'icm42688'"),
        (["--truth-rate", "0"], "--truth-rate"),
        (["--storage", "csv"], "csv"),
    ],
)
def test_wrong_use_is_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture, arguments: list[str], text: str
) -> None:
    assert main(["simulate", str(tmp_path / "bag"), *arguments]) == 2
    complaint = capsys.readouterr().err
    assert text in complaint
    assert complaint.count("\n") == 1
    assert not (tmp_path / "bag").exists()


def test_existing_output_is_kept(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    arguments = ["simulate", str(tmp_path / "bag"), "--scenario", "at_rest", "--duration", "2"]
    assert main(arguments) == 0
    before = (tmp_path / "bag" / "metadata.yaml").read_bytes()
    assert main([*arguments, "--seed", "9"]) == 2
    assert "exists already" in capsys.readouterr().err
    assert (tmp_path / "bag" / "metadata.yaml").read_bytes() == before
    assert main([*arguments, "--seed", "9", "--force"]) == 0
    assert (tmp_path / "bag" / "metadata.yaml").read_bytes() != before
    assert main(["simulate"]) == 2
