"""Motion of a car on a winding, hilly road with stops; without slip, so that the velocity is along the x axis of b.

The road is given by course and slope as functions of the distance, and the drive by the distance as a function of time.
Both are smooth splines; all derivatives follow by the chain rule.
"""

from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline
from scipy.ndimage import gaussian_filter1d

from nav_pose_estimator.sim.trajectories import Kinematics, Motion
from nav_pose_estimator.sim.vehicles.motions import G, attitude_from_euler

_METRE = 2.0
"""Step [m] of the road."""
_TICK = 0.1
"""Step [s] of the drive."""
_SMOOTH = 0.6
"""Standard deviation [s] of the Gaussian window that smooths the drive."""


@dataclass(frozen=True)
class Drive:
    """A drive through town and country."""

    speed: tuple[float, float] = (8.0, 25.0)  # m/s: speed limits of the slowest and the fastest stretch
    acceleration: float = 1.8  # m/s^2
    side_acceleration: float = 2.5  # m/s^2 in a bend
    stretch: tuple[float, float] = (60.0, 350.0)  # m between bends
    turn: tuple[float, float] = (0.3, 1.7)  # rad per bend
    slope_sd: float = 0.03  # rad
    roll_per_g: float = 0.06  # rad of body roll in a bend of 1 g
    stop_every: float = 900.0  # m between stops, on average
    stop: tuple[float, float] = (5.0, 25.0)  # s
    rest: float = 15.0  # s before the start


def drive(plan: Drive, rng: np.random.Generator, duration: float) -> Motion:
    """The motion for at least ``duration`` [s]."""
    length = plan.speed[1] * duration + 200.0
    road = np.arange(0.0, length, _METRE)
    curvature, limit = _bends(plan, rng, road)
    course = CubicSpline(road, curvature).antiderivative()
    slope = CubicSpline(road, _hills(plan, rng, road))
    distance = CubicSpline(*_timetable(plan, rng, road, limit, duration))
    start_yaw = rng.uniform(-np.pi, np.pi)
    roll_gain = plan.roll_per_g / G

    def motion(t: np.ndarray) -> Kinematics:
        s, u, a = (distance(t, order) for order in range(3))
        yaw, bend, bend_rate = start_yaw + course(s), course(s, 1), course(s, 2) * u
        climb, climb_rate = slope(s), slope(s, 1) * u
        roll, roll_rate = roll_gain * bend * u**2, roll_gain * (bend_rate * u**2 + 2.0 * bend * u * a)
        cy, sy, cc, sc = np.cos(yaw), np.sin(yaw), np.cos(climb), np.sin(climb)
        ahead = np.column_stack([cy * cc, sy * cc, sc])
        left = np.column_stack([-sy * cc, cy * cc, np.zeros_like(t)])
        up = np.column_stack([-cy * sc, -sy * sc, cc])
        a_t = a[:, None] * ahead + (u * bend * u)[:, None] * left + (u * climb_rate)[:, None] * up
        q, w = attitude_from_euler(roll, -climb, yaw, roll_rate, -climb_rate, bend * u)
        return Kinematics(u[:, None] * ahead, a_t, q, w)

    return motion


def _bends(plan: Drive, rng: np.random.Generator, road: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Curvature (N,) [1/m], positive to the left, with clothoid-like ends, and the speed limit (N,) [m/s]."""
    curvature, limit = np.zeros_like(road), np.empty_like(road)
    at = 0.0
    while at < road[-1]:
        straight, radius = rng.uniform(*plan.stretch), rng.uniform(15.0, 90.0)
        turn, side = rng.uniform(*plan.turn), rng.choice((-1.0, 1.0))
        first, middle, last = np.searchsorted(road, (at, at + straight, at + straight + turn * radius))
        curvature[middle:last] = side / radius
        limit[first:last] = rng.uniform(*plan.speed)
        at += straight + turn * radius
    curvature = gaussian_filter1d(curvature, 6.0 / _METRE)
    bend_limit = np.sqrt(plan.side_acceleration / np.maximum(np.abs(curvature), 1e-4))
    return curvature, np.minimum(limit, bend_limit)


def _hills(plan: Drive, rng: np.random.Generator, road: np.ndarray) -> np.ndarray:
    """Slope (N,) [rad], undulating over some 200 m."""
    slope = gaussian_filter1d(rng.standard_normal(len(road)), 80.0 / _METRE)
    return slope * (plan.slope_sd / np.std(slope))


def _timetable(
    plan: Drive, rng: np.random.Generator, road: np.ndarray, limit: np.ndarray, duration: float
) -> tuple[np.ndarray, np.ndarray]:
    """Times [s] and distances [m] of the fastest drive within speed limits, acceleration and stops."""
    stops = np.cumsum(rng.uniform(0.5, 1.5, int(road[-1] / plan.stop_every) + 2)) * plan.stop_every
    rows = np.searchsorted(road, np.concatenate([[0.0], stops[stops < road[-1]]]))
    limit = limit.copy()
    limit[rows] = 0.0
    # the squared speed can grow and fall by at most 2 a per metre
    allowed = 2.0 * plan.acceleration * road
    energy = np.minimum.accumulate(limit**2 - allowed) + allowed
    energy = (np.minimum.accumulate((energy + allowed)[::-1]))[::-1] - allowed
    speed = np.sqrt(np.maximum(energy, 0.0))
    driving = 2.0 * np.diff(road) / (speed[:-1] + speed[1:])
    time = np.concatenate([[0.0], np.cumsum(driving)])
    waits = np.zeros_like(time)
    waits[rows] = rng.uniform(*plan.stop, len(rows))
    waits[0] = plan.rest + 4.0 * _SMOOTH
    leave = time + np.cumsum(waits)
    ticks = np.arange(-2.0, duration + 10.0, _TICK)
    both = np.column_stack([leave - waits, leave]).ravel()
    distance = np.interp(ticks, both, np.repeat(road, 2))
    return ticks, gaussian_filter1d(distance, _SMOOTH / _TICK, mode="nearest")
