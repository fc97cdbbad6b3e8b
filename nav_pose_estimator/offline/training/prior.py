"""Command ``train prior RECORDING ... --out FILE``: learns the usual motion of vehicles from many airframes."""

import argparse
import math
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np

from nav_pose_estimator import __version__
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import is_guided
from nav_pose_estimator.core.motion.regimes import Decisions, shows_hovering
from nav_pose_estimator.core.motion.usual import Shown, UsualMotion, fit_hover, fit_travel
from nav_pose_estimator.core.motion.usual_drag import fit_drag
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.outage.epochs import EpochCollector
from nav_pose_estimator.engine.outage.methods.usual_file import as_toml
from nav_pose_estimator.engine.outage.rehearsals import at_its_end
from nav_pose_estimator.engine.solutions import NavBlock, NavSolution
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive.kept import KeptResults
from nav_pose_estimator.offline.flights import latency, methods
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.flights.groups import flight_name, groups_of, patterns_of
from nav_pose_estimator.offline.logs.open_recording import open_recording, prepared
from nav_pose_estimator.offline.logs.options import options_of
from nav_pose_estimator.offline.output_file import write_whole
from nav_pose_estimator.offline.training.flights import Reading, Recorded, flown
from nav_pose_estimator.offline.training.work import find_recordings, fly_all, identify

WORD, ENDING = "prior", ".toml"
WING, ROTORS, GUIDED = "fixed_wing", "multirotor", "wheels"
"""Kinds of vehicles in the file's list of flights; for the last one nothing is learned."""
LEAST = 20.0
"""Shortest flight [s] of a recording that is used."""
_HEAD = """\
# How vehicles usually move: what a flight begins with, and what it shows replaces (docs/outages.md).
# Speeds in m/s (RMS of each axis), wander in m, times in s, rates in 1/s; activities: mean, deviation of a logarithm.
# Written by train prior of nav_pose_estimator {version}; the flights stand at the end. Every airframe counts once.
"""


@dataclass(frozen=True)
class PriorFlight:
    """One recording: aided ``epochs`` (N, COLUMNS) in flight, and the ``decisions`` of its rehearsals.

    ``is_wing``: the user states that it is a fixed wing; otherwise the kind is that of its motion.
    """

    name: str
    group: str
    digest: str
    epochs: np.ndarray
    decisions: Decisions
    is_wing: bool = False

    @property
    def seconds(self) -> float:
        """Duration of the flight [s]."""
        return len(self.epochs) * me.PERIOD


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Raises ``UserError`` for wrong options and unusable recordings."""
    paths, files = find_recordings(arguments.recordings[1:])
    if files or not paths:
        raise UserError("train prior takes recordings only, several of different airframes")
    groups = groups_of(paths, patterns_of(arguments.groups))
    left_out = [path for path in paths if _fits(path, groups[path.name], arguments.leave_out)]
    if arguments.leave_out and not left_out:
        raise UserError(f"--leave-out {arguments.leave_out}: none of the recordings has this name or group")
    log = options_of(arguments, load_parameters(arguments.config).imu.max_gap, math.inf)
    reading = Reading(arguments.config, log, arguments.gnss_delay)
    wings, kept = patterns_of(arguments.wings), KeptResults(arguments.out)
    recordings = identify([path for path in paths if path not in left_out], reading)
    flights = []
    for one in fly_all(fly, recordings, kept, arguments.jobs, arguments.scheduler):
        motion: PriorFlight = kept.load(one.key)
        flight = replace(motion, group=groups[one.path.name], is_wing=_fits_any(one.path, wings))
        if flight.seconds >= LEAST:
            flights.append(flight)
        else:
            print(f"note: {flight.name} holds {flight.seconds:.0f} s of flight: left out", file=sys.stderr)
    usual = fit(flights)
    write_whole(arguments.out, text_of(usual, flights))
    kept.forget()
    airframes = len({one.group for one in flights})
    print(f"{arguments.out}: {len(flights)} flights of {airframes} airframes; name it in learner.prior")
    return 0


def fly(recorded: Recorded) -> PriorFlight:
    """Replay a recording with GNSS and rehearsals of outages, as a flight of an airframe of its own."""
    path, reading = recorded.path, recorded.reading
    parameters = methods.apply(load_parameters(reading.config), methods.BEST)
    recording = prepared(open_recording(path, reading.log, parameters=parameters), parameters, np.inf)
    parameters, _ = latency.choose(recording, parameters, reading.gnss_delay, reading.config, np.inf, search=True)
    engine = PoseEstimator(parameters, attitude=False, rehearse=at_its_end)
    collector, found = EpochCollector(), []
    for sample in recording.samples:
        for output in engine.feed(sample):
            finished = collector.feed(output) if isinstance(output, (NavBlock, NavSolution)) else None
            if finished is not None and finished.is_good:
                found.append(finished.values)
    epochs = np.array(found).reshape(-1, me.COLUMNS)
    decisions = engine.outage_aid.rehearsals.decisions if engine.outage_aid else Decisions()
    return PriorFlight(flight_name(path), flight_name(path), recorded.digest, epochs[flown(epochs)], decisions)


def fit(flights: Sequence[PriorFlight]) -> UsualMotion:
    """Fit the mean over airframes; ``UserError`` if a kind has none."""
    shown: dict[str, list[Shown]] = {WING: [], ROTORS: [], GUIDED: []}
    for members in _airframes(flights).values():
        travelled, missed = (sum(getattr(one.decisions, name) for one in members) for name in ("travelled", "missed"))
        shown[kind_of(members)].append(Shown(tuple(one.epochs for one in members), travelled, missed))
    if not shown[ROTORS] or not shown[WING]:
        raise UserError("a prior needs flights of at least one multirotor and one fixed wing")
    rotors = shown[ROTORS]
    return UsualMotion(fit_travel(rotors), fit_travel(shown[WING]), fit_hover(rotors), fit_drag(rotors))


def kind_of(members: Sequence[PriorFlight]) -> str:
    """Kind of the airframe of these flights."""
    epochs = np.concatenate([flight.epochs for flight in members])
    if is_guided(epochs):
        return GUIDED
    return WING if any(one.is_wing for one in members) or not shows_hovering(epochs) else ROTORS


def _airframes(flights: Sequence[PriorFlight]) -> dict[str, list[PriorFlight]]:
    groups: dict[str, list[PriorFlight]] = {}
    for flight in flights:
        groups.setdefault(flight.group, []).append(flight)
    return groups


def text_of(usual: UsualMotion, flights: Sequence[PriorFlight]) -> str:
    """Text of the file: the numbers, then the list of flights."""
    lines = [_HEAD.format(version=__version__) + as_toml(usual)]
    kinds = {group: kind_of(members) for group, members in _airframes(flights).items()}
    for one in flights:
        lines += [
            "[[flights]]",
            f'name = "{one.name}"',
            f'airframe = "{one.group}"',
            f'kind = "{kinds[one.group]}"',
            f"seconds = {one.seconds:.0f}",
            f'sha256 = "{one.digest}"',
            "",
        ]
    return "\n".join(lines)


def _fits(path: Path, group: str, pattern: str) -> bool:
    return bool(pattern) and (group == pattern or _fits_any(path, [pattern]))


def _fits_any(path: Path, patterns: Sequence[str]) -> bool:
    return any(fnmatchcase(flight_name(path), pattern) for pattern in patterns)
