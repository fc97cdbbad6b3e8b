"""Work in a copy of the process: the same results at the same time of flight, whatever becomes of the copy."""

import os
import signal
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.offline.flights import methods
from nav_pose_estimator.offline.flights.outages import Outage
from nav_pose_estimator.offline.flights.simulated_flight import in_memory
from nav_pose_estimator.offline.replay.replay import ReplayResult, replay
from nav_pose_estimator.offline.replay.second_core import SecondCore
from nav_pose_estimator.sim.scenarios import generate


@pytest.fixture(scope="module")
def flown_twice() -> list[ReplayResult]:
    """A flight with trainings, rehearsals and an outage, with copies of the process and without."""
    flight = in_memory(generate("multirotor_outage", 170.0, 3, "icm42688"))
    parameters = methods.apply(Parameters(), "best")
    results = [replay(flight, parameters, [Outage(140.0, 25.0)])]
    with pytest.MonkeyPatch.context() as patched:
        patched.setattr(os, "sched_getaffinity", lambda _: {0})
        results.append(replay(flight, parameters, [Outage(140.0, 25.0)]))
    return results


def test_a_second_core_changes_no_bit(flown_twice):
    copied, alone = flown_twice
    assert np.array_equal(copied.track.rows, alone.track.rows)
    assert copied.status.counters == alone.status.counters
    assert copied.status.counters["outage.evidence"] > 10


def fatal_unless_in(process: int) -> int:
    if os.getpid() != process:
        os.kill(os.getpid(), signal.SIGKILL)
    return 7


needs_two_cores = pytest.mark.skipif(
    not hasattr(os, "sched_getaffinity") or len(os.sched_getaffinity(0)) < 2, reason="there is one core"
)


@needs_two_cores
def test_work_is_done_in_another_process():
    with SecondCore() as core:
        assert core.rehearse(os.getpid)() != os.getpid()


@needs_two_cores
def test_work_whose_copy_is_killed_is_done_here():
    with SecondCore() as core:
        fatal = partial(fatal_unless_in, os.getpid())
        assert core.rehearse(fatal)() == 7
        assert core.rehearse(fatal)() == 7  # there is no copy any more


@needs_two_cores
def test_work_that_fails_in_the_copy_fails_here_as_it_would_alone():
    with SecondCore() as core, pytest.raises(ZeroDivisionError):
        core.rehearse(partial(divmod, 1, 0))()


@needs_two_cores
def test_a_replay_that_ends_leaves_no_process_behind():
    before = children()
    with SecondCore() as core:
        core.rehearse(signal.pause)
        assert children() == before  # a training may come first
        core.deliver(0)
        assert children() > before
    assert children() == before


def children() -> set[str]:
    """Of this process, those that have ended and were not waited for included."""
    return {pid for file in Path("/proc/self/task").glob("*/children") for pid in file.read_text().split()}
