"""Training in a separate process, so that no callback waits and no sample is lost meanwhile.

The process is spawned, so that it inherits no ROS context, threads or sockets of the node. It runs at low priority,
ignores SIGINT, which is meant for the node, and ends with the node.
"""

import multiprocessing
import os
import signal
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

from nav_pose_estimator.errors import described

_TIME_LIMIT = 600.0  # s after which a training is aborted
_NICE = 10  # niceness of the process


@dataclass(frozen=True)
class Outcome:
    """Outcome of a training: a ``result``, or a clause with the reason why there is none (``failure``)."""

    result: Any = None
    failure: str = ""


class Trainer:
    """Runs trainings, at most one at a time."""

    def __init__(self, time_limit: float = _TIME_LIMIT) -> None:
        self._context = multiprocessing.get_context("spawn")
        self._limit = time_limit
        self._waiting: Any = None
        self._process: Any = None
        self._connection: Any = None
        self._give_up = 0.0

    @property
    def is_busy(self) -> bool:
        """Whether a training runs, or its outcome has not been fetched."""
        return self._process is not None

    def submit(self, job: Any) -> None:
        """Run ``job`` (picklable, with ``run()``) in a new process, now or after the running one.

        Of several waiting jobs only the newest is kept, because its data include those of the older ones.
        """
        if self.is_busy:
            self._waiting = job
            return
        self._connection, theirs = self._context.Pipe(duplex=False)
        self._process = self._context.Process(target=_work, args=(job, theirs), daemon=True, name="training")
        self._process.start()
        theirs.close()
        self._give_up = time.monotonic() + self._limit

    def poll(self) -> Outcome | None:
        """Outcome of the training if it has ended, otherwise None; does not wait."""
        if not self.is_busy:
            return None
        if self._connection.poll():
            try:
                outcome = self._connection.recv()
            except EOFError:
                outcome = Outcome(failure="the training process ended without a result")
        elif time.monotonic() > self._give_up:
            outcome = Outcome(failure=f"it took longer than {self._limit:g} s")
        else:
            return None
        self._end()
        if self._waiting is not None:
            job, self._waiting = self._waiting, None
            self.submit(job)
        return outcome

    def stop(self) -> None:
        """End the running training and discard a waiting one."""
        self._waiting = None
        self._end()

    def _end(self) -> None:
        if self._process is None:
            return
        self._process.kill()
        self._process.join()
        self._connection.close()
        self._process = self._connection = None


def _work(job: Any, connection: Connection) -> None:
    """Main function of the training process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(_NICE)
    try:
        outcome = Outcome(result=job.run())
    except Exception as error:
        outcome = Outcome(failure=described(error))
    connection.send(outcome)
    connection.close()
