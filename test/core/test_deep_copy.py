"""Copies of whole graphs of objects: what ``copy.deepcopy`` makes of them, but that what never changes is shared."""

from __future__ import annotations

import copy
import math
from collections import Counter, deque
from dataclasses import dataclass, field
from enum import Enum
from functools import partial
from typing import NamedTuple

import numpy as np
import pytest

from nav_pose_estimator.core.numerics.deep_copy import deep_copy, shallow_copy
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.offline.benchmarks.speed.plain_flight import samples


class Colour(Enum):
    RED = 1


class Pair(NamedTuple):
    left: float
    right: object


@dataclass(frozen=True)
class Fixed:
    value: float
    words: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class FixedArray:
    rows: np.ndarray


@dataclass(slots=True)
class Slotted:
    numbers: list[int]
    note: str = ""


class Node:
    def __init__(self) -> None:
        self.me = self
        self.act = self.method
        self.rows = np.arange(6.0).reshape(2, 3)
        self.same = self.rows
        self.history = deque([(1.0, (2.0, 3.0)), (4.0, [5.0])], maxlen=7)
        self.things = {"pair": Pair(1.0, [2]), "set": {1, 2}, Colour.RED: Slotted([1], "a"), "counter": Counter("aab")}
        self.partial = partial(max, 3)

    def method(self) -> Node:
        return self


def test_a_graph_is_copied_whole() -> None:
    """GIVEN objects that refer to each other WHEN copied THEN the copy is like them, refers to itself and is free."""
    node = Node()
    twin = deep_copy(node, {})
    assert twin.me is twin
    assert twin.act() is twin
    assert twin.same is twin.rows
    assert twin.rows is not node.rows
    assert twin.rows.tolist() == node.rows.tolist()
    assert twin.history == node.history
    assert twin.history.maxlen == 7
    assert {name: thing for name, thing in twin.things.items() if name is not Colour.RED} == {
        name: thing for name, thing in node.things.items() if name is not Colour.RED
    }
    assert twin.partial(5) == 5
    twin.history[1][1].append(6.0)
    twin.things["pair"].right.append(3)
    twin.things["counter"]["a"] += 1
    twin.things[Colour.RED].numbers.append(2)
    twin.rows[0, 0] = -1.0
    untouched = Node()
    assert node.history == untouched.history
    assert node.things == untouched.things
    assert node.rows.tolist() == untouched.rows.tolist()


def test_what_never_changes_is_shared_and_what_may_change_is_not() -> None:
    """GIVEN frozen things WHEN copied THEN those of numbers are shared, those that hold an array are not."""
    numbers, array, mixed = Fixed(1.0), FixedArray(np.zeros(2)), (1.0, [2.0])
    assert deep_copy(numbers, {}) is numbers
    assert deep_copy((numbers, 1.0), {})[0] is numbers
    assert deep_copy(array, {}).rows is not array.rows
    assert deep_copy(mixed, {})[1] is not mixed[1]


def test_what_is_known_already_is_taken() -> None:
    """GIVEN an object that stands for another WHEN what refers to that is copied THEN the copy refers to the first."""
    old, new = [1], [2]
    assert deep_copy({"a": old}, {id(old): new})["a"] is new


def test_a_shallow_copy_holds_the_same_and_changes_by_itself() -> None:
    """GIVEN an object WHEN it is copied alone THEN both hold the same things, and each has its own attributes."""
    node = Node()
    twin = shallow_copy(node)
    assert vars(twin) == vars(node)
    assert twin.rows is node.rows
    twin.rows = np.zeros(1)
    node.late = 1  # type: ignore[attr-defined]
    assert len(node.rows) == 2
    assert not hasattr(twin, "late")


@dataclass
class _Walk:
    """Two graphs side by side: whether they hold the same, and share among themselves alike."""

    partner: dict[int, int] = field(default_factory=dict)
    differences: list[str] = field(default_factory=list)
    kept: list[object] = field(default_factory=list)

    def compare(self, a: object, b: object, path: str) -> None:
        if type(a) is not type(b):
            self.differences.append(path)
            return
        if id(a) in self.partner:
            if self.partner[id(a)] != id(b) and not isinstance(a, (int, float, str, tuple)):
                self.differences.append(f"{path}: shared otherwise")
            return
        self.partner[id(a)] = id(b)
        self.kept += [a, b]
        if isinstance(a, np.ndarray):
            assert isinstance(b, np.ndarray)
            if a.tobytes() != b.tobytes() or a.strides != b.strides:
                self.differences.append(path)
        elif isinstance(a, dict):
            assert isinstance(b, dict)
            self.compare(list(a.values()), list(b.values()), f"{path}{{}}")
        elif isinstance(a, (list, tuple, deque)):
            for i, (x, y) in enumerate(zip(a, b, strict=True)):  # type: ignore[call-overload]
                self.compare(x, y, f"{path}[{i}]")
        elif hasattr(a, "__self__") and hasattr(a, "__func__"):
            self.compare(a.__self__, b.__self__, f"{path}()")  # type: ignore[attr-defined]
        elif hasattr(a, "__dict__") or hasattr(a, "__slots__"):
            for name in [*getattr(a, "__dict__", ()), *getattr(a, "__slots__", ())]:
                if hasattr(a, name):
                    self.compare(getattr(a, name), getattr(b, name), f"{path}.{name}")
        elif a != b and not (isinstance(a, float) and math.isnan(a)):
            self.differences.append(path)


@pytest.mark.parametrize("count", [3, 300])
def test_a_navigator_is_copied_as_deepcopy_copies_it(count: int) -> None:
    """GIVEN a navigator that aligns, or flies WHEN copied both ways THEN they hold and share the same."""
    engine = SinsEngine()
    for sample in samples(40.0, 50.0)[:count]:
        engine.feed(sample)
    run, journal = engine.run, Journal()
    memo = {id(run.journal): journal, id(run.parameters): run.parameters}
    walk = _Walk()
    walk.compare(copy.deepcopy(run, dict(memo)), deep_copy(run, dict(memo)), "run")
    assert len(walk.partner) > 500
    assert walk.differences == []
