"""Mounting and calibration of an IMU: from the published samples to calibrated values in body axes (FLU)."""

import math
from collections.abc import Sequence

import numpy as np

from nav_pose_estimator.core.numerics.axes import FRD_FLU
from nav_pose_estimator.engine.parameters.imu import ImuParameters
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, Vector3


def axes_matrix(parameters: ImuParameters) -> np.ndarray:
    """C_bs (3, 3) from published sensor axes (``convention``, then ``mounting_rpy``) to body axes FLU."""
    matrix = rotation_from_rpy(parameters.mounting_rpy)
    if parameters.convention == "frd":
        matrix = matrix @ np.diag(FRD_FLU)
    exact = np.round(matrix)  # quarter turns become exact, without rounding errors of 6e-17
    return np.where(np.abs(matrix - exact) < 1e-12, exact, matrix)


def rotation_from_rpy(rpy: Sequence[float]) -> np.ndarray:
    """Rotation matrix (3, 3) of roll, pitch, yaw [rad] about the fixed axes x, y, z."""
    roll, pitch, yaw = rpy
    cr, sr, cp, sp, cy, sy = (f(a) for a in (roll, pitch, yaw) for f in (math.cos, math.sin))
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


class Mounting:
    """Calibrates published samples and rotates them into body axes; free of cost where neither is configured."""

    def __init__(self, parameters: ImuParameters) -> None:
        matrix = axes_matrix(parameters)
        self._rows = None if np.array_equal(matrix, np.eye(3)) else [tuple(row) for row in matrix.tolist()]
        self._bias = parameters.accel_bias
        self._gain = tuple(1.0 / (1.0 + scale) for scale in parameters.accel_scale)
        self._calibrated = any(parameters.accel_bias) or any(parameters.accel_scale)
        self.is_none = self._rows is None and not self._calibrated
        """Whether samples are in body axes as they come, and not calibrated."""

    def vector(self, vector: Vector3) -> Vector3:
        """A vector (or three columns of vectors) in the sensor's axes, rotated into body axes."""
        if self._rows is None:
            return vector
        x, y, z = vector
        a, b, c = self._rows
        return a[0] * x + a[1] * y + a[2] * z, b[0] * x + b[1] * y + b[2] * z, c[0] * x + c[1] * y + c[2] * z

    def force(self, force: Vector3) -> Vector3:
        """A published specific force (or three columns of them), calibrated and in body axes [m/s^2]."""
        if self._calibrated:
            fx, fy, fz = force
            (bx, by, bz), (gx, gy, gz) = self._bias, self._gain
            force = (gx * (fx - bx), gy * (fy - by), gz * (fz - bz))
        return self.vector(force)

    def sample(self, sample: ImuSample) -> ImuSample:
        """A sample, calibrated and in body axes."""
        if self.is_none:
            return sample
        return ImuSample(sample.stamp_ns, self.vector(sample.gyro), self.force(sample.accel))

    def block(self, block: ImuBlock) -> ImuBlock:
        """A block, calibrated and in body axes; bit-identical to its single samples."""
        if self.is_none:
            return block
        # Sums of columns round exactly like the scalar form; a matrix product might not.
        gyro = np.column_stack(self.vector(tuple(block.gyro.T)))
        return ImuBlock(block.stamps_ns, gyro, np.column_stack(self.force(tuple(block.accel.T))))
