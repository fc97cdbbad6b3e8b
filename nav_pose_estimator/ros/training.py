"""Training in a separate process, so that no callback waits and no sample is lost meanwhile.

The process is spawned: it inherits no ROS, threads or sockets of the node. It gives way to
everything that flies (nice 10), ignores the interrupt key, which is meant for the node, and ends with the node.
"""

import multiprocessing
import os
import signal
import time
from dataclasses import dataclass
from multiprocessing.connection import Connection
from typing import Any

_TIME_LIMIT = 600.0  # s: a training that takes longer has gone astray
_NICE = 10


@dataclass(frozen=True)
class Outcome:
    """Outcome of a training: a ``result``, or one clause that says why there is none (``failure``)."""

    result: Any = None
    failure: str = ""


class Trainer:
    """At most one training at a time."""

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
        """Run ``job`` (picklable, with ``run()``) in a new process, now or when the present one is done.

        Of several that wait only the newest is kept: it has seen what the older ones have.
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
        """The outcome as soon as there is one; does not wait."""
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
        """End everything; outcomes are lost."""
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
    """The whole life of the training process."""
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    os.nice(_NICE)
    try:
        outcome = Outcome(result=job.run())
    except Exception as error:
        outcome = Outcome(failure=f"{type(error).__name__}: {' '.join(str(error).split())}")
    connection.send(outcome)
    connection.close()
