"""Motion of a survey vehicle, on water, under water or in the air, along parallel lanes connected by half turns.

Course, speed, heave, roll and pitch are smooth splines of time, whose derivatives are exact.
"""

import math
from dataclasses import dataclass

import numpy as np
from scipy.interpolate import CubicSpline

from nav_pose_estimator.sim.trajectories import Kinematics, Motion
from nav_pose_estimator.sim.vehicles.motions import G, Harmonics, attitude_from_euler, minimum_jerk

_TICK = 0.1
"""Step [s] of the splines."""
_WOBBLES = 3
"""Number of sines in roll, pitch, course and heave."""


@dataclass(frozen=True)
class Survey:
    """Parameters of the motion along the lanes."""

    speed: tuple[float, float] = (1.5, 1.5)  # m/s: lowest and highest speed, between which it oscillates
    speed_period: float = 90.0  # s: period of that oscillation
    lane: float = 200.0  # s from the begin of one turn to that of the next
    turn: float = 25.0  # s: duration of a half turn
    rest: float = 20.0  # s before the start
    start: float = 10.0  # s of acceleration to the speed
    wobble: float = math.radians(1.0)  # rad: standard deviation of roll and pitch; a third of it in the course
    wobble_period: tuple[float, float] = (4.0, 9.0)  # s: shortest and longest period
    heave: float = 0.0  # m/s: standard deviation of the vertical velocity
    lean: bool = False  # whether the vehicle tilts to accelerate, with thrust along the z axis of b, as a multirotor
    drag: float = 0.0  # 1/s: linear drag that the tilt compensates


def follow(survey: Survey, rng: np.random.Generator, duration: float) -> Motion:
    """The motion for at least ``duration`` [s]; ``rng`` determines the initial course and the oscillations."""
    ticks = np.arange(-2.0, duration + 10.0, _TICK)
    away = minimum_jerk((ticks - survey.rest) / survey.start)[0]
    roll, pitch, yaw, up = (_wobbles(survey, rng)(ticks) * away for _ in range(4))
    mean, swing = 0.5 * sum(survey.speed), 0.5 * (survey.speed[1] - survey.speed[0])
    speed = CubicSpline(
        ticks, away * (mean - swing * np.cos(2.0 * np.pi * (ticks - survey.rest) / survey.speed_period))
    )
    course = CubicSpline(ticks, rng.uniform(-np.pi, np.pi) + _turns(survey, ticks) + survey.wobble / 3.0 * yaw)
    rise = CubicSpline(ticks, survey.heave * up)
    roll, pitch = survey.wobble * roll, survey.wobble * pitch
    if survey.lean:
        roll = roll - np.arctan(speed(ticks) * course(ticks, 1) / G)
        pitch = pitch + np.arctan((speed(ticks, 1) + survey.drag * speed(ticks)) / G)
    angles = CubicSpline(ticks, roll), CubicSpline(ticks, pitch), course

    def motion(t: np.ndarray) -> Kinematics:
        cos, sin = np.cos(course(t)), np.sin(course(t))
        u, du, turn = speed(t), speed(t, 1), course(t, 1)
        v = np.column_stack([u * cos, u * sin, rise(t)])
        a = np.column_stack([du * cos - u * turn * sin, du * sin + u * turn * cos, rise(t, 1)])
        return Kinematics(v, a, *attitude_from_euler(*(f(t) for f in angles), *(f(t, 1) for f in angles)))

    return motion


def _turns(survey: Survey, ticks: np.ndarray) -> np.ndarray:
    """Course (N,) [rad] at ``ticks`` [s]: half turns, alternately to the left and to the right."""
    course = np.zeros_like(ticks)
    starts = np.arange(survey.rest + survey.lane, ticks[-1], survey.lane)
    for number, start in enumerate(starts):
        course += (-1.0) ** number * np.pi * minimum_jerk((ticks - start) / survey.turn)[0]
    return course


def _wobbles(survey: Survey, rng: np.random.Generator) -> Harmonics:
    """A sum of sines with a standard deviation of 1."""
    period = rng.uniform(*survey.wobble_period, _WOBBLES)
    phase = rng.uniform(0.0, 2.0 * np.pi, _WOBBLES)
    amplitude = math.sqrt(2.0 / _WOBBLES)
    return Harmonics(0.0, 0.0, (amplitude,) * _WOBBLES, tuple(2.0 * np.pi / period), tuple(phase))
