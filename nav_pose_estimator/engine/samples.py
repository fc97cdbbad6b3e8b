"""Input of the engines: one frozen dataclass per sensor. Stamps are integer nanoseconds, frames FLU and ENU.

``None`` means unknown: a sensor without a covariance gives ``None``, never an invented number.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np

Vector3 = tuple[float, float, float]


@dataclass(slots=True)
class ImuSample:
    """Angular rate ``gyro`` [rad/s] and specific force ``accel`` [m/s^2] in the body frame.

    Treat it as frozen like the others. It is not frozen, because it is created at the rate of the IMU, and freezing
    would double the cost.
    """

    stamp_ns: int
    gyro: Vector3
    accel: Vector3


@dataclass(slots=True)
class ImuBlock:
    """Consecutive IMU samples: ``stamps_ns`` (N,) int64, ``gyro`` (N, 3) [rad/s], ``accel`` (N, 3) [m/s^2].

    To be treated as frozen, like ``ImuSample``.
    """

    stamps_ns: np.ndarray
    gyro: np.ndarray
    accel: np.ndarray

    def __len__(self) -> int:
        return len(self.stamps_ns)

    def part(self, begin: int, end: int | None) -> "ImuBlock":
        """The samples ``begin`` to ``end`` (None: to the last one), as views."""
        return ImuBlock(self.stamps_ns[begin:end], self.gyro[begin:end], self.accel[begin:end])

    def samples(self) -> Iterator[ImuSample]:
        """The samples one by one."""
        rows = zip(self.stamps_ns.tolist(), self.gyro.tolist(), self.accel.tolist(), strict=True)
        return (ImuSample(stamp, tuple(gyro), tuple(accel)) for stamp, gyro, accel in rows)


def joined(parts: Sequence[ImuSample | ImuBlock]) -> ImuBlock:
    """Consecutive IMU samples and blocks as one block."""
    blocks = [part for part in parts if isinstance(part, ImuBlock)]
    if len(blocks) < len(parts):
        if not blocks:
            singles = [part for part in parts if isinstance(part, ImuSample)]
            stamps = np.array([sample.stamp_ns for sample in singles])
            return ImuBlock(stamps, np.array([s.gyro for s in singles]), np.array([s.accel for s in singles]))
        blocks = [part if isinstance(part, ImuBlock) else joined([part]) for part in parts]
    if len(blocks) == 1:
        return blocks[0]
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
    """Number of satellites used. ``count`` None: the receiver reports it as unknown (255 in MAVLink).

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
    """Velocity in the sensor frame [m/s] (DVL, optical flow, wheel). An axis not measured is NaN.

    ``is_learned``: predicted by an outage method, which rehearsals judge; motion need not confirm it first.
    """

    stamp_ns: int
    velocity: Vector3
    cov: np.ndarray | None = None
    is_learned: bool = False


@dataclass(frozen=True, slots=True)
class BeamVelocitySample:
    """Velocities [m/s] along the n beams of a Doppler log or radar, as published: axes and sign are the sensor's own.

    ``directions`` (n, 3) unit vectors in the sensor frame, NaN where the message has none; ``velocities`` (n,), NaN for
    a lost beam. ``variances`` (n,) [m^2/s^2] or None, NaN where unknown. ``ranges`` (n,) [m] or None: a range of zero
    or less means no echo. ``valid`` (n,) bool or None: the sensor's validity flags. ``velocity``: the sensor's own 3-D
    velocity over ground in the same axes, None where it has none.
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

    ``stamp_ns`` None: it came without a header (std_msgs/Float32) and is valid at the last IMU sample.
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
    """Distance [m] along the beam of a downward rangefinder, within the limits that the sensor states.

    ``field_of_view`` [rad]: width of the cone in which the nearest point is measured, 0 for a ray. ``sd`` [m], NaN if
    unknown.
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
    """Origin of the local frame given from outside: latitude, longitude [rad], height above the ellipsoid [m]."""

    stamp_ns: int
    lat: float
    lon: float
    alt: float


@dataclass(frozen=True, slots=True)
class ReturnDecision:
    """The operator's decision on an unexpected return of GNSS (policy ``hold``): accept or refuse."""

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
    """Velocity of the navigator, ENU [m/s], by which the attitude filter separates acceleration from gravity.

    ``valid`` while GNSS or another velocity aids the navigator, or its tilt is still good; otherwise it would feed its
    own errors back. ``q_nb`` is the navigator's attitude, None if unknown; its heading may differ from the filter's.
    ``heading_sd`` and ``tilt_sd`` [rad] are those of that attitude, NaN if unknown: a heading aided by GNSS corrects
    the filter's heading, a good tilt corrects the accelerometer bias.
    """

    stamp_ns: int
    vel_enu: Vector3
    valid: bool = True
    q_nb: tuple[float, float, float, float] | None = None
    drifting: bool = False  # on the IMU alone: changes of the velocity are valid, its value is not
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
    """Hypothesis about the vehicle's motion (a regime such as hover or travel) and its statistics; ``None``: not used.

    ``probability`` at the loss of GNSS. ``velocity_var`` [m^2/s^2]: variance of each horizontal velocity component
    about zero, one independent sample per ``velocity_time`` [s]; with ``velocity_time`` None the velocity only
    discriminates between hypotheses. ``air_noise`` (3,) [m^2/s^2]: noise of the predicted air velocity in b.
    ``log_likelihood``: of all other data. ``place_var`` [m^2]: variance of each horizontal component of the position
    about that of the loss of GNSS, one independent sample per ``place_time`` [s]. ``doubt_psd`` [m^2/s]: random walk of
    the position for motion outside the hypothesis. ``air_corrects``: the predicted air velocity corrects the branch;
    otherwise it only discriminates. ``lasting``: replaces this hypothesis while it has been the likely one ever since
    the loss of GNSS.
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
    """Evidence of the motion over the last ``interval`` [s] of an outage: means of the solution, prediction, regimes.

    ``attitude`` (3, 3): mean C_nb; ``velocity`` in n and ``body_velocity`` (mean of C^T v) [m/s]: means of the
    estimate. ``air_velocity``: predicted in b [m/s], None without a prediction. ``wind`` (East, North) [m/s] at the
    beginning of the outage, its long-term mean ``wind_mean``, present covariance ``wind_cov`` (2, 2), long-term
    variance ``wind_spread`` and time constant ``wind_tau`` [s]. ``dwell`` [s]: mean duration of a regime.
    ``drift_variance``: squared errors without GNSS relative to the stated variance. ``correlation`` [s]: time within
    which data are not independent evidence of a regime. ``unmodelled_var`` [m^2/s^2]: variance of a drifted velocity
    that the covariance does not contain, because wrong predictions persist.
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
    """Stamp of a sample, or of the last sample of a block; None for samples that came without a header."""
    return int(sample.stamps_ns[-1]) if isinstance(sample, ImuBlock) else sample.stamp_ns


def known_stamp(sample: Sample) -> int:
    """``stamp_of`` a sample that is known to have one."""
    stamp = stamp_of(sample)
    assert stamp is not None
    return stamp
