"""Summary of the alignments, and the goals of the innovation-adaptive noise."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.offline.benchmarks.alignment.trial import Trial
from nav_pose_estimator.offline.benchmarks.outage.statistics import bootstrap, rms


@dataclass(frozen=True)
class Summary:
    """Results of one method in one case and condition; a trial that never settled counts as infinite or failed."""

    case: str
    condition: str
    method: str
    trials: int
    to_1_deg_s: float  # median
    to_1_deg_p90_s: float
    to_5_arcmin_s: float  # median
    within_5_arcmin: float  # share of the trials
    heading_rms_deg: float
    heading_low_deg: float  # 95 % interval over the seeds
    heading_high_deg: float
    final_heading_deg: float  # RMS
    tilt_rms_deg: float
    position_rms_m: float
    nees: float  # median over the seeds
    factor: float  # median


def summarise(trials: Iterable[Trial]) -> list[Summary]:
    """A row for every case, condition and method."""
    groups: dict[tuple[str, str, str], list[Trial]] = {}
    for trial in trials:
        groups.setdefault((trial.case, trial.condition, trial.method), []).append(trial)
    return [_summary(names, members) for names, members in groups.items()]


def _summary(names: tuple[str, str, str], trials: list[Trial]) -> Summary:
    def values(name: str) -> np.ndarray:
        """Values of all trials; infinite for a trial without a second half, which never started."""
        found = np.array([getattr(trial, name) for trial in trials])
        return np.where(np.isnan(found), math.inf, found)

    heading = values("heading_rms_deg")
    low, high = math.nan, math.nan
    if np.isfinite(heading).all():
        low, high = bootstrap(heading, np.arange(len(trials)), rms, seed=1)
    return Summary(
        *names,
        trials=len(trials),
        to_1_deg_s=float(np.median(values("to_1_deg_s"))),
        to_1_deg_p90_s=float(np.quantile(values("to_1_deg_s"), 0.9, method="inverted_cdf")),
        to_5_arcmin_s=float(np.median(values("to_5_arcmin_s"))),
        within_5_arcmin=float(np.isfinite(values("to_5_arcmin_s")).mean()),
        heading_rms_deg=rms(heading),
        heading_low_deg=low,
        heading_high_deg=high,
        final_heading_deg=rms(values("final_heading_deg")),
        tilt_rms_deg=rms(values("tilt_rms_deg")),
        position_rms_m=rms(values("position_rms_m")),
        nees=float(np.median(values("nees"))),
        factor=float(np.median(values("factor"))),
    )


@dataclass(frozen=True)
class Goal:
    """Goal of ``innovation_adaptive``: ``value`` of its summary (and of that of ``fixed``) is within the limits."""

    what: str
    case: str
    conditions: tuple[str, ...]
    value: Callable[[Summary, Summary], float]
    at_least: float
    at_most: float


_LASTING = ("white", "x10 for 30 s", "x10 for a fifth", "states x0.32")
_DRONE = ("white", "x10 for 30 s", "10 % outliers x10", "x3 from half-way", "states x0.32")
GOALS = (
    Goal("below 1 deg, median [s]", "ship", _LASTING, lambda s, _: s.to_1_deg_s, 0.0, 300.0),
    Goal("below 1 deg, 90 % of the seeds [s]", "ship", _LASTING, lambda s, _: s.to_1_deg_p90_s, 0.0, 390.0),
    Goal("below 5 arc minutes in 1200 s, share", "ship", _LASTING, lambda s, _: s.within_5_arcmin, 0.95, 1.0),
    Goal("final heading RMS [deg]", "ship", _LASTING, lambda s, _: s.final_heading_deg, 0.0, 0.055),
    Goal("NEES per degree of freedom", "ship", _LASTING, lambda s, _: s.nees, 0.7, 1.8),
    Goal("heading RMS over that of fixed", "drone", _DRONE, lambda s, f: _ratio(s, f, "heading_rms_deg"), 0.0, 1.15),
    Goal("NEES per degree of freedom", "drone", _DRONE, lambda s, _: s.nees, 0.5, 1.3),
    Goal("position RMS [m]", "drone", ("x3 from half-way",), lambda s, _: s.position_rms_m, 0.0, 0.92),
    Goal(
        "heading RMS over that of fixed",
        "drone",
        ("correlated 30 s",),
        lambda s, f: _ratio(s, f, "heading_rms_deg"),
        0.0,
        1.03,
    ),
    Goal(
        "position RMS over that of fixed",
        "drone",
        ("correlated 30 s",),
        lambda s, f: _ratio(s, f, "position_rms_m"),
        0.0,
        1.03,
    ),
)


def judged(summaries: list[Summary]) -> list[list[str]]:
    """A row for every goal that can be judged: case, condition, what, value, limits, met or missed."""
    table = {(s.case, s.condition, s.method): s for s in summaries}
    rows = []
    for goal in GOALS:
        for condition in goal.conditions:
            adaptive = table.get((goal.case, condition, "innovation_adaptive"))
            fixed = table.get((goal.case, condition, "fixed"))
            if adaptive is None or fixed is None:
                continue
            value = goal.value(adaptive, fixed)
            met = "met" if goal.at_least <= value <= goal.at_most else "missed"
            limits = f"{goal.at_least:g} to {goal.at_most:g}"
            rows.append([goal.case, condition, goal.what, f"{value:.3g}", limits, met])
    return rows


def _ratio(one: Summary, other: Summary, name: str) -> float:
    value, reference = getattr(one, name), getattr(other, name)
    return value / reference if math.isfinite(reference) else 0.0
