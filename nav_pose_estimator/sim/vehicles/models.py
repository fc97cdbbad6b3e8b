"""Things that move: each turns equidistant times, a place, a wind and a seed into the truth."""

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
    """``times`` [s]: the first one is where the IMU interval of row 0 begins."""

    def move(self, times: np.ndarray, origin: Origin, wind: Wind, seed: int) -> Truth:
        """The motion from ``origin``; the same seed gives the same motion."""


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
    """A car. It does not feel the wind."""

    drive: road_vehicle.Drive = field(default_factory=road_vehicle.Drive)

    def move(self, times: np.ndarray, origin: Origin, wind: Wind, seed: int) -> Truth:
        return truth_of_motion(road_vehicle.drive(self.drive, stream(seed, "mission"), float(times[-1])), times, origin)


@dataclass(frozen=True)
class Surveyor:
    """A vehicle that goes up and down lanes, under water or in the air. It does not feel the wind."""

    survey: lanes.Survey = field(default_factory=lanes.Survey)

    def move(self, times: np.ndarray, origin: Origin, wind: Wind, seed: int) -> Truth:
        return truth_of_motion(lanes.follow(self.survey, stream(seed, "mission"), float(times[-1])), times, origin)


@dataclass(frozen=True)
class Prescribed:
    """A motion given by formulas; seed and wind change nothing."""

    motion: Motion

    def move(self, times: np.ndarray, origin: Origin, wind: Wind, seed: int) -> Truth:
        return truth_of_motion(self.motion, times, origin)
