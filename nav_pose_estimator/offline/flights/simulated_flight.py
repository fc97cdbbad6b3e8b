"""Conversion of a simulated recording to the input of replay and benchmarks, without a bag in between."""

from pathlib import Path

import numpy as np

from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.flights.tracks import Reference
from nav_pose_estimator.sim.recording import Recording as Simulated


def in_memory(simulated: Simulated) -> Recording:
    """The recording that ``recording.load`` would read from the bag of ``simulated``, but with the unrounded truth.

    Times [s] are relative to the first IMU stamp, the time zero of the simulator.
    """
    stamps, truth = simulated.imu_data.block.stamps_ns, simulated.truth
    epoch_ns = int(simulated.imu.stamps_ns[0])
    position = np.column_stack([truth.lat, truth.lon, truth.alt])
    return Recording(
        path=Path(f"{simulated.imu_grade.name}_{simulated.scenario}_{simulated.seed}"),
        samples=list(simulated.samples()),
        epoch_ns=epoch_ns,
        duration=float(simulated.imu.stamps_ns[-1] - epoch_ns) * 1e-9,
        truth=Reference("ground truth", (stamps - epoch_ns) * 1e-9, position, truth.v_n, truth.q_nb),
    )
