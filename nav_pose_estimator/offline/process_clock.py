"""What /proc tells of a process, above all the wall time since it began, imports included: what a user waits for."""

import os
import time
from pathlib import Path

_loaded = time.monotonic()


def seconds_since_start() -> float:
    """Seconds since this process was started; where the system does not tell, since this module was loaded."""
    try:
        uptime = float(Path("/proc/uptime").read_text(encoding="ascii").split()[0])
        return uptime - int(stat_fields()[19]) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return time.monotonic() - _loaded


def stat_fields(process: int | str = "self") -> list[str]:
    """The fields of /proc/PID/stat from the third one, the state, on. ``OSError`` where there is none."""
    return Path(f"/proc/{process}/stat").read_text(encoding="ascii").rpartition(")")[2].split()
