"""Store of the results of single jobs on disk until a run is complete, so that an interrupted run can be resumed."""

import hashlib
import os
import pickle
import shutil
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import Any

from nav_pose_estimator import __version__
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.whole_file import replacing


class KeptResults:
    """Results by key in a hidden ``folder`` next to ``beside``, the run's output; only a finished run removes it."""

    def __init__(self, beside: Path) -> None:
        self.folder = beside.absolute().parent / f".{beside.name}.nav_pose_partial"

    def take(self, key: str) -> Any | None:
        """Result of an earlier run under ``key``; None if there is none or it cannot be read."""
        with suppress(OSError, EOFError, pickle.UnpicklingError, AttributeError, ImportError):
            if self.folder.stat().st_uid == os.getuid():  # unpickling can run code, so only files of this user are read
                return pickle.loads((self.folder / key).read_bytes())
        return None

    def load(self, key: str) -> Any:
        """Result of this run under ``key``; ``UserError`` if it can no longer be read."""
        if (result := self.take(key)) is None:
            raise UserError("the stored results can no longer be read: run the command again")
        return result

    def keep(self, key: str, result: Any) -> None:
        """Store a result atomically."""
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        with replacing(self.folder / key) as unfinished:
            unfinished.write_bytes(pickle.dumps(result))

    def forget(self) -> None:
        """Remove all stored results at the end of the run."""
        shutil.rmtree(self.folder, ignore_errors=True)


def key_of(job: object, inputs: Iterable[Path]) -> str:
    """Key of ``job`` by its ``repr``, the version of the package, and size and time of the files of ``inputs``."""
    parts = [__version__, repr(job)]
    for path in inputs:
        files = sorted(path.rglob("*")) if path.is_dir() else [path]
        parts += [f"{file}:{state.st_size}:{state.st_mtime_ns}" for file in files if (state := _state(file))]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


def _state(path: Path) -> os.stat_result | None:
    with suppress(OSError):
        return path.stat()
    return None
