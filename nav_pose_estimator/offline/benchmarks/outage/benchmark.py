"""Benchmark ``outage``: forced outages on many recordings, the same for all methods."""

import argparse
import math
import sys
from pathlib import Path

from nav_pose_estimator.engine.outage.airframe_file import load_airframe
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive import jobs
from nav_pose_estimator.offline.archive.recordings import find
from nav_pose_estimator.offline.benchmarks.outage import cross_validation, output
from nav_pose_estimator.offline.benchmarks.outage.held_out_priors import Workers, with_held_out_priors
from nav_pose_estimator.offline.benchmarks.outage.many_flights import run_all
from nav_pose_estimator.offline.benchmarks.outage.statistics import summarise
from nav_pose_estimator.offline.benchmarks.outage.trials import FlightResult, Task
from nav_pose_estimator.offline.benchmarks.tables import REPORT
from nav_pose_estimator.offline.flights import methods
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.flights.flight_window import FIRST_OF_SHORT
from nav_pose_estimator.offline.flights.groups import groups_of, patterns_of
from nav_pose_estimator.offline.logs.open_recording import check_readable
from nav_pose_estimator.offline.logs.options import add_options, options_of
from nav_pose_estimator.offline.output_folder import OutputFolder
from nav_pose_estimator.offline.training.flights import digest_of

_PRIORS = "priors"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``benchmark outage``."""
    add = parser.add_argument
    what = "bags, flight logs, folders or lists (.txt) of them, patterns; NAME.json beside NAME_bag is read"
    add("bags", nargs="+", type=Path, metavar="BAG|LOG", help=what)
    add("--lengths", default="10,30,60", metavar="S,...", help="lengths of the outages (default: 10,30,60)")
    add("--every", type=float, default=5.0, metavar="S", help="an outage starts every S seconds (default: 5)")
    add("--first", type=float, metavar="S", help="first start after the flight begins (default: 160, short flights 60)")
    add("--last", type=float, default=math.inf, metavar="S", help="last start after the flight begins (default: none)")
    add("--methods", default="best,coast,hold,const_velocity", metavar="M,...", help="methods to compare")
    add("--gnss-delay", metavar="S", help="latency of the fixes in seconds, or auto (default: NAME.json, else auto)")
    add("--config", type=Path, metavar="YAML", help="parameter file, as for the nodes")
    add("--airframe", type=Path, metavar="FILE", help="airframe file made by the command train")
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
    add_options(parser)
    jobs.add_options(parser)
    add("--out", type=Path, default=Path("outage_benchmark"), metavar="DIR", help="folder for tables and report")


def run(arguments: argparse.Namespace) -> int:
    """Run all outages with all methods, print the tables, and write them and the report."""
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
        rows = output.rows_of(flights)
        if not rows:
            raise UserError("no outage fits into these flights: try shorter --lengths or an earlier --first")
        summaries = summarise(rows, groups=groups)
        folder.mkdir(exist_ok=True)
        options = {name: str(getattr(arguments, name)) for name in ("every", "first", "lengths")}
        output.write(folder, flights, rows, summaries, options)
        output.print_summary(flights, rows, summaries)
        if groups is not None:
            output.print_verdicts(summaries)
    print(f"report: {arguments.out / REPORT}")
    return 0


def _candidates(arguments: argparse.Namespace) -> list[Path | None]:
    """The parameter files to choose from; without ``--candidates`` there is only ``--config``."""
    if not arguments.candidates:
        return [arguments.config]
    if not arguments.cross_validate or arguments.config is not None:
        raise UserError("--candidates replaces --config and needs --cross-validate")
    return list(arguments.candidates)


def _tasks(arguments: argparse.Namespace, config: Path | None) -> list[Task]:
    """A pass for every recording and estimator. Raises ``UserError`` for invalid options."""
    names = methods.check([name.strip() for name in arguments.methods.split(",") if name.strip()])
    try:
        lengths = tuple(sorted({float(text) for text in arguments.lengths.split(",")}))
    except ValueError:
        raise UserError(f"--lengths {arguments.lengths!r}: write seconds separated by commas, as in 10,30,60") from None
    if not names or not all(0.0 < length < 86400.0 for length in lengths):
        raise UserError("--methods and --lengths must name at least one method and one positive length")
    if not arguments.last >= (arguments.first or 0.0):
        raise UserError("--last must not be less than --first")
    if not 0.0 < arguments.every < math.inf or arguments.jobs < 1:
        raise UserError("--every and --jobs must be positive")
    first = FIRST_OF_SHORT if arguments.first is None else arguments.first  # no outage of any flight begins sooner
    log = options_of(arguments, load_parameters(config).imu.max_gap, first)
    return [
        Task(
            bag=bag,
            method=name,
            predictors=extrapolated,
            lengths=lengths,
            every=arguments.every,
            first=arguments.first,
            last=arguments.last,
            gnss_delay=arguments.gnss_delay,
            config=config,
            airframe=arguments.airframe,
            log=log,
        )
        for bag in arguments.bags
        for name, extrapolated in methods.passes(names)
    ]


def _note_known_flights(airframe: Path, bags: list[Path]) -> None:
    """Print which of the flights the file was made from, because results on them are not a test."""
    known = {flight.digest for flight in load_airframe(airframe).flights}
    for bag in bags:
        if digest_of(bag) in known:
            print(
                f"note: {airframe} was made of {bag}, among others: its errors are no test of the file", file=sys.stderr
            )


def _flown(
    arguments: argparse.Namespace, tasks: list[Task], groups: dict[str, str] | None, folder: Path
) -> list[FlightResult]:
    """Results of all passes; if ``groups`` are held out, with priors that were made without them."""
    if groups is not None:
        workers = Workers(arguments.jobs, arguments.scheduler, arguments.out)
        tasks = with_held_out_priors(tasks, groups, folder / _PRIORS, workers)
    return run_all(tasks, arguments.jobs, arguments.scheduler, arguments.out)


def _held_out(flights: list[FlightResult], groups: dict[str, str], candidates: list[Path | None]) -> list[FlightResult]:
    """The passes with the parameters that were chosen on the other groups; prints the choice."""
    if len(candidates) == 1:
        return flights
    size = len(flights) // len(candidates)
    parts = [flights[i * size : (i + 1) * size] for i in range(len(candidates))]
    method = next(iter(flights[0].errors))[0] if flights[0].errors else ""
    chosen = cross_validation.choose([output.rows_of(part) for part in parts], groups, method)
    for group, i in chosen.items():
        print(f"{group}: {candidates[i]} (chosen on the other groups)")
    return [flight for i, part in enumerate(parts) for flight in part if chosen[groups[flight.bag]] == i]
