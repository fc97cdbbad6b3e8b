"""A few minutes of the endurance run (benchmarks/endurance.py), and that its plan of failures is complete and fixed."""

import importlib.util
import sys
from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest

from nav_pose_estimator.sim.fault_plans import KINDS, SENSORS, random_plan


@pytest.fixture(scope="module")
def endurance(repository: Path):
    """The benchmark as a module."""
    spec = importlib.util.spec_from_file_location("endurance", repository / "benchmarks" / "endurance.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules["endurance"] = module
    spec.loader.exec_module(module)
    yield module
    del sys.modules["endurance"]


def test_a_plan_is_fixed_by_its_seed_and_has_every_failure_once_before_any_twice() -> None:
    plan = random_plan(3, 3600.0)
    assert plan == random_plan(3, 3600.0)
    assert plan != random_plan(4, 3600.0)
    first = plan[: len(SENSORS) * len(KINDS)]
    assert set(Counter((item.sensor, item.kind) for item in first).values()) == {1}
    starts = [item.fault.start for item in plan]
    assert all(50.0 < b - a < 70.0 for a, b in pairwise(starts))


@pytest.mark.compiled
def test_six_minutes_with_a_failure_each(endurance) -> None:
    """GIVEN a flight WHEN a sensor fails every minute THEN nothing raises, every output is finite, sigma holds,
    and after each failure the navigator is good again."""
    one = endurance.run(450.0, seed=2)
    assert len(one.outcomes) >= 5
    assert one.not_finite == 0
    assert all(outcome.recovered for outcome in one.outcomes), one.outcomes
    assert one.honest > 0.9
    assert one.megabytes[-1] - one.megabytes[2] < 30.0
