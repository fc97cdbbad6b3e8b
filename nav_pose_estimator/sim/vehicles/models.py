"""Vehicles: each computes its true motion from equidistant times, an origin, a wind and a seed."""

from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from nav_pose_estimator.sim.noise import stream
from nav_pose_estimator.sim.trajectories import Motion, Origin, Truth, truth_of_motion
from nav_pose_estimator.sim.vehicles import fixed_wing, lanes, multirotor, road_vehicle
from nav_pose_estimator.sim.vehicles.missions import Mission
from nav_pose_estimator.sim.vehicles.multirotor import Airframe
from nav_pose_estimator.sim.wind import Wind


class Vehicle(Protocol):
    """A vehicle. The IMU interval of row 0 begins at the first of ``times`` [s]."""

    def move(self, times: np.ndarray, origin: Origin, wind: Wind, seed: int) -> Truth:
        """The motion from ``origin``, reproducible by ``seed``."""


@dataclass(frozen=True)
class Multirotor:
    """A quadrotor on a mission."""

    mission: Mission = field(default_factory=Mission)
    airframe: Airframe = field(default_factory=Airframe)

    def move(self, times: np.ndarray, origin: Origin, wind: Wind, seed: int) -> Truth:
        rngs = stream(seed, "mission"), stream(seed, "wind")
        return multirotor.fly(self.mission, wind, times, origin, *rngs, self.airframe)


@dataclass(frozen=True)
class FixedWing:
    """A small fixed wing."""

    flight: fixed_wing.Flight = field(default_factory=fixed_wing.Flight)

    def move(self, times: np.ndarray, origin: Origin, wind: Wind, seed: int) -> Truth:
        rngs = stream(seed, "mission"), stream(seed, "wind")
        motion, air = fixed_wing.fly(self.flight, wind, *rngs, duration=float(times[-1]))
        return truth_of_motion(motion, times, origin, air(times))


@dataclass(frozen=True)
class RoadVehicle:
    """A car; the wind has no effect."""

    drive: road_vehicle.Drive = field(default_factory=road_vehicle.Drive)

    def move(self, times: np.ndarray, origin: Origin, wind: Wind, seed: int) -> Truth:
        return truth_of_motion(road_vehicle.drive(self.drive, stream(seed, "mission"), float(times[-1])), times, origin)


@dataclass(frozen=True)
class Surveyor:
    """A survey vehicle on parallel lanes, on water, under water or in the air; the wind has no effect."""

    survey: lanes.Survey = field(default_factory=lanes.Survey)

    def move(self, times: np.ndarray, origin: Origin, wind: Wind, seed: int) -> Truth:
        return truth_of_motion(lanes.follow(self.survey, stream(seed, "mission"), float(times[-1])), times, origin)


@dataclass(frozen=True)
class Prescribed:
    """A motion given by formulas; seed and wind have no effect."""

    motion: Motion

    def move(self, times: np.ndarray, origin: Origin, wind: Wind, seed: int) -> Truth:
        return truth_of_motion(self.motion, times, origin)
