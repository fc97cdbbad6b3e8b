"""What is known of an aircraft before it takes off: its class, an archive of flights, and a network trained on them."""

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
    is_unlike,
    tell_class,
)
from nav_pose_estimator.core.motion.windows import SECONDS

Array = NDArray[np.float64]

VELOCITY, INCREMENTS = "velocity", "increments"
FORMS = (VELOCITY, INCREMENTS)
"""What a network says of a second: velocity through the air and its log variance, or the increments of the source."""
WORTH, FADES = 100.0, 150.0
"""Seconds of flight that an archive of other aircraft is worth at the start, and of motion until none counts."""
CONTROL_SEED = 1
_FASTEST = 100.0  # m/s
_SAME = 3.0  # flights of this very aircraft are worth so much more than those of others of its class
_YOUNG = 60.0  # s of flight in which a multirotor may not have hovered yet


@dataclass(frozen=True)
class Archive:
    """Normal equations of ``prior`` eq. (1) over ``seconds`` of flight, with what is left on flights not used for it.

    ``gram`` (n + 1, n + 1), ``moment`` (n + 1, 3), ``noise`` (3,) and ``wind_spread`` as in ``MotionPrior``.
    """

    gram: Array
    moment: Array
    noise: Array
    wind_spread: float
    seconds: float


@dataclass(frozen=True)
class TrainedNetwork:
    """A network and what its output is worth: archives of ten inputs more than its own three outputs.

    ``archive`` is made with the outputs of networks that had not seen the flight, ``control`` with those of a network
    of random weights.
    """

    form: str
    weights: ConvLstm
    archive: Archive
    control: Archive

    def velocity(self, window: Array) -> Array:
        """Air velocity in b (3,) [m/s] by the last second, ``windows.window``."""
        return air_velocity(self.weights, self.form, window)

    @property
    def untrained(self) -> "TrainedNetwork":
        """The control: the same shape and scales, weights by chance."""
        return TrainedNetwork(self.form, control_of(self.weights), self.control, self.control)


def air_velocity(weights: ConvLstm, form: str, window: Array) -> Array:
    """What a network of this ``form`` says of the air velocity in b (3,) [m/s]; no more than any aircraft flies."""
    said = weights.predict(window[:, : weights.channels])[:3]
    return np.clip(said if form == VELOCITY else said / SECONDS, -_FASTEST, _FASTEST)


def control_of(weights: ConvLstm) -> ConvLstm:
    """A network of the same shape and scales that has learned nothing."""
    scales = {name: getattr(weights, name) for name in ("input_mean", "input_scale", "output_mean", "output_scale")}
    return untrained(scales, CONTROL_SEED)


@dataclass(frozen=True)
class PastFlight:
    """A recording that went into an archive: its name, the SHA-256 of what it was read from, seconds of flight."""

    name: str
    digest: str
    seconds: float


@dataclass(frozen=True)
class Airframe:
    """The content of an airframe file. ``is_one_aircraft``: all flights are of the one that flies with the file.

    ``made_with``: versions and vector instructions, on which the last bits of a simulated flight depend; may be empty.
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
    """An ``archive`` as it counts in flight, at most as much as it holds.

    ``worth`` [s] of flight if it is of other aircraft; ``fades`` [s] as in ``MotionPrior``.
    """
    seconds = min(worth * (_SAME if is_one_aircraft else 1.0), archive.seconds)
    guided = vehicle_class == WHEELS
    return MotionPrior(
        archive.gram, archive.moment, archive.noise, archive.wind_spread, guided, worth=seconds, fades=fades
    )


@dataclass(frozen=True)
class Beforehand:
    """What a flight begins with: the class of the vehicle and, perhaps, an airframe; how much the archive is worth."""

    vehicle_class: str = UNKNOWN
    airframe: Airframe | None = None
    worth: float = WORTH  # s of flight if it is of other aircraft
    fades: float = FADES  # s of motion

    @property
    def is_class_known(self) -> bool:
        """Whether the regimes of motion can be told from the first seconds on."""
        return self.vehicle_class != UNKNOWN

    def by_flight(self, epochs: Array) -> "Beforehand":
        """What is left of it when the flight of ``epochs`` (N, COLUMNS or more) has shown what the vehicle is.

        A multirotor that the file, or the user, takes for a fixed wing, or a fixed wing for anything but that, is what
        it shows. On the ground it shows nothing: a wing taxies, and a multirotor is driven to where it starts.
        """
        told = tell_class(epochs)
        if self.is_class_known and (told not in FLYING or told == self.vehicle_class):
            return self
        return Beforehand(told)

    def can_hover(self, epochs: Array) -> bool | None:
        """Whether the vehicle of the flight of ``epochs`` (N, COLUMNS or more) can; None where that has to show it.

        What moves unlike a multirotor cannot: a car or a boat at constant speed is as calm as a hover. A multirotor
        that flies laps might, but does not; in its first minute it may not have done so yet.
        """
        told = self.by_flight(epochs).vehicle_class
        if told == UNKNOWN:
            return False if is_unlike(MULTIROTOR, epochs) else None
        if told != MULTIROTOR:
            return False
        return True if len(epochs) * me.PERIOD < _YOUNG else None

    @property
    def prior(self) -> MotionPrior | None:
        """The archive as a prior.

        None for multirotors unless they are the same aircraft: frames, propellers and loads differ too much.
        """
        return None if self.airframe is None else self.prior_of(self.airframe.archive)

    def flown(self, epochs: Array) -> Array:
        """Those of ``epochs`` (N, COLUMNS or more) that the archive's law can hold for, while it counts.

        A wing at rest on the runway feels what it feels in cruise: its law would take the difference for wind.
        """
        prior = self.prior
        if prior is None or self.vehicle_class != FIXED_WING or prior.seconds(epochs) == 0.0:
            return epochs
        stands = np.hypot(epochs[:, me.VELOCITY], epochs[:, me.VELOCITY + 1]) < MOVES
        return epochs[np.flatnonzero(stands)[-1] + 1 :] if stands.any() else epochs

    def prior_of(self, archive: Archive) -> MotionPrior | None:
        """The same of another ``archive`` of the airframe."""
        airframe = self.airframe
        if airframe is None or self.worth <= 0.0:
            return None
        if self.vehicle_class == MULTIROTOR and not airframe.is_one_aircraft:
            return None
        return as_prior(archive, self.vehicle_class, airframe.is_one_aircraft, self.worth, self.fades)
