"""A flight log as tables: one per kind of message and instance, one column per field.

Both formats come to this form; what the fields mean in physical terms is the business of ``px4_fields`` and
``ardupilot_fields``.
"""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

Array = np.ndarray


_HALF_WINDOW = 5
_SLACK_US, _INTERVALS = 500_000, 10  # a time may lie so far from the middle of its neighbours
_LONGEST_US = 3_600_000_000


def finite(pairs: Iterable[tuple[str, object]]) -> dict[str, float]:
    """Parameters by name, without those that damage has left no numbers."""
    return {key: float(value) for key, value in pairs if isinstance(value, (int, float)) and math.isfinite(value)}


def whole_numbers(values: Array) -> Array:
    """(N,) int64; 0 for what does not fit."""
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(values) < 2.0**62, values, 0.0).astype(np.int64)


def wild(time_us: Array) -> Array:
    """(N,) bool: times [µs] that do not fit between their neighbours, as damage leaves them.

    Each is compared with the median of the eleven around it, which for rising times is the time itself.
    """
    steps = np.diff(time_us.astype(np.float64))
    if len(time_us) < 3 or ((steps >= 0.0).all() and steps.max() < _LONGEST_US):
        return np.zeros(len(time_us), bool)
    half = min(_HALF_WINDOW, (len(time_us) - 1) // 2)
    padded = np.pad(time_us.astype(np.float64), half, mode="reflect")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
    return np.abs(time_us - middle) > max(_SLACK_US, _INTERVALS * float(np.median(np.abs(steps))))


def rising(time_us: Array) -> Array:
    """(N,) bool: messages with a time that fits and is newer than those of all before them."""
    fits = (time_us > 0) & ~wild(time_us)
    newest = np.maximum.accumulate(np.where(fits, time_us, 0)) if len(time_us) else time_us
    return fits & np.concatenate([[True], time_us[1:] > newest[:-1]])[: len(time_us)]


@dataclass(frozen=True)
class Table:
    """Messages of one kind and instance in the order of the file.

    ``time_us`` (N,) int64 on the clock of the log; ``columns`` (N,) by field name, ``units`` where the log tells them.
    """

    name: str
    instance: int
    time_us: Array
    columns: dict[str, Array]
    units: dict[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time_us)

    def has(self, *names: str) -> bool:
        """True if every one of the fields is there."""
        return all(name in self.columns for name in names)

    def number(self, *names: str, default: float = np.nan) -> Array:
        """The first of the fields that exists as (N,) float64, else ``default`` throughout."""
        for name in names:
            if name in self.columns:
                with np.errstate(invalid="ignore"):  # damage may leave signalling NaNs
                    return self.columns[name].astype(np.float64)
        return np.full(len(self), default)

    def whole(self, *names: str, default: int = 0) -> Array:
        """The same as (N,) int64; what is no whole number that int64 holds becomes 0."""
        return whole_numbers(self.number(*names, default=default))

    def vector(self, *names: str) -> Array:
        """Fields side by side, (N, len(names)); one name stands for the elements ``name[0]`` to ``name[2]``."""
        if len(names) == 1:
            names = tuple(f"{names[0]}[{i}]" for i in range(3))
        return np.stack([self.number(name) for name in names], axis=-1)

    def rate(self) -> float:
        """Messages a second [Hz]: the reciprocal of the median interval; 0 for fewer than two."""
        steps = np.diff(self.time_us)
        steps = steps[steps > 0]
        return 1e6 / float(np.median(steps)) if len(steps) else 0.0

    def select(self, chosen: Array) -> "Table":
        """The messages at ``chosen`` (mask or index array)."""
        columns = {name: values[chosen] for name, values in self.columns.items()}
        return Table(self.name, self.instance, self.time_us[chosen], columns, self.units)


@dataclass
class LogTables:
    """All that was read of one log. ``names``: the kinds of messages found, for whoever misses one.

    ``notices``: what was damaged or assumed, one sentence each.
    """

    path: Path
    form: str  # "ULog" or "DataFlash"
    tables: dict[str, list[Table]]
    names: list[str]
    parameters: dict[str, float] = field(default_factory=dict)
    firmware: str = ""
    notices: list[str] = field(default_factory=list)
    counters: Counter[str] = field(default_factory=Counter)

    def instances(self, name: str) -> list[Table]:
        """The tables of one kind of message, by instance; empty if there is none."""
        return self.tables.get(name, [])

    def first(self, *names: str) -> Table | None:
        """Lowest instance of the first kind that the log holds."""
        for name in names:
            if self.instances(name):
                return self.instances(name)[0]
        return None
