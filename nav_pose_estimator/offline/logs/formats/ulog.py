"""Reader of PX4 ULog (https://docs.px4.io/main/en/dev_log/ulog_file_format.html) with the package pyulog."""

import io
import struct
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any

import numpy as np

from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.logs.formats.log_tables import LogTables, Table, finite

MAGIC = b"ULog\x01\x12\x35"
TOPICS = (
    "sensor_combined",
    "vehicle_imu",
    "vehicle_gps_position",
    "sensor_gps",
    "vehicle_magnetometer",
    "sensor_mag",
    "vehicle_air_data",
    "sensor_baro",
    "airspeed",
    "airspeed_validated",
    "differential_pressure",
    "distance_sensor",
    "vehicle_attitude",
    "vehicle_local_position",
    "vehicle_global_position",
    "vehicle_status",
    "actuator_armed",
)
"""The topics that are read; the others are skipped, which saves time and memory."""
# exceptions of pyulog for damaged files
_DAMAGE = (
    struct.error,
    KeyError,
    IndexError,
    ValueError,
    TypeError,
    AttributeError,
    OverflowError,
    OSError,
    MemoryError,
)


def read_ulog(path: Path) -> LogTables:
    """Read a ULog file. Raises ``BagError`` where it cannot be read at all."""
    log, notices = _parse(path)
    if log.file_corruption:
        notices.append(f"{path.name} is damaged: what could not be read between two messages was skipped")
    lost = sum(dropout.duration for dropout in log.dropouts)
    if lost:
        times = "once" if len(log.dropouts) == 1 else f"{len(log.dropouts)} times"
        notices.append(f"the logger dropped data {times}, {lost * 1e-3:.3g} s in all")
    tables: dict[str, list[Table]] = {}
    for item in sorted(log.data_list, key=lambda item: (item.name, item.multi_id)):
        if item.name in TOPICS and "timestamp" in item.data:
            table = Table(item.name, int(item.multi_id), item.data["timestamp"].astype(np.int64), item.data)
            tables.setdefault(item.name, []).append(table)
    return LogTables(
        path=path,
        form="ULog",
        tables=tables,
        names=list(tables),
        parameters=finite(log.initial_parameters.items()),
        firmware=_firmware(log),
        notices=notices,
    )


def _parse(path: Path) -> tuple[Any, list[str]]:
    """pyulog's object, and notices."""
    try:
        from pyulog import core as pyulog
    except ModuleNotFoundError:
        raise BagError(f"{path.name} is a PX4 ULog, which the package pyulog reads: pip install pyulog") from None
    refused = getattr(pyulog, "ULogException", TypeError)  # an exception of its own since 1.3
    ignored = io.StringIO()
    with path.open("rb", buffering=0) as raw, _Watched(raw) as file, redirect_stdout(ignored):
        try:
            log = pyulog.ULog(file, list(TOPICS))
        except refused as error:
            raise BagError(f"{path} is not a readable ULog ({error})") from None
        except _DAMAGE as error:
            raise BagError(f"{path} is damaged and cannot be read ({type(error).__name__})") from None
    notices = [f"{path.name} ends in the middle of a message and was read up to there"] if file.cut else []
    return log, notices


class _Watched(io.BufferedReader):
    """A file that records whether it ended in the middle of a message."""

    cut = False

    def read(self, size: int | None = -1, /) -> bytes:
        data = super().read(size)
        if size is not None and len(data) < size and (data or size != _HEADER_BYTES):
            self.cut = True
        return data


_LONGEST_NAME = 80  # characters of the firmware's name that are kept
_HEADER_BYTES = 3  # size of a message header; an undamaged file ends where the next one would begin


def _firmware(log: Any) -> str:
    info = log.msg_info_dict
    try:
        version = log.get_version_info_str() or ""
    except TypeError:
        version = ""
    text = " ".join(str(part) for part in (info.get("sys_name", "PX4"), version, info.get("ver_hw", "")) if part)
    return "".join(c for c in text if c.isprintable())[:_LONGEST_NAME]
