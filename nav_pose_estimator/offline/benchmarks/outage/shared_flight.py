"""An aided flight that several methods learn from, because with GNSS they all have the same navigator."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

from nav_pose_estimator.engine.composed.pose_estimator import PoseEstimator, Snapshot
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.outage.aid import OutageAid
from nav_pose_estimator.engine.outage.pilot import OutageHelp
from nav_pose_estimator.engine.outage.rehearsals import at_its_end
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import Sample
from nav_pose_estimator.engine.solutions import NavBlock, NavSolution


class SharedFlight:
    """The estimator of the first method, and the learners of the others.

    At a real loss of GNSS the methods aid the navigator differently; from then on only the first one continues.
    """

    def __init__(self, parameters: Sequence[Parameters]) -> None:
        """``parameters``: one set for each method, which differ only in the outage method."""
        engines = [PoseEstimator(own, attitude=False, rehearse=at_its_end) for own in parameters]
        self.engine = engines[0]
        self._learners = _Learners([engine.outage_aid for engine in engines])
        self.engine.outage_aid = self._learners

    def snapshots(self) -> list[Snapshot]:
        """For each method that still takes part, an estimator as if it had been run alone."""
        whole = self.engine.snapshot()
        return [replace(whole, outage_aid=aid and aid.copy()) for aid in self._learners.aids]


class _Learners(OutageAid):
    """Stands for one aid: all of them receive samples and learn, and the first one aids; None: a method without aid."""

    def __init__(self, aids: Sequence[OutageAid | None]) -> None:
        self.aids = list(aids)

    def copy(self) -> _Learners:
        """Return a placeholder, because ``SharedFlight.snapshots`` copies each aid by itself."""
        return _Learners([])

    def reset(self) -> None:
        for aid in filter(None, self.aids):
            aid.reset()

    def wrong_class(self) -> str:
        first = self.aids[0] if self.aids else None
        return "" if first is None else first.wrong_class()

    def hear(self, sample: Sample) -> None:
        for aid in filter(None, self.aids):
            aid.hear(sample)

    def step(self, output: NavBlock | NavSolution, sins: SinsEngine) -> OutageHelp:
        helps = [OutageHelp() if aid is None else aid.step(output, sins) for aid in self.aids]
        if len(helps) > 1 and any(help_.samples for help_ in helps):
            del self.aids[1:]
        return helps[0]
