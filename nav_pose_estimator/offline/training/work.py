"""Replay of many recordings in parallel, with results that are stored until the output file is written."""

import sys
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

from nav_pose_estimator.core.motion.airframe import Airframe
from nav_pose_estimator.engine.outage.airframe_file import load_airframe
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.archive.jobs import Failure
from nav_pose_estimator.offline.archive.kept import KeptResults
from nav_pose_estimator.offline.archive.recordings import find
from nav_pose_estimator.offline.archive.resumed import carry_on
from nav_pose_estimator.offline.logs.open_recording import check_readable
from nav_pose_estimator.offline.remote import at_hand
from nav_pose_estimator.offline.terminal import note_left_out
from nav_pose_estimator.offline.training.flights import Reading, Recorded, digest_of

AIRFRAME = ".airframe"


def find_recordings(given: Sequence[str]) -> tuple[list[Path], list[Path]]:
    """(recordings, airframe files) in names, patterns, lists and folders; ``UserError`` for those without any."""
    found = find(given, also={AIRFRAME})
    recordings = [path for path in found if path.suffix != AIRFRAME]
    for path in recordings:
        if not path.exists():
            check_readable(path)  # a mistyped name ends the command now, not after an hour
    return recordings, [path for path in found if path.suffix == AIRFRAME]


def load_files(paths: Sequence[Path]) -> list[tuple[Path, Airframe]]:
    """Load airframe files to merge; ``UserError`` for an unusable one."""
    found = []
    for path in paths:
        with at_hand(path) as here:
            found.append((path, load_airframe(here)))
    return found


def identify(paths: Sequence[Path], reading: Reading) -> list[Recorded]:
    """The recordings with their digests; duplicates count once."""
    found: dict[str, Recorded] = {}
    for path in paths:
        try:
            with at_hand(path) as here:
                digest = digest_of(here)
        except OSError as error:
            note_left_out(path.name, error.strerror or str(error))
            continue
        except UserError as error:  # of something elsewhere
            note_left_out(path.name, str(error))
            continue
        if digest in found:
            print(f"note: {path} is the same recording as {found[digest].path}: it counts once", file=sys.stderr)
        found.setdefault(digest, Recorded(path, digest, reading))
    return list(found.values())


def fly_all(
    fly: Callable[[Recorded], Any], recordings: Sequence[Recorded], kept: KeptResults, processes: int, scheduler: str
) -> list[Recorded]:
    """Call ``fly`` for all recordings without ``kept`` results, and store them; return the usable ones in order.

    A recording that fails is reported and left out. After an interruption, finished recordings are not repeated.
    """
    from tqdm import tqdm

    failed = {}
    with tqdm(total=len(recordings), unit=" flight", disable=not sys.stderr.isatty()) as bar:
        keys = [one.key for one in recordings]
        for number, outcome in carry_on(fly, recordings, keys, kept, processes, scheduler):
            bar.update(1)
            if isinstance(outcome, Failure):
                failed[number] = outcome
    for number in sorted(failed):
        note_left_out(recordings[number].path.name, failed[number].why)
    return [one for number, one in enumerate(recordings) if number not in failed]
