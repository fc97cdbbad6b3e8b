"""Clouds of beams are byte for byte what rosbags serializes one by one."""

import numpy as np

from nav_pose_estimator.offline.bags.cdr_packing import typestore
from nav_pose_estimator.offline.bags.point_clouds import KIND, pack_beams

STAMPS = [1_700_000_000_123_456_789, 5]


def test_clouds_read_back_and_serialize_to_the_same_bytes() -> None:
    directions = np.random.default_rng(1).standard_normal((2, 3, 3))
    velocities = np.array([[1.0, np.nan, -2.5], [0.0, 3.0, 1e-3]])
    rows = pack_beams(STAMPS, directions, velocities, "dvl_link")
    for i, row in enumerate(rows):
        cloud = typestore().deserialize_cdr(row.tobytes(), KIND)
        assert bytes(typestore().serialize_cdr(cloud, KIND)) == row.tobytes()
        assert cloud.header.stamp.sec * 1_000_000_000 + cloud.header.stamp.nanosec == STAMPS[i]
        assert cloud.header.frame_id == "dvl_link"
        assert (cloud.height, cloud.width, cloud.point_step, cloud.row_step) == (1, 3, 16, 48)
        assert [(f.name, f.offset, f.datatype, f.count) for f in cloud.fields] == [
            ("x", 0, 7, 1),
            ("y", 4, 7, 1),
            ("z", 8, 7, 1),
            ("velocity", 12, 7, 1),
        ]
        points = cloud.data.view("<f4").reshape(3, 4)
        np.testing.assert_array_equal(points[:, :3], directions[i].astype(np.float32))
        np.testing.assert_array_equal(points[:, 3], velocities[i].astype(np.float32))
