"""Shared memory of Fast DDS that a killed process has left behind, and how a node avoids it.

A process that is killed while it creates a port leaves it in /dev/shm as it then was. Fast DDS opens it with Boost's
``managed_open_or_create``, which waits until somebody has finished it: for ever, in the creation of the next node,
also of other domains, since some ports belong to all of them. (eProsima/Fast-DDS issues 1144, 5469 and 6117 are kin.)
"""

import contextlib
import os
import re
import struct
import time
from pathlib import Path

_TRANSPORT = "FASTDDS_BUILTIN_TRANSPORTS"
_PROFILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")  # these say it, too, and more
_SEGMENT = re.compile(r"fastrtps_(port\d+|[0-9a-f]{16})")
_FINISHED = 2  # the first word of a Boost segment: 0 not begun, 1 begun, 2 finished, 3 spoilt
_BIRTH = 1.0  # s: a segment is finished within microseconds


def choose_transport() -> None:
    """UDP instead of shared memory, unless somebody has chosen; other middlewares do not read that.

    Messages here are small, so that shared memory would save nothing, and peers that use it speak UDP, too. With
    ``ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST`` rmw_fastrtps adds shared memory whatever is chosen.
    """
    if not any(map(os.environ.get, _PROFILES)):
        os.environ.setdefault(_TRANSPORT, "UDPv4")


def remove_unfinished(folder: Path = Path("/dev/shm")) -> list[str]:
    """Remove the segments in ``folder`` that a process has begun and will not finish; their names."""
    removed = []
    for file in _segments(folder):
        with contextlib.suppress(OSError):  # gone meanwhile, or another user's
            if time.time() - file.stat().st_mtime > _BIRTH and _state(file) < _FINISHED:
                file.unlink()
                removed.append(file.name)
    return removed


def _segments(folder: Path) -> list[Path]:
    try:
        return sorted(file for file in folder.iterdir() if _SEGMENT.fullmatch(file.name))
    except OSError:  # no such folder: not Linux
        return []


def _state(file: Path) -> int:
    with file.open("rb") as opened:
        word = opened.read(4)
    return int(struct.unpack("=I", word)[0]) if len(word) == 4 else 0
