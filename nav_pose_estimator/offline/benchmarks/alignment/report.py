"""Tables and plots of ``benchmark alignment``."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np

from nav_pose_estimator.offline.benchmarks.alignment.cases import CASES
from nav_pose_estimator.offline.benchmarks.alignment.summary import Summary, judged
from nav_pose_estimator.offline.benchmarks.alignment.trial import Trial
from nav_pose_estimator.offline.benchmarks.tables import markdown, number
from nav_pose_estimator.offline.page import page
from nav_pose_estimator.offline.page.svg import Plot

HEADER = [
    "receiver",
    "noise",
    "below 1 deg, s",
    "(90 %)",
    "below 5', s",
    "reached",
    "heading, deg",
    "95 %",
    "final, deg",
    "tilt, deg",
    "position, m",
    "NEES",
    "R / R0",
]
GOAL_HEADER = ["case", "receiver", "goal of innovation_adaptive", "value", "limits", ""]
_LEAST = 1e-3  # deg, of a logarithmic plot


def table_rows(summaries: list[Summary]) -> list[list[str]]:
    """Texts in the order of ``HEADER``."""
    return [
        [
            s.condition,
            s.method,
            number(s.to_1_deg_s, 0),
            number(s.to_1_deg_p90_s, 0),
            number(s.to_5_arcmin_s, 0),
            f"{100.0 * s.within_5_arcmin:.0f} %",
            number(s.heading_rms_deg, 3),
            "–" if math.isnan(s.heading_low_deg) else f"{s.heading_low_deg:.3f}-{s.heading_high_deg:.3f}",
            number(s.final_heading_deg, 3),
            number(s.tilt_rms_deg, 3),
            number(s.position_rms_m, 2),
            number(s.nees, 2),
            number(s.factor, 1),
        ]
        for s in summaries
    ]


def text_table(summaries: list[Summary]) -> str:
    """Markdown: a table for each case, then the goals."""
    blocks = []
    for case in dict.fromkeys(s.case for s in summaries):
        rows = table_rows([s for s in summaries if s.case == case])
        blocks.append(f"{case}: {CASES[case].description}\n\n{markdown(HEADER, rows)}")
    goals = judged(summaries)
    if goals:
        blocks.append(markdown(GOAL_HEADER, goals))
    return "\n\n".join(blocks) + "\n"


def write_report(path: Path, trials: list[Trial], summaries: list[Summary]) -> None:
    """Write the page: tables, goals, and the heading error over time."""
    page.write(path, "Alignment", _body(trials, summaries))


def _body(trials: list[Trial], summaries: list[Summary]) -> Iterator[str]:
    yield "<h1>Alignment</h1>"
    yield '<p class="soft">Medians over the seeds of the times after which the heading error stays below 1 degree and '
    yield "below 5 arc minutes; RMS of the second half; NEES of velocity and position per degree of freedom (1 is "
    yield "honest); R / R0: variance that the filter goes by over the stated one, at the end.</p>"
    for case in dict.fromkeys(s.case for s in summaries):
        yield f"<h2>{case}: {CASES[case].description}</h2>"
        yield page.table(HEADER, table_rows([s for s in summaries if s.case == case]), text_columns=(0, 1))
        for condition in dict.fromkeys(s.condition for s in summaries if s.case == case):
            here = [t for t in trials if (t.case, t.condition) == (case, condition)]
            if any(t.t for t in here):
                yield page.figure(_plot(here), f"{condition}: median over the seeds of the heading error.")
    goals = judged(summaries)
    if goals:
        yield "<h2>Goals</h2>" + page.table(GOAL_HEADER, goals, text_columns=(0, 1, 2, 5))


def _plot(trials: list[Trial]) -> Plot:
    plot = Plot("s", "heading error, deg", log=True)
    end = max(t.t[-1] for t in trials if t.t)
    seconds = np.arange(1.0, end)
    for style, method in zip(page.LINES, dict.fromkeys(t.method for t in trials), strict=False):
        curves = [
            np.interp(seconds, t.t, np.abs(t.heading_deg), left=180.0) for t in trials if t.method == method and t.t
        ]
        if curves:
            plot.line(seconds, np.maximum(np.median(curves, axis=0), _LEAST), style, method)
    return plot
