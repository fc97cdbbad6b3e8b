"""The results of rehearsals as named arrays, for the saved state with which a process continues after a crash."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple

import numpy as np

from nav_pose_estimator.core.motion.regimes import Decisions
from nav_pose_estimator.engine.outage.rehearsal import hovered
from nav_pose_estimator.engine.outage.rehearsals import RehearsalState
from nav_pose_estimator.errors import UserError

_TABLES = ("squares", "excess")  # tables of squared errors [m^2], one row for each rehearsal, one column for each way
_HOVERING = "hover_excess"  # the same of rehearsals in which the vehicle hovered, which may reach further back
_LARGEST = 1e12  # m^2: largest plausible squared error, a thousand kilometres
_MOST = 1000  # largest plausible number of rehearsals
_DO_NOT_FIT = "its rehearsals do not fit together"


def arrays_of(state: RehearsalState) -> dict[str, np.ndarray]:
    """The results as named arrays; row i belongs to rehearsal i, NaN where it did not fly a way.

    Rehearsals in which the vehicle hovered have a table of their own.
    """
    arrays = {"surprises": np.array(state.surprises, float), "decisions": np.array(astuple(state.decisions))}
    arrays["hovering"] = np.array(len(state.hover_excess))
    for table in (*_TABLES, _HOVERING):
        outcomes = getattr(state, table)
        for way in dict.fromkeys(way for outcome in outcomes for way in outcome):
            arrays[f"{table}.{way}"] = np.array([outcome.get(way, math.nan) for outcome in outcomes])
    return arrays


def take_over(state: RehearsalState, arrays: Mapping[str, np.ndarray]) -> None:
    """Restore ``state`` from the result of ``arrays_of``. Raises ``UserError`` and changes nothing if it is invalid."""
    surprises, decisions = (np.asarray(arrays.get(name, ())) for name in ("surprises", "decisions"))
    tables = {table: _rows(arrays, table, len(surprises)) for table in _TABLES}
    known = _is_column(surprises, len(surprises)) and not np.isnan(surprises).any() and bool((surprises >= 0.0).all())
    if not (known and decisions.shape == (2,) and np.isfinite(decisions).all() and bool((decisions >= 0.0).all())):
        raise UserError(_DO_NOT_FIT)
    shown = Decisions(*decisions.tolist())
    if "hovering" in arrays:
        tables[_HOVERING] = _rows(arrays, _HOVERING, _count(np.asarray(arrays["hovering"])))
    else:  # a file of an earlier version, which does not tell which rehearsals hovered unless all of them did
        tables[_HOVERING] = tables["excess"] if hovered(shown) else []
    state.surprises.extend(surprises.tolist())
    for table, outcomes in tables.items():
        getattr(state, table).extend(outcomes)
    state.decisions = shown


def _rows(arrays: Mapping[str, np.ndarray], table: str, count: int) -> list[dict[str, float]]:
    """The ``count`` rows of ``table``, each way -> value without NaN."""
    beginning = f"{table}."
    ways = {name.removeprefix(beginning): values for name, values in arrays.items() if name.startswith(beginning)}
    if not all(_is_column(values, count) for values in ways.values()):
        raise UserError(_DO_NOT_FIT)
    rows = ({way: float(values[i]) for way, values in ways.items()} for i in range(count))
    return [{way: value for way, value in row.items() if not math.isnan(value)} for row in rows]


def _count(array: np.ndarray) -> int:
    if array.shape != () or array.dtype.kind != "i" or not 0 <= int(array) <= _MOST:
        raise UserError(_DO_NOT_FIT)
    return int(array)


def _is_column(values: np.ndarray, count: int) -> bool:
    return values.shape == (count,) and values.dtype.kind == "f" and not bool((np.abs(values) > _LARGEST).any())
