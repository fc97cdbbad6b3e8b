"""Tables and plots of ``benchmark attitude``."""

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from nav_pose_estimator.offline.benchmarks.attitude.row import Row
from nav_pose_estimator.offline.benchmarks.tables import markdown, percent
from nav_pose_estimator.offline.page import page
from nav_pose_estimator.offline.page.svg import Plot

HEADER = ["method", "inclination", "heading", "total", "tilt in 95 %", "heading in 95 %", "us/sample"]


def text_table(means: list[Row]) -> str:
    """The means as a Markdown table, one block per condition; the smallest inclination and total are bold."""
    blocks = []
    for condition in dict.fromkeys(row.condition for row in means):
        rows = [[_bold(cell) for cell in cells] for cells in table_rows([m for m in means if m.condition == condition])]
        blocks.append(markdown([f"{condition}, deg", *HEADER[1:]], rows))
    return "\n\n".join(blocks) + "\n"


def table_rows(rows: list[Row]) -> list[list[str]]:
    """Texts of ``rows``; a leading ``*`` marks the best inclination and the best total."""
    best = {name: min((getattr(r, name) for r in rows), default=0.0) for name in ("inclination_deg", "total_deg")}

    def degrees(row: Row, name: str) -> str:
        value = getattr(row, name)
        return ("*" if value == best.get(name) else "") + f"{value:.2f}"

    return [
        [
            row.method,
            degrees(row, "inclination_deg"),
            f"{row.heading_deg:.2f}",
            degrees(row, "total_deg"),
            percent(row.tilt_in_95),
            percent(row.heading_in_95),
            f"{row.us_per_sample:.2f}",
        ]
        for row in rows
    ]


def write_report(path: Path, rows: list[Row], means: list[Row], advance: float) -> None:
    """Write the page: means, errors by trial, and the figures of each trial."""
    page.write(path, "Attitude", _body(rows, means, advance))


def _body(rows: list[Row], means: list[Row], advance: float) -> Iterator[str]:
    yield "<h1>Attitude</h1>"
    yield '<p class="soft">RMSE in motion against optical truth, degrees; means over the trials. Inclination without, '
    yield "heading and total with magnetometer. In 95 %: share of samples whose error lies in the filter's own region."
    yield f"{f' Every estimate turned on by {1e3 * advance:g} ms.' if advance else ''}</p>"
    for condition in dict.fromkeys(row.condition for row in means):
        here = [row for row in rows if row.condition == condition]
        yield f"<h2>{condition.replace('_', ' ')}</h2>"
        yield page.table(HEADER, table_rows([m for m in means if m.condition == condition]))
        yield page.figure(_plot(here, "inclination_deg", "inclination, deg"), "Trials in order; without magnetometer.")
        yield page.figure(_plot(here, "total_deg", "total, deg"), "With magnetometer.")
        for trial in dict.fromkeys(row.trial for row in here):
            yield f"<details><summary>{trial}</summary>"
            yield page.table(HEADER, table_rows([row for row in here if row.trial == trial])) + "</details>"


def _plot(rows: list[Row], name: str, label: str) -> Plot:
    plot = Plot("trial", label, log=True, height=280)
    for style, method in zip(page.LINES, dict.fromkeys(row.method for row in rows), strict=False):
        values = [getattr(row, name) for row in rows if row.method == method]
        plot.line(np.arange(1, len(values) + 1), np.array(values), style, method)
    return plot


def _bold(cell: str) -> str:
    return f"**{cell[1:]}**" if cell.startswith("*") else cell
