"""Rehearsals of outages in flight: the same result whatever the pieces in which the samples come."""

import pickle

import numpy as np
import pytest

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.outage.filter_bank import COAST
from nav_pose_estimator.engine.outage.rehearsal import Epoch, packed, unpacked
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import BodyVelocity, ImuBlock, PressureSample, joined
from nav_pose_estimator.offline.benchmarks.speed.plain_flight import samples
from pieces import one_by_one

SECONDS = 70.0  # a rehearsal begins after 20 s of aided flight and takes 30 s


@pytest.fixture(scope="module")
def flight() -> list:
    return samples(SECONDS, 100.0)


def test_rehearsal_does_not_depend_on_the_size_of_the_pieces(flight):
    # GIVEN a flight with magnetometer and GNSS between the IMU samples
    # WHEN it comes in blocks, as in a replay, and sample by sample, as in the node
    estimators = PoseEstimator(Parameters()), PoseEstimator(Parameters())
    for estimator, pieces in zip(estimators, (flight, one_by_one(flight)), strict=True):
        for sample in pieces:
            estimator.feed(sample)
    # THEN the same rehearsals have been flown, to the last bit
    blocks, singles = (estimator.outage_aid.rehearsals for estimator in estimators)
    assert blocks.count == singles.count >= 1
    assert blocks.rms(COAST) == singles.rms(COAST)
    assert blocks.rms("regimes") == singles.rms("regimes") is not None


def test_samples_and_blocks_join_to_one_block(flight):
    blocks = [sample for sample in flight if isinstance(sample, ImuBlock)][:3]
    whole = joined(blocks)
    for parts in (one_by_one(blocks), [*one_by_one(blocks[:1]), *blocks[1:]], [whole]):
        again = joined(parts)
        assert again.stamps_ns.tolist() == whole.stamps_ns.tolist()
        assert again.gyro.tolist() == whole.gyro.tolist()
        assert again.accel.tolist() == whole.accel.tolist()


def test_packed_epochs_are_the_same_epochs(flight):
    # GIVEN epochs with and without samples of the IMU and of other sensors
    blocks = [sample for sample in flight if isinstance(sample, ImuBlock)][:3]
    others = [PressureSample(5, 95e3), BodyVelocity(7, (1.0, 2.0, 3.0), np.eye(3))]
    epochs = [Epoch(blocks[0], others, None), Epoch(None, others[:1], (1.0, 2.0)), Epoch(blocks[1], [], (3.0, 4.0))]
    # WHEN they are packed for another process and unpacked there
    found = unpacked(pickle.loads(pickle.dumps(packed(epochs))))
    # THEN nothing is lost, and each has its own samples of the IMU
    assert [(repr(one.others), one.velocity) for one in found] == [(repr(one.others), one.velocity) for one in epochs]
    for one, epoch in zip(found, epochs, strict=True):
        assert (one.imu is None) == (epoch.imu is None)
        if epoch.imu is not None:
            for name in ("stamps_ns", "gyro", "accel"):
                np.testing.assert_array_equal(getattr(one.imu, name), getattr(epoch.imu, name))
    assert unpacked(packed([Epoch(None, [], None)])) == [Epoch(None, [], None)]
