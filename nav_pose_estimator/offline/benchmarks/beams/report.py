"""Tables of ``benchmark beams``, as text and as a page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from nav_pose_estimator.offline.benchmarks.beams.cases import CASES
from nav_pose_estimator.offline.benchmarks.beams.methods import METHODS
from nav_pose_estimator.offline.benchmarks.beams.summary import Summary
from nav_pose_estimator.offline.benchmarks.tables import markdown, number, percent
from nav_pose_estimator.offline.page import page

DETAIL = ["fault", "method", "median, %", "RMS, %", "velocity, m/s", "heading, deg", "mounting, deg", "NEES",
          "healthy refused", "faulty refused"]  # fmt: skip
GOAL_HEADER = ["case", "fault", "goal", "value", "limits", ""]
_NOTE = (
    "Horizontal error at the end in % of the distance travelled without GNSS, median / RMS over the seeds; velocity in "
    "3-D outside total loss; NEES of horizontal velocity and position per degree of freedom (1 is honest); shares of "
    "sound beam velocities and of those wrong by more than five deviations that were refused."
)


def text_tables(summaries: list[Summary], goals: list[list[str]]) -> str:
    """Markdown: for each case faults by methods, then the details, then the goals."""
    blocks = []
    for case, rows in _by_case(summaries):
        blocks.append(f"{case}: {CASES[case].description}\n\n{markdown(*overview(rows))}")
        blocks.append(markdown(DETAIL, details(rows)))
    if goals:
        blocks.append(markdown(GOAL_HEADER, goals))
    return "\n\n".join(blocks) + "\n"


def overview(rows: list[Summary]) -> tuple[list[str], list[list[str]]]:
    """Header and lines: faults by methods, median / RMS in %."""
    methods = list(dict.fromkeys(s.method for s in rows))
    found = {(s.fault, s.method): f"{s.percent_median:.3f} / {s.percent_rms:.3f}" for s in rows}
    faults = dict.fromkeys(s.fault for s in rows)
    return ["fault", *methods], [[fault, *(found.get((fault, m), "–") for m in methods)] for fault in faults]


def details(rows: list[Summary]) -> list[list[str]]:
    """Texts in the order of ``DETAIL``."""
    return [
        [
            s.fault,
            s.method,
            number(s.percent_median, 3),
            number(s.percent_rms, 3),
            number(s.velocity_rms, 4),
            number(s.heading_rms_deg, 2),
            number(s.mounting_rms_deg, 2),
            number(s.nees, 2),
            percent(s.refused_healthy, 1),
            percent(s.refused_faulty, 1),
        ]
        for s in rows
    ]


def write_report(path: Path, summaries: list[Summary], goals: list[list[str]]) -> None:
    """Write the page with the same tables."""
    page.write(path, "Beam velocities", _body(summaries, goals))


def _body(summaries: list[Summary], goals: list[list[str]]) -> Iterator[str]:
    yield f'<h1>Beam velocities</h1><p class="soft">{_NOTE}</p>'
    yield "<ul>" + "".join(f"<li>{name}: {method.description}</li>" for name, method in METHODS.items()) + "</ul>"
    for case, rows in _by_case(summaries):
        yield f"<h2>{case}: {CASES[case].description}</h2>"
        yield page.table(*overview(rows), text_columns=(0,))
        yield page.table(DETAIL, details(rows), text_columns=(0, 1))
    if goals:
        yield "<h2>Goals</h2>" + page.table(GOAL_HEADER, goals, text_columns=(0, 1, 2, 4, 5))


def _by_case(summaries: list[Summary]) -> Iterator[tuple[str, list[Summary]]]:
    for case in dict.fromkeys(s.case for s in summaries):
        yield case, [s for s in summaries if s.case == case]
