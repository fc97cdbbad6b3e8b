"""A changed value of every parameter, and the flight on which the change has an effect.

A parameter without an entry fails ``test_every_parameter_has_its_flight_or_its_observer``.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from beamed import Change, beam_directions, in_water, with_beams
from nav_pose_estimator.core.beams.geometry import with_swapped_angle
from nav_pose_estimator.core.numerics.rotation import quat_rotate_many
from nav_pose_estimator.engine.samples import (
    BeamVelocitySample,
    BodyVelocity,
    GnssFix,
    GnssVelocity,
    ImuBlock,
    ImuSample,
    MagSample,
    Sample,
    SatelliteCount,
)
from nav_pose_estimator.sim.faults import Creep, Fault, Freeze, Shift, Stop
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.scenarios import generate
from pieces import one_by_one
from told import silence

AIRFRAME = str(Path(__file__).resolve().parents[2] / "config" / "sim_multirotor.airframe")
CHANGES: dict[str, dict[str, Any]] = {  # flight -> parameter -> value
    "flight": {
        "imu.mounting_rpy": (0.3, 0.3, 0.3),
        "imu.convention": "frd",
        "imu.sampling": "point",
        "imu.accel_bias": (0.1, 0.1, 0.1),
        "imu.accel_scale": (0.01, 0.01, 0.01),
        "imu.gyro_noise": 0.001,
        "imu.accel_noise": 0.04,
        "imu.gyro_bias_sd": 0.008,
        "imu.learn_gyro_bias_sd": False,
        "imu.learn_noise": False,
        "imu.gyro_bias_tau": 6000.0,
        "imu.accel_bias_sd": 0.06,
        "imu.accel_bias_tau": 600.0,
        "imu.gap": 0.03,
        "imu.max_gap": 2.0,
        "imu.max_rate": 1.4,
        "imu.max_force": 20.0,
        "imu.stuck_time": 1.0,
        "gnss.delay": 0.1,
        "gnss.delay_sd": 0.4,
        "gnss.lever_arm": (0.3, 0.3, 0.3),
        "gnss.position_sd": 3.0,
        "gnss.vertical_sd": 5.0,
        "gnss.velocity_sd": 1.0,
        "gnss.velocity_vertical_sd": 1.5,
        "gnss.position_correlation": 1.0,
        "gnss.noise": "innovation_adaptive",
        "gnss.error_states": True,
        "gnss.gate.satellite_source": "none",
        "gnss.gate.min_satellites_enter": 30,
        "gnss.gate.min_satellites_leave": 10,
        "gnss.gate.hold": 4.0,
        "gnss.gate.count_max_age": 30.0,
        "gnss.gate.count_timeout": 0.5,
        "gnss.gate.max_horizontal_sd": 0.2,
        "gnss.gate.max_vertical_sd": 0.4,
        "gnss.reacquisition.policy": "reset",
        "gnss.reacquisition.fixes": 10,
        "gnss.reacquisition.min_duration": 1.6,
        "gnss.reacquisition.sigmas": 2.5,
        "gnss.reacquisition.max_speed": 30.0,
        "gnss.reacquisition.track_timeout": 0.2,
        "attitude.filter": "two_stage",
        "attitude.feedback_period": 0.1,
        "attitude.gravity": 9.9,
        "attitude.wander": 0.0052,
        "attitude.initial_bias_sd": 0.02,
        "attitude.bias_walk": 6e-05,
        "attitude.scale_sd": 0.007,
        "attitude.misalignment_sd": 0.004,
        "attitude.matrix_walk": 0.0001,
        "attitude.timing_sd": 0.005,
        "attitude.initial_tilt_sd": 0.3,
        "attitude.motion_floor": 0.34,
        "attitude.motion_tau": 2.0,
        "attitude.sway_noise": 0.04,
        "attitude.sway_tilt": 0.016,
        "attitude.still_rate": 0.001,
        "attitude.still_force": 0.01,
        "attitude.still_norm": 0.01,
        "attitude.learn_after": 3.0,
        "attitude.max_bias": 0.001,
        "attitude.heading_noise": 0.64,
        "attitude.anomaly_gain": 40.0,
        "attitude.turn_noise": 0.05,
        "attitude.compass_deviation": 0.5,
        "attitude.field_tau": 40.0,
        "attitude.new_field_after": 1.5,
        "attitude.hard_iron": (1e-05, 1e-05, 1e-05),
        "attitude.soft_iron": (1.3, 0.3, 0.3, 0.3, 1.3, 0.3, 0.3, 0.3, 1.3),
        "alignment.static_window": 4.0,
        "alignment.rest_accel_sd": 0.007,
        "alignment.rest_rate": 0.0001,
        "alignment.rest_speed": 0.1,
        "alignment.accel_bias_sd": 0.5,
        "alignment.tilt_sd": 0.02,
        "alignment.hypotheses": 24,
        "alignment.heading_sd": 0.34,
        "alignment.mag_heading_sd": 0.7,
        "alignment.mag_trust": 0.0,
        "navigator.covariance_period": 0.08,
        "navigator.gyro_matrix_states": False,
        "navigator.gyro_matrix_sd": 0.02,
        "navigator.gravity_states": True,
        "navigator.gate_probability": 0.999999,
        "navigator.reject_probability": 0.5,
        "navigator.gap_rate_sd": 0.6,
        "navigator.gap_force_sd": 4.0,
        "navigator.lost_after": 3.0,
        "navigator.expire_after": 12.0,
        "aids.magnetometer": False,
        "aids.magnetometer_period": 1.0,
        "aids.magnetometer_rpy": (0.3, 0.3, 0.3),
        "aids.declination": 0.1,
        "aids.declination_from_model": True,
        "aids.barometer": False,
        "aids.barometer_sd": 3.0,
        "aids.barometer_period": 0.4,
        "aids.barometer_tau": 120.0,
        "aids.body_velocity": False,
        "aids.body_velocity_sd": 0.5,
        "aids.body_velocity_noise": "variational",
        "aids.body_velocity_delay": 0.1,
        "aids.body_velocity_lever": (0.3, 0.3, 0.3),
        "aids.body_velocity_rpy": (0.3, 0.3, 0.3),
        "aids.zero_velocity": False,
        "aids.zero_velocity_sd": 0.1,
    },
    "late": {
        "navigator.memory": 0.15,
        "gnss.gate.max_age": 0.05,
    },
    "jolt": {
        "gnss.reacquisition.max_acceleration": 0.1,
        "gnss.reacquisition.probation": 0.0,
    },
    "contradiction": {
        "gnss.reacquisition.contradiction_time": 2.0,
        "aids.magnetometer_sd": 0.2,  # elsewhere the magnetometer is disturbed ahead of the outage, and steers nothing
    },
    "spoof": {
        "gnss.reacquisition.implausible_time": 60.0,
    },
    "creeping_return": {
        "gnss.reacquisition.velocity_tolerance": 20.0,
    },
    "failure": {
        "gnss.reacquisition.despair_gap": 0.0,
    },
    "air": {
        "attitude.reject_from": 0.8,
        "attitude.reject_to": 8.0,
        "alignment.rest_gyro_sd": 0.04,
        "alignment.gyro_bias_sd": 0.04,
        "alignment.min_time": 6.0,
    },
    "two_stage": {
        "attitude.two_stage.wander": 0.018,
        "attitude.two_stage.force_sd": 1.6,
        "attitude.two_stage.shared_windows": 20.0,
        "attitude.two_stage.regulator_p": 0.1,
        "attitude.two_stage.regulator_i": 0.004,
        "attitude.two_stage.regulator_band": 2.0,
        "attitude.two_stage.heading_noise": 0.3,
        "attitude.two_stage.bias_tau_start": 50.0,
        "attitude.two_stage.bias_tau": 100.0,
        "attitude.two_stage.correction": "literal",
    },
    "wing": {
        "aids.airspeed": False,
        "aids.airspeed_sd": 1.6,
        "aids.airspeed_min": 14.0,
        "aids.wind_sd": 10.0,
    },
    "ground": {
        "aids.range": False,
        "aids.range_sd": 0.2,
    },
    "lake": {
        "aids.water_density": 1030.0,
        "aids.depth_sd": 0.3,
    },
    "beams": {
        "aids.beams.directions": tuple(with_swapped_angle(beam_directions()).ravel().tolist()),
        "aids.beams.sign": -1,
        "aids.beams.sd": 0.05,
        "aids.beams.bias_sd": 0.05,
        "aids.beams.scale_sd": 0.05,
        "aids.beams.delay": 0.1,
        "aids.beams.delay_sd": 0.1,
        "aids.beams.lever": (0.3, 0.3, 0.3),
        "aids.beams.rpy": (0.03, 0.03, 0.03),
        "aids.beams.rpy_sd": 0.05,
    },
    "origin": {
        "origin.latitude": 47.5,
        "origin.longitude": 8.5,
        "origin.height": 500.0,
    },
    "faulty_beam": {
        "aids.beams.compensation": "anfis_frcg",
    },
    "first_training": {"learner.rules": 1, "learner.airframe": AIRFRAME},
    "known_before": {"learner.airframe_seconds": 30.0, "learner.airframe_fades": 30.0},
    "gravity": {"navigator.gravity_sd": 0.001},
    "learning": {
        "learner.enabled": False,
        "learner.method": "coast",
        "learner.vehicle_class": "fixed_wing",
        "learner.window": 60.0,
        "learner.prior": str(Path(__file__).with_name("other_prior.toml")),
        "learner.period": 60.0,
    },
}

READ: dict[str, Any] = {
    "ros.input.imu": "px4",
    "ros.input.fix": "gpsfix",
    "ros.input.velocity": "twist",
    "ros.input.velocity_frame": "ned",
    "ros.input.vertical_velocity": False,
    "ros.input.airspeed": "float32",
    "ros.input.set_origin": "geopoint",
    "ros.frames.map": "world",
    "gnss.gate.satellite_source": "none",
    "aids.beam_velocity_source": "dvl",
}
"""Parameters that change how messages are read, in a node and from a bag alike."""
OF_NODES: dict[str, Any] = {
    "ros.input.queue": 7,
    "ros.input.relieve": False,
    "ros.input.max_stamp_regression": 5.0,
    "ros.frames.map": "world",
    "ros.frames.odom": "start",
    "ros.frames.base_link": "drone",
    "ros.frames.publish_tf": True,
    "ros.output.odometry_rate": 10.0,
    "ros.output.velocity_slew": 0.5,
    "ros.output.attitude_rate": 10.0,
    "ros.output.fix_rate": 1.0,
    "ros.output.bias_rate": 5.0,
    "ros.output.diagnostics_period": 0.5,
    "ros.output.autopilot": "mavros",
    "ros.output.autopilot_when": "always",
    "ros.output.autopilot_rate": 10.0,
    "ros.output.autopilot_dry_run": True,
    "ros.output.autopilot_geoid": 47.0,
    "ros.output.autopilot_gps_id": 0,
    "ros.state.file": "drone.state",
    "ros.state.period": 2.0,
    "ros.model.file": "model.npz",
    "ros.model.save_after_training": True,
    "attitude.world_frame": "ned",
}
"""Parameters that only affect nodes: queues, published topics, written files."""
PRESETS: dict[str, dict[str, Any]] = {
    "origin": {"origin.latitude": 47.4, "origin.longitude": 8.6, "origin.height": 400.0},
    "two_stage": {"attitude.filter": "two_stage"},
    "learning": {"learner.enabled": True},
    "lake": {"aids.water_density": 1000.0},
    "first_training": {"learner.enabled": True},
    "known_before": {"learner.enabled": True, "learner.airframe": AIRFRAME},
    "gravity": {"navigator.gravity_states": True},
}
"""Values that must be set for the parameters of a flight to have an effect. The learner is on only where tested."""


def _base(duration: float = 110.0) -> Recording:
    return generate("multirotor_outage", duration, seed=5, imu_rate=50.0)


def _full() -> list[Sample]:
    """Rest, take-off, an outage with a velocity sensor for a while; an IMU that freezes, pauses, stops and spikes."""
    faults = (
        *silence(45.0, 15.0),
        Shift(ImuSample, 30.0, 0.03, (0.0, 0.0, 0.0, 60.0, 0.0, 0.0)),
        Shift(MagSample, 30.0, 30.0, (2e-5, 1e-5, 0.0)),
        Freeze(ImuSample, 66.0, 0.8),
        Shift(SatelliteCount, 70.0, 1.0, (-6,)),
        Stop(ImuSample, 75.0, 0.2),
        Shift(GnssFix, 82.0, 4.0, (40.0, 0.0, 0.0)),
        Stop(ImuSample, 95.0, 1.5),
    )
    return list(_with_body_velocity(_base(), faults, 46.0, 52.0))


def _with_body_velocity(recording: Recording, faults: tuple[Fault, ...], begin: float, end: float) -> Iterator[Sample]:
    """The flight with a velocity sensor at 5 Hz from ``begin`` to ``end`` [s], 0.05 m/s off on every axis."""
    truth, due = recording.truth, begin
    velocity_b = quat_rotate_many(truth.q_nb * np.array([1.0, -1.0, -1.0, -1.0]), truth.v_n) + 0.05
    for sample in recording.with_faults(*faults).samples():
        yield sample
        if not isinstance(sample, ImuBlock):
            continue
        t = (int(sample.stamps_ns[-1]) - recording.start_ns) * 1e-9
        if due <= t < end:
            row = velocity_b[min(round(t / truth.dt), len(truth) - 1)]
            yield BodyVelocity(int(sample.stamps_ns[-1]), tuple(row.tolist()), 0.04 * np.eye(3))
            due = t + 0.2


def _off_after(begin: float) -> Change:
    """The second beam is off by 2 m/s from ``begin`` [s] on."""

    def change(t: float, sample: BeamVelocitySample) -> BeamVelocitySample:
        return replace(sample, velocities=sample.velocities + np.array([0.0, 2.0 * (t >= begin), 0.0, 0.0]))

    return change


def _silent(scenario: str, duration: float, *faults: Fault) -> list[Sample]:
    return list(generate(scenario, duration, seed=5, imu_rate=50.0).with_faults(*faults).samples())


def _spoiled(duration: float, *faults: Fault) -> list[Sample]:
    return list(_base(duration).with_faults(*faults).samples())


_ELSEWHERE = ((Shift, 200.0), (Creep, 4.0))
FLIGHTS: dict[str, Callable[[], list[Sample]]] = {
    "flight": _full,
    "two_stage": _full,
    # solutions of single samples say where the vehicle is in map
    "origin": lambda: one_by_one(generate("hover", 8.0, seed=5, imu_rate=50.0).samples()),
    "air": lambda: list(generate("start_in_air", 60.0, seed=5, imu_rate=50.0).samples()),
    "late": lambda: list(generate("late_gnss", 40.0, seed=5, imu_rate=50.0).samples()),
    "wing": lambda: list(generate("fixed_wing_airspeed", 60.0, seed=5, imu_rate=50.0).samples()),
    "ground": lambda: _silent("hover_range", 60.0, *silence(45.0, 10.0)),
    "lake": lambda: list(in_water(_base(60.0))),
    "beams": lambda: list(with_beams(_base(60.0), own=True)),
    # the network has been trained when GNSS goes, and a beam with it
    "faulty_beam": lambda: list(
        with_beams(_base(130.0).with_faults(*silence(110.0, 20.0)), _off_after(112.0), own=True)
    ),
    # GNSS jumps in flight and stays there
    "spoof": lambda: _spoiled(90.0, Shift(GnssFix, 40.0, 50.0, (300.0, 0.0, 0.0))),
    # it comes back where the filter cannot be, but the vehicle could
    "contradiction": lambda: _spoiled(110.0, *silence(45.0, 15.0), Shift(GnssFix, 60.0, 100.0, (200.0, 0.0, 0.0))),
    # it comes back elsewhere, and its positions move while its velocity says nothing of it
    "creeping_return": lambda: _spoiled(
        80.0, *silence(45.0, 8.0), *(fault(GnssFix, 53.0, 100.0, (far, 0.0, 0.0)) for fault, far in _ELSEWHERE)
    ),
    # it comes back with another velocity, too
    "failure": lambda: _spoiled(
        110.0,
        *silence(45.0, 8.0),
        Shift(GnssVelocity, 53.0, 100.0, (20.0, 0.0, 0.0)),
        Creep(GnssFix, 53.0, 100.0, step=(4.0, 0.0, 0.0)),
    ),
    # its velocity jumps once while it proves itself
    "jolt": lambda: _spoiled(80.0, *silence(45.0, 15.0), Shift(GnssVelocity, 60.3, 0.3, (6.0, 0.0, 0.0))),
    # only the first training and every fifth try more than one rule where one is enough
    "first_training": lambda: _spoiled(60.0),
    "known_before": lambda: _spoiled(60.0),
    "gravity": lambda: _spoiled(60.0),
    # long enough to train on more than learner.window at its least
    "learning": lambda: list(
        generate("multirotor_outage", 240.0, seed=5, imu_rate=50.0).with_faults(*silence(205.0, 20.0)).samples()
    ),
}
