"""A bag in memory: its samples in order, the withheld truth, and what accompanies it in NAME.json."""

import json
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import enu_to_lla
from nav_pose_estimator.core.numerics.rotation import quat_rotate_many
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, Sample, joined
from nav_pose_estimator.engine.solutions import Event
from nav_pose_estimator.offline.bags.decoder import Decoder
from nav_pose_estimator.offline.bags.raw_messages import BagError
from nav_pose_estimator.offline.bags.reader import BagReader
from nav_pose_estimator.offline.damaged_input import reading
from nav_pose_estimator.offline.flights.tracks import Reference, displacement_enu, gnss_reference
from nav_pose_estimator.ros.messages.cdr import columns

TRUTH_ORIGIN = "/ground_truth/origin"
_STANDS = 0.9  # share of IMU samples without a stamp of their own from which on the clock counts as standing
_ODOMETRY_FIELDS = ("pose.pose.position", "pose.pose.orientation", "twist.twist.linear")


@dataclass
class Recording:
    """One flight. ``epoch_ns`` is its first stamp, from which all seconds count up to ``duration``.

    ``notices`` are sentences for the user, ``events`` what the conversion of single messages had to say. ``opinion``:
    what the autopilot itself estimated, where a flight log tells; for the report, never for an estimator.
    """

    path: Path
    samples: list[Sample]
    epoch_ns: int
    duration: float
    truth: Reference | None = None
    notices: list[str] = field(default_factory=list)
    counters: Counter[str] = field(default_factory=Counter)
    sidecar: dict = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    opinion: Reference | None = None

    @property
    def name(self) -> str:
        """The flight's name: that of the bag without its ending."""
        return self.path.stem.removesuffix("_bag")

    @cached_property
    def fixes(self) -> list[GnssFix]:
        """All fixes, in the order of arrival."""
        return [s for s in self.samples if isinstance(s, GnssFix)]

    @cached_property
    def velocities(self) -> list[GnssVelocity]:
        """All GNSS velocities, in the order of arrival."""
        return [s for s in self.samples if isinstance(s, GnssVelocity)]

    @cached_property
    def imu(self) -> ImuBlock:
        """All IMU samples, in the order of arrival."""
        return joined([s for s in self.samples if isinstance(s, ImuBlock)])

    @cached_property
    def imu_count(self) -> int:
        """Number of IMU samples."""
        return sum(len(s) for s in self.samples if isinstance(s, ImuBlock))

    def reference(self, delay: float) -> Reference:
        """Ground truth where the bag has it, else the fixes at stamp minus ``delay`` [s]."""
        return self.truth or gnss_reference(self.fixes, self.velocities, self.epoch_ns, delay)

    def fix_times(self, delay: float) -> np.ndarray:
        """Times of validity (M,) of the fixes, in order."""
        stamps = sorted({fix.stamp_ns for fix in self.fixes if fix.status >= 0 and fix.stamp_ns > 0})
        return (np.array(stamps, np.int64) - self.epoch_ns) * 1e-9 - delay

    def seconds_of_log(self, log_seconds: float) -> float:
        """Seconds since the first stamp of a time on the clock of the original log (``NAME.json``)."""
        return log_seconds + self.sidecar.get("bag", {}).get("stamp_offset_s", 0.0) - self.epoch_ns * 1e-9


def load(
    path: Path | str,
    remaps: dict[str, str] | None = None,
    progress: Callable[[int], None] | None = None,
    parameters: Parameters | None = None,
) -> Recording:
    """Read a bag as ``parameters`` say (``ros.input``). ``progress`` is called with the number of IMU samples read.

    Raises ``UserError``.
    """
    path = Path(path)
    with reading(path):
        return _load_bag(path, remaps, progress, parameters)


def _load_bag(
    path: Path,
    remaps: dict[str, str] | None,
    progress: Callable[[int], None] | None,
    parameters: Parameters | None,
) -> Recording:
    with BagReader(path, remaps, parameters) as reader:
        samples: list[Sample] = []
        for sample in reader.samples():
            samples.append(sample)
            if progress is not None and isinstance(sample, ImuBlock):
                progress(len(sample))
        stamps = [(int(s.stamps_ns[0]), int(s.stamps_ns[-1])) for s in samples if isinstance(s, ImuBlock) and len(s)]
        if not stamps:
            why = next((f": {event.text}" for event in reader.events if event.text), "")
            raise BagError(f"{path} holds no readable IMU message{why}")
        epoch_ns, last_ns = _span(path, samples, stamps)
        truth, assumed = _truth(reader, samples, epoch_ns)
        counters = reader.counters + Counter(event.name for event in reader.events)
        notices, events = reader.notices + assumed + _standing_clock(samples), reader.events
    duration = (last_ns - epoch_ns) * 1e-9
    return Recording(path, samples, epoch_ns, duration, truth, notices, counters, sidecar(path), events)


def sidecar_path(path: Path) -> Path:
    """NAME.json beside NAME_bag (or NAME.mcap)."""
    return path.resolve().with_name(path.resolve().stem.removesuffix("_bag") + ".json")


def sidecar(path: Path) -> dict:
    """The content of ``sidecar_path``, empty where there is none. ``BagError`` if it is not what it should."""
    beside = sidecar_path(path)
    if not beside.is_file():
        return {}
    try:
        content = json.loads(beside.read_text(encoding="utf-8"))
    except (ValueError, RecursionError) as error:
        raise BagError(f"{beside} is not valid JSON ({error})") from None
    if not isinstance(content, dict):
        return {}
    content = {name: value for name, value in content.items() if value is not None}
    bag = content.get("bag", {})
    values = [content.get("gnss_latency_est_s", 0.0), bag.get("stamp_offset_s", 0.0) if isinstance(bag, dict) else None]
    window = content.get("flight_window_s", [0.0, 0.0])
    values += window if isinstance(window, list) and len(window) == 2 else [None]
    if not all(isinstance(value, (int, float)) and abs(value) < 1e12 for value in values):  # false for NaN
        raise BagError(
            f"{beside}: gnss_latency_est_s and bag.stamp_offset_s must be numbers, flight_window_s two of them"
        )
    return content


def _span(path: Path, samples: list[Sample], imu: list[tuple[int, int]]) -> tuple[int, int]:
    others = [s.stamp_ns for s in samples[:1000] if not isinstance(s, ImuBlock) and s.stamp_ns]
    stamped = [first for first, _ in imu if first > 0]
    if not stamped:
        raise BagError(f"{path}: every IMU message has the stamp zero; the driver must fill header.stamp")
    # A fix may be stamped a little before the first IMU message; a stamp far from it is damaged and dates nothing.
    near = [stamp for stamp in others if 0 <= stamped[0] - stamp < 10**9]
    return min([stamped[0], *near]), max(last for _, last in imu)


def _standing_clock(samples: list[Sample]) -> list[str]:
    """One sentence where most IMU samples repeat a stamp; a few of them are the estimator's business."""
    blocks = [s.stamps_ns for s in samples if isinstance(s, ImuBlock) and len(s)]
    share = 1.0 - len(np.unique(np.concatenate(blocks))) / sum(map(len, blocks))
    if share < _STANDS:
        return []
    return [f"{100.0 * share:.0f} % of the IMU samples repeat a stamp: the clock of the driver stands still"]


def _truth(reader: BagReader, samples: list[Sample], epoch_ns: int) -> tuple[Reference | None, list[str]]:
    """The ground truth of the bag, and what had to be assumed for it."""
    topic = reader.topics.truth
    if topic is None or topic.count == 0:
        return None, []
    # one batch at a time: of a batch only these fields stay in memory
    found = [columns(topic.type, batch, _ODOMETRY_FIELDS) for batch in reader.bag.batches([topic.name]) if len(batch)]
    parts = [part for part in found if part is not None]
    if not parts or len(parts) < len(found):
        return None, [f"the messages on {topic.name} cannot be read or differ in length: judged against GNSS instead"]
    joined = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    t = (joined["stamp_ns"] - epoch_ns) * 1e-9
    enu = joined["pose.pose.position"]
    q_nb = joined["pose.pose.orientation"][:, [3, 0, 1, 2]]
    origin = _origin(reader)
    assumed = []
    if origin is None:
        origin = _fitted_origin(t, enu, samples, epoch_ns)
        assumed = [f"{TRUTH_ORIGIN} is not in the bag: the origin of {topic.name} was fitted to the fixes"]
        if origin is None:
            return None, [f"{topic.name} has no origin and there are no fixes: nothing to judge against"]
    position = np.stack(enu_to_lla(enu, *origin), axis=-1)
    velocity = quat_rotate_many(q_nb, joined["twist.twist.linear"])
    return Reference("ground truth", t, position, velocity, q_nb), assumed


def _origin(reader: BagReader) -> tuple[float, float, float] | None:
    topic = reader.bag.topics.get(TRUTH_ORIGIN)
    if topic is None:
        return None
    for batch in reader.bag.batches([TRUTH_ORIGIN]):
        message = Decoder(topic)(batch.payload(0))
        return float(np.radians(message.latitude)), float(np.radians(message.longitude)), float(message.altitude)
    return None


def _fitted_origin(
    t: np.ndarray, enu: np.ndarray, samples: list[Sample], epoch_ns: int
) -> tuple[float, float, float] | None:
    fixes = [s for s in samples if isinstance(s, GnssFix) and s.status >= 0]
    if not fixes:
        return None
    times = (np.array([fix.stamp_ns for fix in fixes]) - epoch_ns) * 1e-9
    position = np.array([[fix.lat, fix.lon, fix.alt] for fix in fixes])
    there = np.stack([np.interp(times, t, enu[:, i]) for i in range(3)], axis=-1)
    offset = np.median(displacement_enu(position, position[0]) - there, axis=0)
    lat, lon, alt = enu_to_lla(offset, *position[0].tolist())
    return float(lat), float(lon), float(alt)
