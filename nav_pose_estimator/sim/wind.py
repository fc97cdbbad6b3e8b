"""Model of the wind: a mean, gusts, a slow drift and a change of direction."""

from dataclasses import dataclass

import numpy as np

from nav_pose_estimator.sim.noise import gauss_markov, random_walk
from nav_pose_estimator.sim.vehicles.motions import minimum_jerk


@dataclass(frozen=True)
class Wind:
    """Velocity of the air over ground, East-North-Up."""

    mean: float = 0.0  # m/s, horizontal
    gust_sd: float = 0.0  # m/s per horizontal axis, Gauss-Markov; half as much vertically
    gust_tau: float = 10.0  # s
    walk: float = 0.0  # m/s/sqrt(s) per horizontal axis: random walk of the mean
    direction: float | None = None  # rad, counter-clockwise from East, towards which the air moves; None: random
    shift: float = 0.0  # m/s: change of the mean, perpendicular to it
    shift_at: float = 0.0  # s: middle of the change
    shift_length: float = 10.0  # s

    def sample(self, rng: np.random.Generator, count: int, dt: float) -> np.ndarray:
        """Wind (count, 3) [m/s] at equidistant times from 0 on, with step ``dt`` [s]."""
        towards = rng.uniform(-np.pi, np.pi)
        if self.direction is not None:
            towards = self.direction
        wind = gauss_markov(rng, count, dt, self.gust_sd * np.array([1.0, 1.0, 0.5]), self.gust_tau)
        wind[:, :2] += random_walk(rng, count, dt, self.walk, axes=2)
        wind += self.mean * np.array([np.cos(towards), np.sin(towards), 0.0])
        if self.shift:
            step = minimum_jerk((np.arange(count) * dt - self.shift_at) / self.shift_length + 0.5)[0]
            wind += np.outer(self.shift * step, [-np.sin(towards), np.cos(towards), 0.0])
        return wind


CALM = Wind(mean=0.5, gust_sd=0.05)
LIGHT = Wind(mean=2.0, gust_sd=0.2)
MODERATE = Wind(mean=5.0, gust_sd=0.6)
DRIFTING = Wind(mean=2.0, gust_sd=0.2, walk=0.05)
