"""Model of a Doppler log or radar, whose beams each measure the component of the velocity over ground along them."""

import math
from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.core.numerics.rotation import (
    quat_conjugate_many,
    quat_from_euler,
    quat_rotate_many,
    quat_to_matrix,
)
from nav_pose_estimator.engine.samples import BeamVelocitySample
from nav_pose_estimator.sim.sensors import Timed, sensor_times, to_ns
from nav_pose_estimator.sim.trajectories import Truth

Triple = tuple[float, float, float]


def cone(beams: int, angle: float, first: float) -> tuple[Triple, ...]:
    """Unit vectors (x forward, y left, z up) of ``beams`` that point down, at ``angle`` [rad] from the vertical.

    Their azimuths increase to the left from ``first`` [rad]; with four beams, 0 is a "+" and pi / 4 an "x" arrangement.
    """
    around = first + 2.0 * math.pi / beams * np.arange(beams)
    level = math.sin(angle)
    return tuple((level * math.cos(psi), level * math.sin(psi), -math.cos(angle)) for psi in around.tolist())


@dataclass(frozen=True)
class Doppler:
    """Beams with noise, individual biases and a common scale error; mounting and misalignment of the sensor.

    Along beam b_i it measures (1 + scale) b_i . v + bias_i + noise, with its velocity v in its own axes.
    """

    rate: float = 2.0  # Hz
    directions: tuple[Triple, ...] = cone(4, math.radians(30.0), math.radians(45.0))  # in the sensor's axes
    noise: float = 0.01  # m/s per beam and sample
    bias_sd: float = 0.001  # m/s, constant, per beam
    scale_sd: float = 0.002  # common to all beams
    lever: Triple = (0.0, 0.0, 0.0)  # m from the IMU in the body
    rpy: Triple = (0.0, 0.0, 0.0)  # rad, nominal mounting of the sensor in the body
    misalignment: Triple = (0.0, 0.0, 0.0)  # rad, unknown deviation from it about the sensor's axes
    latency: float = 0.0  # s: stamp minus time of validity
    transport: float = 0.02  # s: arrival minus stamp
    sign: float = -1.0  # 1: positive while the sensor moves along the beam; -1: while the ground recedes, as radars do


def doppler(truth: Truth, model: Doppler, rng: np.random.Generator, start_ns: int) -> list[Timed]:
    """Samples of the velocities along all beams, without ranges and 3-D velocity, as a point cloud provides them."""
    t = sensor_times(truth, model.rate)
    t = t[t + model.latency + model.transport <= truth.t[-1]]
    at = truth.at(t)
    v_b = quat_rotate_many(quat_conjugate_many(at.q_nb), at.v_n) + np.cross(at.gyro, model.lever)
    drawn, tilted = (quat_to_matrix(quat_from_euler(*angles)) for angles in (model.rpy, model.misalignment))
    directions = np.array(model.directions)
    along = v_b @ drawn @ tilted @ directions.T
    scale, bias = model.scale_sd * rng.standard_normal(), model.bias_sd * rng.standard_normal(along.shape[1])
    measured = model.sign * ((1.0 + scale) * along + bias + model.noise * rng.standard_normal(along.shape))
    stamps = to_ns(t + model.latency, start_ns).tolist()
    arrivals = to_ns(t + model.latency + model.transport, start_ns).tolist()
    rows = zip(arrivals, stamps, measured, strict=True)
    return [Timed(arrival, BeamVelocitySample(stamp, directions, row)) for arrival, stamp, row in rows]
