"""Named scenarios: a vehicle on a mission, the wind, its sensors and their faults."""

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from nav_pose_estimator.engine.samples import GnssFix, GnssVelocity
from nav_pose_estimator.errors import UserError, unknown
from nav_pose_estimator.sim import beam_faults, sensors
from nav_pose_estimator.sim.doppler import Doppler, cone, doppler
from nav_pose_estimator.sim.faults import Fault, Shift
from nav_pose_estimator.sim.imu_grades import ImuGrade, imu_grade
from nav_pose_estimator.sim.noise import stream
from nav_pose_estimator.sim.recording import Recording
from nav_pose_estimator.sim.sensors import Barometer, DepthGauge, Gnss, Magnetometer, Pitot, Rangefinder, Timed, Wheels
from nav_pose_estimator.sim.trajectories import Origin, Truth, sample_times
from nav_pose_estimator.sim.vehicles import motions
from nav_pose_estimator.sim.vehicles.lanes import Survey
from nav_pose_estimator.sim.vehicles.missions import Mission
from nav_pose_estimator.sim.vehicles.models import FixedWing, Multirotor, Prescribed, RoadVehicle, Surveyor, Vehicle
from nav_pose_estimator.sim.wind import CALM, DRIFTING, LIGHT, MODERATE, Wind

START_NS = 1_700_000_000_000_000_000
"""Stamp of time zero."""
HOME = Origin(math.radians(47.3977), math.radians(8.5456), 488.0)
"""Default origin of the scenarios."""
SEA = Origin(math.radians(43.2), math.radians(5.2), 0.0)
"""Origin of the scenarios on, in or above water."""
MAX_DURATION = 6.0 * 3600.0
"""Longest duration [s]; an hour at 200 Hz takes about 1 GB of memory."""


@dataclass(frozen=True)
class Scenario:
    """A scenario that can be run with any seed and any IMU."""

    name: str
    description: str
    vehicle: Vehicle
    wind: Wind = field(default_factory=Wind)
    duration: float = 600.0  # s
    gnss: Gnss | None = field(default_factory=Gnss)
    magnetometer: Magnetometer | None = field(default_factory=Magnetometer)
    barometer: Barometer | None = field(default_factory=Barometer)
    depth_gauge: DepthGauge | None = None
    airspeed: Pitot | None = None
    ground_range: Rangefinder | None = None
    wheels: Wheels | None = None
    doppler: Doppler | None = None
    faults: tuple[Fault, ...] = ()
    imu_rate: float = 200.0  # Hz
    origin: Origin = HOME


_TRAVEL = Multirotor(Mission())
_HOVER = Multirotor(Mission("hover", speed=1.0, acceleration=0.5, leg=(0.3, 1.5), dwell=(5.0, 20.0), radius=4.0))
_STOP_AND_GO = Multirotor(
    Mission("stop_and_go", speed=14.0, acceleration=5.0, leg=(60.0, 130.0), dwell=(6.0, 25.0), radius=200.0)
)
_BRISK = Mission(speed=6.0, acceleration=3.0, leg=(5.0, 20.0), dwell=(0.0, 1.0), radius=60.0)
_WHITE = Gnss(
    position_sd=(0.0, 0.0, 0.0), position_noise=(1.5, 1.5, 2.5), velocity_noise=(0.15, 0.15, 0.25), satellites_sd=0.0
)
_LOST_300 = Gnss(drops=((120.0, 60.0, 0),))

_ALL: tuple[Scenario, ...] = (
    Scenario(
        "multirotor_outage",
        "A quadrotor between waypoints in light wind, meant for replay with a GNSS outage",
        _TRAVEL,
        LIGHT,
    ),
    Scenario("multirotor_calm", "Waypoints in calm air: wind 0.5 m/s, gusts 0.05 m/s", _TRAVEL, CALM),
    Scenario("multirotor_light", "Waypoints in light wind: 2 m/s, gusts 0.2 m/s", _TRAVEL, LIGHT),
    Scenario("multirotor_moderate", "Waypoints in moderate wind: 5 m/s, gusts 0.6 m/s", _TRAVEL, MODERATE),
    Scenario("multirotor_wind_walk", "Light wind that drifts by 0.05 m/s per root second", _TRAVEL, DRIFTING),
    Scenario(
        "wind_shift",
        "The wind turns by 3 m/s at 300 s, shortly before one would lose GNSS",
        _TRAVEL,
        replace(LIGHT, shift=3.0, shift_at=300.0),
    ),
    Scenario("laps", "A quadrotor on ellipses at 8 m/s, nose forward", Multirotor(Mission("laps")), LIGHT),
    Scenario("hover", "A quadrotor that hovers, turns and shifts by a metre", _HOVER, LIGHT),
    Scenario("stop_and_go", "A quadrotor that dashes at up to 14 m/s and hovers in between", _STOP_AND_GO, LIGHT),
    Scenario(
        "start_in_air",
        "The recording begins in flight: no rest to align on",
        Multirotor(Mission(rest=0.0)),
        LIGHT,
    ),
    Scenario(
        "ship_mooring",
        "A ship sways at its mooring; fixes of 10 m every second and no velocity (meant for --imu navigation)",
        Prescribed(motions.mooring()),
        duration=1200.0,
        gnss=Gnss(1.0, (0.0, 0.0, 0.0), position_noise=(10.0, 10.0, 10.0), velocity=False),
        magnetometer=None,
        barometer=None,
        imu_rate=25.0,
        origin=Origin(math.radians(45.7796), math.radians(126.6705), 50.0),
    ),
    Scenario(
        "alignment_in_air",
        "A quadrotor that manoeuvres from the first second; white GNSS errors, no magnetometer",
        Multirotor(replace(_BRISK, rest=0.0)),
        LIGHT,
        120.0,
        _WHITE,
        None,
        None,
    ),
    Scenario(
        "alignment_on_ground",
        "30 s on the ground in wind, then manoeuvres; white GNSS errors, no magnetometer",
        Multirotor(replace(_BRISK, rest=30.0)),
        MODERATE,
        150.0,
        _WHITE,
        None,
        None,
    ),
    Scenario("fixed_wing", "A small fixed wing: runway, climb, coordinated turns", FixedWing(), LIGHT),
    Scenario(
        "fixed_wing_airspeed",
        "The fixed wing with a pitot tube",
        FixedWing(),
        LIGHT,
        airspeed=Pitot(),
    ),
    Scenario(
        "hover_range",
        "The hovering quadrotor with a laser that looks down",
        _HOVER,
        LIGHT,
        ground_range=Rangefinder(),
    ),
    Scenario("road_vehicle", "A car with bends, slopes and stops", RoadVehicle(), duration=900.0),
    Scenario(
        "road_vehicle_wheels",
        "The car with the speed of its wheels",
        RoadVehicle(),
        duration=900.0,
        wheels=Wheels(),
    ),
    Scenario("at_rest", "Nothing moves", Prescribed(motions.at_rest(0.02, -0.03, 0.7)), duration=300.0),
    Scenario("coning", "A cone of 3 deg at 5 Hz in place", Prescribed(motions.coning()), duration=120.0),
    Scenario("figure_eight", "A level figure of eight", Prescribed(motions.figure_eight()), duration=300.0),
    Scenario("closed_curve", "Aerobatics on a closed curve", Prescribed(motions.closed_curve()), duration=120.0),
    Scenario(
        "coordinated_acceleration",
        "Lean 15 deg for 10 s: the accelerometer shows a level vehicle",
        Prescribed(motions.coordinated_acceleration()),
        duration=60.0,
    ),
    Scenario(
        "sats_3",
        "From 120 to 180 s three satellites are left; fixes go on, poorer and poorer",
        _TRAVEL,
        LIGHT,
        300.0,
        gnss=Gnss(drops=((120.0, 60.0, 3),)),
    ),
    Scenario(
        "spike_15m",
        "Single fixes lie 15 m off at 100, 130 and 160 s",
        _TRAVEL,
        LIGHT,
        240.0,
        faults=tuple(Shift(GnssFix, start, 0.19, (9.0, -12.0, 0.0)) for start in (100.0, 130.0, 160.0)),
    ),
    Scenario(
        "return_offset_300m",
        "GNSS is lost from 120 to 180 s, comes back 300 m off for 20 s, then true",
        _TRAVEL,
        LIGHT,
        300.0,
        gnss=_LOST_300,
        faults=(Shift(GnssFix, 180.0, 20.0, (180.0, 240.0, 0.0)),),
    ),
    Scenario(
        "velocity_jump",
        "GNSS velocity is wrong by 5 m/s from 120 to 130 s, positions stay true",
        _TRAVEL,
        LIGHT,
        240.0,
        faults=(Shift(GnssVelocity, 120.0, 10.0, (4.0, 3.0, 0.0)),),
    ),
    Scenario("late_gnss", "Fixes arrive 0.3 s late with true stamps", _TRAVEL, LIGHT, 300.0, gnss=Gnss(transport=0.3)),
    Scenario(
        "gnss_latency",
        "Fixes are stamped 0.25 s after they were valid, as many drivers do",
        _TRAVEL,
        LIGHT,
        300.0,
        gnss=Gnss(latency=0.25),
    ),
    Scenario(
        "magnetic_disturbance",
        "An iron object turns the compass by about 40 deg from 120 to 150 s",
        _TRAVEL,
        LIGHT,
        240.0,
        magnetometer=Magnetometer(disturbances=((120.0, 30.0, (18e-6, 0.0, 5e-6)),)),
    ),
    Scenario("no_magnetometer", "Heading has to come from GNSS velocity", _TRAVEL, LIGHT, 300.0, magnetometer=None),
)
AUV = Scenario(
    "auv_lanes",
    "An underwater vehicle on lanes of 200 s at 1.5 m/s, Doppler log with four beams, depth (meant for --imu tactical)",
    Surveyor(Survey(heave=0.02)),
    duration=900.0,
    gnss=Gnss(1.0),
    magnetometer=Magnetometer(2.0),
    barometer=None,
    depth_gauge=DepthGauge(),
    doppler=Doppler(lever=(0.4, 0.0, -0.2)),
    imu_rate=50.0,
    origin=SEA,
)
BOAT = Scenario(
    "boat_lanes",
    "A boat on lanes of 60 s at 3 to 6 m/s, level as a hull is",
    Surveyor(Survey((3.0, 6.0), lane=60.0, turn=10.0, heave=0.1)),
    magnetometer=Magnetometer(2.0),
    imu_rate=100.0,
    origin=SEA,
)
DRONE = Scenario(
    "drone_over_water",
    "A drone on lanes of 40 s at 4 to 8 m/s above water, Doppler radar with four beams",
    Surveyor(
        Survey((4.0, 8.0), lane=40.0, turn=8.0, start=4.0, wobble=math.radians(1.5), heave=0.1, lean=True, drag=0.3)
    ),
    duration=900.0,
    magnetometer=Magnetometer(2.0),
    barometer=Barometer(2.0),
    doppler=Doppler(2.5, cone(4, math.radians(25.0), 0.0), 0.08, bias_sd=0.005, scale_sd=0.005, lever=(0.1, 0.0, -0.1)),
    imu_rate=100.0,
    origin=SEA,
)
FAULTY_FROM, FAULTY_FOR = 300.0, 600.0
"""Start and length [s] of the beam faults in the scenarios auv_... and drone_..., for replay with an outage there."""


def _with_faulty_beams(healthy: Scenario, prefix: str, speed: float) -> Iterator[Scenario]:
    """Yield a variant of ``healthy``, with ``speed`` [m/s], for every plan of ``beam_faults``."""
    assert healthy.doppler is not None
    model = healthy.doppler
    where = beam_faults.Stretch(FAULTY_FROM, FAULTY_FOR, speed, model.noise, model.rate, len(model.directions))
    for name in beam_faults.PLANS:
        if name != "none":
            what = f"{healthy.name}, where beams fail from {FAULTY_FROM:g} s on: {name}"
            faults = beam_faults.plan(name, where, seed=0)
            yield replace(healthy, name=f"{prefix}_{name.replace(' ', '_')}", description=what, faults=faults)


_ALL += (
    AUV,
    replace(AUV, name="auv_heave", description="auv_lanes in waves", vehicle=Surveyor(Survey(heave=0.3))),
    *_with_faulty_beams(AUV, "auv", 1.5),
    BOAT,
    DRONE,
    *_with_faulty_beams(DRONE, "drone", 6.0),
)
SCENARIOS = {scenario.name: scenario for scenario in _ALL}


def find_scenario(name: str | Scenario) -> Scenario:
    """The scenario of that name; ``UserError`` with the closest name if it does not exist."""
    if isinstance(name, Scenario):
        return name
    if name not in SCENARIOS:
        raise UserError(unknown("scenario", name, SCENARIOS))
    return SCENARIOS[name]


_SENSORS: dict[str, Callable[[Truth, Any, np.random.Generator, int], list[Timed]]] = {
    "gnss": sensors.gnss,
    "magnetometer": sensors.magnetometer,
    "barometer": sensors.barometer,
    "depth_gauge": sensors.depth_gauge,
    "airspeed": sensors.airspeed,
    "ground_range": sensors.ground_range,
    "wheels": sensors.wheels,
    "doppler": doppler,
}
"""Simulation of each sensor, by the name of its model in ``Scenario`` and of its random numbers."""


def generate(
    scenario: str | Scenario,
    duration: float | None = None,
    seed: int = 0,
    imu: str | ImuGrade = "icm42688",
    imu_rate: float | None = None,
) -> Recording:
    """Simulate ``scenario`` for ``duration`` [s]. The same arguments give the same recording, bit for bit.

    The motion depends only on scenario, duration, rate and seed, so that different IMU grades record the same flight.
    Raises ``UserError`` for an unknown scenario or grade, and for numbers out of range.
    """
    scenario, grade = find_scenario(scenario), imu_grade(imu)
    duration = _within("duration", scenario.duration if duration is None else duration, 1.0, MAX_DURATION, "s")
    rate = _within("IMU rate", scenario.imu_rate if imu_rate is None else imu_rate, 10.0, 4000.0, "Hz")
    if seed < 0:
        raise UserError(f"seed {seed} is negative; give 0 or more")
    truth = scenario.vehicle.move(sample_times(duration, rate), scenario.origin, scenario.wind, seed)
    imu_data = sensors.imu(truth, grade, stream(seed, "imu"), START_NS)
    others: list[Timed] = []
    for name, simulate in _SENSORS.items():
        model = getattr(scenario, name)
        if model is not None:
            others += simulate(truth, model, stream(seed, name), START_NS)
    others.sort(key=lambda timed: timed.arrival_ns)
    block = imu_data.block
    recording = Recording(
        scenario.name, seed, grade, scenario.origin, START_NS, truth, imu_data, block, block.stamps_ns, others
    )
    return recording.with_faults(*scenario.faults)


def _within(what: str, value: float, low: float, high: float, unit: str) -> float:
    if not low <= value <= high:  # this form also rejects NaN
        raise UserError(f"{what} of {value:g} {unit} is out of range; give {low:g} to {high:g} {unit}")
    return float(value)
