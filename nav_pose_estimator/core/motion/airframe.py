"""Prior knowledge of an aircraft: its class, an archive of past flights, and a network trained on them."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from nav_pose_estimator.core.learning.conv_lstm import ConvLstm, untrained
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.prior import MOVES, MotionPrior
from nav_pose_estimator.core.motion.vehicle_class import (
    FIXED_WING,
    FLYING,
    MULTIROTOR,
    UNKNOWN,
    WHEELS,
    classify,
    is_unlike,
)
from nav_pose_estimator.core.motion.windows import SECONDS

Array = NDArray[np.float64]

VELOCITY, INCREMENTS = "velocity", "increments"
FORMS = (VELOCITY, INCREMENTS)
"""Outputs of a network for each second: air velocity and its log variance, or the increments of the source text."""
WORTH, FADES = 100.0, 150.0
"""Initial weight of an archive of other aircraft [s of flight], and motion after which the weight is zero [s]."""
CONTROL_SEED = 1
_FASTEST = 100.0  # m/s: limit of each component of a network's output
_SAME = 3.0  # weight of flights of the same aircraft over that of other aircraft of the class
_YOUNG = 60.0  # s of flight: a multirotor that has not hovered by then is judged by its motion


@dataclass(frozen=True)
class Archive:
    """Normal equations of ``prior`` eq. (1) over ``seconds`` [s] of flight, with cross-validated noise.

    ``gram`` (n + 1, n + 1), ``moment`` (n + 1, 3), ``noise`` (3,) and ``wind_spread`` as in ``MotionPrior``.
    """

    gram: Array
    moment: Array
    noise: Array
    wind_spread: float
    seconds: float


@dataclass(frozen=True)
class TrainedNetwork:
    """A network with archives whose inputs include the network's outputs, which show what these are worth.

    ``archive`` was made with the outputs of networks that were not trained on the flight in question
    (cross-validation), ``control`` with those of a network of random weights.
    """

    form: str
    weights: ConvLstm
    archive: Archive
    control: Archive

    def velocity(self, window: Array) -> Array:
        """Air velocity in b (3,) [m/s] predicted from the last second (``windows.window``)."""
        return air_velocity(self.weights, self.form, window)

    @property
    def untrained(self) -> "TrainedNetwork":
        """The control: the same shape and scales, random weights."""
        return TrainedNetwork(self.form, control_of(self.weights), self.control, self.control)


def air_velocity(weights: ConvLstm, form: str, window: Array) -> Array:
    """Air velocity in b (3,) [m/s] predicted by a network of this ``form``, limited to a plausible speed."""
    output = weights.predict(window[:, : weights.channels])[:3]
    return np.clip(output if form == VELOCITY else output / SECONDS, -_FASTEST, _FASTEST)


def control_of(weights: ConvLstm) -> ConvLstm:
    """A network of the same shape and scales with random weights."""
    scales = {name: getattr(weights, name) for name in ("input_mean", "input_scale", "output_mean", "output_scale")}
    return untrained(scales, CONTROL_SEED)


@dataclass(frozen=True)
class PastFlight:
    """A recording that is part of an archive: its name, the SHA-256 of the file, and its length [s]."""

    name: str
    digest: str
    seconds: float


@dataclass(frozen=True)
class Airframe:
    """The content of an airframe file. ``is_one_aircraft``: all flights are of the aircraft that flies with the file.

    ``made_with``: software versions and vector instructions, on which the last bits of a simulated flight depend; may
    be empty.
    """

    vehicle_class: str
    is_one_aircraft: bool
    archive: Archive
    network: TrainedNetwork | None
    flights: tuple[PastFlight, ...]
    made_with: str = ""


def as_prior(
    archive: Archive, vehicle_class: str, is_one_aircraft: bool, worth: float = WORTH, fades: float = FADES
) -> MotionPrior:
    """The ``archive`` as a prior, with at most the weight of the flight time that it holds.

    ``worth`` [s]: weight of an archive of other aircraft; ``fades`` [s] as in ``MotionPrior``.
    """
    seconds = min(worth * (_SAME if is_one_aircraft else 1.0), archive.seconds)
    guided = vehicle_class == WHEELS
    return MotionPrior(
        archive.gram, archive.moment, archive.noise, archive.wind_spread, guided, worth=seconds, fades=fades
    )


@dataclass(frozen=True)
class Beforehand:
    """Knowledge at the start of a flight: the class of the vehicle and, optionally, an airframe file and its weight."""

    vehicle_class: str = UNKNOWN
    airframe: Airframe | None = None
    worth: float = WORTH  # s of flight: weight of an archive of other aircraft
    fades: float = FADES  # s of motion after which the archive has no weight

    @property
    def is_class_known(self) -> bool:
        """Whether the class is known, so that the regimes of motion are defined from the first seconds on."""
        return self.vehicle_class != UNKNOWN

    def by_flight(self, epochs: Array) -> "Beforehand":
        """The knowledge that still holds after the flight of ``epochs`` (N, COLUMNS or more).

        Where the motion clearly shows a flying class other than the stated one, the motion wins and the airframe is
        dropped. Motion on the ground is no evidence: a fixed wing taxies, and a multirotor is driven to its start.
        """
        shown = classify(epochs)
        if self.is_class_known and (shown not in FLYING or shown == self.vehicle_class):
            return self
        return Beforehand(shown)

    def can_hover(self, epochs: Array) -> bool | None:
        """Whether the vehicle of the flight of ``epochs`` (N, COLUMNS or more) can hover; None: the flight decides.

        A vehicle that moves unlike a multirotor cannot, for a car or a boat at constant speed is as calm as a hover. A
        multirotor that only flies laps never does; in its first minute this cannot be decided yet, and it is assumed
        to be able to.
        """
        shown = self.by_flight(epochs).vehicle_class
        if shown == UNKNOWN:
            return False if is_unlike(MULTIROTOR, epochs) else None
        if shown != MULTIROTOR:
            return False
        return True if len(epochs) * me.PERIOD < _YOUNG else None

    @property
    def prior(self) -> MotionPrior | None:
        """The archive as a prior.

        None for a multirotor unless the archive is of the same aircraft: frames, propellers and loads differ too much.
        """
        return None if self.airframe is None else self.prior_of(self.airframe.archive)

    def flown(self, epochs: Array) -> Array:
        """Those of ``epochs`` (N, COLUMNS or more) for which the archive's law is valid, while it has weight.

        At rest on the runway the IMU of a fixed wing measures the same as in cruise: the law would predict the cruise
        speed, and the difference would be taken for wind.
        """
        prior = self.prior
        if prior is None or self.vehicle_class != FIXED_WING or prior.seconds(epochs) == 0.0:
            return epochs
        stands = np.hypot(epochs[:, me.VELOCITY], epochs[:, me.VELOCITY + 1]) < MOVES
        return epochs[np.flatnonzero(stands)[-1] + 1 :] if stands.any() else epochs

    def prior_of(self, archive: Archive) -> MotionPrior | None:
        """Another ``archive`` of the airframe as a prior; None as for ``prior``."""
        airframe = self.airframe
        if airframe is None or self.worth <= 0.0:
            return None
        if self.vehicle_class == MULTIROTOR and not airframe.is_one_aircraft:
            return None
        return as_prior(archive, self.vehicle_class, airframe.is_one_aircraft, self.worth, self.fades)
