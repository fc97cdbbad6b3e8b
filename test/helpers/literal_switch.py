"""The switch between two rules for R, literally as in the source on fine alignment by innovation detection.

It is a reference for comparison, which the package does not use. ``C(k) = H P H' + R`` is read as a chi-square test.
"""

from collections import deque

import numpy as np
from scipy.stats import chi2


class LiteralSwitch:
    """Steps 7 to 11: R from the window's innovations where they agree with the filter, else from differences."""

    WINDOW, MEMORY = 5, 0.95

    def __init__(self, R: np.ndarray, rules: str = "AB", floor: float = 0.01) -> None:
        """``floor`` on R over the first R; ``rules`` "A" or "B" use one of the two alone."""
        self.R, self._first, self._rules, self._floor = R.copy(), R.copy(), rules, floor
        self._recent: deque[np.ndarray] = deque(maxlen=self.WINDOW)
        self._nis: deque[float] = deque(maxlen=self.WINDOW)
        self._beta = 1.0
        self._residual: np.ndarray | None = None

    def next(self, z: np.ndarray, HPH: np.ndarray) -> np.ndarray:
        """R for the innovation ``z`` (m,)."""
        self._recent.append(np.outer(z, z))
        self._nis.append(float(z @ np.linalg.solve(HPH + self.R, z)))
        self._beta = self._beta / (self._beta + self.MEMORY)
        low, high = chi2.ppf((0.025, 0.975), len(z) * self.WINDOW) / self.WINDOW
        full = len(self._recent) == self.WINDOW
        if self._rules == "A" or (self._rules == "AB" and full and low < np.mean(self._nis) < high):
            alpha = np.trace(self._recent[-1]) / np.trace(np.mean(self._recent, axis=0)) - 1.0
            self.R = (1.0 + np.clip(alpha, -0.9, 4.0)) * self.R
        elif self._residual is not None:
            d = z - self._residual
            self.R = (1.0 - self._beta) * self.R + self._beta * 0.5 * np.outer(d, d)
        self.R = self._sound(self.R)
        return self.R

    def note(self, residual: np.ndarray) -> None:
        """Store the residual after the update."""
        self._residual = residual

    def _sound(self, R: np.ndarray) -> np.ndarray:
        """Variances within the floor and 100 of the first ones; correlations at most 0.9, none where that is not R."""
        first = self._first.diagonal()
        sd = np.sqrt(R.diagonal())
        correlation = np.clip(R / np.outer(sd, sd), -0.9, 0.9)
        np.fill_diagonal(correlation, 1.0)
        if np.linalg.eigvalsh(correlation)[0] < 0.05:
            correlation = np.eye(len(R))
        sd = np.sqrt(np.clip(R.diagonal(), self._floor * first, 100.0 * first))
        return correlation * np.outer(sd, sd)
