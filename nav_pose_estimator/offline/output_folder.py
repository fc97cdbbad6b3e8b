"""A folder of results that is created atomically, and that never replaces files of other origin.

All results are written into a hidden folder beside the final one, which is renamed at the end. If the run ends before,
for whatever reason, earlier results are unchanged. A mark in the folder lists the files that a run has written. A
folder is only replaced if it has the mark of the same kind of run, and contains no other files.
"""

import errno
import fcntl
import os
import shutil
import signal
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path
from types import FrameType, TracebackType
from typing import Any

from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.ending_signals import outside_callbacks

MARK = ".nav_pose_estimator"
"""File in a finished folder: the kind of run, then the files that it has written, one per line."""
_HOLDER = ".{}.nav_pose_unfinished"  # hidden folder beside the final one
_PREVIOUS = ".previous"  # name of the earlier results in it, while they are being replaced
_NO_ROOM = frozenset((errno.ENOSPC, errno.EDQUOT, errno.EFBIG))
_ENDING = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # signals that end the process


class OutputFolder:
    """Context manager: ``with OutputFolder(path, "replay") as work``, where ``work`` is a path that does not exist yet.

    ``work`` has the final name, below the hidden folder. ``inputs`` are files and folders that are read meanwhile.
    ``replace``: whether earlier results of the same kind may be replaced. ``option``: what the user has to change if
    the folder cannot be used. Raises ``UserError`` on entry where the folder cannot be used, or where another run is
    writing it, and on exit for a full disk.
    """

    def __init__(
        self, path: Path, kind: str, inputs: Sequence[Path] = (), replace: bool = True, option: str = "--out"
    ) -> None:
        self._given, self._kind, self._replace, self._option = path, kind, replace, option
        self._path = Path(os.path.realpath(path))
        self._inputs = [Path(os.path.realpath(item)) for item in inputs]
        self._holder = self._path.parent / _HOLDER.format(self._path.name)
        self._work = self._holder / self._path.name
        self._lock = -1
        self._handlers: dict[int, Any] = {}

    def __enter__(self) -> Path:
        self._refuse_unusual()
        try:
            self._path.parent.mkdir(parents=True, exist_ok=True)
            self._lock = self._locked_holder()
        except OSError as error:
            raise UserError(f"{self._given} cannot be made ({error.strerror})") from None
        try:
            self._clear_up()
            self.check()
        except BaseException:
            self._discard()
            raise
        self._handlers = _replace_handlers(outside_callbacks(_end))
        return self._work

    def __exit__(self, kind: type | None, error: BaseException | None, where: TracebackType | None) -> None:
        try:
            if error is None:
                self._commit()
        except OSError as failure:
            error = failure
        finally:
            self._discard()
            _restore_handlers(self._handlers)
        if isinstance(error, OSError) and error.errno in _NO_ROOM:
            raise UserError(f"{self._given} cannot be written: {error.strerror}; nothing was changed") from None
        if error is not None and kind is None:
            raise error

    def check(self) -> None:
        """Raise ``UserError`` unless the folder can be created or replaced."""
        self._refuse_unusual()
        if not os.path.lexists(self._path):
            return
        if not self._path.is_dir():
            raise UserError(f"{self._given} is a file; choose another {self._option} for the folder")
        entries = sorted(item.name for item in self._path.iterdir())
        if not entries:
            return
        if not self._replace:
            raise UserError(f"{self._given} exists already; choose another name or give --force")
        written = _written(self._path, self._kind)
        foreign = entries[:1] if written is None else sorted(set(_files(self._path)) - written)
        if foreign:
            raise UserError(
                f"{self._given} holds {foreign[0]!r}, not from an earlier {self._kind}, so it is not replaced: "
                f"choose another {self._option}"
            )

    def _refuse_unusual(self) -> None:
        here = Path.cwd()
        for item in self._inputs:
            if self._path == item or self._path in item.parents:
                raise UserError(f"{self._given} holds the input {item.name!r}: choose another {self._option}")
        if self._path == here or self._path in here.parents or os.path.ismount(self._path):
            raise UserError(f"{self._given} is the current folder or a mount point: name a folder inside it")
        above = next(folder for folder in self._path.parents if os.path.lexists(folder))
        if not above.is_dir():
            raise UserError(f"{above} is a file, so {self._given} cannot be made")

    def _locked_holder(self) -> int:
        """Create and lock the hidden folder; return its descriptor. The lock is released if the process dies."""
        while True:
            self._holder.mkdir(exist_ok=True)
            lock = os.open(self._holder, os.O_RDONLY | os.O_DIRECTORY)
            try:
                fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError:
                os.close(lock)
                raise UserError(f"another run is writing {self._given}: wait for it, or choose another name") from None
            except OSError:  # a file system without locks
                return lock
            with suppress(FileNotFoundError):
                if os.path.samestat(os.fstat(lock), self._holder.stat()):
                    return lock
            os.close(lock)  # the previous run removed the folder between creation and lock

    def _clear_up(self) -> None:
        """Remove the files of a killed run; restore earlier results if it was killed while replacing them."""
        previous = self._holder / _PREVIOUS
        if previous.exists() and not os.path.lexists(self._path):
            os.rename(previous, self._path)
        for item in self._holder.iterdir():
            shutil.rmtree(item) if item.is_dir() and not item.is_symlink() else item.unlink()

    def _commit(self) -> None:
        _write_mark(self._work, self._kind)
        try:
            self.check()
        except UserError as error:  # other files were added to the folder meanwhile
            kept = next(p for i in range(1, 1000) if not os.path.lexists(p := Path(f"{self._path}_{i}")))
            os.rename(self._work, kept)
            raise UserError(f"{error}; the new results are in {kept}") from None
        with _signals_wait():
            if not os.path.lexists(self._path):
                os.rename(self._work, self._path)
                return
            os.rename(self._path, self._holder / _PREVIOUS)
            try:
                os.rename(self._work, self._path)
            except BaseException:
                os.rename(self._holder / _PREVIOUS, self._path)
                raise

    def _discard(self) -> None:
        shutil.rmtree(self._holder, ignore_errors=True)
        if self._lock >= 0:
            os.close(self._lock)
            self._lock = -1


def _files(folder: Path) -> Iterator[str]:
    """Files and links below ``folder``, relative to it."""
    for root, folders, files in os.walk(folder):
        links = [name for name in folders if os.path.islink(os.path.join(root, name))]
        yield from (os.path.relpath(os.path.join(root, name), folder) for name in files + links)


def _write_mark(folder: Path, kind: str) -> None:
    names = sorted([*_files(folder), MARK])
    (folder / MARK).write_text("\n".join([kind, *names]) + "\n", encoding="utf-8")


def _written(folder: Path, kind: str) -> set[str] | None:
    """Files that a run of this kind has written into ``folder``; None without its mark."""
    try:
        first, *names = (folder / MARK).read_text(encoding="utf-8").splitlines()
    except (OSError, UnicodeDecodeError, ValueError):
        return None
    return set(names) if first == kind else None


def _end(number: int, frame: FrameType | None) -> None:
    raise SystemExit(128 + number)


def _replace_handlers(handler: Any) -> dict[int, Any]:
    """Install ``handler`` for the signals that end the process by default; return the previous handlers."""
    if threading.current_thread() is not threading.main_thread():
        return {}
    found: dict[int, Any] = {number: signal.getsignal(number) for number in _ENDING}
    before = {number: old for number, old in found.items() if old is signal.SIG_DFL}
    for number in before:
        signal.signal(number, handler)
    return before


def _restore_handlers(handlers: dict[int, Any]) -> None:
    for number, handler in handlers.items():
        signal.signal(number, handler)


@contextmanager
def _signals_wait() -> Iterator[None]:
    """Context in which signals are deferred to its end."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    late: list[int] = []
    found: dict[int, Any] = {number: signal.getsignal(number) for number in _ENDING}
    before = {number: old for number, old in found.items() if old is not None}  # None: not set from Python
    for number in before:
        signal.signal(number, lambda arrived, _: late.append(arrived))
    try:
        yield
    finally:
        _restore_handlers(before)
    for number in late[:1]:
        signal.raise_signal(number)
