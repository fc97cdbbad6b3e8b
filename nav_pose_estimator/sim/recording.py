"""What a simulated vehicle recorded: the truth, and every sample in the order in which it arrived."""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, Sample
from nav_pose_estimator.sim.faults import Fault, apply
from nav_pose_estimator.sim.imu_grades import ImuGrade
from nav_pose_estimator.sim.sensors import ImuData, Timed
from nav_pose_estimator.sim.trajectories import Origin, Truth


@dataclass(frozen=True)
class Recording:
    """A simulated flight or drive. Seconds count from ``start_ns``; row i of ``truth`` is row i of ``imu_data.block``.

    ``imu`` is what arrived, after faults: the same rows as long as no fault touches the IMU. ``others`` is in order of
    arrival.
    """

    scenario: str
    seed: int
    imu_grade: ImuGrade
    origin: Origin  # of the truth's East-North-Up coordinates: where the motion began
    start_ns: int
    truth: Truth
    imu_data: ImuData
    imu: ImuBlock
    imu_arrivals_ns: np.ndarray
    others: list[Timed]

    def samples(self, blocks: bool = True) -> Iterator[Sample]:
        """All samples in order of arrival, IMU first at equal times. ``blocks``: IMU samples come as ``ImuBlock``."""
        row = 0
        for arrival_ns, sample in self.others:
            until = int(np.searchsorted(self.imu_arrivals_ns, arrival_ns, side="right"))
            yield from self._imu_samples(row, until, blocks)
            yield sample
            row = max(row, until)
        yield from self._imu_samples(row, len(self.imu), blocks)

    def arrivals(self) -> list[Timed]:
        """All samples one by one with their times of arrival, in this order."""
        imu = [
            Timed(arrival, sample)
            for arrival, sample in zip(
                self.imu_arrivals_ns.tolist(), self._imu_samples(0, len(self.imu), False), strict=True
            )
        ]
        return sorted(imu + self.others, key=lambda timed: timed.arrival_ns)

    def with_faults(self, *faults: Fault) -> "Recording":
        """The same recording with failing sensors. The truth does not change."""
        recording = self
        others = tuple(fault for fault in faults if fault.sensor is not ImuSample)
        if others:
            recording = replace(recording, others=apply(self.others, others, self.start_ns))
        imu = tuple(fault for fault in faults if fault.sensor is ImuSample)
        if imu:
            single = zip(self.imu_arrivals_ns.tolist(), self._imu_samples(0, len(self.imu), False), strict=True)
            stream = apply([Timed(*pair) for pair in single], imu, self.start_ns)
            left: list[Any] = [timed.sample for timed in stream]
            block = ImuBlock(
                np.array([sample.stamp_ns for sample in left], dtype=np.int64),
                np.array([sample.gyro for sample in left]).reshape(-1, 3),
                np.array([sample.accel for sample in left]).reshape(-1, 3),
            )
            arrivals = np.array([timed.arrival_ns for timed in stream], dtype=np.int64)
            recording = replace(recording, imu=block, imu_arrivals_ns=arrivals)
        return recording

    def error_enu(self, t: np.ndarray | float, position: np.ndarray) -> np.ndarray:
        """East, North, Up (..., 3) [m] from where the vehicle was at ``t`` (...) [s] to ``position`` (..., 3).

        ``position``: latitude, longitude [rad], ellipsoid height [m].
        """
        truth = self.truth
        true_lat, true_lon, true_alt = (np.interp(t, truth.t, column) for column in (truth.lat, truth.lon, truth.alt))
        lat, lon, alt = np.moveaxis(position, -1, 0)
        return lla_to_enu(lat, lon, alt, *self.origin) - lla_to_enu(true_lat, true_lon, true_alt, *self.origin)

    def _imu_samples(self, first: int, last: int, blocks: bool) -> Iterator[Sample]:
        if last <= first:
            return
        block = self.imu.part(first, last)
        if blocks:
            yield block
            return
        rows = zip(block.stamps_ns.tolist(), block.gyro.tolist(), block.accel.tolist(), strict=True)
        for stamp, gyro, accel in rows:
            yield ImuSample(stamp, tuple(gyro), tuple(accel))
