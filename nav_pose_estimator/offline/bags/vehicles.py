"""Distinction of several vehicles in a bag by the namespaces of their topics.

The topics of the same sensor on two vehicles differ in one part of their names (/a/imu, /b/imu), or only one has a
namespace (/imu, /b/imu).
"""

from collections.abc import Iterable
from itertools import combinations


def namespaces(topics: Iterable[str]) -> list[str]:
    """Sorted namespaces of the vehicles that ``topics`` of the same sensor belong to; empty for one vehicle."""
    found = {space for first, second in combinations(topics, 2) for space in _apart(first, second) if space}
    return sorted(found)


def others(ours: str, topics: Iterable[str]) -> tuple[str, ...]:
    """Sorted namespaces of the vehicles other than that of the topic ``ours``."""
    return tuple(sorted({pair[1] for topic in topics if (pair := _apart(ours, topic)) and pair[1]}))


def _apart(first: str, second: str) -> tuple[str, ...]:
    """Namespaces of the two vehicles of two topics, "" for none; () for topics of one vehicle."""
    if first != second and (first.endswith(second) or second.endswith(first)):
        return first.removesuffix(second), second.removesuffix(first)
    parts = first.split("/"), second.split("/")
    if len(parts[0]) != len(parts[1]):
        return ()
    differing = [i for i, (one, other) in enumerate(zip(*parts, strict=True)) if one != other]
    if len(differing) != 1 or differing[0] == len(parts[0]) - 1:
        return ()
    return tuple("/".join(path[: differing[0] + 1]) for path in parts)
