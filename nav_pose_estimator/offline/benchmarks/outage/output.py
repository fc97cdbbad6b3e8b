"""Output files and printed tables of ``benchmark outage``."""

import math
import sys
from collections import Counter
from dataclasses import asdict, fields
from pathlib import Path

from nav_pose_estimator.offline.benchmarks.outage.cross_validation import LEAST_OUTAGES, against_classical
from nav_pose_estimator.offline.benchmarks.outage.report import HEADER, table_rows, write_report
from nav_pose_estimator.offline.benchmarks.outage.statistics import Row, Summary
from nav_pose_estimator.offline.benchmarks.outage.trials import FlightResult
from nav_pose_estimator.offline.benchmarks.tables import REPORT, SUMMARY_CSV, SUMMARY_JSON, write_csv
from nav_pose_estimator.offline.flights.outage_errors import OK
from nav_pose_estimator.offline.json_file import versions, write_json
from nav_pose_estimator.offline.terminal import aligned

OUTAGES = "outages.csv"


def rows_of(flights: list[FlightResult]) -> list[Row]:
    """A row for every outage and method."""
    columns = [item.name for item in fields(Row)][2:]
    return [
        Row(flight.bag, method, **{name: getattr(errors, name) for name in columns})
        for flight in flights
        for (method, _), outages in flight.errors.items()
        for errors in outages
    ]


def write(
    folder: Path, flights: list[FlightResult], rows: list[Row], summaries: list[Summary], options: dict[str, str]
) -> None:
    """Write all files; ``options``: those of the command that determine the outages."""
    write_csv(folder / OUTAGES, rows, ".4f")
    write_csv(folder / SUMMARY_CSV, summaries, ".4f")
    content = {
        "summaries": [asdict(s) for s in summaries],
        "flights": [
            {
                "bag": flight.bag,
                "methods": list(dict.fromkeys(method for method, _ in flight.errors)),
                "gnss_delay_s": flight.delay,
                "flight_window_s": flight.window,
                "innovations_lag_1": flight.white,
                "gnss_samples_checked_in_outages": flight.proof,
                "notices": flight.notices,
            }
            for flight in flights
        ],
        "options": options,
        "versions": versions(),
    }
    write_json(folder / SUMMARY_JSON, content)
    write_report(folder / REPORT, flights, summaries, rows)


def print_summary(flights: list[FlightResult], rows: list[Row], summaries: list[Summary]) -> None:
    """Print the tables, and the autocorrelation of the innovations, which are white for an optimal filter."""
    left_out = {
        (row.bag, row.length_s, row.start_s, f"{row.status}: {row.why}" if row.why else row.status)
        for row in rows
        if row.status != OK
    }
    for reason, count in sorted(Counter(item[3] for item in left_out).items()):
        print(f"note: {count} outages left out for all methods ({reason})", file=sys.stderr)
    for bag, length in dict.fromkeys((s.bag, s.length_s) for s in summaries):
        print(f"\n{bag}, {length:g} s")
        here = [s for s in summaries if (s.bag, s.length_s) == (bag, length)]
        print("\n".join(aligned([HEADER, *table_rows(here)])))
    print("\nautocorrelation of GNSS innovations from one to the next, white below 0.2: position, velocity")
    for bag, white in {flight.bag: flight.white for flight in flights}.items():
        print(f"{bag}: " + ", ".join("–" if math.isnan(value) else f"{value:.2f}" for value in white))


def print_verdicts(summaries: list[Summary]) -> None:
    """Print how every method compares with the best classical one."""
    print(f"\nRMS over that of each flight's best classical method, flights with {LEAST_OUTAGES} outages or more:")
    for method, length in dict.fromkeys((s.method, s.length_s) for s in summaries):
        mean, worst, count = against_classical(summaries, method, length)
        if count:
            print(f"{method}, {length:g} s: geometric mean {mean:.2f}, worst {worst:.2f} ({count} flights)")
