"""A simulated recording as the replay and the benchmarks take it, without a bag in between."""

from pathlib import Path

import numpy as np

from nav_pose_estimator.offline.flights.recording import Recording
from nav_pose_estimator.offline.flights.tracks import Reference
from nav_pose_estimator.sim.recording import Recording as Simulated


def in_memory(simulated: Simulated) -> Recording:
    """What ``recording.load`` makes of the bag of ``simulated``, without the bag's rounding of the truth.

    Seconds count from the first IMU stamp, to which the simulator gives its time zero.
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
