"""Compass swing: cause of a compass error, by a running least-squares fit of the field on known headings.

A horizontal vector in level body axes is written x + iy, and u is the direction of magnetic North in them. Any linear
error of a magnetometer in level flight then has the form

    field = a u + b conj(u) + c

|a| is the horizontal field, arg(a) a rotation of the sensor about the vertical (coefficient A of the deviation). b is
soft iron or swapped axes (D and E), c is hard iron, which turns with the vehicle (B and C). Source: Archibald Smith's
deviation coefficients, in US National Geospatial-Intelligence Agency, Handbook of Magnetic Compass Adjustment, chapter
2.
"""

import cmath
import math

import numpy as np

from nav_pose_estimator.core.numerics.jit import kernel

# Observability: smallest eigenvalue of the normalised normal equations; a full circle gives 1, an arc of 150 deg 0.05.
_ENOUGH_TURN = 0.05
_IRON = 0.5  # hard iron, relative to the horizontal field, that is named as a cause; it deflects a heading by 30 deg
_TURNED = math.radians(30.0)  # rotation of the sensor about the vertical that is named as a cause


class CompassSwing:
    """The fit: normal equations with exponential forgetting over ``memory`` [s]."""

    def __init__(self, memory: float) -> None:
        self._memory = memory
        self._products, self._fields = np.zeros((3, 3), dtype=complex), np.zeros(3, dtype=complex)
        self._seconds = 0.0

    def add(self, north: complex, field: complex, seconds: float) -> None:
        """Add a horizontal ``field`` with weight ``seconds``, and the direction ``north`` (unit) that it should have.

        Both are x + iy in level body axes.
        """
        keep = math.exp(-seconds / self._memory)
        _add(self._products, self._fields, keep, seconds, north, field)
        self._seconds = keep * self._seconds + seconds

    def coefficients(self) -> tuple[complex, complex, complex] | None:
        """(a, b, c) of the module's formula; None before the vehicle has turned far enough to separate them."""
        if not self._seconds or np.linalg.eigvalsh(self._products)[0] < _ENOUGH_TURN * self._seconds:
            return None
        a, b, c = np.linalg.solve(self._products, self._fields).tolist()
        return a, b, c

    def cause(self) -> str:
        """Likely cause of a wrong heading, one clause for the user; empty before the vehicle has turned far enough."""
        found = self.coefficients()
        if found is None:
            return ""
        a, b, c = found
        if abs(b) > abs(a):
            return "axes of the magnetometer are swapped or inverted"
        if abs(c) > _IRON * abs(a):
            ratio = abs(c) / max(abs(a), 1e-3 * abs(c))
            return f"hard iron of about {ratio:.1f} times the Earth's horizontal field"
        if abs(cmath.phase(a)) > _TURNED:
            return (
                f"the magnetometer is turned by about {math.degrees(-cmath.phase(a)):.0f} deg about the vertical axis"
            )
        return "a field that comes and goes (currents, steel nearby)"


@kernel
def _add(products, fields, keep, seconds, north, field):
    """Fade the normal equations ``products`` (3, 3) and ``fields`` (3,) by ``keep``, and add one ``field``."""
    row = (north, north.conjugate(), 1.0 + 0.0j)
    for i in range(3):
        weight = seconds * row[i].conjugate()
        fields[i] = keep * fields[i] + weight * field
        for k in range(3):
            products[i, k] = keep * products[i, k] + weight * row[k]
