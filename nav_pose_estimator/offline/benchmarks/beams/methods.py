"""Methods of the beams benchmark: the recommended judge, parts of it, and the neuro-fuzzy network in several roles."""

from __future__ import annotations

from collections.abc import Callable
from copy import deepcopy
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.beams.judge import LOST, OUT, USED, BeamJudge, Judged, Parts
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.parameters.schema import update
from nav_pose_estimator.engine.samples import BeamVelocitySample
from nav_pose_estimator.engine.sensors.beam_velocity import BeamVelocitySensor
from nav_pose_estimator.engine.sensors.beams.anfis_compensator import AnfisCompensator
from nav_pose_estimator.engine.sensors.beams.compensation import BeamEvidence, Compensator

Array = NDArray[np.float64]
_DOUBTED = 3.0  # standard deviations of a beam from which the patent's method compensates the predicted error

NOTHING = Parts(gate=False, parity=False, latch=False, noise=False)


@dataclass
class Watched(BeamJudge):
    """A judge that records its verdicts (n,) for every message."""

    verdicts: list[NDArray[np.int64]] = field(default_factory=list)

    def judge(self, z: Array, H: Array, P: Array, nominal: Array, are_beams: bool) -> Judged:
        """Judge, and record the verdict."""
        judged = super().judge(z, H, P, nominal, are_beams)
        self.verdicts.append(judged.verdict.copy())
        return judged


@dataclass
class EveryBeam(Watched):
    """Every available beam counts as faulty, so that a network replaces all of them at every message."""

    def judge(self, z: Array, H: Array, P: Array, nominal: Array, are_beams: bool) -> Judged:
        """All are out."""
        judged = super().judge(z, H, P, nominal, are_beams)
        return judged._replace(verdict=np.where(judged.verdict == USED, OUT, judged.verdict))


@dataclass
class TextsRule(Watched):
    """The rule of CN114459477B, step 5: a beam is faulty by its distance from the network, with the adapted noise."""

    network: Compensator | None = None

    def judge(self, z: Array, H: Array, P: Array, nominal: Array, are_beams: bool) -> Judged:
        """Reject the beams with a large predicted error."""
        judged = super().judge(z, H, P, nominal, are_beams)
        assert self.network is not None
        adapted = judged.spread - judged.nominal + judged.variance
        evidence = BeamEvidence(0.0, -z, adapted, judged.verdict != LOST)
        error, _ = deepcopy(self.network).predict(evidence)
        is_out = (judged.verdict == USED) & (np.abs(error) > _DOUBTED * np.sqrt(judged.nominal))
        return judged._replace(verdict=np.where(is_out, OUT, judged.verdict), spread=adapted)


@dataclass(frozen=True)
class Method:
    """A judge, and the treatment of the beams that it finds faulty."""

    description: str
    judge: Callable[[], Watched]
    compensation: str = "none"

    def parameters(self, parameters: Parameters) -> Parameters:
        """``parameters`` with the compensation of this method."""
        return update(parameters, {"aids.beams.compensation": self.compensation})

    def judge_of(self, engine: SinsEngine) -> Watched:
        """The judge in ``engine``."""
        judge = sensor_of(engine).judge
        assert isinstance(judge, Watched)
        return judge


RECOMMENDED = "full"
METHODS = {
    "fixed": Method("every beam with its nominal noise", lambda: Watched(NOTHING)),
    "variational": Method("every beam with variational noise (the filter of CN114459477B)",
                          lambda: Watched(NOTHING._replace(noise=True))),
    "gate": Method("a gate on each beam, nominal noise", lambda: Watched(NOTHING._replace(gate=True))),
    RECOMMENDED: Method("gate, parity, latch and variational noise: what the package does", Watched),
    "anfis": Method("the same; faulty beams compensated by the swarm-trained network", Watched, "anfis"),
    "anfis_frcg": Method("... by the network trained by conjugate gradient", Watched, "anfis_frcg"),
    "anfis_linear": Method("... by ridge regression", Watched, "anfis_linear"),
    "text": Method("variational noise; compensated where the network itself predicts a large error (the text's rule)",
                   lambda: TextsRule(NOTHING._replace(noise=True)), "anfis"),
    "always": Method("every beam compensated at every message", lambda: EveryBeam(NOTHING), "anfis"),
}  # fmt: skip
"""By name; what is not in ``TABLE`` is the network's ablation."""
TABLE = ("fixed", "variational", "gate", RECOMMENDED, "anfis")


def prepared(engine: SinsEngine, method: str) -> SinsEngine:
    """``engine`` with the judge of ``method``, before anything has been fed to it."""
    sensor = sensor_of(engine)
    judge = METHODS[method].judge()
    if isinstance(judge, (TextsRule, EveryBeam)):
        sensor.compensator = AnfisCompensator(cautious=False)
    if isinstance(judge, TextsRule):
        judge.network = sensor.compensator
    sensor.judge = judge
    return engine


def sensor_of(engine: SinsEngine) -> BeamVelocitySensor:
    """The sensor of the beams in ``engine``."""
    sensor = engine.run.aids[BeamVelocitySample]
    assert isinstance(sensor, BeamVelocitySensor)
    return sensor
