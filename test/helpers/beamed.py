"""Beam velocities of a Doppler log, or water pressures, from the truth of a simulated flight."""

import math
from collections.abc import Callable, Iterator

import numpy as np

from nav_pose_estimator.core.numerics.rotation import quat_rotate_many
from nav_pose_estimator.engine.imu.mounting import rotation_from_rpy
from nav_pose_estimator.engine.samples import BeamVelocitySample, ImuBlock, PressureSample, Sample
from nav_pose_estimator.sim.recording import Recording

SD = 0.02  # m/s
Change = Callable[[float, BeamVelocitySample], BeamVelocitySample | None]
"""Change of the message at a time [s]; None: it is lost."""


def beam_directions(angle: float = 25.0, azimuths: tuple[float, ...] = (45.0, 135.0, 225.0, 315.0)) -> np.ndarray:
    """Unit vectors (n, 3) in FLU that point down at ``angle`` [deg] from the vertical."""
    a, psi = np.radians(angle), np.radians(azimuths)
    return np.column_stack([np.sin(a) * np.cos(psi), np.sin(a) * np.sin(psi), np.full(len(psi), -np.cos(a))])


def with_beams(
    recording: Recording,
    change: Change = lambda t, sample: sample,
    rpy: tuple[float, float, float] = (0.0, 0.0, 0.0),
    rate: float = 5.0,
    begin: float = 0.0,
    own: bool = False,
    lever: tuple[float, float, float] = (0.0, 0.0, 0.0),
) -> Iterator[Sample]:
    """The samples of ``recording`` with beam velocities from ``begin`` [s] on, with the sensor mounted at ``rpy``.

    ``own``: messages also contain the sensor's 3-D velocity.
    """
    truth, rng = recording.truth, np.random.default_rng(7)
    velocity = (in_body(recording) + np.cross(truth.gyro, lever)) @ rotation_from_rpy(rpy)  # in the sensor's axes
    directions = beam_directions()
    for sample, t in at_rate(recording, rate, begin):
        yield sample
        if isinstance(sample, ImuBlock) and t is not None:
            v = velocity[min(round(t / truth.dt), len(truth) - 1)]
            measured = directions @ v + SD * rng.standard_normal(4)
            message = BeamVelocitySample(
                int(sample.stamps_ns[-1]), directions, measured, velocity=tuple(v.tolist()) if own else None
            )
            changed = change(t, message)
            if changed is not None:
                yield changed


def in_body(recording: Recording) -> np.ndarray:
    """The true velocity (N, 3) [m/s] in b."""
    truth = recording.truth
    return quat_rotate_many(truth.q_nb * np.array([1.0, -1.0, -1.0, -1.0]), truth.v_n)


def at_rate(recording: Recording, rate: float, begin: float = 0.0) -> Iterator[tuple[Sample, float | None]]:
    """The samples, each with the time [s] at which a sensor of ``rate`` [Hz] measures behind it, or None."""
    due = begin
    for sample in recording.samples():
        t = (int(sample.stamps_ns[-1]) - recording.start_ns) * 1e-9 if isinstance(sample, ImuBlock) else -math.inf
        if t >= due:
            due = t + 1.0 / rate - 1e-6
            yield sample, t
        else:
            yield sample, None


def in_water(recording: Recording, density: float = 1000.0, surface: float = 30.0) -> Iterator[Sample]:
    """The samples of ``recording`` with water pressures; the surface is ``surface`` [m] above the start."""
    truth = recording.truth
    for sample in recording.samples():
        if isinstance(sample, PressureSample):
            row = min(round((sample.stamp_ns - recording.start_ns) * 1e-9 / truth.dt), len(truth) - 1)
            depth = truth.alt[0] + surface - truth.alt[row]
            sample = PressureSample(sample.stamp_ns, 101_325.0 + density * 9.807 * float(depth))
        yield sample
