"""Priors of motion without the evaluated group, so that no flight is evaluated with what was learned from it.

The statistics of every recording are collected once, by one aided flight with rehearsals; the fits without one group
each are fast. The rehearsals use the full prior, so that a held-out group has still contributed, by one part in the
number of airframes, to the statistics of wrong decisions of other flights. A group that the prior was not made from
uses the full prior.
"""

import hashlib
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from nav_pose_estimator.engine.outage.methods.usual_file import KnownFlight, flights_of
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive.kept import KeptResults
from nav_pose_estimator.offline.benchmarks.outage.trials import Task
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.training.flights import Reading, Recorded, digest_of
from nav_pose_estimator.offline.training.prior import LEAST, WING, PriorFlight, fit, fly, text_of
from nav_pose_estimator.offline.training.work import fly_all


@dataclass(frozen=True)
class Workers:
    """``processes`` of this machine, or a Dask ``scheduler``. Results are stored beside ``out`` meanwhile."""

    processes: int
    scheduler: str
    out: Path


def with_held_out_priors(
    tasks: Sequence[Task], groups: Mapping[str, str], folder: Path, workers: Workers
) -> list[Task]:
    """The tasks, each with the file of a prior without its group in ``folder``; prints which groups are held out."""
    found: list[Task] = []
    for config in dict.fromkeys(task.config for task in tasks):
        members = [task for task in tasks if task.config == config]
        known = flights_of(load_parameters(config).learner.prior)
        recordings = [_recorded(task) for task in {task.bag: task for task in members}.values()]
        seen = seen_groups({one: groups[one.path.name] for one in recordings}, known)
        flights = list(_flown(recordings, groups, known, workers)) if seen else []
        files = {group: file for group in seen if (file := _file_without(group, flights, folder)) is not None}
        found += [replace(task, prior=files.get(groups[task.bag.name])) for task in members]
    return found


def seen_groups(groups: Mapping[Recorded, str], known: Sequence[KnownFlight]) -> list[str]:
    """Groups of the recordings that the prior of the ``known`` flights was made from."""
    airframes, digests = {one.airframe for one in known}, {one.digest for one in known}
    return list(dict.fromkeys(g for one, g in groups.items() if g in airframes or one.digest in digests))


def _recorded(task: Task) -> Recorded:
    return Recorded(task.bag, digest_of(task.bag), Reading(task.config, task.log, task.gnss_delay))


def _flown(
    recordings: Sequence[Recorded], groups: Mapping[str, str], known: Sequence[KnownFlight], workers: Workers
) -> Iterator[PriorFlight]:
    """Yield the motion of every recording that contains enough of it, with its kind as in the existing prior."""
    wings = {one.digest for one in known if one.kind == WING}
    kept = KeptResults(workers.out)
    for one in fly_all(fly, recordings, kept, workers.processes, workers.scheduler):
        flown: PriorFlight = kept.load(one.key)
        flight = replace(flown, group=groups[one.path.name], is_wing=one.digest in wings)
        if flight.seconds >= LEAST:
            yield flight


def _file_without(group: str, flights: Sequence[PriorFlight], folder: Path) -> Path | None:
    """Write the prior of all other groups to a file with its digest in the name, for the resumption of a run."""
    others = [flight for flight in flights if flight.group != group]
    try:
        text = text_of(fit(others), others)
    except UserError:
        print(
            f"note: the prior was made of {group}, too, and the other recordings are too few to make another "
            "(it takes a multirotor and a fixed wing): its figures are no test of the prior",
            file=sys.stderr,
        )
        return None
    name = re.sub(r"\W+", "_", group).strip("_")
    path = folder / f"without_{name}_{hashlib.sha256(text.encode()).hexdigest()[:8]}.toml"
    folder.mkdir(parents=True, exist_ok=True)
    path.write_text(text, encoding="utf-8")
    print(f"{group}: prior of motion from {len({flight.group for flight in others})} other airframes, {path.name}")
    return path
