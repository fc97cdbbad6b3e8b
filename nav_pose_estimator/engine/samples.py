"""What goes into an engine: one frozen dataclass per sensor. Stamps are integer nanoseconds, frames FLU and ENU.

``None`` means unknown: a sensor that gives no covariance gives ``None``, never an invented number.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

Vector3 = tuple[float, float, float]


@dataclass(slots=True)
class ImuSample:
    """Angular rate ``gyro`` [rad/s] and specific force ``accel`` [m/s^2] in the body frame.

    Treat it as frozen like the others. It is not actually frozen, because it is made at the rate of the IMU and
    freezing doubles the cost.
    """

    stamp_ns: int
    gyro: Vector3
    accel: Vector3


@dataclass(frozen=True, slots=True)
class ImuBlock:
    """Consecutive IMU samples: ``stamps_ns`` (N,) int64, ``gyro`` (N, 3) [rad/s], ``accel`` (N, 3) [m/s^2]."""

    stamps_ns: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def part(self, begin: int, end: int | None) -> "ImuBlock":
        """The samples ``begin`` to ``end`` (None: to the last one), as views."""
        return ImuBlock(self.stamps_ns[begin:end], self.gyro[begin:end], self.accel[begin:end])


def joined(parts: Sequence[ImuSample | ImuBlock]) -> ImuBlock:
    """Consecutive IMU samples and blocks as one block."""
    if len(parts) == 1 and isinstance(parts[0], ImuBlock):
        return parts[0]
    singles = [part for part in parts if isinstance(part, ImuSample)]
    if len(singles) == len(parts):
        stamps = np.array([sample.stamp_ns for sample in singles])
        return ImuBlock(stamps, np.array([s.gyro for s in singles]), np.array([s.accel for s in singles]))
    blocks = [part if isinstance(part, ImuBlock) else joined([part]) for part in parts]
    return ImuBlock(
        np.concatenate([block.stamps_ns for block in blocks]),
        np.concatenate([block.gyro for block in blocks]),
        np.concatenate([block.accel for block in blocks]),
    )


@dataclass(frozen=True, slots=True)
class GnssFix:
    """Geodetic position. ``status`` as in NavSatStatus (>= 0 is a fix). ``cov_enu`` (3, 3) [m^2] or None if unknown."""

    stamp_ns: int
    lat: float  # rad
    lon: float  # rad
    alt: float  # m above the ellipsoid
    status: int = 0
    cov_enu: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class GnssVelocity:
    """Velocity over ground, ENU [m/s]. An axis that is not measured is NaN. ``cov_enu`` (3, 3) or None."""

    stamp_ns: int
    vel_enu: Vector3
    cov_enu: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class SatelliteCount:
    """Number of satellites used. ``count`` None: the receiver says that it does not know (255 in MAVLink).

    MAVROS sends the count without a header: ``stamp_ns`` is then None and the count belongs to the last fix.
    """

    stamp_ns: int | None
    count: int | None


@dataclass(frozen=True, slots=True)
class MagSample:
    """Magnetic field in the body frame [T]; an absent axis is NaN."""

    stamp_ns: int
    field: Vector3


@dataclass(frozen=True, slots=True)
class PressureSample:
    """Static air pressure [Pa], variance [Pa^2] or None."""

    stamp_ns: int
    pressure: float
    variance: float | None = None


@dataclass(frozen=True, slots=True)
class WaterPressure:
    """Absolute pressure [Pa] of a sensor under water."""

    stamp_ns: int
    pressure: float


@dataclass(frozen=True, slots=True)
class BodyVelocity:
    """Velocity in the sensor frame [m/s] (DVL, optical flow, wheel). An axis not measured is NaN."""

    stamp_ns: int
    velocity: Vector3
    cov: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class BeamVelocitySample:
    """Velocities [m/s] along the n beams of a Doppler log or radar, as published: axes and sign are the sensor's own.

    ``directions`` (n, 3) unit vectors in the sensor frame, NaN where the message has none; ``velocities`` (n,), NaN for
    a lost beam. ``variances`` (n,) [m^2/s^2] or None, of which NaN is unknown. ``ranges`` (n,) [m] or None: a beam with
    a range of zero or less has met nothing. ``valid`` (n,) bool or None: what the sensor says of each beam.
    ``velocity``: the sensor's own 3-D velocity over ground in the same axes, None where it has none.
    """

    stamp_ns: int
    directions: np.ndarray
    velocities: np.ndarray
    variances: np.ndarray | None = None
    velocity: Vector3 | None = None
    ranges: np.ndarray | None = None
    valid: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class ComposedPosition:
    """A position composed of predicted motion since GNSS was lost: lat, lon [rad], height [m]; covariance ENU [m^2]."""

    stamp_ns: int
    position: Vector3
    cov: np.ndarray


@dataclass(frozen=True, slots=True)
class Airspeed:
    """True airspeed along the body's x axis [m/s] and its deviation ``sd`` [m/s], NaN if unknown.

    ``stamp_ns`` None: it came without a header (std_msgs/Float32) and holds at the last IMU sample.
    """

    stamp_ns: int | None
    speed: float
    sd: float = math.nan


@dataclass(frozen=True, slots=True)
class DifferentialPressure:
    """Total minus static pressure of a pitot tube [Pa]: 0.5 * density * (true airspeed)^2; below zero by its noise."""

    stamp_ns: int
    pressure: float


@dataclass(frozen=True, slots=True)
class RangeToGround:
    """Distance [m] along the beam of a rangefinder that looks down, within the limits that the sensor states.

    Of an ultrasonic cone of ``field_of_view`` [rad] the nearest point in it, 0 for a ray; ``sd`` [m], NaN if unknown.
    """

    stamp_ns: int
    distance: float
    field_of_view: float = 0.0
    sd: float = math.nan


@dataclass(frozen=True, slots=True)
class SetPose:
    """Pose given from outside, in the local ENU frame of the origin. ``cov`` (6, 6): x, y, z, rotations, or None."""

    stamp_ns: int
    position_enu: Vector3
    q_nb: tuple[float, float, float, float]
    cov: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class SetOrigin:
    """Where the local frame is to have its zero: latitude, longitude [rad], height above the ellipsoid [m]."""

    stamp_ns: int
    lat: float
    lon: float
    alt: float


@dataclass(frozen=True, slots=True)
class ReturnDecision:
    """The operator's decision on GNSS that is back somewhere unexpected (policy ``hold``): accept or refuse."""

    stamp_ns: int
    accept: bool


@dataclass(frozen=True, slots=True)
class AttitudeSample:
    """Attitude from another estimator: ``q_nb`` scalar first, ``cov_n`` (3, 3) [rad^2] about n axes."""

    stamp_ns: int
    q_nb: tuple[float, float, float, float]
    cov_n: np.ndarray | None = None


@dataclass(frozen=True, slots=True)
class NavigatorVelocity:
    """Velocity of the navigator, ENU [m/s]: with it the attitude filter separates acceleration from gravity.

    ``valid`` while GNSS or another velocity aids the navigator, or its tilt is still good: a navigator that has lost
    its tilt would feed its own errors back.
    ``q_nb`` is the navigator's attitude: its heading may differ from the filter's. None if unknown.
    ``heading_sd`` and ``tilt_sd`` [rad] of that attitude, NaN if unknown: a heading that GNSS supports corrects the
    filter's, and such a tilt tells the bias of the accelerometer.
    """

    stamp_ns: int
    vel_enu: Vector3
    valid: bool = True
    q_nb: tuple[float, float, float, float] | None = None
    drifting: bool = False  # nothing but the IMU carries it: its change means something, its value does not
    heading_sd: float = math.nan
    tilt_sd: float = math.nan


@dataclass(frozen=True, slots=True)
class VelocityError:
    """Predicted error of the navigator's velocity (estimate minus truth), ENU [m/s]; ``cov`` (3, 3) of one second."""

    stamp_ns: int
    dv_n: Vector3
    cov: np.ndarray


@dataclass(frozen=True, slots=True)
class Hypothesis:
    """What the vehicle may be doing and what follows from it; ``None`` where nothing does.

    ``probability`` at the loss of GNSS, ``velocity_var`` [m^2/s^2] of each horizontal velocity component about zero, of
    which ``velocity_time`` [s] make one independent draw; without it the velocity tells regimes apart, no more.
    ``air_noise`` (3,) [m^2/s^2] of the predicted air velocity in b, ``log_likelihood`` of all else that was seen.
    ``place_var`` [m^2] of each horizontal component of the place about where GNSS was lost, of which ``place_time`` [s]
    make one draw. ``doubt_psd`` [m^2/s]: how the position spreads because the vehicle may do something else.
    ``air_corrects``: the predicted air velocity corrects the branch; else it tells the hypotheses apart, no more.
    ``lasting``: what holds in place of this while it has been the likely hypothesis ever since GNSS was lost.
    """

    name: str
    probability: float
    velocity_var: float | None
    air_noise: Vector3 | None
    log_likelihood: float = 0.0
    velocity_time: float | None = 1.0
    place_var: float | None = None
    place_time: float = 60.0
    doubt_psd: float = 0.0
    air_corrects: bool = True
    lasting: "Hypothesis | None" = None


@dataclass(frozen=True, slots=True)
class MotionEvidence:
    """What the last ``interval`` [s] of an outage shows of the motion: means of the solution, prediction, hypotheses.

    ``attitude`` (3, 3) mean C_nb; ``velocity`` in n and ``body_velocity`` (mean of C^T v) of the estimate [m/s];
    ``air_velocity`` predicted in b [m/s], None without a prediction. The wind (East, North, m/s) with which an outage
    begins, its mean, covariance (2, 2) now and variance in the long run, and its time constant. ``dwell`` [s]: how long
    a regime lasts. ``drift_variance``: squared errors without GNSS as a fraction of the stated variance. What is nearer
    in time than ``correlation`` [s] is not independent evidence of a regime. ``unmodelled_var`` [m^2/s^2]: of a
    velocity that has drifted; the covariance does not account for lasting wrong predictions.
    """

    stamp_ns: int
    interval: float
    attitude: np.ndarray
    velocity: Vector3
    body_velocity: Vector3
    air_velocity: Vector3 | None
    hypotheses: tuple[Hypothesis, ...]
    dwell: float
    wind: tuple[float, float] = (0.0, 0.0)
    wind_mean: tuple[float, float] = (0.0, 0.0)
    wind_cov: np.ndarray = field(default_factory=lambda: np.zeros((2, 2)))
    wind_spread: float = 0.0
    wind_tau: float = 1.0
    drift_variance: float = 1.0
    correlation: float = 10.0
    unmodelled_var: float = 8.0


Sample = (
    ImuSample
    | ImuBlock
    | GnssFix
    | GnssVelocity
    | SatelliteCount
    | MagSample
    | PressureSample
    | WaterPressure
    | BodyVelocity
    | BeamVelocitySample
    | ComposedPosition
    | Airspeed
    | DifferentialPressure
    | RangeToGround
    | SetPose
    | SetOrigin
    | ReturnDecision
    | AttitudeSample
    | NavigatorVelocity
    | VelocityError
    | MotionEvidence
)


def stamp_of(sample: Sample) -> int | None:
    """The stamp of a sample, of a block its last one; None for a count that came without a header."""
    return int(sample.stamps_ns[-1]) if isinstance(sample, ImuBlock) else sample.stamp_ns


def known_stamp(sample: Sample) -> int:
    """``stamp_of`` a sample that is known to have one."""
    stamp = stamp_of(sample)
    assert stamp is not None
    return stamp
