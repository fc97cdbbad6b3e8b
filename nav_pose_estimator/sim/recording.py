"""A simulated recording: the true motion, and all samples in order of arrival."""

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
    """A simulated flight or drive.

    Times in seconds are relative to ``start_ns``. Row i of ``truth`` corresponds to row i of ``imu_data.block``.
    ``imu`` are the received rows, which differ only by faults of the IMU. ``others`` is in order of arrival.
    """

    scenario: str
    seed: int
    imu_grade: ImuGrade
    origin: Origin  # of the truth's East-North-Up coordinates, where the motion begins
    start_ns: int
    truth: Truth
    imu_data: ImuData
    imu: ImuBlock
    imu_arrivals_ns: np.ndarray
    others: list[Timed]

    def samples(self, blocks: bool = True) -> Iterator[Sample]:
        """All samples in order of arrival, IMU first at equal times; with ``blocks``, IMU samples as ``ImuBlock``."""
        row = 0
        for arrival_ns, sample in self.others:
            until = int(np.searchsorted(self.imu_arrivals_ns, arrival_ns, side="right"))
            yield from self._imu_samples(row, until, blocks)
            yield sample
            row = max(row, until)
        yield from self._imu_samples(row, len(self.imu), blocks)

    def arrivals(self) -> list[Timed]:
        """All samples, one by one, in order of their times of arrival."""
        return sorted(self._imu_arrivals() + self.others, key=lambda timed: timed.arrival_ns)

    def with_faults(self, *faults: Fault) -> "Recording":
        """The same recording with failing sensors, and the same true motion."""
        recording = self
        others = tuple(fault for fault in faults if fault.sensor is not ImuSample)
        if others:
            recording = replace(recording, others=apply(self.others, others, self.start_ns))
        imu = tuple(fault for fault in faults if fault.sensor is ImuSample)
        if imu:
            stream = apply(self._imu_arrivals(), imu, self.start_ns)
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
        """Error (..., 3) [m] East, North, Up of ``position`` (..., 3) relative to the truth at ``t`` (...) [s].

        ``position``: latitude, longitude [rad], ellipsoid height [m].
        """
        truth = self.truth
        true_lat, true_lon, true_alt = (np.interp(t, truth.t, column) for column in (truth.lat, truth.lon, truth.alt))
        lat, lon, alt = np.moveaxis(position, -1, 0)
        return lla_to_enu(lat, lon, alt, *self.origin) - lla_to_enu(true_lat, true_lon, true_alt, *self.origin)

    def _imu_arrivals(self) -> list[Timed]:
        return [Timed(*pair) for pair in zip(self.imu_arrivals_ns.tolist(), self.imu.samples(), strict=True)]

    def _imu_samples(self, first: int, last: int, blocks: bool) -> Iterator[Sample]:
        if last <= first:
            return
        block = self.imu.part(first, last)
        yield from [block] if blocks else block.samples()
