"""Intake of all samples but the IMU's: each becomes an observation on the time line, or takes part in the alignment."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np

from nav_pose_estimator.core.earth.atmosphere import air_density, height_pressure
from nav_pose_estimator.core.earth.ellipsoid import lla_to_enu
from nav_pose_estimator.core.filter import layout as at
from nav_pose_estimator.core.filter import memory
from nav_pose_estimator.core.filter.blocks import blocks_of, enlarged, set_blocks, set_process
from nav_pose_estimator.engine.engine_clock import NS
from nav_pose_estimator.engine.navigator import heading_trial, start_up, status
from nav_pose_estimator.engine.navigator.filter_run import FilterRun, refuse_stamp
from nav_pose_estimator.engine.navigator.modes import DENIED
from nav_pose_estimator.engine.navigator.split_filter import MOTION
from nav_pose_estimator.engine.number_checks import is_position
from nav_pose_estimator.engine.observation import Observation
from nav_pose_estimator.engine.samples import (
    Airspeed,
    AttitudeSample,
    BodyVelocity,
    DifferentialPressure,
    GnssFix,
    GnssVelocity,
    Hypothesis,
    MotionEvidence,
    NavigatorVelocity,
    PressureSample,
    ReturnDecision,
    Sample,
    SatelliteCount,
    SetOrigin,
    SetPose,
    VelocityError,
    WaterPressure,
)
from nav_pose_estimator.engine.sensors import barometer
from nav_pose_estimator.engine.sensors.aids import AIDS
from nav_pose_estimator.engine.sensors.barometer import Barometer
from nav_pose_estimator.engine.sensors.body_velocity import BodyVelocitySensor
from nav_pose_estimator.engine.sensors.magnetometer import Magnetometer
from nav_pose_estimator.engine.sensors.sensor import Aid
from nav_pose_estimator.engine.solutions import Level

_OTHER_CLOCK = 1.0  # s between the stamps of magnetometer and IMU beyond which it is not used for the alignment
_CRUISE = 60.0  # s: correlation time of the velocity of a fixed wing in cruise
_UNEVENTFUL = frozenset((AttitudeSample, NavigatorVelocity, *(aid.sample for aid in AIDS if aid.kind.quiet)))
"""Samples that change neither the mode nor the state of GNSS, unless they become an observation."""
_BOUNDING = tuple(aid.sample for aid in AIDS if aid.bounds_at is not Aid.bounds_at)
"""Samples that may measure the velocity better than a learned prediction."""


def take(run: FilterRun, sample: Sample) -> None:
    """Take a sample of any sensor but the IMU."""
    kind = type(sample)
    if kind not in _UNEVENTFUL:
        run.quiet_until = -math.inf
    run.past.record(run, sample)
    _HANDLERS[kind](run, sample)


def _count(run: FilterRun, sample: SatelliteCount) -> None:
    if not run.clock.running:
        return
    t = run.now
    if sample.stamp_ns is not None:
        t = run.clock.seconds(sample.stamp_ns) - run.parameters.gnss.delay
    run.gnss.reception.count(sample, t)


def _fix(run: FilterRun, sample: GnssFix) -> None:
    t = run.clock.time_of(sample.stamp_ns, "gnss", run.journal)
    if t is None:
        return
    t -= run.parameters.gnss.delay
    if not run.gnss.reception.fix(sample, t, run.now):
        return
    sample = run.gnss.reception.without_bad_height(sample)
    place = run.gnss.reception.fix_track.position
    run.imu_physics.motion.fix(t, place.real, place.imag)
    if run.parameters.aids.declination_from_model:
        run.locate(sample)
    if run.timeline.running:
        run.observe(run.gnss.position.observe(sample, t))
        if run.trial is not None:
            run.start_up.fix(t, sample, run.gnss.reception.position_noise(sample))
            heading_trial.judge(run, run.trial, sample.stamp_ns)
    else:
        run.gnss.reception.refusal = ""  # it takes part in the alignment
        run.start_up.fix(t, sample, run.gnss.reception.position_noise(sample))
        run.try_start()


def _velocity(run: FilterRun, sample: GnssVelocity) -> None:
    t = run.clock.time_of(sample.stamp_ns, "gnss", run.journal)
    if t is None:
        return
    t -= run.parameters.gnss.delay
    usable = run.gnss.reception.velocity(sample, t)
    if usable is None:
        if run.gnss.reception.velocities.doubted:
            run.imu_physics.motion.velocity(t, None, sample.vel_enu)
        return
    t -= (sample.stamp_ns - usable.stamp_ns) * NS  # the receiver's velocity is older than its stamp
    observation = run.gnss.velocity.observe(usable, t)
    if not run.gnss.reception.velocity_scatter.is_on:  # else their changes show noise, not motion
        run.imu_physics.motion.velocity(observation.t, usable.vel_enu, sample.vel_enu)
        run.gnss.position.pull.velocity(observation.t, usable.vel_enu)
    if run.trial is not None or not run.timeline.running:
        run.start_up.velocity(observation.t, usable.vel_enu, run.gnss.reception.velocity_noise(usable))
    if run.timeline.running:
        run.observe(observation)
        if run.trial is not None:
            heading_trial.judge(run, run.trial, sample.stamp_ns)
    else:
        run.try_start()


def _aid(run: FilterRun, sample: Any) -> None:
    aid = run.aids[type(sample)]
    t = run.clock.time_of(sample.stamp_ns, aid.family, run.journal)
    if t is None:
        return
    if run.timeline.running:
        observation = aid.observe(sample, t)
        if observation is not None and (not aid.blocks or _give_blocks(run, aid)):
            run.observe(observation)
    elif isinstance(aid, Magnetometer):
        if abs(t - run.now) > _OTHER_CLOCK and run.parameters.aids.magnetometer:
            refuse_stamp(run, aid.family, sample.stamp_ns, t)
            return
        run.start_up.mag(t, aid.receive(sample))
    elif isinstance(sample, PressureSample):
        run.start_up.standard_height = barometer.standard_height(sample.pressure)


def _body_velocity(run: FilterRun, sample: BodyVelocity) -> None:
    """Omit a velocity that contradicts the IMU; once that is established, its effect on the filter is undone."""
    sensor, body = run.aids[BodyVelocity], run.imu_physics.motion.body
    assert isinstance(sensor, BodyVelocitySensor)
    if run.timeline.running and run.parameters.aids.body_velocity and not sample.is_learned:
        measured = sensor.in_body(sample)
        if measured is not None:
            body.velocity(sensor.time_of(run.clock.seconds(sample.stamp_ns)), measured)
        if body.fault or body.suspect:
            if sensor.refuse_axes(body.fault, sample.stamp_ns):
                run.gnss.reception.velocities.misled = True
            return
        if measured is not None:  # one that lacks an axis cannot be tested
            sensor.is_proven, sensor.possible_error = body.is_proven, body.possible_error
    _aid(run, sample)


def _give_blocks(run: FilterRun, aid: Aid) -> bool:
    """Add the states that ``aid`` needs to the filter; False while it is split, when that is impossible."""
    before = run.timeline.filter.constants
    added = {
        block: np.diag(np.broadcast_to(np.square(aid.first_sd[block]), block.size))
        for block in aid.blocks
        if block in aid.first_sd and not block.is_in(before)
    }
    if not added:
        return True
    whole = run.settled
    if whole.branches is not None:
        return False
    constants = before.copy()
    set_blocks(constants, {*blocks_of(constants), *added})
    for block in added:
        set_process(constants, block, aid.blocks[block])
    run.timeline.restart(constants, whole.nav, enlarged(whole.P, before, constants, added))
    return True


def _airspeed(run: FilterRun, sample: Airspeed) -> None:
    """A sample without a header is valid at the last IMU sample."""
    if sample.stamp_ns is None:
        if not run.clock.running:
            return
        sample = replace(sample, stamp_ns=run.clock.stamp(run.now))
    _aid(run, sample)


def _pressure(run: FilterRun, sample: PressureSample) -> None:
    """A pressure of the air, or of the water where the parameter says so."""
    in_water = run.parameters.aids.water_density > 0.0
    run.gnss.reception.velocities.barometric_height(
        math.nan if in_water else barometer.standard_height(sample.pressure)
    )
    _aid(run, WaterPressure(sample.stamp_ns, sample.pressure) if in_water else sample)


def _differential_pressure(run: FilterRun, sample: DifferentialPressure) -> None:
    """Convert to true airspeed with the air density from the barometer or, without one, from the height."""
    sensor = run.aids[PressureSample]
    pressure = sensor.pressure if isinstance(sensor, Barometer) else math.nan
    if math.isnan(pressure):
        pressure = height_pressure(float(run.timeline.filter.nav[at.ALT]))
    speed = math.sqrt(2.0 * max(sample.pressure, 0.0) / air_density(pressure))
    _aid(run, Airspeed(sample.stamp_ns, speed))


def _motion(run: FilterRun, sample: MotionEvidence) -> None:
    t = run.clock.time_of(sample.stamp_ns, "outage", run.journal)
    if t is not None and run.timeline.running and run.modes.mode in DENIED:
        if any(run.aids[kind].bounds_at(t) for kind in _BOUNDING):
            run.journal.count("outage.evidence.redundant")  # better than learned motion
            return
        if run.unseen:
            sample = _usual_speed(sample, run.parameters.gnss.reacquisition.max_speed)
            run.journal.count("outage.evidence.unseen")
        run.observe(Observation(t, sample.stamp_ns, MOTION, sample))
        run.aiding.bound_drift(t, MOTION.name)
        run.journal.count("outage.evidence")
        if sample.air_velocity is not None:
            run.journal.count("outage.evidence.network")


def _usual_speed(evidence: MotionEvidence, max_speed: float) -> MotionEvidence:
    """Reduce ``evidence`` to a prior on the speed, for an outage of which a part was not observed.

    Everything else in it assumes that velocity, heading and position were known when the outage began: otherwise a
    hover cannot be told from steady flight, and rehearsals, which begin with a known state, do not apply. For a vehicle
    whose mean velocity is not zero, a fixed wing or a car, ``max_speed`` [m/s] is taken as two standard deviations.
    """
    known = [one.velocity_var for one in evidence.hypotheses if one.velocity_var is not None]
    variance, seconds = (max(known), evidence.correlation) if known else ((0.5 * max_speed) ** 2, _CRUISE)
    usual = Hypothesis("travel", 1.0, variance, None, velocity_time=seconds)
    return replace(evidence, air_velocity=None, hypotheses=(usual,), drift_variance=1.0)


def _attitude(run: FilterRun, sample: AttitudeSample) -> None:
    t = run.clock.time_of(sample.stamp_ns, "attitude", run.journal)
    if t is not None and not run.timeline.running:
        run.start_up.attitude(t, sample)


def _set_pose(run: FilterRun, sample: SetPose) -> None:
    here = None
    if run.timeline.running and run.origin is not None:
        lat, lon, alt = run.settled.nav[at.LAT : at.VEL].tolist()
        here = lla_to_enu(lat, lon, alt, *run.origin)
    refusal = start_up.pose_refusal(sample, here, status.horizontal_deviation(run))
    if refusal:
        text = f"set_pose is not used: {start_up.POSE_REFUSALS[refusal]}"
        run.journal.say(sample.stamp_ns, f"set_pose.rejected.{refusal}", Level.WARN, text)
        return
    assert run.origin is not None, "a running filter has an origin"
    run.timeline.settle()
    nav, P = run.timeline.filter.nav, run.timeline.filter.P
    start_up.set_pose(nav, P, sample, run.origin)
    run.timeline.start(nav, P)
    run.pose_given = True
    run.gnss.position.resets += 1
    run.noise.interrupt()
    run.journal.say(sample.stamp_ns, "set_pose", Level.INFO, "the pose was set from outside")


def _set_origin(run: FilterRun, sample: SetOrigin) -> None:
    """Move the origin of the local frame. The vehicle stays where it is on Earth and in odom; the map frame moves."""
    place = (sample.lat, sample.lon, sample.alt)
    if not is_position(*place):
        _refuse_origin(run, sample, "value", "it is not a latitude, longitude and height")
        return
    if run.timeline.running and run.origin is not None:
        lat, lon, alt = run.settled.nav[at.LAT : at.VEL].tolist()
        if start_up.is_far((lat, lon, alt), place):
            _refuse_origin(run, sample, "far", "it is more than 100 km from the vehicle")
            return
        moved = np.subtract(lla_to_enu(lat, lon, alt, *place), lla_to_enu(lat, lon, alt, *run.origin))
        run.timeline.shift = run.timeline.shift + moved
        run.timeline.filter.vector[memory.ORIGIN : memory.STATES] = place
        run.gnss.position.resets += 1
    run.origin, run.origin_is_fixed = place, True
    text = f"the origin is {math.degrees(sample.lat):.7f} {math.degrees(sample.lon):.7f} deg, {sample.alt:.1f} m"
    run.journal.say(sample.stamp_ns, "set_origin", Level.INFO, text)


def _refuse_origin(run: FilterRun, sample: SetOrigin, name: str, why: str) -> None:
    run.journal.say(sample.stamp_ns, f"set_origin.rejected.{name}", Level.WARN, f"set_origin is not used: {why}")


_RETURN_SAID = {
    True: ("gnss.return.accepted", "operator: the return of GNSS is accepted"),
    False: ("gnss.return.refused", "operator: the return of GNSS is refused; it has to prove itself again"),
}


def _return(run: FilterRun, sample: ReturnDecision) -> None:
    name, text = "gnss.return.none", "no return of GNSS is waiting for a decision"
    if run.timeline.running:
        run.timeline.settle()
        if run.gnss.position.decide_return(sample.accept):
            name, text = _RETURN_SAID[sample.accept]
    run.journal.say(sample.stamp_ns, name, Level.INFO, text)


def _not_for_us(run: FilterRun, sample: Sample) -> None:
    """Ignore a sample that is meant for another estimator."""


_HANDLERS: dict[type, Callable[[FilterRun, Any], None]] = {
    GnssFix: _fix,
    GnssVelocity: _velocity,
    SatelliteCount: _count,
    MotionEvidence: _motion,
    SetPose: _set_pose,
    SetOrigin: _set_origin,
    ReturnDecision: _return,
    AttitudeSample: _attitude,
    NavigatorVelocity: _not_for_us,
    VelocityError: _not_for_us,
    **{aid.sample: _aid for aid in AIDS},
    BodyVelocity: _body_velocity,
    PressureSample: _pressure,
    Airspeed: _airspeed,
    DifferentialPressure: _differential_pressure,
}
