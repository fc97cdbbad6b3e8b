"""Inputs of a node: subscriptions, their monitoring, and processing in order of arrival however late the node is."""

import time
from collections.abc import Callable
from functools import partial
from typing import Any

from rclpy.serialization import deserialize_message

from nav_pose_estimator.engine.parameters.ros import InputParameters
from nav_pose_estimator.engine.samples import ImuSample, Sample
from nav_pose_estimator.engine.solutions import Event, Level
from nav_pose_estimator.ros import qos
from nav_pose_estimator.ros.inputs import message_class
from nav_pose_estimator.ros.load.inbox import Adapter, Inbox
from nav_pose_estimator.ros.load.input_watch import InputWatch
from nav_pose_estimator.ros.load.overload import HOPELESS, ImuGroups, Overload, SparseResults
from nav_pose_estimator.ros.messages.message_table import Source

_POLL_PERIOD = 0.02  # s between two polls of the middleware; a poll costs a third of an IMU sample's processing
_TURN = 0.5  # s: longest time of processing before timers and services are served
_FEW = 16  # messages between two polls while the node is behind


class Intake:
    """Passes messages from the middleware to ``node.take``.

    ``node`` also has ``note_failure``, ``logbook``, ``say``, and ``spare``, which is called with whether to omit work
    that can wait.
    """

    def __init__(self, node: Any, parameters: InputParameters) -> None:
        self.watches: list[InputWatch] = []
        self.overload = Overload(self._on_step)
        self._node, self._profile, self._relieve = node, qos.sensor(parameters.queue), parameters.relieve
        self._inbox, self._groups, self._sparse = Inbox(), ImuGroups(), SparseResults()
        self._look_at = 0.0

    def listen(self, source: Source, needed: bool, choose: Callable[[bytes], bool] | None) -> None:
        """Subscribe to ``source``; with ``choose``, only messages are deserialised whose bytes it accepts."""
        kind, from_bytes = message_class(source), source.from_bytes
        if choose is not None:
            wanted = choose

            def from_bytes(data: bytes) -> tuple[Any, ...]:
                return source.adapter(deserialize_message(data, kind)) if wanted(data) else ()

        watch, adapter = InputWatch(self._node, source.topic, needed), from_bytes or source.adapter
        self.watches.append(watch)
        callback = partial(self.receive, watch, adapter)
        raw = from_bytes is not None

        def misfit(text: str) -> None:
            self._node.say("qos.incompatible", Level.WARN, text)

        subscription = qos.subscribe(
            self._node, kind, source.topic, callback, self._profile, raw, on_lost=watch.lost, on_misfit=misfit
        )
        watch.attach(subscription)
        self._inbox.add(watch, adapter, subscription)

    def receive(self, watch: InputWatch, adapter: Adapter, message: Any) -> None:
        """Process a message: the callback of every subscription."""
        watch.taken()
        if self._inbox:
            self._inbox.put(watch, adapter, message)
        else:
            self._handle(watch, adapter, message)
        if time.monotonic() >= self._look_at:
            self.catch_up()

    def catch_up(self) -> None:
        """Process the waiting messages for ``_TURN`` at most. Exceptions are reported and do not end the node."""
        try:
            self._catch_up()
        except Exception as error:
            self._node.note_failure("inbox", error)
        self._look_at = time.monotonic() + _POLL_PERIOD

    def _catch_up(self) -> None:
        give_up, count = time.monotonic() + _TURN, 0
        self._inbox.collect()
        while self._inbox and (now := time.monotonic()) < give_up:
            arrival = self._inbox.next()
            if self._relieve:
                self.overload.note(arrival.lag, now)
            if self.overload.is_hopeless:
                self._give_up()
                break
            self._handle(arrival.watch, arrival.adapter, arrival.message)
            count += 1
            if count % _FEW == 0 or not self._inbox:
                self._inbox.collect()

    def look_back(self) -> None:
        """Process waiting messages and revise the overload; must be called periodically, also without messages."""
        self.catch_up()
        self.overload.look_back(time.monotonic())

    def grouped(self, sample: Sample) -> Sample | None:
        """``sample``, or under overload the mean of a group of IMU samples; None while the group is incomplete."""
        if not isinstance(sample, ImuSample) or (self.overload.group == 1 and not self._groups):
            return sample
        return self._groups.add(sample, self.overload.group)

    def forget(self) -> None:
        """Drop an incomplete group: a new run begins."""
        self._groups.forget()

    def passes(self, output: Any) -> bool:
        """Whether to publish ``output``: always, except that the rate is reduced under overload."""
        return not self.overload.step or self._sparse.passes(type(output), output.stamp_ns)

    @property
    def complaint(self) -> str:
        """Sentence that describes the overload; empty without one."""
        return self.overload.sentence(sum(watch.lost_so_far for watch in self.watches))

    def _handle(self, watch: InputWatch, adapter: Adapter, message: Any) -> None:
        watch.saw()
        try:
            for item in adapter(message):
                if isinstance(item, Event):
                    self._node.logbook.note(item)
                else:
                    self._node.take(item)
        except Exception as error:
            self._node.note_failure(watch.topic, error)

    def _give_up(self) -> None:
        self._inbox.give_up()
        self._node.say(
            "overload.dropped", Level.ERROR, f"more than {HOPELESS:g} s behind: the waiting messages were dropped"
        )

    def _on_step(self, before: int, step: int) -> None:
        self._node.spare(step > 0)
        if step > before:
            self._node.say("overload.step", Level.WARN, self.complaint)
        elif step == 0:
            self._node.say("overload.ended", Level.INFO, "the node keeps up again")
