"""One rehearsal of an outage: a copy of the navigator flies without GNSS, on every way through the outage at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, fields
from operator import attrgetter
from typing import Any, NamedTuple, get_args

import numpy as np

from nav_pose_estimator.core.earth.ellipsoid import step_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter.kalman import horizontal_sd
from nav_pose_estimator.core.motion.epochs import PERIOD
from nav_pose_estimator.core.motion.regimes import Decisions
from nav_pose_estimator.core.motion.usual import SLOW
from nav_pose_estimator.core.numerics.snapshot import snapshot
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.navigator.sins import SinsEngine
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.outage.epochs import EpochCollector, joined_rows
from nav_pose_estimator.engine.outage.filter_bank import COAST, ONE_WAY, FilterBank, OfOneWay, without_gnss
from nav_pose_estimator.engine.outage.methods.air_velocity_guide import HOVER
from nav_pose_estimator.engine.outage.methods.method import Guide
from nav_pose_estimator.engine.samples import ImuBlock, ImuSample, Sample, joined
from nav_pose_estimator.engine.solutions import Mode, NavBlock

LENGTH_NS = 30_000_000_000


class Epoch(NamedTuple):
    """Samples that the copy gets together, and the aided navigator's ``velocity`` then, East and North [m/s]."""

    imu: ImuBlock | None
    others: list[Sample]
    velocity: tuple[float, float] | None

    @classmethod
    def of(cls, samples: list[Sample], velocity: tuple[float, float] | None) -> Epoch:
        """The epoch of ``samples`` in the order of arrival. The IMU's are joined."""
        imu = [sample for sample in samples if isinstance(sample, (ImuSample, ImuBlock))]
        others: list[Sample] = [sample for sample in samples if not isinstance(sample, (ImuSample, ImuBlock))]
        return cls(joined(imu) if imu else None, others, velocity)


_VALUES: dict[type, Callable[[Any], tuple]] = {
    kind: attrgetter(*(one.name for one in fields(kind))) for kind in get_args(Sample)
}
"""Kind of samples -> the values of its fields, of which each kind has several."""
Packed = tuple[ImuBlock | None, list[tuple[int, list[tuple], tuple[float, float] | None]]]
"""Epochs as few objects: the IMU's samples of all, and of each their number, the values of the others, the velocity."""


def packed(epochs: Sequence[Epoch]) -> Packed:
    """``epochs`` for ``pickle``, which takes long for many arrays and dataclasses."""
    blocks = [epoch.imu for epoch in epochs if epoch.imu is not None]
    rest = [
        (0 if imu is None else len(imu), [_bare(one) for one in others], velocity) for imu, others, velocity in epochs
    ]
    return joined(blocks) if blocks else None, rest


def unpacked(packed: Packed) -> list[Epoch]:
    """The epochs of ``packed``."""
    imu, rest = packed
    epochs, done = [], 0
    for count, others, velocity in rest:
        own = imu.part(done, done + count) if imu is not None and count else None
        epochs.append(Epoch(own, [kind(*values) for kind, *values in others], velocity))
        done += count
    return epochs


def _bare(sample: Sample) -> tuple:
    return type(sample), *_VALUES[type(sample)](sample)


class Outcome(NamedTuple):
    """The result of a rehearsal: way -> squared horizontal error at its end in ``squares`` [m^2].

    ``surprise``: the squared error of coasting over its stated variance. ``excess`` [m^2]: squared errors minus their
    stated variances. ``decisions`` between the regimes of motion on the way.
    """

    squares: dict[str, float]
    surprise: float
    excess: dict[str, float]
    decisions: Decisions


@dataclass
class Rehearsal:
    """One rehearsal: the copy of the navigator, with the ``guides`` of the ways and the epochs of each."""

    sins: SinsEngine
    guides: Mapping[str, Guide]
    collectors: dict[str, EpochCollector]
    epochs: list[Epoch] = field(default_factory=list)  # still to be flown
    tally: Decisions = field(default_factory=Decisions)  # decisions of the epochs flown so far

    @classmethod
    def of(cls, sins: SinsEngine, collector: EpochCollector, guides: Mapping[str, Guide]) -> Rehearsal:
        """A rehearsal from the present state of the navigator ``sins`` and of the ``collector`` of its epochs."""
        return cls(without_gnss(sins), guides, {name: snapshot(collector) for name in guides})

    def __getstate__(self) -> dict[str, Any]:
        """The state for another process."""
        return self.__dict__ | {"epochs": packed(self.epochs)}

    def __setstate__(self, state: dict[str, Any]) -> None:
        """Restore it in another process. Pickle leaves slow attributes, a copy has fast ones (``deep_copy``)."""
        self.__dict__ = state
        self.epochs = unpacked(state["epochs"])
        self.sins = self.sins.snapshot()

    def copy(self) -> Rehearsal:
        """An independent copy."""
        collectors = {name: snapshot(collector) for name, collector in self.collectors.items()}
        return Rehearsal(self.sins.snapshot(), self.guides, collectors, list(self.epochs), self.tally)

    @property
    def bank(self) -> FilterBank:
        """The filters."""
        bank = self.sins.run.timeline.filter
        assert isinstance(bank, FilterBank)
        return bank

    @property
    def has_restarted(self) -> bool:
        """Whether the copy had to start again, for a gap in the IMU data or other states, which invalidates all."""
        run = self.sins.run
        if run.unseen or self.sins.mode not in (*DENIED, Mode.AIDED):
            return True
        return not isinstance(run.timeline.filter, FilterBank) or run.timeline.filter.was_restarted

    def fly(self) -> None:
        """Fly the epochs collected so far, unless the copy restarts.

        In each, the other samples are fed ahead of the IMU's: an observation acts at its own time, however early it is
        known.
        """
        epochs, self.epochs = self.epochs, []
        for epoch in epochs:
            for sample in epoch.others:
                self.sins.feed(sample)
            if epoch.imu is not None:
                self._carry(epoch.imu)
            if self.has_restarted:
                return
            self.tally = self.tally + self._decided(epoch.velocity)

    def _carry(self, imu: ImuBlock) -> None:
        """Process IMU samples; at the end of an epoch, each guide advises its own way."""
        blocks = [output for output in self.sins.feed(imu) if isinstance(output, NavBlock)]
        if not blocks or self.has_restarted:
            return
        stamps = joined_rows([block.stamps_ns for block in blocks])
        coasting = joined_rows([block.rows for block in blocks])
        last, ways = blocks[-1], self.bank.ways
        for name, guide in self.guides.items():
            rows = ways[name].take_rows() if name in ways else coasting
            own = NavBlock(stamps, rows, last.mode, last.reset_count, last.correction_enu)
            if self.collectors[name].feed(own) is not None:
                for sample in guide.advise(int(stamps[-1]), self.collectors[name].recent).samples:
                    self._feed_way(name, sample)

    def _feed_way(self, name: str, sample: Sample) -> None:
        """Feed the navigator a ``sample`` of a guide; the resulting observations act on its own way alone."""
        run, taken = self.sins.run, list[Observation]()

        def take(observation: Observation) -> bool:
            taken.append(observation)
            return True

        run.take_observation = take
        try:
            self.sins.feed(sample)
        finally:
            run.take_observation = None
        for one in taken:
            run.observe(OfOneWay(one.t, one.stamp_ns, ONE_WAY, (name, one)))

    def _decided(self, velocity: tuple[float, float] | None) -> Decisions:
        """Decisions of one epoch at the true ``velocity``, by the last of the ways that distinguishes regimes."""
        square = 0.0 if velocity is None else 0.5 * (velocity[0] ** 2 + velocity[1] ** 2)
        if 2.0 * square < SLOW**2:
            return Decisions()
        for name in reversed(self.collectors):
            branches = self.bank.ways[name].branches if name in self.bank.ways else None
            if branches is not None and HOVER in branches.names:
                return Decisions(PERIOD * square, PERIOD * square * branches.probability(HOVER))
        return Decisions()

    def outcome(self, truth: np.ndarray, offset: np.ndarray, known: float) -> Outcome | None:
        """Fly it to its end and evaluate the errors; None where the copy had to restart.

        ``truth``: ``nav`` of the aided navigator at the end. ``offset`` (2,) [m]: its distance from the fixes, East and
        North, as ``Gnss.offset``. ``known`` [m]: its horizontal standard deviation.
        """
        self.fly()
        if self.has_restarted:
            return None
        self.sins.run.timeline.settle()
        views = dict(self.bank.views())
        squares, excess, variances = {}, {}, {}
        for name in (COAST, *self.guides):
            view = views.get(name, views[COAST])
            step = step_enu(truth[at.LAT : at.VEL], view.nav[at.LAT : at.VEL])
            squares[name] = float(np.square(step[:2] + offset).sum())
            # stated variance of its horizontal position, beyond that of the aided navigator
            variances[name] = float(horizontal_sd(view.P)) ** 2 - known**2
            # the variance that earlier rehearsals added must not hide a deficit of the stated one
            added = 2.0 * spread_psd(self.guides.get(name), hovered(self.tally)) * LENGTH_NS * 1e-9
            excess[name] = squares[name] - max(variances[name] - added, 0.0)
        surprise = squares[COAST] / max(variances[COAST], 1.0)
        return Outcome(squares, surprise, excess, self.tally)


def hovered(decisions: Decisions) -> bool:
    """Whether the vehicle hovered during a rehearsal, by its RMS speed where the regimes were distinguished."""
    return decisions.travelled < 0.5 * SLOW**2 * LENGTH_NS * 1e-9


def spread_psd(guide: Guide | None, hovers: bool) -> float:
    """Spectral density [m^2/s] that earlier rehearsals added to the stated position, hovering or travelling."""
    added = getattr(guide, "spread_psd", 0.0)
    return float(getattr(guide, "hover_spread_psd", added) if hovers else added)
