"""A flight is not measured with what was learned from it: the prior of motion is made anew for every group it has seen.

The statistics of every recording are taken once, by one aided flight with rehearsals; the fits without one group each
take no time. The rehearsals are flown with the prior as it is, so a group that is held out has had its share, one in
the number of airframes, in how often the regimes of other flights decided wrongly. A group that the prior was not made
of flies with the prior as it is.
"""

import hashlib
import re
import sys
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from nav_pose_estimator.engine.outage.methods.usual_file import KnownFlight, flights_of
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive.jobs import Failure, carry_out
from nav_pose_estimator.offline.archive.kept import KeptResults, key_of
from nav_pose_estimator.offline.benchmarks.outage.benchmark import Task
from nav_pose_estimator.offline.flights.config_file import load_parameters
from nav_pose_estimator.offline.training.flights import Reading, digest_of
from nav_pose_estimator.offline.training.prior import LEAST, WING, PriorFlight, fit, fly, text_of


@dataclass(frozen=True)
class MotionJob:
    """One recording whose motion is to be taken."""

    bag: Path
    group: str
    reading: Reading


@dataclass(frozen=True)
class Workers:
    """Who flies: ``processes`` of this machine, or a Dask ``scheduler``. What is done is kept beside ``out``."""

    processes: int
    scheduler: str
    out: Path


def with_held_out_priors(
    tasks: Sequence[Task], groups: Mapping[str, str], folder: Path, workers: Workers
) -> list[Task]:
    """The tasks, each with the file of a prior without its group, written into ``folder``; says which those are."""
    found: list[Task] = []
    for config in dict.fromkeys(task.config for task in tasks):
        members = [task for task in tasks if task.config == config]
        known = flights_of(load_parameters(config).learner.prior)
        bags = {task.bag: task for task in members}
        jobs = [MotionJob(bag, groups[bag.name], _reading(task)) for bag, task in bags.items()]
        seen = seen_groups({job.bag: job.group for job in jobs}, known)
        flights = list(_flown(jobs, known, workers)) if seen else []
        files = {group: file for group in seen if (file := _file_without(group, flights, folder)) is not None}
        found += [replace(task, prior=files.get(groups[task.bag.name])) for task in members]
    return found


def seen_groups(groups: Mapping[Path, str], known: Sequence[KnownFlight]) -> list[str]:
    """The groups of recordings, by path, of which the prior of these ``known`` flights was made."""
    airframes, digests = {one.airframe for one in known}, {one.digest for one in known}
    return list(dict.fromkeys(g for bag, g in groups.items() if g in airframes or digest_of(bag) in digests))


def _reading(task: Task) -> Reading:
    return Reading(task.config, task.log, task.gnss_delay)


def _flown(jobs: Sequence[MotionJob], known: Sequence[KnownFlight], workers: Workers) -> Iterator[PriorFlight]:
    """The motion of every recording that holds enough of it. What it counts as, the prior has been told before."""
    wings = {one.digest for one in known if one.kind == WING}
    kept = KeptResults(workers.out)
    keys = [key_of(job, [path for path in (job.bag, job.reading.config) if path is not None]) for job in jobs]
    done: dict[int, PriorFlight] = {i: flight for i, key in enumerate(keys) if (flight := kept.take(key)) is not None}
    rest = [i for i in range(len(jobs)) if i not in done]
    for place, outcome in carry_out(_fly, [jobs[i] for i in rest], workers.processes, workers.scheduler):
        job = jobs[rest[place]]
        if isinstance(outcome, Failure):
            print(f"note: {job.bag.name} adds nothing to the prior: {outcome.why}", file=sys.stderr)
            continue
        done[rest[place]] = outcome
        kept.keep(keys[rest[place]], outcome)
    for i in sorted(done):
        if done[i].seconds >= LEAST:
            yield replace(done[i], is_wing=done[i].digest in wings)


def _fly(job: MotionJob) -> PriorFlight:
    return fly(job.bag, job.group, job.reading)


def _file_without(group: str, flights: Sequence[PriorFlight], folder: Path) -> Path | None:
    """The prior of all other groups as a file, its content in its name: a run that goes on knows it by that."""
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
