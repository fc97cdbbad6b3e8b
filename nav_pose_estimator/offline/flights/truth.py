"""The ground truth of a bag (nav_msgs/Odometry), collected batch by batch."""

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import enu_to_lla
from nav_pose_estimator.core.numerics.rotation import quat_rotate_many
from nav_pose_estimator.offline.bags.decoder import Decoder
from nav_pose_estimator.offline.bags.raw_messages import RawBatch, Topic
from nav_pose_estimator.offline.bags.reader import BagReader
from nav_pose_estimator.offline.flights.row_store import RowStore, pieces, release
from nav_pose_estimator.offline.flights.survey import GnssColumns
from nav_pose_estimator.offline.flights.tracks import Reference, displacement_enu
from nav_pose_estimator.ros.messages.cdr import columns

TRUTH_ORIGIN = "/ground_truth/origin"
_FIELDS = ("pose.pose.position", "pose.pose.orientation", "twist.twist.linear")
Origin = tuple[float, float, float]


class TruthRecorder:
    """Takes the messages of the topic ``topic``; None where the bag has no truth."""

    def __init__(self, topic: Topic | None) -> None:
        self._topic = topic
        self._stamps: list[np.ndarray] = []
        self._rows = RowStore(10)  # position ENU, orientation as in the message, velocity in the body
        self._unreadable = False

    def take(self, batch: RawBatch) -> None:
        """Store the needed fields of the next batch."""
        if self._topic is None or not len(batch):
            return
        found = columns(self._topic.type, batch, _FIELDS)
        if found is None:
            self._unreadable = True
            return
        self._stamps.append(found["stamp_ns"])
        self._rows.append(np.column_stack([found[name] for name in _FIELDS]))

    def reference(self, reader: BagReader, gnss: GnssColumns, epoch_ns: int) -> tuple[Reference | None, list[str]]:
        """The true motion, None if there is none, and sentences about assumptions."""
        if self._topic is None or self._topic.count == 0:
            return None, []
        name = self._topic.name
        if self._unreadable or not self._stamps:
            return None, [f"the messages on {name} cannot be read or differ in length: judged against GNSS instead"]
        t = (np.concatenate(self._stamps) - epoch_ns) * 1e-9
        odometry = self._rows.table()
        origin, assumed = _origin(reader), []
        if origin is None:
            origin = _fitted_origin(t, odometry[:, :3], gnss, epoch_ns)
            assumed = [f"{TRUTH_ORIGIN} is not in the bag: the origin of {name} was fitted to the fixes"]
            if origin is None:
                return None, [f"{name} has no origin and there are no fixes: nothing to judge against"]
        rows = _on_earth(odometry, origin)
        return Reference("ground truth", t, rows[:, :3], rows[:, 3:6], rows[:, 6:]), assumed


def _on_earth(odometry: np.ndarray, origin: Origin) -> np.ndarray:
    """Rows (N, 10): latitude, longitude [rad], height [m]; velocity ENU [m/s]; quaternion, scalar first."""
    store = RowStore(10)
    for part in pieces(len(odometry)):
        enu, orientation, velocity = np.split(odometry[part], (3, 7), axis=1)
        q_nb = orientation[:, [3, 0, 1, 2]]
        store.append(np.column_stack([*enu_to_lla(enu, *origin), quat_rotate_many(q_nb, velocity), q_nb]))
        release(odometry)
    return store.table()


def _origin(reader: BagReader) -> Origin | None:
    topic = reader.bag.topics.get(TRUTH_ORIGIN)
    if topic is None:
        return None
    for batch in reader.bag.batches([TRUTH_ORIGIN]):
        message = Decoder(topic)(batch.payload(0))
        return float(np.radians(message.latitude)), float(np.radians(message.longitude)), float(message.altitude)
    return None


def _fitted_origin(t: np.ndarray, enu: np.ndarray, gnss: GnssColumns, epoch_ns: int) -> Origin | None:
    good = gnss.fixes[:, 3] >= 0.0
    if not good.any():
        return None
    times, position = (gnss.fix_ns[good] - epoch_ns) * 1e-9, gnss.fixes[good, :3]
    there = np.stack([np.interp(times, t, enu[:, i]) for i in range(3)], axis=-1)
    offset = np.median(displacement_enu(position, position[0]) - there, axis=0)
    lat, lon, alt = enu_to_lla(offset, *position[0].tolist())
    return float(lat), float(lon), float(alt)
