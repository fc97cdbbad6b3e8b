"""A flight log as tables: one per kind of message and instance, one column per field.

This form is common to both log formats; ``px4_fields`` and ``ardupilot_fields`` interpret the fields.
"""

import math
from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

Array = np.ndarray


_HALF_WINDOW = 5  # neighbours on each side of a time in the running median
_SLACK_US, _INTERVALS = 500_000, 10  # largest deviation from that median: absolute, and in median intervals
_LONGEST_US = 3_600_000_000  # largest step of a sequence that needs no test


def finite(pairs: Iterable[tuple[str, object]]) -> dict[str, float]:
    """Parameters by name, without values that are not finite numbers, as after damage."""
    return {key: float(value) for key, value in pairs if isinstance(value, (int, float)) and math.isfinite(value)}


def whole_numbers(values: Array) -> Array:
    """``values`` as (N,) int64; 0 for values out of range."""
    with np.errstate(invalid="ignore"):
        return np.where(np.abs(values) < 2.0**62, values, 0.0).astype(np.int64)


def wild(time_us: Array) -> Array:
    """Which times (N,) [µs] are outliers among their neighbours, as after damage.

    Each is compared with the median of the eleven times around it, which for ascending times is the time itself.
    """
    steps = np.diff(time_us.astype(np.float64))
    if len(time_us) < 3 or ((steps >= 0.0).all() and steps.max() < _LONGEST_US):
        return np.zeros(len(time_us), bool)
    half = min(_HALF_WINDOW, (len(time_us) - 1) // 2)
    padded = np.pad(time_us.astype(np.float64), half, mode="reflect")
    middle = np.median(np.lib.stride_tricks.sliding_window_view(padded, 2 * half + 1), axis=1)
    return np.abs(time_us - middle) > max(_SLACK_US, _INTERVALS * float(np.median(np.abs(steps))))


def rising(time_us: Array) -> Array:
    """Which messages (N,) have a time that is not an outlier and newer than all previous ones."""
    fits = (time_us > 0) & ~wild(time_us)
    newest = np.maximum.accumulate(np.where(fits, time_us, 0)) if len(time_us) else time_us
    return fits & np.concatenate([[True], time_us[1:] > newest[:-1]])[: len(time_us)]


@dataclass(frozen=True)
class Table:
    """Messages of one kind and instance in the order of the file.

    ``time_us`` (N,) int64 of the log's clock; ``columns`` (N,) and ``units``, if known, by field name.
    """

    name: str
    instance: int
    time_us: Array
    columns: dict[str, Array]
    units: dict[str, str] = field(default_factory=dict)

    def __len__(self) -> int:
        return len(self.time_us)

    def has(self, *names: str) -> bool:
        """Whether all of the fields exist."""
        return all(name in self.columns for name in names)

    def number(self, *names: str, default: float = np.nan) -> Array:
        """The first existing one of the fields as (N,) float64; ``default`` if there is none."""
        for name in names:
            if name in self.columns:
                with np.errstate(invalid="ignore"):  # damage may leave signalling NaNs
                    return self.columns[name].astype(np.float64)
        return np.full(len(self), default)

    def whole(self, *names: str, default: int = 0) -> Array:
        """The first existing one of the fields as (N,) int64; 0 for values that are not finite or out of range."""
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
    """Content of one log. ``names``: the kinds of messages in it, for error messages.

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
        """Lowest instance of the first existing kind."""
        for name in names:
            if self.instances(name):
                return self.instances(name)[0]
        return None
