"""Wall time since the process began, imports included: what a user waits for."""

import os
import time
from pathlib import Path

_loaded = time.monotonic()


def seconds_since_start() -> float:
    """Seconds since this process was started; where the system does not tell, since this module was loaded."""
    try:
        fields = Path("/proc/self/stat").read_text(encoding="ascii").rpartition(")")[2].split()
        uptime = float(Path("/proc/uptime").read_text(encoding="ascii").split()[0])
        return uptime - int(fields[19]) / os.sysconf("SC_CLK_TCK")
    except (OSError, ValueError, IndexError):
        return time.monotonic() - _loaded
