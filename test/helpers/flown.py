"""Epochs of synthetic flights with a known law of motion, which the outage learning has to find."""

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np

from nav_pose_estimator.core.motion import epochs as me
from nav_pose_estimator.core.numerics.rotation import quat_from_euler, quat_to_matrix

GRAVITY = 9.80665
DRAG = (0.35, 0.5)  # 1/s along body x and y


def linear_drag(air: np.ndarray) -> np.ndarray:
    """Specific force along body x and y of the air velocity (N, 3)."""
    return -np.array(DRAG) * air[:, :2]


@dataclass
class Flight:
    """A multirotor that yaws, tilts and moves back and forth; ``epochs()`` are its half-second means."""

    seconds: float = 300.0
    speed: float = 6.0  # m/s, through the air
    wind: tuple[float, float] = (2.0, -1.5)
    change: Callable[[np.ndarray], np.ndarray] = field(default=lambda t: np.zeros((len(t), 2)))  # of the wind
    drag: Callable[[np.ndarray], np.ndarray] = linear_drag
    noise: float = 0.05  # m/s^2, of the mean specific force
    hover: float = 0.0  # fraction of the time without motion over ground
    seed: int = 1

    def epochs(self) -> np.ndarray:
        """Rows (N, COLUMNS), N two a second."""
        random = np.random.default_rng(self.seed)
        t = me.PERIOD * np.arange(1, round(self.seconds / me.PERIOD) + 1)
        yaw = 2.0 * np.sin(0.05 * t) + 0.04 * t
        C = np.array(
            [quat_to_matrix(quat_from_euler(*tilt, psi)) for tilt, psi in zip(self._tilt(t), yaw, strict=True)]
        )
        wind = np.column_stack([np.array(self.wind) + self.change(t), np.zeros(len(t))])
        air = self.speed * np.column_stack([np.sin(0.31 * t), 0.6 * np.sin(0.23 * t + 1.0), 0.1 * np.sin(0.17 * t)])
        hovers = (t % 40.0) < 40.0 * self.hover
        air[hovers] = np.einsum("nij,ni->nj", C[hovers], -wind[hovers])
        velocity = np.einsum("nij,nj->ni", C, air) + wind
        rows = np.zeros((len(t), me.COLUMNS))
        rows[:, me.TIME], rows[:, me.ATTITUDE : me.BODY_VELOCITY] = t, C.reshape(-1, 9)
        rows[:, me.VELOCITY : me.FORCE] = velocity
        rows[:, me.BODY_VELOCITY : me.VELOCITY] = np.einsum("nij,ni->nj", C, velocity)
        rows[:, me.FORCE : me.RATE] = random.normal(0.0, self.noise, (len(t), 3))
        rows[:, me.FORCE : me.FORCE + 2] += self.drag(air)
        rows[:, me.FORCE + 2] += GRAVITY + 0.5 * air[:, 2]
        rows[:, me.RATE : me.POSITION] = random.normal(0.0, 0.02, (len(t), 3))
        return rows

    def _tilt(self, t: np.ndarray) -> np.ndarray:
        return 0.12 * np.column_stack([np.sin(0.41 * t), np.cos(0.29 * t)])


def drive(seconds: float = 200.0, wind: tuple[float, float] = (0.0, 0.0), seed: int = 1) -> np.ndarray:
    """Epochs of a level vehicle that moves along its x axis, through air with the velocity ``wind`` [m/s].

    Without wind it is a car: its speed does not show in any drag. The specific force is that of its turns.
    """
    random = np.random.default_rng(seed)
    t = me.PERIOD * np.arange(1, round(seconds / me.PERIOD) + 1)
    rate = 0.3 * np.sin(0.11 * t) + 0.1
    yaw, speed = np.cumsum(rate) * me.PERIOD, 12.0 + 4.0 * np.sin(0.07 * t)
    C = np.array([quat_to_matrix(quat_from_euler(0.0, 0.0, psi)) for psi in yaw])
    air = np.column_stack([speed, random.normal(0.0, 0.02, (len(t), 2))])
    rows = np.zeros((len(t), me.COLUMNS))
    rows[:, me.TIME], rows[:, me.ATTITUDE : me.BODY_VELOCITY] = t, C.reshape(-1, 9)
    rows[:, me.VELOCITY : me.FORCE] = np.einsum("nij,nj->ni", C, air) + np.array((*wind, 0.0))
    rows[:, me.BODY_VELOCITY : me.VELOCITY] = np.einsum("nij,ni->nj", C, rows[:, me.VELOCITY : me.FORCE])
    rows[:, me.FORCE : me.RATE] = random.normal((0.0, 0.0, GRAVITY), 0.05, (len(t), 3))
    rows[:, me.FORCE + 1] += rate * speed
    rows[:, me.RATE : me.POSITION] = random.normal(0.0, 0.005, (len(t), 3))
    rows[:, me.RATE + 2] += rate
    return rows
