"""Calibration and mounting of the magnetometer: from the published field to the field in b."""

import numpy as np

from nav_pose_estimator.engine.imu.mounting import axes_matrix, rotation_from_rpy
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import Vector3


class FieldCalibration:
    """``C_bm S (m - h)``: hard iron h and soft iron S in the published axes of the sensor, C_bm from these to b.

    C_bm is the rotation ``aids.magnetometer_rpy`` from the magnetometer's axes to the published axes of the IMU, then
    the mounting of the IMU. Sums are written out, so that a single sample and columns of many are bit-identical.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._hard_iron = parameters.attitude.hard_iron
        soft_iron = np.array(parameters.attitude.soft_iron).reshape(3, 3)
        turn = axes_matrix(parameters.imu) @ rotation_from_rpy(parameters.aids.magnetometer_rpy)
        matrix = turn @ soft_iron
        self._rows = matrix.tolist()
        self._changes_nothing = not any(self._hard_iron) and np.array_equal(matrix, np.eye(3))

    def in_body(self, field: Vector3) -> Vector3:
        """A published field (3,) or three columns of fields, calibrated and in b; in T, or any unit if h is zero."""
        if self._changes_nothing:
            return field
        x, y, z = (part - iron for part, iron in zip(field, self._hard_iron, strict=True))
        a, b, c = self._rows
        return a[0] * x + a[1] * y + a[2] * z, b[0] * x + b[1] * y + b[2] * z, c[0] * x + c[1] * y + c[2] * z
