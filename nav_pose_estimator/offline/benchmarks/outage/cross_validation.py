"""Cross-validated selection of parameters: those for an airframe are selected on the other airframes.

Recordings of one airframe on one day, and all IMUs of one flight, are not independent, and form one group. For every
group the candidate with the best score on all other groups is selected, and only the outages of the held-out group are
reported.
"""

import math
from collections.abc import Mapping, Sequence

import numpy as np

from nav_pose_estimator.offline.benchmarks.outage.scores import energy_score
from nav_pose_estimator.offline.benchmarks.outage.statistics import ALL, Row, Summary, comparable

LEAST_OUTAGES = 8


def choose(results: Sequence[Sequence[Row]], groups: Mapping[str, str], method: str) -> dict[str, int]:
    """Index by group of the candidate with the best score of ``method`` on the other groups.

    ``results``: the outages of every candidate. With a single group, which cannot be held out, it is the first one.
    """
    table = [_scores(rows, groups, method) for rows in results]
    chosen = {}
    for held_out in dict.fromkeys(groups.values()):
        others = [_mean(scores, held_out) for scores in table]
        chosen[held_out] = int(np.argmin(others)) if np.isfinite(others).any() else 0
    return chosen


def against_classical(summaries: Sequence[Summary], method: str, length: float) -> tuple[float, float, int]:
    """RMS of ``method`` over that of each flight's best classical method: geometric mean, largest, number of flights.

    Flights with fewer than ``LEAST_OUTAGES`` outages of this length do not count.
    """
    chosen = [s for s in summaries if s.bag != ALL and s.method == method and s.length_s == length]
    ratios = [s.rms_ratio for s in chosen if s.outages >= LEAST_OUTAGES and s.rms_ratio > 0.0]
    if not ratios:
        return math.nan, math.nan, 0
    return float(np.exp(np.mean(np.log(ratios)))), max(ratios), len(ratios)


def _scores(rows: Sequence[Row], groups: Mapping[str, str], method: str) -> dict[tuple[str, float], float]:
    """Logarithm of the mean energy score of ``method`` by (group, length)."""
    values: dict[tuple[str, float], list[Row]] = {}
    for row in comparable(rows):
        if row.method == method:
            values.setdefault((groups[row.bag], row.length_s), []).append(row)
    return {key: math.log(max(_energy(members), 1e-9)) for key, members in values.items()}


def _energy(rows: Sequence[Row]) -> float:
    error, sigma = (np.array([getattr(row, name) for row in rows]) for name in ("end_error_m", "end_sigma_m"))
    return float(energy_score(error, sigma).mean())


def _mean(scores: Mapping[tuple[str, float], float], held_out: str) -> float:
    """Mean of the logarithms over the other groups and all lengths, with equal weights: that of a geometric mean."""
    others = [value for (group, _), value in scores.items() if group != held_out]
    return float(np.mean(others)) if others else math.inf
