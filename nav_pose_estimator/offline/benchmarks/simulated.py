"""What the benchmarks in simulation share: the words of an option, and seeds on several cores."""

import multiprocessing
import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import chain
from typing import TypeVar

from nav_pose_estimator.errors import UserError

Task = TypeVar("Task")
Trial = TypeVar("Trial")


def chosen(text: str, known: tuple[str, ...], option: str) -> tuple[str, ...]:
    """The names of an option's ``text``, each once; all that are ``known`` for the word all. Raises ``UserError``."""
    names = tuple(dict.fromkeys(name.strip() for name in text.split(",") if name.strip()))
    if names == ("all",):
        return known
    unknown = [name for name in names if name not in known]
    if unknown or not names:
        raise UserError(f"{option} {text!r}: there are {', '.join(known)}, or all")
    return names


def run_all(work: Callable[[Task], list[Trial]], tasks: Sequence[Task], jobs: int) -> Iterator[Trial]:
    """What ``work``, a function of a module, gives for each of ``tasks``, in their order; ``jobs`` processes."""
    from tqdm import tqdm

    if jobs == 1:
        yield from chain.from_iterable(map(work, tqdm(tasks, unit=" seed", disable=not sys.stderr.isatty())))
        return
    with ProcessPoolExecutor(min(jobs, len(tasks)), mp_context=multiprocessing.get_context("spawn")) as pool:
        results = tqdm(pool.map(work, tasks), total=len(tasks), unit=" seed", disable=not sys.stderr.isatty())
        yield from chain.from_iterable(results)
