"""Airframe files of synthetic flights, with and without a network."""

import numpy as np

from flown import Flight, drive
from formula_network import formula_network
from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.motion.air_velocity import learn_air_velocity, wind_along
from nav_pose_estimator.core.motion.airframe import (
    FORMS,
    VELOCITY,
    Airframe,
    Archive,
    PastFlight,
    TrainedNetwork,
)
from nav_pose_estimator.core.motion.prior import regressors
from nav_pose_estimator.core.motion.vehicle_class import FIXED_WING, MULTIROTOR, WHEELS


def archive_of(epochs: np.ndarray, added: int = 0) -> Archive:
    """Archive of one flight with ``added`` inputs that have no effect."""
    wide = np.column_stack([epochs, np.random.default_rng(0).normal(size=(len(epochs), added))])
    wind = wind_along(learn_air_velocity(epochs), epochs)
    in_body = np.einsum("nij,ni->nj", me.attitude(epochs)[:, :2], wind)
    z, target = regressors(wide), epochs[:, me.BODY_VELOCITY : me.VELOCITY] - in_body
    gram = z.T @ z / len(z)
    gram[-1, -1] = 1.0
    return Archive(0.5 * (gram + gram.T), z.T @ target / len(z), np.full(3, 0.1), 0.02, len(z) * me.PERIOD)


def airframe(vehicle_class: str = MULTIROTOR, is_one: bool = True, form: str | None = None) -> Airframe:
    """Airframe of one flight of ``flown.Flight`` in another wind, or of a drive."""
    epochs = drive(seed=5) if vehicle_class == WHEELS else Flight(wind=(-4.0, 1.0), seed=11).epochs()
    network = None
    if form is not None:
        weights = formula_network() if form == VELOCITY else formula_network(6, 9)
        network = TrainedNetwork(form, weights, archive_of(epochs, 3), archive_of(epochs, 3))
    return Airframe(vehicle_class, is_one, archive_of(epochs), network, (PastFlight("a flight", "0" * 64, 300.0),))


__all__ = ["FIXED_WING", "FORMS", "MULTIROTOR", "VELOCITY", "WHEELS", "airframe", "archive_of"]
