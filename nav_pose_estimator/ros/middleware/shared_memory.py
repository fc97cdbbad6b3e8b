"""Protection against unfinished shared-memory segments of Fast DDS, which block every new node.

A process that is killed while it creates a port leaves an unfinished segment in /dev/shm. Fast DDS opens it with
Boost's ``managed_open_or_create``, which waits for the creator to finish it, and so blocks for ever in the creation of
the next node. Nodes of other domains are affected as well, because some ports are common to all of them. (The issues
1144, 5469 and 6117 of eProsima/Fast-DDS are related.)
"""

import contextlib
import os
import re
import struct
import time
from pathlib import Path

_TRANSPORT = "FASTDDS_BUILTIN_TRANSPORTS"
_PROFILES = ("FASTDDS_DEFAULT_PROFILES_FILE", "FASTRTPS_DEFAULT_PROFILES_FILE")  # profiles select the transport as well
_SEGMENT = re.compile(r"fastrtps_(port\d+|[0-9a-f]{16})")
_FINISHED = 2  # first word of a Boost segment: 0 uninitialised, 1 initialising, 2 initialised, 3 corrupted
_BIRTH = 1.0  # s: age from which an unfinished segment is abandoned; creation takes microseconds


def choose_transport() -> None:
    """Select UDP instead of shared memory for Fast DDS, unless the environment already selects a transport.

    The messages are small, so that shared memory would save nothing, and peers that use shared memory also support UDP.
    With ``ROS_AUTOMATIC_DISCOVERY_RANGE=LOCALHOST``, rmw_fastrtps adds shared memory regardless of the selection. Other
    middlewares ignore it.
    """
    if not any(map(os.environ.get, _PROFILES)):
        os.environ.setdefault(_TRANSPORT, "UDPv4")


def remove_unfinished(folder: Path = Path("/dev/shm")) -> list[str]:
    """Remove the abandoned unfinished segments in ``folder``; return their names."""
    removed = []
    for file in _segments(folder):
        with contextlib.suppress(OSError):  # it was removed meanwhile, or belongs to another user
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
