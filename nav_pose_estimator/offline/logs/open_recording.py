"""Common function to open recordings of all formats: rosbag2, PX4 ULog, ArduPilot DataFlash."""

import weakref
from collections.abc import Callable
from contextlib import ExitStack
from pathlib import Path

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.errors import UserError
from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.bags.storage import Bag
from nav_pose_estimator.offline.damaged_input import reading
from nav_pose_estimator.offline.flights.recording import Recording, load
from nav_pose_estimator.offline.logs.formats import dataflash, dataflash_text, ulog
from nav_pose_estimator.offline.logs.imu_choice import with_best_imu
from nav_pose_estimator.offline.logs.log_flight import LogRecording, log_recording
from nav_pose_estimator.offline.logs.options import LogOptions
from nav_pose_estimator.offline.logs.sensors import LogSensors
from nav_pose_estimator.offline.remote import at_hand, is_remote

ULOG, BINARY, TEXT = "ULog", "DataFlash", "DataFlash text"
_ENDINGS = {".ulg": ULOG, ".ulog": ULOG, ".bin": BINARY, ".log": TEXT}
_HEAD = 4096  # bytes at the beginning by which the format is recognised


def open_recording(
    path: Path,
    options: LogOptions,
    remaps: dict[str, str] | None = None,
    progress: Callable[[int], None] | None = None,
    parameters: Parameters | None = None,
    hold: bool = True,
) -> Recording:
    """Read a bag, with ``parameters`` (``ros.input``), or a log. Raises ``UserError`` if it cannot be read.

    ``hold`` as in ``recording.load``; the samples of a log are always held.
    """
    with ExitStack() as stack:
        here = stack.enter_context(at_hand(path))
        recording = _open(here, options, remaps, progress, parameters, hold)
        if not hold:
            weakref.finalize(recording, stack.pop_all().close)
    return recording


def _open(
    path: Path,
    options: LogOptions,
    remaps: dict[str, str] | None,
    progress: Callable[[int], None] | None,
    parameters: Parameters | None,
    hold: bool,
) -> Recording:
    if log_form(path) is None:
        if options.imu is not None or options.segment is not None:
            raise UserError(f"{path.name} is not a flight log: --imu and --segment are only for those")
        return load(path, remaps, progress, parameters, hold)
    if remaps:
        raise BagError(f"{path.name} is a flight log: --remap is for the topics of bags")
    with reading(path):
        recording = log_recording(read_sensors(path), options)
    if progress is not None:
        progress(recording.imu_count)
    return recording


def prepared(recording: Recording, parameters: Parameters, until: float) -> Recording:
    """The recording with the best IMU before ``until`` [s]. Raises ``UserError`` for axes that contradict a log's."""
    if isinstance(recording, LogRecording) and parameters.imu.convention != "flu":
        raise UserError(f"{recording.path.name} is a flight log, whose axes are known: leave imu.convention at flu")
    return with_best_imu(recording, parameters, until)


def check_readable(path: Path) -> None:
    """Raise ``BagError`` if ``path`` is neither a bag nor a log, by the beginning of its data.

    Recordings in an object store are only checked when they are copied.
    """
    if not is_remote(path) and log_form(path) is None:
        Bag(path).close()


def log_form(path: Path) -> str | None:
    """The format of a flight log by its content, None for anything else (a bag). Raises ``BagError``."""
    if not path.is_file():
        if not path.exists() or path.suffix.lower() not in _ENDINGS:
            return None
        raise BagError(f"{path} is a folder, not a flight log")
    with path.open("rb") as file:
        head = file.read(_HEAD)
    expected = _ENDINGS.get(path.suffix.lower())
    if not head and expected is not None:
        raise BagError(f"{path} is empty")
    if head.startswith(ulog.MAGIC[:4]):
        return ULOG
    if head.startswith(dataflash.MAGIC) or (expected == BINARY and dataflash.FMT_MAGIC in head):
        return BINARY
    if dataflash_text.is_dataflash_text(head):
        return TEXT
    if path.suffix.lower() == ".tlog":
        raise BagError(f"{path} is a telemetry log: download the flight log (.bin) from the autopilot instead")
    if expected is not None:
        raise BagError(f"{path} is not a flight log: it holds neither PX4 ULog nor ArduPilot DataFlash")
    return None


def read_sensors(path: Path) -> LogSensors:
    """The sensor data of a flight log. Raises ``BagError``."""
    form = log_form(path)
    if form == ULOG:
        from nav_pose_estimator.offline.logs.px4_fields import px4_sensors

        return px4_sensors(ulog.read_ulog(path))
    from nav_pose_estimator.offline.logs.ardupilot_fields import ardupilot_sensors

    if form is None:
        raise BagError(f"{path} is not a flight log: give a PX4 ULog (.ulg) or an ArduPilot DataFlash log (.bin, .log)")
    read = dataflash.read_dataflash if form == BINARY else dataflash_text.read_dataflash_text
    return ardupilot_sensors(read(path))
