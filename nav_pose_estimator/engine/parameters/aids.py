"""Parameters of the aids besides GNSS."""

from dataclasses import dataclass, field

from nav_pose_estimator.core.filter.measurement_noise import MODELS
from nav_pose_estimator.engine.parameters.beams import BeamParameters
from nav_pose_estimator.engine.parameters.schema import param


@dataclass(frozen=True)
class AidParameters:
    """Switches, noise floors and mounting of the aids."""

    magnetometer: bool = param(True, "", "Use the magnetometer for heading")
    magnetometer_sd: float = param(0.1, "rad", "Deviation of a magnetic heading", 0.01, 3.0, mutable=True)
    magnetometer_period: float = param(0.5, "s", "Shortest time between two magnetic headings", 0.0, 60.0)
    magnetometer_rpy: tuple[float, ...] = param(
        (0.0, 0.0, 0.0),
        "rad",
        "Roll, pitch, yaw of the magnetometer against the axes of the IMU as published",
        -3.2,
        3.2,
    )
    declination: float = param(0.0, "rad", "Magnetic declination, east positive", -3.15, 3.15)
    declination_from_model: bool = param(
        False,
        "",
        "Take it from the World Magnetic Model (pygeomag), for the first trusted position and its date",
    )
    barometer: bool = param(True, "", "Use the barometer for height")
    barometer_sd: float = param(1.5, "m", "Deviation of a barometric height", 0.05, 50.0, mutable=True)
    barometer_period: float = param(0.2, "s", "Shortest time between two barometric heights", 0.0, 60.0)
    barometer_tau: float = param(60.0, "s", "Time constant of the barometer's reference while GNSS is good", 1.0, 1e5)
    water_density: float = param(
        0.0,
        "kg/m^3",
        "Density of the water whose pressure is measured (sea 1025, fresh 1000); 0: pressure of the air",
        0.0,
        1300.0,
    )
    depth_sd: float = param(0.1, "m", "Deviation of a height by the pressure of water", 0.005, 10.0, mutable=True)
    body_velocity: bool = param(True, "", "Use the velocity sensor (DVL, optical flow, wheel)")
    body_velocity_sd: float = param(
        0.1, "m/s", "Lower bound on the deviation of a body velocity", 0.001, 10.0, mutable=True
    )
    body_velocity_noise: str = param(
        "fixed",
        "",
        "Noise model of a body velocity; fixed: as stated, with the floor above; others: estimated upwards",
        choices=tuple(MODELS),
    )
    body_velocity_delay: float = param(0.0, "s", "Stamp minus time of validity of a body velocity", -1.0, 1.0)
    body_velocity_lever: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), "m", "From the IMU to the velocity sensor, body frame", -50.0, 50.0
    )
    body_velocity_rpy: tuple[float, ...] = param(
        (0.0, 0.0, 0.0), "rad", "Roll, pitch, yaw of the velocity sensor in the body frame", -3.2, 3.2
    )
    beam_velocity_source: str = param(
        "none",
        "",
        "Message with the velocities along the beams of a Doppler log or radar; body_velocity takes its 3-D velocity",
        choices=("none", "dvl", "a50", "pointcloud2"),
    )
    beams: BeamParameters = field(default_factory=BeamParameters)
    airspeed: bool = param(True, "", "Use the airspeed of a fixed wing: it learns the wind and bounds the drift")
    airspeed_sd: float = param(0.8, "m/s", "Lower bound on the deviation of a true airspeed", 0.05, 20.0, mutable=True)
    airspeed_min: float = param(7.0, "m/s", "A lower airspeed is not used", 1.0, 100.0)
    wind_sd: float = param(5.0, "m/s", "Deviation of each wind component before anything is known", 0.1, 50.0)
    range: bool = param(True, "", "Use a rangefinder that looks down for the height above flat ground")
    range_sd: float = param(
        0.1, "m", "Lower bound on the deviation of a distance to the ground", 0.01, 10.0, mutable=True
    )
    zero_velocity: bool = param(True, "", "Hold the velocity at zero while the vehicle is certain to be at rest")
    zero_velocity_sd: float = param(0.05, "m/s", "Deviation of the velocity at rest", 0.001, 1.0, mutable=True)
