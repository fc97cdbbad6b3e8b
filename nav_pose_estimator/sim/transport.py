"""Model of the transport of messages from sensor to reader: jitter, delay, losses and bursts."""

from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.engine.samples import ImuSample
from nav_pose_estimator.sim.noise import stream
from nav_pose_estimator.sim.sensors import Timed


@dataclass(frozen=True)
class Transport:
    """The transport.

    ``jitter``: scale of a half-normal delay [s]. ``delay``: constant delay [s] of all samples except the IMU's.
    ``drop``: fraction of lost messages. Every ``burst_every`` [s] (0: never) messages are held for up to
    ``burst_length`` [s] and arrive together.
    """

    jitter: float = 0.0
    delay: float = 0.0
    drop: float = 0.0
    burst_every: float = 0.0
    burst_length: float = 0.1

    def carry(self, sent: list[Timed], start_ns: int, seed: int) -> list[Timed]:
        """The received messages, in order of arrival. Messages of one kind keep their order; stamps are unchanged."""
        rng = stream(seed, "transport")
        delays = np.abs(rng.standard_normal(len(sent))) * self.jitter
        lost = rng.random(len(sent)) < self.drop
        latest: dict[type, int] = {}
        arrived = []
        for timed, extra, is_lost in zip(sent, delays.tolist(), lost.tolist(), strict=True):
            if is_lost:
                continue
            kind = type(timed.sample)
            delay = extra + (0.0 if kind is ImuSample else self.delay)
            arrival = self._after_burst(timed.arrival_ns + round(delay * 1e9), start_ns)
            latest[kind] = max(arrival, latest.get(kind, arrival))
            arrived.append(timed._replace(arrival_ns=latest[kind]))
        return sorted(arrived, key=lambda timed: timed.arrival_ns)

    def _after_burst(self, arrival_ns: int, start_ns: int) -> int:
        if self.burst_every <= 0.0:
            return arrival_ns
        period, length = round(self.burst_every * 1e9), round(self.burst_length * 1e9)
        phase = (arrival_ns - start_ns) % period
        held = phase >= period - length
        return arrival_ns + (period - phase if held else 0)
