"""Groups of recordings that are not independent: of one airframe on one day, or of several IMUs on one flight."""

from collections.abc import Sequence
from fnmatch import fnmatchcase
from pathlib import Path

from nav_pose_estimator.offline.sidecar import flight_name, sidecar

GROUP_KEY = "group"
"""Key in NAME.json of the group of a recording."""


def groups_of(bags: Sequence[Path], patterns: Sequence[str] = ()) -> dict[str, str]:
    """Group by file name of each bag: from NAME.json, else the first matching one of ``patterns``, else its own name.

    A pattern is a shell pattern of flight names, such as ``p4rtk_*``.
    """
    found = {}
    for bag in bags:
        stated = sidecar(bag).get(GROUP_KEY)
        fitting = [pattern for pattern in patterns if fnmatchcase(flight_name(bag), pattern)]
        found[bag.name] = str(stated) if stated else (fitting[0] if fitting else flight_name(bag))
    return found


def patterns_of(text: str) -> list[str]:
    """The patterns of ``--groups``, which commas separate."""
    return [pattern.strip() for pattern in text.split(",") if pattern.strip()]
