"""Beam velocities of a Doppler log or radar, with each beam as a separate observation.

A lost beam costs only its own information; a faulty one is detected by its own innovation and excluded
(``core.beams.judge``). Only two or more rejected beams together question the navigator. Directions and signs are
verified by data before anything is used (``core.beams.geometry``), and the whole sensor against GNSS while that is
good.
"""

from __future__ import annotations

import math
from typing import ClassVar, Self

import numpy as np

from nav_pose_estimator.core.beams.delay import velocity_at
from nav_pose_estimator.core.beams.judge import GATE, GATED, LOST, USED, BeamJudge, Judged
from nav_pose_estimator.core.filter import measurements
from nav_pose_estimator.core.filter.blocks import DVL, DVL_DELAY, Block, GaussMarkov
from nav_pose_estimator.core.filter.measurements import BEAMS
from nav_pose_estimator.engine.imu.mounting import rotation_from_rpy
from nav_pose_estimator.engine.journal import Journal
from nav_pose_estimator.engine.observation import LEFT_OUT, Decision, FilterView, Kind, Observation, Row, Use
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import BeamVelocitySample
from nav_pose_estimator.engine.sensors.aiding import Aiding
from nav_pose_estimator.engine.sensors.beams import words
from nav_pose_estimator.engine.sensors.beams.agreement import Accusation, Agreement
from nav_pose_estimator.engine.sensors.beams.arrangement import Arranged, Arrangement
from nav_pose_estimator.engine.sensors.beams.compensation import COMPENSATORS, BeamEvidence, Compensator
from nav_pose_estimator.engine.sensors.beams.delay_watch import DelayWatch
from nav_pose_estimator.engine.sensors.beams.message import Flaw, MessageReader, given_directions
from nav_pose_estimator.engine.sensors.beams.verification import Verification, deviation_of
from nav_pose_estimator.engine.sensors.sensor import Aid, Linearised
from nav_pose_estimator.engine.solutions import Level

_HOLDS = 3.0  # s after their last use for which beams bound the drift
_INFORMATIVE = 5.0  # standard deviations: a faster motion would show a wrong mounting


class BeamVelocitySensor(Aid):
    """One row for each beam in use."""

    kind = Kind("beam_velocity", holds=True)
    sample, family = BeamVelocitySample, "beam_velocity"
    bounds_drift = True
    blocks: ClassVar[dict[Block, GaussMarkov]] = {
        DVL: GaussMarkov((3e-5,) * BEAMS + (1e-5,) + (1e-6,) * 3),
        DVL_DELAY: GaussMarkov(1e-3),
    }

    def __init__(self, parameters: Parameters, aiding: Aiding, journal: Journal) -> None:
        super().__init__(parameters, aiding, journal)
        beams = self._beams = parameters.aids.beams
        given = given_directions(beams.directions)
        self._reader, self._verification = MessageReader(given), Verification(beams.sign, len(given) > 0)
        self._arrangement = Arrangement(rotation_from_rpy(beams.rpy))
        self._reported: set[str] = set()
        self.compare_anew()
        self._last_used = -math.inf  # s
        self._states = np.zeros(DVL.size)  # last estimate, for the status
        self._fresh: tuple[np.ndarray, np.ndarray] | None = None  # (z, H) of a decision, for the linearisation after it

    def set_parameters(self, parameters: Parameters) -> None:
        """New noise, mounting and initial deviations of the states."""
        beams = parameters.aids.beams
        self._floor, self._delay, self._rpy_sd = beams.sd**2, beams.delay, beams.rpy_sd
        self._lever = np.array(beams.lever)
        self.first_sd = {DVL: (beams.bias_sd,) * BEAMS + (beams.scale_sd,) + (beams.rpy_sd,) * 3}
        if beams.delay_sd > 0.0:
            self.first_sd[DVL_DELAY] = beams.delay_sd

    def compare_anew(self) -> None:
        """Start all tests again, because they compared with a velocity in wrong axes."""
        super().compare_anew()
        self.judge, self._was_out = BeamJudge(), [False] * BEAMS
        self._agreement, self._accusation = Agreement(), Accusation()
        self._delays = DelayWatch()
        self.compensator = COMPENSATORS[self._beams.compensation]()
        self._verification.compare_anew()
        self._reported.clear()

    def take_over(self, before: Self) -> None:
        """Keep the verified convention, the agreement with GNSS and the noise of the beams over an IMU gap."""
        self._verification, self._arrangement = before._verification, before._arrangement
        self.judge, self._was_out = before.judge, before._was_out
        self._agreement, self._reported = before._agreement, before._reported

    # --- on arrival --------------------------------------------------------------------------------------------------

    def observe(self, sample: BeamVelocitySample, t: float) -> Observation | None:
        """The observation of a message in which at least one beam has a velocity."""
        beams = self._reader.read(sample, self._floor)
        if isinstance(beams, Flaw):
            name = f"{self.family}.rejected.{beams.reason}"
            self._report_once(sample.stamp_ns, name, Level.WARN, f"beam velocities not used: {beams.text}")
            return None
        if np.isnan(beams.velocities).all():
            return self._refuse("lost")
        return Observation(t - self._delay, sample.stamp_ns, self.kind, beams)

    def _report_once(self, stamp_ns: int, name: str, level: Level, text: str) -> None:
        """An event the first time; later ones are only counted."""
        if name in self._reported:
            self._journal.count(name)
            return
        self._reported.add(name)
        self._journal.say(stamp_ns, name, level, text)

    # --- when it acts ------------------------------------------------------------------------------------------------

    def decide(self, o: Observation, f: FilterView) -> Decision:
        """Decide which beams are used, with which noise; none before the geometry is verified."""
        self._states = f.nav[DVL.estimates].copy()
        if self._verification.reading is None:
            self._verify(o, f)
            return LEFT_OUT
        arranged, gnss_is_good = self._arrangement.arrange(o.measured), self._aiding.gnss_is_good(o.t)
        change = self._delays.change(o.t, f, self._lever, gnss_is_good)
        z, H = self._rows(arranged, change, f)
        nominal = arranged.variances + self._delays.variance
        judged = self.judge.judge(z, H, f.P, nominal, arranged.are_beams)
        verdicts = judged.verdict.tolist()
        if gnss_is_good:
            self._delays.add(z, H, f)
            self._compare(o, verdicts, f)
        if self._agreement.contradicts:
            self._refuse("contradicts")
            return LEFT_OUT
        if not (gnss_is_good or self._agreement.is_proven):
            self._report_once(o.stamp_ns, *words.UNPROVEN)
            return LEFT_OUT
        self._report(o, verdicts, arranged.are_beams)
        variances = judged.variance.tolist()
        rows = [Row(i, variances[i]) for i, verdict in enumerate(verdicts) if verdict == USED]
        gated = [i for i, verdict in enumerate(verdicts) if verdict == GATED]
        if self._accusation.add(o.t, 0 if gnss_is_good else len(gated)):
            self._journal.count("beam_velocity.accusation")
            rows += _accusing(gated, z, judged)
        elif self.compensator is not None:
            rows += _compensated(self.compensator, gnss_is_good, BeamEvidence(o.t, -z, judged.spread, _flagged(judged)))
        if not rows:
            return LEFT_OUT
        self._fresh = z, H
        return Decision(Use.UNGATED, rows=tuple(rows), change=change)

    def _verify(self, o: Observation, f: FilterView) -> None:
        """Verify the convention by the message's own 3-D velocity, else by the navigator's while GNSS is good."""
        navigator = None
        if self._aiding.gnss_is_good(o.t):
            navigator = velocity_at(f.nav, self._lever), deviation_of(f, self._rpy_sd)
        event = self._verification.add(o.measured, self._arrangement, navigator, math.sqrt(self._floor))
        if event is not None:
            self._report_once(o.stamp_ns, *event)

    def _rows(self, arranged: Arranged, change: np.ndarray, f: FilterView) -> tuple[np.ndarray, np.ndarray]:
        blocks = int(f.constants[DVL.index]), int(f.constants[DVL_DELAY.index])
        directions, measured, _, are_beams = arranged
        return measurements.beam_velocities(
            f.nav, len(f.P), blocks, directions, measured, self._lever, change, are_beams
        )

    def _compare(self, o: Observation, verdicts: list[int], f: FilterView) -> None:
        """Compare the whole sensor with the navigator while GNSS is good."""
        refused, present = verdicts.count(GATED), len(verdicts) - verdicts.count(LOST)
        informative = False
        if 2 * refused > present or not self._agreement.is_proven:
            velocity = velocity_at(f.nav, self._lever)
            sd = math.hypot(math.sqrt(self._floor), deviation_of(f, self._rpy_sd))
            informative = math.hypot(*velocity) > _INFORMATIVE * sd
            if 2 * refused > present:
                self._verification.disagrees(o.measured, velocity, sd)
        if self._agreement.add(refused, present, informative):
            contradicts, delay = self._agreement.contradicts, self._delay + self._delays.missing
            event = self._verification.contradiction(delay) if contradicts else words.AGREES
            self._journal.say(o.stamp_ns, *event)
        elif self._agreement.is_proven and (late := self._delays.missing):
            self._report_once(o.stamp_ns, *words.delayed(self._delay + late, self._delays.sd))

    def linearise(self, o: Observation, f: FilterView) -> Linearised:
        """The rows of the beams that the decision names."""
        assert o.decision is not None
        assert o.decision.change is not None
        z, H = self._fresh or self._rows(self._arrangement.arrange(o.measured), o.decision.change, f)
        self._fresh = None
        numbers, variances, offsets = zip(*o.decision.rows, strict=True)
        chosen = list(numbers)
        if chosen != list(range(len(z))):  # some beams are excluded, or flagged ones follow the others
            z, H = z[chosen], H[chosen]
        R = np.zeros((len(z), len(z)))
        R.flat[:: len(z) + 1] = variances
        return z + offsets, H, R

    # --- outcome -----------------------------------------------------------------------------------------------------

    def note(self, o: Observation, f: FilterView, z: np.ndarray, status: int, nis: float) -> None:
        """Count the outcome, and note the time of the last use."""
        super().note(o, f, z, status, nis)
        if len(z) > 1:  # a single beam leaves the drift in two directions unbounded
            self._last_used = o.t

    def bounds_at(self, t: float) -> bool:
        """Whether beams have bounded the drift at ``t`` [s]."""
        return t - self._last_used < _HOLDS

    def _report(self, o: Observation, verdicts: list[int], are_beams: bool) -> None:
        """Count the verdict of each beam; events for beams that the latch excludes or takes back."""
        for i, verdict in enumerate(verdicts):
            self._journal.count(words.COUNTERS[i if are_beams else BEAMS][verdict])
        out = self.judge.out.tolist()
        if out != self._was_out:
            for are_out in (True, False):
                changed = [i + 1 for i in range(BEAMS) if out[i] is are_out is not self._was_out[i]]
                if changed:
                    self._journal.say(o.stamp_ns, *words.latched(changed, are_out))
            self._was_out = out

    def figures(self) -> dict[str, float]:
        """Status: estimated mounting and scale; noise factor and flag rate of each beam."""
        if self._verification.reading is None:
            return {}
        figures = {"beams.scale": float(self._states[BEAMS])}
        for name, angle in zip(("roll", "pitch", "yaw"), self._states[BEAMS + 1 :].tolist(), strict=True):
            figures[f"beams.mounting_{name}_deg"] = math.degrees(angle)
        if not math.isnan(self._delays.sd):
            figures["beams.delay"], figures["beams.delay_sd"] = self._delay + self._delays.estimate, self._delays.sd
        for i in range(self._arrangement.count):
            figures[f"beams.{i + 1}.bias"] = float(self._states[i])
            figures[f"beams.{i + 1}.noise_factor"] = float(self.judge.factors[i])
            figures[f"beams.{i + 1}.flag_rate"] = float(self.judge.flag_rates[i])
        return figures | ({} if self.compensator is None else self.compensator.figures())


def _accusing(gated: list[int], z: np.ndarray, judged: Judged) -> list[Row]:
    """Rows of beams that have long been rejected together without GNSS, with noise that makes their NIS ``GATE``."""
    variance = judged.nominal + z**2 / GATE - judged.spread
    return [Row(i, float(variance[i])) for i in gated]


def _flagged(judged: Judged) -> np.ndarray:
    """Which beams (n,) have been found faulty."""
    return (judged.verdict != USED) & (judged.verdict != LOST)


def _compensated(compensator: Compensator, gnss_is_good: bool, evidence: BeamEvidence) -> list[Row]:
    """Without GNSS: rows of faulty beams, corrected by their predicted errors; with GNSS the compensator learns."""
    if gnss_is_good:
        compensator.learn(evidence)
        return []
    error, variance = compensator.predict(evidence)
    answered = evidence.flagged & np.isfinite(error) & np.isfinite(variance)
    return [Row(i, float(variance[i]), float(error[i])) for i in np.flatnonzero(answered).tolist()]
