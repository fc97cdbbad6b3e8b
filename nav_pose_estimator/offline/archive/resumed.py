"""Resumption of an interrupted run: jobs that it has finished are not repeated."""

import sys
from collections.abc import Callable, Iterator, Sequence
from typing import Any

from nav_pose_estimator.offline.archive.jobs import LOCAL, Failure, carry_out
from nav_pose_estimator.offline.archive.kept import KeptResults


def carry_on(
    work: Callable[[Any], Any],
    jobs: Sequence[Any],
    keys: Sequence[str],
    kept: KeptResults,
    processes: int = 1,
    scheduler: str = LOCAL,
) -> Iterator[tuple[int, Any | Failure]]:
    """Yield the outcomes of ``jobs``: first the results in ``kept``, then those of ``carry_out`` of the other jobs.

    ``keys``: one for each of ``jobs``. Every result is stored before it is yielded.
    """
    waiting = []
    for number, key in enumerate(keys):
        result = kept.take(key)
        if result is None:
            waiting.append(number)
        else:
            yield number, result
    if len(waiting) < len(jobs):
        print(f"{len(jobs) - len(waiting)} of {len(jobs)} jobs were finished by an earlier run", file=sys.stderr)
    for place, outcome in carry_out(work, [jobs[number] for number in waiting], processes, scheduler):
        if not isinstance(outcome, Failure):
            kept.keep(keys[waiting[place]], outcome)
        yield waiting[place], outcome
