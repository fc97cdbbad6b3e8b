"""From single trials to a table, and the goals of the recommended method."""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.offline.benchmarks.beams.cases import ALLOWANCE, GOALS, MOUNTING_GOALS, USUAL_LENGTH
from nav_pose_estimator.offline.benchmarks.beams.methods import RECOMMENDED
from nav_pose_estimator.offline.benchmarks.beams.trial import Trial
from nav_pose_estimator.offline.benchmarks.outage.statistics import rms


@dataclass(frozen=True)
class Summary:
    """One method on one case with one fault, over the seeds."""

    case: str
    fault: str
    method: str
    trials: int
    percent_median: float
    percent_rms: float
    velocity_rms: float  # m/s
    heading_rms_deg: float
    mounting_rms_deg: float
    nees: float  # median
    refused_healthy: float  # mean
    refused_faulty: float


def summarise(trials: Iterable[Trial]) -> list[Summary]:
    """A row for every case, fault and method."""
    groups: dict[tuple[str, str, str], list[Trial]] = {}
    for trial in trials:
        groups.setdefault((trial.case, trial.fault, trial.method), []).append(trial)
    return [_summary(names, members) for names, members in groups.items()]


def _summary(names: tuple[str, str, str], trials: list[Trial]) -> Summary:
    def values(name: str) -> np.ndarray:
        return np.array([getattr(trial, name) for trial in trials])

    def mean(name: str) -> float:
        known = values(name)[np.isfinite(values(name))]
        return float(known.mean()) if len(known) else math.nan

    return Summary(
        *names,
        trials=len(trials),
        percent_median=float(np.median(values("percent"))),
        percent_rms=rms(values("percent")),
        velocity_rms=rms(values("velocity_rms")),
        heading_rms_deg=rms(values("heading_deg")),
        mounting_rms_deg=rms(values("mounting_deg")),
        nees=float(np.median(values("nees"))),
        refused_healthy=mean("refused_healthy"),
        refused_faulty=mean("refused_faulty"),
    )


def judged(summaries: list[Summary], length: float = USUAL_LENGTH, is_turned: bool = False) -> list[list[str]]:
    """A row for every goal that can be judged: case, fault, what, value, limits, met or missed.

    ``length`` [s] without GNSS; ``is_turned``: the mounting of the sensor differs from the parameters.
    """
    rows, goals, allowance = [], GOALS.get(length, {}), ALLOWANCE if is_turned else 1.0
    for s in summaries:
        goal = goals.get((s.case, s.fault))
        if s.method != RECOMMENDED or goal is None:
            continue
        checks = [
            ("median, %", s.percent_median, 0.0, allowance * goal.median),
            ("RMS, %", s.percent_rms, 0.0, allowance * goal.rms),
            ("NEES", s.nees, 0.5, 1.8),
        ]
        if math.isfinite(goal.velocity):
            checks.append(("velocity, m/s", s.velocity_rms, 0.0, goal.velocity))
        if is_turned:
            checks.append(("mounting, deg", s.mounting_rms_deg, 0.0, MOUNTING_GOALS[s.case]))
        if s.fault == "none":
            checks.append(("healthy refused", s.refused_healthy, 0.0, 0.003))
        elif math.isfinite(s.refused_faulty):
            checks.append(("faulty refused", s.refused_faulty, 0.97, 1.0))
        for what, value, least, most in checks:
            met = "met" if least <= value <= most else "missed"
            rows.append([s.case, s.fault, what, f"{value:.3g}", f"{least:g} to {most:g}", met])
    return rows
