"""What rehearsals have shown as named arrays: a process that dies in flight leaves it to the next one."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import astuple

import numpy as np

from nav_pose_estimator.core.motion.regimes import Decisions
from nav_pose_estimator.engine.outage.rehearsals import RehearsalState
from nav_pose_estimator.errors import UserError

_TABLES = ("squares", "excess")  # lists of way -> squared error [m^2]
_LARGEST = 1e12  # m^2: a thousand kilometres


def arrays_of(state: RehearsalState) -> dict[str, np.ndarray]:
    """Row i of every array belongs to rehearsal i, NaN where a way was not flown."""
    arrays = {"surprises": np.array(state.surprises, float), "decisions": np.array(astuple(state.decisions))}
    for table in _TABLES:
        outcomes = getattr(state, table)
        for way in dict.fromkeys(way for outcome in outcomes for way in outcome):
            arrays[f"{table}.{way}"] = np.array([outcome.get(way, math.nan) for outcome in outcomes])
    return arrays


def take_over(state: RehearsalState, arrays: Mapping[str, np.ndarray]) -> None:
    """Restore ``state`` from what ``arrays_of`` gave. ``UserError`` if it is invalid; then nothing is changed."""
    surprises, decisions = (np.asarray(arrays.get(name, ())) for name in ("surprises", "decisions"))
    columns = {tuple(name.split(".", 1)): values for name, values in arrays.items() if "." in name}
    tables = {}
    for table in _TABLES:
        ways = {way: values for (of, way), values in columns.items() if of == table}
        if not all(_is_column(values, len(surprises)) for values in ways.values()):
            raise UserError("its rehearsals do not fit together")
        rows = ({way: float(values[i]) for way, values in ways.items()} for i in range(len(surprises)))
        tables[table] = [{way: value for way, value in row.items() if not math.isnan(value)} for row in rows]
    known = _is_column(surprises, len(surprises)) and not np.isnan(surprises).any() and bool((surprises >= 0.0).all())
    if not (known and decisions.shape == (2,) and np.isfinite(decisions).all() and bool((decisions >= 0.0).all())):
        raise UserError("its rehearsals do not fit together")
    state.surprises.extend(surprises.tolist())
    for table, outcomes in tables.items():
        getattr(state, table).extend(outcomes)
    state.decisions = Decisions(*decisions.tolist())


def _is_column(values: np.ndarray, count: int) -> bool:
    return values.shape == (count,) and values.dtype.kind == "f" and not bool((np.abs(values) > _LARGEST).any())
