"""Base class of the nodes: parameters, inputs, time guard, events, diagnostics and services around one engine."""

from collections.abc import Callable, Sequence
from typing import Any

from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration
from rclpy.node import Node

from nav_pose_estimator.engine import first_run
from nav_pose_estimator.engine.parameters import Parameters
from nav_pose_estimator.engine.samples import stamp_of
from nav_pose_estimator.engine.solutions import AttitudeSolution, Event, Level, Mode, NavSolution, Status
from nav_pose_estimator.errors import described
from nav_pose_estimator.ros import services, wording
from nav_pose_estimator.ros.diagnostics import Diagnostics
from nav_pose_estimator.ros.load.intake import Intake
from nav_pose_estimator.ros.logbook import Logbook
from nav_pose_estimator.ros.messages.message_table import Source
from nav_pose_estimator.ros.messages.outgoing import is_finite, warm_up
from nav_pose_estimator.ros.parameters import LiveParameters, declare
from nav_pose_estimator.ros.time_guard import TimeGuard


class EstimatorNode(Node):
    """A node around one engine. Subclasses subscribe with ``listen`` and publish in ``publish``.

    No message can end the node: exceptions in callbacks are counted and reported in one sentence.
    """

    published: tuple[type, ...] = (NavSolution, AttitudeSolution)
    """Types of the engine's outputs that ``publish`` receives."""

    def __init__(self, name: str, make_engine: Callable[[Parameters], Any]) -> None:
        super().__init__(name)
        self.parameters = declare(self)
        self.logbook = Logbook(self.get_logger())
        first_run.compile_kernels(self.get_logger().info)
        self.engine = make_engine(self.parameters)
        self.engine.warm_up()
        warm_up()
        self._live = LiveParameters(self, self.parameters, self._set_parameters)
        self._guard = TimeGuard(round(self.parameters.ros.input.max_stamp_regression * 1e9))
        self._mode: Mode | None = None
        self.intake = Intake(self, self.parameters.ros.input)
        self._diagnostics = Diagnostics(self)
        # a steady clock, because diagnostics must also be published when /clock is missing
        period = self.parameters.ros.output.diagnostics_period
        self._timer = self.create_timer(period, self._on_timer, clock=Clock(clock_type=ClockType.STEADY_TIME))
        back = JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1), on_clock_change=False)
        self._jump = self.get_clock().create_jump_callback(back, post_callback=lambda _: self._guard.expect_restart())
        services.offer_reset(self)

    # --- inputs ----------------------------------------------------------------------------------------------------

    def listen(self, source: Source, needed: bool = False, choose: Callable[[bytes], bool] | None = None) -> None:
        """Subscribe to ``source``; if it is ``needed``, diagnostics warn while it is silent.

        With ``choose``, only messages are deserialised whose bytes it accepts. The outputs of other nodes arrive at
        hundreds of hertz, and deserialising all of them would cost more than using some.
        """
        self.intake.listen(source, needed, choose)

    def spare(self, flag: bool) -> None:
        """Omit work that can wait while ``flag`` is set (overload); for nodes that have such work."""

    def take(self, sample: Any) -> None:
        """Feed one sample to the engine and publish its outputs."""
        admission = self._guard.admit(sample)
        if admission.back_s > 0.0:
            stamp = min(filter(None, map(stamp_of, admission.samples)))
            reason = f"time went back by {admission.back_s:.1f} s"
            self.intake.forget()
            self.deliver(self.engine.reset(stamp, reason))
        for ready in admission.samples:
            sample = self.intake.grouped(ready)
            if sample is not None:
                self.deliver(self.engine.feed(sample))

    # --- outputs ---------------------------------------------------------------------------------------------------

    def deliver(self, outputs: Sequence[Any]) -> None:
        """Log events, publish solutions, report a change of mode at once."""
        for output in outputs:
            if isinstance(output, Event):
                self.logbook.note(output)
            elif type(output) not in self.published:
                continue  # blocks of solutions result only from blocks of samples, which nodes do not feed
            elif is_finite(output):
                if self.intake.passes(output):
                    self.publish(output)
            else:
                text = "a solution with NaN or infinite values was not published"
                self.logbook.note(Event(output.stamp_ns, "output.withheld.nan", Level.ERROR, text))
        mode = self.engine.mode
        if mode is not self._mode:
            self._mode = mode
            self._diagnostics.publish_status(*self._state(self.engine.status()))

    def describe(self, status: Status) -> wording.Description:
        """Level, sentence and facts for ~/status and diagnostics."""
        return wording.level_of(status), wording.sentence(status), wording.facts(status)

    def _state(self, status: Status) -> wording.Description:
        """``describe``, with the overload if there is one."""
        level, sentence, facts = self.describe(status)
        complaint = self.intake.complaint
        if complaint:
            level, sentence = max(level, wording.WARN), f"{sentence}; {complaint}"
        return level, sentence, [*facts, ("overload", complaint or "-")]

    def publish(self, solution: Any) -> None:
        """Publish one solution of the engine."""
        raise NotImplementedError

    def destroy_node(self) -> None:
        """Destroy the node, after its callback for jumps of the clock."""
        self._jump.unregister()
        super().destroy_node()

    # --- callbacks -------------------------------------------------------------------------------------------------

    def _on_timer(self) -> None:
        try:
            self.intake.look_back()
            status = self.engine.status()
            own = {k: v for k, v in self.logbook.counters.items() if k not in status.counters}
            self._diagnostics.publish(self._state(status), self.intake.watches, {**status.counters, **own})
        except Exception as error:
            self.note_failure("diagnostics", error)

    def reset(self, reason: str) -> None:
        """Restart the engine for the given reason."""
        self.deliver(self.engine.reset(self.newest_ns, reason))
        self._guard.forget()
        self.intake.forget()

    @property
    def newest_ns(self) -> int:
        """The newest stamp received."""
        return self._guard.newest_ns

    def _set_parameters(self, parameters: Parameters) -> None:
        self.parameters = parameters
        self.engine.set_parameters(parameters)
        self.say("parameters.changed", Level.INFO, "parameters were changed")

    def say(self, name: str, level: Level, text: str) -> None:
        """Count and log an event of the node itself."""
        self.logbook.note(Event(self.newest_ns, name, level, text))

    def note_failure(self, where: str, error: Exception) -> None:
        """Count and log an exception in the processing of a message or a call."""
        if not self.context.ok():
            return  # shutting down: publishers are gone
        text = f"{where}: {described(error)}; the message is not used"
        self.say(f"callback.failed.{where}", Level.ERROR, text)
