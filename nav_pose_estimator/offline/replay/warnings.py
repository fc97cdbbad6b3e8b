"""Warnings of a replay: one line for each kind of event, with its number, its first time and a remedy."""

from dataclasses import dataclass

from nav_pose_estimator.engine.events import catalogue
from nav_pose_estimator.engine.solutions import Level
from nav_pose_estimator.offline.replay.replay import ReplayResult

_MODES = "mode."  # prefix of events that are left out, because the modes of a replay are reported separately


@dataclass(frozen=True)
class Warned:
    """One kind of event. ``first_s`` [s since the first stamp] is None for an event without a stamp."""

    name: str
    level: str
    count: int
    first_s: float | None
    text: str  # of the first event
    cure: str

    @property
    def sentence(self) -> str:
        """For the terminal."""
        since = "without a stamp" if self.first_s is None else f"at {self.first_s:.1f} s"
        when = since if self.count == 1 else f"{self.count} times, first {since}"
        word = "error" if self.level == Level.ERROR.name else "warning"
        return f"{word}: {self.text} ({self.name}: {when})" + (f"; cure: {self.cure}" if self.cure else "")


def warnings(result: ReplayResult) -> list[Warned]:
    """Every kind of event at level WARN or ERROR, in the order in which they first happened."""
    recording = result.recording
    counters = {**result.status.counters, **recording.counters}
    events = [*recording.events, *result.record.events]
    found: dict[str, Warned] = {}
    for event in sorted(events, key=lambda event: event.stamp_ns):
        if event.level.value < Level.WARN.value or event.name.startswith(_MODES) or event.name in found:
            continue
        same = sum(other.name == event.name for other in events)
        first = (event.stamp_ns - recording.epoch_ns) * 1e-9 if event.stamp_ns > 0 else None
        entry = catalogue.find(event.name)
        cure = "" if entry is None else entry.cure
        count = max(counters.get(event.name, 0), same)
        found[event.name] = Warned(event.name, event.level.name, count, first, event.text, cure)
    return list(found.values())
