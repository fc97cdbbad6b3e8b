"""Rate limit by stamp time: which solutions are published. It reads no clock, so that a run is reproducible."""


class Pace:
    """Limit of ``rate`` [Hz] in stamp time; 0: no limit."""

    def __init__(self, rate: float) -> None:
        self._period_ns = round(1e9 / rate) if rate > 0.0 else 0
        self._due_ns = 0

    def is_due(self, stamp_ns: int) -> bool:
        """Whether to publish at ``stamp_ns``. The mean rate is kept when the stamps do not fall on its grid."""
        early = self._due_ns - stamp_ns
        if 0 < early <= self._period_ns:
            return False
        # on time, late, or early by more than a period, which means a new run
        on_grid = -self._period_ns < early <= 0
        self._due_ns = (self._due_ns if on_grid else stamp_ns) + self._period_ns
        return True
