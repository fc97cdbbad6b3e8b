"""Results of single jobs kept on disk until all are there, so that a run that was interrupted goes on where it was."""

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


class KeptResults:
    """Results by key in a hidden ``folder`` beside ``beside``, the run's output; only a finished run removes it."""

    def __init__(self, beside: Path) -> None:
        self.folder = beside.absolute().parent / f".{beside.name}.nav_pose_partial"

    def take(self, key: str) -> Any | None:
        """The result that an earlier run kept under ``key``, None without one or where it cannot be read any more."""
        with suppress(OSError, EOFError, pickle.UnpicklingError, AttributeError, ImportError):
            if self.folder.stat().st_uid == os.getuid():  # nobody else's: reading it can run code
                return pickle.loads((self.folder / key).read_bytes())
        return None

    def load(self, key: str) -> Any:
        """The result that this run has kept under ``key``. ``UserError`` where it cannot be read any more."""
        if (result := self.take(key)) is None:
            raise UserError("what was flown cannot be read any more: run the command again")
        return result

    def keep(self, key: str, result: Any) -> None:
        """Keep a result; a run that ends in the middle of it leaves nothing or all."""
        self.folder.mkdir(mode=0o700, parents=True, exist_ok=True)
        unfinished = self.folder / f"{key}.{os.getpid()}"
        unfinished.write_bytes(pickle.dumps(result))
        unfinished.replace(self.folder / key)

    def forget(self) -> None:
        """The run is finished: nothing is kept any more."""
        shutil.rmtree(self.folder, ignore_errors=True)


def key_of(job: object, inputs: Iterable[Path]) -> str:
    """A name for ``job``, whose ``repr`` says what it is; another one when a file of ``inputs`` or the version is."""
    parts = [__version__, repr(job)]
    for path in inputs:
        files = sorted(path.rglob("*")) if path.is_dir() else [path]
        parts += [f"{file}:{state.st_size}:{state.st_mtime_ns}" for file in files if (state := _state(file))]
    return hashlib.sha256("\n".join(parts).encode()).hexdigest()[:32]


def _state(path: Path) -> os.stat_result | None:
    with suppress(OSError):
        return path.stat()
    return None
