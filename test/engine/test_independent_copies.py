"""Copies of a whole estimator: nothing that changes is shared, and a new attribute is copied without another line."""

import dataclasses
from collections import Counter, deque
from collections.abc import Iterator
from enum import Enum
from types import MethodType
from typing import Any

import numpy as np
import pytest

from nav_pose_estimator.core.alignment.aligner import Aligner
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.navigator.past import Past
from nav_pose_estimator.engine.outage.methods.method import OutageMethod
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, SatelliteCount
from nav_pose_estimator.sim.faults import Stop
from nav_pose_estimator.sim.scenarios import generate

SHARED = (type, Enum, Aligner, Past, OutageMethod)
"""What copies may share: an aligner that has finished, a past that nobody writes to, methods, which have no state."""


@pytest.fixture(scope="module")
def flown() -> PoseEstimator:
    """An estimator in an outage, its filter split into branches."""
    recording = generate("multirotor_light", duration=50.0, seed=1, imu_rate=50.0)
    lost = (Stop(kind, start=45.0, length=10.0) for kind in (GnssFix, GnssVelocity, SatelliteCount))
    engine = PoseEstimator()
    for sample in recording.with_faults(*lost).samples():
        engine.feed(sample)
    assert engine.sins.run.timeline.filter.branches is not None
    return engine


def held(value: Any) -> Iterator[Any]:
    """What an object holds itself."""
    if isinstance(value, dict):
        yield from value.values()
    elif isinstance(value, (list, tuple, set, deque)):
        yield from value
    elif isinstance(value, MethodType):
        yield value.__self__
    elif not isinstance(value, np.ndarray):
        yield from getattr(value, "__dict__", {}).values()
        yield from (getattr(value, name) for name in getattr(type(value), "__slots__", ()) if hasattr(value, name))


def parts(root: Any) -> dict[int, Any]:
    """By identity all that is reachable from ``root`` but for what is shared on purpose and what never changes."""
    found: dict[int, Any] = {}
    queue = [root]
    while queue:
        value = queue.pop()
        frozen = dataclasses.is_dataclass(value) and type(value).__dataclass_params__.frozen
        if not (id(value) in found or frozen or isinstance(value, SHARED)):
            found[id(value)] = value
            queue += held(value)
    return found


def may_change(value: Any) -> bool:
    if isinstance(value, np.ndarray):
        return bool(value.flags.writeable)
    if isinstance(value, tuple) or (callable(value) and not hasattr(value, "__self__")):
        return False
    return (
        isinstance(value, (list, dict, set, deque)) or hasattr(value, "__dict__") or hasattr(type(value), "__slots__")
    )


def test_a_copy_shares_nothing_that_changes(flown: PoseEstimator) -> None:
    """GIVEN an estimator in an outage WHEN copied THEN original and copy have no changeable object in common."""
    copied = flown.snapshot()
    for original, twin in ((flown.sins, copied.sins), (flown.outage_aid, copied.outage_aid)):
        mine, others = parts(original), parts(twin)
        assert len(others) > 50
        assert [type(value) for key, value in mine.items() if key in others and may_change(value)] == []


def test_a_new_attribute_of_any_part_of_the_navigator_is_copied(flown: PoseEstimator) -> None:
    """GIVEN one more list in every object of the run WHEN copied THEN each copy has a list of its own."""
    run = flown.sins.run
    growing = [value for value in parts(run).values() if hasattr(value, "__dict__") and value is not run.journal]
    growing = [value for value in growing if not isinstance(value, (MethodType, Counter))]
    for value in growing:
        value.added = [[2.0]]
    twins = [value for value in parts(flown.snapshot().sins.run).values() if hasattr(value, "added")]
    for value in growing:
        value.added[0].append(3.0)
    assert len(growing) > 50
    assert sorted(type(value).__name__ for value in twins) == sorted(type(value).__name__ for value in growing)
    assert all(value.added == [[2.0]] for value in twins)
