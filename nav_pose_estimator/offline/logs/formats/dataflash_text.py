"""Reader of DataFlash logs as text with one message per line (``IMU, 123456, 0.01, ...``), as of ground stations.

The numbers are already scaled, with latitudes in degrees.
"""

from pathlib import Path

import numpy as np

from nav_pose_estimator.offline.logs.formats.dataflash_tables import FIELDS_OF_FMT, Format, RawMessages, build
from nav_pose_estimator.offline.logs.formats.log_tables import LogTables, whole_numbers

_TEXTS = "nNZM"  # format letters of fields that hold text; a mode is one as text
_LARGEST = 2.0**62  # largest integer
_SCALED = "cCeEL"  # to "f": the numbers are scaled already


def is_dataflash_text(head: bytes) -> bool:
    """True if a file that begins with ``head`` is a DataFlash log as text."""
    lines = head.decode("ascii", "replace").splitlines()[:50]
    return any(line.replace(" ", "").startswith("FMT,") for line in lines)


def read_dataflash_text(path: Path) -> LogTables:
    """Read a text log. Raises ``BagError`` where it holds no messages."""
    formats = {"FMT": Format("FMT", "BBnNZ", FIELDS_OF_FMT)}
    rows: dict[str, list[list[str]]] = {"FMT": []}
    places: dict[str, list[int]] = {"FMT": []}
    garbage = bad_lines = position = 0
    with path.open(encoding="ascii", errors="replace") as file:
        for line in file:
            position += len(line)
            name, _, rest = line.partition(",")
            form = formats.get(name.strip())
            if form is None:
                if line.strip():
                    garbage, bad_lines = garbage + len(line), bad_lines + 1
                continue
            if form.wanted:
                values = _split(rest, len(form.columns))
                if values is None:
                    garbage, bad_lines = garbage + len(line), bad_lines + 1
                    continue
                rows[form.name].append(values)
                places[form.name].append(position)
                if form.name == "FMT":
                    _define(formats, rows, places, values)
    messages = []
    for name, form in formats.items():
        columns, good = _columns(form, rows[name])
        messages.append(RawMessages(form, np.array(places[name], np.int64)[good], columns))
        garbage, bad_lines = garbage + int((~good).sum()), bad_lines + int((~good).sum())
    notices = [f"{bad_lines} lines of {path.name} are not messages: skipped"] if bad_lines else []
    return build(path, messages, notices, garbage)


def _split(rest: str, count: int) -> list[str] | None:
    """Fields of a line; the last one may contain commas (the columns of FMT, the text of MSG)."""
    values = [value.strip() for value in rest.split(",", max(count - 1, 0))]
    return values if len(values) == count else None


def _define(formats: dict, rows: dict, places: dict, values: list[str]) -> None:
    _, _, name, letters, columns = values
    names = tuple(column.strip() for column in columns.split(",")) if columns else ()
    if name not in formats and len(set(names)) == len(letters) and name:
        formats[name] = Format(name, "".join("f" if c in _SCALED else c for c in letters), names)
        rows[name], places[name] = [], []


def _columns(form: Format, rows: list[list[str]]) -> tuple[dict[str, np.ndarray], np.ndarray]:
    """Columns by field name, and which rows could be read (N,) bool."""
    if not rows:
        return {}, np.zeros(0, bool)
    texts = list(zip(*rows, strict=True))
    good = np.ones(len(rows), bool)
    parsed: dict[str, np.ndarray] = {}
    for name, letter, values in zip(form.columns, form.letters, texts, strict=True):
        if letter in _TEXTS:
            parsed[name] = np.array(values, dtype=object)
            continue
        numbers, fits = _numbers(values, letter)
        parsed[name], good = numbers, good & fits
    return {name: values[good] for name, values in parsed.items()}, good


def _numbers(values: tuple[str, ...], letter: str) -> tuple[np.ndarray, np.ndarray]:
    whole = letter not in "fdg"
    try:
        return np.array(values).astype(np.int64 if whole else np.float64), np.ones(len(values), bool)
    except ValueError:
        found = np.array([_number(value) for value in values])
    if whole:
        return whole_numbers(found), np.abs(found) < _LARGEST
    fits = np.isfinite(found) | np.array([value.lower() in ("nan", "-nan", "inf", "-inf") for value in values])
    return found, fits


def _number(value: str) -> float:
    try:
        return float(value)
    except ValueError:
        return float("nan")
