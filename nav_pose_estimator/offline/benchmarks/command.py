"""``benchmark outage | attitude | alignment | beams | speed | archive``."""

import argparse
import csv
import json
import math
import sys
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict, fields
from importlib import import_module
from pathlib import Path
from typing import Any

from nav_pose_estimator.errors import UserError

PARTS = {
    "outage": "forced GNSS outages over many bags and methods",
    "attitude": "attitude errors on recorded motions with optical truth",
    "alignment": "fine alignment in simulation, by model of the measurement noise",
    "beams": "drift without GNSS while beams of a Doppler sensor fail, in simulation",
    "speed": "what everything costs on this machine",
    "archive": "what many recordings cost, and what a killed process loses",
}
OUTAGES, SUMMARY_CSV, SUMMARY_JSON, REPORT = "outages.csv", "summary.csv", "summary.json", "report.html"
PRIORS = "priors"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Options of the benchmarks."""
    parser.description = "Measure the package: drift in GNSS outages, attitude, alignment, beams, speed."
    kind = type("_Part", (_WithLateArguments, type(parser)), {})
    parts: Any = parser.add_subparsers(dest="part", required=True, metavar=f"{{{','.join(PARTS)}}}", parser_class=kind)
    for name, what in PARTS.items():
        module = f"nav_pose_estimator.offline.benchmarks.{name}.benchmark"
        add = _add_outage if name == "outage" else _options_of(module)
        parts.add_parser(name, help=what, description=what).arguments_by(add)


class _WithLateArguments(argparse.ArgumentParser):
    """Knows its arguments when it is asked to parse: a benchmark is loaded only where it is chosen."""

    def arguments_by(self, add: Callable[[argparse.ArgumentParser], None]) -> None:
        """``add`` adds them."""
        self._add: Callable[[argparse.ArgumentParser], None] | None = add

    def parse_known_args(self, args=None, namespace=None):  # type: ignore[override]
        """As always."""
        add, self._add = self._add, None
        if add is not None:
            add(self)
        return super().parse_known_args(args, namespace)


def _options_of(module: str) -> Callable[[argparse.ArgumentParser], None]:
    return lambda parser: import_module(module).add_arguments(parser)


def _add_outage(part: argparse.ArgumentParser) -> None:
    from nav_pose_estimator.offline.archive import jobs
    from nav_pose_estimator.offline.logs.options import add_options

    add = part.add_argument
    what = "bags, flight logs, folders or lists (.txt) of them, patterns; NAME.json beside NAME_bag is read"
    add("bags", nargs="+", type=Path, metavar="BAG|LOG", help=what)
    add("--lengths", default="10,30,60", metavar="S,...", help="lengths of the outages (default: 10,30,60)")
    add("--every", type=float, default=5.0, metavar="S", help="an outage starts every S seconds (default: 5)")
    add("--first", type=float, metavar="S", help="first start after the flight begins (default: 160, short flights 60)")
    add("--last", type=float, default=math.inf, metavar="S", help="last start after the flight begins (default: none)")
    add("--methods", default="best,coast,hold,const_velocity", metavar="M,...", help="methods to compare")
    add("--gnss-delay", metavar="S", help="latency of the fixes in seconds, or auto (default: NAME.json, else auto)")
    add("--config", type=Path, metavar="YAML", help="parameters, as the nodes take them")
    add("--airframe", type=Path, metavar="FILE", help="what is known before the flight: a file of train")
    add("--cross-validate", action="store_true", help="group flights by airframe: prior, selection, intervals")
    add("--groups", default="", metavar="GLOB,...", help='flights that are one group, as in "p4rtk_*,px4_3dr*"')
    add(
        "--candidates",
        type=Path,
        nargs="+",
        default=[],
        metavar="YAML",
        help="parameter files among which --cross-validate chooses for each group on the other groups",
    )
    add_options(part)
    jobs.add_options(part)
    add("--out", type=Path, default=Path("outage_benchmark"), metavar="DIR", help="folder for tables and report")


def run(arguments: argparse.Namespace) -> int:
    """Carry one of the benchmarks out."""
    if arguments.part != "outage":
        return import_module(f"nav_pose_estimator.offline.benchmarks.{arguments.part}.benchmark").run(arguments)
    from nav_pose_estimator.offline.archive.recordings import find
    from nav_pose_estimator.offline.benchmarks.outage.report import write_report
    from nav_pose_estimator.offline.benchmarks.outage.statistics import summarise
    from nav_pose_estimator.offline.flights.groups import groups_of, patterns_of
    from nav_pose_estimator.offline.logs.open_recording import check_readable
    from nav_pose_estimator.offline.output_folder import OutputFolder

    arguments.bags = find(arguments.bags)
    candidates = _candidates(arguments)
    tasks = [task for config in candidates for task in _tasks(arguments, config)]
    for bag in arguments.bags:
        if len(arguments.bags) == 1 or not bag.exists():
            check_readable(bag)  # a mistyped name ends the command now, not after an hour
    if arguments.airframe is not None:
        _note_known_flights(arguments.airframe, arguments.bags)
    inputs = [*arguments.bags, *(config for config in candidates if config is not None)]
    groups = groups_of(arguments.bags, patterns_of(arguments.groups)) if arguments.cross_validate else None
    with OutputFolder(arguments.out, "outage benchmark", inputs) as folder:
        flights = _flown(arguments, tasks, groups, folder)
        if groups is not None:
            flights = _held_out(flights, groups, candidates)
        rows = _rows(flights)
        if not rows:
            raise UserError("no outage fits into these flights: try shorter --lengths or an earlier --first")
        summaries = summarise(rows, groups=groups)
        folder.mkdir(exist_ok=True)
        _write_csv(folder / OUTAGES, [asdict(row) for row in rows])
        _write_csv(folder / SUMMARY_CSV, [asdict(s) for s in summaries])
        _write_json(folder / SUMMARY_JSON, flights, summaries, arguments)
        write_report(folder / REPORT, flights, summaries, rows)
        _print(summaries, rows)
        _print_innovations(flights)
        if groups is not None:
            _print_verdicts(summaries)
    print(f"report: {arguments.out / REPORT}")
    return 0


def _flown(arguments: argparse.Namespace, tasks: list, groups: dict[str, str] | None, folder: Path) -> list:
    """The results of all passes; where ``groups`` are held out, with priors that have not seen them."""
    from nav_pose_estimator.offline.benchmarks.outage.held_out_priors import Workers, with_held_out_priors
    from nav_pose_estimator.offline.benchmarks.outage.many_flights import run_all

    if groups is not None:
        workers = Workers(arguments.jobs, arguments.scheduler, arguments.out)
        tasks = with_held_out_priors(tasks, groups, folder / PRIORS, workers)
    return run_all(tasks, arguments.jobs, arguments.scheduler, arguments.out)


def _note_known_flights(airframe: Path, bags: list[Path]) -> None:
    """Say which flights the file was made of: what is measured on them is no test."""
    from nav_pose_estimator.engine.outage.airframe_file import load_airframe
    from nav_pose_estimator.offline.training.flights import digest_of

    known = {flight.digest for flight in load_airframe(airframe).flights}
    for bag in bags:
        if digest_of(bag) in known:
            print(
                f"note: {airframe} was made of {bag}, among others: its errors are no test of the file", file=sys.stderr
            )


def _candidates(arguments: argparse.Namespace) -> list[Path | None]:
    """The parameter files to choose from; without ``--candidates`` there is only ``--config``."""
    if not arguments.candidates:
        return [arguments.config]
    if not arguments.cross_validate or arguments.config is not None:
        raise UserError("--candidates takes the place of --config and needs --cross-validate")
    return list(arguments.candidates)


def _held_out(flights: list, groups: dict[str, str], candidates: list[Path | None]) -> list:
    """Of all passes those with the parameters that were chosen on the other groups; says what was chosen."""
    from nav_pose_estimator.offline.benchmarks.outage import cross_validation

    size = len(flights) // len(candidates)
    parts = [flights[i * size : (i + 1) * size] for i in range(len(candidates))]
    if len(candidates) == 1:
        return flights
    method = next(iter(flights[0].errors))[0] if flights[0].errors else ""
    chosen = cross_validation.choose([_rows(part) for part in parts], groups, method)
    for group, i in chosen.items():
        print(f"{group}: {candidates[i]} (chosen on the other groups)")
    return [flight for i, part in enumerate(parts) for flight in part if chosen[groups[flight.bag]] == i]


def _tasks(arguments: argparse.Namespace, config: Path | None) -> list:
    from nav_pose_estimator.offline.benchmarks.outage.benchmark import Task
    from nav_pose_estimator.offline.flights import methods
    from nav_pose_estimator.offline.flights.config_file import load_parameters
    from nav_pose_estimator.offline.flights.flight_window import FIRST_OF_SHORT
    from nav_pose_estimator.offline.logs.options import options_of

    names = methods.check([name.strip() for name in arguments.methods.split(",") if name.strip()])
    try:
        lengths = tuple(sorted({float(text) for text in arguments.lengths.split(",")}))
    except ValueError:
        raise UserError(f"--lengths {arguments.lengths!r}: write seconds separated by commas, as in 10,30,60") from None
    if not names or not all(0.0 < length < 86400.0 for length in lengths):
        raise UserError("--methods and --lengths must name at least one method and one positive length")
    if not arguments.last >= (arguments.first or 0.0):
        raise UserError("--last must not be sooner than --first")
    if not 0.0 < arguments.every < math.inf or arguments.jobs < 1:
        raise UserError("--every and --jobs must be positive")
    shared = {"lengths": lengths, "every": arguments.every, "first": arguments.first, "config": config}
    shared |= {"last": arguments.last, "airframe": arguments.airframe}
    first = FIRST_OF_SHORT if arguments.first is None else arguments.first  # no outage of any flight begins sooner
    shared["log"] = options_of(arguments, load_parameters(config).imu.max_gap, first)
    return [
        Task(
            bag=bag,
            method=name,
            predictors=extrapolated,
            gnss_delay=arguments.gnss_delay,
            **shared,
        )
        for bag in arguments.bags
        for name, extrapolated in methods.passes(names)
    ]


def _rows(flights: list) -> list:
    from nav_pose_estimator.offline.benchmarks.outage.statistics import Row

    columns = [item.name for item in fields(Row)][2:]
    return [
        Row(flight.bag, method, **{name: getattr(errors, name) for name in columns})
        for flight in flights
        for (method, _), outages in flight.errors.items()
        for errors in outages
    ]


def _write_csv(path: Path, rows: list[dict]) -> None:
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.DictWriter(file, list(rows[0]) if rows else [])
        writer.writeheader()
        for row in rows:
            writer.writerow(
                {name: f"{value:.4f}" if isinstance(value, float) else value for name, value in row.items()}
            )


def _write_json(path: Path, flights: list, summaries: list, arguments: argparse.Namespace) -> None:
    from nav_pose_estimator.offline.replay.files import plain, versions

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
        "options": {key: str(value) for key, value in vars(arguments).items() if key in ("every", "first", "lengths")},
        "versions": versions(),
    }
    path.write_text(json.dumps(plain(content), indent=1, allow_nan=False) + "\n", encoding="utf-8")


def _print(summaries: list, rows: list) -> None:
    from nav_pose_estimator.offline.benchmarks.outage.report import HEADER, table_rows

    left_out = {
        (row.bag, row.length_s, row.start_s, f"{row.status}: {row.why}" if row.why else row.status)
        for row in rows
        if row.status != "ok"
    }
    for reason, count in sorted(Counter(item[3] for item in left_out).items()):
        print(f"note: {count} outages left out for all methods ({reason})", file=sys.stderr)
    for bag, length in dict.fromkeys((s.bag, s.length_s) for s in summaries):
        table = [HEADER, *table_rows([s for s in summaries if (s.bag, s.length_s) == (bag, length)])]
        widths = [max(len(row[i]) for row in table) for i in range(len(HEADER))]
        print(f"\n{bag}, {length:g} s")
        for row in table:
            print("  ".join(text.rjust(width) for text, width in zip(row, widths, strict=True)))


def _print_innovations(flights: list) -> None:
    """Whether the filter takes from GNSS all that it says: then its innovations are white."""
    print("\nautocorrelation of GNSS innovations from one to the next, white below 0.2: position, velocity")
    for bag, white in {flight.bag: flight.white for flight in flights}.items():
        print(f"{bag}: {white[0]:.2f}, {white[1]:.2f}")


def _print_verdicts(summaries: list) -> None:
    from nav_pose_estimator.offline.benchmarks.outage.cross_validation import LEAST_OUTAGES, against_classical

    print(f"\nRMS over that of each flight's best classical method, flights with {LEAST_OUTAGES} outages or more:")
    for method, length in dict.fromkeys((s.method, s.length_s) for s in summaries):
        mean, worst, count = against_classical(summaries, method, length)
        if count:
            print(f"{method}, {length:g} s: geometric mean {mean:.2f}, worst {worst:.2f} ({count} flights)")
