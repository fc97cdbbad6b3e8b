"""What is done with the beams: the recommended judge, parts of it, and the neuro-fuzzy network in several roles."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.beams.judge import LOST, OUT, USED, BeamJudge, Judged, Parts
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import BeamVelocitySample
from nav_pose_estimator.engine.sensors.beam_velocity import BeamVelocitySensor

Array = NDArray[np.float64]


@dataclass
class Watched(BeamJudge):
    """A judge whose verdicts are kept, one (n,) for every message."""

    verdicts: list[NDArray[np.int64]] = field(default_factory=list)

    def judge(self, z: Array, H: Array, P: Array, nominal: Array, are_beams: bool) -> Judged:
        """The same, remembered."""
        judged = super().judge(z, H, P, nominal, are_beams)
        self.verdicts.append(judged.verdict.copy())
        return judged
