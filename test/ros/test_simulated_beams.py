"""Simulated beams are published and recorded as a Doppler radar does it."""

from pathlib import Path

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import BeamVelocitySample
from nav_pose_estimator.offline.bags.reader import BagReader
from nav_pose_estimator.offline.simulated_bag import write_recording
from nav_pose_estimator.ros.messages import beams
from nav_pose_estimator.ros.messages.sample_messages import to_message
from nav_pose_estimator.sim.beam_faults import BeamsLost
from nav_pose_estimator.sim.doppler import cone
from nav_pose_estimator.sim.scenarios import generate


def test_a_sample_survives_the_way_through_a_message() -> None:
    directions = np.array(cone(4, 0.5, 0.0))
    sample = BeamVelocitySample(1_700_000_000_123_456_789, directions, np.array([1.0, np.nan, -0.5, 0.25]))
    (got,) = beams.point_cloud(to_message(sample))
    assert got.stamp_ns == sample.stamp_ns
    np.testing.assert_allclose(got.directions, directions, atol=1e-7)
    np.testing.assert_allclose(got.velocities, sample.velocities, atol=1e-7)


def test_a_bag_gives_the_beams_back(tmp_path: Path) -> None:
    recording = generate("auv_lanes", 10.0, seed=1).with_faults(BeamsLost(start=5.0, length=2.0, beams=(1,)))
    write_recording(tmp_path / "bag", recording)
    parameters = update(Parameters(), {"aids.beam_velocity_source": "pointcloud2"})
    with BagReader(tmp_path / "bag", parameters=parameters) as reader:
        got = [sample for sample in reader.samples() if isinstance(sample, BeamVelocitySample)]
    made = [timed.sample for timed in recording.others if isinstance(timed.sample, BeamVelocitySample)]
    assert [sample.stamp_ns for sample in got] == [sample.stamp_ns for sample in made]
    measured = np.array([sample.velocities for sample in made])
    assert np.isnan(measured).any()
    np.testing.assert_allclose(np.array([sample.velocities for sample in got]), measured, atol=1e-7)
    np.testing.assert_allclose(got[0].directions, made[0].directions, atol=1e-7)
