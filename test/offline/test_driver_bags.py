"""Bags of PX4 over uXRCE-DDS: types that only the bag describes, one message for position, velocity and count."""

from pathlib import Path

import numpy as np
import pytest
from rosbags.rosbag2 import StoragePlugin, Writer

from driver_types import SENSOR_COMBINED, SENSOR_GPS, STORE, make
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, SatelliteCount
from nav_pose_estimator.offline.bags.reader import BagReader
from nav_pose_estimator.offline.flights.config_file import load_parameters

EPOCH_US = 1_700_000_000_000_000


@pytest.fixture(scope="module", params=[StoragePlugin.MCAP, StoragePlugin.SQLITE3], ids=lambda p: p.name)
def px4_bag(tmp_path_factory, request) -> Path:
    path = tmp_path_factory.mktemp("px4") / "px4_bag"
    with Writer(path, version=9, storage_plugin=request.param) as writer:
        imu, gps = (
            writer.add_connection(topic, kind, typestore=STORE)
            for topic, kind in (
                ("/fmu/out/sensor_combined", SENSOR_COMBINED),
                ("/fmu/out/vehicle_gps_position", SENSOR_GPS),
            )
        )
        for i in range(400):
            t = EPOCH_US + i * 10_000
            message = make(SENSOR_COMBINED, timestamp=t, accelerometer_m_s2=np.array([0, 0, -9.8], np.float32))
            writer.write(imu, t * 1000, STORE.serialize_cdr(message, SENSOR_COMBINED))
            if i % 20 == 0:
                fix = make(
                    SENSOR_GPS, timestamp=t, latitude_deg=47.0, fix_type=3, satellites_used=11, vel_ned_valid=True
                )
                writer.write(gps, t * 1000, STORE.serialize_cdr(fix, SENSOR_GPS))
    return path


def test_one_message_plays_all_its_parts(px4_bag, repository):
    with BagReader(px4_bag) as reader:
        samples = list(reader.samples())
        assert any("config/driver_px4.yaml" in notice for notice in reader.notices)
    blocks = [s for s in samples if isinstance(s, ImuBlock)]
    assert sum(map(len, blocks)) == 400
    assert blocks[0].stamps_ns[0] == EPOCH_US * 1000
    np.testing.assert_allclose(blocks[0].accel[0], [0.0, 0.0, -9.8], rtol=1e-6)
    for kind in (GnssFix, GnssVelocity, SatelliteCount):
        assert sum(isinstance(s, kind) for s in samples) == 20, kind
    assert load_parameters(repository / "config" / "driver_px4.yaml").imu.convention == "frd"
