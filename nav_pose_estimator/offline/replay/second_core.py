"""Trainings and rehearsals of a replay on another core, in a forked process.

The process is forked once. It receives one piece of work after the other, and returns the results. A result takes
effect at the same time as in a run with one process, for which the replay waits if necessary. With one core, or where
forking is not possible, the work is done in this process.
"""

import os
import pickle
import signal
import socket
import sys
import warnings
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import suppress
from io import BufferedRWPair
from typing import Any

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator
from nav_pose_estimator.engine.outage.learner import TAKE_OVER, OutageLearner
from nav_pose_estimator.engine.outage.methods.method import TrainingJob, TrainingResult
from nav_pose_estimator.engine.outage.rehearsals import at_its_end

Work = Callable[[], Any]
_AHEAD = 0.01  # s before a result takes effect from which the replay waits for it; more than times are rounded by
_KINDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class SecondCore:
    """Context manager, which ends unfinished work on exit."""

    def __init__(self) -> None:
        self._can_copy = sys.platform == "linux" and len(os.sched_getaffinity(0)) > 1
        self._copy: _Copy | None = None
        self._trainings: list[tuple[float, OutageLearner, Work]] = []
        self._rehearsals: list[Callable[[], None]] = []  # not begun yet
        self.engine: PoseEstimator | None = None
        """Whose trainings these are."""

    def __enter__(self) -> "SecondCore":
        return self

    def __exit__(self, *_: object) -> None:
        if self._copy is not None:
            self._copy.end()
            self._copy = None

    def rehearse(self, work: Work) -> Work:
        """Begin a rehearsal at the next ``deliver``; calling the returned function waits for its outcome.

        Its outcome is needed after half a minute of flight. A training that begins at the same time, the result of
        which is needed after five seconds, is done first.
        """
        begun: list[Work] = []

        def begin() -> None:
            if not begun:
                begun.append(self._begin(work))

        def outcome() -> Any:
            begin()
            return begun[0]()

        self._rehearsals.append(begin)
        return outcome

    def train(self, job: TrainingJob) -> None:
        """Begin a training. Its result takes effect ``TAKE_OVER`` after its data; ``deliver`` provides it before."""
        assert self.engine is not None
        assert self.engine.outage_aid is not None
        learner = self.engine.outage_aid.learner
        self._trainings.append((job.until, learner, self._begin(job.run)))

    def deliver(self, stamp_ns: int) -> None:
        """Provide the results of trainings that could take effect by ``stamp_ns``, and after a clock that went back.

        To be called once a second of flight; rehearsals begin here.
        """
        rehearsals, self._rehearsals = self._rehearsals, []
        for begin in rehearsals:
            begin()
        while self._trainings and not 0.0 <= stamp_ns * 1e-9 - self._trainings[0][0] < TAKE_OVER - _AHEAD:
            _, learner, result = self._trainings.pop(0)
            aid = None if self.engine is None else self.engine.outage_aid
            if aid is not None and aid.learner is learner:  # else it has forgotten the flight meanwhile
                outcome: TrainingResult = result()
                aid.accept(outcome)

    def _begin(self, work: Work) -> Work:
        """Begin ``work``; the kernels that only it needs are loaded by the fork alone."""
        if not self._can_copy:
            return at_its_end(work)
        if self._copy is None:
            self._copy = _Copy()
        return self._copy.begin(work)


class _Copy:
    """A fork of this process that does one piece of work after the other until this process ends it, or ends."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        with warnings.catch_warnings():
            # Python warns of a fork with threads, but the fork does not use those of the libraries
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process = os.fork()
        if self._process == 0:
            ours.close()
            _serve(theirs.makefile("rwb"))
        theirs.close()
        self._pipe = ours.makefile("rwb")
        ours.close()
        self._talk = ThreadPoolExecutor(max_workers=1)  # waits for the fork, so that the replay does not

    def begin(self, work: Work) -> Work:
        """Submit ``work``; calling the returned function waits for its result."""
        answer = self._talk.submit(self._answer, work)
        return lambda: _result(answer, work)

    def end(self) -> None:
        """End the fork and its unfinished work."""
        with suppress(ProcessLookupError):
            os.kill(self._process, signal.SIGKILL)
        os.waitpid(self._process, 0)
        self._talk.shutdown(cancel_futures=True)
        with suppress(OSError):
            self._pipe.close()

    def _answer(self, work: Work) -> Any:
        self._pipe.write(pickle.dumps(work))
        self._pipe.flush()
        return pickle.load(self._pipe)


def _result(answer: Future, work: Work) -> Any:
    try:
        return answer.result()
    except (OSError, EOFError):  # the fork was killed, perhaps for lack of memory; this process is unaffected
        return work()


def _serve(pipe: BufferedRWPair) -> None:
    """Main function of the fork: it only works, and does not clean up what belongs to the original process."""
    try:
        for kind in _KINDS:
            signal.signal(kind, signal.SIG_DFL)
        while True:
            pickle.dump(pickle.load(pipe)(), pipe)
            pipe.flush()
    finally:
        os._exit(0)
