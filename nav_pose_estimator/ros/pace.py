"""Rates by stamps: which of many solutions are published. Asks no clock, so that a run can be repeated exactly."""


class Pace:
    """At most ``rate`` times a second of stamp time; rate 0: always."""

    def __init__(self, rate: float) -> None:
        self._period_ns = round(1e9 / rate) if rate > 0.0 else 0
        self._due_ns = 0

    def is_due(self, stamp_ns: int) -> bool:
        """Whether to publish at ``stamp_ns``; keeps the mean rate when stamps do not fall on the grid."""
        early = self._due_ns - stamp_ns
        if 0 < early <= self._period_ns:
            return False
        # on time, late, or (early by more than a period) in a new run
        on_grid = -self._period_ns < early <= 0
        self._due_ns = (self._due_ns if on_grid else stamp_ns) + self._period_ns
        return True
