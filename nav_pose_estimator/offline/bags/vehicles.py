"""Which topics of a bag belong to which vehicle, by their namespaces.

Two names of one sensor on two vehicles differ in one part (/a/imu, /b/imu), or one has a namespace that the other has
not (/imu, /b/imu).
"""

from collections.abc import Iterable
from itertools import combinations


def namespaces(topics: Iterable[str]) -> list[str]:
    """The namespaces of vehicles of which each has one of ``topics``, sorted; empty for names of one vehicle."""
    found = {space for first, second in combinations(topics, 2) for space in _apart(first, second) if space}
    return sorted(found)


def others(ours: str, topics: Iterable[str]) -> tuple[str, ...]:
    """The namespaces of vehicles other than that of the topic ``ours``."""
    return tuple(sorted({pair[1] for topic in topics if (pair := _apart(ours, topic)) and pair[1]}))


def _apart(first: str, second: str) -> tuple[str, ...]:
    """The namespaces of the vehicles by which two names differ, "" for none; () for names of one vehicle."""
    if first != second and (first.endswith(second) or second.endswith(first)):
        return first.removesuffix(second), second.removesuffix(first)
    parts = first.split("/"), second.split("/")
    if len(parts[0]) != len(parts[1]):
        return ()
    differing = [i for i, (one, other) in enumerate(zip(*parts, strict=True)) if one != other]
    if len(differing) != 1 or differing[0] == len(parts[0]) - 1:
        return ()
    return tuple("/".join(path[: differing[0] + 1]) for path in parts)
