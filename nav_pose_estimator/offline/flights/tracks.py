"""Tracks: the estimate of an engine, and the reference that it is compared with.

Times are in seconds since the bag's first stamp, angles in radians, heights in metres above the ellipsoid, vectors ENU.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import radii_many
from nav_pose_estimator.core.filter.layout import OUT_COLUMNS, OUT_POS, OUT_QUAT, OUT_VAR, OUT_VEL
from nav_pose_estimator.core.numerics.rotation import quat_rotate_many
from nav_pose_estimator.engine.solutions import NavBlock
from nav_pose_estimator.offline.flights.row_store import AT_ONCE, RowStore, pieces, release
from nav_pose_estimator.offline.flights.survey import GnssColumns

Array = np.ndarray
_VAR_DVEL, _VAR_DPOS = OUT_VAR + 3, OUT_VAR + 6
_SAME_EPOCH_NS = 100_000_000  # largest difference of the stamps of a fix and a velocity of one epoch
_TIMES_AT_ONCE = 512  # number of times that are interpolated at once, for which about ten times as many rows are read
TRACK_HZ = 50.0
"""Rate [Hz] of the stored rows of the estimate; linear interpolation errs by less than 1 mm at 20 m/s^2."""


def displacement_enu(position: Array, reference: Array) -> Array:
    """Displacement (..., 3) [m] ENU from ``reference`` to the nearby ``position`` (..., 3), both lat, lon, alt."""
    r_m, r_n = radii_many(reference[..., 0])
    height = reference[..., 2]
    lon = np.mod(position[..., 1] - reference[..., 1] + np.pi, 2.0 * np.pi) - np.pi
    east = lon * (r_n + height) * np.cos(reference[..., 0])
    north = (position[..., 0] - reference[..., 0]) * (r_m + height)
    return np.stack([east, north, position[..., 2] - height], axis=-1)


@dataclass(frozen=True)
class Track:
    """The estimate: times ``t`` (N,), ``rows`` (N, OUT_COLUMNS) of ``core.filter.layout``."""

    t: Array
    rows: Array

    def __len__(self) -> int:
        return len(self.t)

    @property
    def position(self) -> Array:
        """(N, 3) latitude, longitude, height."""
        return self.rows[:, OUT_POS : OUT_POS + 3]

    @property
    def velocity(self) -> Array:
        """(N, 3) m/s."""
        return self.rows[:, OUT_VEL : OUT_VEL + 3]

    @property
    def q_nb(self) -> Array:
        """(N, 4) scalar first."""
        return self.rows[:, OUT_QUAT : OUT_QUAT + 4]

    @property
    def horizontal_sd(self) -> Array:
        """(N,) m: root of the sum of the East and North variances."""
        return np.sqrt(self.rows[:, _VAR_DPOS] + self.rows[:, _VAR_DPOS + 1])

    def sd(self, what: str) -> Array:
        """(N, 3) deviations of ``attitude`` [rad], ``velocity`` [m/s] or ``position`` [m]."""
        start = {"attitude": OUT_VAR, "velocity": _VAR_DVEL, "position": _VAR_DPOS}[what]
        return np.sqrt(np.maximum(self.rows[:, start : start + 3], 0.0))

    def pieces(self) -> Iterator["Track"]:
        """Yield the track in parts; each one must be processed before the next one is requested."""
        for part in pieces(len(self.t)):
            yield Track(self.t[part], self.rows[part])
            release(self.rows)

    def thinned(self, largest: int) -> "Track":
        """The track, decimated by an integer factor to at most ``largest`` rows."""
        step = -(-len(self.t) // largest)
        return self if step <= 1 else Track(self.t[::step], _every(self.rows, step))

    def at(self, times: Array) -> Array:
        """Rows (M, OUT_COLUMNS) at ``times`` (M,) by linear interpolation; NaN outside of the track."""
        rows = np.full((len(times), OUT_COLUMNS), np.nan)
        for part, found in self._parts_at(times):
            rows[part] = found
        return rows

    def velocity_at(self, times: Array) -> Array:
        """Velocity (M, 3) [m/s] at ``times``, as of ``at``."""
        velocities = np.full((len(times), 3), np.nan)
        for part, found in self._parts_at(times):
            velocities[part] = found[:, OUT_VEL : OUT_VEL + 3]
        return velocities

    def _parts_at(self, times: Array) -> Iterator[tuple[slice, Array]]:
        if len(self.t):
            yield from ((part, self._at(times[part])) for part in pieces(len(times), _TIMES_AT_ONCE))

    def _at(self, times: Array) -> Array:
        i = np.clip(np.searchsorted(self.t, times) - 1, 0, max(len(self.t) - 2, 0))
        j = np.minimum(i + 1, len(self.t) - 1)
        span = np.maximum(self.t[j] - self.t[i], 1e-9)
        weight = ((times - self.t[i]) / span)[:, None]
        rows = self.rows[i] + weight * (self.rows[j] - self.rows[i])
        slack = 1.5 * span  # the last fixes of an outage may be a little newer than the last IMU sample
        outside = (times < self.t[0] - 1e-9) | (times > self.t[-1] + np.minimum(slack, 0.1))
        rows[outside] = np.nan
        release(self.rows)
        return rows

    def antenna_at(self, times: Array, lever: Array) -> Array:
        """Position (M, 3) at ``times`` of an antenna with the ``lever`` (3,) [m] from the IMU in b."""
        positions = np.full((len(times), 3), np.nan)
        for part, rows in self._parts_at(times):
            position = rows[:, OUT_POS : OUT_POS + 3]
            positions[part] = shift(position, quat_rotate_many(_unit(rows), lever)) if np.any(lever) else position
        return positions


def _every(rows: Array, step: int) -> Array:
    """Copy of every ``step``-th row."""
    chosen = np.arange(0, len(rows), step)
    out = np.empty((len(chosen), rows.shape[1]))
    for part in pieces(len(chosen), max(AT_ONCE // step, 1)):
        out[part] = rows[chosen[part]]
        release(rows)
    return out


def _unit(rows: Array) -> Array:
    q = rows[:, OUT_QUAT : OUT_QUAT + 4]
    return q / np.linalg.norm(q, axis=1, keepdims=True)


def shift(position: Array, enu: Array) -> Array:
    """``position`` (..., 3) moved by ``enu`` (..., 3) [m]."""
    r_m, r_n = radii_many(position[..., 0])
    lat = position[..., 0] + enu[..., 1] / (r_m + position[..., 2])
    lon = position[..., 1] + enu[..., 0] / ((r_n + position[..., 2]) * np.cos(position[..., 0]))
    return np.stack([lat, lon, position[..., 2] + enu[..., 2]], axis=-1)


class TrackRecorder:
    """Collects blocks of solutions, decimated to at most ``rate_hz`` rows per second."""

    def __init__(self, epoch_ns: int, rate_hz: float = TRACK_HZ) -> None:
        self._epoch_ns = epoch_ns
        self._slot_ns = max(round(1e9 / rate_hz), 1)
        self._last_slot = -(1 << 62)
        self._stamps: list[Array] = []
        self._rows = RowStore(OUT_COLUMNS)
        self._waiting: list[NavBlock] = []  # decimated together, because blocks may consist of one sample
        self._waiting_rows = 0

    def add(self, block: NavBlock) -> None:
        """Store the first row of ``block`` in every time slot."""
        self._waiting.append(block)
        self._waiting_rows += len(block.stamps_ns)
        if self._waiting_rows >= AT_ONCE:
            self._thin_out()

    def _thin_out(self) -> None:
        if not self._waiting:
            return
        stamps = np.concatenate([block.stamps_ns for block in self._waiting])
        slots = stamps // self._slot_ns
        fresh = np.empty(len(slots), bool)
        fresh[0], fresh[1:] = slots[0] != self._last_slot, slots[1:] != slots[:-1]
        self._stamps.append(stamps[fresh])
        self._rows.append(np.concatenate([block.rows for block in self._waiting])[fresh])
        self._last_slot = int(slots[-1])
        self._waiting, self._waiting_rows = [], 0

    def track(self) -> Track:
        """The stored rows, sorted by time, which is only necessary after a clock that went back."""
        self._thin_out()
        if not self._stamps:
            return Track(np.empty(0), np.empty((0, OUT_COLUMNS)))
        t = (np.concatenate(self._stamps) - self._epoch_ns) * 1e-9
        rows = self._rows.table()
        if np.any(np.diff(t) < 0.0):
            order = np.argsort(t, kind="stable")
            t, rows = t[order], rows[order]
        return Track(t, rows)


@dataclass(frozen=True)
class Reference:
    """Reference for the estimate. ``kind`` is "ground truth" or "GNSS"; ``velocity`` (N, 3) may contain NaN."""

    kind: str
    t: Array
    position: Array  # (N, 3) latitude, longitude, height
    velocity: Array | None = None
    q_nb: Array | None = None

    def __len__(self) -> int:
        return len(self.t)

    def thinned(self, largest: int) -> "Reference":
        """The reference, decimated by an integer factor to at most ``largest`` entries."""
        step = -(-len(self.t) // largest)
        if step <= 1:
            return self
        velocity, q_nb = (None if part is None else _every(part, step) for part in (self.velocity, self.q_nb))
        return Reference(self.kind, self.t[::step], _every(self.position, step), velocity, q_nb)

    def at(self, times: Array) -> Array:
        """(M, 3) latitude, longitude, height at ``times``; NaN outside."""
        if len(self.t) == 0:
            return np.full((len(times), 3), np.nan)
        columns = []
        for i in range(3):
            columns.append(np.interp(times, self.t, self.position[:, i], left=np.nan, right=np.nan))
            release(self.position)
        return np.stack(columns, axis=-1)

    def travelled(self, start: float, end: float) -> float:
        """Horizontal distance [m] from ``start`` to ``end``: the integral of the speed, else the length of the path."""
        inside = (self.t > start) & (self.t < end)
        t = np.concatenate([[start], self.t[inside], [end]])
        if len(t) < 4 or end - start > 2.0 * (t[-2] - t[1]):
            return float("nan")
        if self.velocity is not None:
            around = self._with_known_neighbours(np.flatnonzero(inside))
            speed = np.linalg.norm(self.velocity[around, :2], axis=1)
            release(self.velocity)
            known = np.isfinite(speed)
            if known[inside[around]].all():
                at_t = np.interp(t, self.t[around][known], speed[known])
                return float((np.diff(t) * (at_t[1:] + at_t[:-1]) / 2.0).sum())  # trapezoidal rule
        position = self.at(np.clip(t, self.t[0], self.t[-1]))
        steps = np.diff(displacement_enu(position, position[0])[:, :2], axis=0)
        return float(np.linalg.norm(steps, axis=1).sum())

    def _with_known_neighbours(self, chosen: Array) -> slice:
        """Slice from the last known velocity before ``chosen`` (M,) to the first one after them, if there are any."""
        assert self.velocity is not None
        first, last = max(int(chosen[0]) - 1, 0), min(int(chosen[-1]) + 1, len(self.t) - 1)
        while first > 0 and not np.isfinite(self.velocity[first, :2]).all():
            first -= 1
        while last < len(self.t) - 1 and not np.isfinite(self.velocity[last, :2]).all():
            last += 1
        return slice(first, last + 1)


def gnss_reference(gnss: GnssColumns, epoch_ns: int, delay: float) -> Reference:
    """Reference of the fixes of a receiver, each at its time of validity (stamp minus ``delay`` [s])."""
    rows, stamps = gnss.fixes, gnss.fix_ns
    good = np.isfinite(rows).all(axis=1) & (rows[:, 3] >= 0.0) & (stamps > 0)
    stamps, first = np.unique(stamps[good], return_index=True)  # in order of time, repeated fixes once
    velocity = _velocities_at(stamps, gnss) if len(gnss.velocity_ns) else None
    return Reference("GNSS", (stamps - epoch_ns) * 1e-9 - delay, rows[good][first, :3], velocity)


def _velocities_at(stamps: Array, gnss: GnssColumns) -> Array:
    """Velocities (N, 3) closest in time to ``stamps`` (N,); NaN where there is none within ``_SAME_EPOCH_NS``."""
    known, first = np.unique(gnss.velocity_ns, return_index=True)
    values = gnss.velocities[first]
    after = np.clip(np.searchsorted(known, stamps), 0, len(known) - 1)
    before = np.maximum(after - 1, 0)
    nearest = np.where(np.abs(known[before] - stamps) < np.abs(known[after] - stamps), before, after)
    found = values[nearest]
    found[np.abs(known[nearest] - stamps) > _SAME_EPOCH_NS] = np.nan
    return found
