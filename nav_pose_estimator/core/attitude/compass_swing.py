"""What is wrong with a compass, from its fields on known headings: the classical swing, as a running least squares fit.

With x + iy for a horizontal vector in level body axes and u the direction of magnetic North there, any linear
error of a magnetometer in level flight is

    field = a u + b conj(u) + c

|a| is the horizontal field and arg(a) a rotation of the sensor (coefficient A of the deviation), b a soft iron or
swapped axes (D and E), and c a hard iron, which turns with the vehicle (B and C). Source: Archibald Smith's deviation
coefficients, in US National Geospatial-Intelligence Agency, Handbook of Magnetic Compass Adjustment, chapter 2.
"""

import cmath
import math

import numpy as np

_ENOUGH_TURN = 0.05  # least eigenvalue of the mean of the regressors' products; a circle gives 1, 150 deg of it 0.05
_IRON = 0.5  # hard iron, in horizontal fields, that turns a heading by up to 30 deg
_TURNED = math.radians(30.0)


class CompassSwing:
    """Sums of the fit over the last ``memory`` seconds or so."""

    def __init__(self, memory: float) -> None:
        self._memory = memory
        self._products = [[0.0j] * 3 for _ in range(3)]
        self._fields = [0.0j] * 3
        self._seconds = 0.0

    def add(self, north: complex, field: complex, seconds: float) -> None:
        """A ``field`` in level body axes, x + iy, that stands for ``seconds``; ``north``: where it should point."""
        row = (north, north.conjugate(), 1.0 + 0.0j)
        keep = math.exp(-seconds / self._memory)
        for i, one in enumerate(row):
            weight = seconds * one.conjugate()
            self._fields[i] = keep * self._fields[i] + weight * field
            products = zip(self._products[i], row, strict=True)
            self._products[i] = [keep * so_far + weight * other for so_far, other in products]
        self._seconds = keep * self._seconds + seconds

    def coefficients(self) -> tuple[complex, complex, complex] | None:
        """(a, b, c) of the module's formula, None before the vehicle has turned far enough to tell them apart."""
        if not self._seconds or np.linalg.eigvalsh(self._products)[0] < _ENOUGH_TURN * self._seconds:
            return None
        a, b, c = np.linalg.solve(self._products, self._fields).tolist()
        return a, b, c

    def cause(self) -> str:
        """The likely cause of a wrong heading, one clause; empty before the vehicle has turned far enough."""
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
