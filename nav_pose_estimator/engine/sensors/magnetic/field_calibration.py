"""The magnetometer's calibration and mounting: from the field as published to the field in b, for whoever uses it."""

import numpy as np

from nav_pose_estimator.engine.imu.mounting import axes_matrix, rotation_from_rpy
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import Vector3


class FieldCalibration:
    """``C_bm S (m - h)``: hard iron h and soft iron S in the sensor's axes as published, C_bm its axes into the body.

    The magnetometer's axes are turned by ``aids.magnetometer_rpy`` against those of the IMU as published, and with them
    into the body. Sums are written out, so that one sample and columns of many give the same bits.
    """

    def __init__(self, parameters: Parameters) -> None:
        self._hard_iron = parameters.attitude.hard_iron
        soft_iron = np.array(parameters.attitude.soft_iron).reshape(3, 3)
        turn = axes_matrix(parameters.imu) @ rotation_from_rpy(parameters.aids.magnetometer_rpy)
        matrix = turn @ soft_iron
        self._rows = matrix.tolist()
        self._changes_nothing = not any(self._hard_iron) and np.array_equal(matrix, np.eye(3))

    def in_body(self, field: Vector3) -> Vector3:
        """A field (3,) as published, or three columns of fields, calibrated and in b; any unit if h is zero, else T."""
        if self._changes_nothing:
            return field
        x, y, z = (part - iron for part, iron in zip(field, self._hard_iron, strict=True))
        a, b, c = self._rows
        return a[0] * x + a[1] * y + a[2] * z, b[0] * x + b[1] * y + b[2] * z, c[0] * x + c[1] * y + c[2] * z
