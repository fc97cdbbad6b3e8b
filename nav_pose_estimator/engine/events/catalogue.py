"""Catalogue of all events: meaning and remedy, for diagnostics, log and documentation.

The name of an event is its counter on ``/diagnostics``. A ``*`` in a name stands for any text. The page
``docs/troubleshooting.md`` is generated from this table, and a test compares it with the names in the code.
"""

from fnmatch import fnmatchcase
from functools import cache

from nav_pose_estimator.engine.events import aids, gnss, imu, operation
from nav_pose_estimator.engine.events.entry import Entry

SECTIONS: dict[str, tuple[Entry, ...]] = operation.SECTIONS | imu.SECTIONS | gnss.SECTIONS | aids.SECTIONS


@cache
def find(name: str) -> Entry | None:
    """The entry of the event ``name``: the one of the exact name, else the first with a matching pattern."""
    entries = [entry for section in SECTIONS.values() for entry in section]
    exact = (entry for entry in entries if entry.name == name)
    return next(exact, None) or next((entry for entry in entries if fnmatchcase(name, entry.name)), None)


def in_words(name: str) -> str:
    """Meaning of the event ``name``; the name itself where it is unknown."""
    entry = find(name)
    return name if entry is None else entry.meaning
