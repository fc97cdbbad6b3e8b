"""Recordings for the tests of the offline tools."""

from pathlib import Path

import pytest

from flight_bag import write_flight_bag
from small_bags import flight, write_bag


@pytest.fixture(scope="module")
def bag(tmp_path_factory) -> Path:
    """Half a minute of a simulated flight; test files with a ``bag`` of their own use that."""
    path = tmp_path_factory.mktemp("flight") / "circles_bag"
    write_flight_bag(path, 30.0, imu_hz=50.0)
    return path


@pytest.fixture(scope="session")
def mcap_bag(tmp_path_factory) -> Path:
    """Four seconds of every sensor as mcap."""
    return write_bag(tmp_path_factory.mktemp("bags") / "small", flight())
