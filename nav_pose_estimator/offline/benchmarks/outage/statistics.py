"""Statistics of the outages: medians with confidence intervals, consistency, and comparison of the methods."""

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.offline.benchmarks.outage.scores import energy_score, log_score
from nav_pose_estimator.offline.flights.methods import classical
from nav_pose_estimator.offline.flights.outage_errors import OK

RESAMPLES = 2000
CONFIDENCE = 0.95
ALL = "all"


@dataclass(frozen=True)
class Row:
    """One outage of one method."""

    bag: str
    method: str
    length_s: float
    start_s: float
    end_error_m: float
    rms_error_m: float
    max_error_m: float
    end_vertical_m: float
    end_sigma_m: float
    travelled_m: float
    status: str
    why: str = ""


@dataclass(frozen=True)
class Summary:
    """A method on one flight, or on all of them (``bag`` "all"), at one outage length."""

    bag: str
    method: str
    length_s: float
    outages: int
    median_m: float
    median_low_m: float
    median_high_m: float
    rms_m: float
    p90_m: float
    max_m: float
    within_3_sigma: float
    error_over_sigma: float
    best_classical: str
    rms_ratio: float
    win_rate: float
    within_1_sigma: float
    within_2_sigma: float
    log_score: float
    energy_score_m: float


def comparable(rows: Iterable[Row]) -> list[Row]:
    """Rows of the outages with results of all methods, so that all are evaluated on the same ones."""
    rows = list(rows)
    spoiled = {(row.bag, row.length_s, row.start_s) for row in rows if row.status != OK}
    return [row for row in rows if (row.bag, row.length_s, row.start_s) not in spoiled]


def summarise(rows: Iterable[Row], seed: int = 1, groups: Mapping[str, str] | None = None) -> list[Summary]:
    """A summary of every method, length and flight, then of all flights together if there are several.

    ``groups``: clusters (airframes) of flights for the confidence intervals; by default each flight is a cluster.
    """
    rows = comparable(rows)
    bags = list(dict.fromkeys(row.bag for row in rows))
    tables = [(bag, [row for row in rows if row.bag == bag]) for bag in bags]
    if len(bags) > 1:
        tables.append((ALL, rows))
    out = []
    for bag, members in tables:
        for length in sorted({row.length_s for row in members}):
            out += _compare(bag, length, [row for row in members if row.length_s == length], seed, groups or {})
    return out


def _compare(bag: str, length: float, rows: list[Row], seed: int, groups: Mapping[str, str]) -> list[Summary]:
    methods = list(dict.fromkeys(row.method for row in rows))
    by_method = {method: [row for row in rows if row.method == method] for method in methods}
    rivals = {m: rms([row.end_error_m for row in r]) for m, r in by_method.items() if m in classical()}
    best = min(rivals, key=lambda method: rivals[method]) if rivals else ""
    interval = {m: bootstrap(_errors(r), clusters(r, groups), np.median, seed) for m, r in by_method.items()}
    return [
        _summary(bag, method, length, by_method[method], interval[method], best, by_method.get(best, []))
        for method in methods
    ]


def _errors(rows: list[Row]) -> np.ndarray:
    return np.array([row.end_error_m for row in rows])


def _summary(
    bag: str,
    method: str,
    length: float,
    rows: list[Row],
    interval: tuple[float, float],
    best: str,
    rival: list[Row],
) -> Summary:
    errors = _errors(rows)
    sigma = np.array([row.end_sigma_m for row in rows])
    known = np.isfinite(sigma) & (sigma > 0.0)
    error, sigma = errors[known], sigma[known]
    other = {(row.bag, row.start_s): row.end_error_m for row in rival}
    pairs = [(row.end_error_m, other[row.bag, row.start_s]) for row in rows if (row.bag, row.start_s) in other]
    return Summary(
        bag=bag,
        method=method,
        length_s=length,
        outages=len(rows),
        median_m=float(np.median(errors)),
        median_low_m=interval[0],
        median_high_m=interval[1],
        rms_m=rms(errors),
        p90_m=float(np.percentile(errors, 90)),
        max_m=float(errors.max()),
        within_3_sigma=_mean(error <= 3.0 * sigma),
        error_over_sigma=float(np.median(error / sigma)) if known.any() else math.nan,
        best_classical=best,
        rms_ratio=rms(errors) / rms([b for _, b in pairs]) if pairs else math.nan,
        win_rate=_mean([(a < b) + 0.5 * (a == b) for a, b in pairs]),
        within_1_sigma=_mean(error <= sigma),
        within_2_sigma=_mean(error <= 2.0 * sigma),
        log_score=_mean(log_score(error, sigma)),
        energy_score_m=_mean(energy_score(error, sigma)),
    )


def clusters(rows: list[Row], groups: Mapping[str, str] | None = None) -> np.ndarray:
    """Cluster of each outage (N,): its flight or group if there are several, else its interval of one outage length.

    Overlapping outages have correlated errors; treating them as independent would make the interval too narrow.
    """
    bags = list(dict.fromkeys(row.bag for row in rows))
    if len(bags) > 1:
        names = [(groups or {}).get(row.bag, row.bag) for row in rows]
        return np.unique(names, return_inverse=True)[1]
    first = min(row.start_s for row in rows)
    return np.array([int((row.start_s - first) / row.length_s + 1e-9) for row in rows])


def bootstrap(
    values: np.ndarray, cluster: np.ndarray, statistic: Callable[[np.ndarray], float], seed: int
) -> tuple[float, float]:
    """Percentile interval of ``statistic`` when whole clusters are drawn with replacement (Efron 1979).

    NaN with fewer than two clusters, because one flight does not reveal the variation between flights.
    """
    members = [values[cluster == c] for c in np.unique(cluster)]
    if len(members) < 2:
        return math.nan, math.nan
    rng = np.random.default_rng(seed)
    draws = rng.integers(0, len(members), (RESAMPLES, len(members)))
    found = [statistic(np.concatenate([members[i] for i in draw])) for draw in draws]
    tail = 50.0 * (1.0 - CONFIDENCE)
    low, high = np.percentile(found, [tail, 100.0 - tail])
    return float(low), float(high)


def rms(values) -> float:
    """Root of the mean square; NaN for no values."""
    values = np.asarray(values, float)
    return float(np.sqrt(np.mean(values**2))) if len(values) else math.nan


def _mean(values) -> float:
    values = np.asarray(values, float)
    return float(values.mean()) if len(values) else math.nan
