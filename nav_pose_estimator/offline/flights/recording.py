"""A recording: its samples in order, the true motion, which is withheld from estimators, and data from NAME.json."""

from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity, ImuBlock, Sample, joined
from nav_pose_estimator.engine.solutions import Event
from nav_pose_estimator.offline.bags.raw_messages import BagError, from_payloads
from nav_pose_estimator.offline.bags.reader import BagReader, SampleBatch
from nav_pose_estimator.offline.damaged_input import reading
from nav_pose_estimator.offline.flights.survey import Contents, Survey
from nav_pose_estimator.offline.flights.tracks import Reference, gnss_reference
from nav_pose_estimator.offline.flights.truth import TruthRecorder
from nav_pose_estimator.offline.sidecar import flight_name, sidecar

HELD_BYTES = 24 << 20
"""Memory for the samples of a short bag, which is read once: 15 minutes of a 200 Hz IMU with all sensors."""
_IMU_BYTES, _OTHER_BYTES = 56, 400  # memory of a sample
_STANDS = 0.9  # fraction of IMU samples with repeated stamps from which the clock counts as standing still


@dataclass
class Recording:
    """One flight. Times [s] are relative to its first stamp ``epoch_ns``, and go up to ``duration``.

    ``samples`` is a list in memory or a ``SampleStream``; ``known``: contents already found by a pass over them.
    ``notices`` are sentences for the user, ``events`` those of the conversion of messages. ``opinion``: the autopilot's
    own estimate in a flight log, for the report only.
    """

    path: Path
    samples: Iterable[Sample]
    epoch_ns: int
    duration: float
    truth: Reference | None = None
    notices: list[str] = field(default_factory=list)
    counters: Counter[str] = field(default_factory=Counter)
    sidecar: dict = field(default_factory=dict)
    events: list[Event] = field(default_factory=list)
    opinion: Reference | None = None
    known: Contents | None = None

    @property
    def name(self) -> str:
        """Name of the flight."""
        return flight_name(self.path)

    @property
    def held(self) -> list[Sample]:
        """The samples of a recording in memory (``load`` with ``hold``)."""
        assert isinstance(self.samples, list)
        return self.samples

    @cached_property
    def fixes(self) -> list[GnssFix]:
        """All fixes, in the order of arrival."""
        return [s for s in self.samples if isinstance(s, GnssFix)]

    @cached_property
    def velocities(self) -> list[GnssVelocity]:
        """All GNSS velocities, in the order of arrival."""
        return [s for s in self.samples if isinstance(s, GnssVelocity)]

    @cached_property
    def imu(self) -> ImuBlock:
        """All IMU samples, in the order of arrival."""
        return joined([s for s in self.samples if isinstance(s, ImuBlock)])

    @cached_property
    def contents(self) -> Contents:
        """Contents found by a pass over the samples."""
        return self.known or Contents.of(self.samples)

    @property
    def imu_count(self) -> int:
        """Number of IMU samples."""
        return self.contents.imu_count

    def reference(self, delay: float) -> Reference:
        """Ground truth if the bag has it, else the fixes at stamp minus ``delay`` [s]."""
        return self.truth or self.receiver(delay)

    def receiver(self, delay: float) -> Reference:
        """The fixes at stamp minus ``delay`` [s]."""
        return gnss_reference(self.contents.gnss, self.epoch_ns, delay)

    def fix_times(self, delay: float) -> np.ndarray:
        """Times of validity (M,) of the fixes, in order."""
        stamps, status = self.contents.gnss.fix_ns, self.contents.gnss.fixes[:, 3]
        return (np.unique(stamps[(status >= 0.0) & (stamps > 0)]) - self.epoch_ns) * 1e-9 - delay

    def seconds_of_log(self, log_seconds: float) -> float:
        """Seconds since the first stamp of a time on the clock of the original log (``NAME.json``)."""
        return log_seconds + self.sidecar.get("bag", {}).get("stamp_offset_s", 0.0) - self.epoch_ns * 1e-9


class SampleStream:
    """The samples of a bag. Those of a short one stay in memory; of a longer one, every iteration reads them again."""

    def __init__(self, path: Path, remaps: dict[str, str] | None, parameters: Parameters | None) -> None:
        self._path, self._remaps, self._parameters = path, remaps, parameters
        self._held: list[SampleBatch] | None = []
        self._bytes = 0

    def hold(self, batch: SampleBatch) -> None:
        """Keep the next samples of the bag, unless they are too many. All of it has to pass here once, or nothing."""
        if self._held is None:
            return
        self._bytes += _IMU_BYTES * len(batch.imu) + _OTHER_BYTES * len(batch.others)
        self._held.append(replace(batch, aside=from_payloads([], [], [])))
        if self._bytes > HELD_BYTES:
            self._held = None

    def __iter__(self) -> Iterator[Sample]:
        if self._held:
            for batch in self._held:
                yield from batch.samples()
            return
        with reading(self._path), BagReader(self._path, self._remaps, self._parameters) as reader:
            yield from reader.samples()


def load(
    path: Path | str,
    remaps: dict[str, str] | None = None,
    progress: Callable[[int], None] | None = None,
    parameters: Parameters | None = None,
    hold: bool = True,
) -> Recording:
    """Read a bag with the given ``parameters`` (``ros.input``). ``progress`` receives the number of IMU samples read.

    With ``hold`` False, the samples of a long bag are not stored: every iteration reads it again. Raises ``UserError``
    for a bag that cannot be read.
    """
    path = Path(path)
    with reading(path):
        return _load_bag(path, remaps, progress, parameters, hold)


def _load_bag(
    path: Path,
    remaps: dict[str, str] | None,
    progress: Callable[[int], None] | None,
    parameters: Parameters | None,
    hold: bool,
) -> Recording:
    survey, samples, stream = Survey(), list[Sample](), SampleStream(path, remaps, parameters)
    with BagReader(path, remaps, parameters) as reader:
        recorder = TruthRecorder(reader.topics.truth)
        for batch in reader.batches(reader.topics.truth):
            survey.take(batch)
            recorder.take(batch.aside)
            if hold:
                samples += batch.samples()
            else:
                stream.hold(batch)
            if progress is not None:
                progress(len(batch.imu))
        epoch_ns = _epoch(path, survey, reader)
        contents = survey.contents()
        truth, assumed = recorder.reference(reader, contents.gnss, epoch_ns)
        counters = reader.counters + reader.event_counts
        notices, events = reader.notices + assumed + _standing_clock(survey), reader.events
    return Recording(
        path=path,
        samples=samples if hold else stream,
        epoch_ns=epoch_ns,
        duration=(survey.last_ns - epoch_ns) * 1e-9,
        truth=truth,
        notices=notices,
        counters=counters,
        sidecar=sidecar(path),
        events=events,
        known=None if hold else contents,
    )


def _epoch(path: Path, survey: Survey, reader: BagReader) -> int:
    if not survey.imu_count:
        reasons = [*(event.text for event in reader.events), *reader.bag.warnings]
        why = next((f": {text}" for text in reasons if text), "")
        raise BagError(f"{path} holds no readable IMU message{why}")
    if survey.epoch_ns is None:
        raise BagError(f"{path}: every IMU message has the stamp zero; the driver must fill header.stamp")
    return survey.epoch_ns


def _standing_clock(survey: Survey) -> list[str]:
    """Sentence for the user if most IMU samples repeat a stamp; the estimator handles a few of them."""
    if survey.repeated < _STANDS:
        return []
    return [f"{100.0 * survey.repeated:.0f} % of the IMU samples repeat a stamp: the clock of the driver stands still"]
