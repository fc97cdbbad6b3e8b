"""Saved state of the navigator: written periodically in flight and read at the start, for a restart in flight."""

import errno
import hashlib
import os
import socket
from concurrent.futures import Future, ThreadPoolExecutor
from pathlib import Path
from typing import Any

from nav_pose_estimator.engine import array_file
from nav_pose_estimator.engine.composed import resumption
from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.parameters.ros import StateParameters
from nav_pose_estimator.engine.parameters.schema import ParameterError
from nav_pose_estimator.engine.solutions import Level
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.ros.pace import Pace

STATE = array_file.Kind("state", 1)


class StateKeeper:
    """Reads ``ros.state.file`` into ``engine`` at the start; then ``note`` writes it every ``ros.state.period``.

    A thread writes the file, so that a slow disk does not delay the node. Writes in flight are not synchronised to the
    disk, which is sufficient when the process dies, though not when the computer does. A state that cannot be read or
    written is reported in one warning, and the node continues. So is a file that another node writes: its state may be
    that of another vehicle.
    """

    def __init__(self, node: Any, engine: PoseEstimator, parameters: StateParameters) -> None:
        self._node, self._engine = node, engine
        self._path = Path(parameters.file) if parameters.file else None
        self._pace = Pace(1.0 / parameters.period)
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="state")
        self._writing: Future[None] | None = None
        self._failed = False
        self._claim: socket.socket | None = None
        if self._path is None:
            return
        if not self._path.parent.is_dir():
            raise ParameterError(f"ros.state.file: there is no folder {self._path.parent}")
        self._claim = _claim(self._path)
        if self._claim is None:
            text = f"the saved state is not used: another node writes {self._path}; give each node a file of its own"
            self._node.say("resume.refused.file", Level.WARN, text)
            self._path = None
        elif self._path.exists():
            self._read(self._path)
        else:
            text = f"there is no saved state yet ({self._path}): the navigator aligns as at every first start"
            self._node.say("resume.none", Level.INFO, text)

    def _read(self, path: Path) -> None:
        try:
            resumption.resume(self._engine, array_file.load(path, STATE))
        except UserError as error:
            self._node.say("resume.refused.file", Level.WARN, f"the saved state is not used: {path}: {error}")

    def note(self, stamp_ns: int) -> None:
        """Write the state after the solution of ``stamp_ns`` if one is due and the previous write has ended."""
        if self._path is None or not self._pace.is_due(stamp_ns):
            return
        if self._writing is not None:
            if not self._writing.done():
                return
            self._report(self._writing)
        arrays = resumption.arrays_of(self._engine)
        if arrays is not None:
            self._writing = self._writer.submit(array_file.save, self._path, STATE, arrays, durable=False)

    def wait(self) -> None:
        """Wait until the last write has ended."""
        if self._writing is not None:
            self._writing.exception()

    def stop(self) -> None:
        """Write the final state, synchronised to the disk, when the node ends."""
        self._writer.shutdown()
        arrays = None if self._path is None else resumption.arrays_of(self._engine)
        if self._path is not None and arrays is not None:
            try:
                array_file.save(self._path, STATE, arrays)
            except UserError as error:
                self._node.say("state.not_written", Level.WARN, str(error))
        if self._claim is not None:
            self._claim.close()

    def _report(self, writing: "Future[None]") -> None:
        """Report a failed write, once until a write succeeds again."""
        error = writing.exception()
        if error is not None and not self._failed:
            self._node.say("state.not_written", Level.WARN, f"{error}; a restart in flight would have to align again")
        self._failed = error is not None


def _claim(path: Path) -> socket.socket | None:
    """Claim ``path`` for this process until the socket is closed or the process ends; None where another one has it.

    The name of an abstract socket needs no file that a killed process would leave behind.
    """
    name = hashlib.sha256(os.path.realpath(path).encode()).hexdigest()
    claim = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    try:
        claim.bind(f"\0nav_pose_estimator_{name}")
    except OSError as error:
        if error.errno == errno.EADDRINUSE:
            claim.close()
            return None
    return claim
