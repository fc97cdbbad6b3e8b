"""Common functions of the benchmarks: names in an option, and tables in files."""

import csv
import math
from collections.abc import Collection, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from nav_pose_estimator.errors import UserError

TRIALS, SUMMARY_CSV, SUMMARY_JSON, REPORT = "trials.csv", "summary.csv", "summary.json", "report.html"


def chosen(text: str, known: tuple[str, ...], option: str) -> tuple[str, ...]:
    """Names in an option's ``text``, each once, or all ``known`` ones for "all". Raises ``UserError`` for others."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if names == ("all",):
        return known
    if not names or not set(names) <= set(known):
        raise UserError(f"{option} {text!r}: there are {', '.join(known)}, or all")
    return names


def write_csv(path: Path, rows: Sequence[Any], form: str, left_out: Collection[str] = ()) -> None:
    """Write ``rows`` of one dataclass; ``form``: format of floats, such as ``.4f``; ``left_out``: omitted fields."""
    names = [item.name for item in fields(rows[0]) if item.name not in left_out] if rows else []
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for row in rows:
            values = [getattr(row, name) for name in names]
            writer.writerow([format(value, form) if isinstance(value, float) else value for value in values])


def number(value: float, digits: int = 1) -> str:
    """A number for a cell; a dash where it is unknown, "never" for a time that did not come."""
    if math.isnan(value):
        return "–"
    return "never" if math.isinf(value) else f"{value:.{digits}f}"


def percent(share: float, digits: int = 0) -> str:
    """A share for a cell, in per cent; a dash where it is unknown."""
    return "–" if math.isnan(share) else f"{100.0 * share:.{digits}f} %"


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table as Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
