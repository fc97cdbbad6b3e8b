"""What becomes of each sample that is not the IMU's: an observation on the time line, or a help for the alignment."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from nav_pose_estimator.engine.navigator import heading_trial, start_up
from nav_pose_estimator.engine.navigator.filter_run import FilterRun
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.navigator.split_filter import MOTION
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.samples import (
    Airspeed,
    AttitudeSample,
    DifferentialPressure,
    GnssFix,
    GnssVelocity,
    MotionEvidence,
    NavigatorVelocity,
    RangeToGround,
    ReturnDecision,
    Sample,
    SatelliteCount,
    SetPose,
    VelocityError,
)
from nav_pose_estimator.engine.sensors.aids import AIDS
from nav_pose_estimator.engine.sensors.magnetometer import Magnetometer
from nav_pose_estimator.engine.solutions import Level

_UNEVENTFUL = frozenset((AttitudeSample, NavigatorVelocity, *(aid.sample for aid in AIDS if aid.kind.quiet)))
"""Samples that change neither mode nor GNSS unless an observation comes of them."""


def take(run: FilterRun, sample: Sample) -> None:
    """Take one sample that is not the IMU's."""
    kind = type(sample)
    if kind not in _UNEVENTFUL:
        run.quiet_until = -float("inf")
    _HANDLERS[kind](run, sample)


def _count(run: FilterRun, sample: SatelliteCount) -> None:
    if not run.clock.running:
        return
    t = run.now
    if sample.stamp_ns is not None:
        t = run.clock.seconds(sample.stamp_ns) - run.parameters.gnss.delay
    run.gnss.reception.count(sample, t)


def _fix(run: FilterRun, sample: GnssFix) -> None:
    t = run.clock.time_of(sample.stamp_ns, "gnss.rejected", run.journal)
    if t is None:
        return
    t -= run.parameters.gnss.delay
    if not run.gnss.reception.fix(sample, t, run.now):
        return
    if run.parameters.aids.declination_from_model:
        run.locate(sample)
    if run.timeline.running:
        run.observe(run.gnss.position.observe(sample, t))
        if run.trial is not None:
            run.aligner.fix(t, sample, run.gnss.reception.position_noise(sample))
            heading_trial.judge(run, run.trial, sample.stamp_ns)
    else:
        run.aligner.fix(t, sample, run.gnss.reception.position_noise(sample))
        run.try_start()


def _velocity(run: FilterRun, sample: GnssVelocity) -> None:
    t = run.clock.time_of(sample.stamp_ns, "gnss.rejected", run.journal)
    if t is None or not run.gnss.reception.velocity(sample):
        return
    observation = run.gnss.velocity.observe(sample, t - run.parameters.gnss.delay)
    assert observation.stated_R is not None
    run.aligner.velocity(observation.t, sample.vel_enu, observation.stated_R)
    if run.timeline.running:
        run.observe(observation)
        if run.trial is not None:
            heading_trial.judge(run, run.trial, sample.stamp_ns)
    else:
        run.try_start()


def _aid(run: FilterRun, sample: Any) -> None:
    aid = run.aids[type(sample)]
    t = run.clock.time_of(sample.stamp_ns, f"{aid.family}.rejected", run.journal)
    if t is None:
        return
    if run.timeline.running:
        run.observe(aid.observe(sample, t))
    elif isinstance(aid, Magnetometer):
        run.aligner.mag(t, aid.receive(sample))


def _motion(run: FilterRun, sample: MotionEvidence) -> None:
    t = run.clock.time_of(sample.stamp_ns, "outage.rejected", run.journal)
    if t is not None and run.timeline.running and run.modes.mode in DENIED:
        run.observe(Observation(t, sample.stamp_ns, MOTION, sample))
        run.aiding.bound_drift(t)
        run.journal.count("outage.evidence")


def _attitude(run: FilterRun, sample: AttitudeSample) -> None:
    t = run.clock.time_of(sample.stamp_ns, "attitude.rejected", run.journal)
    if t is not None and not run.timeline.running:
        run.aligner.attitude(t, sample)


def _set_pose(run: FilterRun, sample: SetPose) -> None:
    refusal = start_up.pose_refusal(sample, run.timeline.running)
    if refusal:
        text = f"set_pose is not used: {start_up.POSE_REFUSALS[refusal]}"
        run.journal.say(sample.stamp_ns, f"set_pose.rejected.{refusal}", Level.WARN, text)
        return
    assert run.origin is not None, "a running filter has an origin"
    run.timeline.settle()
    nav, P = run.timeline.filter.nav, run.timeline.filter.P
    start_up.set_pose(nav, P, sample, run.origin)
    run.timeline.start(nav, P)
    run.gnss.position.resets += 1
    run.journal.say(sample.stamp_ns, "set_pose", Level.INFO, "the pose was set from outside")


_RETURN_SAID = {
    True: ("gnss.return.accepted", "operator: the return of GNSS is accepted"),
    False: ("gnss.return.refused", "operator: the return of GNSS is refused; it has to prove itself again"),
}


def _return(run: FilterRun, sample: ReturnDecision) -> None:
    name, text = "gnss.return.none", "there is no return of GNSS that waits for a decision"
    if run.timeline.running:
        run.timeline.settle()
        if run.gnss.position.decide_return(sample.accept):
            name, text = _RETURN_SAID[sample.accept]
    run.journal.say(sample.stamp_ns, name, Level.INFO, text)


def _not_for_us(run: FilterRun, sample: Sample) -> None:
    """Meant for the estimators around this one."""


_HANDLERS: dict[type, Callable[[FilterRun, Any], None]] = {
    GnssFix: _fix,
    GnssVelocity: _velocity,
    SatelliteCount: _count,
    MotionEvidence: _motion,
    SetPose: _set_pose,
    ReturnDecision: _return,
    AttitudeSample: _attitude,
    NavigatorVelocity: _not_for_us,
    VelocityError: _not_for_us,
    Airspeed: _not_for_us,
    DifferentialPressure: _not_for_us,
    RangeToGround: _not_for_us,
    **{aid.sample: _aid for aid in AIDS},
}
