"""Parallel execution of independent jobs on the cores of this machine or of a cluster.

    for number, outcome in carry_out(work, jobs, processes=4):
        if isinstance(outcome, Failure): ...

A job that fails, or whose process dies, loses only its own result. ``work`` is a function at module level, and its
arguments and results can be pickled. Results are yielded as they complete.
"""

import argparse
import multiprocessing
import os
import threading
from collections import Counter, deque
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import FIRST_COMPLETED, Future, ProcessPoolExecutor, wait
from concurrent.futures.process import BrokenProcessPool
from dataclasses import dataclass
from typing import Any

from nav_pose_estimator.errors import UserError, described

LOCAL = "local"
_ATTEMPTS = 2  # attempts at a job that was running when a process died, which another job may have caused
_PATIENCE = 10.0  # s: time-out of the connection to a scheduler
_DIED = "its process was killed {} times, probably for lack of memory: try fewer processes (--jobs)"


def add_options(parser: argparse.ArgumentParser) -> None:
    """Add the options ``--jobs`` and ``--scheduler`` with the arguments of ``carry_out``."""
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (default: 1)")
    where = "processes of this machine, or a Dask scheduler"
    parser.add_argument("--scheduler", default=LOCAL, metavar="local|tcp://...", help=where)


@dataclass(frozen=True)
class Failure:
    """Reason why a job has no result, in one sentence. ``expected``: it is due to the input (``UserError``)."""

    why: str
    expected: bool


def carry_out(
    work: Callable[[Any], Any], jobs: Sequence[Any], processes: int = 1, scheduler: str = LOCAL
) -> Iterator[tuple[int, Any | Failure]]:
    """Call ``work`` with each of ``jobs``; yield (number of the job, its result or ``Failure``) in any order.

    With one process the jobs run in this process. ``scheduler``: the address of a Dask scheduler, instead of processes
    of this machine. A program error becomes a ``Failure`` as well, so that the other jobs continue.
    """
    if scheduler != LOCAL:
        yield from _on_cluster(work, jobs, scheduler)
        return
    if processes <= 1 or len(jobs) <= 1:
        yield from ((number, _attempt(work, job)) for number, job in enumerate(jobs))
        return
    # one thread per process, so that the threads of the libraries do not compete for the cores
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    waiting, attempts = deque(range(len(jobs))), Counter[int]()
    context = multiprocessing.get_context("spawn")
    while waiting:
        count = min(processes, len(waiting))
        with ProcessPoolExecutor(count, mp_context=context, initializer=_end_with_parent) as pool:
            yield from _until_one_dies(pool, count, (work, jobs), waiting, attempts)


def _end_with_parent() -> None:
    """End this worker when its parent dies; otherwise it would wait for ever."""

    def watch() -> None:
        if (parent := multiprocessing.parent_process()) is not None:
            parent.join()
            os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def _until_one_dies(
    pool: ProcessPoolExecutor,
    processes: int,
    task: tuple[Callable[[Any], Any], Sequence[Any]],
    waiting: deque[int],
    attempts: Counter[int],
) -> Iterator[tuple[int, Any | Failure]]:
    """Yield the outcomes of the ``waiting`` jobs until a process dies.

    The jobs that were running then are put back, or become failures after their last attempt. At most as many jobs as
    processes are submitted at a time, so that only running jobs can be the cause.
    """
    work, jobs = task
    running: dict[Future, int] = {}
    try:
        while waiting or running:
            while waiting and len(running) < processes:
                future = pool.submit(_attempt, work, jobs[waiting[0]])  # if it raises, the job remains in ``waiting``
                running[future] = waiting.popleft()
            for future in wait(running, return_when=FIRST_COMPLETED).done:
                outcome = future.result()
                yield running.pop(future), outcome
    except BrokenProcessPool:
        for number in running.values():
            attempts[number] += 1
            if attempts[number] < _ATTEMPTS:
                waiting.append(number)
            else:
                yield number, Failure(_DIED.format(_ATTEMPTS), expected=False)


def _on_cluster(work: Callable[[Any], Any], jobs: Sequence[Any], address: str) -> Iterator[tuple[int, Any | Failure]]:
    """``carry_out`` on the workers of a Dask scheduler, which moves a job to another worker when its own dies."""
    try:
        from distributed import Client, as_completed
    except ImportError:
        raise UserError("--scheduler needs Dask: pip install -r requirements-cluster.txt") from None
    try:
        client = Client(address, timeout=_PATIENCE)
    except (OSError, ValueError) as error:
        raise UserError(f"there is no Dask scheduler at {address} ({error})") from None
    with client:
        waiting = {client.submit(_attempt, work, job, pure=False): number for number, job in enumerate(jobs)}
        for future in as_completed(list(waiting)):
            lost = future.exception()  # of the cluster; exceptions of ``work`` are outcomes
            yield waiting[future], Failure(described(lost), False) if lost else future.result()
            future.release()


def _attempt(work: Callable[[Any], Any], job: Any) -> Any | Failure:
    try:
        return work(job)
    except UserError as error:
        return Failure(str(error), expected=True)
    except Exception as error:
        return Failure(described(error), expected=False)
