"""Common part of binary and text DataFlash: the messages that are read, their times, instances and units."""

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.logs.formats.log_tables import LogTables, Table, finite, wild

Array = np.ndarray
FIELDS_OF_FMT = ("Type", "Length", "Name", "Format", "Columns")
# field with the instance by kind of message, in newer firmware
INSTANCE_FIELDS = {
    "IMU": "I",
    "GPS": "I",
    "GPA": "I",
    "MAG": "I",
    "BARO": "I",
    "ARSP": "I",
    "RFND": "Instance",
    "XKF1": "C",
    "NKF1": "C",
    "EKF1": "",
    "ATT": "",
    "ORGN": "Type",
    "EV": "",
    "ARM": "",
    "VIBE": "IMU",
}
# (kind, instance) by name of the message, in older firmware
NUMBERED = {f"{name}{i}": (name, i - 1) for name in ("IMU", "GPS", "GPA", "MAG") for i in (2, 3)}
NUMBERED |= {"BAR2": ("BARO", 1), "BAR3": ("BARO", 2), "ASP2": ("ARSP", 1)}
DESCRIPTIONS = ("FMT", "FMTU", "UNIT", "MULT", "PARM", "MSG")
_SCALED_BY_LETTER = "cCeEL"  # the multiplier that FMTU gives for these is the one that the letter has applied already
_RESTART_US = 5_000_000  # step back of the time that counts as a restart, and the gap that is put in its place


@dataclass(frozen=True)
class Format:
    """One FMT message: name, format letters and field names of a kind of message."""

    name: str
    letters: str
    columns: tuple[str, ...]

    @property
    def wanted(self) -> bool:
        """Whether messages of this kind are read."""
        return self.name in INSTANCE_FIELDS or self.name in NUMBERED or self.name in DESCRIPTIONS


@dataclass(frozen=True)
class RawMessages:
    """All messages of one kind: positions in the file (N,), ascending, and columns (N,) by field name."""

    form: Format
    places: Array
    columns: dict[str, Array]


def build(path: Path, messages: list[RawMessages], notices: list[str], garbage: int) -> LogTables:
    """Tables with times and instances. Raises ``BagError`` where the file holds no message but its own description."""
    known = {m.form.name: m for m in messages}
    names = sorted(known.keys() - set(DESCRIPTIONS))
    if not names:
        raise BagError(f"{path} holds no DataFlash messages: it is empty, cut off, or not an ArduPilot log")
    clock = _Clock([m for m in messages if len(m.places)])
    if clock.restarts:
        times = "once" if clock.restarts == 1 else f"{clock.restarts} times"
        notices.append(f"the clock of {path.name} restarted {times}: what follows is appended to what came before")
    units = _Units(known)
    tables: dict[str, list[Table]] = {}
    for item in messages:
        name, instance = NUMBERED.get(item.form.name, (item.form.name, 0))
        if name in INSTANCE_FIELDS and len(item.places):
            tables.setdefault(name, []).extend(_tables(item, name, instance, clock, units))
    for found in tables.values():
        found.sort(key=lambda table: table.instance)
    texts = [_text(value) for value in known["MSG"].columns.get("Message", [])] if "MSG" in known else []
    firmware = next((text for text in texts if text.startswith(("Ardu", "APM:", "Blimp", "Rover"))), "ArduPilot")
    return LogTables(
        path=path,
        form="DataFlash",
        tables=tables,
        names=names,
        parameters=_parameters(known),
        firmware=firmware,
        notices=notices,
        counters=Counter({"log.garbage_bytes": garbage} if garbage else {}),
    )


def _tables(item: RawMessages, name: str, instance: int, clock: "_Clock", units: "_Units") -> list[Table]:
    """One table for each instance in ``item``."""
    columns, labels = units.in_si(item)
    table = Table(name, instance, clock.times(item), columns, labels)
    marker = INSTANCE_FIELDS[name]
    if not marker or marker not in columns:
        return [table]
    which = columns[marker].astype(np.int64)
    return [
        Table(name, number, part.time_us, part.columns, labels)
        for number in np.unique(which).tolist()
        for part in (table.select(which == number),)
    ]


class _Clock:
    """Times of messages: their own, else that of the previous message with a time in the file."""

    def __init__(self, messages: list[RawMessages]) -> None:
        timed = [(m.places, own) for m in messages if (own := _own_times(m)) is not None]
        places = np.concatenate([p for p, _ in timed] or [np.empty(0, np.int64)])
        times = np.concatenate([t for _, t in timed] or [np.empty(0, np.int64)])
        order = np.argsort(places, kind="stable")
        places, times = places[order], times[order]
        sound = ~wild(times)
        self._places, times = places[sound], times[sound]
        fell = np.flatnonzero(np.diff(times) < -_RESTART_US) + 1
        self.restarts = len(fell)
        shifts = np.zeros(len(times), np.int64)
        for i in fell.tolist():
            shifts[i:] += times[i - 1] - times[i] + _RESTART_US
        self._times, self._shifts = times + shifts, shifts

    def times(self, item: RawMessages) -> Array:
        """Times (N,) int64 [µs] of the messages of ``item``."""
        if not len(self._places):
            return np.zeros(len(item.places), np.int64)
        before = np.clip(np.searchsorted(self._places, item.places, side="right") - 1, 0, None)
        own = _own_times(item)
        return self._times[before] if own is None else own + self._shifts[before]


def _own_times(item: RawMessages) -> Array | None:
    """Times [µs] in the messages themselves, None if there are none.

    In old GPS messages TimeMS is the GNSS time of week; the time of the log's clock is then T, if it is logged.
    """
    columns = item.columns
    if "TimeUS" in columns:
        return columns["TimeUS"].astype(np.int64)
    if NUMBERED.get(item.form.name, (item.form.name,))[0] == "GPS":
        return columns["T"].astype(np.int64) * 1000 if "T" in columns else None
    return columns["TimeMS"].astype(np.int64) * 1000 if "TimeMS" in columns else None


class _Units:
    """Units and multipliers by the messages UNIT, MULT and FMTU, which firmware has written since 2017."""

    def __init__(self, known: dict[str, RawMessages]) -> None:
        self._labels = {_letter(i): _text(text) for i, text in _pairs(known.get("UNIT"), "Id", "Label")}
        self._factors = {_letter(i): float(factor) for i, factor in _pairs(known.get("MULT"), "Id", "Mult")}
        rows = known.get("FMTU")
        self._of_type: dict[int, tuple[str, str]] = {}
        if rows is not None and {"FmtType", "UnitIds", "MultIds"} <= rows.columns.keys():
            parts = (rows.columns[name] for name in ("FmtType", "UnitIds", "MultIds"))
            self._of_type = {int(kind): (_text(u), _text(m)) for kind, u, m in zip(*parts, strict=True)}
        fmt = known.get("FMT")
        self._types = {_text(name): int(kind) for kind, name in _pairs(fmt, "Type", "Name")}

    def in_si(self, item: RawMessages) -> tuple[dict[str, Array], dict[str, str]]:
        """Columns multiplied by the factors of FMTU, except times, and the labels of their units."""
        units, factors = self._of_type.get(self._types.get(item.form.name, -1), ("", ""))
        columns, labels = dict(item.columns), {}
        for name, letter, unit, mark in zip(item.form.columns, item.form.letters, units, factors, strict=False):
            labels[name] = self._labels.get(unit, "")
            factor = self._factors.get(mark, 0.0)
            if labels[name] in _SCALED_UNITS and letter not in _SCALED_BY_LETTER and factor not in (0.0, 1.0):
                columns[name] = columns[name].astype(np.float64) * factor
            elif labels[name] in _SCALED_UNITS and factor == 0.0:
                del labels[name]  # without a multiplier the unit is ambiguous, and that of the documentation is used
        return columns, labels


_SCALED_UNITS = ("Gauss", "m", "m/s", "Pa", "rad/s", "deg", "deg/s", "m/s/s")


def _pairs(item: RawMessages | None, *names: str) -> list[tuple]:
    if item is None or not set(names) <= item.columns.keys():
        return []
    return list(zip(*(item.columns[name].tolist() for name in names), strict=True))


def _letter(number: int) -> str:
    return chr(int(number) & 0x7F)


def _parameters(known: dict[str, RawMessages]) -> dict[str, float]:
    """Last logged values of the parameters by name."""
    return finite((_text(name), value) for name, value in _pairs(known.get("PARM"), "Name", "Value"))


def _text(value: object) -> str:
    """A string of the log without unprintable characters."""
    text = value.decode("ascii", "replace") if isinstance(value, bytes) else str(value)
    return "".join(c for c in text.split("\0")[0] if c.isprintable()).strip()
