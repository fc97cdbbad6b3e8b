"""report.html of the outage benchmark: tables by length, and map and error growth of each flight."""

import math
from collections.abc import Iterator
from html import escape
from pathlib import Path

import numpy as np

from nav_pose_estimator.offline.benchmarks.outage.scores import probability
from nav_pose_estimator.offline.benchmarks.outage.statistics import ALL, Row, Summary, comparable
from nav_pose_estimator.offline.benchmarks.outage.trials import GRID, FlightResult
from nav_pose_estimator.offline.benchmarks.tables import number, percent
from nav_pose_estimator.offline.flights.methods import classical
from nav_pose_estimator.offline.page import page
from nav_pose_estimator.offline.page.svg import Plot

HEADER = [
    "method",
    "n",
    "median m",
    "95 % interval",
    "rms m",
    "90 % m",
    "max m",
    "in 3 sigma",
    "err/sigma",
    "ratio",
    "wins",
    "1, 2 sigma",
    "log score",
    "energy m",
]


def write_report(path: Path, flights: list[FlightResult], summaries: list[Summary], rows: list[Row]) -> None:
    """Write the page."""
    page.write(path, "GNSS outages", _body(flights, summaries, rows))


def table_rows(summaries: list[Summary]) -> list[list[str]]:
    """The summaries of one flight and length as texts; the smallest median and RMS are marked as best."""
    if not summaries:
        return []
    best = {name: min(getattr(s, name) for s in summaries) for name in ("median_m", "rms_m")}
    return [
        [
            s.method,
            str(s.outages),
            ("*" if s.median_m == best["median_m"] else "") + number(s.median_m),
            f"{number(s.median_low_m)} to {number(s.median_high_m)}",
            ("*" if s.rms_m == best["rms_m"] else "") + number(s.rms_m),
            number(s.p90_m),
            number(s.max_m),
            percent(s.within_3_sigma),
            number(s.error_over_sigma, 2),
            number(s.rms_ratio, 2),
            percent(s.win_rate),
            f"{percent(s.within_1_sigma)}, {percent(s.within_2_sigma)}",
            number(s.log_score, 2),
            number(s.energy_score_m),
        ]
        for s in summaries
    ]


def _body(flights: list[FlightResult], summaries: list[Summary], rows: list[Row]) -> Iterator[str]:
    yield "<h1>GNSS outages</h1>"
    yield '<p class="soft">Horizontal error at the end of forced outages, mean over the fixes of the last 1.05 s, '
    yield "against ground truth or the withheld GNSS. Interval: bootstrap of the median, clustered by flight, within "
    yield "one flight by stretches of an outage's length. Ratio and wins: RMS and single outages against the best "
    yield f"classical method of that flight ({', '.join(classical())}). Scores (log, energy) "
    yield "are of the stated distribution; less is better. An honest sigma has 63, 98 and 100 % within 1, 2 and 3 "
    yield "sigma and a median of error / sigma of 0.83.</p>"
    rows = comparable(rows)
    yield from _reliability(rows)
    names = [flight.bag for flight in flights]
    bags = list(dict.fromkeys(names))
    for bag in ([ALL] if len(bags) > 1 else []) + bags:
        yield f"<h2>{escape('All flights' if bag == ALL else bag)}</h2>"
        if bag != ALL:
            yield from _flight([flight for flight in flights if flight.bag == bag])
            if len(bags) > 1:  # else it stands above
                yield from _reliability([row for row in rows if row.bag == bag])
        for length in sorted({s.length_s for s in summaries if s.bag == bag}):
            chosen = [s for s in summaries if s.bag == bag and s.length_s == length]
            yield f"<p><b>{length:g} s</b></p>" + page.table(HEADER, table_rows(chosen))


def _reliability(rows: list[Row]) -> Iterator[str]:
    """Reliability of each method with a sigma over all outages: stated probability and observed frequency."""
    plot = Plot("stated probability", "share of outages", height=320, y_range=(0.0, 1.0))
    plot.line(np.array([0.0, 1.0]), np.array([0.0, 1.0]), "f dash")
    styles, drawn = iter(page.LINES), False
    for method in dict.fromkeys(row.method for row in rows):
        pairs = np.array([(row.end_error_m, row.end_sigma_m) for row in rows if row.method == method])
        pairs = pairs[pairs[:, 1] > 0.0]
        if len(pairs):
            stated = np.sort(probability(pairs[:, 0], pairs[:, 1]))
            plot.line(stated, np.arange(1, len(stated) + 1) / len(stated), next(styles, "f"), method)
            drawn = True
    if drawn:
        yield page.figure(plot, "Share of errors within the stated probability; on the diagonal sigma is honest.")


def _flight(passes: list[FlightResult]) -> Iterator[str]:
    first = passes[0]
    begin, end = first.window
    yield f'<p class="soft">Flight from {begin:.0f} to {end:.0f} s, GNSS latency {first.delay:.3f} s. '
    yield f"{sum(p.proof for p in passes)} GNSS samples passed the door of an estimator in an outage, none of them "
    yield "valid inside it. Autocorrelation of GNSS innovations from one to the next, position and velocity: "
    yield f"{number(first.white[0], 2)} and {number(first.white[1], 2)} (white: below 0.2).</p>"
    growth = {method: curves for flight in passes for method, curves in flight.growth.items()}
    if growth:
        yield page.figure(_growth(growth), "Median horizontal error; band: 25 to 75 % of the outages, first method.")
    if len(first.path):
        yield page.figure(_map(first), "Dots: where the outages begin.")


def _growth(growth: dict[str, np.ndarray]) -> Plot:
    plot = Plot("s since GNSS was lost", "horizontal error, m", height=320, log=True)
    for (method, curves), style in zip(growth.items(), page.LINES, strict=False):
        seen = np.isfinite(curves).sum(axis=0) >= max(1, len(curves) // 4)
        if not seen.any():
            continue
        t = np.arange(curves.shape[1])[seen] * GRID
        low, middle, high = np.nanpercentile(curves[:, seen], [25, 50, 75], axis=0)
        if style == page.LINES[0]:
            plot.band(t, low, high, style)
        plot.line(t, middle, style, method)
    return plot


def _map(flight: FlightResult) -> Plot:
    plot = Plot("East, m", "North, m", height=420, equal=True)
    plot.line(flight.path[:, 0], flight.path[:, 1], "f", thinned=False)
    for east, north in flight.starts.tolist():
        if math.isfinite(east):
            plot.mark(east, north, "dot")
    return plot
