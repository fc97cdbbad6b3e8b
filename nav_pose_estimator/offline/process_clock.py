"""Information about a process from /proc, above all the wall time since its start, which includes imports."""

import os
import time
from pathlib import Path

_loaded = time.monotonic()


def seconds_since_start() -> float:
    """Time [s] since the start of this process, or since the import of this module where /proc is not available."""
    try:
        uptime = float(Path("/proc/uptime").read_text(encoding="ascii").split()[0])
        return uptime - int(stat_fields()[19]) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return time.monotonic() - _loaded


def stat_fields(process: int | str = "self") -> list[str]:
    """Fields of /proc/PID/stat from the third one, the state, on; ``OSError`` if it does not exist."""
    return Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
