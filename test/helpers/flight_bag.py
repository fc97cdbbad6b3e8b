"""A short flight by formulas as a bag."""

from pathlib import Path

from nav_pose_estimator.offline.benchmarks.speed.flight_messages import write_samples
from nav_pose_estimator.offline.benchmarks.speed.plain_flight import samples


def write_flight_bag(path: Path, seconds: float, imu_hz: float) -> None:
    """Write ``seconds`` [s] of ``plain_flight`` with 5 Hz of GNSS as a rosbag2 (mcap)."""
    write_samples(path, samples(seconds, imu_hz, gnss_hz=5.0))
