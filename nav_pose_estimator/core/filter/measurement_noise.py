"""Measurement noise: from what a sensor states to the covariance R that the filter goes by.

A model is asked each time that an observation acts, and told once what came of it, in the order in which observations
first act; that is when it may learn. Its memory is copied with the filter.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Protocol

from numpy import float64
from numpy.typing import NDArray

Array = NDArray[float64]


class NoiseModel(Protocol):
    """Decides how noisy one sensor is."""

    learns: bool
    """Whether ``note`` wants to be called."""

    def covariance(self, z: Array, H: Array, P: Array, stated: Array) -> Array:
        """R (m, m) for an innovation ``z`` (m,) with ``H`` (m, n) at covariance ``P`` (n, n); changes nothing."""

    def note(self, z: Array, HPH: Array, R: Array, used: bool) -> None:
        """An observation has acted for the first time: innovation ``z``, its covariance ``HPH`` + ``R`` (m, m).

        ``used`` is False when the gate refused it.
        """


class Fixed:
    """What the sensor states, with the floors that its parameters put under it."""

    learns = False

    def covariance(self, z: Array, H: Array, P: Array, stated: Array) -> Array:
        """``stated`` as it is."""
        return stated

    def note(self, z: Array, HPH: Array, R: Array, used: bool) -> None:
        """Nothing is learned."""


MODELS: dict[str, Callable[[], NoiseModel]] = {"fixed": Fixed}
"""The models by the names that parameters choose them by."""
