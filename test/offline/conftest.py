"""Recordings for the tests of the offline tools."""

from pathlib import Path

import pytest

from small_bags import flight, write_bag


@pytest.fixture(scope="session")
def mcap_bag(tmp_path_factory) -> Path:
    """Four seconds of every sensor as mcap."""
    return write_bag(tmp_path_factory.mktemp("bags") / "small", flight())
