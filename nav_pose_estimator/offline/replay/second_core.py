"""Trainings and rehearsals of a replay on another core, in a copy of this process.

The copy is made once. Work travels to it and the result travels back, one after the other. The result counts when it
counts where everything is done in one process: whoever asks for it earlier waits. Where there is one core, or no such
copy, the work is done here.
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

Work = Callable[[], Any]
_AHEAD = 0.5  # s before a result counts
_KINDS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)


class SecondCore:
    """Use it as a context: what is left under way at the end is ended."""

    def __init__(self) -> None:
        self._can_copy = sys.platform == "linux" and len(os.sched_getaffinity(0)) > 1
        self._seen: set[str] = set()
        self._copy: _Copy | None = None
        self._trainings: list[tuple[float, OutageLearner, Work]] = []
        self.engine: PoseEstimator | None = None
        """Whose trainings these are."""

    def __enter__(self) -> "SecondCore":
        return self

    def __exit__(self, *_: object) -> None:
        if self._copy is not None:
            self._copy.end()
            self._copy = None

    def rehearse(self, work: Work) -> Work:
        """Begin a rehearsal; what is returned waits for its outcome."""
        return self._begin("rehearsal", work)

    def train(self, job: TrainingJob) -> None:
        """Begin a training; its result counts ``TAKE_OVER`` after its data, and ``deliver`` brings it before."""
        assert self.engine is not None
        assert self.engine.outage_aid is not None
        learner = self.engine.outage_aid.learner
        self._trainings.append((job.until, learner, self._begin("training", job.run)))

    def deliver(self, stamp_ns: int) -> None:
        """Hand in the results of trainings that might count before ``stamp_ns``, and of a clock that went back."""
        while self._trainings and not 0.0 <= stamp_ns * 1e-9 - self._trainings[0][0] < TAKE_OVER - _AHEAD:
            _, learner, result = self._trainings.pop(0)
            aid = None if self.engine is None else self.engine.outage_aid
            if aid is not None and aid.learner is learner:  # else it has forgotten the flight meanwhile
                outcome: TrainingResult = result()
                aid.accept(outcome)

    def _begin(self, kind: str, work: Work) -> Work:
        """The first of a ``kind`` is done here: its kernels are loaded then, and an outage finds them."""
        if not self._can_copy or kind not in self._seen:
            self._seen.add(kind)
            result = work()
            return lambda: result
        if self._copy is None:
            self._copy = _Copy()
        return self._copy.begin(work)


class _Copy:
    """A copy of this process that does one piece of work after the other until this process ends it, or ends itself."""

    def __init__(self) -> None:
        ours, theirs = socket.socketpair()
        with warnings.catch_warnings():
            # of threads: those of the libraries take no part in what the copy does
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process = os.fork()
        if self._process == 0:
            ours.close()
            _serve(theirs.makefile("rwb"))
        theirs.close()
        self._pipe = ours.makefile("rwb")
        ours.close()
        self._talk = ThreadPoolExecutor(max_workers=1)  # waits for the copy, so that the flight does not

    def begin(self, work: Work) -> Work:
        """Begin ``work`` as soon as all before it is done; what is returned waits for the result."""
        answer = self._talk.submit(self._answer, work)
        return lambda: _result(answer, work)

    def end(self) -> None:
        """End it, with what it has not done yet."""
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
    except (OSError, EOFError):  # the copy was killed, for want of memory, say: nothing of this process was changed
        return work()


def _serve(pipe: BufferedRWPair) -> None:
    """In the copy: nothing but the work, above all no cleaning up of what belongs to the original."""
    try:
        for kind in _KINDS:
            signal.signal(kind, signal.SIG_DFL)
        while True:
            pickle.dump(pickle.load(pipe)(), pipe)
            pipe.flush()
    finally:
        os._exit(0)
