"""Command ``train RECORDING ... --out NAME.airframe``: learns from past flights of an aircraft.

``train prior`` learns from flights of many airframes.
"""

import argparse
import math
import os
import sys
from collections.abc import Sequence
from pathlib import Path

from nav_pose_estimator.core.motion.airframe import FORMS, Airframe
from nav_pose_estimator.core.motion.vehicle_class import CLASSES, MULTIROTOR
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive import jobs
from nav_pose_estimator.offline.logs.options import add_options, options_of
from nav_pose_estimator.offline.output_file import check_new

DESCRIPTION = (
    "Learn from recorded flights of an aircraft, or of others like it, what helps in the first minutes of the next. "
    "Prints what the file would have been worth to each of the flights, left out of it. "
    "train prior RECORDING ... --out FILE: how vehicles usually move, from flights of many airframes."
)


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options of ``train``."""
    parser.description = DESCRIPTION
    parser.add_argument(
        "recordings",
        nargs="+",
        metavar="RECORDING",
        help="bags, PX4 .ulg, ArduPilot .bin; folders, patterns and lists of them; .airframe files to merge",
    )
    add = parser.add_argument
    add("--out", type=Path, required=True, metavar="FILE", help="file to write, NAME.airframe")
    add("--class", dest="vehicle_class", choices=CLASSES, help="class of the vehicles (default: by their motion)")
    add("--one-aircraft", action="store_true", help="all flights are of the aircraft that will fly with the file")
    add("--network", action="store_true", help="also train a network (make train-setup)")
    add("--form", choices=FORMS, default=FORMS[0], help="output of the network for a second (default: velocity)")
    add("--steps", type=int, default=2500, metavar="N", help="steps of each training (default: 2500)")
    add("--folds", type=int, default=4, metavar="N", help="networks trained without a part of the flights (default: 4)")
    add("--gnss-delay", metavar="S", help="latency of the fixes in seconds, or auto (default: NAME.json, else auto)")
    add("--config", type=Path, metavar="YAML", help="parameter file, as for the nodes")
    add_options(parser)
    add(
        "--groups", default="", metavar="GLOB,...", help='of a prior: flights of one airframe, as in "p4rtk_*,px4_3dr*"'
    )
    add("--wings", default="", metavar="GLOB,...", help="of a prior: fixed wings that a start by hand or taxiing hides")
    add("--leave-out", default="", metavar="NAME", help="of a prior: flight, pattern or airframe not to learn from")
    jobs.add_options(parser)
    add("--force", action="store_true", help="replace an existing file")


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises ``UserError`` for wrong options, unusable recordings and unwritable outputs."""
    from nav_pose_estimator.offline.training import prior

    if arguments.recordings[0] == prior.WORD:
        _check(arguments, prior.ENDING)
        return prior.run(arguments)
    from nav_pose_estimator.engine.outage.airframe_file import save_airframe
    from nav_pose_estimator.offline.archive.kept import KeptResults
    from nav_pose_estimator.offline.flights.config_file import load_parameters
    from nav_pose_estimator.offline.training import network, work
    from nav_pose_estimator.offline.training.airframe import Order, make_airframe
    from nav_pose_estimator.offline.training.flights import Reading, fly

    _check(arguments, work.AIRFRAME)
    if arguments.network:
        network.check_available()
    log = options_of(arguments, load_parameters(arguments.config).imu.max_gap, math.inf)
    reading = Reading(arguments.config, log, arguments.gnss_delay)
    recordings, files = work.find_recordings(arguments.recordings)
    if os.path.realpath(arguments.out) in [os.path.realpath(path) for path in files]:
        raise UserError(f"{arguments.out} is one of the files to learn from; choose another name for --out")
    merged = work.load_files(files)
    kept = KeptResults(arguments.out)
    flown = work.fly_all(fly, work.identify(recordings, reading), kept, arguments.jobs, arguments.scheduler)
    order = Order(
        vehicle_class=arguments.vehicle_class,
        is_one_aircraft=arguments.one_aircraft,
        form=arguments.form if arguments.network else None,
        steps=arguments.steps,
        folds=arguments.folds,
    )
    airframe, lines = make_airframe(kept, [one.key for one in flown], merged, order)
    save_airframe(arguments.out, airframe)
    kept.forget()
    _report(arguments.out, airframe, lines)
    return 0


def _report(out: Path, airframe: Airframe, lines: Sequence[str]) -> None:
    for line in lines:
        print(line)
    if airframe.vehicle_class == MULTIROTOR and not airframe.is_one_aircraft:
        print(
            "note: frames and propellers of multirotors differ too much, so that nothing but the class of this file is "
            "used in flight: give --one-aircraft if the one that flies with it is the one of these flights",
            file=sys.stderr,
        )
    count, minutes = len(airframe.flights), airframe.archive.seconds / 60.0
    if count == 1:
        print(
            "note: with one flight nothing shows what the file is worth to another one: add more flights, or try it "
            "with benchmark outage --airframe",
            file=sys.stderr,
        )
    print(
        f"{out}: {airframe.vehicle_class}, {count} flight{'s' if count > 1 else ''}, {minutes:.0f} minutes"
        f"{', with a network' if airframe.network else ''}; name it in learner.airframe"
    )


def _check(arguments: argparse.Namespace, ending: str) -> None:
    out = arguments.out
    if out.suffix != ending:
        raise UserError(f"--out {out}: the name of the file must end in {ending}")
    check_new(out, arguments.force)
    if arguments.jobs < 1 or arguments.steps < 1 or arguments.folds < 2:
        raise UserError("--jobs and --steps must be at least 1, --folds at least 2")
