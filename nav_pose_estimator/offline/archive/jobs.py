"""Independent jobs on the cores of this machine or of several: one that fails, or whose process dies, costs its own
result only.

    for number, outcome in carry_out(work, jobs, processes=4):
        if isinstance(outcome, Failure): ...

``work`` is a function of a module, and what goes in and comes out can be pickled. Results come as they are ready.
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

from nav_pose_estimator.errors import UserError

LOCAL = "local"
_ATTEMPTS = 2  # a job under way when a process died is tried once more: it may have been another's fault
_PATIENCE = 10.0  # s to find a scheduler
_DIED = "its process was killed {} times, probably for want of memory: fewer processes at a time may help"


def add_options(parser: argparse.ArgumentParser) -> None:
    """``--jobs`` and ``--scheduler``, as ``carry_out`` takes them."""
    parser.add_argument("--jobs", type=int, default=1, metavar="N", help="processes (default: 1)")
    where = "processes of this machine, or a Dask scheduler"
    parser.add_argument("--scheduler", default=LOCAL, metavar="local|tcp://...", help=where)


@dataclass(frozen=True)
class Failure:
    """Why a job has no result, one sentence. ``expected``: the input is to blame (``UserError``)."""

    why: str
    expected: bool


def carry_out(
    work: Callable[[Any], Any], jobs: Sequence[Any], processes: int = 1, scheduler: str = LOCAL
) -> Iterator[tuple[int, Any | Failure]]:
    """Do ``work`` on each of ``jobs``; yields (number of the job, its result or ``Failure``) in any order.

    One process is this one. ``scheduler``: the address of a Dask scheduler instead of processes of this machine. A
    program error becomes a ``Failure`` as well: of an archive, the rest goes on.
    """
    if scheduler != LOCAL:
        yield from _on_cluster(work, jobs, scheduler)
        return
    if processes <= 1 or len(jobs) <= 1:
        yield from ((number, _attempt(work, job)) for number, job in enumerate(jobs))
        return
    # Each process computes on one thread, else the libraries' threads fight for the cores.
    for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, "1")
    waiting, attempts = deque(range(len(jobs))), Counter[int]()
    context = multiprocessing.get_context("spawn")
    while waiting:
        count = min(processes, len(waiting))
        with ProcessPoolExecutor(count, mp_context=context, initializer=_end_with_parent) as pool:
            yield from _until_one_dies(pool, count, (work, jobs), waiting, attempts)


def _end_with_parent() -> None:
    """A worker whose parent is killed would wait for its next job for ever."""

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
    """Outcomes of what is ``waiting``. Where a process dies, the jobs under way are put back, or are failures.

    No more jobs are handed out than there are processes: only what was under way can be to blame.
    """
    work, jobs = task
    running: dict[Future, int] = {}
    try:
        while waiting or running:
            while waiting and len(running) < processes:
                future = pool.submit(_attempt, work, jobs[waiting[0]])  # may raise: the job then still waits
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
    """On the workers of a Dask scheduler, which takes a job elsewhere when its worker dies."""
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
            lost = future.exception()  # of the cluster: those of the work are outcomes
            yield waiting[future], Failure(f"{type(lost).__name__}: {lost}", False) if lost else future.result()
            future.release()


def _attempt(work: Callable[[Any], Any], job: Any) -> Any | Failure:
    try:
        return work(job)
    except UserError as error:
        return Failure(str(error), expected=True)
    except Exception as error:
        return Failure(f"{type(error).__name__}: {error}", expected=False)
