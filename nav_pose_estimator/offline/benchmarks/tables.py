"""What the benchmarks have in common: the words of an option, and tables in files."""

import csv
from collections.abc import Collection, Sequence
from dataclasses import fields
from pathlib import Path
from typing import Any

from nav_pose_estimator.errors import UserError

TRIALS, SUMMARY_CSV, SUMMARY_JSON, REPORT = "trials.csv", "summary.csv", "summary.json", "report.html"


def chosen(text: str, known: tuple[str, ...], option: str) -> tuple[str, ...]:
    """The names of an option's ``text``, each once; all that are ``known`` for the word all. Raises ``UserError``."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if names == ("all",):
        return known
    if not names or not set(names) <= set(known):
        raise UserError(f"{option} {text!r}: there are {', '.join(known)}, or all")
    return names


def write_csv(path: Path, rows: Sequence[Any], form: str, left_out: Collection[str] = ()) -> None:
    """``rows`` of one dataclass; ``form`` of its floats, as in ``.4f``; ``left_out``: what does not fit into a cell."""
    names = [item.name for item in fields(rows[0]) if item.name not in left_out] if rows else []
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(names)
        for row in rows:
            values = [getattr(row, name) for name in names]
            writer.writerow([format(value, form) if isinstance(value, float) else value for value in values])


def markdown(header: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    """A table as Markdown."""
    lines = [header, ["---"] * len(header), *rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)
