"""Recordings are flown one by one, several at a time, and what each gave is kept until the file is written."""

import glob
import hashlib
import multiprocessing
import os
import sys
from collections.abc import Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from pathlib import Path

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.bags.storage import STORAGES
from nav_pose_estimator.offline.logs.open_recording import check_readable
from nav_pose_estimator.offline.training.flights import FlightData, Reading, digest_of, fly

AIRFRAME = ".airframe"
_LOGS = (".ulg", ".ulog", ".bin")
_METADATA = "metadata.yaml"


@dataclass(frozen=True)
class Recorded:
    """A recording, the SHA-256 of its content, and how it is read."""

    path: Path
    digest: str
    reading: Reading

    def part(self, folder: Path) -> Path:
        """Where what it gives is kept."""
        return folder / f"{hashlib.sha256(self.digest.encode() + self.reading.key).hexdigest()}.npz"


@dataclass(frozen=True)
class Outcome:
    """What became of a recording: a part in the folder, or a sentence why not."""

    recorded: Recorded
    failure: str = ""


def find_recordings(given: Sequence[str]) -> tuple[list[Path], list[Path]]:
    """(recordings, airframe files) in names, patterns and folders. ``UserError`` for a name that leads to nothing."""
    found: list[Path] = []
    for text in given:
        paths = sorted(map(Path, glob.glob(text, recursive=True))) or [Path(text)]
        for path in paths:
            inside = list(_inside(path)) if path.is_dir() and not (path / _METADATA).is_file() else [path]
            if not inside:
                raise UserError(f"{path} holds no recording (bags, {', '.join(_LOGS)}) and no {AIRFRAME} file")
            found += inside
    found = list(dict.fromkeys(found))
    files = [path for path in found if path.suffix == AIRFRAME]
    recordings = [path for path in found if path.suffix != AIRFRAME and _is_readable(path)]
    return recordings, files


def _is_readable(path: Path) -> bool:
    try:
        check_readable(path)
    except UserError as error:
        if not path.exists():
            raise  # a mistyped name ends the command now, not after an hour
        print(f"note: left out: {error}", file=sys.stderr)
        return False
    return True


def _inside(folder: Path) -> Iterator[Path]:
    """Recordings and airframe files below a folder; what lies in a bag's folder belongs to the bag."""
    for path in sorted(folder.iterdir()):
        if path.is_dir():
            yield from [path] if (path / _METADATA).is_file() else _inside(path)
        elif path.suffix.lower() in (*_LOGS, *STORAGES, AIRFRAME):
            yield path


def identify(paths: Sequence[Path], reading: Reading) -> list[Recorded]:
    """The recordings with their digests; one that is there twice counts once."""
    found: dict[str, Recorded] = {}
    for path in paths:
        digest = digest_of(path)
        if digest in found:
            print(f"note: {path} is the same recording as {found[digest].path}: it counts once", file=sys.stderr)
        found.setdefault(digest, Recorded(path, digest, reading))
    return list(found.values())


def fly_all(recordings: Sequence[Recorded], folder: Path, jobs: int) -> list[Path]:
    """Fly what has no part in ``folder`` yet; returns the parts of all that could be used, in the order given.

    A recording that fails is left out. Whatever ends this, finished recordings are not flown again.
    """
    from tqdm import tqdm

    folder.mkdir(parents=True, exist_ok=True)
    waiting = [one for one in recordings if FlightData.load(one.part(folder)) is None]
    with tqdm(total=len(recordings), unit=" flight", disable=not sys.stderr.isatty()) as bar:
        bar.update(len(recordings) - len(waiting))
        for outcome in _outcomes(waiting, folder, jobs):
            bar.update(1)
            if outcome.failure:
                bar.write(f"note: left out: {outcome.failure}", file=sys.stderr)
    if not any(folder.iterdir()):
        folder.rmdir()
    return [one.part(folder) for one in recordings if one.part(folder).is_file()]


def _outcomes(waiting: Sequence[Recorded], folder: Path, jobs: int) -> Iterator[Outcome]:
    if jobs == 1 or len(waiting) < 2:
        for one in waiting:
            yield _keep(one, folder)
        return
    # Each process computes on one thread, else the libraries' threads fight for the cores.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    context = multiprocessing.get_context("spawn")
    try:
        with ProcessPoolExecutor(min(jobs, len(waiting)), mp_context=context) as pool:
            for future in as_completed([pool.submit(_keep, one, folder) for one in waiting]):
                yield future.result()
    except BrokenProcessPool:
        done = sum(one.part(folder).exists() for one in waiting)
        raise UserError(
            f"a worker was killed (out of memory?); {done} of {len(waiting)} recordings are done and kept: "
            "run the same command again, perhaps with fewer --jobs"
        ) from None


def _keep(one: Recorded, folder: Path) -> Outcome:
    try:
        fly(one.path, one.digest, one.reading).save(one.part(folder))
    except UserError as error:
        return Outcome(one, str(error))
    return Outcome(one)
