"""Trainings and rehearsals of a replay on another core, in copies of this process.

A copy has all that the work needs, and only the result travels. The result counts when it counts where everything is
done in one process: whoever asks for it earlier waits. Where there is one core, or no such copy, the work is done here.
"""

import os
import pickle
import signal
import sys
import warnings
from collections.abc import Callable
from contextlib import suppress
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
        self._running: set[int] = set()
        self._trainings: list[tuple[float, OutageLearner, Work]] = []
        self.engine: PoseEstimator | None = None
        """Whose trainings these are."""

    def __enter__(self) -> "SecondCore":
        return self

    def __exit__(self, *_: object) -> None:
        for process in self._running:
            with suppress(ProcessLookupError):
                os.kill(process, signal.SIGKILL)
            os.waitpid(process, 0)
        self._running.clear()

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
        """The first of a ``kind`` is done here: its kernels are loaded then, and every copy has them."""
        if not self._can_copy or kind not in self._seen:
            self._seen.add(kind)
            result = work()
            return lambda: result
        reader, writer = os.pipe()
        with warnings.catch_warnings():
            # of threads: those of the libraries take no part in what the copy does
            warnings.simplefilter("ignore", DeprecationWarning)
            process = os.fork()
        if process == 0:
            _work_and_end(work, writer)
        os.close(writer)
        self._running.add(process)
        return lambda: self._result(process, reader, work)

    def _result(self, process: int, reader: int, work: Work) -> Any:
        with os.fdopen(reader, "rb") as pipe:
            data = pipe.read()
        _, status = os.waitpid(process, 0)
        self._running.discard(process)
        if status != 0:  # killed for want of memory, say: nothing of this process was changed
            return work()
        return pickle.loads(data)


def _work_and_end(work: Work, writer: int) -> None:
    """In the copy: nothing but the work, above all no cleaning up of what belongs to the original."""
    try:
        for kind in _KINDS:
            signal.signal(kind, signal.SIG_DFL)
        with os.fdopen(writer, "wb") as pipe:
            pickle.dump(work(), pipe)
        os._exit(0)
    finally:
        os._exit(1)
